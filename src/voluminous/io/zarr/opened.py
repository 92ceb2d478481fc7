"""Zarr arrays by the library, from a directory or a ZIP file."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

from ...errors import FileFormatError
from ...memory import check_memory
from ...packages import require


@contextmanager
def zarr_store(path: Path) -> Iterator[Any]:
    """Give what the library and xarray take for a store."""
    zarr = require("zarr", "arrays", "reading Zarr")
    if path.is_dir():
        yield str(path)
    else:
        with closing(zarr.storage.ZipStore(str(path), mode="r")) as store:
            yield store


def zarr_array(store: Any, place: str) -> Any:
    """Return an array; nothing of its values is read.

    Raises
    ------
    FileFormatError
        If its shape, or that of its pieces, makes no sense.
    MemoryNeededError
        If one piece does not fit into memory.
    """
    zarr = require("zarr", "arrays", "reading Zarr")
    array = zarr.open_array(store, mode="r", path=place or None)
    pieces = tuple(int(n) for n in array.chunks)
    if any(n < 1 for n in pieces) or any(int(n) < 0 for n in array.shape):
        raise FileFormatError(f"{place!r} has shape {array.shape} in pieces of {pieces}")
    size = math.prod(pieces) * array.dtype.itemsize
    check_memory(size, f"one piece {pieces} of {place!r}", "store it in smaller chunks")
    return array
