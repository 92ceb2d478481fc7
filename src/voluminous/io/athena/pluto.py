"""Reader for PLUTO's HDF5 files of static grids (.dbl.h5, .flt.h5): http://plutocode.ph.unito.it."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...errors import FileFormatError, InputError
from ..axes import is_even
from ..contract import Contents, ContentsReader, StoredField, UnitLike
from ..hdf5 import data_sets, holds, opened, read
from ..leaves import GRIDS
from ..units import OPTIONS, TIME, CodeUnits
from .reader import LENGTHS, described

if TYPE_CHECKING:
    import h5py

_NODES, _STEP = "node_coords", "Timestep_"
# Tolerance for nodes, relative to the largest coordinate: they are single precision.
_ROUNDING = 1e-5


class PlutoReader(ContentsReader):
    """Cartesian, polar and spherical grids of three dimensions, without resampling."""

    name = "pluto"
    description = "a PLUTO file of a static grid (.dbl.h5, .flt.h5)"
    options = OPTIONS

    def matches(self, path: Path, head: bytes) -> bool:
        return holds(path, head, lambda f: _NODES in f and any(n.startswith(_STEP) for n in f))

    def contents(self, path: Path, *, unit: UnitLike = None, **code_units: UnitLike) -> Contents:
        units = CodeUnits.given(**code_units)
        fields = []
        with opened(path) as file:
            kind, walls = _grid(file)
            step = file[next(name for name in file if name.startswith(_STEP))]
            shape = tuple(len(w) - 1 for w in walls[::-1])
            for name, item in data_sets(path, step["vars"])[0].items():
                if item.shape != shape:
                    raise FileFormatError(
                        f"{item.name} has shape {item.shape}, expected {shape} (z, y, x)"
                    )
                common, quantity = described(name, kind)
                factor, stored_unit = units.of(quantity)
                place, dtype = item.name.strip("/"), item.dtype.newbyteorder("=")
                load = functools.partial(_load, path, place, factor)
                fields.append(StoredField(common, place, shape, dtype, stored_unit, load))
            time = float(np.ravel(step.attrs.get("Time", 0.0))[0])
        edges, grid_unit = units.edges(walls, LENGTHS[kind], unit)
        factor, time_unit = units.of(TIME)
        meta = {"code": "PLUTO", "time": time * factor}
        meta |= {"time_unit": time_unit} if time_unit else {}
        return Contents(fields, lambda chosen: GRIDS[kind](*edges, unit=grid_unit), meta)


def _load(path: Path, place: str, factor: float) -> np.ndarray:
    with opened(path) as file:
        values: np.ndarray = read(file[place]).T
    return values if factor == 1 else values * factor


def _grid(file: h5py.File) -> tuple[str, list[np.ndarray]]:
    nodes = [file[_NODES][axis] for axis in "XYZ"]
    if any(item.shape != nodes[0].shape or item.ndim != 3 for item in nodes):
        raise InputError(f"its grid has {nodes[0].ndim} dimensions, expected 3")
    # Lines along x1, x2 and x3 with well-determined angles: off the centre and the poles.
    z, y, x = (n // 2 for n in nodes[0].shape)
    x, every = nodes[0].shape[2] - 1, slice(None)
    lines = ((z, y, every), (z, every, x), (every, y, x))
    along = [[np.asarray(item[line], np.float64) for item in nodes] for line in lines]
    few = tuple(slice(None, None, max(n // 8, 1)) for n in nodes[0].shape)
    points = np.array([np.asarray(item[few], np.float64).T for item in nodes])
    for kind, (coordinates, position) in _COORDINATES.items():
        walls = [_tidy(coordinates(*line)[axis]) for axis, line in enumerate(along)]
        sparse = [w[step] for w, step in zip(walls, few[::-1], strict=True)]
        rebuilt = np.array(position(*np.meshgrid(*sparse, indexing="ij")))
        if np.abs(rebuilt - points).max() <= _ROUNDING * np.abs(points).max():
            return kind, walls
    raise InputError("its nodes make no Cartesian, polar or spherical grid")


def _tidy(walls: np.ndarray) -> np.ndarray:
    """Return walls without single-precision rounding: equally spaced walls become exactly so."""
    walls = np.where(np.abs(walls) < _ROUNDING * np.abs(walls).max(), 0.0, walls)
    return np.linspace(walls[0], walls[-1], len(walls)) if is_even(walls) else walls


def _azimuth(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    phi = np.unwrap(np.arctan2(y, x))
    full = abs(np.ptp(phi) - 2 * np.pi) < _ROUNDING
    return np.append(phi[:-1], phi[0] + 2 * np.pi) if full else phi


def _polar_angle(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    theta = np.arctan2(np.hypot(x, y), z)
    return np.where(np.abs(theta - np.pi) < _ROUNDING, np.pi, theta)


# The grid's coordinates of x, y and z, and the inverse.
_COORDINATES: dict[str, tuple[Callable[..., tuple[np.ndarray, ...]], ...]] = {
    "cartesian": (lambda x, y, z: (x, y, z), lambda x, y, z: (x, y, z)),
    "cylindrical": (
        lambda x, y, z: (np.hypot(x, y), _azimuth(x, y), z),
        lambda r, phi, z: (r * np.cos(phi), r * np.sin(phi), z),
    ),
    "spherical": (
        lambda x, y, z: (np.hypot(np.hypot(x, y), z), _polar_angle(x, y, z), _azimuth(x, y)),
        lambda r, t, p: (r * np.sin(t) * np.cos(p), r * np.sin(t) * np.sin(p), r * np.cos(t)),
    ),
}
