"""Sizes of the cells of patches in a kernel, from a code that a patch's level has."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...backend import Float, dr, from_host
from ...backend.types import Int, Mask
from .lookup import Cell, Orientation
from .tree import ABSENT, NONE, NUMBER_MASK, Tree

if TYPE_CHECKING:
    from ...backend.device import Backend
    from .patch_cells import Patches


_EXPONENT_BITS = 6


class PowersOfTwo:
    """Sizes that are powers of two, in finest units: their exponents are the code.

    Attributes
    ----------
    codes : array of uint32, shape (levels,)
    alike : bool
        Cells are as long as wide and high, in finest units.
    exact : bool
        Products with one over a size are not rounded.
    """

    exact = True

    def __init__(self, exponents: np.ndarray, extent: np.ndarray, backend: Backend) -> None:
        self.backend = backend
        shifts = np.arange(3) * _EXPONENT_BITS
        self.codes = (exponents << shifts).sum(axis=1).astype(np.uint32)
        self.alike = bool((exponents == exponents[:, :1]).all())
        # Extents may take 53 bits in double precision.
        Whole: Any = backend.UInt if extent.max() < 1 << 31 else dr.uint64_array_t(backend.UInt)
        self.extent = [dr.opaque(Whole, int(n)) for n in extent]
        single = backend.precision == "single"
        self.Bits: Any = (
            dr.int32_array_t(backend.Float) if single else dr.int64_array_t(backend.Float)
        )
        self.bias, self.shift = (127, 23) if single else (1023, 52)

    def of(self, code: Any) -> tuple[list[Any], list[Any], list[Any]]:
        """Return sizes, one over them, and how many make the domain (modulo 2^32), per axis."""
        mask, UInt = (1 << _EXPONENT_BITS) - 1, self.backend.UInt
        if self.alike:
            exponents = [code & mask] * 3
        else:
            exponents = [(code >> (_EXPONENT_BITS * axis)) & mask for axis in range(3)]
        counts = [UInt(n >> type(n)(e)) for n, e in zip(self.extent, exponents, strict=True)]
        if self.alike:
            one = self.Bits(exponents[0])
            return [self._power(one)] * 3, [self._power(-one)] * 3, counts
        bits = [self.Bits(e) for e in exponents]
        return [self._power(b) for b in bits], [self._power(-b) for b in bits], counts

    def _power(self, exponent: Any) -> Any:
        return dr.reinterpret_array(self.backend.Float, (exponent + self.bias) << self.shift)


class AnySizes:
    """Sizes of any ratio, chosen by level, which is the code.

    There are few levels: choosing takes an operation for each, looking up a packet as long as ten.
    """

    exact = False

    def __init__(self, sizes: np.ndarray, extent: np.ndarray, backend: Backend) -> None:
        self.codes = np.arange(len(sizes), dtype=np.uint32)
        self.alike = bool((sizes == sizes[:, :1]).all())
        self.per_axis = [
            [
                (
                    backend.opaque(float(s)),
                    backend.opaque(1.0 / s),
                    dr.opaque(backend.UInt, int(n) & 0xFFFFFFFF),
                )
                for s, n in zip(column, length // column, strict=True)
            ]
            for column, length in zip(sizes.T, extent, strict=True)
        ]

    def of(self, code: Any) -> tuple[list[Any], list[Any], list[Any]]:
        """Return sizes, one over them, and how many make the domain (modulo 2^32), per axis."""
        which = [code == level for level in range(len(self.codes) - 1)]
        found = [
            [_chosen(which, levels) for levels in zip(*axis, strict=True)] for axis in self.per_axis
        ]
        size, per_size, counts = (list(values) for values in zip(*found, strict=True))
        if self.alike:
            size, per_size = [size[0]] * 3, [per_size[0]] * 3
        return size, per_size, counts


def _chosen(which: list[Any], values: Float) -> Any:
    *others, found = values
    for mask, value in zip(which, others, strict=True):
        found = dr.select(mask, value, found)
    return found


def make_sizes(sizes: np.ndarray, extent: np.ndarray, backend: Backend) -> PowersOfTwo | AnySizes:
    """Return the faster kind that the sizes (levels, 3) of cells allow."""
    mantissa, exponent = np.frexp(sizes.astype(float))
    if (mantissa == 0.5).all():
        return PowersOfTwo(exponent.astype(np.int64) - 1, extent, backend)
    return AnySizes(sizes, extent, backend)


# Marks patches that are seen partly: the numbers of their cells are looked up.
TABLED = 1 << 31


@dataclass(frozen=True)
class PatchNumbering:
    """Entries that name the patch whose cells they are covered by; see `tree.Numbering`."""

    patches: Patches

    def cells(
        self, entry: np.ndarray, place: np.ndarray, unit: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return numbers and sizes of the cells around places; a hole is its entry."""
        hole, patches = entry == ABSENT, self.patches
        patch = np.where(hole, 0, entry & NUMBER_MASK)
        size = patches.sizes[patches.level[patch]].T
        index = place // size - patches.low[patch].T
        ny, nz = patches.shape[patch, 1], patches.shape[patch, 2]
        local = (index[0] * ny + index[1]) * nz + index[2]
        number = local + (patches.ends - patches.visible)[patch]
        partly = patches.hidden[patch] & ~hole
        number[partly] = patches.numbers[(local + patches.first_slots[patch])[partly]]
        return np.where(hole, -1, number), np.where(hole, unit, size)

    def traced(self, tree: Tree, backend: Backend) -> Any:
        """Return the same for kernels."""
        return TracedPatches(self.patches, tree, backend)


class TracedPatches:
    """From an entry to the cell around a place, by what is known of the entry's patch.

    Places are in finest units. Ratios of refinement being any, indices are found by multiplying
    with rounded numbers: places are moved to the middle of their finest unit first, so that an
    index is off for no rounding. That is not needed where all sizes are powers of two.
    """

    def __init__(self, patches: Patches, tree: Tree, backend: Backend) -> None:
        self.backend, self.holes = backend, tree.holes
        self.sizes = make_sizes(patches.sizes, tree.extent, backend)
        self.units = _Units(tree, backend)
        self.exact = self.sizes.exact and bool((np.frexp(tree.units)[0] == 0.5).all())
        rows = patches.rows.copy()
        rows[:, 3] = self.sizes.codes[patches.level] | (rows[:, 3] & TABLED)
        self.rows = from_host(backend.UInt, rows.reshape(-1))
        self.tabled = bool(patches.hidden.any())
        self.blocks = _blocks(patches, tree, backend)
        self.numbers = backend.UInt(patches.numbers) if self.tabled else None
        self.Four = backend.module.Array4u
        # Of indices beyond 32 bits the lowest 32 are wanted.
        small = int(tree.extent.max()) < 1 << 32
        self.Whole: Any = backend.UInt if small else dr.uint64_array_t(backend.UInt)

    def located(self, place: list[Any]) -> list[Any]:
        """Return places moved to the middle of their finest unit, where need be."""
        if self.exact:
            return place
        return [dr.floor(p) + 0.5 for p in place]

    def root(self, place: list[Any]) -> list[Any]:
        """Return the indices of the root's entries around centred places."""
        return [self.backend.UInt(p * i) for p, i in zip(place, self.units.per_root, strict=True)]

    def slot(self, place: list[Any], level: Int, way: Orientation) -> Any:
        """Return the number of an entry of a tree level in its block."""
        slot, stride = self.backend.UInt(0), self.backend.UInt(1)
        for axis, p in enumerate(place):
            per_unit, per_outer, ratio = self.units.at(axis, level)
            local = self._index(p * per_unit) - self._index(p * per_outer) * ratio
            slot = slot + _unmirrored(local, ratio, way.flip[axis]) * stride
            stride = stride * ratio
        return slot

    def cell(
        self, entry: Int, place: list[Any], level: Int, way: Orientation, active: Mask
    ) -> Cell:
        """Return the cells around places, from entries of a tree level that are no blocks.

        Of lanes that are not active anything may be returned.
        """
        patch = entry & NUMBER_MASK
        hole = patch == NONE if self.holes else None
        *row, what = dr.gather(self.Four, self.rows, patch if hole is None else _but(hole, patch))
        size, per_size, count = self.sizes.of(what & (TABLED - 1))
        if hole is not None:  # a hole is as large as its entry
            unit, per_unit = self.units.sizes(level)
            size = [dr.select(hole, u, s) for u, s in zip(unit, size, strict=True)]
            per_size = [dr.select(hole, u, s) for u, s in zip(per_unit, per_size, strict=True)]
        index = [dr.floor(p * s) for p, s in zip(place, per_size, strict=True)]
        low = [i * s for i, s in zip(index, size, strict=True)]
        i, j, k = (
            _unmirrored(self._index(own), n, flip)
            for own, n, flip in zip(index, count, way.flip, strict=True)
        )
        number = row[0] + i * row[1] + j * row[2] + k
        number = self._number(number, active & (what >= TABLED), hole)
        cell = Cell(number, low, size[:1] if self.sizes.alike and hole is None else size)
        if self.blocks is None:
            return cell
        strides = (row[1], row[2], type(number)(1))
        # All bits or none: modulo 2^32, the stride or minus it.
        cell.strides = [(s ^ flip) - flip for s, flip in zip(strides, way.flip, strict=True)]
        cell.end = [
            # Halves keep quotients of whole numbers away from these, however they are rounded.
            dr.fma(dr.floor(dr.fma(own, per_block, 0.5 * per_block)), n, n) * s
            for own, s, (n, per_block) in zip(index, size, self.blocks, strict=True)
        ]
        return cell

    def sizes_of(self, cell: Cell) -> list[Any]:
        """Return the sizes of cells along each axis."""
        return cell.size * (3 // len(cell.size))

    def _index(self, index: Int) -> Any:
        return self.backend.UInt(self.Whole(index))

    def _number(self, number: Int, tabled: Any, hole: Any) -> Any:
        if self.tabled:
            if hole is not None:
                tabled &= ~hole
            seen = dr.gather(self.backend.UInt, self.numbers, number, tabled)
            number = dr.select(tabled, seen, number)
        return number if hole is None else dr.select(hole, NONE, number)


def _blocks(patches: Patches, tree: Tree, backend: Backend) -> list[tuple[Any, Any]] | None:
    """Return the shape of patches, and one over it, where they are blocks of one shape.

    Those of each level are on a lattice of their own, as they are in Athena++ and FLASH. None where
    they are not, or where some of their cells are not to be seen.
    """
    shape, counts = patches.shape[0], tree.extent // patches.sizes
    uneven = (patches.shape != shape).any() or (patches.low % shape).any()
    if uneven or (counts % shape).any() or patches.hidden.any() or tree.holes:
        return None
    return [(backend.opaque(float(n)), backend.opaque(1.0 / n)) for n in shape]


class _Units:
    """Sizes of the entries of a tree's levels."""

    def __init__(self, tree: Tree, backend: Backend) -> None:
        self.backend, units = backend, tree.units.T.astype(float)
        self.per_root = [backend.opaque(1.0 / u[0]) for u in units]
        self.unit = [from_host(backend.Float, u) for u in units]
        self.per_unit = [from_host(backend.Float, 1.0 / u) for u in units]
        ratios = np.concatenate([[tree.shape], tree.ratios]).astype(np.uint32)
        self.ratios = [from_host(backend.UInt, r) for r in ratios.T]
        # Where there is one level of blocks only, its numbers need not be looked up.
        self.below = None
        if len(tree.units) == 2:
            self.below = [
                (backend.opaque(1.0 / u[1]), per_root, dr.opaque(backend.UInt, int(r)))
                for u, per_root, r in zip(units, self.per_root, ratios[1], strict=True)
            ]

    def at(self, axis: int, level: Int) -> tuple[Any, Any, Any]:
        """Return one over the size of a level's entries, of those above, and their ratio."""
        if self.below is not None:
            return self.below[axis]
        Float, UInt = self.backend.Float, self.backend.UInt
        level = UInt(level)
        per_unit = dr.gather(Float, self.per_unit[axis], level)
        per_outer = dr.gather(Float, self.per_unit[axis], level - 1)
        return per_unit, per_outer, dr.gather(UInt, self.ratios[axis], level)

    def sizes(self, level: Int) -> tuple[list[Any], list[Any]]:
        level, Float = self.backend.UInt(level), self.backend.Float
        return (
            [dr.gather(Float, u, level) for u in self.unit],
            [dr.gather(Float, u, level) for u in self.per_unit],
        )


def _but(hole: Any, patch: Any) -> Any:
    return dr.select(hole, 0, patch)


def _unmirrored(index: Int, count: Int, flip: Any) -> Any:
    """Return indices below a count, counted from the other end where `flip` has all bits set."""
    return (index ^ flip) + (count & flip)
