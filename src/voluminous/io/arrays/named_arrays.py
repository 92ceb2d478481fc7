"""Base of the readers of named arrays (NPZ, NPY, HDF5, Zarr): which are fields, which the grid."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...deferred import Deferred
from ...errors import FileFormatError, InputError
from ..boxes import boxes
from ..contract import FieldChoice, FieldInfo, Reader
from ..names import chosen_fields, field_name
from .layout import Entry, axis_order, make_grid, named_order, with_components

if TYPE_CHECKING:
    from ...volume import Volume


class NamedArraysReader(Reader):
    """A format has to provide `entries`."""

    options = {  # noqa: RUF012 - as in Reader
        "x": "place of the cell edges along x in the file, or the edges themselves",
        "y": "the same along y",
        "z": "the same along z",
        "bounds": "(low, high) or ((x0, x1), (y0, y1), (z0, z1)) of a grid of equal cells",
        "spacing": "cell width, or one per axis, of a grid that starts at 0",
        "unit": "unit of length",
        "axes": "what the arrays' axes are: 'xyz' (default), or 'zyx' if z comes first",
        "components": "which axis of arrays of four counts the components of a vector: 'first' or "
        "'last'; by default the one of length 3, else 2 to 4",
    }

    def entries(
        self, path: Path, only: str | None = None, **options: Any
    ) -> AbstractContextManager[dict[str, Entry]]:
        """Return a context that gives place → array, places without a slash in front.

        With `only` the array there is enough: a file may hold thousands.
        """
        raise NotImplementedError

    def read(
        self,
        path: Path,
        fields: FieldChoice = None,
        *,
        axes: str | None = None,
        components: str | None = None,
        **options: Any,
    ) -> Volume:
        from ...volume import Volume

        specific = self._own(options)
        with self.entries(path, **specific) as stored:
            entries = with_components(stored, components)
            chosen = _chosen(entries, fields)
            for name, place in chosen.items():
                _check_field(name, entries[place])
            orders = {
                name: named_order(entries[place].dims) if axes is None else axis_order(axes)
                for name, place in chosen.items()
            }
            shapes = {tuple(entries[p].shape[k] for k in orders[n]) for n, p in chosen.items()}
            if len(shapes) > 1:
                listed = ", ".join(f"{name} {entries[p].shape}" for name, p in chosen.items())
                raise InputError(
                    f"fields must have one shape, got {listed}; choose some of one shape with "
                    "fields=[…]"
                )
            first = next(iter(chosen))
            grid, turns = make_grid(entries, chosen[first], shapes.pop(), orders[first], options)
            volume = Volume(grid)

            backward = [turn.step == -1 for turn in turns]
            for name, place in chosen.items():
                entry, order, pieces = entries[place], orders[name], None
                whole = entry.part_of or place
                part = functools.partial(self._part, path, specific, components, place, whole)
                if entry.chunks is not None:
                    pieces = boxes(part, [entry.shape], entry.chunks, order, backward)
                read = functools.partial(_whole, part, order, turns)
                volume[name] = Deferred(read, entry.dtype, entry.unit, pieces)
        return volume

    def info(
        self, path: Path, *, components: str | None = None, **options: Any
    ) -> tuple[FieldInfo, ...]:
        with self.entries(path, **self._own(options)) as stored:
            return tuple(
                FieldInfo(field_name(place), place, entry.shape, str(entry.dtype), entry.unit)
                for place, entry in with_components(stored, components).items()
                if entry.is_field
            )

    def _part(
        self,
        path: Path,
        specific: dict[str, Any],
        components: str | None,
        place: str,
        whole: str,
        index: Any,
        level: int = 0,
    ) -> np.ndarray:
        with self.entries(path, whole, **specific) as stored:
            return with_components(stored, components)[place].load(index)

    def _own(self, options: dict[str, Any]) -> dict[str, Any]:
        specific = [name for name in options if name not in NamedArraysReader.options]
        return {name: options.pop(name) for name in specific}


def _whole(
    part: Callable[[Any], np.ndarray], order: tuple[int, ...], turns: tuple[slice, ...]
) -> np.ndarray:
    return np.transpose(part(...), order)[turns]


def _chosen(entries: Mapping[str, Entry], fields: FieldChoice) -> dict[str, str]:
    places = {
        place: field_name(place) for place, e in entries.items() if e.is_field or fields is not None
    }
    if not places:
        listed = [f"{place} {e.shape} {e.dtype}" for place, e in list(entries.items())[:8]]
        more = ", …" if len(entries) > len(listed) else ""
        raise FileFormatError(
            "expected a three-dimensional array of numbers; the file holds "
            f"{', '.join(listed) or 'nothing'}{more}"
        )
    return chosen_fields(places, fields, "array")


def _check_field(name: str, entry: Entry) -> None:
    shape, hint = entry.shape, ""
    if entry.dtype.kind == "O":
        raise FileFormatError(
            f"{name!r} holds Python objects, expected numbers; objects could run any program when "
            "loaded. Save it again with a numeric type"
        )
    if not entry.numeric:
        raise FileFormatError(f"{name!r} must be real numbers, got dtype {entry.dtype}")
    if len(shape) == 4:
        hint = (
            "; give the components of a vector as three fields, or say with components='first' or "
            "'last' which axis counts them"
        )
    if len(shape) != 3:
        raise FileFormatError(f"{name!r} has shape {shape}, expected three axes (x, y, z){hint}")
    if min(shape) < 1:
        raise FileFormatError(f"{name!r} has shape {shape}, expected at least one cell")
