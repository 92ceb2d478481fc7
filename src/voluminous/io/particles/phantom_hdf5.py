"""Phantom's dumps in HDF5, and copies of dumps with the same names."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FileFormatError
from ..hdf5 import data_set, opened, read
from .phantom_source import Property, Source

_VECTORS = {"xyz": "", "vxyz": "v", "Bxyz": "B"}
# What copies call what Phantom has for each type.
_MASS = ("massoftype", "mass")


def is_dump(file: Any) -> bool:
    """Return True for an open file with a header and particles as Phantom names them."""
    if "header" not in file or "particles" not in file:
        return False
    told = {*file["header"], *file["header"].attrs}
    return {"xyz", "h"} <= set(file["particles"]) and {"hfact", "udist"} <= told


def source_in(path: Path) -> Source:
    """Return what is in a dump in HDF5; no values of particles are read."""
    with opened(path) as file:
        if not is_dump(file):
            raise FileFormatError("expected groups 'header' and 'particles' as Phantom writes them")
        header = _numbers(path, file["header"])
        mass = next((name for name in _MASS if name in header), None)
        if mass is None:
            raise FileFormatError("the header has no massoftype")
        header["massoftype"] = header[mass]
        particles = _properties(path, file["particles"])
        count = particles["h"].shape[0]
        for item in particles.values():
            if item.shape[0] != count:
                raise FileFormatError(f"{item.place} has {item.shape[0]} rows, expected {count}")
        sinks = _properties(path, file["sinks"]) if "sinks" in file else {}
    return Source(header, particles, sinks, f"header/{mass}")


def _numbers(path: Path, group: Any) -> dict[str, np.ndarray]:
    """Return the numbers of a header, be they attributes or data sets."""
    found = {name: np.ravel(value) for name, value in group.attrs.items()}
    for name in group:
        found[name] = np.ravel(read(data_set(path, group, name)))
    return {name: v for name, v in found.items() if v.size and v.dtype.kind in "fiu"}


def _properties(path: Path, group: Any) -> dict[str, Property]:
    found: dict[str, Property] = {}
    for name in group:
        item = data_set(path, group, name)
        place = item.name.strip("/")
        if len(item.shape) == 1:
            load = functools.partial(_load, path, place)
            found[name] = Property(place, item.shape, item.dtype, load)
        elif item.shape[1:] == (3,):
            for k, axis in enumerate("xyz"):
                load = functools.partial(_load, path, place, k)
                tag = f"{_VECTORS.get(name, name + '_')}{axis}"
                found[tag] = Property(f"{place}[{k}]", item.shape, item.dtype, load)
    return found


def _load(path: Path, place: str, column: int | None = None) -> np.ndarray:

    group, _, name = place.rpartition("/")
    with opened(path) as file:
        return read(data_set(path, file[group], name), column)
