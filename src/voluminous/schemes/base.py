"""The contract of a scheme: how the emission b and transparency θ of one segment are computed."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Any, Protocol

from ..backend import Backend, dr
from ..backend.functions import branch
from ..backend.types import Float, Int, Mask
from ..grids.contract import Corners, Cursor, Segment, Track
from .path import Path, empty_path, last_argument

# A solved segment is a piece of path like any other.
Solution = Path
# j per emission and α per extinction.
Coefficients = tuple[list[Float], list[Float]]


class Source(Protocol):
    """Where a scheme gets its coefficients from."""

    numbers: Any  # the numbers that are integrated: `sources.channel_layout`
    backend: Backend
    bricks: Any  # of empty space, or None

    def at(self, segment: Segment) -> Coefficients:
        """Return j and α of a segment's cell."""

    def interpolate(self, corners: Corners, active: Mask) -> list[Float]:
        """Return all numbers, interpolated between vertices."""

    def along(self, segment: Segment) -> Any:
        """Return the fields along a segment."""


@dataclass
class Position:
    """Where rays are in a walk: `track` is constant along a ray, `cursor` moves."""

    walk: Any
    track: Track
    cursor: Cursor


class Scheme:
    """How a segment is solved; the base class of all schemes.

    Attributes
    ----------
    name : str
    order : int
        Order of convergence in the cell size.
    coefficients_at : {"cell", "vertex", "field"}
        Where coefficients are tabulated; ``"field"``: fields are interpolated instead.
    linear : bool
        The emission is linear in the emissivity, whatever the extinction.
    controlled : bool
        It keeps to a tolerance and estimates its error (`Path.error`).
    backward : bool
        Rays run towards the observer, as in RADMC-3D: rays along edges of cells are in the same
        cells then. Of schemes without an error.
    radmc3d_steps : bool
        Positions are rounded, and segments divided, as in RADMC-3D.
    complete : bool
        Faint places are not skipped.
    everywhere : bool
        Empty cells are visited, too.
    layout : callable, optional
        Called with a medium, the backend and the grid's scale: which numbers are tabulated, in
        place of coefficients (`sources.channel_layout`).
    """

    name: str
    order: int = 1
    coefficients_at: str = "cell"
    linear: bool = True
    controlled: bool = False
    backward: bool = False
    radmc3d_steps: bool = False
    complete: bool = False
    everywhere: bool = False
    layout: Callable[..., Any] | None = None

    def start(self, position: Position, source: Source) -> list[Float]:
        """Return the carried state of rays where they enter."""
        return []

    def after_skip(
        self, position: Position, source: Source, carried: list[Float], moved: Mask
    ) -> list[Float]:
        """Return the carried state at a position, which rays in `moved` reached through a gap."""
        return carried

    def solve(
        self, segment: Segment, source: Source, carried: list[Float]
    ) -> tuple[Solution, list[Float]]:
        """Return the solution of a segment, and the new carried state.

        Parameters
        ----------
        segment : Segment
            ``segment.length`` is in units of the grid's scale, as are coefficients. Where
            ``segment.backward`` its end is nearer to the camera than its beginning.
        source : Source
            The coefficients.
        carried : list of arrays
            As returned for the previous segment, or by `start`.
        """
        raise NotImplementedError

    def after_discarded(self, carried: list[Float], onward: list[Float]) -> list[Float]:
        """Return the carried state after a segment whose solution is discarded.

        It was `carried` before the segment, and `solve` returned `onward`.
        """
        return onward

    def results(self, extinctions: int) -> list[float]:
        """Return the results of rays that meet nothing, if rays look for something else than light.

        Results are then the first numbers that are carried; solutions have no parts. Default: none.
        """
        return []

    def coarseness_for(self, tolerance: float) -> float:
        """Return by what part of a structure's width scalars may bend within a wide step.

        Zero for single cells; for ``"field"``.
        """
        return 0.0

    def hiding(self, bits: Int) -> Scheme:
        """Return the scheme that leaves out segments in some cells, of which this is a mask."""
        return Hiding(self, bits)

    def hides(self, segment: Segment) -> Mask:
        """Return where the solution of a segment is discarded."""
        return segment.active & False

    def key(self) -> Hashable:
        """Return the identity of the scheme: equal keys share traced kernels.

        None disables sharing, for classes outside this package: their state may change unnoticed.
        """
        own = type(self).__module__.startswith("voluminous.")
        return (type(self).__name__, *sorted(vars(self).items())) if own else None


class Hiding(Scheme):
    """A scheme that leaves out segments in hidden cells; otherwise it is another."""

    def __init__(self, scheme: Scheme, bits: Int) -> None:
        self.scheme, self.bits = scheme, bits
        self.name, self.coefficients_at = scheme.name, scheme.coefficients_at
        self.controlled = scheme.controlled

    def start(self, position: Position, source: Source) -> list[Float]:
        return self.scheme.start(position, source)

    def after_skip(
        self, position: Position, source: Source, carried: list[Float], moved: Mask
    ) -> list[Float]:
        return self.scheme.after_skip(position, source, carried, moved)

    def solve(
        self, segment: Segment, source: Source, carried: list[Float]
    ) -> tuple[Solution, list[Float]]:
        hidden = self.hides(segment)
        path, onward = self.scheme.solve(segment, source, carried)
        parts = (path.emission, path.transparency, path.error)
        nothing = empty_path(type(segment.length), *map(len, parts))
        beyond = self.scheme.after_discarded(carried, onward)
        return dr.select(hidden, nothing, path), dr.select(hidden, beyond, onward)

    def hides(self, segment: Segment) -> Mask:
        cell = segment.own_cell
        word = dr.gather(type(self.bits), self.bits, cell >> 5, segment.active)
        return (word >> (cell & 31)) & 1 == 1


def interpolated_at(
    position: Position, source: Source, values: list[Float], moved: Mask
) -> list[Float]:
    """Return the coefficients at a position, interpolated again for rays that have moved."""

    def anew(values: list[Float]) -> list[Float]:
        corners = position.walk.entry_corners(position.track, position.cursor)
        return list(source.interpolate(corners, moved & position.cursor.inside))

    return list(branch((values,), moved, anew, last_argument))


class VertexScheme(Scheme):
    """Base of schemes with coefficients averaged to vertices and bilinear on cell walls.

    The values at one wall are carried along: each wall is interpolated once.
    """

    order = 2
    coefficients_at = "vertex"

    def start(self, position: Position, source: Source) -> list[Float]:
        cursor = position.cursor
        corners = position.walk.entry_corners(position.track, cursor)
        return list(source.interpolate(corners, cursor.inside))

    def after_skip(
        self, position: Position, source: Source, carried: list[Float], moved: Mask
    ) -> list[Float]:
        return interpolated_at(position, source, carried, moved)

    def solve(
        self, segment: Segment, source: Source, carried: list[Float]
    ) -> tuple[Solution, list[Float]]:
        corners = segment.walk.exit_corners(segment.track, segment)
        reached = list(source.interpolate(corners, segment.active))
        front, back = (reached, carried) if segment.backward else (carried, reached)
        split = source.numbers.split
        return self.between(split(front), split(back), segment.length, segment.walk.scale), reached

    def between(
        self, front: Coefficients, back: Coefficients, length: Float, scale: Float
    ) -> Solution:
        """Return the solution of a segment from the coefficients at its two ends.

        Lengths are in units of `scale`, in the volume's unit.
        """
        raise NotImplementedError
