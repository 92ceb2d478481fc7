"""The twin's renderer for refined curvilinear grids: an octree as groups of finest cells.

The mean over the eight octants around a vertex, with leaves counting once per octant, is the mean
over the eight finest cells there: vertices are those of the evenly refined grid.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from .curvilinear import Frame, Pieces, _joined, pieces
from .curvilinear_render import _fold, _Points, cyclic_vertex_means, sub_steps
from .schemes import solve_first_order, solve_olson_kunasz


@dataclass(frozen=True)
class Leaves:
    """The leaf of each finest cell (flat), and where leaves are, in finest cells (3, n)."""

    fine: Frame
    leaf: np.ndarray
    low: np.ndarray
    size: np.ndarray


def render_refined(leaves: Leaves, j, alpha, camera, scheme, largest_turn=0.0):
    """Return the intensity (ny, nx) of coefficients (leaves,); see `render_curvilinear`."""
    iy, ix = np.indices((camera.ny, camera.nx))
    rays = camera.rays(*camera.pixel_centres(iy.ravel(), ix.ravel()))
    found = pieces(leaves.fine, rays.origins, rays.directions, t_last=rays.t_end)
    found = Pieces(found.ray, leaves.leaf[found.cell], found.t0, found.t1)
    found = _joined(leaves.fine, found, rays.origins, rays.directions)
    points = _Points(rays.origins, rays.directions)
    if largest_turn:
        found = sub_steps(found, points, largest_turn)
    ds = (found.t1 - found.t0).astype(float)[:, None]
    if scheme == "first-order":
        solved = solve_first_order(j[found.cell, None], alpha[found.cell, None], ds)
    else:
        ends = []
        for values in (j, alpha):
            shape = [len(e) - 1 for e in leaves.fine.edges]
            cells = values[leaves.leaf].reshape(*shape, 1)
            ends += _at_ends(leaves, cyclic_vertex_means(leaves.fine, cells), found, points)
        solved = solve_olson_kunasz(*ends, ds)
    return _fold(found.ray, iy.size, solved)["intensity"].reshape(iy.shape)


def _at_ends(leaves, vertices, found, points):
    """Return values where pieces begin and end: on a wall, those of the finer leaf there."""
    same = (found.ray[1:] == found.ray[:-1]) & (found.t0[1:] == found.t1[:-1])
    size = leaves.size.prod(axis=0)[found.cell]
    before = np.append(False, same & (size[:-1] < size[1:]))
    after = np.append(same & (size[1:] < size[:-1]), False)
    first = np.where(before, np.roll(found.cell, 1), found.cell)
    last = np.where(after, np.roll(found.cell, -1), found.cell)
    return [
        _interpolate(leaves, vertices, cell, points.at(found.ray, t))
        for cell, t in ((first, found.t0), (last, found.t1))
    ]


def _interpolate(leaves, vertices, cell, points):
    frame, own, weights = leaves.fine, leaves.fine.coordinates(points), []
    low, high = leaves.low[:, cell], (leaves.low + leaves.size)[:, cell]
    for axis, edges in enumerate(frame.edges):
        start, end, value = edges[low[axis]], edges[high[axis]], own[:, axis]
        if axis == frame.phi_axis:  # rounding may have put it a full circle away
            middle = 0.5 * (start + end)
            value = middle + np.mod(value - middle + np.pi, 2 * np.pi) - np.pi
        upper = np.clip((value - start) / (end - start), 0, 1).astype(float)
        weights.append((1 - upper, upper))
    total = 0
    for corner in itertools.product((0, 1), repeat=3):
        weight = np.prod([weights[axis][c] for axis, c in enumerate(corner)], axis=0)
        at = tuple(high[axis] if c else low[axis] for axis, c in enumerate(corner))
        total += weight[:, None] * vertices[at]
    return total
