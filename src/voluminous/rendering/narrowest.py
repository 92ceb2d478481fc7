"""The narrowest cell that a ray meets, as RADMC-3D measures it to divide pixels.

On trees it is a width along x: that of the first base cell, halved as often as the deepest cell
met. On spherical grids it is a size of a cell as seen from where the ray enters it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..backend import dr
from ..errors import InputError
from ..grids.contract import Ray
from .drawing import reverse

# Relative and angular sizes that cells of spherical grids count as at least, and at most.
_THINNEST = 0.003
_LEAST_ANGLE, _MOST_ANGLE = 0.05, 0.3
# Of the innermost radius: what a ray counts as meeting that passes through the cavity.
_OF_CAVITY = 0.05


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
            segment, cursor = self.walk.next(track, state.cursor)
            width = self.width(state.cursor, segment, sight)
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
        self.finest = float(np.broadcast_to(self.walk.lookup.per_finest, 3)[0])
        edges = grid.base_edges[0]
        self.unit = float((edges[1] - edges[0]) / grid.divisions[0])

    def before(self, sight: Any, count: int) -> Any:
        """Return the width of the largest cells."""
        return dr.full(self.backend.Float, self.largest, count)

    def width(self, cursor: Any, segment: Any, sight: Any) -> Any:
        """Return the width of the cell that the cursor is in."""
        lookup = self.walk.lookup
        width = lookup.sizes(cursor.cell)[0] * (1.0 / self.finest)
        return dr.select(lookup.is_cell(cursor.cell), width, self.largest)


@dataclass
class Sight:
    """Rays as a centre sees them.

    Attributes
    ----------
    closest : array
        How near they come.
    arrive : array
        Where they enter the sphere around all, counted from there: negative.
    polar : array
        Absolute z component of the direction.
    """

    closest: Any
    arrive: Any
    polar: Any


class NarrowestOfSphere(Narrowest):
    """The rule for spherical grids; widths in units of the grid's scale.

    RADMC-3D follows rays towards the camera, and cells look different from their other ends.

    Parameters
    ----------
    backward : bool
        Rays run towards the camera.
    """

    def __init__(self, grid: Any, backend: Any, backward: bool) -> None:
        super().__init__(grid, backend)
        self.backward = backward
        r, theta = grid.edges[0] / grid.scale, grid.edges[1]
        self.unit = grid.scale
        self.inner, self.outer = backend.wide(r[0]), backend.wide(r[-1])
        middle, polar = 0.5 * (r[1:] + r[:-1]), 0.5 * (theta[1:] + theta[:-1])
        across = np.minimum(np.minimum(polar, np.pi - polar), 1.0)
        own = backend.Float
        self.radius = own(middle.astype(backend.dtype))
        self.depth = own(np.maximum(np.diff(r), _THINNEST * middle).astype(backend.dtype))
        self.along_theta, self.along_phi = (
            own(np.clip(angle, _LEAST_ANGLE, _MOST_ANGLE).astype(backend.dtype))
            for angle in (np.diff(theta), across * np.diff(theta))
        )
        self.strides = [dr.opaque(backend.UInt, n) for n in (grid.shape[1], grid.shape[2])]

    def along(self, ray: Ray) -> np.ndarray:
        """Return the width of the narrowest cell that each ray meets, in the grid's unit."""
        return super().along(ray if self.backward else reverse(ray))

    def sight(self, ray: Ray) -> Sight:
        """Return rays as the centre sees them."""
        to_scale = self.backend.wide(1.0 / self.grid.scale)
        origin = [o * to_scale for o in ray.origin]
        way = -sum(o * d for o, d in zip(origin, ray.direction, strict=True))
        nearest = [dr.fma(way, d, o) for o, d in zip(origin, ray.direction, strict=True)]
        square = sum(n * n for n in nearest)
        arrive = -dr.sqrt(dr.maximum(self.outer * self.outer - square, 0.0))
        own = self.backend.Float
        return Sight(own(dr.sqrt(square)), own(arrive), own(dr.abs(ray.direction[2])))

    def before(self, sight: Sight, count: int) -> Any:
        """Return what rays meet in the cavity; infinity for those that pass beside it."""
        inner = self.backend.Float(self.inner)
        return dr.select(sight.closest <= inner, _OF_CAVITY * inner, np.inf)

    def width(self, cursor: Any, segment: Any, sight: Sight) -> Any:
        """Return the size of a segment's cell, as seen from where the ray enters it."""
        row = self.backend.quotient(segment.cell, self.strides[1])
        shell = self.backend.quotient(row, self.strides[0])
        zone = row - shell * self.strides[0]

        def of(table: Any, index: Any) -> Any:
            return dr.gather(self.backend.Float, table, index, segment.active)

        radius = of(self.radius, shell)
        across, around = (radius * of(t, zone) for t in (self.along_theta, self.along_phi))
        way = segment.begin + sight.arrive
        distance = dr.sqrt(dr.fma(way, way, sight.closest * sight.closest))
        upright = dr.abs(way) / distance
        tilted = dr.lerp(around, across, sight.polar) * upright
        width = dr.minimum(dr.minimum(across, around), tilted)
        return dr.maximum(of(self.depth, shell), width)


def make_narrowest(job: Any) -> Narrowest:
    """Return what finds the narrowest cells that a job's rays meet.

    Raises
    ------
    InputError
        If RADMC-3D has no rule for such a grid or camera.
    """
    grid = job.volume.grid
    if not job.camera.parallel:
        raise InputError(
            "samples='flux-conserving' compares pixels with cells: it needs parallel rays "
            "(vm.Orthographic); use samples='adaptive'"
        )
    if hasattr(grid, "base_edges") and tuple(grid.coordinates) == ("x", "y", "z"):
        return NarrowestOfTree(grid, job.backend)
    if tuple(grid.coordinates) == ("r", "theta", "phi") and len(grid.shape) == 3:
        return NarrowestOfSphere(grid, job.backend, job.backward)
    raise InputError(
        f"samples='flux-conserving' is not known on a {type(grid).__name__}; use samples='adaptive'"
    )
