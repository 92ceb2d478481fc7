"""Plain Zarr: arrays by their places, as in HDF5."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FileFormatError
from ..arrays.entry import Entry
from ..arrays.named_arrays import NamedArraysReader
from ..names import field_name
from ..unit_texts import known_unit
from .opened import zarr_array, zarr_store
from .store import Node, arrays_in, holds_zarr, node_at, stored


class ZarrReader(NamedArraysReader):
    """Any Zarr store with arrays of three dimensions."""

    name = "zarr"
    description = "a Zarr store"
    suffixes = (".zarr",)
    packages = ("zarr",)
    extra = "arrays"

    def matches(self, path: Path, head: bytes) -> bool:
        return holds_zarr(path, head)

    @contextmanager
    def entries(
        self, path: Path, only: str | None = None, **options: Any
    ) -> Iterator[dict[str, Entry]]:
        stem = field_name(path.name.split(".")[0])
        with stored(path) as store:
            root = node_at(store)
            alone = only if root is not None and not root.is_array else None
            nodes = list(arrays_in(store, alone or ""))
        if not nodes:
            raise FileFormatError("there is no array in this Zarr store")
        with zarr_store(path) as opened:
            yield {node.place or stem: _entry(opened, node) for node in nodes}


def _entry(store: Any, node: Node) -> Entry:
    array = zarr_array(store, node.place)
    unit = known_unit(str(node.attributes.get("units", node.attributes.get("unit", ""))))
    load = functools.partial(_values, array)
    return Entry(tuple(int(n) for n in array.shape), np.dtype(array.dtype), unit, load)


def _values(array: Any, index: Any = ...) -> np.ndarray:
    return np.asarray(array[index])
