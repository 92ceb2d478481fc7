"""Which cells are too wide for the particles that reach into them."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from ..progress import reported_range
from .base import Base

# Particles looked at at once: temporary arrays stay small.
_CHUNK = 1 << 18


def claimed_cells(
    base: Base,
    points: np.ndarray,
    reach: np.ndarray,
    widest: np.ndarray,
    most: int,
    steps: int = 1,
) -> list[np.ndarray]:
    """Return for each level the numbers of the cells that have to be split, ascending.

    Parameters
    ----------
    base : Base
    points : array, shape (n, 3)
    reach, widest : array, shape (n,)
        How far particles reach, and how wide cells may be there.
    most : int
        Levels that there are at most.
    steps : int
        Into how many parts the cube in a particle's sphere is cut along each axis: its size counts
        at their corners.
    """
    offsets = _offsets(steps)
    found: list[list[np.ndarray]] = [[np.empty(0, np.uint64)] for _ in range(most)]
    for first in reported_range(len(points), _CHUNK):
        part = slice(first, first + _CHUNK)
        for level, numbers in _claims(base, points[part], reach[part], widest[part], most, offsets):
            found[level].append(numbers)
    claimed = [np.unique(np.concatenate(numbers)) for numbers in found]
    for level in range(most - 1, 0, -1):
        parents = _parents(base, claimed[level], level)
        claimed[level - 1] = np.unique(np.concatenate([claimed[level - 1], parents]))
    return claimed


def _offsets(steps: int) -> np.ndarray:
    """Return where a particle's size matters, in radii from its centre.

    At its centre, and at the corners of the cube in its sphere: without these, wide cells beside
    fine ones are a part of many kernels, and interpolation smears them out (columns of an SPH disc:
    11 % too much, with them 0.5 %). Where cells are much smaller, in between, too.
    """
    ticks = np.linspace(-(3**-0.5), 3**-0.5, steps + 1)
    corners = np.array(list(itertools.product(ticks, repeat=3)))
    return np.concatenate([np.zeros((1, 3)), corners])


def _claims(
    base: Base,
    points: np.ndarray,
    reach: np.ndarray,
    widest: np.ndarray,
    most: int,
    offsets: np.ndarray,
) -> Iterator[tuple[int, np.ndarray]]:
    wanted = np.ceil(np.log2(base.width.max() / widest) - 1e-9)
    level = np.clip(wanted, 0, most).astype(np.int64) - 1
    for offset in offsets:
        near = base.wrapped(points + reach[:, None] * offset)
        here = np.flatnonzero(base.inside(near) & (level >= 0))
        cells = base.places(near[here], most) >> (most - level[here])[:, None]
        numbers = base.numbers(cells, level[here])
        for own in np.unique(level[here]):
            yield int(own), np.unique(numbers[level[here] == own])


def _parents(base: Base, numbers: np.ndarray, level: int) -> np.ndarray:
    nx, ny, _ = (np.uint64(n) << np.uint64(level) for n in base.counts)
    rows, x = np.divmod(numbers, nx)
    z, y = np.divmod(rows, ny)
    return np.unique(base.numbers(np.stack([x, y, z], axis=1) >> np.uint64(1), level - 1))
