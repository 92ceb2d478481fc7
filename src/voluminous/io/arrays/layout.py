"""Where the cells are: from options, from arrays in the file, or cells of unit length."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import FileFormatError, InputError, unknown_name
from ...units import as_quantity, is_quantity, parse_unit, plain, unit_of
from ..axes import AXES, axis_of, edges_of_centers, is_even

if TYPE_CHECKING:
    from ...grids import CartesianGrid


_AS_IT_IS = (slice(None),) * 3
_KINDS = (("x", "y", "z"), ("bounds",), ("spacing",))


def axis_order(axes: Any) -> tuple[int, ...]:
    """Return the transposition that brings arrays to the order x, y, z."""
    if not isinstance(axes, str) or sorted(axes) != sorted(AXES):
        raise InputError(f"axes must be x, y and z in the arrays' order, e.g. 'zyx', got {axes!r}")
    return tuple(axes.index(axis) for axis in AXES)


def named_order(dims: tuple[str, ...]) -> tuple[int, ...]:
    """Return the transposition for axes with names; they are x, y, z if these do not tell."""
    axes = "".join(axis_of(dim, {}) for dim in dims)
    return axis_order(axes if sorted(axes) == sorted(AXES) else AXES)


def make_grid(
    entries: Mapping[str, Entry],
    place: str,
    shape: tuple[int, ...],
    order: tuple[int, ...],
    options: Mapping[str, Any],
) -> tuple[CartesianGrid, tuple[slice, ...]]:
    """Return the grid of a file of named arrays, and what turns arrays where coordinates fall."""
    from ...grids import CartesianGrid

    unit = options.get("unit") or text_in(entries.get("unit"))
    given = [kind for kind in _KINDS if any(options.get(name) is not None for name in kind)]
    if len(given) > 1:
        raise InputError("give the edges x, y and z, or bounds, or spacing, not several of them")
    if given and given[0] == _KINDS[0]:
        edges, turns = _rising(_given_edges(entries, shape, options))
        return CartesianGrid(*edges, unit=unit), turns
    if given:
        return equal_cells(shape, options, unit), _AS_IT_IS
    lines = _lines(entries, place, order)
    if lines:
        edges = [_edges(entries, p, a, n) for p, a, n in zip(lines, AXES, shape, strict=True)]
        edges, turns = _rising(edges)
        with _explained(lines):
            return CartesianGrid(*edges, unit=unit), turns
    told = "bounds" in entries and entries["bounds"].shape in ((2,), (3, 2))
    bounds = _loaded(entries["bounds"]) if told else [(0, n) for n in shape]
    return CartesianGrid.uniform(shape, bounds, unit=unit), _AS_IT_IS


def _rising(edges: list[Any]) -> tuple[list[Any], tuple[slice, ...]]:
    down = [bool(len(line) > 1 and line[0] > line[-1]) for line in edges]
    turns = tuple(slice(None, None, -1 if d else None) for d in down)
    return [line[turn] for line, turn in zip(edges, turns, strict=True)], turns


def _lines(entries: Mapping[str, Entry], place: str, order: tuple[int, ...]) -> tuple[str, ...]:
    """Return the places of the coordinates along x, y and z; nothing if not all are there."""
    scales = entries[place].scales
    groups = place.split("/")[:-1]
    above = ["/".join(groups[:n]) for n in range(len(groups), -1, -1)]
    found = [tuple(f"{group}/{a}".strip("/") for a in AXES) for group in above]
    candidates = [tuple(scales[k] for k in order), *found] if scales else found
    return next((c for c in candidates if all(_is_line(entries.get(p)) for p in c)), ())


@contextmanager
def _explained(lines: tuple[str, ...]) -> Iterator[None]:
    try:
        yield
    except InputError as error:
        raise type(error)(
            f"the coordinates {', '.join(lines)} in the file make no grid of cells: {error}. Give "
            "bounds=… or spacing=… in their place"
        ) from error


def equal_cells(shape: tuple[int, ...], options: Mapping[str, Any], unit: Any) -> CartesianGrid:
    """Return the grid of the option `bounds` or `spacing`."""
    from ...grids import CartesianGrid

    bounds = options.get("bounds")
    bounds = _spaced(shape, options["spacing"]) if bounds is None else bounds
    return CartesianGrid.uniform(shape, bounds, unit=unit)


def _given_edges(
    entries: Mapping[str, Entry], shape: tuple[int, ...], options: Mapping[str, Any]
) -> list[Any]:
    missing = [axis for axis in AXES if options.get(axis) is None]
    if missing:
        raise InputError(f"edges are needed along all three axes; {', '.join(missing)} missing")
    return [_edges(entries, options[axis], axis, n) for axis, n in zip(AXES, shape, strict=True)]


def _edges(entries: Mapping[str, Entry], source: Any, axis: str, cells: int) -> Any:
    """Return the edges that `source`, a place in the file or an array, stands for."""
    if isinstance(source, str):
        place = source.strip("/")
        if place not in entries:
            raise unknown_name("array", source, entries)
        edges = _loaded(entries[place])
    else:
        edges = source
    edges = as_quantity(edges)
    values = edges.value if is_quantity(edges) else edges
    found = np.shape(values)
    if found == (cells,) and cells > 1 and is_even(np.asarray(values, np.float64)):
        between = edges_of_centers(values)
        return between * edges.unit if is_quantity(edges) else between
    if found != (cells + 1,):
        told = (
            f"the {axis} edges {source!r} have" if isinstance(source, str) else f"{axis} edges have"
        )
        hint = (
            "; these seem to be centres, and not equally spaced: give edges, or "
            "bounds=((x0, x1), (y0, y1), (z0, z1)) for equal cells"
            if found == (cells,)
            else ""
        )
        raise FileFormatError(
            f"{told} shape {found}, expected {cells + 1} edges around {cells} cells{hint}"
        )
    return edges


def _is_line(entry: Entry | None) -> bool:
    return entry is not None and entry.numeric and len(entry.shape) == 1


def _loaded(entry: Entry) -> Any:
    unit = parse_unit(entry.unit)
    return entry.load() if unit is None else entry.load() * unit


def _spaced(shape: tuple[int, ...], spacing: Any) -> Any:
    """Return the bounds of cells of a width (one, or one per axis) that start at 0."""
    unit = unit_of(spacing)
    widths = np.asarray(plain(spacing, unit, "spacing"))
    if widths.shape not in ((), (3,)) or not np.all(widths > 0):
        raise InputError(f"spacing must be a positive number, or one per axis, got {spacing!r}")
    ends = np.broadcast_to(widths, 3) * np.asarray(shape)
    bounds = np.stack([np.zeros(3), ends], axis=1)
    return bounds if unit is None else bounds * unit


def text_in(entry: Entry | None) -> str | None:
    """Return the text in an array that is one text."""
    if entry is None or entry.shape != () or entry.dtype.kind not in "US":
        return None
    value = entry.load()[()]
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


# More are no components of a vector, but a fourth dimension.
_MOST = 4
_WHERE = {"first": 0, "last": 3}


@dataclass(frozen=True)
class Entry:
    """An array in a file."""

    shape: tuple[int, ...]  # known without reading it
    dtype: np.dtype[Any]  # known without reading it
    unit: str  # known without reading it
    load: Callable[..., np.ndarray]  # returns the values, or the part with an index
    mapped: bool = False  # true if values stay in the file until they are used
    # per axis the place of its coordinate and its name, empty where there is none; or nothing
    scales: tuple[str, ...] = ()
    # per axis the place of its coordinate and its name, empty where there is none; or nothing
    dims: tuple[str, ...] = ()
    part_of: str = ""  # place of the array that this is a component of; empty if it is whole

    @property
    def numeric(self) -> bool:
        """True for real numbers."""
        return self.dtype.kind in "fiub"

    def component(self, place: str, axis: int, number: int) -> Entry:
        """Return one entry along an axis; the place is that of the whole array."""
        index = (*[slice(None)] * axis, number)
        without = [k for k in range(len(self.shape)) if k != axis]
        return replace(
            self,
            shape=tuple(self.shape[k] for k in without),
            load=lambda: self.load(index),
            mapped=False,
            scales=tuple(self.scales[k] for k in without) if self.scales else (),
            dims=tuple(self.dims[k] for k in without) if self.dims else (),
            part_of=place,
        )


def with_components(entries: Mapping[str, Entry], where: Any) -> dict[str, Entry]:
    """Return all arrays, those of vectors (of four axes) as one for each component."""
    if where is not None and where not in _WHERE:
        raise InputError(f"components must be 'first' or 'last', got {where!r}")
    found: dict[str, Entry] = {}
    for place, entry in entries.items():
        axis = _component_axis(entry, where)
        if axis is None:
            found[place] = entry
            continue
        count = entry.shape[axis]
        endings = "xyz" if count == len("xyz") else map(str, range(count))
        for number, ending in enumerate(endings):
            found.setdefault(f"{place}_{ending}", entry.component(place, axis, number))
    return found


def _component_axis(entry: Entry, where: str | None) -> int | None:
    if len(entry.shape) != 4 or not entry.numeric:
        return None
    if where is not None:
        return _WHERE[where]
    # An axis that is called x, y, z or t counts no components.
    ends = [a for a in _WHERE.values() if not (entry.dims and axis_of(entry.dims[a], {}))]
    three = [axis for axis in ends if entry.shape[axis] == 3]
    few = [axis for axis in ends if 2 <= entry.shape[axis] <= _MOST]
    return next((found[0] for found in (three, few) if len(found) == 1), None)
