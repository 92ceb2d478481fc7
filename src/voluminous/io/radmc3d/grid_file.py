"""Parser for ``amr_grid``: a regular grid, an octree, or layers of finer cells over a base grid."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...errors import FileFormatError
from .encodings import EncodedFile

REGULAR, OCTREE, LAYERS = 0, 1, 10
SPHERICAL, BEYOND = 100, 200
# RADMC-3D refuses deeper trees.
DEEPEST = 20
_AXES = "xyz"
Ints = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class GridFile:
    """The contents of a grid file."""

    style: int  # REGULAR, OCTREE or LAYERS
    coordinates: int  # below 100 Cartesian, below 200 spherical
    active: tuple[bool, ...]  # along other dimensions there is one cell, which is never refined
    walls: tuple[NDArray[np.float64], ...]  # of the base grid: cm; or r in cm, angles in radian
    flags: NDArray[np.uint8] | None = None  # of octrees: 1 for each split node, depth first
    layers: Ints | None = None  # (n, 7): parent; first cell from 1, number, in cells of the parent

    def __eq__(self, other: object) -> bool:
        """Return True if both describe the same cells."""
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
        cells = math.prod(self.shape)
        if self.layers is None:
            return cells
        finer = math.prod(self.factors.tolist())
        return cells + sum(finer * math.prod(row[4:]) for row in self.layers.tolist())


def _bytes(array: np.ndarray | None) -> bytes:
    return b"" if array is None else array.tobytes()


def read_grid(source: EncodedFile) -> GridFile:
    """Return the contents of a grid file; raise FileFormatError if RADMC-3D would reject it."""
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
    if LAYERS > style >= OCTREE:
        flags = _read_flags(source, sizes, math.prod(shape), 1 << sum(active))
        return GridFile(OCTREE, coordinates, active, walls, flags)
    layers = _read_layers(source, sizes[1], active) if style >= LAYERS else None
    source.end()
    style = REGULAR if layers is None else LAYERS
    return GridFile(style, coordinates, active, walls, layers=layers)


def _expect(what: str, number: int, least: int, beyond: int) -> None:
    if not least <= number < beyond:
        expected = str(least) if beyond == least + 1 else f"{least} to {beyond - 1}"
        raise FileFormatError(f"{what} must be {expected}, got {number}")


def _check_shape(shape: list[int], active: tuple[bool, ...]) -> None:
    for n, used, axis in zip(shape, active, _AXES, strict=True):
        if n < 1 or (n > 1 and not used):
            allowed = "at least 1" if used else "1, for the dimension is inactive"
            raise FileFormatError(f"the number of cells along {axis} must be {allowed}, got {n}")


def _sizes(source: EncodedFile, style: int) -> list[int]:
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


def _walls(source: EncodedFile, cells: int, axis: str) -> NDArray[np.float64]:
    walls = source.reals(cells + 1, f"{axis} walls")
    rising = np.isfinite(walls) & (np.diff(walls, prepend=-np.inf) > 0)
    if not rising.all():
        k = int(np.argmin(rising))
        raise FileFormatError(
            f"{axis} walls must be finite and increase; the one of number {k + 1} is {walls[k]:g}"
        )
    return walls


def _read_flags(
    source: EncodedFile, sizes: list[int], base: int, children: int
) -> NDArray[np.uint8]:
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


def _read_layers(source: EncodedFile, count: int, active: tuple[bool, ...]) -> Ints:
    rows = []
    for k in range(count):  # stops at the end of the file
        rows.append(source.integers(7, f"layer {k + 1}"))
    layers = np.array(rows, np.int64).reshape(-1, 7)
    layers[:, 4:][:, ~np.array(active)] = 1  # ignore the entries of inactive dimensions
    return layers


@dataclass(frozen=True)
class LayerBoxes:
    """The base grid and its layers, in units of cells of their levels."""

    level: Ints  # (n + 1,)
    low: Ints  # (n + 1, 3): first cell, index in the whole domain
    shape: Ints  # (n + 1, 3): number of cells


def boxes(grid: GridFile) -> LayerBoxes:
    """Return the positions of the layers of a grid."""
    layers = np.zeros((0, 7), np.int64) if grid.layers is None else grid.layers
    count = len(layers) + 1
    level = np.zeros(count, np.int64)
    low, shape = np.zeros((count, 3), np.int64), np.zeros((count, 3), np.int64)
    shape[0] = grid.shape
    for k, (parent, *numbers) in enumerate(layers.tolist(), start=1):
        if not 0 <= parent < k:
            raise FileFormatError(
                f"the parent of layer {k} must be from 0 to {k - 1}, got {parent}: a layer comes "
                "after its parent"
            )
        first, cells = [n - 1 for n in numbers[:3]], numbers[3:]
        whole = shape[parent].tolist()
        if any(f < 0 or n < 1 or f + n > m for f, n, m in zip(first, cells, whole, strict=True)):
            raise FileFormatError(
                f"layer {k} begins at cell {numbers[:3]} and covers {cells} of its parent "
                f"{parent}, which has {whole}"
            )
        level[k] = level[parent] + 1
        low[k] = grid.factors * (low[parent] + first)
        shape[k] = grid.factors * cells
    if level.max() > DEEPEST:
        raise FileFormatError(f"layers are {level.max()} levels deep; {DEEPEST} are the most")
    return LayerBoxes(level, low, shape)


def uncovered(grid: GridFile) -> list[NDArray[np.bool_]]:
    """Return masks of the cells not covered by a finer layer, for the base grid and each layer."""
    found = boxes(grid)
    seen = [np.ones(shape, bool) for shape in found.shape.tolist()]
    layers = () if grid.layers is None else grid.layers.tolist()
    for k, (parent, *numbers) in enumerate(layers, start=1):
        ranges = zip(numbers[:3], numbers[3:], strict=True)
        part = tuple(slice(first - 1, first - 1 + count) for first, count in ranges)
        if not seen[parent][part].all():
            raise FileFormatError(f"layer {k} overlaps another one on its parent {parent}")
        seen[parent][part] = False
    return seen


def leaves(grid: GridFile) -> tuple[Ints, Ints, Ints]:
    """Return level, index within the level, and position in the file of each leaf cell."""
    found, seen = boxes(grid), uncovered(grid)
    index, value, first = [], [], 0
    for low, mask in zip(found.low, seen, strict=True):
        flat = np.flatnonzero(mask.ravel(order="F"))
        index.append(np.stack(np.unravel_index(flat, mask.shape, order="F"), axis=1) + low)
        value.append(first + flat)
        first += mask.size
    level = np.repeat(found.level, [len(part) for part in value])
    return level, np.concatenate(index), np.concatenate(value)
