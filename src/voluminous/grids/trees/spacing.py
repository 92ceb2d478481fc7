"""Lengths on a tree of boxes, in kernels: from places, which are whole numbers, to distances."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...backend import dr, from_host
from ...geometry import is_uniform


class Spacing:
    """Distances along the axes of a grid of boxes, in units of its scale.

    Parameters
    ----------
    grid : TreeCells
    backend : Backend
        In double precision.
    """

    def __init__(self, grid: Any, backend: Any) -> None:
        kinds = [_Even if is_uniform(edges) else _Uneven for edges in grid.base_edges]
        self.axes = [
            kind(edges / grid.scale, int(parts), backend)
            for kind, edges, parts in zip(kinds, grid.base_edges, grid.divisions, strict=True)
        ]

    def widths(self, middle: list[Any], size: list[Any]) -> list[Any]:
        """Return the widths of boxes, from middles and sizes in finest units."""
        return [s * axis.unit(m) for axis, m, s in zip(self.axes, middle, size, strict=True)]

    def reaches(self, middle: list[Any], size: list[Any]) -> list[list[Any]]:
        """Return how far to look around boxes for second derivatives: once, by their sizes."""
        return [size]

    def turning(self, axis: Any, middle: list[Any], gradient: list[Any]) -> Any:
        """Return by how much a gradient that turns with an axis changes along it: not at all."""
        return 0.0

    def ways(self, start: list[Any], end: list[Any]) -> list[Any]:
        """Return the distances between places, neither of which is on a wall of base cells."""
        return [axis.way(a, b) for axis, a, b in zip(self.axes, start, end, strict=True)]


class _Even:
    """Base cells of equal width."""

    def __init__(self, edges: np.ndarray, parts: int, backend: Any) -> None:
        width = float(edges[-1] - edges[0]) / ((len(edges) - 1) * parts)
        self.width = dr.opaque(backend.Float, width)

    def unit(self, place: Any) -> Any:
        return self.width

    def way(self, start: Any, end: Any) -> Any:
        return (end - start) * self.width


class _Uneven:
    """Base cells of any width."""

    def __init__(self, edges: np.ndarray, parts: int, backend: Any) -> None:
        self.real, self.UInt = backend.Float, backend.UInt
        self.bases = dr.opaque(backend.Float, 1.0 / parts)
        self.parts = dr.opaque(backend.Float, float(parts))
        self.last = dr.opaque(backend.Float, len(edges) - 2.0)
        self.low = from_host(backend.Float, edges[:-1] - edges[0])
        self.widths = from_host(backend.Float, np.diff(edges) / parts)

    def unit(self, place: Any) -> Any:
        return dr.gather(self.real, self.widths, self.UInt(self._base(place)))

    def way(self, start: Any, end: Any) -> Any:
        bases = [self._base(place) for place in (start, end)]
        first, last = (
            dr.fma(place - base * self.parts, self.unit(place), self._wall(base))
            for place, base in zip((start, end), bases, strict=True)
        )
        # Within a base cell the difference is exact, however small.
        return dr.select(bases[0] == bases[1], (end - start) * self.unit(start), last - first)

    def _base(self, place: Any) -> Any:
        return dr.clip(dr.floor(place * self.bases), 0.0, self.last)

    def _wall(self, base: Any) -> Any:
        return dr.gather(self.real, self.low, self.UInt(base))
