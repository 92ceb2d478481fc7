"""The twin's renderer of cells that are boxes of any size, each compared with every ray.

Vertices and walls follow RADMC-3D: the mean over eight octants, the wall of the finer cell.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from .schemes import solve_first_order, solve_olson_kunasz, solve_second_order

CORNERS = np.array(list(itertools.product((0, 1), repeat=3)))
BATCH = 1 << 22  # numbers compared at once
SOLVERS = {"second-order": solve_second_order, "olson-kunasz": solve_olson_kunasz}


@dataclass(frozen=True)
class Boxes:
    """Cells between corners `low` and `high`, each (n, 3), that fill a domain or parts of it.

    Of two neighbours that with the larger `depth` (n,) is the finer one.
    """

    low: np.ndarray
    high: np.ndarray
    depth: np.ndarray

    def containing(self, points: np.ndarray) -> np.ndarray:
        """Return which cell each point (m, 3) is in, -1 outside; points are not on walls."""
        found = np.full(len(points), -1)
        size = max(1, BATCH // len(self.low))
        for first in range(0, len(points), size):
            part = points[first : first + size, None]
            inside = ((part > self.low) & (part < self.high)).all(axis=2)
            found[first : first + size] = np.where(inside.any(axis=1), inside.argmax(axis=1), -1)
        return found

    def vertex_means(self, values: np.ndarray) -> np.ndarray:
        """Return values (n, C) averaged to the eight corners of all cells, (n, 8, C)."""
        corners = np.where(CORNERS[:, None], self.high, self.low).swapaxes(0, 1).reshape(-1, 3)
        aside = 1e-3 * (self.high - self.low).min(axis=0)
        total, count = np.zeros((len(corners), values.shape[1])), np.zeros((len(corners), 1))
        for octant in CORNERS:
            cell = self.containing(corners + (2 * octant - 1) * aside)
            total += np.where(cell[:, None] >= 0, values[cell], 0.0)
            count += cell[:, None] >= 0
        return (total / count).reshape(len(self.low), 8, -1)

    def interpolated(self, corners: np.ndarray, cell: int, point: np.ndarray) -> np.ndarray:
        """Return what is trilinear between the corners of a cell, at a point in it."""
        f = np.clip((point - self.low[cell]) / (self.high[cell] - self.low[cell]), 0, 1)
        weight = np.where(CORNERS, f, 1 - f).prod(axis=1)
        return weight @ corners[cell]

    def crossed(self, origin, direction, t_end):
        """Return the cells that a line crosses in their order, and where it enters and leaves."""
        with np.errstate(divide="ignore"):
            ends = np.stack([(wall - origin) / direction for wall in (self.low, self.high)])
        enter, leave = ends.min(axis=0).max(axis=1), ends.max(axis=0).min(axis=1)
        leave = np.minimum(leave, t_end)
        cell = np.flatnonzero(leave > enter)
        cell = cell[np.argsort(enter[cell], kind="stable")]
        return cell, enter[cell], leave[cell]


def render_boxes(boxes, j, alpha, camera, scheme, background=0.0):
    """Return intensity and optical depth, each of shape (ny, nx, C).

    Parameters
    ----------
    boxes : Boxes
    j, alpha : array, shape (n, C)
    camera : Camera
    scheme : {"first-order", "second-order", "olson-kunasz"}
    """
    iy, ix = np.indices((camera.ny, camera.nx)).reshape(2, -1)
    rays = camera.rays(*camera.pixel_centres(iy, ix))
    corners = [boxes.vertex_means(values) for values in (j, alpha)]
    found = []
    for origin, direction in zip(rays.origins, rays.directions, strict=True):
        cell, enter, leave = boxes.crossed(origin, direction, rays.t_end)
        length = (leave - enter)[:, None]
        if scheme == "first-order":
            b, theta, tau = solve_first_order(j[cell], alpha[cell], length)
        else:
            starts, ends = (origin + t[:, None] * direction for t in (enter, leave))
            first, last = _finer(boxes, cell, enter, leave)
            j0, a0 = (_values(boxes, c, first, starts) for c in corners)
            j1, a1 = (_values(boxes, c, last, ends) for c in corners)
            b, theta, tau = SOLVERS[scheme](j0, j1, a0, a1, length)
        intensity = np.full(j.shape[1], background)
        for emitted, passed in zip(b, theta, strict=True):
            intensity = intensity * passed + emitted
        found.append((intensity, tau.sum(axis=0)))
    return [np.array(part).reshape(camera.ny, camera.nx, -1) for part in zip(*found, strict=True)]


def _finer(boxes, cell, enter, leave):
    """Return which cell's walls count where a ray enters each of its cells, and where it leaves.

    Cells of equal depth have the same corners; beside a hole there is but one.
    """
    deeper = np.diff(boxes.depth[cell].astype(int))
    touching = enter[1:] - leave[:-1] < 1e-9 * np.ptp(boxes.high)
    first, last = cell.copy(), cell.copy()
    first[1:] = np.where(touching & (deeper < 0), cell[:-1], cell[1:])
    last[:-1] = np.where(touching & (deeper > 0), cell[1:], cell[:-1])
    return first, last


def _values(boxes, corners, cells, points):
    found = [boxes.interpolated(corners, c, p) for c, p in zip(cells, points, strict=True)]
    return np.array(found).reshape(len(cells), corners.shape[2])
