"""The file ``amr_grid``: a regular grid, an octree, or layers of finer cells over a base grid."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import FileFormatError
from ..io.fortran import CUT, BinaryFile, Flags, Reals, TextOut

REGULAR, OCTREE, LAYERS = 0, 1, 10
SPHERICAL, BEYOND = 100, 200
# RADMC-3D refuses deeper trees.
DEEPEST = 20
_AXES = "xyz"
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class GridFile:
    """The contents of a grid file."""

    coordinates: int  # below 100 Cartesian, below 200 spherical
    active: tuple[bool, ...]  # along other dimensions there is one cell, which is never refined
    walls: tuple[Reals, ...]  # of the base grid: cm; or r in cm, angles in radian
    flags: Flags | None = None  # of octrees: 1 for each split node, depth first
    layers: Ints | None = None  # (n, 7): parent; first cell from 1, number, in cells of the parent
    levels: int = 0  # an upper limit

    def same_cells(self, other: GridFile) -> bool:
        """Return True if both describe the same cells."""
        mine, theirs = (
            [g.spherical, g.active, *(a if a is None else a.tobytes() for a in arrays)]
            for g, arrays in ((g, (*g.walls, g.flags, g.layers)) for g in (self, other))
        )
        return mine == theirs

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of cells of the base grid along each axis."""
        return tuple(len(w) - 1 for w in self.walls)

    @property
    def spherical(self) -> bool:
        """True for coordinates r, theta, phi."""
        return self.coordinates >= SPHERICAL

    @property
    def names(self) -> tuple[str, str, str]:
        """Names of the coordinates."""
        return ("r", "theta", "phi") if self.spherical else ("x", "y", "z")

    @property
    def factors(self) -> Ints:
        """Number of cells along each axis that replace a refined one."""
        return np.where(self.active, 2, 1)

    @property
    def cells(self) -> int:
        """Number of values per field in files, including cells covered by finer layers."""
        if self.flags is not None:
            return len(self.flags) - int(np.count_nonzero(self.flags))
        covered = () if self.layers is None else self.layers[:, 4:].tolist()
        return math.prod(self.shape) + sum(map(math.prod, covered)) * (1 << sum(self.active))

    def boxes(self) -> tuple[Ints, Ints, Ints]:
        """Return levels (n,), first cells and shapes (n, 3) of the base grid and its layers.

        First cells are indices on their level in the whole domain.
        """
        layers = [] if self.layers is None else self.layers.tolist()
        level, low = np.zeros(len(layers) + 1, np.int64), np.zeros((len(layers) + 1, 3), np.int64)
        shape = np.array([self.shape] * (len(layers) + 1))
        for k, (parent, *numbers) in enumerate(layers, start=1):
            if not 0 <= parent < k:
                raise FileFormatError(
                    f"the parent of layer {k} must be from 0 to {k - 1}, got {parent}: a layer "
                    "comes after its parent"
                )
            first, cells = np.array(numbers[:3]) - 1, np.array(numbers[3:])
            if (first < 0).any() or (cells < 1).any() or (first + cells > shape[parent]).any():
                raise FileFormatError(
                    f"layer {k} begins at cell {numbers[:3]} and covers {cells.tolist()} of its "
                    f"parent {parent}, which has {shape[parent].tolist()}"
                )
            level[k] = level[parent] + 1
            low[k], shape[k] = self.factors * (low[parent] + first), self.factors * cells
        if level.max() > DEEPEST:
            raise FileFormatError(f"layers are {level.max()} levels deep; {DEEPEST} are the most")
        return level, low, shape


def read_grid(source: BinaryFile) -> GridFile:
    """Return the contents of a grid file; raise FileFormatError if RADMC-3D would reject it."""
    _expect("the format number", source.format(False), 1, 2)
    (style,) = source.integers(1, "the grid style")
    _expect("the grid style", style, REGULAR, 2 * LAYERS)
    (coordinates,) = source.integers(1, "the coordinate system")
    _expect("the coordinate system", coordinates, 0, BEYOND)
    _expect("gridinfo", source.integers(1, "gridinfo")[0], 0, 1)
    active = tuple(flag != 0 for flag in source.integers(3, "the active dimensions"))
    shape = source.integers(3, "the numbers of cells")
    for n, used, axis in zip(shape, active, _AXES, strict=True):
        if n < 1 or (n > 1 and not used):
            allowed = "at least 1" if used else "1, for the dimension is inactive"
            raise FileFormatError(f"the number of cells along {axis} must be {allowed}, got {n}")
    names = ["levels", "layers"] if style >= LAYERS else ["levels", "leaves", "nodes"]
    sizes = source.integers(len(names), f"the numbers of {', '.join(names)}") if style else [0]
    for name, number in zip(names, sizes, strict=bool(style)):
        if number < 0:
            raise FileFormatError(f"the number of {name} must not be negative, got {number}")
    if sizes[0] > DEEPEST:
        raise FileFormatError(
            f"the grid shall be {sizes[0]} levels deep; RADMC-3D takes {DEEPEST} at most"
        )
    walls = tuple(_walls(source, n, axis) for n, axis in zip(shape, _AXES, strict=True))
    flags: Flags | None = None
    layers: Ints | None = None
    if LAYERS > style >= OCTREE:
        flags = _read_flags(source, sizes, math.prod(shape), 1 << sum(active))
    else:
        if style >= LAYERS:
            rows = []
            for k in range(sizes[1]):  # stops at the end of the file
                rows.append(source.integers(7, f"layer {k + 1}"))
            layers = np.array(rows, np.int64).reshape(-1, 7)
            layers[:, 4:][:, ~np.array(active)] = 1  # ignore the entries of inactive dimensions
        source.end()
    return GridFile(coordinates, active, walls, flags, layers, sizes[0])


def _expect(what: str, number: int, least: int, beyond: int) -> None:
    if not least <= number < beyond:
        expected = str(least) if beyond == least + 1 else f"{least} to {beyond - 1}"
        raise FileFormatError(f"{what} must be {expected}, got {number}")


def _walls(source: BinaryFile, cells: int, axis: str) -> Reals:
    walls = source.reals(cells + 1, f"{axis} walls")
    rising = np.isfinite(walls) & (np.diff(walls, prepend=-np.inf) > 0)
    if not rising.all():
        k = int(np.argmin(rising))
        raise FileFormatError(
            f"{axis} walls must be finite and increase; the one of number {k + 1} is {walls[k]:g}"
        )
    return walls


def _read_flags(source: BinaryFile, sizes: list[int], base: int, children: int) -> Flags:
    flags = source.flags("the octree")
    splits = int(np.count_nonzero(flags))
    expected = base + children * splits
    if len(flags) != expected:
        raise FileFormatError(
            f"{CUT if len(flags) < expected else ''}the octree has {base} base cells and {splits} "
            f"splits into {children}, which make {expected} nodes; found {len(flags)}"
        )
    counts = {"leaves": (len(flags) - splits, sizes[1]), "nodes": (len(flags), sizes[2])}
    for what, (count, promised) in counts.items():
        if count > promised:
            raise FileFormatError(f"the octree has {count} {what}, but {promised} are promised")
    return flags


def write_grid(grid: GridFile, out: TextOut) -> None:
    """Write a grid file."""
    out.format(1)
    layered, tree = grid.layers is not None, grid.flags is not None
    out.integers(LAYERS if layered else OCTREE if tree else REGULAR)
    out.integers(grid.coordinates)
    out.integers(0)
    out.integers(*map(int, grid.active))
    out.integers(*grid.shape)
    if grid.flags is not None:
        out.integers(grid.levels, grid.cells, len(grid.flags))
    if grid.layers is not None:
        out.integers(grid.levels, len(grid.layers))
    for walls in grid.walls:
        out.rows(walls)
    if grid.flags is not None:
        out.flags(grid.flags)
    for row in () if grid.layers is None else grid.layers.tolist():
        out.integers(*row)
