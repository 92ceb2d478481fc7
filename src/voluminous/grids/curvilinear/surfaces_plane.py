"""Planes across the axis."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...backend import dr, from_host
from ..axes import NEVER
from .approach import PARALLEL, Approach
from .arithmetic import NUMBERS, Arithmetic
from .crossing import Lines
from .surfaces import Running, RunningTrack


@dataclass
class PlaneTrack:
    """Mirrored height of a ray, and distance along it per height."""

    height: Any
    pace: Any
    parallel: Any


class Planes(Running):
    """Planes across the axis.

    Parameters
    ----------
    edges : array
        Heights of the cells' walls, in units of the grid's scale.
    """

    encloses = True

    def __init__(self, edges: np.ndarray, backend: Any) -> None:
        beyond = [2 * edges[-1] - edges[0]], [edges[-1] - 2 * edges[0]]
        heights = np.concatenate([edges, beyond[0], -edges[::-1], beyond[1]])
        table = np.stack([heights, np.zeros_like(heights)], axis=1)
        super().__init__(table, len(edges), len(edges) - 1, backend)
        self.mirrored_start = dr.opaque(backend.Int, len(edges) + 1)
        self.lower = from_host(backend.Float, edges[:-1])
        self.inverse_width = from_host(backend.Float, 1.0 / np.diff(edges))

    def track(self, approach: Approach) -> RunningTrack:
        Float = self.backend.Float
        z, dz = approach.point[2], approach.direction[2]
        down, parallel = dz < 0, dr.abs(dz) < PARALLEL
        pace = 1.0 / dr.select(parallel, 1.0, dr.abs(dz))
        surface = PlaneTrack(Float(dr.select(down, -z, z)), Float(pace), parallel)
        start = self.first + dr.select(down, self.mirrored_start, 0)
        return RunningTrack(surface, self.lines(surface), start, start, down)

    def place(self, surface: PlaneTrack, t: Any) -> Any:
        way = dr.select(surface.parallel, 0.0, t / surface.pace)
        return surface.height + way

    def is_ahead(self, surface: PlaneTrack, wall: list[Any], here: Any) -> Any:
        return wall[0] > here

    def lines(self, surface: PlaneTrack) -> Lines:
        """Return when rays meet the planes; parallel to them they never meet the one above."""
        pace = dr.select(surface.parallel, 0.0, surface.pace)
        lead = dr.select(surface.parallel, NEVER, -surface.height * surface.pace)
        return Lines((lead, pace, None), (1.0, None, None))

    def enter(self, track: RunningTrack, t: Any) -> Any:
        return dr.clip(super().enter(track, t), 1, self.last_cell + 1)

    def leave(self, track: RunningTrack) -> Any:
        """Return the distance at which rays leave the outermost plane."""
        return self.time(track, self.last_cell + 1)

    def cell(self, track: RunningTrack, count: Any) -> Any:
        """Return the number of the cell along this axis."""
        return dr.select(track.down, self.wall_count - 1 - count, count - 1)

    def vertex(self, track: RunningTrack, count: Any) -> Any:
        """Return the number of the vertices on the wall that is met next."""
        return dr.select(track.down, self.wall_count - 1 - count, count)

    def fraction(self, cell: Any, point: list[Any], own: Arithmetic = NUMBERS) -> Any:
        cell = self.backend.UInt(cell)
        lower = dr.gather(self.backend.Float, self.lower, cell)
        inverse = dr.gather(self.backend.Float, self.inverse_width, cell)
        return own.part(point[2], lower, inverse)
