"""Zarr stores of versions 2 and 3, opened by the library: directories, ZIP files and URLs."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...errors import FileFormatError, VoluminousError
from ...files import url_of
from ...memory import check_memory
from ...packages import require
from ..guard import by_library
from ..payload import ZIP, zip_names

if TYPE_CHECKING:
    import zarr

_NODES = ("zarr.json", ".zarray", ".zgroup")
_DEEPEST = 16


def holds_zarr(path: Path, head: bytes) -> bool:
    """Return True for a directory or a ZIP file that is a Zarr store, and for any URL."""
    if url_of(path):
        return True
    if path.is_dir():
        return any((path / name).is_file() for name in _NODES)
    if not head.startswith(ZIP):
        return False
    names = zip_names(path)
    return not names.isdisjoint(_NODES) or (not names and path.name.lower().endswith(".zarr.zip"))


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """Yield the root node of a store; errors of the library become a `FileFormatError`."""
    library = require("zarr", "arrays", "reading Zarr")
    url = url_of(path)
    if url:
        require("fsspec", "remote", f"opening {url}")
    with by_library("zarr"), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of files that are no part of the hierarchy
        archive = library.storage.ZipStore(path, mode="r") if path.is_file() else None
        try:
            yield library.open(archive or url or path, mode="r")
        finally:
            if archive is not None:
                archive.close()


def root_fits(path: Path, head: bytes, fits: Callable[[Any], bool]) -> bool | None:
    """Return whether a file is a Zarr store whose root fits; None if that cannot be opened.

    The reader of plain arrays then says what is wrong.
    """
    if not holds_zarr(path, head):
        return False
    try:
        with opened(path) as root:
            return fits(root)
    except VoluminousError:
        return None


def arrays_in(node: Any, place: str = "") -> dict[str, zarr.Array[Any]]:
    """Return the arrays at a place and below it; that of a lone array is the empty string."""
    node = node[place] if place else node
    if not hasattr(node, "members"):
        return {place: checked(node)}
    found = dict(node.members(max_depth=_DEEPEST))
    ordered = sorted(found, key=lambda name: name.split("/"))
    start = f"{place}/" if place else ""
    return {start + name: checked(found[name]) for name in ordered if hasattr(found[name], "shape")}


def checked(array: Any) -> zarr.Array[Any]:
    """Return the array, after checking that its chunks fit into memory."""
    chunks = tuple(int(n) for n in array.chunks)
    if any(n < 1 for n in chunks) or any(int(n) < 0 for n in array.shape):
        raise FileFormatError(f"{array.path!r} has shape {array.shape} in pieces of {chunks}")
    size = math.prod(chunks) * array.dtype.itemsize
    check_memory(size, f"one piece {chunks} of {array.path!r}", "store it in smaller chunks")
    found: zarr.Array[Any] = array
    return found


def dimensions(array: zarr.Array[Any]) -> tuple[str, ...] | None:
    """Return the names of an array's dimensions, or None; a single number has none of them."""
    names: Any = array.attrs.get("_ARRAY_DIMENSIONS")
    if array.metadata.zarr_format == 3:
        names = array.metadata.dimension_names
    names = () if not array.shape else names
    named = isinstance(names, (list, tuple)) and all(isinstance(name, str) for name in names)
    return tuple(names) if named else None
