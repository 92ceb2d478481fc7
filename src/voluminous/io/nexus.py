"""Reader for NeXus files: the signal of an NXdata group, on its axes.

https://manual.nexusformat.org/classes/base_classes/NXdata.html
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import FileFormatError, unknown_name
from ..packages import require
from .hdf5 import check_places, holds, opened, text
from .labelled.convert import LabelledReader

if TYPE_CHECKING:
    import h5py
    import xarray


# Groups that lead to the one that is shown: in fact an entry, and what it shows.
_DEEPEST = 8


class NeXusReader(LabelledReader):
    """Signals of three or more dimensions in one NXdata group; axes are cell centres, or edges."""

    name = "nexus"
    description = "a NeXus file with NXdata of three dimensions (HDF5)"
    suffixes = (".nxs", ".nx")
    options = {  # noqa: RUF012 - as in Reader
        **LabelledReader.options,
        "group": "the NXdata group; by default the one that the file shows, or the first",
    }

    def matches(self, path: Path, head: bytes) -> bool:
        def marked(file: h5py.File) -> bool:
            items = (file, *(item for _, item in _members(file)))
            return any("NX_class" in item.attrs for item in items) and bool(_groups(file))

        return holds(path, head, marked)

    @contextmanager
    def dataset(self, path: Path, group: str | None) -> Iterator[xarray.Dataset]:
        xarray = require("xarray", self.extra, "reading NeXus")
        check_places(path)
        with opened(path) as file:
            known, shown = _groups(file), file
            for _ in range(_DEEPEST):  # a group may name itself
                shown = dict(_members(shown)).get(text(shown.attrs.get("default")), shown)
            first = shown.name.strip("/") if shown.name.strip("/") in known else next(iter(known))
            place = first if group is None else group.strip("/")
            if place not in known:
                raise unknown_name("NXdata group", place, known)
            yield _dataset(xarray, path, file[place], known[place])


def _members(group: Any) -> Iterator[tuple[str, Any]]:
    import h5py

    for name in group:
        inside = not isinstance(group.get(name, getlink=True), h5py.ExternalLink)
        item = group.get(name) if inside else None
        if item is not None:
            yield name, item


def _groups(file: Any) -> dict[str, str]:
    """Return {place: signal name} of all NXdata groups; signals have three or more dimensions."""
    result: dict[str, str] = {}

    def visit(place: str, item: Any) -> None:
        if text(item.attrs.get("NX_class")) == "NXdata":
            inside = dict(_members(item))
            # Older files mark the signal data set itself.
            marked = (n for n, i in inside.items() if str(i.attrs.get("signal")) in ("1", "b'1'"))
            signal = text(item.attrs.get("signal")) or next(marked, "")
            if getattr(inside.get(signal), "ndim", 0) >= 3:
                result[place] = signal

    file.visititems(visit)
    return result


def _dataset(xarray: Any, path: Path, group: Any, signal: str) -> Any:
    inside = dict(_members(group))
    shape = inside[signal].shape
    names = _axes(group, signal)
    letters = [re.sub(r"[^a-z]", "", name.lower())[-1:] for name in names]
    is_xyz = sorted(letters[-3:]) == ["x", "y", "z"]
    coords: dict[str, Any] = {"group": group.name}
    variables: dict[str, Any] = {}
    for name, letter, count in zip(names, letters, shape, strict=True):
        item: Any = inside.get(name)
        if getattr(item, "shape", None) not in ((count,), (count + 1,)) or not count:
            continue
        attributes = {"units": text(item.attrs.get("units"))} | ({"axis": letter} if is_xyz else {})
        values = item[()].astype(np.float64)
        if len(values) > count:
            attributes["bounds"] = f"{name}_bounds"
            variables[f"{name}_bounds"] = ((name, "ends"), np.stack([values[:-1], values[1:]], 1))
            values = (values[1:] + values[:-1]) / 2
        coords[name] = (name, values, attributes)
    for name, item in inside.items():
        if getattr(item, "shape", None) == shape and item.dtype.kind in "fiub":
            if item.file.filename != group.file.filename:
                raise FileFormatError(f"the values of {name} are in another file")
            attributes = {"units": text(item.attrs.get("units"))}
            attributes["ancillary_variables"] = f"errors {name}_errors"
            variables[name] = (names, _lazy(xarray, item), attributes)
    return xarray.Dataset(variables, coords)


def _axes(group: Any, signal: str) -> list[str]:
    """Return the axis names of the signal; missing names are made up."""
    names = [text(name) for name in np.ravel(group.attrs.get("axes", ()))]
    if not names:  # older files: an attribute of the signal
        names = [n for n in re.split(r"[\s,:\[\]]+", text(group[signal].attrs.get("axes"))) if n]
    names += ["."] * (group[signal].ndim - len(names))
    return [name if name != "." else f"axis_{k}" for k, name in enumerate(names)]


def _lazy(xarray: Any, item: Any) -> Any:
    indexing = xarray.core.indexing

    class LazyItem(xarray.backends.BackendArray):
        shape, dtype = item.shape, item.dtype.newbyteorder("=")

        def __getitem__(self, key: Any) -> Any:
            return indexing.explicit_indexing_adapter(
                key,
                self.shape,
                indexing.IndexingSupport.BASIC,
                lambda k: item[k].astype(self.dtype),
            )

    return indexing.LazilyIndexedArray(LazyItem())
