"""Data sets of HDF5 files that can hold what they promise, and are in the file itself."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FileFormatError
from ...memory import check_memory
from ..payload import inside

# What deflate can pack at most, and a little more: 1 to 1032.
_MOST_PACKED = 2000


def is_own(group: Any, name: str) -> bool:
    """Return whether something is in the group itself, and no link to another place or file."""
    import h5py

    return isinstance(group.get(name, getlink=True), h5py.HardLink)


def data_set(path: Path, group: Any, name: str) -> Any:
    """Return a data set of numbers.

    Raises
    ------
    FileFormatError
        If there is none of this name, it holds something else, its values are in another file
        outside of the directory, or it promises more than its bytes can be unpacked to.
    """
    import h5py

    item = group[name] if is_own(group, name) else None
    if not isinstance(item, h5py.Dataset):
        raise FileFormatError(f"expected a data set {group.name}/{name}")
    if item.dtype.kind not in "fiub" or item.shape is None:
        raise FileFormatError(f"{item.name} must be numbers, got {item.dtype}")
    check_place(path, item)
    size = item.size * item.dtype.itemsize
    if not item.is_virtual and size > _MOST_PACKED * item.id.get_storage_size():
        raise FileFormatError(
            f"{item.name} promises values of shape {item.shape}, but has "
            f"{item.id.get_storage_size()} bytes in the file"
        )
    return item


def check_place(path: Path, item: Any) -> None:
    """Refuse values that are elsewhere: a file must not make us read any other.

    Raises
    ------
    FileFormatError
        If they are in files of any kind, or in HDF5 files outside of the directory.
    """
    if item.external:
        raise FileFormatError(
            f"the values of {item.name} are in {item.external[0][0]!r}, not in the file itself; "
            "copy them into one file with h5repack"
        )
    if item.is_virtual:
        for source in item.virtual_sources():
            if source.file_name != ".":
                inside(path.parent, source.file_name)


def data_sets(path: Path, group: Any) -> tuple[dict[str, Any], dict[str, str]]:
    """Return the data sets of numbers in a group, and why each other thing in it is none."""
    import h5py

    found: dict[str, Any] = {}
    others: dict[str, str] = {}
    for name in group:
        item = group[name] if is_own(group, name) else None
        if not isinstance(item, h5py.Dataset):
            others[name] = "a link" if item is None else "a group"
        elif not item.size:
            others[name] = "no values"
        elif item.dtype.kind not in "fiub":
            others[name] = f"values of type {item.dtype}"
        else:
            found[name] = data_set(path, group, name)
    return found, others


def read(item: Any, column: int | None = None) -> np.ndarray:
    """Return the values of a data set, or one column of them, in native byte order.

    Raises
    ------
    MemoryNeededError
        If they do not fit into memory.
    """
    count = item.size if column is None else len(item)
    check_memory(count * item.dtype.itemsize, f"reading {item.name}", "read a part of the data")
    values = item[()] if column is None else item[:, column]
    return np.asarray(values, item.dtype.newbyteorder("="))


def text(attribute: Any) -> str:
    """Return an attribute that is one text, however it is kept; empty for any other."""
    values = np.ravel(attribute)
    first = values[0] if values.size == 1 else ""
    first = first.decode("utf-8", "replace") if isinstance(first, bytes) else first
    return first.strip() if isinstance(first, str) else ""
