"""Zarr: plain arrays by their places, and arrays on named dimensions as xarray writes them."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import FileFormatError, unknown_name
from ..arrays.layout import Entry
from ..arrays.named_arrays import NamedArraysReader
from ..labelled.convert import LabelledReader, decoded
from ..names import field_name
from ..units import known_unit
from .store import arrays_in, dimensions, holds_zarr, opened, part, root_fits, warn_of_missing

if TYPE_CHECKING:
    import xarray


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
            if only is None or not hasattr(root, "members"):
                arrays = arrays_in(root)
            else:
                with opened(path, only) as array:
                    arrays = {only: array}
            if not arrays:
                raise FileFormatError("there is no array in this Zarr store")
            result = {}
            for place, array in arrays.items():
                unit = known_unit(str(array.attrs.get("units", array.attrs.get("unit", ""))))
                shape = tuple(int(n) for n in array.shape)
                load, chunks = functools.partial(part, path, place), tuple(array.chunks)
                dtype = np.dtype(array.dtype)
                result[place or stem] = Entry(shape, dtype, unit, load, chunks=chunks)
            yield result


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
        with opened(path) as root:
            # Opened once, as the store is.
            kept = root.store.kept
            if group not in kept:
                kept[group] = decoded(
                    root.store,
                    engine="zarr",
                    group=_group(list(arrays_in(root)), group) or None,
                    consolidated=None if root.metadata.consolidated_metadata else False,
                )
            yield kept[group]
            warn_of_missing(path, root.store)


def _group(places: list[str], group: str | None) -> str:
    groups = list(dict.fromkeys(place.rpartition("/")[0] for place in places))
    if group is not None:
        if group.strip("/") not in groups:
            raise unknown_name("group", group, groups)
        return group.strip("/")
    if "" in groups or len(groups) == 1:
        return "" if "" in groups else groups[0]
    raise FileFormatError(f"there are several groups; choose one with group=…: {', '.join(groups)}")
