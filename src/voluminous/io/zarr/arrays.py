"""Zarr with names of dimensions, as xarray writes it."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import FileFormatError, unknown_name
from ...packages import require
from ..arrays.layout import Entry
from ..arrays.named_arrays import NamedArraysReader
from ..labelled.convert import LabelledReader
from ..names import field_name
from ..unit_texts import known_unit
from .store import Node, Store, arrays_in, holds_zarr, node_at, stored, zarr_array, zarr_store

if TYPE_CHECKING:
    import xarray


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


class LabelledZarrReader(LabelledReader):
    """Groups of Zarr arrays on named dimensions, by the CF conventions."""

    name = "zarr-xarray"
    description = "a Zarr store with named dimensions"
    suffixes = (".zarr",)
    packages = ("zarr", "xarray")

    def matches(self, path: Path, head: bytes) -> bool:
        if not holds_zarr(path, head):
            return False
        try:
            with stored(path) as store:
                node = node_at(store)
                nodes = [] if node is None or node.is_array else list(arrays_in(store))
        except (FileFormatError, OSError):
            return False  # the plain reader tells what is wrong
        return bool(nodes) and all(node.dims is not None for node in nodes)

    @contextmanager
    def dataset(self, path: Path, group: str | None) -> Iterator[xarray.Dataset]:
        xarray = require("xarray", self.extra, "reading Zarr with named dimensions")
        with stored(path) as store:
            place = _group(store, group)
            nodes = [node for node in arrays_in(store, place) if _parent(node) == place]
        with zarr_store(path) as opened:
            for node in nodes:
                zarr_array(opened, node.place)  # refuses what makes no sense
            with xarray.open_zarr(
                opened,
                group=place or None,
                chunks=None,
                consolidated=None if (path / ".zmetadata").is_file() else False,
                decode_timedelta=False,
            ) as data:
                yield data


def _parent(node: Node) -> str:
    return node.place.rpartition("/")[0]


def _group(store: Store, group: str | None) -> str:
    """Return the group to look into: that named, else the only one that has arrays."""
    groups = list(dict.fromkeys(_parent(node) for node in arrays_in(store)))
    if group is not None:
        if group.strip("/") not in groups:
            raise unknown_name("group", group, groups)
        return group.strip("/")
    if "" in groups or len(groups) == 1:
        return "" if "" in groups else groups[0]
    raise FileFormatError(f"there are several groups; choose one with group=…: {', '.join(groups)}")
