"""Any rays at all as a camera: one pixel for each."""

from __future__ import annotations

import numpy as np

from voluminous.backend import dr
from voluminous.cameras.contract import Camera, Frame
from voluminous.grids.contract import Ray

COLUMNS = 16


class Bundle(Camera):
    """Rays from given points into given directions; `flat` puts an image in their order.

    Parameters
    ----------
    origins, directions : array_like, shape (n, 3)
        In the volume's unit; directions are used as they are.
    start : bool
        True if the rays start at their origins, False if they are whole lines.
    """

    def __init__(self, origins, directions, *, start=False):
        origins, directions = np.broadcast_arrays(np.atleast_2d(origins), directions)
        self.count, self.start = len(origins), start
        self.rows = -(-self.count // COLUMNS)
        spare = self.rows * COLUMNS - self.count
        self.origins, self.directions = (
            np.pad(a.astype(float), ((0, spare), (0, 0)), mode="edge")
            for a in (origins, directions)
        )

    def frame(self, grid):
        """Return pixels of size one: their coordinates are their numbers."""
        pixels = (COLUMNS, self.rows)
        middle = (0.5 * (COLUMNS - 1), 0.5 * (self.rows - 1))
        return Frame(pixels, (float(COLUMNS), float(self.rows)), middle, np.zeros((1, 3)))

    def rays(self, vectors, u, v):
        """Return the rays with the numbers of the pixels."""
        Wide, UInt = type(u), dr.uint32_array_t(type(u))
        # Lanes beyond the image belong to no pixel: any ray will do.
        number = dr.minimum(UInt(v + 0.5) * COLUMNS + UInt(u + 0.5), len(self.origins) - 1)

        def columns(data):
            return [dr.gather(Wide, Wide(np.ascontiguousarray(c)), number) for c in data.T]

        first = Wide(0) if self.start else None
        return Ray(columns(self.origins), columns(self.directions), first)

    def describe(self):
        """Return the type: this camera is not for files."""
        return {"type": "bundle"}

    def flat(self, plane):
        """Return a plane (ny, nx, channel) as (ray, channel), or (ray,) for one channel."""
        rays = np.asarray(plane).reshape(-1, plane.shape[-1])[: self.count]
        return rays[:, 0] if rays.shape[1] == 1 else rays


def on_a_sphere(count, seed=0):
    """Return directions (count, 3) that are spread evenly, and random."""
    vectors = np.random.default_rng(seed).normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def box_limits(bounds, origins, directions):
    """Return the distances (R,) at which lines enter and leave a closed box; equal if they miss."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        walls = (np.asarray(bounds).T[:, None] - origins) / directions
    low, high = walls.min(axis=0), walls.max(axis=0)
    between = (bounds[:, 0] <= origins) & (origins <= bounds[:, 1])
    low = np.where(directions == 0, np.where(between, -np.inf, np.inf), low).max(axis=1)
    high = np.where(directions == 0, np.inf, high).min(axis=1)
    return np.where(low < high, low, 0.0), np.where(low < high, high, 0.0)


def chords(bounds, origins, directions):
    """Return the lengths (R,) of lines in a closed box."""
    enter, leave = box_limits(bounds, origins, directions)
    return leave - enter
