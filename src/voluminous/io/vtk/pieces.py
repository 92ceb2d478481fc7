"""Data in pieces, each a box of points: put together."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...errors import FileFormatError
from ...memory import check_memory
from ..payload import checked_shape
from .axes import cell_counts
from .dataset import Array
from .encoded import Encoded


@dataclass(frozen=True)
class Part:
    """An array in one piece."""

    encoded: Encoded
    components: int
    labels: tuple[str, ...] = ()
    unit: str = ""


@dataclass(frozen=True)
class Piece:
    """A box of points and what is on it.

    Attributes
    ----------
    low : tuple of three int
        Index of the first point along x, y and z.
    points : tuple of three int
        Number of points along each; not all positive if the piece is empty.
    parts : dict of Part
        By (point or cell, name).
    coordinates : tuple of Encoded
        Of the points, in formats that list them.
    """

    low: tuple[int, ...]
    points: tuple[int, ...]
    parts: dict[tuple[str, str], Part] = field(default_factory=dict)
    coordinates: tuple[Encoded, ...] = ()


class Whole:
    """All pieces together: the smallest box that holds them.

    Raises
    ------
    FileFormatError
        If there is no piece, or pieces do not fill the box.
    """

    def __init__(self, pieces: Sequence[Piece]) -> None:
        self.pieces = [piece for piece in pieces if all(n > 0 for n in piece.points)]
        if not self.pieces:
            raise FileFormatError("expected a piece with points in it, there is none")
        ends = [np.add(piece.low, piece.points) for piece in self.pieces]
        self.low = tuple(int(n) for n in np.min([piece.low for piece in self.pieces], axis=0))
        counts = np.max(ends, axis=0) - self.low
        self.points = checked_shape(counts, "the number of points")
        there = sum(math.prod(piece.points) for piece in self.pieces)
        if there < math.prod(self.points):
            raise FileFormatError(
                f"the pieces have {there} points, expected at least {math.prod(self.points)} to "
                f"fill a box of {' x '.join(map(str, self.points))}"
            )
        for piece in self.pieces:
            for (at, _), part in piece.parts.items():
                part.encoded.check(math.prod(cell_counts(piece.points, at)) * part.components)

    def arrays(self) -> list[Array]:
        """Return the arrays that all pieces have."""
        shared = [
            key for key in self.pieces[0].parts if all(key in p.parts for p in self.pieces[1:])
        ]
        return [self._array(*key) for key in shared]

    def _array(self, at: str, name: str) -> Array:
        first = self.pieces[0].parts[at, name]
        for piece in self.pieces[1:]:
            other = piece.parts[at, name]
            if (other.encoded.dtype, other.components) != (first.encoded.dtype, first.components):
                raise FileFormatError(f"array {name!r} has another type in some of the pieces")

        def load() -> np.ndarray:
            return self._joined(at, name, first.components, first.encoded.dtype)

        dtype = first.encoded.dtype
        return Array(name, at, first.components, dtype, load, first.labels, first.unit)

    def _joined(self, at: str, name: str, components: int, dtype: np.dtype[Any]) -> np.ndarray:
        """Return the values in all pieces, shape (nz, ny, nx, components)."""
        if len(self.pieces) == 1:
            return _values(self.pieces[0], at, name)
        shape = (*cell_counts(self.points, at)[::-1], components)
        size = math.prod(shape) * (dtype.itemsize + 1)
        check_memory(size, f"putting together {name!r}", "open one of the pieces")
        out, filled = np.empty(shape, dtype), np.zeros(shape[:3], bool)
        for piece in self.pieces:
            values = _values(piece, at, name)
            start = np.subtract(piece.low, self.low)[::-1]
            box = tuple(slice(a, a + n) for a, n in zip(start, values.shape[:3], strict=True))
            out[box], filled[box] = values, True
        if not filled.all():
            raise FileFormatError(
                f"array {name!r}: {np.count_nonzero(~filled)} of {filled.size} values are in none "
                "of the pieces"
            )
        return out

    def lines(self) -> list[np.ndarray]:
        """Return the coordinates of the points along x, y and z."""
        for piece in self.pieces:
            for encoded, count in zip(piece.coordinates, piece.points, strict=True):
                encoded.check(count)
        lines = [np.full(n, np.nan) for n in self.points]
        for piece in self.pieces:
            for axis, encoded in enumerate(piece.coordinates):
                start, count = piece.low[axis] - self.low[axis], piece.points[axis]
                lines[axis][start : start + count] = encoded.values(count)
        return lines

    def mesh(self) -> np.ndarray:
        """Return where all points are, shape (nz, ny, nx, 3)."""
        if len(self.pieces) > 1:
            raise FileFormatError("a structured grid in several pieces is not read; merge them")
        piece = self.pieces[0]
        count = 3 * math.prod(piece.points)
        return piece.coordinates[0].values(count).reshape(*piece.points[::-1], 3)


def _values(piece: Piece, at: str, name: str) -> np.ndarray:
    """Return the values in one piece."""
    part = piece.parts[at, name]
    shape = (*cell_counts(piece.points, at)[::-1], part.components)
    return part.encoded.values(math.prod(shape)).reshape(shape)
