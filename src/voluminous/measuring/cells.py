"""Measured quantities: their units and values in cells, and the part of each cell that counts."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from numbers import Integral
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..errors import InputError, UnitsError
from ..expressions import Expression, components, is_dex, without_unit
from ..expressions.interval_ops import IntervalOps
from ..geometry import CARTESIAN, metric, mirror_images, position
from ..grids.contract import BoxGrid
from ..grids.structured import is_structured
from ..large.partition import partition_of
from ..progress import reported_range
from ..regions import Box, Outside, Region, region_on
from ..regrid.resample import points_along
from ..rendering.cache import VolumeStatistics
from ..units import Unit, UnitLike, parse_unit, plain, unit_name

if TYPE_CHECKING:
    from ..grids.contract import CellBox, Grid
    from ..rendering.partition import Partition
    from ..volume import Volume

# Bytes for each cell that is evaluated at once: temporary arrays, and what cells are multiplied by.
_PER_CELL = 320
# The parts of a cell that is entirely inside add up to one only to this.
_ROUNDING = 1e-12


class CellQuantity(NamedTuple):
    """An expression in plain numbers of a volume's fields, and its unit (None: a plain number)."""

    expression: Expression
    unit: Unit
    text: str

    @classmethod
    def of(cls, volume: Volume, expression: Any, what: str = "quantity") -> CellQuantity:
        """Return the quantity of a user's expression; `what` names it in errors."""
        if not isinstance(expression, (str, Expression, int, float)):
            advice = "an array; put it into the volume, volume['name'] = array, and give the name"
            got = advice if isinstance(expression, np.ndarray) else repr(expression)
            raise InputError(
                f"{what} must be a field or an expression such as 'density', got {got}"
            )
        first, *others = components(expression)
        if others:
            raise InputError(f"{what} must be one number per cell, got the vector {expression!r}")
        plain, unit = volume.resolved(first)
        return cls(plain, unit, first.text)

    @property
    def number(self) -> Expression:
        """The quantity divided by its unit: what rays add up."""
        return without_unit(self.expression, self.unit, self.text)


def integral_unit(unit: Unit, length: Unit, power: int = 1) -> tuple[Unit, float]:
    """Return a unit times a power of a length, and the factor that numbers are multiplied by.

    The length is in the unit of length that the first unit contains: g / cm3 along parsecs gives
    g / cm2.
    """
    if is_dex(unit):
        raise UnitsError(
            f"numbers in {unit_name(unit)} depend on the unit of what the logarithm is taken of, "
            "and so does their integral; divide by a number with a unit, as in "
            f"'log10(a / (1 {unit_name(unit.physical_unit)}))'"
        )
    if length is None or unit is None:
        return (unit if length is None else length**power), 1.0
    powers = zip(unit.bases, unit.powers, strict=True)
    inverse = {base: p for base, p in powers if base.physical_type == "length" and p < 0}
    own = min(inverse, key=lambda base: inverse[base]) if inverse else length
    return parse_unit(unit * own**power), float(length.to(own)) ** power


def check_volume(volume: Any) -> None:
    """Refuse anything but a volume."""
    if not hasattr(volume, "seen_by"):
        raise InputError(f"measurements need a Volume first, got {type(volume).__name__}")


class Block(NamedTuple):
    """Cells that are measured together: all, or a part of those of a volume larger than memory."""

    volume: Volume
    # The first cell along each axis, and the ranges of cells that are evaluated at once.
    low: tuple[int, ...]
    ranges: Iterator[tuple[int, int]]


def blocks(
    partition: Partition, names: Iterable[str], step: int, parts: CellParts | None = None
) -> Iterator[Block]:
    """Yield the blocks of a volume with some fields; `step` cells at once.

    Blocks of which no part is measured are left out.
    """
    names, grid, before = tuple(dict.fromkeys(names)), partition.volume.grid, 0

    def ranges(size: int, before: int) -> Iterator[tuple[int, int]]:
        for first in reported_range(size, step, before, grid.size):
            yield first, min(first + step, size)

    for box in partition.blocks_of(names, 8, step * _PER_CELL):
        size = math.prod(b - a for a, b in zip(box.low, box.high, strict=True))
        if parts is None or size == grid.size or not parts.beside(grid, box):
            yield Block(partition.part(box, names), box.low, ranges(size, before))
        before += size


def converted(unit: Unit, wanted: UnitLike, what: str) -> tuple[Unit, float]:
    """Return the unit a user wants, and the factor that converts to it."""
    from astropy import units as u

    if wanted is None:
        return unit, 1.0
    own, target = (u.dimensionless_unscaled if x is None else x for x in (unit, parse_unit(wanted)))
    try:
        return parse_unit(target), float(own.to(target))
    except u.UnitConversionError as error:
        raise UnitsError(
            f"{what} is in {unit_name(own) or 'no unit'}, which is not {wanted}"
        ) from error


def undefined_as_missing(
    volume: Volume, expressions: Sequence[Expression], memory: Any
) -> tuple[Volume, list[Expression]]:
    """Return a volume and expressions of it, undefined values of which are missing.

    An expression that is undefined in some cells, such as ``log10(a)`` where a is negative, becomes
    a field with missing values: along rays these count nothing.
    """
    results = []
    for expression in expressions:
        results.append(expression)
        if _is_finite(volume, expression):
            continue
        name = "quantity"
        while name in volume:
            name += "_"
        other, lacks = partition_of(volume, memory).with_field(name, expression)
        if lacks:
            volume, results[-1] = other, Expression(name)
    return volume, results


def _is_finite(volume: Volume, expression: Expression) -> bool:
    if not expression.partial:
        return True
    with np.errstate(all="ignore"):
        statistics = VolumeStatistics(volume)
        fields = {name: statistics.range_of(name) for name in expression.names}
        ops = IntervalOps()
        range_ = ops.number(expression.evaluate(ops, fields))
    return bool(np.isfinite(range_.lo) & np.isfinite(range_.hi))


class CellParts:
    """The part of each cell that is measured: where a condition holds, and inside a region."""

    def __init__(self, volume: Volume, where: Any, clip: Any, samples: Any) -> None:
        if not isinstance(samples, Integral) or samples < 1:
            raise InputError(f"samples must be a positive whole number, got {samples!r}")
        if clip is not None and not isinstance(volume.grid, BoxGrid):
            raise InputError(
                f"clip= needs cells that are boxes, got a {type(volume.grid).__name__}; use "
                "where= with coordinates, or volume.resample(grid) first"
            )
        self.region = None if clip is None else region_on(clip, volume.grid)
        self.samples = int(samples)
        self.where = None if where is None else CellQuantity.of(volume, where, "where").expression
        self.names = () if self.where is None else self.where.names

    def of(self, volume: Volume, first: int, last: int) -> np.ndarray:
        """Return the parts of consecutive cells of the volume, or of a block, from 0 to 1."""
        part = np.ones(last - first)
        if self.region is not None:
            part *= self._inside(self.region, volume.grid, first, last)
        if self.where is not None and part.any():
            values = volume.evaluate_cells(self.where, first, last)
            part *= (values != 0) & (values == values)  # not where it has no value
        return part

    def _inside(self, region: Region, grid: Grid, first: int, last: int) -> np.ndarray:
        if isinstance(region, Box) and tuple(grid.coordinates) == CARTESIAN and not grid.mirror:
            return _in_box(region, grid, first, last)
        if isinstance(region, Outside):
            return np.asarray(1.0 - self._inside(region.region, grid, first, last))
        part, cut = self._known(region, grid, first, last)
        # Without a bound of the distance corners tell where a surface is.
        near = np.flatnonzero(cut) if region.bounded else np.arange(last - first)
        if near.size:
            corners = _fraction(region, grid, first, last, near, [np.arange(3) / 2] * 3)
            part[near] = np.round(corners)  # all points inside, or none
            divided = near[((corners > 0) & (corners < 1)) | cut[near]]
        if near.size and divided.size:
            counts = points_along(grid, self.samples)
            steps = [(np.arange(n) + 0.5) / n for n in counts]
            part[divided] = _fraction(region, grid, first, last, divided, steps)
        return part

    def _known(
        self, region: Region, grid: Grid, first: int, last: int
    ) -> tuple[np.ndarray, np.ndarray]:
        centers, images = np.asarray(grid.cell_centers(first, last)), mirror_images(grid)
        half = 0.5 * np.asarray(grid.cell_sizes(first, last))
        # Any point can be reached along the coordinates one after another, the angles first.
        cartesian = tuple(grid.coordinates) == CARTESIAN
        reach = np.linalg.norm(half, axis=0) if cartesian else half.sum(axis=0)
        inside, cut = np.zeros(last - first), np.zeros(last - first, bool)
        for image in images:
            points = centers * image[:, None]
            inside += region.inside(points, grid.unit) / len(images)
            cut |= np.abs(region.beyond(points, grid.unit)) < reach
        return inside, cut

    def beside(self, grid: Grid, box: CellBox) -> bool:
        """Return whether nothing of a box of cells of a Cartesian grid is measured, for certain."""
        if self.region is None or not self.region.bounded or not is_structured(grid):
            return False
        ends = zip(grid.edges, box.low, box.high, strict=True)
        low, high = np.array([(e[a], e[b]) for e, a, b in ends]).T
        away = self.region.beyond(0.5 * (low + high)[:, None], grid.unit)
        return bool(away[0] > 0.5 * np.linalg.norm(high - low))


def _in_box(region: Box, grid: Any, first: int, last: int) -> np.ndarray:
    """Return which part of each cell is in a box: exactly, but for slivers of rounding."""
    corners = np.array([plain(end, grid.unit, "box") for end in (region.low, region.high)])
    region.beyond(corners.T, grid.unit)  # refuses those that are the wrong way round

    def common(low: np.ndarray, high: np.ndarray, start: Any, stop: Any) -> np.ndarray:
        part = (np.minimum(high, stop) - np.maximum(low, start)) / (high - low)
        return np.where(part < _ROUNDING, 0.0, np.where(part > 1 - _ROUNDING, 1.0, part))

    if is_structured(grid):  # one axis after another: 1 instead of 9 ms for 512² cells
        axes = [common(e[:-1], e[1:], *c) for e, c in zip(grid.edges, corners.T, strict=True)]
        row = len(axes[1]) * len(axes[2])
        begin = first // row
        parts = axes[0][begin : -(-last // row)]
        if not parts.any():
            return np.zeros(last - first)
        flat = np.einsum("i,j,k", parts, *axes[1:]).ravel()
        return np.asarray(flat[first - begin * row : last - begin * row])
    low, high = grid.spans(first, last)
    return np.asarray(common(low, high, *corners[..., None]).prod(axis=0))


def _fraction(
    region: Region,
    grid: Any,
    first: int,
    last: int,
    cells: np.ndarray,
    steps: list[np.ndarray],
) -> np.ndarray:
    system = tuple(grid.coordinates)
    inside, total, images = np.zeros(len(cells)), np.zeros(len(cells)), mirror_images(grid)
    low, high = (ends[:, cells] for ends in grid.spans(first, last))
    for place in np.array(np.meshgrid(*steps)).reshape(3, -1).T:
        native = low + place[:, None] * (high - low)
        points = position(system, native)
        weight = np.abs(np.prod(metric(system, native), axis=0)) + 1e-300
        total += weight
        for image in images:
            inside += weight * region.inside(points * image[:, None], grid.unit) / len(images)
    return np.where(inside > (1 - _ROUNDING) * total, 1.0, inside / total)
