"""Zarr with names of dimensions, as xarray writes it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from ...errors import FileFormatError, unknown_name
from ...packages import require
from ..labelled.reader import LabelledReader
from .opened import zarr_array, zarr_store
from .store import Node, Store, arrays_in, holds_zarr, node_at, stored

if TYPE_CHECKING:
    import xarray


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
    """Return the group to look into: that named, else the only one that has arrays.

    Raises
    ------
    UnknownNameError
        If there is no such group.
    FileFormatError
        If there are several, and none is named.
    """
    groups = list(dict.fromkeys(_parent(node) for node in arrays_in(store)))
    if group is not None:
        if group.strip("/") not in groups:
            raise unknown_name("group", group, groups)
        return group.strip("/")
    if "" in groups or len(groups) == 1:
        return "" if "" in groups else groups[0]
    raise FileFormatError(f"there are several groups; choose one with group=…: {', '.join(groups)}")
