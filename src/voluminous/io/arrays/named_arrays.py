"""Files that are a set of named arrays (NPZ, NPY, HDF5): which are fields, which the grid."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...deferred import Deferred
from ...errors import FileFormatError, InputError
from ..contract import FieldInfo, Reader
from ..names import chosen_fields, field_name
from .layout import AXES, axis_order, make_grid

if TYPE_CHECKING:
    from ...volume import Volume


@dataclass(frozen=True)
class Entry:
    """An array in a file: what is known of it before it is read, and how to read it.

    `mapped` is True if its values stay in the file until they are used.
    """

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    unit: str
    load: Callable[[], np.ndarray]
    mapped: bool = False

    @property
    def numeric(self) -> bool:
        """True for real numbers."""
        return self.dtype.kind in "fiub"


class NamedArraysReader(Reader):
    """What readers of named arrays share; a format has to provide `entries`."""

    options = {  # noqa: RUF012 - as in Reader
        "x": "place of the cell edges along x in the file, or the edges themselves",
        "y": "the same along y",
        "z": "the same along z",
        "bounds": "(low, high) or ((x0, x1), (y0, y1), (z0, z1)) of a grid of equal cells",
        "spacing": "cell width, or one per axis, of a grid that starts at 0",
        "unit": "unit of length",
        "axes": "what the arrays' axes are: 'xyz' (default), or 'zyx' if z comes first",
    }

    def entries(self, path: Path, **options: Any) -> AbstractContextManager[dict[str, Entry]]:
        """Return a context that gives place → array, places without a slash in front."""
        raise NotImplementedError

    def read(self, path: Path, fields: Any = None, **options: Any) -> Volume:
        """Return the volume; reads the chosen fields and the edges only."""
        from ...volume import Volume

        order = axis_order(options.pop("axes", AXES))
        own = self._own(options)
        with self.entries(path, **own) as entries:
            chosen = _chosen(entries, fields)
            shape = _common_shape({name: entries[place] for name, place in chosen.items()})
            grid = make_grid(entries, tuple(shape[k] for k in order), options)
            volume = Volume(grid)
            for name, place in chosen.items():
                load = functools.partial(self._load, path, place, order, own)
                entry = entries[place]
                volume[name] = Deferred(load, entry.dtype, entry.unit, entry.mapped)
        return volume

    def _load(
        self, path: Path, place: str, order: tuple[int, ...], own: dict[str, Any]
    ) -> np.ndarray:
        """Return the values of a field."""
        with self.entries(path, **own) as entries:
            return entries[place].load().transpose(order)

    def info(self, path: Path, **options: Any) -> tuple[FieldInfo, ...]:
        """Return all numeric arrays of three dimensions, whether or not they fit together."""
        with self.entries(path, **self._own(options)) as entries:
            places = [p for p, entry in entries.items() if _is_field(entry)]
            return tuple(
                FieldInfo(
                    field_name(place),
                    place,
                    entries[place].shape,
                    str(entries[place].dtype),
                    entries[place].unit,
                )
                for place in places
            )

    def _own(self, options: dict[str, Any]) -> dict[str, Any]:
        """Return, and take away, the options that are not of all such readers."""
        own = [name for name in options if name not in NamedArraysReader.options]
        return {name: options.pop(name) for name in own}


def _is_field(entry: Entry) -> bool:
    return len(entry.shape) == 3 and entry.numeric


def _chosen(entries: Mapping[str, Entry], fields: Any) -> dict[str, str]:
    """Return name → place of the fields asked for; of all fields if none is."""
    if fields is not None:
        return chosen_fields({place: field_name(place) for place in entries}, fields, "array")
    places = {p: field_name(p) for p, entry in entries.items() if _is_field(entry)}
    if not places:
        raise FileFormatError(
            f"expected a three-dimensional array of numbers; the file holds {_listed(entries)}"
        )
    return chosen_fields(places, None)


def _common_shape(chosen: Mapping[str, Entry]) -> tuple[int, ...]:
    """Return the shape of all fields, once each is known to be a field."""
    for name, entry in chosen.items():
        _check_field(name, entry)
    shapes = {entry.shape for entry in chosen.values()}
    if len(shapes) > 1:
        listed = ", ".join(f"{name} {entry.shape}" for name, entry in chosen.items())
        raise InputError(
            f"fields must have one shape, got {listed}; choose some of one shape with fields=[…]"
        )
    return shapes.pop()


def _check_field(name: str, entry: Entry) -> None:
    if entry.dtype.kind == "O":
        raise FileFormatError(
            f"{name!r} holds Python objects, expected numbers; objects could run any program when "
            "loaded. Save it again with a numeric type"
        )
    if not entry.numeric:
        raise FileFormatError(f"{name!r} must be real numbers, got dtype {entry.dtype}")
    if len(entry.shape) != 3:
        many = len(entry.shape) == 4
        raise FileFormatError(
            f"{name!r} has shape {entry.shape}, expected three axes (x, y, z)"
            + ("; give the components of a vector as three fields" if many else "")
        )
    if 0 in entry.shape:
        raise FileFormatError(f"{name!r} has shape {entry.shape}, expected at least one cell")


def _listed(entries: Mapping[str, Entry]) -> str:
    shown = [f"{place} {entry.shape} {entry.dtype}" for place, entry in list(entries.items())[:8]]
    more = ", …" if len(entries) > len(shown) else ""
    return ", ".join(shown) + more if shown else "nothing"
