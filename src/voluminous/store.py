"""A volume in pieces: boxes of its fields, read from a file or sliced from arrays."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from .errors import FileFormatError, InputError, unknown_name
from .fields import held_dtype

if TYPE_CHECKING:
    from .deferred import Fields


class Store(Protocol):
    """Fields of which any box can be read: on three axes, or one of the leaves of a refined grid.

    Attributes
    ----------
    chunks : tuple of int
        Cells of a chunk along each axis, at every level; those at the upper ends may be smaller.
    levels : int
        Number of resolutions; 1 if there are only the cells themselves.
    """

    @property
    def chunks(self) -> tuple[int, ...]:
        """Cells of a chunk."""

    @property
    def levels(self) -> int:
        """Number of resolutions."""

    def shape(self, level: int) -> tuple[int, ...]:
        """Return the number of cells of a level along each axis; level 0 is the finest."""

    def read(
        self, name: str, low: Sequence[int], high: Sequence[int], level: int = 0
    ) -> np.ndarray:
        """Return the cells ``low <= i < high`` of a level, in the field's type and unit.

        Returns
        -------
        ndarray
            In C order. A cell of level 1 or more is the mean of the cells that it covers.

        Raises
        ------
        UnknownNameError
            If there is no such field.
        InputError
            If there is no such level, or the box is empty or reaches beyond it.
        """

    def extremes(self, name: str, level: int = 0) -> np.ndarray | None:
        """Return the least and the largest value in each chunk of a level, if they are stored.

        Returns
        -------
        ndarray or None
            Shape ``(kx, ky, kz, 2)``, or ``(k, 2)``: of the cells of level 0 that a chunk covers,
            and so of its own; NaN if one of them is.
        """


class FieldStore:
    """The `Store` of a volume: its files as far as these can be read in pieces, else its arrays."""

    # Cells along the sides of a chunk where a file does not say: 8 MiB of single precision.
    side = 128
    # Cells of a refined grid in a chunk: 1 MiB of single precision.
    leaves = 1 << 18

    def __init__(self, shape: Sequence[int], fields: Fields) -> None:
        self._fields = fields
        self._trusts = True
        pieces = [p for p in map(fields.pieces, fields) if p is not None]
        first = next((p for p in pieces if p.chunks), None)
        usual = (self.side,) * 3 if len(shape) == 3 else (self.leaves,)
        stored = list(first.chunks if first and first.chunks else usual)
        if first is not None and first.extremes is None:
            stored = _several(stored)
        self.chunks = tuple(min(c, n) for c, n in zip(stored, shape, strict=True))
        # Levels that not all files have are left out; those of arrays are made when asked for.
        coarser = min((p.coarser for p in pieces), key=len, default=())
        self._shapes = [tuple(shape), *coarser]
        if any(p.coarser[: len(coarser)] != coarser for p in pieces):
            self._shapes = self._shapes[:1]

    @property
    def levels(self) -> int:
        """Number of resolutions."""
        return len(self._shapes)

    def shape(self, level: int) -> tuple[int, ...]:
        """Return the number of cells of a level along each axis."""
        if not 0 <= level < self.levels:
            raise InputError(
                f"level must be from 0 to {self.levels - 1}, the coarsest that is stored, got "
                f"{level!r}"
            )
        return self._shapes[level]

    def read(
        self, name: str, low: Sequence[int], high: Sequence[int], level: int = 0
    ) -> np.ndarray:
        """Return the cells ``low <= i < high`` of a level."""
        self._check(name)
        shape = self.shape(level)
        if not all(0 <= a < b <= n for a, b, n in zip(low, high, shape, strict=True)):
            raise InputError(
                f"a box needs 0 <= low < high <= {shape}, got {tuple(low)} and {tuple(high)}"
            )
        values = self._fields.box(name, low, high, level)
        if values is None and level == 0:
            values = self._fields[name][tuple(map(slice, low, high))]
        elif values is None:
            factors = self._factors(level)
            first = [a * f for a, f in zip(low, factors, strict=True)]
            last = [min(b * f, n) for b, f, n in zip(high, factors, self._shapes[0], strict=True)]
            values = means(self.read(name, first, last), factors)
        self._check_range(name, low, high, level, values)
        return np.ascontiguousarray(values, held_dtype(values.dtype))

    def extremes(self, name: str, level: int = 0) -> np.ndarray | None:
        """Return the least and the largest value in each chunk of a level, if they are stored."""
        self._check(name)
        self.shape(level)
        table = self._fields.piece_extremes(name) if self._trusts else None
        return None if table is None else _reduced(table, self._factors(level))

    def without_ranges(self) -> FieldStore:
        """Return the store as if no ranges were stored: who writes new ones trusts no others."""
        other = FieldStore(self._shapes[0], self._fields)
        other._trusts = False
        return other

    def _check_range(
        self, name: str, low: Sequence[int], high: Sequence[int], level: int, values: np.ndarray
    ) -> None:
        """Refuse cells that are not what the stored ranges tell: pictures are planned by these."""
        table = self._fields.piece_extremes(name) if self._trusts else None
        pieces = self._fields.pieces(name)
        if table is None or pieces is None or pieces.chunks is None:
            return
        # Of all chunks a table may be large: only those of the box are looked at.
        factors = self._factors(level)
        sides = list(zip(low, high, pieces.chunks, factors, strict=True))
        table = _reduced(
            table[tuple(slice(a // c * f, -(-b // c) * f) for a, b, c, f in sides)], factors
        )
        walls = [
            [a, *range((a // c + 1) * c, b, c), b]
            for a, b, c in zip(low, high, pieces.chunks, strict=True)
        ]
        for place in np.ndindex(*(len(w) - 1 for w in walls)):
            ends = [(w[i], w[i + 1]) for w, i in zip(walls, place, strict=True)]
            cells = values[tuple(slice(a - f, b - f) for (a, b), f in zip(ends, low, strict=True))]
            number = tuple(a // c for (a, _), c in zip(ends, pieces.chunks, strict=True))
            first = (a // c for a, _, c, _ in sides)
            least, largest = table[tuple(i - k for i, k in zip(number, first, strict=True))]
            # A chunk with a NaN has no range.
            if np.isnan(least) or (least <= cells.min() and cells.max() <= largest):
                continue
            with self._fields.reading():
                raise FileFormatError(
                    f"field {name!r}, level {level}, chunk {number}: cells are from {cells.min()} "
                    f"to {cells.max()}, but its stored range is from {least} to {largest}: it was "
                    "damaged, or changed after the ranges were stored; convert the file again"
                )

    def _check(self, name: str) -> None:
        if name not in self._fields:
            raise unknown_name("field", name, self._fields)

    def _factors(self, level: int) -> tuple[int, ...]:
        factors = level_factors(self._shapes[0], self._shapes[level])
        return factors or (1,) * len(self._shapes[0])


def _reduced(table: np.ndarray, factors: Sequence[int]) -> np.ndarray:
    for axis, factor in enumerate(factors):
        if factor > 1:
            starts = np.arange(0, table.shape[axis], factor)
            low = np.minimum.reduceat(table[..., 0], starts, axis)
            table = np.stack([low, np.maximum.reduceat(table[..., 1], starts, axis)], -1)
    return table


def _several(chunk: Sequence[int]) -> list[int]:
    sides = [int(n) for n in chunk]
    for axis in np.argsort(sides, kind="stable"):
        others = math.prod(sides) // sides[axis]
        side = FieldStore.side
        most = min(side, side**3 // others) if len(sides) == 3 else FieldStore.leaves
        sides[axis] *= max(1, most // sides[axis])
    return sides


def level_factors(fine: Sequence[int], coarse: Sequence[int]) -> tuple[int, ...] | None:
    """Return the powers of two by which a shape is coarser than another; None if it is not.

    Examples
    --------
    >>> level_factors((9, 9, 4), (5, 2, 4)), level_factors((9, 9, 9), (4, 4, 4))
    ((2, 8, 1), None)
    """
    factors = []
    for n, k in zip(fine, coarse, strict=True):
        powers = [1 << p for p in range(n.bit_length() + 1) if -(-n >> p) == k]
        # All but the least make the same number only where one cell is left.
        factors.append(powers[0] if powers else 0)
    return tuple(factors) if all(factors) else None


def means(values: np.ndarray, factors: Sequence[int]) -> np.ndarray:
    """Return the means of groups of cells of a field, of its type; NaN where all of them are NaN.

    Groups at the upper ends may be of fewer cells. Means of integers are rounded.
    """
    return weighted_means(values, factors)[0]


def weighted_means(
    values: np.ndarray, factors: Sequence[int], weights: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return `means` of values, each of which counts as so many cells, and how many count in them.

    NaN does not count.
    """
    known = None
    if values.dtype.kind == "f" and np.isnan(values.min()):
        known = ~np.isnan(values)
        weights = known.astype(np.float64) if weights is None else weights * known
    if weights is None or weights.min() == weights.max():
        total = _sums(values.astype(np.float64), factors)
        count: Any = 1.0 if weights is None else weights.flat[0]
        for axis, (n, factor) in enumerate(zip(values.shape, factors, strict=True)):
            counts = np.minimum(factor, n - factor * np.arange(total.shape[axis]))
            counts = counts.reshape([-1 if a == axis else 1 for a in range(3)])
            total /= counts
            count = count * counts
    else:
        count = _sums(weights.astype(np.float64), factors)
        some = values if known is None else np.where(known, values, 0)
        with np.errstate(invalid="ignore"):
            total = _sums(some.astype(np.float64) * weights, factors) / count
    rounded = total if values.dtype.kind == "f" else np.rint(total)
    return np.asarray(rounded.astype(values.dtype)), count


def _sums(values: np.ndarray, factors: Sequence[int]) -> np.ndarray:
    for axis, factor in enumerate(factors):
        for _ in range(factor.bit_length() - 1):
            lines = np.moveaxis(values, axis, 0)
            pairs = lines[::2].copy()
            pairs[: len(lines) // 2] += lines[1::2]
            values = np.moveaxis(pairs, 0, axis)
    return values
