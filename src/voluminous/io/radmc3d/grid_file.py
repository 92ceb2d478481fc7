"""The file ``amr_grid``: what is in it, read in all its forms."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import FileFormatError
from .binary import BinaryFile
from .known import opened
from .records import RecordFile
from .text import TextFile

REGULAR, OCTREE, LAYERS = 0, 1, 10
SPHERICAL, BEYOND = 100, 200
# RADMC-3D refuses deeper trees.
DEEPEST = 20
_AXES = "xyz"
Source = BinaryFile | TextFile | RecordFile


@dataclass(frozen=True, eq=False)
class GridFile:
    """What the file says.

    Attributes
    ----------
    style : {REGULAR, OCTREE, LAYERS}
    coordinates : int
        Below 100 Cartesian, below 200 spherical.
    active : tuple of three bool
        Dimensions that there are: along others there is one cell, which is never refined.
    walls : tuple of three float64 arrays
        Of the base grid: x, y, z in cm; or r in cm, theta and phi in radian.
    flags : array of uint8 or None
        Of octrees: 1 for each node that is split, depth first.
    layers : array of int64, shape (n, 7), or None
        Of layers: parent; first cell from 1, number of cells, in cells of the parent.
    """

    style: int
    coordinates: int
    active: tuple[bool, ...]
    walls: tuple[NDArray[np.float64], ...]
    flags: NDArray[np.uint8] | None = None
    layers: NDArray[np.int64] | None = None

    def __eq__(self, other: object) -> bool:
        """Return True for the same cells."""
        if not isinstance(other, GridFile):
            return NotImplemented
        mine, theirs = (
            (g.style, g.spherical, g.active, *map(_bytes, (*g.walls, g.flags, g.layers)))
            for g in (self, other)
        )
        return mine == theirs

    __hash__ = None  # type: ignore[assignment]

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of cells of the base grid."""
        return tuple(len(w) - 1 for w in self.walls)

    @property
    def spherical(self) -> bool:
        """True for r, theta, phi."""
        return self.coordinates >= SPHERICAL

    @property
    def names(self) -> tuple[str, str, str]:
        """Names of the coordinates."""
        return ("r", "theta", "phi") if self.spherical else ("x", "y", "z")

    @property
    def factors(self) -> NDArray[np.int64]:
        """Number of cells along each axis that a refined one is split into."""
        return np.where(self.active, 2, 1)

    @property
    def cells(self) -> int:
        """Number of values per field in files: cells below finer layers are among them."""
        if self.flags is not None:
            return len(self.flags) - int(np.count_nonzero(self.flags))
        cells = math.prod(self.shape)
        if self.layers is None:
            return cells
        finer = math.prod(self.factors.tolist())
        return cells + sum(finer * math.prod(row[4:]) for row in self.layers.tolist())


def _bytes(array: NDArray[np.generic] | None) -> bytes:
    return b"" if array is None else array.tobytes()


def read_grid(path: Path) -> GridFile:
    """Return what a grid file says.

    Raises
    ------
    FileFormatError
        If it is damaged, at odds with itself, or RADMC-3D would not take it.
    """
    with opened(path) as source:
        _expect("the format number", source.format(False), 1, 2)
        (style,) = source.integers(1, "the grid style")
        (coordinates,) = source.integers(1, "the coordinate system")
        _expect("the grid style", style, REGULAR, 2 * LAYERS)
        _expect("the coordinate system", coordinates, 0, BEYOND)
        _expect("gridinfo", source.integers(1, "gridinfo")[0], 0, 1)
        active = tuple(flag != 0 for flag in source.integers(3, "the active dimensions"))
        shape = source.integers(3, "the numbers of cells")
        _check_shape(shape, active)
        sizes = _sizes(source, style)
        walls = tuple(_walls(source, n, axis) for n, axis in zip(shape, _AXES, strict=True))
        if style >= LAYERS:
            layers = _read_layers(source, sizes[1], active)
            source.end()
            return GridFile(LAYERS, coordinates, active, walls, layers=layers)
        if style >= OCTREE:
            flags = _read_flags(source, sizes, math.prod(shape), 1 << sum(active))
            return GridFile(OCTREE, coordinates, active, walls, flags)
        source.end()
        return GridFile(REGULAR, coordinates, active, walls)


def _expect(what: str, number: int, least: int, beyond: int) -> None:
    if not least <= number < beyond:
        expected = str(least) if beyond == least + 1 else f"{least} to {beyond - 1}"
        raise FileFormatError(f"{what} must be {expected}, got {number}")


def _check_shape(shape: list[int], active: tuple[bool, ...]) -> None:
    for n, used, axis in zip(shape, active, _AXES, strict=True):
        if n < 1 or (n > 1 and not used):
            allowed = "at least 1" if used else "1, for the dimension is inactive"
            raise FileFormatError(f"the number of cells along {axis} must be {allowed}, got {n}")


def _sizes(source: Source, style: int) -> list[int]:
    if style < OCTREE:
        return []
    layered = style >= LAYERS
    names = ["levels", "layers"] if layered else ["levels", "leaves", "nodes"]
    sizes = source.integers(len(names), f"the numbers of {', '.join(names)}")
    for name, number in zip(names, sizes, strict=True):
        if number < 0:
            raise FileFormatError(f"the number of {name} must not be negative, got {number}")
    if sizes[0] > DEEPEST:
        raise FileFormatError(
            f"the grid shall be {sizes[0]} levels deep; RADMC-3D takes {DEEPEST} at most"
        )
    return sizes


def _walls(source: Source, cells: int, axis: str) -> NDArray[np.float64]:
    walls = source.reals(cells + 1, f"{axis} walls")
    rising = np.isfinite(walls) & (np.diff(walls, prepend=-np.inf) > 0)
    if not rising.all():
        k = int(np.argmin(rising))
        raise FileFormatError(
            f"{axis} walls must be finite and increase; the one of number {k + 1} is {walls[k]:g}"
        )
    return walls


def _read_flags(source: Source, sizes: list[int], base: int, children: int) -> NDArray[np.uint8]:
    flags = source.flags("the octree")
    splits = int(np.count_nonzero(flags))
    leaves, expected = len(flags) - splits, base + children * splits
    if len(flags) != expected:
        short = "it is cut short: " if len(flags) < expected else ""
        raise FileFormatError(
            f"{short}the octree has {base} base cells and {splits} splits into {children}, which "
            f"make {expected} nodes; found {len(flags)}"
        )
    for what, found, promised in (("leaves", leaves, sizes[1]), ("nodes", len(flags), sizes[2])):
        if found > promised:
            raise FileFormatError(f"the octree has {found} {what}, but {promised} are promised")
    return flags


def _read_layers(source: Source, count: int, active: tuple[bool, ...]) -> NDArray[np.int64]:
    rows = []
    for k in range(count):  # ends with the file
        rows.append(source.integers(7, f"layer {k + 1}"))
    layers = np.array(rows, np.int64).reshape(-1, 7)
    layers[:, 4:][:, ~np.array(active)] = 1  # whatever is said of dimensions that are not there
    return layers
