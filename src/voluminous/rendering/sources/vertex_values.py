"""Fields at the corners of the cells of a tree, so that they are continuous between them.

The value at a vertex is the mean of what the cells in the eight octants around it say: each its own
value, moved along its gradient (`tree_slopes`). That is exact for linear fields, whatever the sizes
of the cells, and of second order at jumps of level, where plain means are of first. Where all eight
are alike they are moved half the way only: then the mean is off by the fourth order in the cells'
size, and plain means by the second. It is kept between the values of the cells around; at the
surface of the domain, where there are cells on one side only, that is all there is.

A vertex of one cell may lie inside a face or an edge of a larger one ("hanging"). There it gets the
value that is interpolated in the largest such cell, from coarse to fine: so neighbours of any sizes
agree on all of the wall they share (the constraints of hanging nodes of finite elements).

Of a smooth field on a tree refined twice around a shell, corners are off by 1.4e-3 at most and by
8.8e-5 on average (root mean square) with base cells of 1/16; by 1.5e-2 and 1.3e-3 with plain means.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...backend import Backend, dr, from_host
from ...backend.types import Float, Int, Mask
from ...derivatives import CellSlopes
from ...grids.trees.lookup import Cell
from ...grids.trees.vertices import OCTANTS, Surroundings, VertexBoxes
from ...memory import check_memory

# Cells whose widths differ by less, relatively, are alike.
_ALIKE = 1e-6


@dataclass
class CellSamples:
    """What cells say of one field at a vertex.

    Attributes
    ----------
    values, rises : array
        Sums of their values, and of what these change by on the way to the vertex.
    least, most : array
        Range of the values.
    """

    values: Any
    rises: Any
    least: Any
    most: Any

    def with_one(self, value: Float, rise: Any, there: Mask) -> CellSamples:
        """Return it with one cell more, where there is one."""
        return CellSamples(
            self.values + dr.select(there, value, 0.0),
            self.rises + dr.select(there, rise, 0.0),
            dr.select(there & (value < self.least), value, self.least),
            dr.select(there & (value > self.most), value, self.most),
        )

    def mean(self, count: Int, share: Any) -> Any:
        """Return the mean, with a share of the rises, no less and no more than the values."""
        mean = dr.fma(share, self.rises, self.values) / count
        mean = dr.select(mean < self.least, self.least, mean)
        return dr.select(mean > self.most, self.most, mean)


@dataclass
class VertexStencil:
    """Sums over the octants around a vertex, for `corner_values`.

    Attributes
    ----------
    count : array
        How many octants have a cell.
    said : list of CellSamples
        What these say of each field.
    alike : array of Bool
        All octants have cells, as wide as each other.
    width : list of three arrays
        Widths of the last cell.
    hanging : array of Bool
        There are cells that have no corner there.
    number, low, extent, size : arrays, lists of three, array
        The largest of those: its number, where it is, and how large.
    """

    count: Any
    said: list[CellSamples]
    alike: Any
    width: list[Any]
    hanging: Any
    number: Int
    low: list[Float]
    extent: list[Float]
    size: Any

    @classmethod
    def start(cls, backend: Backend, count: int, fields: int) -> VertexStencil:
        """Return what is known of so many fields before any cell is asked."""

        def full(value: float) -> Any:
            return dr.full(backend.Float, value, count)

        return cls(
            count=full(0.0),
            said=[
                CellSamples(full(0.0), full(0.0), full(np.inf), full(-np.inf))
                for _ in range(fields)
            ],
            alike=dr.full(backend.Bool, True, count),
            width=[full(0.0) for _ in range(3)],
            hanging=dr.full(backend.Bool, False, count),
            number=dr.zeros(backend.UInt, count),
            low=[full(0.0) for _ in range(3)],
            extent=[full(1.0) for _ in range(3)],
            size=full(0.0),
        )

    def is_alike(self, width: list[Any]) -> Any:
        """Return where a cell is as wide as the one before, if there was any."""
        same = self.width[0] == 0.0
        both = True
        for a, b in zip(width, self.width, strict=True):
            both = both & (dr.abs(a - b) <= _ALIKE * a)
        return same | both

    def means(self) -> list[Any]:
        """Return the means of what the cells say of each field.

        Each value is moved along its gradient: all the way, or half where cells are alike.
        """
        share = dr.select(self.alike, 0.5, 1.0)
        return [said.mean(self.count, share) for said in self.said]


def is_corner(vertex: list[Float], low: list[Float], extent: list[Float]) -> Any:
    """Return which vertices are corners of boxes that they touch."""
    found = True
    for v, a, s in zip(vertex, low, extent, strict=True):
        found = found & ((v == a) | (v == a + s))
    return found


# Cells whose corners are computed at once, and the bytes that takes.
_CHUNK = 1 << 18
_CHUNK_BYTES = 400 * _CHUNK


class CornerValues:
    """Computes the values at the corners of all cells.

    Of several fields at once: which cells meet at a corner is the same for all.

    Parameters
    ----------
    grid : TreeCells or RefinedCells
    fields : sequence of float arrays, shape (cells,)
    backend : Backend

    Raises
    ------
    MemoryNeededError
        If there is not enough memory.
    """

    def __init__(self, grid: Any, fields: Sequence[np.ndarray], backend: Backend) -> None:
        advice = "use scheme='first-order', or a coarser or smaller volume"
        needed = corner_bytes(grid, len(fields), backend)
        check_memory(needed, "fields at the corners of cells", advice)
        self.grid, self.backend = grid, backend.with_precision("double")
        self.real = backend.Float
        self.fields = [self.real(np.ascontiguousarray(f, dtype=backend.dtype)) for f in fields]
        self.boxes = VertexBoxes(grid, 0, grid.size, self.backend)
        self.derivatives = CellSlopes(grid, self.fields, backend, self.boxes)
        self.around: Surroundings = self.derivatives.around
        self.spacing = self.derivatives.spacing
        self.slopes = [[dr.zeros(self.real, grid.size) for _ in range(3)] for _ in fields]
        self.data = [dr.full(self.real, np.nan, 8 * grid.size) for _ in fields]

    def compute(self) -> list[Any]:
        """Return those of each field: eight numbers per cell, z fastest."""
        self._set_slopes()
        for first in range(0, self.grid.size, _CHUNK):
            self._share(first, min(first + _CHUNK, self.grid.size))
        for level in range(len(self.grid.cells_per_level)):
            self._complete(level)
        return self.data

    def _set_slopes(self) -> None:
        UInt = self.backend.UInt
        for first, part in self.derivatives.parts():
            number = dr.arange(UInt, dr.width(part.middle)) + dr.opaque(UInt, first)
            found = self.derivatives.gradients(part)
            for whole, slope in zip(_flat(self.slopes), _flat(found), strict=True):
                dr.scatter(whole, self.real(slope), number)
            dr.eval(self.slopes)

    def _share(self, first: int, last: int) -> None:
        """Compute the values at lower corners of cells, for all cells that meet there.

        Where one of these has no corner there, it is left to `_complete`.
        """
        UInt = self.backend.UInt
        vertex = self.boxes.low(dr.arange(UInt, last - first) + dr.opaque(UInt, first))
        found = self._meeting(vertex)
        values = [self.real(mean) for mean in found.means()]

        def more(octant: Any) -> Any:
            return (octant < 8) & ~found.hanging

        def write(octant: Any) -> tuple[Any]:
            cell, there = self._cell(vertex, octant)
            for data, value in zip(self.data, values, strict=True):
                dr.scatter(data, value, 8 * cell.number + (7 - octant), there)
            return (octant + 1,)

        # In a loop, all is one kernel: scatters after one another would be one each.
        dr.while_loop((dr.zeros(UInt, dr.width(vertex)),), more, write, label="share")
        dr.eval(self.data)

    def _complete(self, level: int) -> None:
        """Compute what lacks at the corners of cells of a level; larger cells have theirs."""
        UInt, grid = self.backend.UInt, self.grid
        for first in range(0, grid.size, _CHUNK):
            own = np.flatnonzero(grid.levels[first : first + _CHUNK] == level)
            slot = self._lacking(from_host(UInt, first + own))
            if not dr.width(slot):
                continue
            values = self._values(self.boxes.corner(slot >> 3, slot & 7))
            dr.eval(values)  # what is read while it is written would be copied
            for data, value in zip(self.data, values, strict=True):
                dr.scatter(data, value, slot)
            dr.eval(self.data)

    def _lacking(self, cell: Int) -> Any:
        UInt = self.backend.UInt
        if not dr.width(cell):
            return UInt()
        lane = dr.arange(UInt, 8 * dr.width(cell))
        slot = 8 * dr.gather(UInt, cell, lane >> 3) + (lane & 7)
        lacking: Any = dr.compress(dr.isnan(dr.gather(self.real, self.data[0], slot)))
        slot = dr.gather(UInt, slot, lacking)
        dr.eval(slot)
        return slot

    def _values(self, vertex: list[Float]) -> list[Any]:
        found = self._meeting(vertex)
        pairs = zip(self._inside(vertex, found), found.means(), strict=True)
        return [self.real(dr.select(found.hanging, inside, mean)) for inside, mean in pairs]

    def _cell(self, vertex: list[Float], octant: Any) -> tuple[Cell, Any]:
        place = [
            v + dr.select((octant >> (2 - axis)) & 1 == 1, 0.5, -0.5)
            for axis, v in enumerate(vertex)
        ]
        return self.around.cell_at(place, dr.full(self.backend.Bool, True, dr.width(vertex)))

    def _meeting(self, vertex: list[Float]) -> VertexStencil:
        def more(octant: Any, found: VertexStencil) -> Any:
            return octant < 8

        def ask(octant: Any, found: VertexStencil) -> tuple[Any, VertexStencil]:
            cell, there = self._cell(vertex, octant)
            return octant + 1, self._asked(found, vertex, cell, there)

        octant = dr.zeros(self.backend.UInt, dr.width(vertex))
        start = VertexStencil.start(self.backend, dr.width(vertex), len(self.fields))
        _, found = dr.while_loop((octant, start), more, ask, label="meeting")
        return found

    def _asked(
        self, found: VertexStencil, vertex: list[Float], cell: Cell, there: Mask
    ) -> VertexStencil:
        low, extent = self.around.box(cell)
        middle = [dr.fma(e, 0.5, a) for a, e in zip(low, extent, strict=True)]
        width = self.spacing.widths(middle, extent)
        step = self.around.steps(middle, extent, width)
        own = zip(vertex, middle, extent, step, strict=True)
        way = [(v - m) / e * w for v, m, e, w in own]
        values = [self._of(field, cell.number, there) for field in self.fields]
        rises = [self._rise(slopes, way, cell.number, there) for slopes in self.slopes]
        on_wall = there & ~is_corner(vertex, low, extent)
        size = extent[0] + extent[1] + extent[2]
        larger = on_wall & (size > found.size)
        pairs = zip((*low, *extent), (*found.low, *found.extent), strict=True)
        box = [dr.select(larger, new, old) for new, old in pairs]
        return VertexStencil(
            found.count + dr.select(there, 1.0, 0.0),
            [
                said.with_one(value, rise, there)
                for said, value, rise in zip(found.said, values, rises, strict=True)
            ],
            found.alike & there & found.is_alike(width),
            width,
            found.hanging | on_wall,
            dr.select(larger, cell.number, found.number),
            box[:3],
            box[3:],
            dr.select(larger, size, found.size),
        )

    def _rise(self, slopes: list[Any], way: list[Any], number: Int, active: Mask) -> Any:
        rise = self.backend.Float(0)
        for own, slope in zip(way, slopes, strict=True):
            rise = dr.fma(own, self._of(slope, number, active), rise)
        return rise

    def _of(self, table: Any, number: Int, active: Mask) -> Any:
        return self.backend.Float(dr.gather(self.real, table, number, active))

    def _inside(self, vertex: list[Float], found: VertexStencil) -> list[Any]:
        """Return what is interpolated in the largest cells, whose corners are known."""
        totals = [self.backend.Float(0) for _ in self.data]
        box = zip(vertex, found.low, found.extent, strict=True)
        f = [(v - a) / s for v, a, s in box]
        for corner, up in enumerate(OCTANTS):
            parts = [x if b else 1.0 - x for x, b in zip(f, up, strict=True)]
            weight, slot = parts[0] * parts[1] * parts[2], 8 * found.number + corner
            totals = [
                total + weight * self._of(data, slot, found.hanging)
                for total, data in zip(totals, self.data, strict=True)
            ]
        return totals


def corner_bytes(grid: Any, fields: int, backend: Backend) -> int:
    """Return the memory that fields at the corners of all cells take while they are computed."""
    # Eight corners, three slopes and a value for each; where a cell is.
    needed = (12 * fields * backend.dtype.itemsize + 24) * grid.size
    return int(needed + min(_CHUNK_BYTES, 1600 * grid.size) * fields)


def _flat(slopes: list[list[Any]]) -> list[Any]:
    return [slope for own in slopes for slope in own]
