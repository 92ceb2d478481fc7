"""Phantom's dumps in HDF5, and copies of dumps with the same names."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FileFormatError
from ..hdf5 import data_set, data_sets, opened, read
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
        header = {name: np.ravel(value) for name, value in file["header"].attrs.items()}
        header |= {n: np.ravel(read(d)) for n, d in data_sets(path, file["header"])[0].items()}
        header = {n: v for n, v in header.items() if v.size and v.dtype.kind in "fiu"}
        mass = next((name for name in _MASS if name in header), None)
        if mass is None:
            raise FileFormatError("the header has no massoftype")
        header["massoftype"] = header[mass]
        particles, left_out = _properties(path, file["particles"], file["particles/h"].size)
        for tag in ("x", "y", "z", "h"):
            if tag not in particles:
                raise FileFormatError(f"particles have no {tag!r}; left out are {left_out}")
        sinks = _properties(path, file["sinks"])[0] if "sinks" in file else {}
    return Source(header, particles, sinks, f"header/{mass}", left_out)


def _properties(
    path: Path, group: Any, count: int | None = None
) -> tuple[dict[str, Property], dict[str, str]]:
    """Return one property for each column of the data sets, and why others are none."""
    found: dict[str, Property] = {}
    items, left_out = data_sets(path, group)
    for name, item in items.items():
        place, shape = item.name.strip("/"), item.shape
        if len(shape) not in (1, 2) or shape[0] != (count or shape[0]):
            left_out[name] = f"shape {shape}, expected a row of numbers for each particle"
        elif len(shape) == 1:
            load = functools.partial(_load, path, place)
            found[name] = Property(place, shape, item.dtype, load)
        else:
            endings = "xyz" if shape[1] == 3 else [f"{k}" for k in range(shape[1])]
            stem = _VECTORS.get(name, f"{name}_")
            for k, ending in enumerate(endings):
                load = functools.partial(_load, path, place, k)
                tag = stem + ending if shape[1] > 1 else name
                found[tag] = Property(f"{place}[{k}]", shape, item.dtype, load)
    return found, left_out


def _load(path: Path, place: str, column: int | None = None) -> np.ndarray:
    group, _, name = place.rpartition("/")
    with opened(path) as file:
        return read(data_set(path, file[group], name), column)
