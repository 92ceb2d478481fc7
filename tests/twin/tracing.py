"""The twin's renderer: rays of a camera through a rectilinear grid, in batches."""

from __future__ import annotations

import numpy as np

from .camera import Camera
from .radmc import radmc_steps
from .schemes import (
    solve_first_order,
    solve_first_order_radmc,
    solve_olson_kunasz,
    solve_second_order,
)
from .traverse import Segments, segments
from .vertices import interpolate, vertex_means

CROSSINGS_PER_BATCH = 2**17  # bounds the memory: some hundred bytes per crossing and channel

SCHEMES = ("first-order", "second-order", "olson-kunasz")


def render(
    edges,
    j: np.ndarray,
    alpha: np.ndarray,
    camera: Camera,
    scheme: str,
    background=0.0,
    samples: int | str = 1,
    radmc_branch: bool = False,
    interpolate_source: bool = False,
    radmc_rounding: bool = False,
    pixels=None,
) -> dict[str, np.ndarray]:
    """Make an image of a rectilinear grid of emissivities and extinctions.

    Parameters
    ----------
    edges : sequence of 3 numpy.ndarray
        Cell walls along x, y, z.
    j, alpha : numpy.ndarray
        Emissivity and extinction of the cells, shape (nx, ny, nz, C), per length.
    camera : Camera
        Which rays.
    scheme : str
        One of ``SCHEMES``. Second order takes j and alpha linear in distance between the values
        at the cell walls; ``olson-kunasz`` is RADMC-3D's second order.
    background : float or array of shape (C,)
        Intensity behind everything.
    samples : int or "flux-conserving"
        n: the mean of n x n rays at the centres of equal sub-pixels. ``"flux-conserving"``: as
        many as RADMC-3D takes, see `flux_conserving_samples`.
    radmc_branch : bool
        First order as RADMC-3D does it: linear for tau <= 1e-4; nothing emitted where alpha = 0.
    interpolate_source : bool
        ``olson-kunasz`` with S = j / alpha in place of j averaged and interpolated.
    radmc_rounding : bool
        Positions and path lengths rounded as in RADMC-3D, see `radmc_steps`.
    pixels : pair of integer arrays, optional
        Row and column numbers (iy, ix), broadcast together; all pixels if not given.

    Returns
    -------
    dict
        ``intensity``, ``optical_depth`` and ``transparency``, each of shape (ny, nx, C), or the
        broadcast shape of ``pixels`` and C; means over the samples of a pixel.
    """
    iy, ix = np.ogrid[: camera.ny, : camera.nx] if pixels is None else pixels
    iy, ix = np.broadcast_arrays(iy, ix)
    n = flux_conserving_samples(edges, camera) if samples == "flux-conserving" else samples
    solve = _Solver(edges, j, alpha, scheme, radmc_branch, interpolate_source)
    px, py = camera.pixel_centres(iy.ravel(), ix.ravel())
    px, py = _sub_pixels(px, py, camera.pixel_size, n)
    parts = []
    for batch in _batches(len(px), sum(len(e) for e in edges)):
        rays = camera.rays(px[batch], py[batch])
        pieces = segments(edges, rays.origins, rays.directions, rays.t_end)
        if radmc_rounding:
            pieces = radmc_steps(edges, rays, camera.point, pieces)
        parts.append(_fold(pieces, len(rays.origins), solve, background))
    names = ("intensity", "optical_depth", "transparency")
    columns = zip(*parts, strict=True)
    shape = (*iy.shape, n * n, j.shape[3])
    return {
        name: np.concatenate(column).reshape(shape).mean(axis=-2)
        for name, column in zip(names, columns, strict=True)
    }


def flux_conserving_samples(edges, camera: Camera) -> int:
    """Return n such that RADMC-3D's flux-conserving recursion takes n x n rays in every pixel.

    RADMC-3D quarters a pixel while it is wider than the smallest cell met by its central ray,
    for which a grid without refinement always takes the first cell's width along x. So
    the criterion is the same for all rays, those that miss the grid included, and the recursion
    ends at the same level everywhere: the sub-pixels form a uniform grid.
    """
    width, n = max(camera.pixel_size), 1
    while width / n > edges[0][1] - edges[0][0]:
        n *= 2
    return n


def _sub_pixels(px, py, pixel_size, n):
    """Centres (R * n * n,) of n x n equal parts of the pixels (R,), pixel after pixel."""
    offset = (np.arange(n) - (n - 1) / 2) / n
    x = px[:, None, None] + offset[None, None, :] * pixel_size[0]
    y = py[:, None, None] + offset[None, :, None] * pixel_size[1]
    return tuple(v.ravel() for v in np.broadcast_arrays(x, y))


def _batches(rays: int, crossings_per_ray: int):
    size = max(CROSSINGS_PER_BATCH // crossings_per_ray, 1)
    return [slice(first, first + size) for first in range(0, rays, size)]


def _fold(pieces: Segments, rays: int, solve: _Solver, background):
    """Return intensity, optical depth and transparency, each (rays, C), from back to front."""
    b, theta, tau = solve(pieces)
    shape = (rays, b.shape[1])
    intensity = np.array(np.broadcast_to(background, shape), dtype=float)
    depth, transparency = np.zeros(shape), np.ones(shape)
    for now in pieces.steps():
        ray = pieces.ray[now]
        intensity[ray] = theta[now] * intensity[ray] + b[now]
        depth[ray] += tau[now]
        transparency[ray] *= theta[now]
    return intensity, depth, transparency


class _Solver:
    """Turn segments into (b, theta, tau), each of shape (N, C)."""

    def __init__(self, edges, j, alpha, scheme, radmc_branch, interpolate_source):
        if scheme not in SCHEMES:
            raise ValueError(f"scheme must be one of {SCHEMES}, not {scheme!r}")
        self.edges, self.scheme = edges, scheme
        self.constant = solve_first_order_radmc if radmc_branch else solve_first_order
        self.interpolate_source = interpolate_source
        if scheme == "olson-kunasz":  # RADMC-3D keeps S and gets j back from it
            source = j / (alpha + 1e-199)
            j = source if interpolate_source else source * alpha
        if scheme != "first-order":
            j, alpha = vertex_means(j), vertex_means(alpha)
        self.j, self.alpha = j, alpha

    def __call__(self, pieces: Segments):
        ds = pieces.length[:, None]
        if self.scheme == "first-order":
            return self.constant(self.j[pieces.cell], self.alpha[pieces.cell], ds)
        a0, a1 = self._at_ends(self.alpha, pieces)
        j0, j1 = self._at_ends(self.j, pieces)
        if self.scheme == "second-order":
            return solve_second_order(j0, j1, a0, a1, ds)
        if self.interpolate_source:
            j0, j1 = j0 * (a0 + 1e-99), j1 * (a1 + 1e-99)
        return solve_olson_kunasz(j0, j1, a0, a1, ds)

    def _at_ends(self, vertices, pieces: Segments):
        ends = (pieces.start, pieces.end)
        return [interpolate(self.edges, vertices, pieces.cell, point) for point in ends]
