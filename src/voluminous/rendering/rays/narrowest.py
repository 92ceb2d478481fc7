"""The narrowest cell that a ray meets, as RADMC-3D measures it to divide pixels.

On trees it is a width along x: that of the first base cell, halved as often as the deepest cell
met.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...backend import dr
from ...grids.contract import Ray


@dataclass
class State:
    """What goes round the loop: where a ray is, and the least width so far."""

    cursor: Any
    least: Any


class Narrowest:
    """Follows rays through a grid's cells."""

    def __init__(self, grid: Any, backend: Any) -> None:
        self.grid, self.backend = grid, backend
        self.walk = grid.walk(backend)

    def along(self, ray: Ray) -> np.ndarray:
        """Return the width of the narrowest cell that each ray meets, in the grid's unit."""
        track, cursor = self.walk.enter(ray)
        sight = self.sight(ray)

        def inside(state: State) -> Any:
            return state.cursor.inside

        def step(state: State) -> tuple[State]:
            here = state.cursor
            if self.walk.has_gaps:
                here = self.walk.cross(track, here).cursor
            segment, cursor = self.walk.next(track, here)
            width = self.width(here, segment, sight)
            narrower = segment.active & (segment.length > 0.0) & (width < state.least)
            return (State(cursor, dr.select(narrower, width, state.least)),)

        state = State(cursor, self.before(sight, dr.width(ray.direction)))
        (state,) = dr.while_loop((state,), inside, step, label="narrowest")
        return np.asarray(state.least, np.float64) * self.unit

    unit: float

    def sight(self, ray: Ray) -> Any:
        """Return what is to be known of rays."""
        return None

    def before(self, sight: Any, count: int) -> Any:
        """Return the widths that rays begin with."""
        raise NotImplementedError

    def width(self, cursor: Any, segment: Any, sight: Any) -> Any:
        """Return the width of the cell of a segment."""
        raise NotImplementedError


class NarrowestOfTree(Narrowest):
    """Widths in units of the first base cell's finest parts."""

    def __init__(self, grid: Any, backend: Any) -> None:
        super().__init__(grid, backend)
        largest = int(np.argmin(grid.levels))
        self.largest = float(grid.boxes(largest, largest + 1)[1][0, 0])
        edges = grid.base_edges[0]
        self.unit = float((edges[1] - edges[0]) / grid.divisions[0])

    def before(self, sight: Any, count: int) -> Any:
        return dr.full(self.backend.Float, self.largest, count)

    def width(self, cursor: Any, segment: Any, sight: Any) -> Any:
        lookup = self.walk.lookup
        width = lookup.sizes(cursor.cell)[0]
        return dr.select(lookup.is_cell(cursor.cell), width, self.largest)
