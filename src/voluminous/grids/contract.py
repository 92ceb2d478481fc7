"""The contract of a grid: the host side (`Grid`) and the walk that a kernel traces (`Walk`).

Both are base classes: what has a default here need not be written for a new grid.

Lengths inside a kernel are in units of ``grid.scale`` (a typical cell width), so that single
precision never overflows, whatever the unit of the data. Distances along a ray are counted from the
point where it enters the whole domain: pieces of a volume agree on them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, TypeVar

import numpy as np

from ..backend import dr
from ..backend.types import Float, Int, Mask
from ..errors import InputError
from ..geometry import CARTESIAN, span, unit_vectors
from ..units import unit_name

if TYPE_CHECKING:
    from ..backend import Backend

Made = TypeVar("Made")
# Single precision must tell this many points apart across the thinnest cell.
_POINTS_PER_CELL = 256
# The attribute of grids that holds what is made for devices.
_ON_DEVICES = "_on_devices"


@dataclass
class Ray:
    """Rays in the volume's coordinates, one per lane.

    Attributes
    ----------
    origin, direction : list of three arrays
        ``origin + t direction`` with a unit direction pointing the way the ray is walked.
    first, last : array or None
        The walk is confined to ``first <= t <= last``; None where it is not.
    active : array of Bool or None
        Lanes that are rays at all.
    waiting : cursor or None
        Where rays go on, in a walk confined to some leaves of a tree; None where they enter.
    stretches : list of (array, array), optional
        Several parts to which rays are confined, in their order; a walk goes through one of them.
    """

    origin: list[Float]
    direction: list[Float]
    first: Float = None
    last: Float = None
    active: Mask = None
    waiting: Any = None
    stretches: list[tuple[Float, Float]] | None = None

    def confined(self, first: Float, last: Float) -> Ray:
        """Return rays that are also confined to ``first <= t <= last``, in one stretch."""
        if self.first is not None:
            first = dr.select(self.first > first, self.first, first)
        if self.last is not None:
            last = dr.select(self.last < last, self.last, last)
        return replace(self, first=first, last=last, stretches=None)


@dataclass
class Segment:
    """The stretch of a ray inside one cell.

    Attributes
    ----------
    cell : array of UInt
        Flat index of the cell.
    length : array
        Its length, in units of the grid's scale.
    begin, end : array
        Distances along the ray where it begins and ends.
    active : array of Bool
        Lanes that are in a cell: neither outside nor in a gap.
    exit : object
        What the grid needs to find where the segment leaves the cell; for `Walk.exit_corners`.
    ray, walk, track, entry, backward, hidden
        The ray it is a part of, its walk and track, the cursor where it begins, whether it runs
        towards the camera, and where it is not solved because the cell has no value; for schemes,
        sources and media. Set by the ray loop.
    unsolved : array of Bool
        Where a scheme has solved only a part of it, or nothing yet; set by the scheme. The ray loop
        asks it again, with what is carried, until all is solved.
    """

    cell: Int
    length: Float
    begin: Float
    end: Float
    active: Mask
    exit: Any
    ray: Ray | None = field(default=None, kw_only=True)
    walk: Any = field(default=None, kw_only=True)
    track: Any = field(default=None, kw_only=True)
    entry: Any = field(default=None, kw_only=True)
    backward: bool = field(default=False, kw_only=True)
    hidden: Mask = field(default=False, kw_only=True)
    unsolved: Mask = field(default=False, kw_only=True)

    @property
    def own_cell(self) -> Int:
        """Number of the grid's own cell; in a dual walk alone there is none."""
        return self.cell


@dataclass
class Corners:
    """Vertices around a point and their weights: ``Σ weight[k] f[vertex[k]]`` interpolates f."""

    vertex: list[Int]
    weight: list[Float]


@dataclass(frozen=True)
class CellBox:
    """A box of cells to which a walk is confined; of trees, some consecutive leaves.

    `low` and `high` are the first cell along each axis of a field, and the one after the last.
    """

    low: tuple[int, ...]
    high: tuple[int, ...]

    @property
    def with_ghosts(self) -> tuple[slice, slice, slice]:
        """The cells whose values a dual walk needs: one layer more on the low sides."""
        x, y, z = (slice(max(a - 1, 0), b) for a, b in zip(self.low, self.high, strict=True))
        return x, y, z


class Track:
    """What is constant along a ray.

    `entry` is the distance from its origin to where distances count from, in units of the scale;
    `arrive` what cursors' distances are there.
    """

    entry: Float
    arrive: ClassVar[Any] = 0.0


class Cursor(Protocol):
    """Where a ray is: a dataclass of arrays; `inside` are the lanes still in the domain."""

    inside: Mask


@dataclass
class Landing:
    """Where rays are once they have crossed space in which there is nothing to gather.

    `moved` are the lanes that have crossed any; `holds` returns of a later cursor the lanes that
    have not come to more of it.
    """

    cursor: Any
    moved: Mask
    holds: Callable[[Any], Mask]


# Moves the cursors of one track beyond such space.
Skip = Callable[[Any], Landing]


class Walk:
    """How rays walk through a grid, traced into the kernel; see `VertexWalk` and `FieldWalk` too.

    Attributes
    ----------
    scale : array
        The grid's scale.
    in_cells : bool
        Segments lie in one cell of the grid each; in a walk through dual cells they do not.
    """

    scale: Float
    in_cells: bool = True

    def enter(self, ray: Ray) -> tuple[Any, Any]:
        """Return the `Track` and the `Cursor` where each ray enters."""
        raise NotImplementedError

    def next(self, track: Any, cursor: Any) -> tuple[Segment, Any]:
        """Return the segment through the present cell, and the cursor at its end.

        In a gap the segment is not active, and its cell is any that there is. There the cursor is
        of no use: `skipper` leads on.
        """
        raise NotImplementedError

    def skipper(self, track: Any, bricks: Any = None) -> Skip | None:
        """Return what moves rays beyond gaps, and empty `bricks`; None where it would do nothing.

        Gaps are space in the domain that belongs to no cell. To be made outside of loops: what is
        constant along rays is computed once. `bricks`: see `grids.cartesian.leap`.
        """
        return None

    def step(self, track: Any, cursor: Any) -> tuple[Segment, Any]:
        """Return the next segment in a cell, beyond the gap that a ray may be in; see `next`."""
        skip = self.skipper(track)
        return self.next(track, cursor if skip is None else skip(cursor).cursor)


class VertexWalk(Protocol):
    """What schemes with coefficients at vertices also ask of a walk of the kind ``"cells"``."""

    def entry_corners(self, track: Any, cursor: Any) -> Corners:
        """Return the vertices around the cursor."""

    def exit_corners(self, track: Any, segment: Segment) -> Corners:
        """Return the vertices around the end of a segment."""


class FieldWalk(Protocol):
    """What schemes that interpolate fields also ask of a walk of the kind ``"dual"``.

    `continuous`: interpolated fields are continuous from segment to segment, so that values at the
    end of one serve at the beginning of the next. False where each cell has a function of position
    alone.
    """

    continuous: bool

    def chord(self, track: Any, segment: Segment) -> Chord:
        """Return where a segment runs through its dual cell."""


class Chord(Protocol):
    """A segment in a (dual) cell, or in a cube of them.

    `cell`: number of the cell; `corner`: that of its lower corner, where corners are numbered;
    `width`: how many cells wide the cube is, None for a single cell; `position`, `step`: where it
    enters, and the vector to where it leaves, in the volume's coordinates.
    """

    @property
    def cell(self) -> Int: ...
    @property
    def corner(self) -> Int: ...
    @property
    def width(self) -> Float | None: ...
    @property
    def position(self) -> list[Float]: ...
    @property
    def step(self) -> list[Float]: ...
    def at(self, s: Float) -> tuple[Any, list[Float]]:
        """Return the cell around a place of the segment, s from 0 to 1, and the place in it.

        The cell is one that `FieldLattice.corners` takes; the place three numbers from 0 to 1.
        """


class Grid:
    """A grid on the host: the base class of all grids; see `BoxGrid`, `VertexGrid`, `DualGrid` too.

    A new grid needs the attributes without a default, `cell_centers`, `locate` and `walk`. Cells
    have flat numbers: C order of `shape` where a grid has three axes (the last one is fastest), the
    order of its leaves where it is refined. All lengths are plain floats in `unit`.

    Attributes
    ----------
    kind : str
        The name by which descriptions and native files know the grid.
    unit : astropy unit or None
        Length unit; None is dimensionless.
    coordinates : tuple of three str
        Names of the grid's coordinates, such as ``("r", "theta", "phi")``, angles in radians.
    mirror : bool
        What is above the midplane is also below (spherical grids).
    shape : tuple of int
        The shape of a field: ``(n1, n2, n3)``, or ``(cells,)``.
    size : int
        Number of cells.
    scale : float
        Typical cell width (the smallest useful one): lengths in kernels are in this unit.
    bounds : array, shape (3, 2)
        Corners of the Cartesian box around the domain.
    cell_volumes : array
        Volumes of the cells, exact, of the grid's shape; a mirrored cell counts twice.
    """

    kind: str = "unnamed"
    unit: Any = None
    coordinates: tuple[str, str, str] = CARTESIAN
    mirror: bool = False

    if TYPE_CHECKING:  # attributes or properties, as a grid likes

        @property
        def shape(self) -> tuple[int, ...]: ...
        @property
        def size(self) -> int: ...
        @property
        def scale(self) -> float: ...
        @property
        def bounds(self) -> np.ndarray: ...
        @property
        def cell_volumes(self) -> np.ndarray: ...

    def cell_centers(self, first: int = 0, last: int | None = None) -> np.ndarray:
        """Return x, y and z of the centres of the cells from `first` to `last`, shape (3, n).

        Of curvilinear cells it is where each coordinate is in its middle.
        """
        raise NotImplementedError

    def cell_sizes(self, first: int = 0, last: int | None = None) -> np.ndarray:
        """Return the cells' widths along their coordinates, as lengths, shape (3, n).

        Of curvilinear cells they are measured through the centre: Δr, r Δθ, r sin θ Δφ. Where cells
        are no boxes, they are those of a cube of the same volume.
        """
        width = np.cbrt(self.cell_volumes.reshape(-1)[first:last])
        return np.broadcast_to(width, (3, len(width)))

    def locate(self, points: Any) -> np.ndarray:
        """Return the flat number of the cell that each point is in, -1 outside.

        Parameters
        ----------
        points : array_like or Quantity, shape (n, 3)
            Cartesian coordinates; plain numbers are in the grid's unit. A point on a wall is in one
            of the cells around.
        """
        raise NotImplementedError

    def walk(self, backend: Backend, kind: str = "cells", box: CellBox | None = None) -> Any:
        """Return the `Walk` for a backend.

        Parameters
        ----------
        backend : Backend
            Device and precision.
        kind : str
            ``"cells"``: through the cells; ``"dual"``: through the dual cells of a `DualGrid`;
            ``"substeps"``: through the cells in the sub-steps of RADMC-3D.
        box : CellBox, optional
            Confine it to these cells. Geometry and distances are those of the whole domain; cells
            are numbered within the box, and vertices of the dual walk within
            `CellBox.with_ghosts`. Rays through some leaves of a tree go on where they are
            `Ray.waiting`.

        Raises
        ------
        InputError
            If the grid has no such walk.
        """
        raise NotImplementedError

    def pack(self, value: Any) -> np.ndarray:
        """Return what a user gives as a field, as an array; its shape is checked elsewhere.

        Where fields have one array per patch, these are put into the order of cells, and covered
        cells are left out.
        """
        return np.asarray(value)

    def needs_double(self) -> bool:
        """Return True where single precision cannot tell cells apart."""
        return False

    def describe(self) -> dict[str, Any]:
        """Return what ``voluminous info`` and an image's provenance say about the grid.

        Plain values: type, shape, bounds, unit; ``cells_per_level`` where it is refined.
        """
        return {
            "type": self.kind,
            "shape": list(self.shape),
            "bounds": self.bounds.tolist(),
            "unit": unit_name(self.unit),
        }

    def _counts(self) -> str:
        return f"{'x'.join(map(str, self.shape))} cells"

    def _limits(self) -> Iterable[Sequence[float]]:
        return self.bounds

    def __repr__(self) -> str:
        limits = zip(self.coordinates, self._limits(), strict=True)
        ends = [f"{name}: {span(low, high)}" for name, (low, high) in limits]
        parts = [self._counts(), *ends, *(["mirrored"] if self.mirror else [])]
        return f"<{type(self).__name__} {', '.join(parts)} {unit_name(self.unit)}".rstrip() + ">"

    def __getstate__(self) -> dict[str, Any]:
        """Return all but what devices hold: another process makes its own."""
        return {name: value for name, value in vars(self).items() if name != _ON_DEVICES}


class BoxGrid(Grid):
    """Cells lie between two values of each of the grid's coordinates.

    Attributes
    ----------
    levels : array of uint8
        How often each cell's base cell was refined, of the grid's shape.
    resolution : float
        Width of the thinnest cell as a part of the domain's, or of its distance from where
        distances are counted: where it is below 3e-5, kernels need double precision.
    """

    if TYPE_CHECKING:

        @property
        def levels(self) -> np.ndarray: ...
        @property
        def resolution(self) -> float: ...

    def spans(self, first: int = 0, last: int | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Return where cells begin and end along their coordinates, shape (3, n) each."""
        center, half = self.cell_centers(first, last), 0.5 * self.cell_sizes(first, last)
        return center - half, center + half

    def native_centers(self, first: int = 0, last: int | None = None) -> np.ndarray:
        """Return the centres in the grid's coordinates, shape (3, n)."""
        return self.cell_centers(first, last)

    def needs_double(self) -> bool:
        return bool(self.resolution < np.finfo(np.float32).eps * _POINTS_PER_CELL)


class VertexGrid(Grid):
    """A grid with vertices, for schemes with coefficients there; its walk is a `VertexWalk`."""

    if TYPE_CHECKING:

        @property
        def vertex_count(self) -> int: ...

    def vertex_cells(self, vertex: Int, backend: Backend) -> list[tuple[Int, Mask]]:
        """Return the eight cells around vertices, each with where it exists (traced).

        Coefficients at a vertex are plain means over those that exist; one that is named twice
        counts twice. With three axes, vertices are numbered in C order of ``(n1 + 1, n2 + 1,
        n3 + 1)``, and those of layer i of the first axis touch only cells of its layers i - 1
        and i.
        """
        raise NotImplementedError


class DualGrid(Grid):
    """A grid with a walk of the kind ``"dual"``, a `FieldWalk`, for the default scheme.

    Attributes
    ----------
    dual_layout : str or callable
        Where the values around a dual cell are: ``"cells"`` of the grid, and one layer more around
        them; ``"dual vertices"`` (curvilinear grids); the ``"corners"`` of the leaves of a tree. Or
        a function of arrays, a backend, and of which of the fields the integral is to be the sum
        over cells; it returns a `rendering.sources.corner_layouts.FieldLattice` for each.
    """

    dual_layout: str | Callable[[Sequence[np.ndarray], Backend, Sequence[bool]], list[Any]]


def native_centers(grid: Grid, first: int = 0, last: int | None = None) -> np.ndarray:
    """Return the centres of cells in a grid's coordinates, shape (3, n)."""
    if isinstance(grid, BoxGrid):
        return grid.native_centers(first, last)
    return grid.cell_centers(first, last)


def basis(grid: Grid, first: int = 0, last: int | None = None) -> np.ndarray:
    """Return unit vectors along the coordinates at the centres of cells, shape (3, 3, n).

    ``[k, :, i]`` are the Cartesian components of the direction in which coordinate k of cell i
    increases.
    """
    return unit_vectors(tuple(grid.coordinates), native_centers(grid, first, last))


def check_walk(grid: Grid, kind: str, kinds: Sequence[str], box: CellBox | None) -> None:
    """Refuse kinds of walks that a grid does not have, and a box of cells to confine one to."""
    if kind not in kinds:
        raise InputError(
            f"a {grid.kind} grid has no walk of the kind {kind!r}, only "
            f"{', '.join(map(repr, kinds))}; use scheme='first-order'"
        )
    if box is not None:
        raise InputError(
            f"rays through a {type(grid).__name__} cannot be confined to a box of its cells "
            "(box=): CartesianGrid can, with the walks 'cells' and 'dual'; octrees and patches "
            "to consecutive leaves, CellBox((first,), (last,))"
        )


def on_device(grid: Grid, backend: Backend, what: str, make: Callable[[], Made]) -> Made:
    """Return what `make` returned the first time for a backend; it is stored with the grid."""
    cached: dict[Any, Made] = grid.__dict__.setdefault(_ON_DEVICES, {})
    key = (backend, what)
    if key not in cached:
        cached[key] = make()
    return cached[key]


def cells_across(grid: Grid) -> float:
    """Return about how many cells a ray crosses at most."""
    return float(sum(grid.shape)) if len(grid.shape) == 3 else 3.0 * float(np.cbrt(grid.size))
