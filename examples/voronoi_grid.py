"""A Voronoi grid in one file: cells are nearer to their point than to all others, within a box.

Rays cross the bisecting planes between neighbours, so that pictures with scheme="first-order" are
exact. Run it for a picture of 20 000 random cells.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import Voronoi, cKDTree

import voluminous as vm
from voluminous.backend import dr, from_host
from voluminous.backend.functions import loop
from voluminous.errors import InputError
from voluminous.grids.box_walk import BoxWalk, make_axis
from voluminous.grids.contract import CellBox, Grid, Segment, check_walk, on_device
from voluminous.units import plain, space_unit, unit_of

# Along each axis of the box: places at which a cell nearby is known, for rays that enter.
_GUESSES = 16


class VoronoiGrid(Grid):
    """Cells around points: each is nearer to its own than to any other.

    Parameters
    ----------
    points : array_like or Quantity, shape (n, 3)
        At least five, all different.
    bounds : array_like, shape (3, 2)
        The box that the cells fill; plain numbers are in the unit of the points.
    unit : str or unit, optional
        Length unit of plain points.

    Attributes
    ----------
    points : array, shape (n, 3)
    cell_volumes : array, shape (n,)
        Exact: a cell is a pyramid over each of its faces.
    first, neighbor : arrays of int
        The neighbours of cell i are ``neighbor[first[i]:first[i + 1]]``.

    Raises
    ------
    InputError
        If points are not such, or outside of the box.
    """

    kind = "voronoi"

    def __init__(self, points: Any, bounds: Any, *, unit: Any = None) -> None:
        self.unit = unit_of(points) or space_unit(unit)
        self.points = np.array(plain(points, self.unit, "points"), np.float64)
        self.bounds = np.array(plain(bounds, self.unit, "bounds"), np.float64)
        if self.points.ndim != 2 or self.points.shape[1] != 3 or len(self.points) < 5:
            raise InputError(f"points must have shape (n, 3), n >= 5, got {self.points.shape}")
        low, high = self.bounds.T
        if not np.all((self.points > low) & (self.points < high)):
            raise InputError("all points must lie within bounds")
        self.tree = cKDTree(self.points)
        if self.tree.query(self.points, 2)[0][:, 1].min() == 0:
            raise InputError("points must be all different")
        self.size = len(self.points)
        self.shape = (self.size,)
        self._divide(low, high)
        self.scale = float(np.median(np.cbrt(self.cell_volumes)))

    def _divide(self, low: np.ndarray, high: np.ndarray) -> None:
        """Find volumes and neighbours: the faces of the box bisect points and their images."""
        images = [self.points]
        for axis, wall in ((a, w[a]) for a in range(3) for w in (low, high)):
            image = self.points.copy()
            image[:, axis] = 2 * wall - image[:, axis]
            images.append(image)
        places = np.concatenate(images)
        diagram = Voronoi(places)
        mine = (diagram.ridge_points < self.size).any(axis=1)
        pairs = diagram.ridge_points[mine]
        faces = [f for f, m in zip(diagram.ridge_vertices, mine, strict=True) if m]
        area = np.array([_area(diagram.vertices[face]) for face in faces])
        height = 0.5 * np.linalg.norm(places[pairs[:, 0]] - places[pairs[:, 1]], axis=1)
        self.cell_volumes = np.zeros(self.size)
        for side in pairs.T:
            own = side < self.size
            np.add.at(self.cell_volumes, side[own], (area * height / 3)[own])
        inner = pairs[(pairs < self.size).all(axis=1)]
        both = np.concatenate([inner, inner[:, ::-1]])
        both = both[np.argsort(both[:, 0], kind="stable")]
        self.first = np.searchsorted(both[:, 0], np.arange(self.size + 1))
        self.neighbor = both[:, 1]

    def cell_centers(self, first: int = 0, last: int | None = None) -> np.ndarray:
        """Return the points, shape (3, n)."""
        return self.points[first:last].T

    def locate(self, points: Any) -> np.ndarray:
        """Return the number of the cell around each point, -1 outside."""
        points = np.asarray(plain(points, self.unit, "points"), np.float64)
        inside = np.all((points >= self.bounds[:, 0]) & (points <= self.bounds[:, 1]), axis=1)
        return np.where(inside, self.tree.query(points)[1], -1)

    def needs_double(self) -> bool:
        """Return True where single precision cannot tell the nearest points apart."""
        nearest = self.tree.query(self.points, 2)[0][:, 1].min()
        return bool(nearest < 256 * np.finfo(np.float32).eps * np.ptp(self.bounds, axis=1).max())

    def walk(self, backend: Any, kind: str = "cells", box: CellBox | None = None) -> Any:
        """Return the walk of rays from cell to cell."""
        check_walk(self, kind, ["cells"], box)
        return on_device(self, backend, kind, lambda: VoronoiWalk(self, backend))


def _area(polygon: np.ndarray) -> float:
    """Return the area of a convex polygon in space, shape (n, 3)."""
    sides = polygon[1:] - polygon[0]
    return 0.5 * float(np.linalg.norm(np.cross(sides[:-1], sides[1:]).sum(axis=0)))


@dataclass
class VoronoiTrack:
    """A ray: from where distances count, its direction, and the distance where it leaves."""

    origin: list[Any]
    direction: list[Any]
    entry: Any
    leave: Any


@dataclass
class VoronoiCursor:
    """Where a ray is."""

    cell: Any
    t: Any
    inside: Any


@dataclass
class Search:
    """A loop over neighbours: the next of them, and the best so far."""

    slot: Any
    best: Any
    cell: Any


class VoronoiWalk(BoxWalk):
    """Rays from cell to cell: through the nearest of the planes ahead.

    Along a ray the points of its cells come ever further: no ray comes to a cell twice.
    """

    def __init__(self, grid: VoronoiGrid, backend: Any) -> None:
        self.backend = backend
        self.scale, self.to_scale = backend.wide(grid.scale), backend.wide(1.0 / grid.scale)
        self.axes = [make_axis(ends, grid.scale, backend) for ends in grid.bounds]
        UInt, Wide = backend.UInt, backend.Wide
        self.first = from_host(UInt, grid.first.astype(np.uint32))
        self.neighbor = from_host(UInt, grid.neighbor.astype(np.uint32))
        # In units of the scale, from the corner of the box: the points, and per neighbour the plane
        # normal · x = offset half way to it.
        self.corner = [backend.wide(c) for c in grid.bounds[:, 0]]
        points = (grid.points - grid.bounds[:, 0]) / grid.scale
        there = points[grid.neighbor]
        here = np.repeat(points, np.diff(grid.first), axis=0)
        normal = there - here
        self.points = [from_host(Wide, p) for p in points.T]
        self.normal = [from_host(Wide, n) for n in normal.T]
        self.offset = from_host(Wide, np.sum(normal * 0.5 * (here + there), axis=1))
        # Lookup of a cell near the place where a ray enters.
        steps = np.linspace(0, 1, _GUESSES)
        lattice = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), -1).reshape(-1, 3)
        places = grid.bounds[:, 0] + lattice * np.ptp(grid.bounds, axis=1)
        self.guess = from_host(UInt, grid.tree.query(places)[1].astype(np.uint32))
        sides = np.ptp(grid.bounds, axis=1) / grid.scale
        self.per_guess = [backend.wide((_GUESSES - 1) / s) for s in sides]

    def _start(
        self, sides: list[Any], arrive: Any, begin: Any, inside: Any, bound: Any
    ) -> tuple[VoronoiTrack, VoronoiCursor]:
        here = arrive * self.scale
        origin = [
            (dr.fma(here, side.direction, side.origin) - corner) * self.to_scale
            for side, corner in zip(sides, self.corner, strict=True)
        ]
        direction = [side.direction for side in sides]
        leave = dr.minimum(dr.minimum(sides[0].leave, sides[1].leave), sides[2].leave) - arrive
        leave = self.backend.Float(leave)
        if bound is not None:
            leave = dr.minimum(leave, bound)
        track = VoronoiTrack(origin, direction, arrive, leave)
        place = [dr.fma(begin, d, o) for o, d in zip(origin, direction, strict=True)]
        t = self.backend.Float(begin)
        inside = inside & (t < leave)
        return track, VoronoiCursor(self._cell_at(place, inside), t, inside)

    def _cell_at(self, place: list[Any], active: Any) -> Any:
        """Return the cell around a place: from neighbour to neighbour, ever nearer."""
        UInt, flat = self.backend.UInt, self.backend.UInt(0)
        for x, per_length in zip(place, self.per_guess, strict=True):
            index = dr.clip(dr.round(x * per_length), 0, _GUESSES - 1)
            flat = flat * _GUESSES + UInt(index)
        cell = dr.gather(UInt, self.guess, flat, active)

        def nearer(state: Search) -> tuple[Search]:
            other = dr.gather(UInt, self.neighbor, state.slot, active)
            away = self._square(other, place, active)
            better = away < state.best
            # A nearer one: go on with its neighbours, from the first.
            cell = dr.select(better, other, state.cell)
            begin = dr.gather(UInt, self.first, cell, active)
            slot = dr.select(better, begin, state.slot + 1)
            return (Search(slot, dr.select(better, away, state.best), cell),)

        def unsure(state: Search) -> Any:
            return active & (state.slot < dr.gather(UInt, self.first, state.cell + 1, active))

        start = dr.gather(UInt, self.first, cell, active)
        state = Search(start, self._square(cell, place, active), cell)
        (state,) = loop((state,), unsure, nearer, label="nearest point")
        return state.cell

    def _square(self, cell: Any, place: list[Any], active: Any) -> Any:
        """Return the squared distance of a place from the point of a cell."""
        away = [
            dr.gather(self.backend.Wide, p, cell, active) - x
            for p, x in zip(self.points, place, strict=True)
        ]
        return sum(a * a for a in away)

    def next(self, track: VoronoiTrack, cursor: VoronoiCursor) -> tuple[Segment, VoronoiCursor]:
        """Return the segment through the present cell, and the cursor in the next one."""
        UInt, Wide, active = self.backend.UInt, self.backend.Wide, cursor.inside
        end = dr.gather(UInt, self.first, cursor.cell + 1, active)

        def look(state: Search) -> tuple[Search]:
            going = active & (state.slot < end)
            normal = [dr.gather(Wide, n, state.slot, going) for n in self.normal]
            offset = dr.gather(Wide, self.offset, state.slot, going)
            toward = sum(n * d for n, d in zip(normal, track.direction, strict=True))
            t = (offset - sum(n * o for n, o in zip(normal, track.origin, strict=True))) / toward
            nearer = (toward > 0.0) & (t < state.best)
            cell = dr.gather(UInt, self.neighbor, state.slot, going)
            best = dr.select(nearer, t, state.best)
            return (Search(state.slot + 1, best, dr.select(nearer, cell, state.cell)),)

        def left(state: Search) -> Any:
            return active & (state.slot < end)

        start = dr.gather(UInt, self.first, cursor.cell, active)
        state = Search(start, Wide(dr.inf) + 0 * track.entry, cursor.cell)
        (state,) = loop((state,), left, look, label="planes ahead")
        wall = dr.maximum(self.backend.Float(state.best), cursor.t)
        t = dr.minimum(wall, track.leave)
        segment = Segment(cursor.cell, t - cursor.t, cursor.t, t, active, None)
        return segment, VoronoiCursor(state.cell, t, active & (wall < track.leave))


def main() -> None:
    """Save a picture of a ball of random cells."""
    rng = np.random.default_rng(1)
    grid = VoronoiGrid(rng.uniform(-1, 1, (20_000, 3)), [(-1, 1)] * 3)
    radius = np.linalg.norm(grid.cell_centers(), axis=0)
    volume = vm.Volume(grid, density=np.exp(-4 * radius**2))
    vm.render(volume, scheme="first-order").save("voronoi.png")


if __name__ == "__main__":
    main()
