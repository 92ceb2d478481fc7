"""Which cells a ray crosses: all its wall crossings, sorted; counting them tells the cell.

Slow and without any position that is carried from cell to cell, so that it cannot drift or leak.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Segments:
    """The N pieces of rays inside one cell each, ray after ray, t growing within a ray.

    Attributes
    ----------
    ray : numpy.ndarray
        Which ray, shape (N,), not decreasing.
    step : numpy.ndarray
        Number of the piece within its ray, from 0, shape (N,).
    cell : tuple of numpy.ndarray
        Cell indices (ix, iy, iz), each of shape (N,).
    t0, t1 : numpy.ndarray
        Distances along the ray where the piece begins and ends, shape (N,).
    length : numpy.ndarray
        t1 - t0, positive.
    start, end : numpy.ndarray
        The points at t0 and t1, shape (N, 3); a coordinate on a wall equals the wall exactly.
    """

    ray: np.ndarray
    step: np.ndarray
    cell: tuple[np.ndarray, np.ndarray, np.ndarray]
    t0: np.ndarray
    t1: np.ndarray
    length: np.ndarray
    start: np.ndarray
    end: np.ndarray

    def steps(self) -> list[np.ndarray]:
        """For k = 0, 1, ...: which pieces are the k-th of their ray."""
        order = np.argsort(self.step, kind="stable")
        return np.split(order, np.cumsum(np.bincount(self.step))[:-1])


def segments(edges, origins: np.ndarray, directions: np.ndarray, t_end: float = np.inf) -> Segments:
    """Cut rays at every wall of a rectilinear grid.

    Parameters
    ----------
    edges : sequence of 3 numpy.ndarray
        Cell walls along x, y, z, increasing.
    origins, directions : numpy.ndarray
        Points and unit vectors, shape (R, 3). A ray extends over -infinity < t < ``t_end``.
    t_end : float
        Where the rays end (0: at their origins).

    Returns
    -------
    Segments
        A ray that runs in a wall belongs to the cell above it; in the last wall, to none.
    """
    walls = [_crossings(e, origins[:, a], directions[:, a]) for a, e in enumerate(edges)]
    enter = np.max([w.min(axis=1) for w in walls], axis=0)
    leave = np.minimum(np.min([w.max(axis=1) for w in walls], axis=0), t_end)
    enter, leave = _empty_where_missed(edges, origins, directions, enter, leave)
    t = np.clip(np.concatenate(walls, axis=1), enter[:, None], leave[:, None])
    order = np.argsort(t, axis=1, kind="stable")
    t = np.take_along_axis(t, order, axis=1)
    ray, column = np.nonzero(t[:, 1:] > t[:, :-1])
    cell = _cells(edges, origins, directions, order, ray, column)
    t0, t1 = t[ray, column], t[ray, column + 1]
    first = np.searchsorted(ray, np.arange(len(origins)))
    o, d = origins[ray], directions[ray]
    start = _points(edges, o, d, cell, t0, above=d < 0)
    end = _points(edges, o, d, cell, t1, above=d > 0)
    return Segments(ray, np.arange(len(ray)) - first[ray], cell, t0, t1, t1 - t0, start, end)


def _crossings(walls: np.ndarray, origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Distances (R, n) at which rays cross walls; a ray parallel to them never limits the path."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        t = (walls - origin[:, None]) / direction[:, None]
    never = np.full(len(walls), np.inf)
    never[0] = -np.inf
    return np.where(direction[:, None] == 0, never, t)


def _empty_where_missed(edges, origins, directions, enter, leave):
    low = np.array([e[0] for e in edges])
    high = np.array([e[-1] for e in edges])
    beside = (directions == 0) & ((origins < low) | (origins >= high))
    missed = beside.any(axis=1) | ~(leave > enter)
    return np.where(missed, 0.0, enter), np.where(missed, 0.0, leave)


def _cells(edges, origins, directions, order, ray, column):
    """Return the cell indices of pieces: how many walls of each axis the ray has met by then.

    ``order`` (R, walls) is the order in which the rays meet the walls of all axes.
    """
    axis_of_wall = np.repeat(np.arange(3), [len(e) for e in edges])
    indices = []
    for axis, walls in enumerate(edges):
        met = np.cumsum(axis_of_wall[order] == axis, axis=1)[ray, column]
        d = directions[ray, axis]
        resting = np.searchsorted(walls, origins[ray, axis], side="right")
        count = np.select([d > 0, d < 0], [met, len(walls) - met], resting)
        indices.append(count - 1)
    return tuple(indices)


def _points(edges, o, d, cell, t, above):
    """Points at distance t; coordinates on the lower (upper where ``above``) wall are set to it."""
    points = o + t[:, None] * d
    for axis, walls in enumerate(edges):
        wall = walls[cell[axis] + above[:, axis]]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            crossed = (wall - o[:, axis]) / d[:, axis] == t
        points[:, axis] = np.where(crossed, wall, points[:, axis])
    return points
