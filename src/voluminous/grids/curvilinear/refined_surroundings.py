"""The leaves around the vertices of a refined curvilinear grid, and the distances between them.

Azimuth that closes a circle goes on beyond its ends: places there are of leaves a full turn away.
Beyond a mirrored midplane are the images of the leaves above it. Beyond the other ends, poles and
axis included, there is nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...backend import dr
from ..trees.lookup import Cell
from ..trees.spacing import Spacing
from ..trees.vertices import Surroundings


class RefinedSurroundings(Surroundings):
    """Finds the leaves in the eight octants around vertices.

    Parameters
    ----------
    grid : RefinedCells
    backend : Backend
        In double precision.
    """

    def __init__(self, grid: Any, backend: Any) -> None:
        super().__init__(grid.tree, backend)
        self.turning, self.mirrored = endless(grid)
        self.parts = [float(p) for p in grid.divisions]

    def spacing(self, grid: Any, backend: Any) -> ContinuedSpacing:
        return OwnSpacing(grid, backend)

    def steps(self, middle: list[Any], size: list[Any], width: list[Any]) -> list[Any]:
        """Return widths of leaves as gradients count them: as parts of base cells.

        They are negative in images, where what a leaf's gradient tells goes backwards.
        """
        found = [s / parts for s, parts in zip(size, self.parts, strict=True)]
        if any(self.mirrored):
            axis = self.mirrored.index(True)
            image = middle[axis] > self.extent[axis]
            found[axis] = dr.select(image, -found[axis], found[axis])
        return found

    def cell_at(self, place: list[Any], active: Any) -> tuple[Cell, Any]:
        """Return the leaves around places, or what they continue as, and where there is one.

        Corners of the leaves are moved to where they continue.
        """
        inner = list(place)
        for axis, (p, extent) in enumerate(zip(place, self.extent, strict=True)):
            if self.turning[axis]:
                inner[axis] = p - _turns(p, extent)
            elif self.mirrored[axis]:
                inner[axis] = dr.select(p > extent, 2.0 * extent - p, p)
        cell, there = super().cell_at(inner, active)
        low, sizes = list(cell.low), self.lookup.sizes(cell)
        for axis, (p, extent) in enumerate(zip(place, self.extent, strict=True)):
            if self.turning[axis]:
                low[axis] = low[axis] + _turns(p, extent)
            elif self.mirrored[axis]:
                image = 2.0 * extent - low[axis] - sizes[axis]
                low[axis] = dr.select(p > extent, image, low[axis])
        return Cell(cell.number, low, cell.size), there


def _turns(place: Any, extent: Any) -> Any:
    """Return how far places are from where they are within the domain: a turn or none."""
    return dr.select(place < 0.0, -extent, dr.select(place > extent, extent, 0.0))


class ContinuedSpacing(Spacing):
    """Differences of the grid's own coordinates, which go on where the grid does.

    Parameters
    ----------
    grid : RefinedCells
    edges : list of three arrays
        The walls of its base cells, in any unit.
    backend : Backend
        In double precision.
    straight : list of bool, optional
        Axes that go on as they are, instead.
    """

    def __init__(
        self, grid: Any, edges: Any, backend: Any, straight: Sequence[bool] = (False,) * 3
    ) -> None:
        turning, mirrored = (
            [own and not on for own, on in zip(each, straight, strict=True)]
            for each in endless(grid)
        )
        continued = [_continued(*each) for each in zip(edges, turning, mirrored, strict=True)]
        super().__init__(_Frame(continued, grid.divisions), backend)
        # A full turn comes before the first cell.
        before = np.where(turning, grid.tree.extent, 0)
        self.before = [dr.opaque(backend.Float, float(n)) for n in before]

    def widths(self, middle: list[Any], size: list[Any]) -> list[Any]:
        return super().widths(self._moved(middle), size)

    def ways(self, start: list[Any], end: list[Any]) -> list[Any]:
        return super().ways(self._moved(start), self._moved(end))

    def _moved(self, place: list[Any]) -> list[Any]:
        return [p + n for p, n in zip(place, self.before, strict=True)]


class OwnSpacing(ContinuedSpacing):
    """Differences of the grid's own coordinates, made comparable.

    Radii, which may span many decades, and angles are counted in widths of the base cell that a
    difference starts in.

    Parameters
    ----------
    grid : RefinedCells
    backend : Backend
        In double precision.
    """

    def __init__(self, grid: Any, backend: Any) -> None:
        super().__init__(grid, grid.edges, backend)
        self.parts = [dr.opaque(backend.Float, float(p)) for p in grid.divisions]

    def ways(self, start: list[Any], end: list[Any]) -> list[Any]:
        ways, bases = super().ways(start, end), self.widths(start, self.parts)
        return [w / base for w, base in zip(ways, bases, strict=True)]


@dataclass(frozen=True)
class _Frame:
    """Base cells that go on where the grid does; see `Spacing`."""

    base_edges: list[np.ndarray]
    divisions: np.ndarray
    scale: float = 1.0


def endless(grid: Any) -> tuple[list[bool], list[bool]]:
    """Return along which axes a grid closes upon itself, and which have a mirror at their end."""
    turning = [name == "phi" and grid.is_periodic for name in grid.coordinates]
    return turning, [name == "theta" and grid.mirror for name in grid.coordinates]


def _continued(edges: np.ndarray, turning: bool, mirrored: bool) -> np.ndarray:
    if turning:
        turn = edges[-1] - edges[0]
        return np.concatenate([edges[:-1] - turn, edges, edges[1:] + turn])
    return np.append(edges, 2 * edges[-1] - edges[-2::-1]) if mirrored else edges
