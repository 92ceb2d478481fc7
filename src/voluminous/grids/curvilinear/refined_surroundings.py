"""Neighbours of leaves of a refined curvilinear grid in straight space: which, and how far.

Vectors are along the directions of r, θ and φ (R, φ and z) at the leaf they start from, which are
the same everywhere on them. So functions of x, y and z are fitted, which are smooth on the axis and
in the centre, where functions of r, θ and φ need not be. Beyond the axis and the centre are the
leaves opposite.

Along an angle with one cell all is symmetric: the same leaf is found wherever that angle is turned
to. Turned by a little it tells that nothing changes on going round.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...backend import dr, from_host
from ...backend.types import Float, Int, Mask
from ...geometry import SPHERICAL
from ..trees.axes import Spacing
from ..trees.tree import Cell
from ..trees.vertices import Surroundings
from .surfaces import FULL_CIRCLE

if TYPE_CHECKING:
    from ...backend.device import Backend


class RefinedSurroundings(Surroundings):
    """Finds the leaves in the eight octants around vertices."""

    grid: Any

    def __init__(self, grid: Any, backend: Backend) -> None:
        super().__init__(grid, backend)
        self.turning, self.mirrored = endless(grid)
        self.parts = [float(p) for p in grid.divisions]

    def spacing(self, backend: Backend) -> ContinuedSpacing:
        return OwnSpacing(self.grid, backend)

    def steps(self, middle: list[Float], size: list[Float], width: list[Float]) -> list[Float]:
        found = [s / parts for s, parts in zip(size, self.parts, strict=True)]
        if any(self.mirrored):
            axis = self.mirrored.index(True)
            image = middle[axis] > self.extent[axis]
            found[axis] = dr.select(image, -found[axis], found[axis])
        return found

    def cell_at(self, place: list[Float], active: Mask) -> tuple[Cell, Mask]:
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


def _turns(place: Float, extent: Float) -> Float:
    """Return how far places are from where they are within the domain: a turn or none."""
    return dr.select(place < 0.0, -extent, dr.select(place > extent, extent, 0.0))


class ContinuedSpacing(Spacing):
    """Differences of the grid's own coordinates, which go on where the grid does."""

    def __init__(
        self,
        grid: Any,
        edges: Sequence[np.ndarray],
        backend: Backend,
        straight: Sequence[bool] = (False,) * 3,
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

    def widths(self, middle: list[Float], size: list[Float]) -> list[Float]:
        return super().widths(self._moved(middle), size)

    def vectors(self, start: list[Float], end: list[Float]) -> list[Float]:
        return super().vectors(self._moved(start), self._moved(end))

    def _moved(self, place: list[Float]) -> list[Float]:
        return [p + n for p, n in zip(place, self.before, strict=True)]


class OwnSpacing(ContinuedSpacing):
    """Differences of the grid's own coordinates, made comparable.

    Radii, which may span many decades, and angles are counted in widths of the base cell that a
    difference starts in.
    """

    def __init__(self, grid: Any, backend: Backend) -> None:
        super().__init__(grid, grid.edges, backend)
        self.parts = [dr.opaque(backend.Float, float(p)) for p in grid.divisions]

    def vectors(self, start: list[Float], end: list[Float]) -> list[Float]:
        moves, bases = super().vectors(start, end), self.widths(start, self.parts)
        return [w / base for w, base in zip(moves, bases, strict=True)]


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


# A place outside, along any axis, also where that closes upon itself.
_NOWHERE = -np.inf
# By how much leaves are turned along angles with one cell, in radian: second derivatives that
# follow from the gradient are off by a quarter of its square.
_TURNED = 2.0**-18
# How far to look around along an angle, at most, in radian; and where, in parts of that.
_WIDEST, _FARTHEST = 2.0, 0.75


class StraightSurroundings(RefinedSurroundings):
    """Finds neighbours of leaves, also beyond the axis and the centre."""

    def __init__(self, grid: Any, backend: Backend) -> None:
        super().__init__(grid, backend)
        self.alike = _alike(grid)
        self.opposite = Opposite(grid, self.alike, np.pi / _TURNED, backend)

    def spacing(self, backend: Backend) -> StraightSpacing:
        return StraightSpacing(self.grid, backend)

    def cell_at(self, place: list[Float], active: Mask) -> tuple[Cell, Mask]:
        # Aside of a place is the leaf itself, not one that is turned.
        whole = [
            dr.round(p - 0.5) if alike else p for p, alike in zip(place, self.alike, strict=True)
        ]
        found = self.opposite.moved(whole)
        inner = [dr.fma(0.0, p, 0.5) if a else p for p, a in zip(found, self.alike, strict=True)]
        cell, there = super().cell_at(inner, active)
        low = [
            p if alike else own for p, alike, own in zip(found, self.alike, cell.low, strict=True)
        ]
        return Cell(cell.number, low, cell.size), there


class StraightSpacing(ContinuedSpacing):
    """Vectors along the directions of the coordinates at their start, in units of the scale."""

    def __init__(self, grid: Any, backend: Backend) -> None:
        angles = [name in ("theta", "phi") for name in grid.coordinates]
        alike = _alike(grid)
        edges = [
            e.mean() + _TURNED * np.array([-0.5, 0.5]) if a else e / (1.0 if angle else grid.scale)
            for e, a, angle in zip(grid.edges, alike, angles, strict=True)
        ]
        super().__init__(grid, edges, backend, alike)
        self.starts = [dr.opaque(backend.Float, float(e[0])) for e in edges]
        self.spherical = tuple(grid.coordinates) == SPHERICAL
        self.alike, self.centre = alike, grid.edges[0][0] == 0.0
        extent = grid.tree.extent
        self.extent = [dr.opaque(backend.Float, float(n)) for n in extent]
        self.open = _open(grid, alike)

    def widths(self, middle: list[Float], size: list[Float]) -> list[Float]:
        own, (first, second, third) = self._own(middle), super().widths(middle, size)
        if self.spherical:
            return [first, own[0] * second, own[0] * dr.sin(own[1]) * third]
        return [first, own[0] * second, third]

    def reaches(self, middle: list[Float], size: list[Float]) -> list[list[Float]]:
        own, width, out = self._own(middle), self.widths(middle, size), list(size)
        if self.spherical:
            if self.centre or self.alike[1]:
                width[1] = self._wider(1, own[0], width[0], middle, width, out)
            least = dr.maximum(width[0], width[1])
            self._wider(2, own[0] * dr.sin(own[1]), least, middle, width, out)
        else:
            self._wider(1, own[0], dr.maximum(width[0], width[2]), middle, width, out)
        return [size, out]

    def _wider(
        self,
        axis: int,
        radius: Float,
        least: Float,
        middle: list[Float],
        width: list[Float],
        size: Float,
    ) -> Float:
        wanted = size[axis] * dr.minimum(least, _WIDEST * radius) / width[axis]
        for end, open_ in zip((0.0, self.extent[axis]), self.open[axis], strict=True):
            if not open_:
                wanted = dr.minimum(wanted, dr.abs(middle[axis] - end) / _FARTHEST)
        wide = dr.maximum(wanted, size[axis])
        width[axis] = width[axis] * wide / size[axis]
        size[axis] = wide
        return width[axis]

    def turning(self, axis: Int, middle: list[Float], gradient: list[Float]) -> Float:
        r, theta, _ = self._own(middle)
        away = gradient[0] / r
        if not self.spherical:
            return dr.select(axis == 1, away, 0.0)
        around = dr.fma(gradient[1], dr.cos(theta) / (r * dr.sin(theta)), away)
        return dr.select(axis == 0, 0.0, dr.select(axis == 1, away, around))

    def vectors(self, start: list[Float], end: list[Float]) -> list[Float]:
        own, differences = self._own(start), super().vectors(start, end)
        return (_spherical if self.spherical else _cylindrical)(own, differences)

    def _own(self, place: list[Float]) -> list[Float]:
        axes = zip(self.axes, self.before, place, self.starts, strict=True)
        return [axis.distance(before, before + p) + start for axis, before, p, start in axes]


def _alike(grid: Any) -> list[bool]:
    counts = grid.tree.extent
    return [
        bool(count == 1) and name in ("theta", "phi")
        for name, count in zip(grid.coordinates, counts, strict=True)
    ]


def _open(grid: Any, alike: list[bool]) -> list[tuple[bool, bool]]:
    turning, mirrored = endless(grid)
    found = [(turns, turns or mirror) for turns, mirror in zip(turning, mirrored, strict=True)]
    if grid.is_periodic and "theta" in grid.coordinates:
        low, high = grid.edges[1][[0, -1]]
        found[1] = (low == 0.0, grid.mirror or high == np.pi)
    return [(a or low, a or high) for a, (low, high) in zip(alike, found, strict=True)]


def _spherical(own: list[Float], differences: list[Float]) -> list[Float]:
    """Return a vector along r, θ and φ, from where it starts and the differences of these.

    Of differences of cosines no digit is lost.
    """
    (r, theta, _), (dr_, dtheta, dphi) = own, differences
    end = r + dr_
    across = end * dr.sin(theta + dtheta)
    inwards = across * _versine(dphi)
    return [
        dr_ - end * _versine(dtheta) - inwards * dr.sin(theta),
        end * dr.sin(dtheta) - inwards * dr.cos(theta),
        across * dr.sin(dphi),
    ]


def _cylindrical(own: list[Float], differences: list[Float]) -> list[Float]:
    outwards, dphi, dz = differences
    end = own[0] + outwards
    return [outwards - end * _versine(dphi), end * dr.sin(dphi), dz]


def _versine(angle: Float) -> Float:
    sine = dr.sin(0.5 * angle)
    return 2.0 * sine * sine


class Opposite:
    """Moves places beyond the axis and the centre to where they are."""

    def __init__(self, grid: Any, alike: list[bool], half: float, backend: Backend) -> None:
        self.real, self.UInt = backend.Float, backend.UInt
        names, edges = list(grid.coordinates), grid.edges
        self.azimuth = names.index("phi")
        self.polar = names.index("theta") if "theta" in names else None
        self.alike, self.half, self.mirrored = alike, half, grid.mirror
        extent = grid.tree.extent
        self.extent = [dr.opaque(backend.Float, float(n)) for n in extent]
        self.centre = edges[0][0] == 0.0
        self.poles = self.polar is not None and not alike[self.polar]
        self.north = self.poles and edges[1][0] == 0.0
        self.south = self.poles and edges[1][-1] == np.pi
        self.around = grid.is_periodic
        self.tables: dict[int, Float] = {}
        if self.around and not alike[self.azimuth] and (self.centre or self.north or self.south):
            fine = grid.fine_edges[self.azimuth]
            turned = np.mod(_middles(fine) + np.pi - fine[0], FULL_CIRCLE) + fine[0]
            self.tables[self.azimuth] = from_host(self.real, _places(fine, turned))
        if self.centre and self.poles and not self.mirrored:
            fine = grid.fine_edges[1]
            self.tables[1] = from_host(self.real, _places(fine, np.pi - _middles(fine)))

    def moved(self, place: list[Float]) -> list[Float]:
        """Return where places are, in finest units."""
        place = list(place)
        if self.north:
            place = self._through_axis(place, place[1] < 0.0, -place[1])
        if self.south:
            end = self.extent[1]
            place = self._through_axis(place, place[1] > end, 2.0 * end - place[1])
        return self._through_centre(place) if self.centre else place

    def _through_axis(self, place: list[Float], beyond: Mask, polar: Float) -> list[Float]:
        out = [place[0], dr.select(beyond, polar, place[1]), place[2]]
        out[2] = dr.select(beyond, self._half_turned(place[2]), place[2])
        return out

    def _through_centre(self, place: list[Float]) -> list[Float]:
        beyond, out = place[0] < 0.0, list(place)
        out[0] = dr.abs(place[0])
        out[self.azimuth] = self._half_turned(place[self.azimuth])
        if self.polar is not None:
            out[1] = self._upside_down(place[1])
        return [dr.select(beyond, new, old) for new, old in zip(out, place, strict=True)]

    def _upside_down(self, place: Float) -> Float:
        if self.alike[1]:
            return -place
        return 2.0 * self.extent[1] - place if self.mirrored else self._looked_up(1, place)

    def _half_turned(self, place: Float) -> Float:
        if self.alike[self.azimuth]:
            return place + self.half
        if not self.around:
            return self.real(_NOWHERE)  # a wedge
        extent = self.extent[self.azimuth]
        wrapped = place - extent * dr.floor(place / extent)
        return self._looked_up(self.azimuth, wrapped)

    def _looked_up(self, axis: int, place: Float) -> Float:
        extent = self.extent[axis]
        inside = (place > 0.0) & (place < extent)
        unit = self.UInt(dr.clip(place, 0.0, extent - 0.5))
        return dr.select(inside, dr.gather(self.real, self.tables[axis], unit, inside), _NOWHERE)


def _middles(edges: np.ndarray) -> np.ndarray:
    return np.asarray(0.5 * (edges[1:] + edges[:-1]))


def _places(edges: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Return the middles of the cells around coordinates, in units of cells; outside, nowhere."""
    inside = (own > edges[0]) & (own < edges[-1])
    return np.where(inside, np.searchsorted(edges, own, side="right") - 0.5, _NOWHERE)
