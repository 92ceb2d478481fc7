"""What a grid promises: the host side (`Grid`) and the walk a kernel traces (`Walk`).

Lengths inside a kernel are in units of ``grid.scale`` (a typical cell width), so that single
precision never overflows, whatever the unit of the data. Distances along a ray are counted from the
point where it enters the whole domain: pieces of a volume agree on them.
"""

from __future__ import annotations

from dataclasses import dataclass
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
    """

    cell: Any
    length: Any
    begin: Any
    end: Any
    active: Any
    exit: Any


@dataclass
class Corners:
    """Vertices around a point and their weights: ``Σ weight[k] f[vertex[k]]`` interpolates f."""

    vertex: list[Any]
    weight: list[Any]


class Walk(Protocol):
    """How rays walk through a grid, traced into the kernel.

    A *track* holds what is constant along a ray, a *cursor* (a dataclass of arrays, part of the
    loop's state) where it is now; ``cursor.inside`` tells the lanes that still have a way to go.
    """

    leaps: bool  # rays may cross empty blocks in one step (`grids.leap`)

    def enter(self, ray: Ray) -> tuple[Any, Any]:
        """Return the track and the cursor at the point where each ray enters."""

    def next(self, track: Any, cursor: Any) -> tuple[Segment, Any]:
        """Return the segment through the present cell, and the cursor at its end."""

    def entry_corners(self, track: Any, cursor: Any) -> Corners:
        """Return the vertices around the point where the cursor is."""

    def exit_corners(self, track: Any, segment: Segment) -> Corners:
        """Return the vertices around the point where a segment ends."""


class Grid(Protocol):
    """What schemes, media and cameras may ask of a grid on the host."""

    unit: Any
    shape: tuple[int, ...]
    scale: float

    @property
    def size(self) -> int:
        """Number of cells."""

    @property
    def bounds(self) -> np.ndarray:
        """Corners of the domain, shape (3, 2)."""

    def walk(self, backend: Any, kind: str = "cells") -> Walk:
        """Return the walk for a backend.

        It goes through the cells; or through the dual cells between their centres (``"dual"``);
        or, where the grid can, through the cells with RADMC-3D's rounding (``"reckoned"``).
        """

    def needs_double(self) -> bool:
        """Return True where single precision cannot tell cells apart."""

    def describe(self) -> dict[str, Any]:
        """Return what ``voluminous info`` and an image's provenance tell of the grid."""
