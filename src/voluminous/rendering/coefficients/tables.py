"""Coefficients tabulated beforehand, per cell or averaged to vertices.

The medium is evaluated in double precision where the device has it, times the grid's scale (lengths
in kernels are in that unit), and only then rounded: coefficients in cgs units would underflow in
single precision. A table holds j per channel, then the extinctions, interleaved so that one packet
gather fetches them all: 55 cycles per vector of 16 rays from the first-level cache, where four
gathers take 130.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from ...backend import dr
from ...backend.functions import flush_subnormal
from ...backend.types import Float, Mask
from ...errors import InputError
from ...grids.contract import Corners, Segment
from ...schemes.base import Coefficients

# Dr.Jit arrays, and the offsets of packets in them, are 32-bit.
LARGEST = 2**32 - 1
# Cells classified at once: bounds the memory of temporaries, and the time between interruptions.
SLAB = 1 << 19


def packet_widths(count: int) -> list[int]:
    """Return how `count` numbers are split into packets of 4, 2 and 1."""
    widths = [4] * (count // 4)
    for width in (2, 1):
        if count & width:
            widths.append(width)
    return widths


@dataclass
class Table:
    """Tabulated coefficients: what a scheme looks up.

    Attributes
    ----------
    packets : list of arrays
        Interleaved numbers, one flat array per packet.
    numbers : Direct or Shapes
        What the numbers are.
    largest : list of float
        Largest magnitude of each number, times the grid's scale.
    bounds : list of float
        Bounds of them, from the ranges of the fields: as they were before they were rounded.
    blocks, walk : optional
        Blocks for rays to leap over; or a walk through less than the whole grid.
    """

    packets: list[Any]
    widths: list[int]
    numbers: Any
    largest: list[float]
    backend: Any
    bounds: list[float]
    blocks: Any = None
    walk: Any = None

    def gather(self, index: Any, active: Any) -> list[Any]:
        """Return all numbers at a flat index."""
        values: list[Any] = []
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


def cell_table(classifier: Any, backend: Any, report: Any) -> Table:
    """Return the coefficients of all cells.

    Parameters
    ----------
    classifier : Classifier
        Evaluates the medium on ranges of cells.
    report : callable
        Called as ``report(done, total)``; may raise to interrupt.
    """
    return _cells(classifier, backend, 0, classifier.grid.size, report)


def _cells(classifier: Any, backend: Any, low: int, high: int, report: Any) -> Table:
    table = _empty_table(classifier, backend, high - low)
    for first in range(low, high, SLAB):
        last = min(first + SLAB, high)
        _classify_into(table, classifier, first, last - first, first - low)
        report(last - low, high - low)
    return table


def vertex_table(classifier: Any, backend: Any, report: Any) -> Table:
    """Return the coefficients at all vertices: plain means over the cells that touch them.

    RADMC-3D's rule: cells outside the domain are left out, not counted as zero. Each cell is
    classified once or twice.
    """
    grid = classifier.grid
    table = _empty_table(classifier, backend, grid.vertex_count)
    cells, held = None, (0, 0)
    for (first, last), around in _vertex_pieces(grid):
        if around != held or cells is None:
            cells, held = _cells(classifier, backend, *around, _unheard), around
        _store(table, _means(cells, grid, (first, last), around[0]), first)
        report(last, grid.vertex_count)
    return table


def _vertex_pieces(grid: Any) -> Iterator[tuple[tuple[int, int], tuple[int, int]]]:
    """Yield ranges of vertices, and of the cells around them.

    Layers of the first axis touch two layers of cells; the leaves of a tree are anywhere.
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


def _means(cells: Table, grid: Any, vertices: tuple[int, int], low: int) -> list[Any]:
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


def _empty_table(classifier: Any, backend: Any, size: int) -> Table:
    count = classifier.numbers.count
    widths = packet_widths(count)
    if size * max(widths) > LARGEST:
        raise InputError(
            f"a table of {size} x {max(widths)} numbers exceeds the {LARGEST} that an array can "
            "hold; render the volume in parts, or with scheme='first-order'"
        )
    packets = [dr.empty(backend.Float, size * w) for w in widths]
    bounds = classifier.numbers.in_units(classifier.largest())
    return Table(packets, widths, classifier.numbers, [0.0] * count, backend, bounds)


def _classify_into(table: Table, classifier: Any, first: int, count: int, place: int) -> None:
    """Classify cells from `first` on and write them into a table from `place` on."""
    values = classifier.classify(first, count)
    bad = classifier.unusable(values)
    _store(table, values, place, bad)
    if dr.any(bad):
        classifier.refuse(values, bad, first)


def _store(table: Table, values: list[Any], first: int, *also: Any) -> None:
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
