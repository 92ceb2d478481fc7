"""Trees at random, for tests of refined grids."""

from __future__ import annotations

import numpy as np


def random_flags(bases, children, depth=3, seed=0):
    """Return the split flags of an unbalanced tree."""
    rng, flags = np.random.default_rng(seed), []

    def node(level):
        split = level < depth and rng.random() < 0.3
        flags.append(int(split))
        for _ in range(children * split):
            node(level + 1)

    for _ in range(bases):
        node(0)
    return flags
