"""Arrays in a native file: nothing is read that is not there, or that lies elsewhere."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FileFormatError
from ...memory import check_memory
from ..hdf5 import opened
from ..payload import mapped

# What gzip can make of repeated bytes: more than that many times what is stored is no data.
_MOST_PACKED = 1100
# Fields start at multiples of this: mapped numbers are aligned.
ALIGNMENT = 64
_ADVICE = "read fewer fields, or use a machine with more memory"


def sound_array(parent: Any, name: str) -> Any:
    """Return a data set of real numbers that is stored in this very file.

    Raises
    ------
    FileFormatError
        If there is none, it is of another kind, leads to another file, or is larger than what is
        stored can be.
    """
    import h5py

    link = parent.get(name, getlink=True)
    if not isinstance(link, h5py.HardLink):
        found = "nothing" if link is None else "a link that leads elsewhere"
        raise FileFormatError(f"expected an array {parent.name}/{name}, found {found}")
    item = parent[name]
    place = f"{parent.name}/{name}".replace("//", "/")
    if not isinstance(item, h5py.Dataset) or item.shape is None or item.dtype.kind not in "fiub":
        raise FileFormatError(f"expected an array of real numbers at {place}")
    if item.is_virtual or item.external:
        raise FileFormatError(f"{place} takes its values from another file; expected them here")
    _check_size(item, place)
    return item


def _check_size(item: Any, place: str) -> None:
    size = math.prod(item.shape) * item.dtype.itemsize
    stored = item.id.get_storage_size()
    if size > stored * (_MOST_PACKED if item.chunks else 1):
        raise FileFormatError(
            f"{place} promises {size} bytes ({item.dtype} of shape {item.shape}), but {stored} are "
            "stored"
        )


def loaded(parent: Any, name: str) -> np.ndarray:
    """Return an array, in memory."""
    item = sound_array(parent, name)
    check_memory(math.prod(item.shape) * item.dtype.itemsize, f"reading {item.name}", _ADVICE)
    array: np.ndarray = item[()]
    return array


def is_plain(item: Any) -> bool:
    """Return True for an array that lies in the file as it does in memory."""
    # HDF5 keeps booleans as an enumeration, which is for HDF5 to check.
    plain = item.dtype.kind != "b" and item.dtype.isnative and item.chunks is None
    return bool(plain and item.id.get_offset() is not None)


def field_values(path: Path, group: str, name: str) -> np.ndarray:
    """Return a field: mapped where it lies as it is in memory, else read."""
    with opened(path) as file:
        item = sound_array(file[group], name)
        if not is_plain(item):
            return loaded(file[group], name)
        offset, shape, dtype = item.id.get_offset(), item.shape, item.dtype
    return mapped(path, offset, shape, dtype)
