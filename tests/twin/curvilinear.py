"""Which cells of a spherical or cylindrical grid a ray crosses: all roots, sorted; slow and plain.

Every surface is met where a quadratic polynomial along the whole line is zero (both sheets of a
cone, both halves of a plane): lines are cut there, and the middle of each piece tells the cell.
Cuts too many do no harm: pieces in the same cell are joined again.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

Real = np.longdouble


@dataclass(frozen=True)
class Frame:
    """Edges of a grid.

    ``system`` is ``"spherical"`` (r, theta, phi) or ``"cylindrical"`` (R, phi, z); ``mirror`` folds
    what is below the midplane onto what is above.
    """

    system: str
    edges: tuple[np.ndarray, np.ndarray, np.ndarray]
    mirror: bool = False

    @classmethod
    def of(cls, grid) -> Frame:
        """Return the frame of a grid of the package."""
        return cls(grid.kind, grid.edges, grid.mirror)

    @property
    def phi_axis(self) -> int:
        """Which axis is azimuth."""
        return 2 if self.system == "spherical" else 1

    @property
    def periodic(self) -> bool:
        """True if azimuth is a full circle."""
        phi = self.edges[self.phi_axis]
        return bool(phi[-1] - phi[0] > 2 * np.pi - 1e-9)

    def coordinates(self, points: np.ndarray) -> np.ndarray:
        """Return the grid's own coordinates (..., 3) of points (..., 3)."""
        x, y, z = np.moveaxis(points, -1, 0)
        across, start = np.sqrt(x * x + y * y), self.edges[self.phi_axis][0]
        phi = np.mod(np.arctan2(y, x) - start, 2 * np.pi) + start
        if self.system == "cylindrical":
            return np.stack([across, phi, z], axis=-1)
        z = np.abs(z) if self.mirror else z
        return np.stack([np.sqrt(across**2 + z * z), np.arctan2(across, z), phi], axis=-1)

    def cells(self, points: np.ndarray) -> np.ndarray:
        """Return the flat cell number of points (..., 3), -1 outside."""
        inside, flat = True, 0
        for axis, edges in enumerate(self.edges):
            value = self.coordinates(points)[..., axis]
            index = np.searchsorted(edges, value, side="right") - 1
            index = np.where(value == edges[-1], len(edges) - 2, index)
            if axis == self.phi_axis and self.periodic:  # all but for rounding
                index = np.clip(index, 0, len(edges) - 2)
            inside &= (index >= 0) & (index < len(edges) - 1)
            flat = flat * (len(edges) - 1) + index
        return np.where(inside, flat, -1)


@dataclass(frozen=True)
class Pieces:
    """Pieces of rays in one cell each, sorted by ray and distance; arrays of shape (N,)."""

    ray: np.ndarray
    cell: np.ndarray
    t0: np.ndarray
    t1: np.ndarray


def crossings(frame: Frame, origins: np.ndarray, directions: np.ndarray, only_ends=False):
    """Return the distances (R, n) of all crossings with walls, NaN where there is none.

    ``only_ends`` leaves out walls between cells.
    """
    o, d = origins.astype(Real), directions.astype(Real)
    # From the closest approach to the centre on, and across the axis: nothing cancels there.
    near = -np.sum(o * d, axis=1)
    p = o + near[:, None] * d
    pick = (lambda e: e[[0, -1]]) if only_ends else (lambda e: e)
    edges = [pick(np.asarray(e, dtype=Real)) for e in frame.edges]
    families = _spherical if frame.system == "spherical" else _cylindrical
    columns = [t + near for t in families(frame, edges, p, d)]
    return np.stack(columns, axis=1).astype(Real)


def _spherical(frame, edges, p, d):
    r, theta, phi = edges
    square, radius2 = np.sum(d * d, axis=1), np.sum(p * p, axis=1)
    along = np.sum(p * d, axis=1)
    yield from (t for e in r for t in _roots(square, along, radius2 - e * e))
    for angle in theta:
        if abs(angle - np.pi / 2) < 1e-12:  # a double root
            yield from 2 * [_quotient(-p[:, 2], d[:, 2])]
            continue
        c2, s2 = np.cos(angle) ** 2, np.sin(angle) ** 2
        a = s2 * d[:, 2] ** 2 - c2 * (d[:, 0] ** 2 + d[:, 1] ** 2)
        b = s2 * d[:, 2] * p[:, 2] - c2 * (d[:, 0] * p[:, 0] + d[:, 1] * p[:, 1])
        c = s2 * p[:, 2] ** 2 - c2 * (p[:, 0] ** 2 + p[:, 1] ** 2)
        yield from _roots(a, b, c)
    yield from _half_planes(phi, p, d)


def _cylindrical(frame, edges, p, d):
    R, phi, z = edges
    a = d[:, 0] ** 2 + d[:, 1] ** 2
    b = d[:, 0] * p[:, 0] + d[:, 1] * p[:, 1]
    for e in R:
        yield from _roots(a, b, p[:, 0] ** 2 + p[:, 1] ** 2 - e * e)
    yield from _half_planes(phi, p, d)
    yield from (_quotient(e - p[:, 2], d[:, 2]) for e in z)


def _half_planes(phi, p, d):
    for angle in phi:
        c, s = np.cos(angle), np.sin(angle)
        yield _quotient(s * p[:, 0] - c * p[:, 1], c * d[:, 1] - s * d[:, 0])


def _roots(a, b, c):
    """Return the real roots of a t² + 2 b t + c, without cancellation."""
    discriminant = b * b - a * c
    with np.errstate(invalid="ignore"):
        q = -(b + np.where(b < 0, -1, 1) * np.sqrt(discriminant))
    return _quotient(q, a), _quotient(c, q)


def _quotient(a, b):
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        return np.where(b != 0, a / b, np.nan)


def pieces(frame: Frame, origins, directions, t_first=-np.inf, t_last=np.inf) -> Pieces:
    """Cut rays (R, 3) at all walls between two distances; pieces in no cell are left out."""
    cuts = crossings(frame, origins, directions)
    far = np.nanmax(np.where(np.isfinite(cuts), np.abs(cuts), 0), axis=1, initial=1) * 2
    first = np.broadcast_to(np.maximum(t_first, -far), len(cuts))
    last = np.broadcast_to(np.minimum(t_last, far), len(cuts))
    last = np.maximum(first, last)
    cuts = np.where(np.isfinite(cuts), cuts, first[:, None])
    cuts = np.clip(cuts, first[:, None], last[:, None])
    t = np.sort(np.concatenate([first[:, None], cuts, last[:, None]], axis=1), axis=1)
    middle = 0.5 * (t[:, 1:] + t[:, :-1])
    points = origins[:, None, :] + middle[..., None] * directions[:, None, :]
    cell = np.where(t[:, 1:] > t[:, :-1], frame.cells(points), -1)
    ray, column = np.nonzero(cell >= 0)
    found = Pieces(ray, cell[ray, column], t[ray, column], t[ray, column + 1])
    return _joined(frame, found, origins, directions)


def _joined(frame, found: Pieces, origins, directions) -> Pieces:
    """Return the pieces with neighbours in the same cell joined (not across a mirror)."""
    z = origins[found.ray, 2] + 0.5 * (found.t0 + found.t1) * directions[found.ray, 2]
    side = (z < 0) if frame.mirror else np.zeros(len(z), bool)
    begins = np.ones(len(found.ray), bool)
    begins[1:] = (
        (np.diff(found.ray) != 0)
        | (np.diff(found.cell) != 0)
        | (side[1:] != side[:-1])
        | (found.t0[1:] != found.t1[:-1])
    )
    first = np.flatnonzero(begins)
    last = np.append(first[1:], len(begins))[: len(first)] - 1
    return Pieces(found.ray[first], found.cell[first], found.t0[first], found.t1[last])


def way_inside(frame: Frame, origins, directions, t_first=-np.inf, t_last=np.inf) -> np.ndarray:
    """Return the length (R,) of rays that is in any cell."""
    cuts = crossings(frame, origins, directions, only_ends=True)
    enter, leave = chord(frame, origins, directions)
    first, last = np.maximum(t_first, enter)[:, None], np.minimum(t_last, leave)[:, None]
    cuts = np.where(np.isfinite(cuts), cuts, first)
    cuts = np.sort(np.clip(cuts, first, np.maximum(first, last)), axis=1)
    middle = (0.5 * (cuts[:, 1:] + cuts[:, :-1])).astype(float)
    points = origins[:, None, :] + middle[..., None] * directions[:, None, :]
    inside = frame.cells(points) >= 0
    return np.sum(np.where(inside, np.diff(cuts, axis=1), 0), axis=1)


def chord(frame: Frame, origins, directions) -> tuple[np.ndarray, np.ndarray]:
    """Return the distances (R,) at which lines enter and leave the outermost surface; or zeros."""
    o, d = origins.astype(Real), directions.astype(Real)
    part = slice(0, 3 if frame.system == "spherical" else 2)
    square = np.sum(d[:, part] ** 2, axis=1)
    parallel = square < 1e-30
    square = np.where(parallel, 1, square)
    near = np.where(parallel, 0, -np.sum(o[:, part] * d[:, part], axis=1)) / square
    inner = frame.edges[0][-1] ** 2 - np.sum((o + near[:, None] * d)[:, part] ** 2, axis=1)
    half = np.sqrt(np.maximum(inner, 0) / square)
    half = np.where(parallel, np.where(inner > 0, np.inf, 0), half)
    enter, leave = near - half, near + half
    if frame.system == "cylindrical":
        ends = [_quotient(z - o[:, 2], d[:, 2]) for z in frame.edges[2][[0, -1]]]
        enter = np.fmax(enter, np.minimum(*ends))
        leave = np.fmin(leave, np.maximum(*ends))
        low, high = frame.edges[2][[0, -1]]
        beside = (d[:, 2] == 0) & ((o[:, 2] < low) | (o[:, 2] > high))
        leave = np.where(beside, enter, leave)
    met = enter < leave
    return np.where(met, enter, 0), np.where(met, leave, 0)
