"""The contract of a grid: the host side (`Grid`) and the walk that a kernel traces (`Walk`).

Both are base classes: what has a default here need not be written for a new grid.

Lengths inside a kernel are in units of ``grid.scale`` (a typical cell width), so that single
precision never overflows, whatever the unit of the data. Distances along a ray are counted from the
point where it enters the whole domain: pieces of a volume agree on them.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, NoReturn, Protocol, TypeVar

import numpy as np

from ..backend.types import Float, Int, Mask
from ..errors import InputError
from ..geometry import CARTESIAN, span
from ..units import unit_name

if TYPE_CHECKING:
    from ..backend import Backend

Made = TypeVar("Made")
# Single precision must tell this many points apart across the thinnest cell.
_POINTS_PER_CELL = 256


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
    """

    origin: list[Float]
    direction: list[Float]
    first: Float = None
    last: Float = None
    active: Mask = None
    waiting: Any = None


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
    ray, walk, track, entry, backward
        The ray it is a part of, its walk and track, the cursor where it begins, and whether it runs
        towards the camera; for schemes, sources and media. Set by the ray loop.
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
    """A grid on the host: the base class of all grids.

    A new grid needs what is listed first under Attributes, `cell_centers`, `locate` and `walk`;
    all else has a default. Cells have flat numbers: C order of `shape` where a grid has three axes
    (the last one is fastest), the order of its leaves where it is refined. All lengths are plain
    floats in `unit`.

    Attributes
    ----------
    unit : astropy unit or None
        Length unit; None is dimensionless.
    size : int
        Number of cells.
    shape : tuple of int
        The shape of a field: ``(n1, n2, n3)``, or ``(cells,)``.
    scale : float
        Typical cell width (the smallest useful one): lengths in kernels are in this unit.
    bounds : array, shape (3, 2)
        Corners of the Cartesian box around the domain.
    cell_volumes : array
        Volumes of the cells, exact, of the grid's shape; a mirrored cell counts twice.
    resolution : float
        Width of the thinnest cell as a part of the domain's, or of its distance from where
        distances are counted: where it is below 3e-5, kernels need double precision.
    levels : array of uint8
        How often each cell's base cell was refined, of the grid's shape.
    kind : str
        The name by which descriptions and native files know the grid.
    coordinates : tuple of three str
        Names of the grid's own coordinates, such as ``("r", "theta", "phi")``, angles in radians.
    edges : tuple of three arrays
        Walls along the own coordinates; of structured grids, and of base cells.
    walk_kinds : tuple of str
        Which walks it has: always ``"cells"``; see `walk`.
    cells_are_boxes : bool
        Each cell lies between two values of each of the grid's own coordinates, and `cell_sizes`
        and `native_centers` tell which. Other cells have sizes that are estimates.
    is_rectilinear : bool
        Structured, with walls that are planes of x, y and z.
    is_uniform : bool
        Rectilinear, with cells all alike.
    is_periodic : bool
        Azimuth spans a full circle.
    mirror : bool
        What is above the midplane is also below (spherical grids).
    has_bricks : bool
        Rays may leap over bricks of its cells (`grids.cartesian.leap`).
    has_vertices : bool
        It has `vertex_count` and `vertex_cells`, for schemes with coefficients at vertices.
    has_traced_centers : bool
        Kernels can compute `traced_centers`.
    has_neighbourhood : bool
        Kernels can find neighbours of cells through `neighbourhood`.
    can_be_pruned : bool
        Rays can walk through the cells that show something alone: `pruned`, `walk_through`.
    base_edges : tuple of three arrays
        Walls of the base cells of Cartesian trees.
    places, patches : object or None
        How the cells of octrees, and of patches, are nested.
    """

    kind: str = "unnamed"
    coordinates: tuple[str, str, str] = CARTESIAN
    walk_kinds: tuple[str, ...] = ("cells",)
    mirror: bool = False
    cells_are_boxes: bool = False
    is_rectilinear: bool = False
    has_bricks: bool = False
    has_vertices: bool = False
    has_traced_centers: bool = False
    has_neighbourhood: bool = False
    can_be_pruned: bool = False
    edges: tuple[np.ndarray, ...] = ()
    places: Any = None
    patches: Any = None
    base_edges: tuple[np.ndarray, ...] = ()
    unit: Any = None

    if TYPE_CHECKING:  # attributes or properties, as a grid likes

        @property
        def size(self) -> int: ...
        @property
        def shape(self) -> tuple[int, ...]: ...
        @property
        def scale(self) -> float: ...
        @property
        def bounds(self) -> np.ndarray: ...
        @property
        def cell_volumes(self) -> np.ndarray: ...
        @property
        def levels(self) -> np.ndarray: ...
        @property
        def is_uniform(self) -> bool: ...
        @property
        def is_periodic(self) -> bool: ...
        @property
        def vertex_count(self) -> int: ...
        @property
        def resolution(self) -> float: ...
    else:
        is_uniform = is_periodic = False
        resolution = 1.0

    @property
    def is_structured(self) -> bool:
        """Whether cells are numbered along three axes."""
        return len(self.shape) == 3

    @property
    def cells_across(self) -> float:
        """About how many cells a ray crosses at most."""
        if self.is_structured:
            return float(sum(self.shape))
        return 3.0 * float(np.cbrt(self.size))

    def pack(self, value: Any) -> np.ndarray:
        """Return what a user gives as a field, as an array; its shape is checked elsewhere.

        Where fields come in parts (one array per patch) they are put into the order of cells, and
        what finer cells hide is left out.
        """
        return np.asarray(value)

    def unpack(self, flat: np.ndarray) -> Any:
        """Return a field the way `pack` takes it; hidden cells are NaN, or zero for integers."""
        return np.asarray(flat).reshape(self.shape)

    def cell_centers(self, first: int = 0, last: int | None = None) -> np.ndarray:
        """Return x, y and z of the centres of the cells from `first` to `last`, shape (3, n).

        Of curvilinear cells it is where each own coordinate is in its middle.
        """
        raise NotImplementedError

    def native_centers(self, first: int = 0, last: int | None = None) -> np.ndarray:
        """Return the centres in the grid's own coordinates, shape (3, n)."""
        return self.cell_centers(first, last)

    def basis(self, first: int = 0, last: int | None = None) -> np.ndarray:
        """Return unit vectors along the own coordinates at the centres, shape (3, 3, n).

        ``[k, :, i]`` are the Cartesian components of the direction in which coordinate k of cell i
        increases.
        """
        count = (self.size if last is None else last) - first
        return np.broadcast_to(np.eye(3)[..., None], (3, 3, count))

    @functools.cached_property
    def thinnest(self) -> float:
        """Length of the shortest side of a cell; angles do not count on grids of arrays."""
        if not self.is_structured:
            return float(self.cell_sizes().min())
        walls = zip(self.coordinates, self.edges, strict=True)
        return min(float(np.diff(e).min()) for name, e in walls if name not in ("theta", "phi"))

    def cell_sizes(self, first: int = 0, last: int | None = None) -> np.ndarray:
        """Return the cells' widths along their own coordinates, as lengths, shape (3, n).

        Of curvilinear cells they are measured through the centre: Δr, r Δθ, r sin θ Δφ. Where cells
        are no boxes, they are those of a cube of the same volume.
        """
        width = np.cbrt(self.cell_volumes.reshape(-1)[first:last])
        return np.broadcast_to(width, (3, len(width)))

    def spans(self, first: int = 0, last: int | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Return where cells begin and end along their own coordinates, shape (3, n) each.

        Of cells that are boxes.
        """
        center, half = self.cell_centers(first, last), 0.5 * self.cell_sizes(first, last)
        return center - half, center + half

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
            ``"cells"``: through the cells; ``"dual"``: through the dual cells between their
            centres; ``"substeps"``: through the cells in the sub-steps of RADMC-3D.
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

    def check_no_box(self, box: CellBox | None) -> None:
        """Raise an InputError if there is a box, which a walk is to be confined to."""
        if box is not None:
            raise InputError(
                f"rays through a {type(self).__name__} cannot be confined to a box of its cells "
                "(box=): CartesianGrid can, with the walks 'cells' and 'dual'; octrees and patches "
                "to consecutive leaves, CellBox((first,), (last,))"
            )

    def lattice(
        self, arrays: Sequence[np.ndarray], backend: Backend, sums: Sequence[bool] = ()
    ) -> list[Any]:
        """Return fields as dual walks gather them, one for each array.

        `sums` says of which fields the integral is to be the sum over cells, however steep they
        are; by default of none.
        """
        self.refuse("fields between its cells")

    def vertex_cells(self, vertex: Int, backend: Backend) -> list[tuple[Int, Mask]]:
        """Return the eight cells around vertices, each with where it exists (traced).

        Coefficients at a vertex are plain means over those that exist; one that is named twice
        counts twice. With three axes, vertices are numbered in C order of ``(n1 + 1, n2 + 1,
        n3 + 1)``, and those of layer i of the first axis touch only cells of its layers i - 1
        and i.
        """
        self.refuse("vertices")

    def traced_centers(self, cell: Int, backend: Backend) -> list[Float]:
        """Return x, y and z of cell centres from flat cell numbers (traced)."""
        self.refuse("centres that kernels compute")

    def neighbourhood(self, backend: Backend) -> Any:
        """Return what finds neighbours of cells in kernels, and how far they are."""
        self.refuse("neighbours that kernels find")

    def pruned(self, visible: Any) -> Any:
        """Return the tree with holes for cells of which `visible` is false."""
        self.refuse("cells that can be left out")

    def walk_through(self, tree: Any, backend: Backend, kind: str = "cells") -> Any:
        """Return a walk through another tree over the same domain, such as one with holes."""
        self.refuse("cells that can be left out")

    def refuse(self, lacking: str) -> NoReturn:
        """Raise an InputError for what the grid does not have: a scheme needs less."""
        raise InputError(f"a {type(self).__name__} has no {lacking}; use scheme='first-order'")

    def needs_double(self) -> bool:
        """Return True where single precision cannot tell cells apart."""
        return bool(self.resolution < np.finfo(np.float32).eps * _POINTS_PER_CELL)

    def describe(self) -> dict[str, Any]:
        """Return what ``voluminous info`` and an image's provenance tell of the grid.

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

    def __repr__(self) -> str:
        walls = zip(self.coordinates, self.base_edges or self.edges, strict=False)
        limits = [f"{name}: {span(e[0], e[-1])}" for name, e in walls]
        mirrored = ["mirrored"] if self.mirror else []
        told = ", ".join([self._counts(), *limits, *mirrored])
        return f"<{type(self).__name__} {told} {unit_name(self.unit)}".rstrip() + ">"

    def on_device(self, backend: Backend, what: str, make: Callable[[], Made]) -> Made:
        """Return what `make` returned the first time for a backend: once made, it is kept."""
        cached: dict[Any, Made] = self.__dict__.setdefault("_on_devices", {})
        key = (backend, what)
        if key not in cached:
            cached[key] = make()
        return cached[key]

    def __getstate__(self) -> dict[str, Any]:
        """Return all but what devices hold: another process makes its own."""
        return {name: value for name, value in vars(self).items() if name != "_on_devices"}
