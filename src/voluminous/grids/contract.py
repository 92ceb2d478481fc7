"""What a grid promises: the host side (`Grid`) and the walk a kernel traces (`Walk`).

Lengths inside a kernel are in units of ``grid.scale`` (a typical cell width), so that single
precision never overflows, whatever the unit of the data. Distances along a ray are counted from the
point where it enters the whole domain: pieces of a volume agree on them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np


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
    start : list of three arrays, optional
        A point of the ray before the domain, rounded as in RADMC-3D; for a walk by dead reckoning.
    """

    origin: list[Any]
    direction: list[Any]
    first: Any = None
    last: Any = None
    active: Any = None
    start: list[Any] | None = None


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
        Lanes that are still inside.
    exit : object
        What the grid needs to find where the segment leaves the cell; for `Walk.exit_corners`.
    ray, walk, track, backward
        The ray it is a part of, its walk and track, and whether it runs towards the camera; for
        schemes, sources and media. Set by the ray loop.
    """

    cell: Any
    length: Any
    begin: Any
    end: Any
    active: Any
    exit: Any
    ray: Ray | None = field(default=None, kw_only=True)
    walk: Any = field(default=None, kw_only=True)
    track: Any = field(default=None, kw_only=True)
    backward: bool = field(default=False, kw_only=True)


@dataclass
class Corners:
    """Vertices around a point and their weights: ``Σ weight[k] f[vertex[k]]`` interpolates f."""

    vertex: list[Any]
    weight: list[Any]


class Landing(Protocol):
    """Where rays are once they have crossed space in which there is nothing to gather.

    Attributes
    ----------
    cursor : object
        Where they are.
    moved : array of Bool
        Lanes that have crossed any.
    """

    cursor: Any
    moved: Any

    def holds(self, cursor: Any) -> Any:
        """Return the lanes that may go on from there: they have not come to more of it."""


class Walk(Protocol):
    """How rays walk through a grid, traced into the kernel.

    A *track* holds what is constant along a ray (``track.entry``: how far from its origin distances
    begin to count, in units of the scale), a *cursor* (a dataclass of arrays, part of the
    loop's state) where it is now; ``cursor.inside`` tells the lanes that still have a way to go.
    """

    leaps: bool  # rays may cross empty blocks in one step (`grids.cartesian.leap`)

    # Besides, if there is space in the domain that belongs to no cell: `has_gaps`, which is True
    # then, and `cross(track, cursor)`, which returns the `Landing` beyond it. A cursor in a gap has
    # no segment.

    def enter(self, ray: Ray) -> tuple[Any, Any]:
        """Return the track and the cursor at the point where each ray enters."""

    def next(self, track: Any, cursor: Any) -> tuple[Segment, Any]:
        """Return the segment through the present cell, and the cursor at its end."""

    def entry_corners(self, track: Any, cursor: Any) -> Corners:
        """Return the vertices around the point where the cursor is."""

    def exit_corners(self, track: Any, segment: Segment) -> Corners:
        """Return the vertices around the point where a segment ends."""


class Grid(Protocol):
    """What fields, schemes, media and cameras may ask of a grid on the host.

    Cells have flat numbers: C order of `shape` where a grid has three axes (the last one is
    fastest), the order of its leaves where it is refined. All lengths are plain floats in `unit`.

    Attributes
    ----------
    unit : astropy unit or None
        Length unit; None is dimensionless.
    shape : tuple of int
        The shape of a field: ``(n1, n2, n3)``, or ``(leaves,)`` where the grid is refined.
    scale : float
        Typical cell width (the smallest useful one): lengths in kernels are in this unit.
    coordinates : tuple of three str
        Names of the grid's own coordinates, such as ``("r", "theta", "phi")``, angles in radians.
    edges : tuple of three arrays
        Walls along the own coordinates; of grids with three axes.
    mirror : bool
        What is above the midplane is also below (spherical grids).
    walk_kinds : tuple of str
        Which walks it has: always ``"cells"``; see `walk`.
    has_blocks : bool
        Rays may leap over blocks of its cells (`grids.cartesian.leap`).
    """

    unit: Any
    shape: tuple[int, ...]
    scale: float
    coordinates: tuple[str, ...]
    edges: tuple[np.ndarray, ...]
    mirror: bool
    walk_kinds: tuple[str, ...]
    has_blocks: bool

    @property
    def size(self) -> int:
        """Number of cells."""

    @property
    def bounds(self) -> np.ndarray:
        """Corners of the Cartesian box around the domain, shape (3, 2)."""

    def pack(self, value: Any) -> np.ndarray:
        """Return what a user gives as a field, as an array; its shape is checked elsewhere.

        Where fields come in parts (one array per patch) they are put into the order of cells, and
        what finer cells hide is left out.
        """

    def unpack(self, flat: np.ndarray) -> Any:
        """Return a field the way `pack` takes it; hidden cells are NaN, or zero for integers."""

    def cell_centers(self, first: int = 0, last: int | None = None) -> np.ndarray:
        """Return x, y and z of the centres of the cells from `first` to `last`, shape (3, n).

        Of curvilinear cells it is where each own coordinate is in its middle.
        """

    def native_centers(self, first: int = 0, last: int | None = None) -> np.ndarray:
        """Return the centres in the grid's own coordinates, shape (3, n)."""

    def basis(self, first: int = 0, last: int | None = None) -> np.ndarray:
        """Return unit vectors along the own coordinates at the centres, shape (3, 3, n).

        ``[k, :, i]`` are the Cartesian components of the direction in which coordinate k of cell i
        increases.
        """

    def cell_sizes(self, first: int = 0, last: int | None = None) -> np.ndarray:
        """Return the cells' widths along their own coordinates, as lengths, shape (3, n).

        Of curvilinear cells they are measured through the centre: Δr, r Δθ, r sin θ Δφ.
        """

    @property
    def cell_volumes(self) -> np.ndarray:
        """Volumes of the cells, exact, of the grid's shape; a mirrored cell counts twice."""

    @property
    def levels(self) -> np.ndarray:
        """How often each cell's base cell was refined: uint8 of the grid's shape."""

    def locate(self, points: Any) -> np.ndarray:
        """Return the flat number of the cell that each point is in, -1 outside.

        Parameters
        ----------
        points : array_like or Quantity, shape (n, 3)
            Cartesian coordinates; plain numbers are in the grid's unit. A point on a wall is in one
            of the cells around.
        """

    @property
    def vertex_count(self) -> int:
        """Number of vertices, for schemes with coefficients there; needs `vertex_cells`."""

    def vertex_cells(self, vertex: Any, backend: Any) -> list[tuple[Any, Any]]:
        """Return the eight cells around vertices, each with where it exists (traced).

        Coefficients at a vertex are plain means over those that exist; one that is named twice
        counts twice. With three axes, vertices are numbered in C order of ``(n1 + 1, n2 + 1,
        n3 + 1)``, and those of layer i of the first axis touch only cells of its layers i - 1
        and i.
        """

    def walk(self, backend: Any, kind: str = "cells") -> Walk:
        """Return the walk for a backend.

        It goes through the cells; or through the dual cells between their centres (``"dual"``);
        or, where the grid can, through the cells with RADMC-3D's rounding (``"reckoned"``).
        """

    def needs_double(self) -> bool:
        """Return True where single precision cannot tell cells apart."""

    def describe(self) -> dict[str, Any]:
        """Return what ``voluminous info`` and an image's provenance tell of the grid.

        Plain values: type, shape, bounds, unit; ``cells_per_level`` where it is refined.
        """


def cells_across(grid: Any) -> float:
    """Return about how many cells a ray crosses at most."""
    if len(grid.shape) == 3:
        return float(sum(grid.shape))
    return 3.0 * float(grid.size) ** (1 / 3)


def has_blocks(grid: Any) -> bool:
    """Return whether rays may leap over blocks of a grid's cells."""
    return bool(getattr(grid, "has_blocks", False))


def has_gaps(walk: Any) -> bool:
    """Return whether there may be space in the domain that belongs to no cell."""
    return bool(getattr(walk, "has_gaps", False))
