"""Which part of each cell is measured: where a condition holds, and inside of a region."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from numbers import Integral
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError
from ..expressions import Expression
from ..expressions.interval_ops import IntervalOps
from ..geometry import CARTESIAN, metric, mirror_images, position
from ..regions import Region
from ..regrid.resample import points_along
from ..rendering.cache import VolumeStatistics
from .quantity import CellQuantity

if TYPE_CHECKING:
    from ..grids.contract import Grid
    from ..volume import Volume

# Cells looked at at once.
_CHUNK = 1 << 20


def with_known(volume: Volume, expressions: Sequence[Expression]) -> tuple[Any, list[Expression]]:
    """Return a volume, and expressions of its fields that have a value wherever these have one.

    An expression that has none in some cells, such as ``log10(a)`` where a is negative, becomes a
    field that lacks it there: what is missing in fields counts nothing along rays.
    """
    arrays: dict[str, np.ndarray] = {}
    found = []
    for expression in expressions:
        values = None if _defined(volume, expression) else _lacking(volume, expression)
        if values is None:
            found.append(expression)
            continue
        name = _free_name(volume, len(arrays))
        arrays[name] = values
        found.append(Expression(name))
    return (_with_fields(volume, arrays) if arrays else volume), found


def check_finite(values: np.ndarray, expression: Expression, first: int, grid: Grid) -> None:
    """Refuse a quantity that is infinite in one of consecutive cells."""
    infinite = np.flatnonzero(np.isinf(values))
    if infinite.size:
        place = np.unravel_index(first + int(infinite[0]), grid.shape)
        raise InputError(
            f"{expression.text!r} is infinite in cells, the first of which is "
            f"{tuple(int(i) for i in place)}: leave them out, where(…, …, 0), or have them missing "
            "(NaN)"
        )


def _defined(volume: Volume, expression: Expression) -> bool:
    """Return whether the ranges of the fields alone say that it is finite everywhere."""
    if not expression.partial:
        return True
    with np.errstate(all="ignore"):
        statistics = VolumeStatistics(volume)
        fields = {name: statistics.range_of(name) for name in expression.names}
        ops = IntervalOps()
        range_ = ops.number(expression.evaluate(ops, fields))
    return bool(np.isfinite(range_.lo) & np.isfinite(range_.hi))


def _lacking(volume: Volume, expression: Expression) -> np.ndarray | None:
    values = np.concatenate(list(_pieces(volume, expression)))
    unknown = np.isnan(values)
    if unknown.all():
        raise InputError(f"{expression.text!r} has no value in any cell")
    return values.reshape(volume.grid.shape) if unknown.any() else None


def _pieces(volume: Volume, expression: Expression) -> Iterator[np.ndarray]:
    size = volume.grid.size
    for first in range(0, size, _CHUNK):
        last = min(first + _CHUNK, size)
        values = volume.evaluate_cells(expression, first, last, double=True)
        check_finite(values, expression, first, volume.grid)
        yield np.asarray(values, np.float64)


def _free_name(volume: Volume, number: int) -> str:
    name = f"quantity_{number}"
    while name in volume:
        name += "_"
    return name


def _with_fields(volume: Volume, arrays: dict[str, np.ndarray]) -> Any:
    other = volume.with_arrays(arrays)
    for name in arrays:
        other.set_unit(name, None)
    return other


def condition(volume: Volume, text: Any, what: str = "where") -> CellQuantity:
    """Return a condition, an expression that is zero where it does not hold."""
    return CellQuantity.of(volume, text, what)


def holds(volume: Volume, what: CellQuantity, first: int, last: int) -> Any:
    """Return in which cells a condition holds; not where it has no value."""
    values = volume.evaluate_cells(what.expression, first, last)
    return (values != 0) & (values == values)


# Cells looked at at once.
CHUNK = 1 << 18
# Of a cell that is inside entirely the parts need not add up to one.
_ROUNDING = 1e-12


class CellParts:
    """The part of each cell that is measured."""

    def __init__(self, volume: Volume, where: Any, region: Region | None, samples: Any) -> None:
        if not isinstance(samples, Integral) or samples < 1:
            raise InputError(f"samples must be a positive whole number, got {samples!r}")
        if region is not None and not volume.grid.cells_are_boxes:
            raise InputError(
                f"a region needs cells that are boxes, got a {type(volume.grid).__name__}; use "
                "where= with coordinates, or volume.resample(grid) first"
            )
        self.volume, self.region, self.samples = volume, region, int(samples)
        self.where = None if where is None else condition(volume, where)

    @property
    def everything(self) -> bool:
        """True if nothing is left out."""
        return self.where is None and self.region is None

    def of(self, first: int, last: int) -> np.ndarray:
        """Return the parts of consecutive cells, from 0 to 1."""
        part = np.ones(last - first)
        if self.where is not None:
            part *= holds(self.volume, self.where, first, last)
        if self.region is not None:
            part *= self._inside(first, last)
        return part

    def whole(self) -> np.ndarray:
        """Return the parts of all cells, of the grid's shape."""
        grid = self.volume.grid
        found = [self.of(a, min(a + CHUNK, grid.size)) for a in range(0, grid.size, CHUNK)]
        return np.concatenate(found).reshape(grid.shape)

    def _inside(self, first: int, last: int) -> np.ndarray:
        assert self.region is not None
        corners = self._tally(first, last, np.arange(last - first), [np.linspace(0, 1, 3)] * 3)
        part = np.round(corners)  # all points inside, or none
        divided = np.flatnonzero(((corners > 0) & (corners < 1)) | self._cut(first, last))
        if divided.size:
            counts = points_along(self.volume.grid, self.samples)
            steps = [(np.arange(n) + 0.5) / n for n in counts]
            part[divided] = self._tally(first, last, divided, steps)
        return part

    def _cut(self, first: int, last: int) -> np.ndarray:
        """Return which cells the region's surface may pass through, between their corners."""
        assert self.region is not None
        grid = self.volume.grid
        centers, reach = np.asarray(grid.cell_centers(first, last)), _reach(grid, first, last)
        found = np.zeros(last - first, dtype=bool)
        for image in mirror_images(grid):
            away = self.region.beyond(centers * image[:, None], grid.unit)
            found |= np.asarray(np.abs(away) < reach)
        return found

    def _tally(
        self, first: int, last: int, cells: np.ndarray, steps: list[np.ndarray]
    ) -> np.ndarray:
        """Return the part that is inside, of points at fractions of cells along each axis."""
        assert self.region is not None
        grid, system = self.volume.grid, tuple(self.volume.grid.coordinates)
        inside, total, images = np.zeros(len(cells)), np.zeros(len(cells)), mirror_images(grid)
        low, size = (a[:, cells] for a in _native_boxes(grid, first, last))
        for place in np.array(np.meshgrid(*steps)).reshape(3, -1).T:
            native = low + place[:, None] * size
            points = position(system, native)
            weight = np.abs(np.prod(metric(system, native), axis=0)) + 1e-300
            total += weight
            for image in images:
                found = self.region.inside(points * image[:, None], grid.unit)
                inside += weight * found / len(images)
        return np.where(inside > (1 - _ROUNDING) * total, 1.0, inside / total)


def _reach(grid: Grid, first: int, last: int) -> np.ndarray:
    half = 0.5 * np.asarray(grid.cell_sizes(first, last))
    if tuple(grid.coordinates) == CARTESIAN:
        return np.asarray(np.linalg.norm(half, axis=0))
    # To any point there is a way along the coordinates one after another, the angles first.
    return np.asarray(half.sum(axis=0))


def _native_boxes(grid: Grid, first: int, last: int) -> tuple[np.ndarray, np.ndarray]:
    low, high = grid.spans(first, last)
    return low, high - low
