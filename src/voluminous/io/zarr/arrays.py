"""Zarr: plain arrays by their places, and arrays on named dimensions as xarray writes them."""

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
from .store import arrays_in, dimensions, holds_zarr, opened, root_fits

if TYPE_CHECKING:
    import xarray
    import zarr


class ZarrReader(NamedArraysReader):
    """Any Zarr store with arrays of three dimensions."""

    name = "zarr"
    description = "a Zarr store"
    suffixes = (".zarr",)
    packages = ("zarr",)
    extra = "arrays"
    remote = True

    def matches(self, path: Path, head: bytes) -> bool:
        return holds_zarr(path, head)

    @contextmanager
    def entries(
        self, path: Path, only: str | None = None, **options: Any
    ) -> Iterator[dict[str, Entry]]:
        stem = field_name(path.name.split(".")[0])
        with opened(path) as root:
            lone = not hasattr(root, "members")
            arrays = arrays_in(root, "" if lone or only is None else only)
            if not arrays:
                raise FileFormatError("there is no array in this Zarr store")
            result = {}
            for place, array in arrays.items():
                unit = known_unit(str(array.attrs.get("units", array.attrs.get("unit", ""))))
                shape = tuple(int(n) for n in array.shape)
                load, chunks = functools.partial(_values, array), tuple(array.chunks)
                dtype = np.dtype(array.dtype)
                result[place or stem] = Entry(shape, dtype, unit, load, chunks=chunks)
            yield result


def _values(array: zarr.Array[Any], index: Any = ...) -> np.ndarray:
    return np.asarray(array[index])


class LabelledZarrReader(LabelledReader):
    """Groups of Zarr arrays on named dimensions, by the CF conventions."""

    name = "zarr-xarray"
    description = "a Zarr store with named dimensions"
    suffixes = (".zarr",)
    packages = ("zarr", "xarray")
    remote = True

    def matches(self, path: Path, head: bytes) -> bool:
        def fits(root: Any) -> bool:
            arrays = arrays_in(root) if hasattr(root, "members") else {}
            named = (dimensions(array) is not None for array in arrays.values())
            return bool(arrays) and all(named)

        return bool(root_fits(path, head, fits))

    @contextmanager
    def dataset(self, path: Path, group: str | None) -> Iterator[xarray.Dataset]:
        xarray = require("xarray", self.extra, "reading Zarr with named dimensions")
        with opened(path) as root:
            place = _group(list(arrays_in(root)), group)
            consolidated = None if root.metadata.consolidated_metadata else False
            data = xarray.open_zarr(
                root.store,
                group=place or None,
                chunks=None,
                consolidated=consolidated,
                decode_timedelta=False,
            )
            with data:
                yield data


def _group(places: list[str], group: str | None) -> str:
    """Return the group that is named, else the outermost, or the only one that has arrays."""
    groups = list(dict.fromkeys(place.rpartition("/")[0] for place in places))
    if group is not None:
        if group.strip("/") not in groups:
            raise unknown_name("group", group, groups)
        return group.strip("/")
    if "" in groups or len(groups) == 1:
        return "" if "" in groups else groups[0]
    raise FileFormatError(f"there are several groups; choose one with group=…: {', '.join(groups)}")
