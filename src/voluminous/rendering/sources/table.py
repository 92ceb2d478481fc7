"""Coefficients per cell or vertex: tabulated beforehand, or evaluated on the ray."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from ...backend import Backend, dr
from ...backend.functions import flush_subnormal
from ...backend.types import Float, Int, Mask
from ...errors import InputError
from ...grids.contract import Corners, Segment
from ...memory import check_memory, fits
from ...schemes.base import Coefficients, Scheme
from ..cache import SLABS, Cache
from .cells import LARGEST, SLAB, CellEvaluator, device_array
from .empty_space import CELLS, get_blocks, pruned_walk, tabled

if TYPE_CHECKING:
    from ...grids.contract import Grid


def packet_widths(count: int) -> list[int]:
    """Return the widths (4, 2 or 1) of the packets that hold `count` numbers."""
    widths = [4] * (count // 4)
    for width in (2, 1):
        if count & width:
            widths.append(width)
    return widths


@dataclass
class CoefficientTable:
    """Tabulated coefficients, for look-up by schemes.

    Attributes
    ----------
    packets : list of arrays
        Interleaved numbers, one flat array per packet.
    numbers : PerChannel or SharedProfiles
        Layout of the numbers.
    largest : list of float
        Largest magnitude of each number, times the grid's scale.
    bounds : list of float
        Their bounds from the ranges of the fields, before rounding.
    blocks, walk : optional
        Blocks that rays may skip; or a walk through part of the grid.
    """

    packets: list[Any]
    widths: list[int]
    numbers: Any
    largest: list[float]
    backend: Backend
    bounds: list[float]
    blocks: Any = None
    walk: Any = None
    walk_kind: ClassVar[str | None] = None
    tolerance: ClassVar[tuple[Float, ...]] = ()

    def gather(self, index: Int, active: Mask) -> list[Any]:
        """Return all numbers at a flat index."""
        values: list[Float] = []
        for data, width in zip(self.packets, self.widths, strict=True):
            got = dr.gather(self.backend.packet(width), data, self.backend.UInt(index), active)
            values += [got] if width == 1 else list(got)
        return values

    def at(self, segment: Segment) -> Coefficients:
        return self.numbers.split(self.gather(segment.cell, segment.active))

    def inputs(self) -> Any:
        return self.packets, self.numbers.inputs()

    def interpolate(self, corners: Corners, active: Mask) -> list[Float]:
        total: list[Any] = []
        for vertex, weight in zip(corners.vertex, corners.weight, strict=True):
            values = self.gather(vertex, active)
            if total:
                total = [dr.fma(weight, v, t) for v, t in zip(values, total, strict=True)]
            else:
                total = [weight * v for v in values]
        return total


def cell_table(evaluator: Any, backend: Backend, report: Any) -> CoefficientTable:
    """Return the coefficients of all cells."""
    return _cells(evaluator, backend, 0, evaluator.grid.size, report)


def _cells(evaluator: Any, backend: Backend, low: int, high: int, report: Any) -> CoefficientTable:
    table = _empty_table(evaluator, backend, high - low)
    for first in range(low, high, SLAB):
        last = min(first + SLAB, high)
        _classify_into(table, evaluator, first, last - first, first - low)
        report(last - low, high - low)
    return table


def vertex_table(evaluator: Any, backend: Backend, report: Any) -> CoefficientTable:
    """Return the coefficients at all vertices: plain means over the cells that touch them.

    RADMC-3D's rule: cells outside the domain are excluded, not counted as zero. Each cell is
    classified once or twice.
    """
    grid = evaluator.grid
    table = _empty_table(evaluator, backend, grid.vertex_count)
    cells, held = None, (0, 0)
    for (first, last), around in _vertex_pieces(grid):
        if around != held or cells is None:
            cells, held = _cells(evaluator, backend, *around, _unheard), around
        _store(table, _means(cells, grid, (first, last), around[0]), first)
        report(last, grid.vertex_count)
    return table


def _vertex_pieces(grid: Grid) -> Iterator[tuple[tuple[int, int], tuple[int, int]]]:
    """Yield ranges of vertices, and of the cells around them.

    Layers of the first axis touch two layers of cells; for trees all leaves are needed.
    """
    if not grid.is_structured:
        for first in range(0, grid.vertex_count, SLAB):
            yield (first, min(first + SLAB, grid.vertex_count)), (0, grid.size)
        return
    n, plane = grid.shape[0], grid.size // grid.shape[0]
    vertices = grid.vertex_count // (n + 1)
    step = max(1, SLAB // plane)
    for first in range(0, n + 1, step):
        last = min(first + step, n + 1)
        low, high = max(first - 1, 0), min(last, n)
        yield (first * vertices, last * vertices), (low * plane, high * plane)


def _unheard(done: int, total: int) -> None:
    """Report nothing."""


def _means(cells: CoefficientTable, grid: Grid, vertices: tuple[int, int], low: int) -> list[Any]:
    """Return the means at consecutive vertices, from a table of cells that begins with `low`."""
    backend = cells.backend
    UInt, Float = backend.UInt, backend.Float
    first, last = vertices
    vertex = dr.arange(UInt, last - first) + dr.opaque(UInt, first)
    begin = dr.opaque(UInt, low)
    total = [Float(0)] * cells.numbers.count
    number = Float(0)
    for cell, there in grid.vertex_cells(vertex, backend):
        values = cells.gather(UInt(cell) - begin, there)
        total = [t + v for t, v in zip(total, values, strict=True)]
        number += dr.select(there, 1.0, 0.0)
    return [t / number for t in total]


def _empty_table(evaluator: Any, backend: Backend, size: int) -> CoefficientTable:
    count = evaluator.numbers.count
    widths = packet_widths(count)
    if size * max(widths) > LARGEST:
        raise InputError(
            f"a table of {size} x {max(widths)} numbers exceeds the {LARGEST} that an array can "
            "hold; render the volume in parts, or with scheme='first-order'"
        )
    packets = [dr.empty(backend.Float, size * w) for w in widths]
    bounds = evaluator.numbers.in_units(evaluator.largest())
    return CoefficientTable(packets, widths, evaluator.numbers, [0.0] * count, backend, bounds)


def _classify_into(
    table: CoefficientTable, evaluator: Any, first: int, count: int, place: int
) -> None:
    """Classify cells from `first` on and write them into a table from `place` on."""
    values = evaluator.classify(first, count)
    bad = evaluator.unusable(values)
    _store(table, values, place, bad)
    if dr.any(bad):
        evaluator.refuse(values, bad, first)


def _store(table: CoefficientTable, values: list[Float], first: int, *also: Any) -> None:
    """Write the numbers of consecutive places into a table, in one kernel with `also`."""
    real = table.backend.Float
    values = [flush_subnormal(real(v)) for v in values]
    lane = dr.arange(table.backend.UInt, max(len(v) for v in values))
    index = lane + dr.opaque(table.backend.UInt, first)
    position = 0
    for data, width in zip(table.packets, table.widths, strict=True):
        part = values[position : position + width]
        packet = part[0] if width == 1 else table.backend.packet(width)(part)
        dr.scatter(data, packet, index)
        position += width
    size = [dr.abs(v) for v in values]
    dr.eval(table.packets, size, *also)
    for k, v in enumerate(size):
        table.largest[k] = max(table.largest[k], float(dr.max(v)[0]))


class OnRay:
    """The medium evaluated in every cell that a ray visits; the same bits as from a table.

    Unusable coefficients become NaN, which reaches the picture and is checked there.
    """

    blocks = walk = walk_kind = None
    tolerance: tuple[Float, ...] = ()

    def __init__(self, evaluator: CellEvaluator, backend: Backend) -> None:
        self.evaluator, self.backend = evaluator, backend
        self.numbers = evaluator.numbers
        volume = evaluator.volume
        self.fields = {
            name: _whole_field(volume.array(name), backend)
            for name in evaluator.medium.names
            if name in volume
        }
        evaluator.centers.whole()  # made before rays are traced
        self.largest = self.bounds = self.numbers.in_units(evaluator.largest())

    def inputs(self) -> Any:
        return self.fields, self.evaluator.centers.whole(), self.numbers.inputs()

    def at(self, segment: Segment) -> Coefficients:
        cell, active = segment.cell, segment.active
        Wide = self.backend.Wide
        values = {
            name: Wide(dr.gather(type(data), data, cell, active))
            for name, data in self.fields.items()
        }
        found = self.evaluator.evaluate({**self.evaluator.centers.at(cell, active), **values})
        for k in range(self.numbers.emissions, len(found)):
            found[k] = dr.select(found[k] >= 0, found[k], math.nan)
        return self.numbers.split([self._narrow(v) for v in found])

    def _narrow(self, value: Float) -> Any:
        return flush_subnormal(self.backend.Float(value))


def _whole_field(array: np.ndarray, backend: Backend) -> Any:
    if array.dtype.kind != "f":
        size = array.size * (4 if array.dtype.itemsize <= 2 else 8)
        check_memory(size, "an integer field as floating point", "crop or coarsen the volume")
    return device_array(array.reshape(-1), backend)


_ADVICE = (
    "use precision='single', scheme='first-order' (which can do without a table), "
    "or a coarser or smaller volume"
)
# Tabulated coefficients below this fraction of their peak are neglected: below rounding.
_FAINT = {"single": 1e-9, "double": 1e-18}


def tabulated(
    evaluator: CellEvaluator,
    cache: Cache,
    scheme: Scheme,
    steps: float,
    report: Callable[..., None],
    whole: bool,
) -> Any:
    """Return a new or cached table, or the medium on the ray where a table does not pay."""
    volume, backend, numbers = evaluator.volume, evaluator.backend, evaluator.numbers
    needed = table_bytes(evaluator, scheme, backend)
    crowded = scheme.coefficients_at == "cell" and _crowded(
        numbers, needed, volume.grid.size / steps
    )
    if crowded and not volume.tables:  # not even hashed: that takes a while for 1024³
        return _on_ray(evaluator, backend)
    everywhere = scheme.everywhere
    faint = 0.0 if scheme.complete else _FAINT[backend.precision]
    key = _key(evaluator, scheme, cache, (faint, everywhere))
    found = None if key is None else cache.get(key)
    if found is not None:
        return replace(found, numbers=numbers.reuse(found.numbers))
    if crowded:
        return _on_ray(evaluator, backend)
    check_memory(needed + SLABS, f"the table of scheme {scheme.name!r}", _ADVICE)
    numbers.normalise(evaluator.largest())
    make = cell_table if scheme.coefficients_at == "cell" else vertex_table
    table = make(evaluator, backend, report)
    if not everywhere:
        table.blocks = get_blocks(evaluator, cache, faint, CELLS)
        table.walk = _pruned(table, volume.grid, scheme, faint) if whole else None
    return table if key is None else cache.put(key, table)


def _pruned(table: CoefficientTable, grid: Grid, scheme: Scheme, faint: float) -> Any:
    if scheme.coefficients_at != "cell" or not grid.can_be_pruned:
        return None
    return pruned_walk(grid, tabled(table, faint), table.backend, "cells")


def _crowded(numbers: Int, needed: int, cells_per_step: float) -> bool:
    """Return True if the medium is better evaluated on the ray than for all cells beforehand.

    That is so where the rays visit few of the cells. But a table that can be cached and leaves
    enough memory also serves the next pictures: with 512³ cells and 400² rays the first takes 3.1 s
    and the next 0.45 s; on the ray each takes 1.6 s.
    """
    if not fits(needed + SLABS):
        return True
    if cells_per_step < 0.5:
        return False
    return numbers.key() is None or not fits(4 * needed)


def _on_ray(evaluator: CellEvaluator, backend: Backend) -> OnRay:
    evaluator.numbers.normalise(evaluator.largest())
    return OnRay(evaluator, backend)


def table_bytes(evaluator: CellEvaluator, scheme: Scheme, backend: Backend) -> int:
    """Return the memory of a scheme's table."""
    grid = evaluator.grid
    places = grid.vertex_count if scheme.coefficients_at == "vertex" else grid.size
    return places * evaluator.numbers.count * backend.dtype.itemsize


def _key(evaluator: CellEvaluator, scheme: Scheme, cache: Cache, left_out: tuple[Any, ...]) -> Any:
    own = evaluator.numbers.key()
    if own is None:
        return None
    backend = evaluator.backend
    names = evaluator.medium.names
    return (own, scheme.coefficients_at, left_out, backend, cache.statistics.digests(names))
