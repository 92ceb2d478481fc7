"""The twin's renderer for spherical grids, with RADMC-3D's sub-steps; and for cylindrical ones."""

from __future__ import annotations

import itertools

import numpy as np

from .curvilinear import Frame, Pieces, pieces
from .schemes import solve_first_order, solve_first_order_radmc, solve_olson_kunasz
from .vertices import vertex_means


def render_curvilinear(
    frame: Frame,
    j: np.ndarray,
    alpha: np.ndarray,
    camera,
    scheme: str,
    largest_turn: float = 0.0,
    radmc_branch: bool = False,
    sub_pixels=None,
) -> dict[str, np.ndarray]:
    """Make an image of cell values (n1, n2, n3, C); see `twin.render`.

    Parameters
    ----------
    largest_turn : float
        ``camera_maxdphi``: how far a step of ``"olson-kunasz"`` may turn around the centre; 0: any.
    """
    iy, ix = np.indices((camera.ny, camera.nx))
    px, py = camera.pixel_centres(iy.ravel(), ix.ravel())
    rays = camera.rays(px, py)
    found = pieces(frame, rays.origins, rays.directions, t_last=rays.t_end)
    points = _Points(rays.origins, rays.directions)
    if largest_turn:
        found = sub_steps(found, points, largest_turn)
    ds = (found.t1 - found.t0).astype(float)[:, None]
    channels = j.shape[3]
    if scheme == "first-order":
        solve = solve_first_order_radmc if radmc_branch else solve_first_order
        solved = solve(
            j.reshape(-1, channels)[found.cell], alpha.reshape(-1, channels)[found.cell], ds
        )
    else:
        vertices = [cyclic_vertex_means(frame, v) for v in (j, alpha)]
        ends = [
            interpolate_in(frame, values, found.cell, points.at(found.ray, t))
            for values in vertices
            for t in (found.t0, found.t1)
        ]
        solved = solve_olson_kunasz(*ends, ds)
    shape = (camera.ny, camera.nx, channels)
    return {k: v.reshape(shape) for k, v in _fold(found.ray, len(px), solved).items()}


class _Points:
    """Points of rays, in extended precision."""

    def __init__(self, origins, directions):
        self.origins, self.directions = (a.astype(np.longdouble) for a in (origins, directions))

    def at(self, ray, t):
        return self.origins[ray] + t[:, None] * self.directions[ray]

    def turn(self, ray, t0, t1):
        """Return RADMC-3D's measure of how far a stretch turns around the centre."""
        r0 = np.linalg.norm(self.at(ray, t0).astype(float), axis=1)
        origin, direction = (a[ray].astype(float) for a in (self.origins, self.directions))
        moment = np.linalg.norm(np.cross(origin, direction), axis=1)
        length = (t1 - t0).astype(float)
        return moment * length / (r0 * (r0 + length))


def sub_steps(found: Pieces, points: _Points, largest: float) -> Pieces:
    """Return pieces cut, one after the other, where they have turned far enough."""
    done, rest = [], found
    while len(rest.ray):
        turn = points.turn(rest.ray, rest.t0, rest.t1)
        long = turn > largest
        stop = rest.t0 + (rest.t1 - rest.t0) * np.where(long, largest / np.where(long, turn, 1), 1)
        stop = np.where(long, stop, rest.t1)
        done.append(Pieces(rest.ray, rest.cell, rest.t0, stop))
        rest = Pieces(rest.ray[long], rest.cell[long], stop[long], rest.t1[long])
    ray, cell, t0, t1 = (
        np.concatenate([getattr(part, name) for part in done])
        for name in ("ray", "cell", "t0", "t1")
    )
    order = np.lexsort((t0, ray))
    return Pieces(ray[order], cell[order], t0[order], t1[order])


def cyclic_vertex_means(frame: Frame, cells: np.ndarray) -> np.ndarray:
    """Return vertex means (n1+1, n2+1, n3+1, C): azimuth cyclic, the midplane mirrored."""
    before = after = [slice(None)] * 3
    if frame.periodic:
        width = [(0, 0)] * 4
        width[frame.phi_axis] = (1, 1)
        cells = np.pad(cells, width, mode="wrap")
        before = [slice(1, -1) if a == frame.phi_axis else s for a, s in enumerate(before)]
    if frame.mirror:
        cells = np.concatenate([cells, cells[:, -1:]], axis=1)
        after = [slice(None), slice(0, -1), slice(None)]
    return vertex_means(cells)[tuple(before)][tuple(after)]


def interpolate_in(frame: Frame, vertices, cell, points) -> np.ndarray:
    """Return vertex values, linear in each own coordinate, at points (N, 3) in given cells."""
    shape = [len(e) - 1 for e in frame.edges]
    index, own = np.unravel_index(cell, shape), frame.coordinates(points)
    weights = []
    for axis, edges in enumerate(frame.edges):
        low, high = edges[index[axis]], edges[index[axis] + 1]
        value = own[:, axis]
        if axis == frame.phi_axis:  # rounding may have put it a full circle away
            middle = 0.5 * (low + high)
            value = middle + np.mod(value - middle + np.pi, 2 * np.pi) - np.pi
        upper = np.clip((value - low) / (high - low), 0, 1).astype(float)
        weights.append((1 - upper, upper))
    total = 0
    for corner in itertools.product((0, 1), repeat=3):
        weight = np.prod([weights[axis][c] for axis, c in enumerate(corner)], axis=0)
        at = tuple(i + c for i, c in zip(index, corner, strict=True))
        total += weight[:, None] * vertices[at]
    return total


def _fold(ray, rays, solved):
    """Return intensity, optical depth and transparency (rays, C), from back to front."""
    b, theta, tau = solved
    out = {
        "intensity": np.zeros((rays, b.shape[1])),
        "optical_depth": np.zeros((rays, b.shape[1])),
        "transparency": np.ones((rays, b.shape[1])),
    }
    first = np.searchsorted(ray, np.arange(rays))
    step = np.arange(len(ray)) - first[ray]
    for k in range(step.max(initial=-1) + 1):
        now = np.flatnonzero(step == k)
        r = ray[now]
        out["intensity"][r] = theta[now] * out["intensity"][r] + b[now]
        out["optical_depth"][r] += tau[now]
        out["transparency"][r] *= theta[now]
    return out
