"""Arrays in a file and their grid: from options, from arrays in the file, or unit cells."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import FileFormatError, InputError, unknown_name
from ...units import as_quantity, parse_unit, plain, unit_of
from ..axes import AXES, axis_of, edges_of_centers, is_even

if TYPE_CHECKING:
    from ...grids import CartesianGrid

_AS_IT_IS = (slice(None),) * 3
_KINDS = (("x", "y", "z"), ("bounds",), ("spacing",))
# A longer axis is a fourth dimension, not the components of a vector.
_MOST_COMPONENTS = 4
_ENDS = {"first": 0, "last": 3}


@dataclass(frozen=True)
class Entry:
    """An array in a file: its shape, type and unit, and how to read its values."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    unit: str
    load: Callable[..., np.ndarray]  # returns the values, or the part with an index
    # Per axis the place of its coordinate and its name, empty where there is none; or nothing.
    scales: tuple[str, ...] = ()
    dims: tuple[str, ...] = ()
    # Cells of the pieces in the file, () if any part is as good; None if it must be read whole.
    chunks: tuple[int, ...] | None = None
    part_of: str = ""  # place of the array that this is a component of; empty if it is whole

    @property
    def numeric(self) -> bool:
        """True for real numbers."""
        return self.dtype.kind in "fiub"

    @property
    def is_field(self) -> bool:
        """True if the array can be a field without conversion."""
        return len(self.shape) == 3 and self.numeric

    def component(self, place: str, axis: int, number: int) -> Entry:
        """Return one entry along an axis; the place is that of the whole array."""
        without = [k for k in range(len(self.shape)) if k != axis]

        def load(index: Any = ...) -> np.ndarray:
            rest = (slice(None),) * len(without) if index is ... else index
            return self.load((*rest[:axis], number, *rest[axis:]))

        return replace(
            self,
            shape=tuple(self.shape[k] for k in without),
            load=load,
            scales=tuple(self.scales[k] for k in without) if self.scales else (),
            dims=tuple(self.dims[k] for k in without) if self.dims else (),
            chunks=tuple(self.chunks[k] for k in without) if self.chunks else self.chunks,
            part_of=place,
        )

    def quantity(self) -> Any:
        """Return the values with their unit."""
        unit = parse_unit(self.unit)
        return self.load() if unit is None else self.load() * unit

    def text(self) -> str | None:
        """Return the text in an array that is one text."""
        if self.shape != () or self.dtype.kind not in "US":
            return None
        value = self.load()[()]
        return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


def with_components(entries: Mapping[str, Entry], where: Any) -> dict[str, Entry]:
    """Return all arrays, those of vectors (of four axes) as one for each component.

    `where` ("first" or "last") is the axis that counts components; None: the only one of the two
    that has three, or else 2 to 4 entries. The components of ``velocity`` are ``velocity_x``,
    ``velocity_y`` and ``velocity_z`` if there are three, else ``velocity_0`` …
    """
    if where is not None and where not in _ENDS:
        raise InputError(f"components must be 'first' or 'last', got {where!r}")
    split: dict[str, Entry] = {}
    for place, entry in entries.items():
        axis = _ENDS[where] if where else _component_axis(entry)
        if len(entry.shape) != 4 or not entry.numeric or axis is None:
            split[place] = entry
            continue
        count = entry.shape[axis]
        for number, ending in enumerate(AXES if count == 3 else map(str, range(count))):
            split.setdefault(f"{place}_{ending}", entry.component(place, axis, number))
    return split


def _component_axis(entry: Entry) -> int | None:
    counts = {a: entry.shape[a] for a in _ENDS.values() if a < len(entry.shape)}
    # An axis called x, y, z or t does not enumerate components.
    counts = {a: n for a, n in counts.items() if not (entry.dims and axis_of(entry.dims[a], {}))}
    three = [axis for axis, n in counts.items() if n == 3]
    few = [axis for axis, n in counts.items() if 2 <= n <= _MOST_COMPONENTS]
    return next((axes[0] for axes in (three, few) if len(axes) == 1), None)


def axis_order(axes: Any) -> tuple[int, ...]:
    """Return the transposition that brings arrays to the order x, y, z."""
    if not isinstance(axes, str) or sorted(axes) != sorted(AXES):
        raise InputError(f"axes must be x, y and z in the arrays' order, e.g. 'zyx', got {axes!r}")
    return tuple(axes.index(axis) for axis in AXES)


def named_order(dims: tuple[str, ...]) -> tuple[int, ...]:
    """Return the transposition for axes with names; x, y, z if the names say nothing.

    Examples
    --------
    >>> named_order(("lev", "lat", "lon")), named_order(())
    ((2, 1, 0), (0, 1, 2))
    """
    axes = "".join(axis_of(dim, {}) for dim in dims)
    return axis_order(axes if sorted(axes) == sorted(AXES) else AXES)


def make_grid(
    entries: Mapping[str, Entry],
    place: str,
    shape: tuple[int, ...],
    order: tuple[int, ...],
    options: Mapping[str, Any],
) -> tuple[CartesianGrid, tuple[slice, ...]]:
    """Return the grid of a file of named arrays, and what turns arrays where coordinates fall.

    Options (edges, bounds or spacing, and the unit) go before the file. There the coordinates of
    the axes of the field at `place`, or ``x, y, z`` beside it or above, are edges, or equally
    spaced centres; else ``bounds``.
    """
    from ...grids import CartesianGrid

    unit = options.get("unit") or (entries["unit"].text() if "unit" in entries else None)
    given = [kind for kind in _KINDS if any(options.get(name) is not None for name in kind)]
    if len(given) > 1:
        raise InputError("give the edges x, y and z, or bounds, or spacing, not several of them")
    if given and given[0] != _KINDS[0]:
        return equal_cells(shape, options, unit), _AS_IT_IS
    lines: tuple[Any, ...] = tuple(options.get(axis) for axis in AXES)
    missing = [axis for axis, line in zip(AXES, lines, strict=True) if line is None]
    if given and missing:
        raise InputError(f"edges are needed along all three axes; {', '.join(missing)} missing")
    lines = lines if given else _lines(entries, place, order)
    if not lines:
        bounds = entries.get("bounds")
        ends = [(0, n) for n in shape]
        if bounds is not None and bounds.shape in ((2,), (3, 2)):
            ends = bounds.quantity()
        return CartesianGrid.uniform(shape, ends, unit=unit), _AS_IT_IS
    edges = [_edges(entries, p, a, n) for p, a, n in zip(lines, AXES, shape, strict=True)]
    down = [bool(len(line) > 1 and line[0] > line[-1]) for line in edges]
    turns = tuple(slice(None, None, -1 if d else None) for d in down)
    edges = [line[turn] for line, turn in zip(edges, turns, strict=True)]
    try:
        return CartesianGrid(*edges, unit=unit), turns
    except InputError as error:
        if given:
            raise
        raise type(error)(
            f"the coordinates {', '.join(lines)} in the file make no grid of cells: {error}. Give "
            "bounds=… or spacing=… in their place"
        ) from error


def _lines(entries: Mapping[str, Entry], place: str, order: tuple[int, ...]) -> tuple[str, ...]:
    """Return the places of the coordinates along x, y and z; nothing if not all are there."""
    scales, groups = entries[place].scales, place.split("/")[:-1]
    above = ["/".join(groups[:n]) for n in range(len(groups), -1, -1)]
    candidates = [tuple(scales[k] for k in order)] if scales else []
    candidates += [tuple(f"{group}/{a}".strip("/") for a in AXES) for group in above]
    lines = {p for p, entry in entries.items() if entry.numeric and len(entry.shape) == 1}
    return next((c for c in candidates if {*c} <= lines), ())


def equal_cells(shape: tuple[int, ...], options: Mapping[str, Any], unit: Any) -> CartesianGrid:
    """Return the grid of the option `bounds`, or `spacing` of cells that start at 0."""
    from ...grids import CartesianGrid

    if options.get("bounds") is not None:
        return CartesianGrid.uniform(shape, options["bounds"], unit=unit)
    spacing = options["spacing"]
    spacing_unit = unit_of(spacing)
    widths = np.asarray(plain(spacing, spacing_unit, "spacing"))
    if widths.shape not in ((), (3,)) or not np.all(widths > 0):
        raise InputError(f"spacing must be a positive number, or one per axis, got {spacing!r}")
    bounds = np.outer(np.broadcast_to(widths, 3) * shape, [0, 1])
    return CartesianGrid.uniform(
        shape, bounds if spacing_unit is None else bounds * spacing_unit, unit=unit
    )


def _edges(entries: Mapping[str, Entry], source: Any, axis: str, cells: int) -> Any:
    """Return the edges given by `source`: a place in the file, or an array."""
    edges, what = source, f"{axis} edges have"
    if isinstance(source, str):
        if source.strip("/") not in entries:
            raise unknown_name("array", source, entries)
        edges, what = entries[source.strip("/")].quantity(), f"the {axis} edges {source!r} have"
    edges = as_quantity(edges)
    unit = unit_of(edges)
    values = np.asarray(edges if unit is None else edges.value)
    hint = ""
    if values.shape == (cells,):
        if cells > 1 and is_even(values.astype(np.float64)):
            between = edges_of_centers(values)
            return between if unit is None else between * unit
        hint = (
            "; these seem to be centres, and not equally spaced: give edges, or "
            "bounds=((x0, x1), (y0, y1), (z0, z1)) for equal cells"
        )
    if values.shape != (cells + 1,):
        raise FileFormatError(
            f"{what} shape {values.shape}, expected {cells + 1} edges around {cells} cells{hint}"
        )
    return edges
