"""Data that names instead of measuring: whole numbers, each of which stands for a thing."""

from __future__ import annotations

import numpy as np

from ..expressions import Expression
from ..volume import Volume
from .samples import pieces

_MOST = 64
# Labels are counted through: values with wider gaps are coarsely measured numbers.
_SPAN = 2


def labels_of(volume: Volume, expr: Expression, values: np.ndarray) -> np.ndarray | None:
    """Return the labels in a volume, without the one around them; None if it holds no labels.

    Labels are at least two and at most 64 whole numbers that fill more than half of their range.
    What the outermost cells hold most is the background.

    Parameters
    ----------
    volume : Volume
        All of it is looked at if its samples look like labels: some things are small.
    expr : Expression
        The scalar.
    values : array
        Samples of it, sorted.
    """
    if not _may_be_labels(np.unique(values)):
        return None
    found: set[float] = set()
    around: dict[float, int] = {}
    for piece in pieces(volume, expr, np.inf):
        found.update(np.unique(piece.x[~np.isnan(piece.x)]).tolist())
        if not _may_be_labels(np.array(sorted(found))):
            return None
        outermost = piece.outermost()
        _count(around, outermost[~np.isnan(outermost)])
    background = max(around, key=lambda label: (around[label], -label), default=None)
    if len(found) < 2 or max(found) - min(found) >= _SPAN * len(found):
        return None
    return np.array(sorted(found - {background}))


def _may_be_labels(values: np.ndarray) -> bool:
    """Return False if these sorted, distinct numbers, or more of them, cannot be labels."""
    whole = bool(np.all(values == np.round(values)))
    return whole and len(values) <= _MOST and bool(np.ptp(values) < _SPAN * _MOST)


def _count(counts: dict[float, int], values: np.ndarray) -> None:
    for value, number in zip(*np.unique(values, return_counts=True), strict=True):
        counts[float(value)] = counts.get(float(value), 0) + int(number)
