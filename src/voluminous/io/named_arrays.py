"""Files that are a set of named arrays (NPZ, NPY, HDF5): which are fields, which the grid."""

from __future__ import annotations

import keyword
import math
import unicodedata
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import FileFormatError, InputError, unknown_name
from ..memory import check_memory
from .contract import FieldInfo, Reader
from .layout import AXES, axis_order, make_grid

if TYPE_CHECKING:
    from ..volume import Volume


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
        from ..volume import Volume

        order = axis_order(options.pop("axes", AXES))
        with self.entries(path, **self._own(options)) as entries:
            chosen = _chosen(entries, fields)
            shape = _common_shape({name: entries[place] for name, place in chosen.items()})
            grid = make_grid(entries, tuple(shape[k] for k in order), options)
            check_memory(
                _needed([entries[p] for p in chosen.values()]),
                "reading " + ", ".join(chosen),
                "read fewer fields with fields=[…]",
            )
            volume = Volume(grid)
            for name, place in chosen.items():
                volume[name] = entries[place].load().transpose(order)
                volume.set_unit(name, entries[place].unit)
        return volume

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


def field_name(place: str) -> str:
    """Return a name that expressions can use: the last part of a place, made an identifier.

    Examples
    --------
    >>> field_name("gas/x-velocity"), field_name("e")
    ('x_velocity', 'e_')
    """
    from ..expressions import CONSTANTS, FUNCTIONS
    from ..fields import COORDINATES

    # Expressions read names in this normal form.
    last = unicodedata.normalize("NFKC", place.rsplit("/", 1)[-1])
    name = "".join(c if f"_{c}".isidentifier() else "_" for c in last)
    name = name if name.isidentifier() else f"_{name}"
    reserved = name in FUNCTIONS or name in CONSTANTS or name in COORDINATES
    return f"{name}_" if reserved or keyword.iskeyword(name) else name


def _is_field(entry: Entry) -> bool:
    return len(entry.shape) == 3 and entry.numeric


def _chosen(entries: Mapping[str, Entry], fields: Any) -> dict[str, str]:
    """Return name → place of the fields asked for; of all fields if none is."""
    if fields is None:
        places = [place for place, entry in entries.items() if _is_field(entry)]
        if not places:
            raise FileFormatError(
                f"expected a three-dimensional array of numbers; the file holds {_listed(entries)}"
            )
        return _named(places)
    if isinstance(fields, Mapping):
        return {name: _found(entries, place) for name, place in fields.items()}
    asked = [fields] if isinstance(fields, str) else list(fields)
    if not asked:
        raise InputError("fields is empty; name at least one, or leave it out to read all")
    return _named([_found(entries, place) for place in asked])


def _named(places: list[str]) -> dict[str, str]:
    chosen: dict[str, str] = {}
    for place in places:
        name = field_name(place)
        if chosen.setdefault(name, place) != place:
            raise InputError(
                f"{chosen[name]!r} and {place!r} would both be called {name!r}; name the fields "
                f"with fields={{{name!r}: {chosen[name]!r}, …}}"
            )
    return chosen


def _found(entries: Mapping[str, Entry], place: Any) -> str:
    if not isinstance(place, str):
        raise InputError(f"fields must be names, got {place!r}")
    if place.strip("/") not in entries:
        raise unknown_name("array", place, entries)
    return place.strip("/")


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


def _needed(entries: list[Entry]) -> int:
    """Return the bytes that reading takes."""
    return sum(math.prod(e.shape) * e.dtype.itemsize for e in entries if not e.mapped)


def _listed(entries: Mapping[str, Entry]) -> str:
    shown = [f"{place} {entry.shape} {entry.dtype}" for place, entry in list(entries.items())[:8]]
    more = ", …" if len(entries) > len(shown) else ""
    return ", ".join(shown) + more if shown else "nothing"
