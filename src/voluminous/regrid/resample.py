"""Means of fields over the cells of another grid.

Cells that are boxes are intersected exactly. A box that is not inside one cell of the other grid is
cut along the walls of the cell that holds its centre: the part inside is done, and up to six
smaller boxes remain. All boxes are cut at once, so that the number of rounds grows with the
logarithm of the number of cells that a box overlaps.

Cells of other shapes are sampled by points. Where the cells of one grid are the smaller ones, its
points are used, and elsewhere those of the other: each region of space counts once, and no cell is
too small to be sampled.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError, UnitsError
from ..geometry import CARTESIAN, metric, mirror_images, position
from ..grids.contract import BoxGrid, native_centers
from ..memory import check_memory
from ..progress import progress_bar, reported_range, silent
from ..units import is_count, plain, shown, unit_name
from .slices import MOST
from .table import named_fields

if TYPE_CHECKING:
    from ..grids.contract import Grid

# Boxes per chunk.
_CHUNK = 1 << 18
# In cell widths: thinner slices result from rounding of coincident walls.
_SLIVER = 1e-13
# Relative rounding error of a wall's coordinate.
_ROUNDING = 8 * np.finfo(np.float64).eps
# Most halvings of a box whose centre is in a hole of the other grid.
_HALVINGS = 12

Overlap = tuple[np.ndarray, np.ndarray, np.ndarray]


@dataclass
class BoxPieces:
    """Boxes to cut: their cells, corners (3, n), smallest widths (3, n) and halvings so far."""

    owner: np.ndarray
    low: np.ndarray
    high: np.ndarray
    thin: np.ndarray
    halved: np.ndarray

    def chosen(self, which: Any) -> BoxPieces:
        """Return the boxes selected by an index."""
        return BoxPieces(
            self.owner[which],
            self.low[:, which],
            self.high[:, which],
            self.thin[:, which],
            self.halved[which],
        )

    def between(self, axis: int, low: np.ndarray, high: np.ndarray) -> BoxPieces:
        """Return boxes cut to an interval along an axis, without those that are too thin."""
        new = replace(self, low=self.low.copy(), high=self.high.copy())
        new.low[axis], new.high[axis] = low, high
        return new.chosen(high - low > self.thin[axis])


def overlaps(cells: Grid, others: Grid, whole: Grid | None = None) -> Iterator[Overlap]:
    """Yield the overlaps of the cells of a grid, or of a part of a `whole`, with another's."""
    centers, half = others.cell_centers(0, others.size), 0.5 * others.cell_sizes(0, others.size)
    for first in reported_range(cells.size, _CHUNK):
        target = _boxes(cells, first, min(first + _CHUNK, cells.size), whole or cells)
        waiting = [_clipped(target, others.bounds)]
        while waiting:
            boxes = waiting.pop()
            for start in range(0, len(boxes.owner), _CHUNK):
                part = boxes.chosen(slice(start, start + _CHUNK))
                other = others.locate(np.ascontiguousarray((0.5 * (part.low + part.high)).T))
                waiting += _halves(part.chosen((other < 0) & (part.halved < _HALVINGS)))
                part, other = part.chosen(other >= 0), other[other >= 0]
                floor = np.maximum(part.low, centers[:, other] - half[:, other])
                ceiling = np.minimum(part.high, centers[:, other] + half[:, other])
                yield part.owner, other, np.prod(ceiling - floor, axis=0)
                waiting += _left_over(part, floor, ceiling)


def _boxes(cells: Grid, first: int, last: int, whole: Grid) -> BoxPieces:
    middle, half = cells.cell_centers(first, last), 0.5 * cells.cell_sizes(first, last)
    rounding = _ROUNDING * np.max(np.abs(whole.bounds), axis=1)[:, None]
    thin = np.maximum(2 * _SLIVER * half, rounding)
    owner = np.arange(first, last)
    return BoxPieces(owner, middle - half, middle + half, thin, np.zeros(last - first, int))


def _clipped(boxes: BoxPieces, bounds: np.ndarray) -> BoxPieces:
    for axis in range(3):
        low = np.maximum(boxes.low[axis], bounds[axis, 0])
        boxes = boxes.between(axis, low, np.minimum(boxes.high[axis], bounds[axis, 1]))
    return boxes


def _left_over(boxes: BoxPieces, floor: np.ndarray, ceiling: np.ndarray) -> list[BoxPieces]:
    found = []
    for axis in range(3):
        found.append(boxes.between(axis, boxes.low[axis], floor[axis]))
        found.append(boxes.between(axis, ceiling[axis], boxes.high[axis]))
        boxes = replace(boxes, low=boxes.low.copy(), high=boxes.high.copy())
        boxes.low[axis], boxes.high[axis] = floor[axis], ceiling[axis]
    found = [boxes for boxes in found if len(boxes.owner)]
    return [_joined(found)] if found else []


def _halves(boxes: BoxPieces) -> list[BoxPieces]:
    if not len(boxes.owner):
        return []
    width = boxes.high - boxes.low
    long = np.argmax(width, axis=0)
    middle = 0.5 * (boxes.low + boxes.high)
    cut = np.arange(3)[:, None] == long
    halved = boxes.halved + 1
    lower = replace(boxes, high=np.where(cut, middle, boxes.high), halved=halved)
    upper = replace(boxes, low=np.where(cut, middle, boxes.low), halved=halved)
    return [lower, upper]


def _joined(parts: list[BoxPieces]) -> BoxPieces:
    return BoxPieces(
        np.concatenate([p.owner for p in parts]),
        np.concatenate([p.low for p in parts], axis=1),
        np.concatenate([p.high for p in parts], axis=1),
        np.concatenate([p.thin for p in parts], axis=1),
        np.concatenate([p.halved for p in parts]),
    )


# Sampling points per chunk.
_SAMPLES_CHUNK = 1 << 20
# The angle per sampling point is at most this over the number of points per axis, because cells may
# go all around. On an axisymmetric grid the integral of a wedge had an error of 30 % with four
# points all around, and of 0.5 % with a 64th of the circle per point.
_ANGLE = np.pi / 8.0


def sampled_overlaps(cells: Grid, others: Grid, count: int) -> Iterator[Overlap]:
    """Yield estimated overlaps of the cells of two grids, from count³ points or more per cell."""
    yield from _smaller(cells, others, count, equal=True)
    for other, cell, volume in _smaller(others, cells, count, equal=False):
        yield cell, other, volume


def _smaller(cells: Grid, others: Grid, count: int, *, equal: bool) -> Iterator[Overlap]:
    """Yield overlaps where the cells are smaller than the others, or with `equal` as large."""
    ours, theirs = (grid.cell_volumes.reshape(-1) for grid in (cells, others))
    for cell, points, volume in points_in(cells, count):
        other = others.locate(points)
        small = ours[cell] <= theirs[other] if equal else ours[cell] < theirs[other]
        counts = (other >= 0) & small
        yield cell[counts], other[counts], volume[counts]


def points_in(grid: Grid, count: int) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Yield points spread evenly in the cells of a grid."""
    volumes, images = grid.cell_volumes.reshape(-1), mirror_images(grid)
    counts = points_along(grid, count)
    steps = [(np.arange(n) + 0.5) / n - 0.5 for n in counts]
    offsets = np.array(np.meshgrid(*steps, indexing="ij")).reshape(3, 1, -1)
    step = max(1, _SAMPLES_CHUNK // (offsets.shape[2] * len(images)))
    for first in reported_range(grid.size, step):
        last = min(first + step, grid.size)
        within, weight = _within(grid, offsets, first, last)
        share = weight / weight.sum(axis=1, keepdims=True) * volumes[first:last, None]
        points = position(tuple(grid.coordinates), within.reshape(3, -1)).T
        cell = np.repeat(np.arange(first, last), offsets.shape[2])
        for image in images:
            yield cell, np.ascontiguousarray(points * image), share.ravel() / len(images)


def points_along(grid: Any, count: int) -> list[int]:
    """Return the number of points along each axis of a cell: more along wide angles."""
    widths = [0.0, 0.0, 0.0]
    for axis, edges in enumerate(getattr(grid, "edges", ())):  # trees of boxes have none
        if grid.coordinates[axis] in ("theta", "phi"):
            widths[axis] = np.diff(edges).max()
    return [max(count, math.ceil(width * count / _ANGLE - 1e-9)) for width in widths]


def _within(
    grid: Grid, offsets: np.ndarray, first: int, last: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the grid coordinates (3, n, m) of points in cells, and Jacobians (n, m)."""
    system = tuple(grid.coordinates)
    centers = native_centers(grid, first, last)
    widths = grid.cell_sizes(first, last) / metric(system, centers)
    points = centers[..., None] + widths[..., None] * offsets
    return points, np.prod(metric(system, points.reshape(3, -1)), axis=0).reshape(points.shape[1:])


def axis_means(values: np.ndarray, source: Any, target: Any) -> np.ndarray:
    """Return the integral over each target cell divided by its volume; zero outside."""
    for axis, (old, new) in enumerate(zip(source.edges, target.edges, strict=True)):
        values = np.moveaxis(_means(np.moveaxis(values, axis, 0), old, new), 0, axis)
    return np.ascontiguousarray(values)


def _means(values: np.ndarray, old: np.ndarray, new: np.ndarray) -> np.ndarray:
    out = np.zeros((len(new) - 1, *values.shape[1:]))
    walls = np.union1d(old, new)
    walls = walls[(walls >= max(old[0], new[0])) & (walls <= min(old[-1], new[-1]))]
    if len(walls) < 2:
        return out
    middle = 0.5 * (walls[1:] + walls[:-1])
    source_cell, into = (np.searchsorted(e, middle, "right") - 1 for e in (old, new))
    part = np.diff(walls) / np.diff(new)[into]
    weighted = values[source_cell] * part.reshape(-1, *[1] * (values.ndim - 1))
    cells, starts = np.unique(into, return_index=True)
    out[cells] = np.add.reduceat(weighted, starts, axis=0)
    return out


# Cells of a volume that are read at once, to make a box of another grid's.
_AT_ONCE = 1 << 22
# Relative rounding error of the covered part of a volume.
_COVERED = 1e-9


def resampled(
    fields: Mapping[str, np.ndarray],
    source: Grid,
    target: Grid,
    fill: float,
    samples: int,
    whole: Grid | None = None,
) -> dict[str, np.ndarray]:
    """Return fields on another grid, or on a part of a `whole`; see `Volume.resample`."""
    size = 8 * (len(fields) + 4) * target.size
    check_memory(size, "fields on another grid", "take fewer fields, or a coarser grid")
    holed = {name: v for name, v in fields.items() if v.dtype.kind == "f" and np.isnan(v).any()}
    rest = {name: v for name, v in fields.items() if name not in holed}
    others = (source, target, fill, samples, whole)
    found = _resample_means(rest, *others) if rest else {}
    found |= {name: _known_means(values, *others) for name, values in holed.items()}
    return {name: found[name] for name in fields}


def _known_means(
    values: np.ndarray,
    source: Grid,
    target: Grid,
    fill: float,
    samples: int,
    whole: Grid | None,
) -> np.ndarray:
    """Return means over the valid part (not NaN) of each cell; NaN where it is below half."""
    known = ~np.isnan(values)
    parts = {"sum": np.where(known, values, 0.0), "known": known, "there": np.ones(known.shape)}
    found = _resample_means(parts, source, target, 0.0, samples, whole)
    enough = found["known"] >= 0.5 * found["there"]
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(found["known"] > 0, found["sum"] / found["known"], 0.0)
    total = mean * found["there"] + _share(fill, _without(found["there"]))
    return np.where(enough, total, np.nan)


def _resample_means(
    fields: Mapping[str, np.ndarray],
    source: Grid,
    target: Grid,
    fill: float,
    samples: int,
    whole: Grid | None,
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
    found = _box_overlaps(source, target) if whole is None else _ordered(source, target, whole)
    sums, shared = _sums(fields, target, found)
    empty = _share(fill, _without(shared / volumes))
    return {name: total / volumes + empty for name, total in sums.items()}


def _sampled(
    fields: Mapping[str, np.ndarray], source: Grid, target: Grid, fill: float, samples: int
) -> dict[str, np.ndarray]:
    overlapping = sampled_overlaps if isinstance(source, BoxGrid) else _located
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
    fields: Mapping[str, np.ndarray], target: Grid, found: Iterator[Overlap]
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    flat = {name: values.reshape(-1) for name, values in fields.items()}
    sums = {name: np.zeros(target.size) for name in fields}
    shared = np.zeros(target.size)
    for source_cell, into, volume in found:
        np.add.at(shared, into, volume)
        for name, values in flat.items():
            np.add.at(sums[name], into, values[source_cell] * volume)
    return {n: total.reshape(target.shape) for n, total in sums.items()}, shared.reshape(
        target.shape
    )


def _box_overlaps(source: Grid, target: Grid) -> Iterator[Overlap]:
    if _has_holes(source) or (source.size > target.size and not _has_holes(target)):
        yield from overlaps(source, target)
        return
    for into, source_cell, volume in overlaps(target, source):
        yield source_cell, into, volume


def _ordered(source: Grid, target: Grid, whole: Grid) -> Iterator[Overlap]:
    waiting: list[Overlap] = []

    def in_order() -> Overlap:
        into, source_cell, volume = (np.concatenate(parts) for parts in zip(*waiting, strict=True))
        order = np.lexsort((volume, source_cell, into))
        return source_cell[order], into[order], volume[order]

    for found in overlaps(target, source, whole):
        # Cells come so many at a time, all that is in them one after another.
        if waiting and len(found[0]) and found[0][0] // _CHUNK != waiting[0][0][0] // _CHUNK:
            yield in_order()
            waiting.clear()
        if len(found[0]):
            waiting.append(found)
    if waiting:
        yield in_order()


def _inside(source: Grid, target: Grid, samples: int) -> np.ndarray:
    inside = np.zeros(target.size)
    for cell, points, volume in points_in(target, samples):
        np.add.at(inside, cell, np.where(source.locate(points) >= 0, volume, 0.0))
    part: np.ndarray = inside.reshape(target.shape) / target.cell_volumes
    return np.where(part > 1.0 - _COVERED, 1.0, part)


def _without(part: np.ndarray) -> np.ndarray:
    rest = 1.0 - part
    return np.where(rest > _COVERED, rest, 0.0)


def _share(fill: float, rest: np.ndarray) -> np.ndarray:
    """Return the contribution of the outside value: zero if no part is outside, even for NaN."""
    return np.where(rest > 0.0, fill * rest, 0.0)


def _is_boxes(grid: Grid) -> bool:
    return isinstance(grid, BoxGrid) and tuple(grid.coordinates) == CARTESIAN


def _located(source: Grid, target: Grid, samples: int) -> Iterator[Overlap]:
    for into, points, volume in points_in(target, samples):
        number = source.locate(points)
        there = number >= 0
        yield number[there], into[there], volume[there]


def _has_holes(grid: Grid) -> bool:
    box = float(np.prod(np.ptp(grid.bounds, axis=1)))
    return float(np.sum(grid.cell_volumes)) < (1.0 - _COVERED) * box


def _double(values: np.ndarray) -> np.ndarray:
    return np.asarray(values, dtype=np.float64)


def _check(source: Grid, target: Grid, samples: Any) -> None:
    if not hasattr(target, "locate"):
        raise InputError(f"resample needs a grid such as vm.CartesianGrid, got {target!r}")
    if not isinstance(target, BoxGrid):
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
        wanted, there = (
            " x ".join(f"{a:g} … {b:g}" for a, b in g.bounds) for g in (target, source)
        )
        raise InputError(
            f"the new grid, {wanted}, is nowhere in the volume, {there}; compare their bounds"
        )


def resampled_volume(
    volume: Any, grid: Grid, fields: Iterable[str] | None, fill: Any, samples: int, later: Any
) -> Any:
    """Return a volume on another grid; see `Volume.resample`.

    With a function `later` fields are what it makes of their type, and of how boxes are made.
    """
    names, fill = named_fields(volume, fields), _number(fill)
    _check(volume.grid, grid, samples)
    other = type(volume)(grid)
    if later is not None:
        _check_in_boxes(volume.grid, grid)
        for name in names:
            single = volume.describe()["fields"][name]["dtype"] == "float32"
            read = functools.partial(_box, volume, name, grid, fill)
            other[name] = later(read, np.dtype(np.float32 if single else np.float64), grid.shape)
    else:
        values = {name: volume.array(name) for name in names}
        means = resampled(values, volume.grid, grid, fill, samples)
        for name in names:
            single = values[name].dtype == np.float32
            other[name] = means[name].astype(np.float32) if single else means[name]
    for name in names:
        other.set_unit(name, volume.field_unit(name))
    other.meta |= meta_on(volume, grid)
    return other


def _check_in_boxes(source: Grid, target: Grid) -> None:
    if not (_is_boxes(source) and _is_boxes(target)) or len(target.shape) != 3:
        raise InputError(
            "deferred=True needs cells that are boxes along x, y and z, and a vm.CartesianGrid for "
            f"the new ones, got {type(source).__name__} and {type(target).__name__}"
        )
    if len(source.shape) != 3 and _has_holes(source):
        raise InputError("deferred=True needs a volume without holes between its cells")


def _box(
    volume: Any,
    name: str,
    grid: Grid,
    fill: float,
    low: Sequence[int],
    high: Sequence[int],
    level: int = 0,
) -> np.ndarray:
    """Return the cells ``low <= i < high`` of a field on another grid."""
    part = _part(grid, low, high)
    first, last = low, high  # of the cells of the volume
    if len(volume.grid.shape) == 3:
        first, last = _met(volume.grid, part)
        wide = [
            b - a if m - k > 1 else 0 for a, b, k, m in zip(first, last, low, high, strict=True)
        ]
        if math.prod(b - a for a, b in zip(first, last, strict=True)) > _AT_ONCE and any(wide):
            axis = int(np.argmax(wide))
            middle = [*high], [*low]
            middle[0][axis] = middle[1][axis] = (low[axis] + high[axis]) // 2
            halves = (low, middle[0]), (middle[1], high)
            return np.concatenate([_box(volume, name, grid, fill, *h) for h in halves], axis)
        values, source = volume.store.read(name, first, last), _part(volume.grid, first, last)
    else:
        values, source = volume.array(name), volume.grid
    with progress_bar(silent):
        made: np.ndarray = resampled({name: values}, source, part, fill, 1, grid)[name]
    return made.astype(np.float32) if values.dtype == np.float32 else made


def _part(grid: Any, low: Sequence[int], high: Sequence[int]) -> Grid:
    edges = (e[a : b + 1] for e, a, b in zip(grid.edges, low, high, strict=True))
    made: Any = type(grid)
    part: Grid = made(*edges, unit=grid.unit)
    return part


def _met(source: Any, part: Any) -> tuple[list[int], list[int]]:
    first, last = [], []
    for old, new in zip(source.edges, part.edges, strict=True):
        start = min(max(int(np.searchsorted(old, new[0], "right")) - 1, 0), len(old) - 2)
        first.append(start)
        end = int(np.searchsorted(old, new[-1], "left"))
        last.append(min(max(end, start + 1), len(old) - 1))
    return first, last


def meta_on(volume: Any, grid: Grid) -> dict[str, Any]:
    """Return the metadata of a volume that are true on another grid."""
    meta = dict(volume.meta)
    old, new = (np.mean(g.bounds, axis=1) for g in (volume.grid, grid))
    if "direction" in meta and not np.allclose(old, new, rtol=0, atol=1e-9 * volume.grid.scale):
        # Turned about the centre of the scan, whatever part of it this is.
        meta.setdefault("direction_center", old.tolist())
    return meta


def _number(fill: Any) -> float:
    number = None if fill is None else plain(fill, None, "fill")
    if not isinstance(number, float):
        raise InputError(f"fill must be one number, got {shown(fill)}")
    return number
