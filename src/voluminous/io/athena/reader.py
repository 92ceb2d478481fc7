"""Reader for Athena++ HDF5 files: blocks of cells, each on the lattice of its level."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import FileFormatError
from ..contract import Contents, ContentsReader, StoredField, UnitLike
from ..hdf5 import data_set, holds, opened
from ..leaves import GRIDS, grid_of_blocks
from ..names import field_name
from ..payload import checked_shape
from ..units import OPTIONS, TIME, CodeUnits, Quantity

if TYPE_CHECKING:
    import h5py

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
_MARKS = ("RootGridSize", "MeshBlockSize", "VariableNames", "Coordinates")


class AthenaReader(ContentsReader):
    """Blocks of any level, Cartesian, spherical or cylindrical, without resampling."""

    name = "athena"
    description = "an Athena++ file (.athdf)"
    suffixes = (".athdf",)
    options = OPTIONS

    def matches(self, path: Path, head: bytes) -> bool:
        return holds(path, head, lambda file: all(mark in file.attrs for mark in _MARKS))

    def contents(self, path: Path, *, unit: UnitLike = None, **code_units: UnitLike) -> Contents:
        units = CodeUnits.given(**code_units)
        with opened(path) as file:
            kind = _text(file.attrs["Coordinates"])
            if kind not in _KINDS:
                raise FileFormatError(
                    f"Coordinates are {kind!r}, expected one of {', '.join(_KINDS)}"
                )
            kind = _KINDS[kind]
            block, counts = (
                np.array(checked_shape(file.attrs[name], name))
                for name in ("MeshBlockSize", "RootGridSize")
            )
            level, low = _blocks(file, block, counts)
            walls = [_edges(file, axis, int(n), level, low, block) for axis, n in enumerate(counts)]
            edges, length_unit = units.edges(_whole_circles(kind, walls), LENGTHS[kind], unit)
            shape, ratio = np.broadcast_to(block, low.shape), np.where(counts > 1, 2, 1)

            # Made when first needed: a description of the file needs no grid.
            @functools.cache
            def mesh() -> tuple[Any, Callable[..., Any]]:
                return grid_of_blocks(
                    GRIDS[kind], edges, level, low, shape, ratio, unit=length_unit
                )

            def load(dataset: str, row: int, factor: float) -> Any:
                with opened(path) as file:
                    values = _numbers(file, dataset)[row]
                values = values.astype(values.dtype.newbyteorder("="), copy=False)
                values = values if factor == 1 else values * factor
                return mesh()[1](values.transpose(0, 3, 2, 1))

            fields: list[StoredField] = []
            blocks = (len(level), *block[::-1].tolist())
            for place, dataset, row in _variables(file):
                item = _numbers(file, dataset)
                if item.shape[1:] != blocks or row >= item.shape[0]:
                    raise FileFormatError(
                        f"{dataset!r} has shape {item.shape}, expected the variables of blocks "
                        f"{blocks} (block, z, y, x)"
                    )
                name, quantity = described(place, kind)
                name = field_name(place) if name in {f.name for f in fields} else name
                factor, own_unit = units.of(quantity)
                read = functools.partial(load, dataset, row, factor)
                dtype = item.dtype.newbyteorder("=")
                fields.append(StoredField(name, place, blocks, dtype, own_unit, read))
            return Contents(fields, lambda chosen: mesh()[0], _meta(file, units))


def _numbers(file: h5py.File, name: str) -> h5py.Dataset:
    return data_set(Path(file.filename), file, name)


def _text(value: bytes | str) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


def _variables(file: h5py.File) -> list[tuple[str, str, int]]:
    names, datasets = (
        [_text(name) for name in np.ravel(file.attrs[key])]
        for key in ("VariableNames", "DatasetNames")
    )
    counts = [max(int(n), 0) for n in np.ravel(file.attrs["NumVariables"])]
    rows = [(d, k) for d, n in zip(datasets, counts, strict=True) for k in range(n)]
    return [(name, *row) for name, row in zip(names, rows, strict=True)]


def _blocks(
    file: h5py.File, block: np.ndarray, counts: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    level = _numbers(file, "Levels")[()].astype(np.int64)
    location = _numbers(file, "LogicalLocations")[()].astype(np.int64)
    count = int(file.attrs["NumMeshBlocks"])
    if level.shape != (count,) or location.shape != (count, 3) or count < 1:
        raise FileFormatError(
            f"NumMeshBlocks is {count}, but Levels has shape {level.shape} and LogicalLocations "
            f"{location.shape}"
        )
    if level.min() < 0 or level.max() > _DEEPEST or abs(location).max() >= 1 << 31:
        raise FileFormatError(
            f"Levels must be from 0 to {_DEEPEST}, LogicalLocations less than 2^31"
        )
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
    return level, low


def _edges(
    file: h5py.File, axis: int, count: int, level: np.ndarray, low: np.ndarray, block: np.ndarray
) -> np.ndarray:
    """Return the walls of the root grid along an axis; check that those of all cells agree."""
    name = f"x{axis + 1}f"
    first, last, ratio = (float(v) for v in file.attrs[f"RootGridX{axis + 1}"])
    faces = _numbers(file, name)[()].astype(np.float64)
    if faces.shape != (len(level), block[axis] + 1):
        raise FileFormatError(
            f"{name} has shape {faces.shape}, expected {(len(level), block[axis] + 1)}"
        )
    place = low[:, axis, None] + np.arange(block[axis] + 1)
    parts = np.where(count > 1, 1 << level, 1)[:, None]
    edges = np.linspace(first, last, count + 1)
    if ratio != 1:
        base = place % parts == 0
        edges[(place // parts)[base]] = faces[base]
    if not (np.isfinite(edges).all() and (np.diff(edges) > 0).all()):
        raise FileFormatError(f"walls of the root grid along x{axis + 1} must increase")
    expected = np.interp(place / parts, np.arange(count + 1), edges)
    width = np.diff(edges)[np.minimum(place // parts, count - 1)] / parts
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
    return edges


def _whole_circles(kind: str, edges: list[np.ndarray]) -> list[np.ndarray]:
    """Return the edges; a single cell in azimuth or from pole to pole gets the full exact range."""
    x1, x2, x3 = edges
    if kind == "spherical" and len(x3) == 2:
        x3 = np.array([0, 2 * np.pi])
        x2 = np.array([0, np.pi]) if len(x2) == 2 else x2
    if kind == "cylindrical" and len(x2) == 2:
        x2 = np.array([0, 2 * np.pi])
    return [x1, x2, x3]


def _meta(file: h5py.File, units: CodeUnits) -> dict[str, Any]:
    meta: dict[str, Any] = {}
    if "Time" in file.attrs:
        factor, unit = units.of(TIME)
        meta |= {"time": float(file.attrs["Time"]) * factor, "time_unit": unit}
    if "NumCycles" in file.attrs:
        meta["cycle"] = int(file.attrs["NumCycles"])
    return meta


COMPONENTS = {
    "cartesian": ("x", "y", "z"),
    "spherical": ("r", "theta", "phi"),
    "cylindrical": ("R", "phi", "z"),
}
# The axes of these grids that are lengths.
LENGTHS = {"cartesian": (0, 1, 2), "spherical": (0,), "cylindrical": (0, 2)}
_DENSITY = Quantity("density", (-3, 1, 0), "g / cm3")
_PRESSURE = Quantity("pressure", (-1, 1, -2), "erg / cm3")
_SCALARS = {
    "rho": _DENSITY,
    "dens": _DENSITY,
    "prs": _PRESSURE,
    "press": _PRESSURE,
    "Etot": Quantity("total_energy", (-1, 1, -2), "erg / cm3"),
    "phi": Quantity("potential", (2, 0, -2), "cm2 / s2"),
}
_VELOCITY = Quantity("velocity", (1, 0, -1), "cm / s")
_FIELD = Quantity("magnetic_field", (-1, 1, -2), "G")
_VECTORS = {
    "vel": _VELOCITY,
    "vx": _VELOCITY,
    "Bx": _FIELD,
    "Bcc": _FIELD,
    "mom": Quantity("momentum", (-2, 1, -1), "g / (cm2 s)"),
}


def described(place: str, kind: str) -> tuple[str, Quantity | None]:
    """Return the common name and the quantity of a variable on a kind of grid."""
    if place in _SCALARS:
        return _SCALARS[place].name, _SCALARS[place]
    stem, number = place[:-1], place[-1:]
    if stem in _VECTORS and number in "123":
        quantity = _VECTORS[stem]
        return f"{quantity.name}_{COMPONENTS[kind][int(number) - 1]}", quantity
    return field_name(place), None
