"""Blocks that guaranteed bounds may leap over, and what can be in them after all."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...expressions.interval import Interval
from ...media.contract import Medium
from ...media.ranges import RangeContext
from ..coefficients.classify import Classifier
from .blocks import DUAL, worthwhile_blocks

# Coefficients below this part of what matters count as none; a bound of them is added in the end.
_FAINT = 1e-6
# Below this part of their peak, shells are not looked for at all: less than any rounding.
_NOTHING = 1e-300


@dataclass
class Neglected:
    """What rays may miss in all, by leaping: emission per channel, and optical depth."""

    emission: np.ndarray
    depth: float


def empty_blocks(
    classifier: Classifier, ranges: dict[str, Interval], tolerance: float
) -> tuple[Any, Neglected]:
    """Return blocks to leap over, None if there are few empty ones, and what is missed by that.

    Parameters
    ----------
    ranges : dict of str to Interval
        The values of all fields in each block.
    tolerance : float
        How wide brackets may be, as a fraction of the brightest pixel.
    """
    volume, grid = classifier.volume, classifier.grid
    if not grid.has_blocks:
        return None, Neglected(np.zeros(classifier.medium.channels), 0.0)
    shape = DUAL.shape(grid.shape)
    context = RangeContext(volume.unit, volume.expression_unit, _NOTHING)
    with np.errstate(all="ignore"):
        emission, depth = _largest(classifier.medium, ranges, context, shape)
    diagonal = float(np.linalg.norm(np.ptp(grid.bounds, axis=1)))
    bright = np.where(np.isfinite(emission), emission, 0.0).max()
    # The brightest pixel may be much fainter than a path across the volume at its brightest place.
    seen = (emission.max(axis=0) > _FAINT**2 * tolerance * bright) | (
        depth * diagonal > _FAINT * tolerance
    )
    blocks = worthwhile_blocks(seen, classifier.backend, DUAL)
    if blocks is None:
        return None, Neglected(np.zeros(len(emission)), 0.0)
    missed = np.where(seen, 0.0, emission).max(axis=(1, 2, 3)) * diagonal
    return blocks, Neglected(missed, float(np.where(seen, 0.0, depth).max() * diagonal))


def _largest(
    medium: Medium, ranges: dict[str, Interval], context: RangeContext, shape: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray]:
    emission, depth = np.zeros((medium.channels, *shape)), np.zeros(shape)
    for part in medium.components():
        found = part.largest(ranges, context)
        j, alpha = (
            np.array([np.broadcast_to(most, shape) for most in values])
            for values in (found.emissivity, found.extinction)
        )
        emission, depth = emission + j, depth + alpha.max(axis=0)
    return emission, depth
