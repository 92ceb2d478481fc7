"""One axis of a rectilinear grid, seen by rays that run upwards or downwards along it.

Along an axis that a ray runs down, positions and cells are counted from the far end, so every
ray runs upwards: the loop needs neither the sign of the step nor two limits.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

# Later than any crossing: the time at which a ray that runs parallel to a wall meets it.
NEVER = 1e30


@dataclass
class AxisTrack:
    """What is constant for one axis along a ray (lane arrays).

    ``position + t speed`` is the mirrored coordinate; a wall at mirrored coordinate w is met at
    ``t = w pace + lead``. `table` tells where the edges of the ray's sense start.
    """

    position: Any
    speed: Any
    pace: Any
    lead: Any
    table: Any = None


class UniformAxis:
    """Cells of equal width; coordinates are counted in cells, so edge i is at i."""

    def __init__(self, edges: np.ndarray, scale: float, backend: Any) -> None:
        self.count = len(edges) - 1
        self.width = (edges[-1] - edges[0]) / self.count
        self.backend = backend
        self.low = backend.wide(edges[0])
        self.to_own = backend.wide(1.0 / self.width)
        self.speed_unit = backend.wide(scale / self.width)
        self.extent = backend.wide(float(self.count))
        self.last_index = backend.wide(self.count - 1.0)

    def track(self, side: Any, position: Any) -> AxisTrack:
        """Return the track of rays that are at mirrored `position` where distances start."""
        pace, never = _pace(side)
        # Cell i is left at wall i + 1: the one is part of the lead, so that crossing is one FMA.
        lead = dr.select(never, NEVER, (1.0 - position) * pace)
        return AxisTrack(*_narrow(self.backend, position, side.speed, pace, lead))

    def index_of(self, track: AxisTrack, position: Any) -> Any:
        """Return the (mirrored, floating-point) cell index of a mirrored Wide coordinate."""
        return dr.floor(position)

    def crossing(self, track: AxisTrack, index: Any) -> Any:
        """Return the distance at which the ray leaves cell `index` through its upper wall."""
        return dr.fma(index, track.pace, track.lead)

    def fraction(self, track: AxisTrack, index: Any, t: Any) -> Any:
        """Return where in cell `index` the ray is at distance `t`, between 0 and 1."""
        return dr.clip(dr.fma(t, track.speed, track.position) - index, 0.0, 1.0)


class RectilinearAxis:
    """Cells of any width; coordinates are counted in units of the grid's scale."""

    def __init__(self, edges: np.ndarray, scale: float, backend: Any) -> None:
        self.count = len(edges) - 1
        self.backend = backend
        up = (edges - edges[0]) / scale
        down = (edges[-1] - edges[::-1]) / scale
        both = np.concatenate([up, down])
        self.wide_edges = backend.Wide(both)
        self.edges = backend.Float(both.astype(backend.dtype))
        width = np.concatenate([np.diff(up), [1.0], np.diff(down), [1.0]])
        self.inverse_width = backend.Float((1.0 / width).astype(backend.dtype))
        self.low = backend.wide(edges[0])
        self.to_own = backend.wide(1.0 / scale)
        self.speed_unit = backend.wide(1.0)
        self.extent = backend.wide(float(up[-1]))
        self.last_index = backend.wide(self.count - 1.0)
        self.size = dr.opaque(backend.UInt, self.count + 1)
        self.steps = int(np.ceil(np.log2(self.count + 1)))

    def track(self, side: Any, position: Any) -> AxisTrack:
        """Return the track of rays that are at mirrored `position` where distances start."""
        pace, never = _pace(side)
        lead = dr.select(never, NEVER, -position * pace)
        table = dr.select(side.down, self.size, 0)
        return AxisTrack(*_narrow(self.backend, position, side.speed, pace, lead), table)

    def index_of(self, track: AxisTrack, position: Any) -> Any:
        """Return the (mirrored, floating-point) cell index of a mirrored Wide coordinate."""
        UInt = self.backend.UInt
        low, high = UInt(0), UInt(self.size - 1)
        for _ in range(self.steps):
            middle = (low + high) >> 1
            edge = dr.gather(self.backend.Wide, self.wide_edges, track.table + middle)
            above = edge <= position
            low, high = dr.select(above, middle, low), dr.select(above, high, middle)
        return self.backend.Wide(low)

    def crossing(self, track: AxisTrack, index: Any) -> Any:
        """Return the distance at which the ray leaves cell `index` through its upper wall."""
        slot = track.table + self.backend.UInt(index) + 1
        return dr.fma(dr.gather(self.backend.Float, self.edges, slot), track.pace, track.lead)

    def fraction(self, track: AxisTrack, index: Any, t: Any) -> Any:
        """Return where in cell `index` the ray is at distance `t`, between 0 and 1."""
        slot = track.table + self.backend.UInt(index)
        lower = dr.gather(self.backend.Float, self.edges, slot)
        inverse = dr.gather(self.backend.Float, self.inverse_width, slot)
        return dr.clip((dr.fma(t, track.speed, track.position) - lower) * inverse, 0.0, 1.0)


def _pace(side: Any) -> tuple[Any, Any]:
    """Return distance per coordinate, zero where the ray runs parallel to the walls, and where."""
    never = side.speed == 0
    return dr.select(never, 0.0, 1.0 / dr.select(never, 1.0, side.speed)), never


def _narrow(backend: Any, *wide: Any) -> list[Any]:
    return [backend.Float(value) for value in wide]


def is_uniform(edges: np.ndarray) -> bool:
    """Return True if all cells are equally wide to the rounding of the edges themselves."""
    even = np.linspace(edges[0], edges[-1], len(edges))
    rounding = 8 * np.finfo(np.float64).eps * np.max(np.abs(edges))
    return bool(np.max(np.abs(edges - even)) <= rounding)


def make_axis(edges: np.ndarray, scale: float, backend: Any) -> UniformAxis | RectilinearAxis:
    """Return the faster kind of axis that the edges allow."""
    kind = UniformAxis if is_uniform(edges) else RectilinearAxis
    return kind(edges, scale, backend)
