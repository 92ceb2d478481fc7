"""Coefficients tabulated beforehand, per cell or averaged to vertices.

The medium is evaluated in double precision where the device has it, times the grid's scale (lengths
in kernels are in that unit), and only then rounded: coefficients in cgs units would underflow in
single precision. A table holds j per channel, then the extinctions, interleaved so that one packet
gather fetches them all: 55 cycles per vector of 16 rays from the first-level cache, where four
gathers take 130.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ..backend import dr
from ..backend.functions import flush_subnormal
from ..errors import InputError
from ..grids.contract import Corners

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
    """

    packets: list[Any]
    widths: list[int]
    numbers: Any
    largest: list[float]
    backend: Any
    blocks: Any = None

    def gather(self, index: Any, active: Any) -> list[Any]:
        """Return all numbers at a flat index."""
        values: list[Any] = []
        for data, width in zip(self.packets, self.widths, strict=True):
            got = dr.gather(self.backend.packet(width), data, self.backend.UInt(index), active)
            values += [got] if width == 1 else list(got)
        return values

    def at(self, cell: Any, active: Any) -> tuple[list[Any], list[Any]]:
        """Return j and α of a cell."""
        return self.numbers.split(self.gather(cell, active))

    def interpolate(self, corners: Corners, active: Any) -> list[Any]:
        """Return all numbers interpolated between vertices."""
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
    size = classifier.grid.size
    table = _empty_table(classifier, backend, size)
    for first in range(0, size, SLAB):
        count = min(SLAB, size - first)
        _classify_into(table, classifier, first, count, first)
        report(first + count, size)
    return table


def vertex_table(classifier: Any, backend: Any, report: Any) -> Table:
    """Return the coefficients at all vertices: plain means over the cells that touch them.

    RADMC-3D's rule: cells outside the domain are left out, not counted as zero. Layers of the
    first axis are classified once each, a few at a time.
    """
    nx, ny, nz = classifier.grid.shape
    plane = (ny + 1) * (nz + 1)
    table = _empty_table(classifier, backend, (nx + 1) * plane)
    step = max(1, SLAB // (ny * nz))
    for first in range(0, nx + 1, step):
        last = min(first + step, nx + 1)
        low, high = max(first - 1, 0), min(last, nx)
        cells = _empty_table(classifier, backend, (high - low) * ny * nz)
        _classify_into(cells, classifier, low * ny * nz, (high - low) * ny * nz, 0)
        values = _means(cells, backend, (nx, ny, nz), (first, last), low)
        _store(table, values, first * plane)
        report(last, nx + 1)
    return table


def _means(
    cells: Table, backend: Any, shape: tuple[int, int, int], layers: tuple[int, int], low: int
) -> list[Any]:
    """Return the means at the vertices of some layers, from a table of the cells around them."""
    nx, ny, nz = shape
    first, last = layers
    Int, Float = backend.Int, backend.Float
    lane = dr.arange(backend.UInt, (last - first) * (ny + 1) * (nz + 1))
    row = backend.quotient(lane, dr.opaque(backend.UInt, nz + 1))
    k = Int(lane) - Int(row) * dr.opaque(Int, nz + 1)
    i = Int(backend.quotient(row, dr.opaque(backend.UInt, ny + 1)))
    j = Int(row) - i * dr.opaque(Int, ny + 1)
    i += dr.opaque(Int, first)
    nx, ny, nz, low = (dr.opaque(Int, n) for n in (nx, ny, nz, low))
    total = [Float(0)] * cells.numbers.count
    number = Float(0)
    for corner in range(8):
        a, b, c = i - (corner >> 2 & 1), j - (corner >> 1 & 1), k - (corner & 1)
        there = (a >= 0) & (a < nx) & (b >= 0) & (b < ny) & (c >= 0) & (c < nz)
        index = ((a - low) * ny + b) * nz + c
        total = [t + v for t, v in zip(total, cells.gather(index, there), strict=True)]
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
    return Table(packets, widths, classifier.numbers, [0.0] * count, backend)


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
