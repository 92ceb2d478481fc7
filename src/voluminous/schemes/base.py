"""The contracts of schemes, and of the sources of their coefficients.

A scheme computes the emission b and transparency θ of one segment of a ray. Its source gives the
coefficients: in a cell, at vertices, or along a segment from interpolated fields.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Generic, Protocol

from ..backend import Backend
from ..backend.functions import branch
from ..backend.types import Float, Mask
from ..grids.contract import Corners, Cursor, Segment, Track
from .channels import Channels, Tolerance
from .path import Path, last_argument

if TYPE_CHECKING:
    from typing_extensions import TypeVar

    from ..grids.cartesian.leap import Bricks
    from ..grids.contract import Grid
    from ..media.bound import Binding
    from ..media.context import Context
    from ..media.contract import Medium
    from ..media.panel import Panel
else:
    from typing import TypeVar as _TypeVar

    def TypeVar(name, **_):
        """Return a type variable: Python 3.10 knows no defaults."""
        return _TypeVar(name)


# A solved segment is a piece of path like any other.
Solution = Path
# j per emission and α per extinction.
JAlpha = tuple[list[Float], list[Float]]


@dataclass
class Skipping:
    """What rays skip of a volume because nothing shows there.

    Attributes
    ----------
    bricks, walk : optional
        Bricks that rays leap over; or a walk through less than the whole grid.
    neglected_emission, neglected_depth : float
        Upper bounds of what is skipped along a ray.
    """

    bricks: Bricks | None = None
    walk: Any = None
    neglected_emission: float = 0.0
    neglected_depth: float = 0.0

    @property
    def coarse(self) -> bool:
        """Whether rays cross bricks in wide steps."""
        return self.bricks is not None and self.bricks.coarse


class Source(Protocol):
    """What the ray loop and every scheme know of the coefficients of a medium."""

    channels: Channels
    backend: Backend
    skipping: Skipping


class CellSource(Source, Protocol):
    """Coefficients that are constant in cells."""

    def at(self, segment: Segment) -> JAlpha:
        """Return j and α of a segment's cell."""


class VertexSource(Source, Protocol):
    """Coefficients at vertices, as a table holds them (`Channels.split`)."""

    def interpolate(self, corners: Corners, active: Mask) -> list[Float]:
        """Return all values, interpolated between vertices."""


class FieldSource(Source, Protocol):
    """Fields that are interpolated along the ray; the medium is evaluated there.

    Attributes
    ----------
    context : Context
        How the medium is evaluated.
    tolerance : Tolerance
        The errors that are allowed in a segment; set by the tracer.
    """

    context: Context
    tolerance: Tolerance

    def along(self, segment: Segment) -> Fields:
        """Return the fields along a segment."""


# The fields at a place that panels need, and the medium's scalars.
Node = tuple[dict[str, Float], list[Float]]


class Fields(Protocol):
    """The fields along a segment, at places s from 0 to 1.

    Attributes
    ----------
    looks_inside : bool
        Whether panels need the fields: of other media the scalars at their nodes are enough.
    """

    looks_inside: bool

    def at(self, s: Float) -> dict[str, Float]:
        """Return every field, and coordinate, that the medium uses."""

    def scalars(self, s: Float) -> list[Float]:
        """Return the medium's scalars."""

    def node(self, s: Float, *, culling_only: bool = False) -> Node:
        """Return the fields, if panels need them, and the scalars; or the fields of these alone."""

    def panel(
        self,
        nodes: Sequence[Node],
        begin: Float = 0.0,
        width: Float = 1.0,
        *,
        straight: bool = False,
        culling_only: bool = False,
    ) -> Panel:
        """Return a part of the segment with three nodes (both ends and the middle), or five.

        A `straight` one needs no scalars in the middle.
        """


@dataclass
class Position:
    """Where rays are in a walk: `track` is constant along a ray, `cursor` moves."""

    walk: Any
    track: Track
    cursor: Cursor


@dataclass(frozen=True)
class Steps:
    """How rays go through a grid.

    Attributes
    ----------
    walk_kind : str
        One of the grid's kinds of walk.
    backward : bool
        Rays run towards the observer, as in RADMC-3D: rays along edges of cells are in the same
        cells then. Of schemes without an error.
    """

    walk_kind: str
    backward: bool = False


S = TypeVar("S", bound=Source, contravariant=True, default=Any)


class Scheme(Generic[S]):
    """How a segment is solved; the base class of all schemes.

    Attributes
    ----------
    name : str
    coefficients_at : {"cell", "vertex", "field"}
        Where coefficients are tabulated; ``"field"``: fields are interpolated instead.
    """

    name: str
    coefficients_at: str = "cell"

    def steps(self, grid: Grid) -> Steps:
        """Return how rays go through a grid."""
        return Steps("dual" if self.coefficients_at == "field" else "cells")

    def start(self, position: Position, source: S) -> list[Any]:
        """Return the carried state of rays where they enter."""
        return []

    def after_skip(
        self, position: Position, source: S, carried: list[Any], moved: Mask
    ) -> list[Any]:
        """Return the carried state at a position, which rays in `moved` reached through a gap.

        Gaps are places without cells, skipped bricks, and cells without a value.
        """
        return carried

    def solve(self, segment: Segment, source: S, carried: list[Any]) -> tuple[Solution, list[Any]]:
        """Return the solution of a segment, and the new carried state.

        Parameters
        ----------
        segment : Segment
            ``segment.length`` is in units of the grid's scale, as are coefficients; zero, on lanes
            that are not active, where there is nothing to solve. Where ``segment.backward`` its end
            is nearer to the camera than its beginning.
        source : Source
            The coefficients.
        carried : list of arrays
            As returned for the previous segment, or by `start`.
        """
        raise NotImplementedError

    def key(self) -> Hashable:
        """Return the identity of the scheme: equal keys share traced kernels.

        None disables sharing, for classes outside this package: their state may change unnoticed.
        """
        own = type(self).__module__.startswith("voluminous.")
        return (type(self).__name__, *sorted(vars(self).items())) if own else None


def innermost(scheme: Scheme) -> Scheme:
    """Return the scheme that solves the segments."""
    return innermost(scheme.scheme) if isinstance(scheme, Around) else scheme


def is_controlled(scheme: Scheme) -> bool:
    """Return whether a scheme keeps to a tolerance and estimates its error (`Path.error`)."""
    return isinstance(scheme, FieldScheme) and scheme.controlled


class Around(Scheme[S]):
    """Base of schemes around another, to which they forward what they leave as it is."""

    def __init__(self, scheme: Scheme[S]) -> None:
        self.scheme = scheme
        self.name, self.coefficients_at = scheme.name, scheme.coefficients_at

    def steps(self, grid: Grid) -> Steps:
        return self.scheme.steps(grid)

    def start(self, position: Position, source: S) -> list[Any]:
        return self.scheme.start(position, source)

    def after_skip(
        self, position: Position, source: S, carried: list[Any], moved: Mask
    ) -> list[Any]:
        return self.scheme.after_skip(position, source, carried, moved)

    def solve(self, segment: Segment, source: S, carried: list[Any]) -> tuple[Solution, list[Any]]:
        return self.scheme.solve(segment, source, carried)


class TowardsObserver(Around[S]):
    """Another scheme of cells or vertices, whose rays run towards the observer on any grid."""

    def steps(self, grid: Grid) -> Steps:
        return replace(self.scheme.steps(grid), backward=True)

    def key(self) -> Hashable:
        key = self.scheme.key()
        return None if key is None else ("towards observer", key)


class Scanner(Scheme[S]):
    """Base of schemes that measure along rays, in place of drawing: no place is too faint.

    Attributes
    ----------
    everywhere : bool
        Empty cells are visited, too.
    """

    everywhere = False

    def results(self, extinctions: int) -> list[float]:
        """Return the results of rays that meet nothing; none if paths are the result.

        Results are the first numbers that are carried; solutions then have no parts.
        """
        return []


class FieldScheme(Scheme[FieldSource]):
    """Base of schemes that classify interpolated fields.

    Attributes
    ----------
    controlled : bool
        It keeps to a tolerance and estimates its error (`Path.error`).
    """

    coefficients_at = "field"
    controlled = False

    def coarseness(self, tolerance: float) -> float:
        """Return by what part of a structure's width scalars may bend within a wide step."""
        return 0.0


def interpolated_at(
    position: Position, source: VertexSource, values: list[Float], moved: Mask
) -> list[Float]:
    """Return the coefficients at a position, interpolated again for rays that have moved."""

    def anew(values: list[Float]) -> list[Float]:
        corners = position.walk.entry_corners(position.track, position.cursor)
        return list(source.interpolate(corners, moved & position.cursor.inside))

    return list(branch((values,), moved, anew, last_argument))


class VertexScheme(Scheme[VertexSource]):
    """Base of schemes with coefficients averaged to vertices and bilinear on cell walls.

    The values at one wall are carried along: each wall is interpolated once.
    """

    coefficients_at = "vertex"

    def start(self, position: Position, source: VertexSource) -> list[Float]:
        cursor = position.cursor
        corners = position.walk.entry_corners(position.track, cursor)
        return list(source.interpolate(corners, cursor.inside))

    def after_skip(
        self, position: Position, source: VertexSource, carried: list[Float], moved: Mask
    ) -> list[Float]:
        return interpolated_at(position, source, carried, moved)

    def solve(
        self, segment: Segment, source: VertexSource, carried: list[Float]
    ) -> tuple[Solution, list[Float]]:
        corners = segment.walk.exit_corners(segment.track, segment)
        reached = list(source.interpolate(corners, segment.active))
        front, back = (reached, carried) if segment.backward else (carried, reached)
        split = source.channels.split
        return self.between(split(front), split(back), segment.length, segment.walk.scale), reached

    def between(self, front: JAlpha, back: JAlpha, length: Float, scale: Float) -> Solution:
        """Return the solution of a segment from the coefficients at its two ends.

        Lengths are in units of `scale`, in the volume's unit.
        """
        raise NotImplementedError

    def channels(self, medium: Medium, binding: Binding, context: Context) -> Channels | None:
        """Return what tables hold in place of coefficients; None for those."""
        return None

    def needs_double(self, medium: Medium) -> bool:
        """Return whether it loses digits that matter for a medium."""
        return False
