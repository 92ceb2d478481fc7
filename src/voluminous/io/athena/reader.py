"""Reader for Athena++ HDF5 files: blocks of cells, each on the lattice of its level."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...deferred import Deferred
from ...errors import FileFormatError
from ...grids import CartesianGrid, CylindricalGrid, PatchGrid, SphericalGrid
from ...units import unit_name
from ..axes import round_unit
from ..contract import FieldChoice, FieldInfo, Reader, UnitLike
from ..hdf5 import data_set, holds, opened
from ..leaves import placed_values, tree_of_leaves
from ..names import chosen_fields
from ..payload import checked_shape
from .variables import CodeUnits, Variable, variables

if TYPE_CHECKING:
    import h5py

    from ...volume import Volume


# Tolerance for wall positions, in cells: single precision, and the halving of uneven cells.
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
class AthenaMesh:
    """The blocks of a mesh."""

    kind: str
    block: np.ndarray  # cells of a block along each axis
    level: np.ndarray
    low: np.ndarray  # first cell of each block, as an index on its level in the whole domain
    edges: tuple[np.ndarray, ...]  # walls of the cells of level 0

    @property
    def counts(self) -> np.ndarray:
        """Number of level-0 cells along each axis."""
        return np.array([len(e) - 1 for e in self.edges])

    @property
    def axes(self) -> tuple[int, ...]:
        """The refined axes: those with more than one cell."""
        return tuple(int(axis) for axis in np.flatnonzero(self.counts > 1))


def read_mesh(file: h5py.File) -> AthenaMesh:
    """Return the mesh of an open file."""
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
    return AthenaMesh(kind, block, level, low, _whole_circles(kind, edges))


def _numbers(file: h5py.File, name: str) -> Any:
    return data_set(Path(file.filename), file, name)


def _kind(file: h5py.File) -> str:
    told = file.attrs["Coordinates"]
    name = told.decode("utf-8", "replace") if isinstance(told, bytes) else str(told)
    if name not in _KINDS:
        raise FileFormatError(f"Coordinates are {name!r}, expected one of {', '.join(_KINDS)}")
    return _KINDS[name]


def _blocks(file: h5py.File) -> tuple[np.ndarray, np.ndarray]:
    level = _numbers(file, "Levels")[()].astype(np.int64)
    location = _numbers(file, "LogicalLocations")[()].astype(np.int64)
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
    file: h5py.File, axis: int, count: int, level: np.ndarray, low: np.ndarray, block: np.ndarray
) -> np.ndarray:
    first, last, ratio = (float(v) for v in file.attrs[f"RootGridX{axis + 1}"])
    faces = _numbers(file, f"x{axis + 1}f")[()].astype(np.float64)
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
    """Compare all cell walls with those that follow from halving the root grid."""
    expected = np.interp(place, np.arange(len(edges)), edges)
    width = np.diff(edges)[np.minimum(place.astype(np.int64), len(edges) - 2)] / parts
    rounding = 4 * np.finfo(np.float32).eps * np.abs(edges).max()
    off = (np.abs(faces - expected) - rounding) / width
    if not off.max() < _UNEVEN:  # also true for NaN
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
    """Return the edges; a single cell in azimuth or from pole to pole gets the full exact range."""
    x1, x2, x3 = edges
    if kind == "spherical" and len(x3) == 2:
        x3 = np.array([0, 2 * np.pi])
        x2 = np.array([0, np.pi]) if len(x2) == 2 else x2
    if kind == "cylindrical" and len(x2) == 2:
        x2 = np.array([0, 2 * np.pi])
    return x1, x2, x3


Arrange = Callable[[np.ndarray], Any]
REGULAR: dict[str, Any] = {
    "cartesian": CartesianGrid,
    "spherical": SphericalGrid,
    "cylindrical": CylindricalGrid,
}


def grid_of_mesh(
    mesh: AthenaMesh, edges: Sequence[np.ndarray], unit: UnitLike
) -> tuple[Any, Arrange]:
    """Return the grid of a mesh, and a function that makes fields of values [block, ix, iy, iz].

    Blocks of one level that fill the domain make a regular grid; other blocks make patches, or a
    tree in curvilinear coordinates.
    """
    if not mesh.level.any() and len(mesh.level) * mesh.block.prod() == mesh.counts.prod():
        return REGULAR[mesh.kind](*edges, unit=unit), _Joined(mesh)
    if mesh.kind == "cartesian":
        shape = np.broadcast_to(mesh.block, mesh.low.shape)
        ratio = np.where(mesh.counts > 1, 2, 1)
        ratios = np.broadcast_to(ratio, (int(mesh.level.max()), 3))
        x, y, z = edges
        grid = PatchGrid.from_boxes(x, y, z, mesh.level, mesh.low, shape, ratios, unit=unit)
        return grid, lambda values: values
    tree, source = _tree(mesh, edges, unit)
    return tree, lambda values: placed_values(values.reshape(-1), source)


class _Joined:
    """Joins blocks of one level to one array."""

    def __init__(self, mesh: AthenaMesh) -> None:
        self.shape, self.block, self.low = tuple(mesh.counts), mesh.block, mesh.low

    def __call__(self, values: np.ndarray) -> np.ndarray:
        missing = np.nan if values.dtype.kind == "f" else 0
        whole = np.full(self.shape, missing, values.dtype)
        for part, low in zip(values, self.low, strict=True):
            x, y, z = (slice(a, a + n) for a, n in zip(low, self.block, strict=True))
            whole[x, y, z] = part
        return whole


def _tree(mesh: AthenaMesh, edges: Sequence[np.ndarray], unit: UnitLike) -> tuple[Any, np.ndarray]:
    local = np.moveaxis(np.indices(mesh.block.tolist()), 0, -1).reshape(-1, 3)
    index = (mesh.low[:, None] + local).reshape(-1, 3)
    level = np.repeat(mesh.level, len(local))
    return tree_of_leaves(REGULAR[mesh.kind], edges, level, index, mesh.axes, unit=unit)


_MARKS = ("RootGridSize", "MeshBlockSize", "VariableNames", "Coordinates")
_LENGTHS = {"cartesian": (0, 1, 2), "spherical": (0,), "cylindrical": (0, 2)}


class AthenaReader(Reader):
    """Blocks of any level, Cartesian, spherical or cylindrical, without resampling."""

    name = "athena"
    description = "an Athena++ file (.athdf)"
    suffixes = (".athdf",)
    options = {  # noqa: RUF012 - as in Reader
        "unit": "unit of length of the grid; without length_unit, what numbers in the file are in",
        "length_unit": "the code's unit of length, such as '1.5e16 cm'",
        "mass_unit": "the code's unit of mass",
        "time_unit": "the code's unit of time",
        "velocity_unit": "the code's unit of velocity, in place of time_unit",
        "density_unit": "the code's unit of density, in place of mass_unit",
    }

    def matches(self, path: Path, head: bytes) -> bool:
        return holds(path, head, lambda file: all(mark in file.attrs for mark in _MARKS))

    def read(
        self, path: Path, fields: FieldChoice = None, *, unit: UnitLike = None, **code_units: Any
    ) -> Volume:
        from ...volume import Volume

        units = CodeUnits(**code_units)
        with opened(path) as file:
            mesh = read_mesh(file)
            known = {v.place: v for v in variables(file.attrs, mesh.kind)}
            edges, own = in_unit(mesh.kind, mesh.edges, units, unit)
            grid, arrange = grid_of_mesh(mesh, edges, own)
            volume = Volume(grid)
            volume.meta.update(_meta(file, units))
            names = {place: v.name for place, v in known.items()}
            for name, place in chosen_fields(names, fields).items():
                variable = known[place]
                dataset = _dataset(file, variable, mesh)
                factor, field_unit = units.of(variable.kind)
                load = functools.partial(_load, path, variable, mesh, arrange, factor)
                volume[name] = Deferred(load, _native(dataset.dtype), field_unit)
        return volume

    def info(self, path: Path, **options: Any) -> tuple[FieldInfo, ...]:
        options.pop("unit", None)
        units = CodeUnits(**options)
        with opened(path) as file:
            mesh = read_mesh(file)
            return tuple(
                FieldInfo(
                    v.name,
                    v.place,
                    _dataset(file, v, mesh).shape[1:],
                    str(_native(file[v.dataset].dtype)),
                    unit_name(units.of(v.kind)[1]),
                )
                for v in variables(file.attrs, mesh.kind)
            )


def _dataset(file: h5py.File, variable: Variable, mesh: AthenaMesh) -> Any:
    dataset = _numbers(file, variable.dataset)
    blocks = (len(mesh.level), *mesh.block[::-1].tolist())
    if dataset.shape[1:] != blocks or variable.row >= dataset.shape[0]:
        raise FileFormatError(
            f"{variable.dataset!r} has shape {dataset.shape}, expected the variables of blocks "
            f"{blocks} (block, z, y, x)"
        )
    return dataset


def _load(path: Path, variable: Variable, mesh: AthenaMesh, arrange: Arrange, factor: float) -> Any:
    with opened(path) as file:
        values = _dataset(file, variable, mesh)[variable.row]
    values = values.astype(_native(values.dtype), copy=False)
    return arrange((values if factor == 1 else values * factor).transpose(0, 3, 2, 1))


def _native(dtype: Any) -> Any:
    return np.dtype(dtype).newbyteorder("=")


def in_unit(
    kind: str, edges: Sequence[np.ndarray], units: CodeUnits, unit: UnitLike
) -> tuple[Sequence[np.ndarray], Any]:
    """Return the edges of a grid in the unit of the volume, and this unit."""
    if units.length is None:
        return edges, unit
    lengths = _LENGTHS[kind]
    width = max(float(np.ptp(edges[axis])) for axis in lengths)
    own = round_unit(width * units.length) if unit is None else unit
    factor = units.length.to(own)
    return [e * factor if axis in lengths else e for axis, e in enumerate(edges)], own


def _meta(file: h5py.File, units: CodeUnits) -> dict[str, Any]:
    meta: dict[str, Any] = {}
    if "Time" in file.attrs:
        factor, unit = units.of(("time", (0, 0, 1), "s"))
        meta["time"] = float(file.attrs["Time"]) * factor
        meta["time_unit"] = unit_name(unit)
    if "NumCycles" in file.attrs:
        meta["cycle"] = int(file.attrs["NumCycles"])
    return meta
