"""The mesh in an Athena++ file: blocks of cells, each on the lattice of its level."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...errors import FileFormatError
from ..payload import checked_shape

# gzip packs a thousand to one at best: a file that promises more is no data.
_MOST_PACKED = 1100
# How far a wall may be off its place, in cells: single precision, and uneven cells that are halved.
_ROUNDING, _UNEVEN = 1e-3, 0.3
_DEEPEST = 30
_KINDS = {
    "cartesian": "cartesian",
    "minkowski": "cartesian",
    "spherical_polar": "spherical",
    "schwarzschild": "spherical",
    "kerr-schild": "spherical",
    "cylindrical": "cylindrical",
}


@dataclass(frozen=True)
class Mesh:
    """Blocks of cells.

    Attributes
    ----------
    kind : {"cartesian", "spherical", "cylindrical"}
    block : array of int64, shape (3,)
        Cells of a block along each axis.
    level : array of int64, shape (n,)
    low : array of int64, shape (n, 3)
        First cell of each block, counted in cells of its level across the domain.
    edges : tuple of three float64 arrays
        Walls of the cells of level 0.
    """

    kind: str
    block: np.ndarray
    level: np.ndarray
    low: np.ndarray
    edges: tuple[np.ndarray, ...]

    @property
    def counts(self) -> np.ndarray:
        """Cells of level 0 along each axis."""
        return np.array([len(e) - 1 for e in self.edges])

    @property
    def axes(self) -> tuple[int, ...]:
        """The axes that refinement halves: those with more than one cell."""
        return tuple(int(axis) for axis in np.flatnonzero(self.counts > 1))


def read_mesh(file: Any) -> Mesh:
    """Return the mesh of an open file.

    Raises
    ------
    FileFormatError
        If it is of a kind that is not known, or what tells of it is at odds.
    """
    kind = _kind(file)
    block = np.array(checked_shape(file.attrs["MeshBlockSize"], "MeshBlockSize"))
    counts = np.array(checked_shape(file.attrs["RootGridSize"], "RootGridSize"))
    level, location = _blocks(file)
    low = location * block
    end = np.where(counts > 1, counts << level[:, None], counts)
    outside = ((location < 0) | (low + block > end)).any(axis=1)
    if outside.any():
        bad = int(np.argmax(outside))
        raise FileFormatError(
            f"block {bad} of {block.tolist()} cells at LogicalLocations "
            f"{location[bad].tolist()}, level {level[bad]}, is outside of the mesh of "
            f"{counts.tolist()} root cells. Slices, sums and ghost zones cannot be read"
        )
    edges = tuple(_edges(file, axis, int(n), level, low, block) for axis, n in enumerate(counts))
    return Mesh(kind, block, level, low, _whole_circles(kind, edges))


def checked(dataset: Any) -> Any:
    """Return a data set that can hold what it promises.

    Raises
    ------
    FileFormatError
        If that is more than the bytes it has in the file can be unpacked to.
    """
    stored = dataset.id.get_storage_size()
    if dataset.size * dataset.dtype.itemsize > _MOST_PACKED * stored:
        raise FileFormatError(
            f"{dataset.name} promises {dataset.shape} values, but has {stored} bytes in the file"
        )
    return dataset


def _kind(file: Any) -> str:
    told = file.attrs["Coordinates"]
    name = told.decode("utf-8", "replace") if isinstance(told, bytes) else str(told)
    if name not in _KINDS:
        raise FileFormatError(f"Coordinates are {name!r}, expected one of {', '.join(_KINDS)}")
    return _KINDS[name]


def _blocks(file: Any) -> tuple[np.ndarray, np.ndarray]:
    level = checked(file["Levels"])[()].astype(np.int64)
    location = checked(file["LogicalLocations"])[()].astype(np.int64)
    count = int(file.attrs["NumMeshBlocks"])
    if level.shape != (count,) or location.shape != (count, 3) or count < 1:
        raise FileFormatError(
            f"NumMeshBlocks is {count}, but Levels has shape {level.shape} and LogicalLocations "
            f"{location.shape}"
        )
    if level.min() < 0 or level.max() > _DEEPEST:
        raise FileFormatError(f"Levels must be from 0 to {_DEEPEST}, got {level.max()}")
    if abs(location).max() >= 1 << 31:
        raise FileFormatError("LogicalLocations must be less than 2^31")
    return level, location


def _edges(
    file: Any, axis: int, count: int, level: np.ndarray, low: np.ndarray, block: np.ndarray
) -> np.ndarray:
    first, last, ratio = (float(v) for v in file.attrs[f"RootGridX{axis + 1}"])
    faces = checked(file[f"x{axis + 1}f"])[()].astype(np.float64)
    if faces.shape != (len(level), block[axis] + 1):
        raise FileFormatError(
            f"x{axis + 1}f has shape {faces.shape}, expected {(len(level), block[axis] + 1)}"
        )
    place = low[:, axis, None] + np.arange(block[axis] + 1)
    parts = np.where(count > 1, 1 << level, 1)[:, None]
    edges = np.linspace(first, last, count + 1)
    if ratio != 1:
        base = place % parts == 0
        edges[(place // parts)[base]] = faces[base]
    if not (np.isfinite(edges).all() and (np.diff(edges) > 0).all()):
        raise FileFormatError(f"walls of the root grid along x{axis + 1} must increase")
    _check_faces(f"x{axis + 1}f", faces, edges, place / parts, parts)
    return edges


def _check_faces(
    name: str, faces: np.ndarray, edges: np.ndarray, place: np.ndarray, parts: np.ndarray
) -> None:
    """Compare the walls of all cells with those that the root grid's make when they are halved."""
    expected = np.interp(place, np.arange(len(edges)), edges)
    width = np.diff(edges)[np.minimum(place.astype(np.int64), len(edges) - 2)] / parts
    rounding = 4 * np.finfo(np.float32).eps * np.abs(edges).max()
    off = (np.abs(faces - expected) - rounding) / width
    if not off.max() < _UNEVEN:  # NaN too
        bad = int(np.argmax(~(off < _UNEVEN).all(axis=1)))
        raise FileFormatError(
            f"the walls {name} of block {bad} are not where its level and location put them. "
            "Ghost zones cannot be read"
        )
    if off.max() > _ROUNDING:
        warnings.warn(
            f"{name}: cells are of uneven widths and refined; the grid halves them evenly, so that "
            f"walls are up to {off.max():.2g} cells off",
            stacklevel=2,
        )


def _whole_circles(kind: str, edges: tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
    """Return the edges; those of a single cell around an axis, or from pole to pole, go around."""
    x1, x2, x3 = edges
    if kind == "spherical" and len(x3) == 2:
        x3 = np.array([0, 2 * np.pi])
        x2 = np.array([0, np.pi]) if len(x2) == 2 else x2
    if kind == "cylindrical" and len(x2) == 2:
        x2 = np.array([0, 2 * np.pi])
    return x1, x2, x3
