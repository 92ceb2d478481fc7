"""Memory layouts of fields from which rays gather the eight values around a dual cell."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...backend import Backend, dr
from ...backend.types import Int, Mask
from ...errors import InputError
from ...grids.cartesian.dual_walk import Chord
from ...grids.curvilinear.field_walk import dual_values
from ...memory import check_memory, fits
from ...ranges import CellsInPlace, device_array, is_packed
from ...schemes.channels import unit_near
from ..cache import Cache
from .cells import LARGEST, SLAB, CellEvaluator

if TYPE_CHECKING:
    from ...grids.contract import DualGrid, Grid
    from ...grids.trees.ghosts import LeavesWithGhosts

# Maximum size of face packets (quads) in bytes. Rays through 100³ cells take 0.75 of the time they
# take with nodes, through 512³ (where both are limited by memory) 0.92, for 2 GB and 3 s to create
# them.
_LARGEST_QUADS = 1 << 29

# Number of fields whose values at tree corners are computed at once: four take 0.4 of the time of
# four computed one by one.
_FIELDS = 4

# How names of fields begin whose integral is to be the sum over cells.
KEEPS_SUMS = "cellwise("

# Corners of a dual cell: values[x][y][z].
Corners = list[list[list[Any]]]


class FieldLattice:
    """A field in the layout that rays gather.

    Attributes
    ----------
    unit : float
        The values are divided by this.
    """

    unit: float

    @classmethod
    def of_range(cls, low: float, high: float, backend: Backend) -> FieldLattice:
        """Return the unit of a field alone, given its range."""
        lattice = cls()
        lattice.unit = _unit_of(low, high, backend)
        return lattice

    def corners(self, chord: Any, active: Mask) -> Corners:
        """Return the values around the dual cell of a segment."""
        raise NotImplementedError


@dataclass
class FacePackets(FieldLattice):
    """Values of faces of constant x: f[i, j, k], f[i, j, k+1], f[i, j+1, k], f[i, j+1, k+1]."""

    data: Any
    unit: float
    stride: Any
    packet: Any

    def corners(self, chord: Chord, active: Mask) -> Corners:
        return faces(self.packet, self.data, chord.cell, self.stride, active)


@dataclass
class NodalValues(FieldLattice):
    """Every value once."""

    data: Any
    unit: float
    strides: tuple[Any, Any]

    def corners(self, chord: Chord, active: Mask) -> Corners:
        x, y = self.strides
        return [
            [[self._value(chord.corner + a + b + c, active) for c in (0, 1)] for b in (0, y)]
            for a in (0, x)
        ]

    def _value(self, index: Int, active: Mask) -> Any:
        return dr.gather(type(self.data), self.data, index, active)


@dataclass
class CornerPackets(FieldLattice):
    """The eight values of every cell of a tree side by side (`vertex_values`)."""

    data: Any
    unit: float
    packet: Any

    def corners(self, chord: Any, active: Mask) -> Corners:
        return faces(self.packet, self.data, 2 * chord.cell, 1, active)


def faces(packet: Any, data: Any, index: Int, stride: Any, active: Mask) -> Corners:
    """Return the eight values around a dual cell, from the quads of its two faces."""
    found = [list(dr.gather(packet, data, k, active)) for k in (index, index + stride)]
    return [[f[0:2], f[2:4]] for f in found]


def _checked_unit(array: np.ndarray, backend: Backend, count: int) -> float:
    """Return the number a field is divided by so that single precision can hold it, mostly 1.

    Refuses a field of which `count` values do not fit into memory beside the volume.
    """
    if count > LARGEST:
        raise InputError(
            f"scheme 'post-classified' can hold {LARGEST} values of a field, this one has {count}; "
            "render the volume in parts, or with scheme='first-order'"
        )
    advice = "use scheme='first-order', which needs no copy, or a coarser or smaller volume"
    check_memory(count * backend.dtype.itemsize, "a field between cell centres", advice)
    return _unit_of(
        float(np.fmin.reduce(array, axis=None)), float(np.fmax.reduce(array, axis=None)), backend
    )


def _unit_of(low: float, high: float, backend: Backend) -> float:
    most = max(abs(low), abs(high))
    if backend.precision == "double" or not 0.0 < most < np.inf or 1e-25 < most < 1e25:
        return 1.0
    return unit_near(most)


def tree_lattices(
    grid: Grid, arrays: Sequence[np.ndarray], backend: Backend, sums: Sequence[bool]
) -> list[CornerPackets]:
    """Return values at the corners of the cells of trees.

    The number of fields computed at once depends on the memory.
    """
    from .vertex_values import CornerValues, corner_bytes

    made: list[CornerPackets] = []
    while left := arrays[len(made) :]:
        many = left[:_FIELDS] if fits(2 * corner_bytes(grid, _FIELDS, backend)) else left[:1]
        units = [_checked_unit(array, backend, 8 * grid.size) for array in many]
        scaled = [array / unit for array, unit in zip(many, units, strict=True)]
        own = sums[len(made) : len(made) + len(many)]
        data = CornerValues(grid, scaled, backend, own).compute()
        made += [CornerPackets(d, u, backend.packet(4)) for d, u in zip(data, units, strict=True)]
    return made


def lattices_of_leaves(
    leaves: LeavesWithGhosts,
    arrays: Sequence[np.ndarray],
    units: Sequence[float],
    backend: Backend,
    sums: Sequence[bool] = (),
) -> list[CornerPackets]:
    """Return the lattices of a part of a tree, from fields divided by units."""
    from .vertex_values import CornerValues

    scaled = [array / unit for array, unit in zip(arrays, units, strict=True)]
    made: list[CornerPackets] = []
    while left := scaled[len(made) :]:
        own = sums[len(made) :][:1]
        data = CornerValues(leaves, left[:1], backend, own).compute()
        made.append(CornerPackets(data[0], units[len(made)], backend.packet(4)))
        dr.flush_malloc_cache()  # memory of slopes, and of all else
    return made


def lattices_of(
    grid: DualGrid, arrays: Sequence[np.ndarray], backend: Backend, sums: Sequence[bool] = ()
) -> Sequence[Any]:
    """Return fields as the dual walk of a grid gathers them, one for each array.

    `sums` says of which fields the integral is to be the sum over cells, however steep they are; by
    default of none.
    """
    match grid.dual_layout:
        case "corners":
            return tree_lattices(grid, arrays, backend, sums)
        case "cells" | "dual vertices" as layout:
            sizes = [
                0 if layout == "cells" and _in_place(array, backend) else _padded_size(array.shape)
                for array in arrays
            ]
            units = [_checked_unit(a, backend, n) for a, n in zip(arrays, sizes, strict=True)]
            pairs = zip(arrays, units, strict=True)
            if layout == "cells":
                return [_cartesian_lattice(array, backend, unit) for array, unit in pairs]
            return [make_nodes(dual_values(array, grid), backend, unit) for array, unit in pairs]
        case make:
            return make(arrays, backend, sums)  # type: ignore[operator]


def _padded_size(shape: tuple[int, ...]) -> int:
    return math.prod(int(n) + 2 for n in shape)


def _in_quads(array: np.ndarray, backend: Backend) -> bool:
    size = 4 * _padded_size(array.shape) * backend.dtype.itemsize
    return size <= _LARGEST_QUADS and fits(4 * size)


def _in_place(array: np.ndarray, backend: Backend) -> bool:
    """Return whether rays gather from the array itself; indices are signed."""
    readable = array.dtype == backend.dtype or is_packed(array)
    return readable and array.size < 1 << 31 and not _in_quads(array, backend)


def _cartesian_lattice(array: np.ndarray, backend: Backend, unit: float) -> Any:
    if unit == 1.0 and _in_place(array, backend):
        return CellsInPlace.of(array, backend)
    padded = np.pad(array, 1, mode="edge")
    if _in_quads(array, backend):
        return make_faces(padded, backend, unit)
    return make_nodes(padded, backend, unit)


def make_nodes(padded: np.ndarray, backend: Backend, unit: float) -> NodalValues:
    """Return values at the vertices of a dual grid, divided by a unit."""
    scaled = padded if unit == 1.0 else padded / unit
    _, ny, nz = padded.shape
    data = backend.Float(scaled.astype(backend.dtype, copy=False).reshape(-1))
    return NodalValues(data, unit, (dr.opaque(backend.UInt, ny * nz), dr.opaque(backend.UInt, nz)))


def make_faces(padded: np.ndarray, backend: Backend, unit: float) -> FacePackets:
    """Return the quads of the values at the vertices of a dual grid, divided by a unit."""
    UInt, (layers, ny, nz) = backend.UInt, padded.shape
    plane = (ny - 1) * (nz - 1)
    data, scale = dr.empty(backend.Float, 4 * layers * plane), backend.wide(1.0 / unit)
    step = max(1, SLAB // plane)
    for first in range(0, layers, step):
        part = device_array(padded[first : first + step].reshape(-1), backend)
        lane = dr.arange(UInt, min(step, layers - first) * plane)
        row = backend.quotient(lane, dr.opaque(UInt, nz - 1))
        layer = backend.quotient(row, dr.opaque(UInt, ny - 1))
        # Rows have one value more than quads, and layers one row more.
        corner = lane + row + layer * dr.opaque(UInt, nz)
        values = [
            backend.Float(backend.Wide(dr.gather(type(part), part, index)) * scale)
            for line in (corner, corner + dr.opaque(UInt, nz))
            for index in (line, line + 1)
        ]
        target = lane + dr.opaque(UInt, first * plane)
        dr.scatter(data, backend.packet(4)(values), target)
        dr.eval(data)
    return FacePackets(data, unit, dr.opaque(UInt, plane), backend.packet(4))


def get_lattices(evaluator: CellEvaluator, cache: Cache) -> dict[str, Any]:
    """Return all fields in the layouts that rays gather; cached with the volume."""
    volume, backend = evaluator.volume, evaluator.backend
    names = [name for name in evaluator.medium.names if name in volume]
    keys = {n: ("lattice", n, backend, cache.statistics.digest(n)) for n in names}
    found = {name: cache.get(key) for name, key in keys.items()}
    lacking = [name for name in names if found[name] is None]
    arrays = [volume.array(name) for name in lacking]
    made = lattices_of(volume.grid, arrays, backend, [n.startswith(KEEPS_SUMS) for n in lacking])
    for name, lattice in zip(lacking, made, strict=True):
        found[name] = cache.put(keys[name], lattice)
    return found
