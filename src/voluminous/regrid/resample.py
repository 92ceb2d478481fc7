"""Means of fields over the cells of another grid."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from ..errors import InputError, UnitsError
from ..geometry import CARTESIAN
from ..memory import check_memory
from ..units import is_count, shown, unit_name
from .boxes import Overlap, overlaps
from .plane import MOST
from .samples import points_in, sampled_overlaps
from .separable import axis_means

# Rounding of a volume that is covered entirely.
_COVERED = 1e-9


def resampled(
    fields: Mapping[str, np.ndarray], source: Any, target: Any, fill: float, samples: int
) -> dict[str, np.ndarray]:
    """Return fields on another grid; see `Volume.resample`.

    Parameters
    ----------
    fields : mapping of str to array
        Of the source's shape.
    source, target : grids
    fill : float
        The value outside the source.
    samples : int
        Points per axis and cell, where cells are no boxes.
    """
    _check(source, target, samples)
    size = 8 * (len(fields) + 4) * target.size
    check_memory(size, "fields on another grid", "take fewer fields, or a coarser grid")
    holed = {name: v for name, v in fields.items() if v.dtype.kind == "f" and np.isnan(v).any()}
    rest = {name: v for name, v in fields.items() if name not in holed}
    found = _means(rest, source, target, fill, samples) if rest else {}
    found |= {n: _known_means(v, source, target, fill, samples) for n, v in holed.items()}
    return {name: found[name] for name in fields}


def _known_means(
    values: np.ndarray, source: Any, target: Any, fill: float, samples: int
) -> np.ndarray:
    """Return means over what is known (not NaN); NaN where that is less than half."""
    known = ~np.isnan(values)
    parts = {"sum": np.where(known, values, 0.0), "known": known, "there": np.ones(known.shape)}
    found = _means(parts, source, target, 0.0, samples)
    enough = found["known"] >= 0.5 * found["there"]
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(found["known"] > 0, found["sum"] / found["known"], 0.0)
    total = mean * found["there"] + _share(fill, _without(found["there"]))
    return np.where(enough, total, np.nan)


def _means(
    fields: Mapping[str, np.ndarray], source: Any, target: Any, fill: float, samples: int
) -> dict[str, np.ndarray]:
    if not (_is_boxes(source) and _is_boxes(target)):
        return _sampled(fields, source, target, fill, samples)
    if len(source.shape) == len(target.shape) == 3:
        ones = axis_means(np.ones(source.shape), source, target)
        return {
            name: axis_means(_double(values), source, target) + _share(fill, _without(ones))
            for name, values in fields.items()
        }
    volumes = target.cell_volumes
    sums, shared = _sums(fields, target, _box_overlaps(source, target))
    empty = _share(fill, _without(shared / volumes))
    return {name: total / volumes + empty for name, total in sums.items()}


def _sampled(
    fields: Mapping[str, np.ndarray], source: Any, target: Any, fill: float, samples: int
) -> dict[str, np.ndarray]:
    overlapping = sampled_overlaps if source.cells_are_boxes else _located
    sums, shared = _sums(fields, target, overlapping(source, target, samples))
    inside = _inside(source, target, samples)
    met = shared > 0
    nearest = source.locate(np.ascontiguousarray(target.cell_centers(0, target.size).T))
    nearest = nearest.reshape(target.shape)
    found = {}
    for name, total in sums.items():
        mean = np.where(nearest >= 0, _double(fields[name]).reshape(-1)[nearest], fill)
        mean[met] = total[met] / shared[met]
        found[name] = np.where(inside > 0, inside * mean, 0.0) + _share(fill, 1.0 - inside)
    return found


def _sums(
    fields: Mapping[str, np.ndarray], target: Any, found: Iterator[Overlap]
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Return the integrals of fields over target cells, and the volumes that were met."""
    flat = {name: values.reshape(-1) for name, values in fields.items()}
    sums = {name: np.zeros(target.size) for name in fields}
    shared = np.zeros(target.size)
    for own, into, volume in found:
        np.add.at(shared, into, volume)
        for name, values in flat.items():
            np.add.at(sums[name], into, values[own] * volume)
    return {n: total.reshape(target.shape) for n, total in sums.items()}, shared.reshape(
        target.shape
    )


def _box_overlaps(source: Any, target: Any) -> Iterator[Overlap]:
    """Yield what cells share. Those are cut that are smaller, or whose grid has holes."""
    if _has_holes(source) or (source.size > target.size and not _has_holes(target)):
        yield from overlaps(source, target)
        return
    for into, own, volume in overlaps(target, source):
        yield own, into, volume


def _inside(source: Any, target: Any, samples: int) -> np.ndarray:
    inside = np.zeros(target.size)
    for cell, points, volume in points_in(target, samples):
        np.add.at(inside, cell, np.where(source.locate(points) >= 0, volume, 0.0))
    part: np.ndarray = inside.reshape(target.shape) / target.cell_volumes
    return np.where(part > 1.0 - _COVERED, 1.0, part)


def _without(part: np.ndarray) -> np.ndarray:
    rest = 1.0 - part
    return np.where(rest > _COVERED, rest, 0.0)


def _share(fill: float, rest: np.ndarray) -> np.ndarray:
    """Return what the value outside adds: nothing where no part is outside, even if it is NaN."""
    return np.where(rest > 0.0, fill * rest, 0.0)


def _is_boxes(grid: Any) -> bool:
    return grid.cells_are_boxes and tuple(grid.coordinates) == CARTESIAN


def _located(source: Any, target: Any, samples: int) -> Iterator[Overlap]:
    """Yield the cells of the source at points in those of the target."""
    for into, points, volume in points_in(target, samples):
        own = source.locate(points)
        there = own >= 0
        yield own[there], into[there], volume[there]


def _has_holes(grid: Any) -> bool:
    box = float(np.prod(np.ptp(grid.bounds, axis=1)))
    return float(np.sum(grid.cell_volumes)) < (1.0 - _COVERED) * box


def _double(values: np.ndarray) -> np.ndarray:
    return np.asarray(values, dtype=np.float64)


def _check(source: Any, target: Any, samples: Any) -> None:
    if not hasattr(target, "locate"):
        raise InputError(f"resample needs a grid such as vm.CartesianGrid, got {target!r}")
    if not target.cells_are_boxes:
        raise InputError(
            f"fields cannot be resampled onto a {type(target).__name__}, whose cells are no boxes"
        )
    if not is_count(samples, MOST):
        raise InputError(f"samples must be a positive whole number, got {shown(samples)}")
    if source.unit != target.unit:
        names = [unit_name(grid.unit) or "no unit" for grid in (target, source)]
        raise UnitsError(
            f"the new grid's lengths are in {names[0]}, the volume's in {names[1]}; make the grid "
            "in the volume's unit"
        )
    (low, high), (first, last) = source.bounds.T, target.bounds.T
    if np.any(np.maximum(low, first) >= np.minimum(high, last)):
        told = [" x ".join(f"{a:g} … {b:g}" for a, b in g.bounds) for g in (target, source)]
        raise InputError(
            f"the new grid, {told[0]}, is nowhere in the volume, {told[1]}; compare their bounds"
        )
