"""Walks through trees from which what shows nothing is left out: rays cross it in one step."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...expressions.interval import Interval
from ...media.ranges import RangeContext
from ..coefficients.classify import Classifier
from ..interpolants.lattice import Octets

# The part of all leaves that may be visible for that to pay: where it is a tenth, the larger leaves
# around are crossed as fast (half a million leaves, a thin shell: 39 instead of 44 ms).
_WORTHWHILE = 0.05
# Leaves looked at at once.
_CHUNK = 1 << 20


def pruned_walk(grid: Any, visible: np.ndarray, backend: Any, kind: str) -> Any:
    """Return a walk through the leaves that are visible, or None if most of them are."""
    if np.count_nonzero(visible) > _WORTHWHILE * len(visible):
        return None
    return grid.walk_through(grid.pruned(visible), backend, kind)


def can_be_pruned(classifier: Classifier) -> bool:
    """Return whether leaves can be left out, and their fields' ranges tell which."""
    names = classifier.medium.names
    fields = all(name in classifier.volume for name in names)
    return bool(classifier.grid.can_be_pruned) and fields


def tabled(table: Any, faint: float) -> np.ndarray:
    """Return which leaves have coefficients above a part of their peak, from a table of all."""
    visible: Any = False
    position = 0
    for data, width in zip(table.packets, table.widths, strict=True):
        numbers = np.asarray(data).reshape(-1, width)
        for k in range(width):
            visible = visible | (np.abs(numbers[:, k]) > faint * table.largest[position + k])
        position += width
    return np.asarray(visible)


def interpolated(classifier: Classifier, octets: dict[str, Octets], faint: float) -> np.ndarray:
    """Return which leaves may show something between the values at their corners."""
    volume = classifier.volume
    context = RangeContext(volume.unit, volume.expression_unit, faint)
    visible = np.empty(volume.grid.size, bool)
    values = {name: (np.asarray(o.data).reshape(-1, 8), o.unit) for name, o in octets.items()}
    for first in range(0, len(visible), _CHUNK):
        part = slice(first, first + _CHUNK)
        ranges = {name: _range(v[part], unit) for name, (v, unit) in values.items()}
        with np.errstate(all="ignore"):
            visible[part] = classifier.medium.visible_in(ranges, context)
    return visible


def _range(corners: np.ndarray, unit: float) -> Interval:
    low = corners[:, 0].astype(np.float64)
    high = low.copy()
    for k in range(1, 8):
        np.minimum(low, corners[:, k], out=low)
        np.maximum(high, corners[:, k], out=high)
    return Interval(low * unit, high * unit)
