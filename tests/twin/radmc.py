"""RADMC-3D's rounding of positions, needed to compare images beyond 1e-9 of their maximum.

Its second order takes the difference of nearly equal numbers for small optical depths, and so
depends on the last bits of the path lengths. Nothing else in the twin needs this.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .camera import Rays
from .traverse import Segments


def radmc_steps(edges, rays: Rays, point, pieces: Segments) -> Segments:
    """Return the pieces with start, end and length as RADMC-3D gets them.

    It starts far behind the grid and carries the position from wall to wall: the coordinate that
    crosses is set to the wall, the others advance by distance times direction; the path
    length is the Euclidean distance of the two positions. Cameras at infinity only.
    """
    corner = np.sqrt(3.0) * max(np.abs(e).max() for e in edges)
    position = rays.origins - 3 * (np.linalg.norm(point) + corner) * rays.directions
    start, end = np.empty_like(pieces.start), np.empty_like(pieces.end)
    for k, now in enumerate(pieces.steps()):
        ray = pieces.ray[now]
        here, direction = position[ray], rays.directions[ray]
        if k == 0:
            behind = np.where(direction > 0, [e[0] for e in edges], [e[-1] for e in edges])
            here = _advance(here, direction, behind, np.argmax, never=-np.inf)
        above = direction > 0
        ahead = np.stack([edges[a][pieces.cell[a][now] + above[:, a]] for a in range(3)], axis=-1)
        start[now] = here
        end[now] = position[ray] = _advance(here, direction, ahead, np.argmin, never=np.inf)
    length = np.sqrt(np.sum((end - start) ** 2, axis=1))
    return replace(pieces, start=start, end=end, length=length)


def _advance(here, direction, walls, choose, never) -> np.ndarray:
    """Move to the one of three walls (R, 3) that ``choose`` picks by its distance."""
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = np.where(direction == 0, never, (walls - here) / direction)
    axis = choose(distance, axis=1)[:, None]
    there = here + np.take_along_axis(distance, axis, axis=1) * direction
    np.put_along_axis(there, axis, np.take_along_axis(walls, axis, axis=1), axis=1)
    return there
