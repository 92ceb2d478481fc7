"""Conversion of arrays with named dimensions to fields: selection, axis order and grid."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import InputError, UnitsError, unknown_name
from ...units import parse_unit
from ..arrays.layout import equal_cells
from ..axes import AXES, axis_of, edges_of_centers
from ..units import known_unit

if TYPE_CHECKING:
    import xarray

    from ...grids import CartesianGrid

# Options that select part of the data and define its cells.
OPTIONS = {
    "dims": "the dimensions along x, y and z, by default as their names say: ('lon', 'lat', 'lev')",
    "isel": "which part of other dimensions, by number: {'time': 0}; slices cut a part out",
    "sel": "the same by the value of the coordinate: {'time': '2001-01-31'}",
    "bounds": "(low, high) or ((x0, x1), (y0, y1), (z0, z1)) of a grid of equal cells, in place of "
    "the coordinates",
    "spacing": "cell width, or one per axis, of a grid that starts at 0, in place of coordinates",
    "aspect": "lengths of the sides of the box (x, y, z) that coordinates of different kinds, such "
    "as angles and pressures, are fitted into",
    "unit": "unit of length",
}
# Pressure grows downwards, whether or not its coordinate says so (CF conventions 4.3.1).
_PRESSURES = ("Pa", "hPa", "mbar", "dbar", "kPa", "bar")


@dataclass(frozen=True)
class Line:
    """One axis of a grid, from the coordinate of a dimension."""

    dim: str
    edges: np.ndarray  # of the cells, ascending; negative depths or pressures where `down`
    unit: str = ""
    flipped: bool = False  # True if values come in the opposite order
    counted: bool = False  # True if there is no coordinate, and cells are counted
    down: bool = False  # True if the coordinate grows downwards

    def described(self) -> dict[str, Any]:
        """Return the name, unit and ends as plain values, as in the data."""
        ends = [float(self.edges[0]), float(self.edges[-1])]
        first, last = [-end for end in ends] if self.down else ends
        return {"name": self.dim, "unit": self.unit, "from": first, "to": last}

    @property
    def kind(self) -> str:
        """The same for units that convert into each other."""
        unit = parse_unit(self.unit)
        return "" if unit is None else str(unit.decompose().bases)

    def quantity(self) -> Any:
        """Return the edges with their unit."""
        unit = parse_unit(self.unit)
        return self.edges if unit is None else self.edges * unit

    def fitted(self, side: float) -> np.ndarray:
        """Return the edges scaled to the length `side`, starting at 0."""
        low, high = self.edges[0], self.edges[-1]
        return np.asarray((self.edges - low) * (side / (high - low)))


@dataclass(frozen=True)
class NamedLayout:
    """The axes and the grid that all fields share."""

    lines: tuple[Line, ...]
    grid: CartesianGrid

    @property
    def dims(self) -> tuple[str, ...]:
        """Dimensions along x, y and z."""
        return tuple(line.dim for line in self.lines)

    def values(self, array: xarray.DataArray) -> np.ndarray:
        """Return an array as a field: index [ix, iy, iz], coordinates ascending."""
        # Turned once it is in memory: xarray would look up each value of a file by itself.
        kept = [str(dim) for dim in array.dims if dim in self.dims]
        values = plain_values(array).reshape([array.sizes[dim] for dim in kept])
        senses = tuple(slice(None, None, -1 if line.flipped else None) for line in self.lines)
        return np.asarray(values.transpose([kept.index(dim) for dim in self.dims])[senses])

    def part(
        self, array: xarray.DataArray, low: Sequence[int], high: Sequence[int], level: int
    ) -> np.ndarray:
        """Return the cells ``low <= i < high`` of an array as a field."""
        box = {}
        for line, a, b in zip(self.lines, low, high, strict=True):
            n = array.sizes[line.dim]
            box[line.dim] = slice(n - b, n - a) if line.flipped else slice(a, b)
        return self.values(array.isel(box))

    def chunks(self, array: xarray.DataArray) -> tuple[int, ...] | None:
        """Return the cells of the pieces of an array, in a file or of dask."""
        stored = {str(dim): sizes[0] for dim, sizes in array.chunksizes.items()}
        stored = stored or dict(array.encoding.get("preferred_chunks") or {})
        return (
            tuple(int(stored.get(dim, array.sizes[dim])) for dim in self.dims) if stored else None
        )


def layout_of(
    data: xarray.Dataset, array: xarray.DataArray, options: Mapping[str, Any]
) -> NamedLayout:
    """Return the axes and the grid of an array of a data set."""
    names = dims_of(data, array, options)
    lines = tuple(_line(data, n, axis == "z") for n, axis in zip(names, AXES, strict=True))
    return NamedLayout(lines, _grid(lines, options))


def selected(data: xarray.Dataset, options: Mapping[str, Any]) -> xarray.Dataset:
    """Return the part of a data set selected by `isel` and `sel`."""
    for kind in ("isel", "sel"):
        given = options.get(kind) or {}
        if not isinstance(given, Mapping):
            raise InputError(f"{kind} must be {{dimension: entry}}, got {given!r}")
        for name, entry in given.items():
            dim = str(name)  # it may be a number
            if dim not in data.sizes:
                raise unknown_name("dimension", dim, [str(d) for d in data.sizes])
            try:
                part = data.isel({dim: entry}) if kind == "isel" else data.sel({dim: entry})
                if not part.sizes.get(dim, 1):
                    raise KeyError(entry)
            except (IndexError, KeyError, TypeError, ValueError) as error:
                values = data[dim].values
                ends = (0, len(values) - 1) if kind == "isel" else (values[0], values[-1])
                raise InputError(f"no {dim} = {entry!r}: expected {ends[0]} … {ends[1]}") from error
            data = part
    return data


def axis_in(data: xarray.Dataset, dim: str) -> str:
    """Return what a dimension of a data set is: x, y, z, t or unknown."""
    attributes = data.coords[dim].attrs if dim in data.coords else {}
    is_time = dim in data.coords and (
        data.coords[dim].dtype.kind == "M" or _of_calendar(data.coords[dim])
    )
    return "t" if is_time else axis_of(dim, attributes)


def _of_calendar(coordinate: xarray.DataArray) -> bool:
    """Return True for times of climate models' calendars, and those before 1678: cftime's."""
    values = coordinate.values if coordinate.dtype.kind == "O" else np.empty(0)
    return values.size > 0 and hasattr(values.flat[0], "calendar")


def dims_of(
    data: xarray.Dataset, array: xarray.DataArray, options: Mapping[str, Any]
) -> tuple[str, ...]:
    """Return the dimensions of an array along x, y and z."""
    sizes = {str(dim): int(n) for dim, n in array.sizes.items()}
    dims = options.get("dims")
    if dims is None:
        return _spatial_dims(sizes, {dim: axis_in(data, dim) for dim in sizes})
    names = [dims.get(axis) for axis in AXES] if isinstance(dims, Mapping) else dims
    listed = [str(n) for n in names if n is not None] if isinstance(names, (list, tuple)) else []
    if len(listed) != 3 or len(set(listed)) != 3:
        raise InputError(
            f"dims must name the dimensions along x, y and z, such as {tuple(sizes)[-3:][::-1]}, "
            f"got {dims!r}"
        )
    for name in listed:
        if name not in sizes:
            raise unknown_name("dimension", name, sizes)
    return _spatial_dims(sizes, {d: AXES[listed.index(d)] if d in listed else "" for d in sizes})


def _spatial_dims(sizes: Mapping[str, int], axes: Mapping[str, str]) -> tuple[str, ...]:
    """Return the dimensions along x, y and z by the axis that each stands for, or "".

    Where there are more than three, those of length one that are no axes of space are left out.
    Unknown ones get the axes that are left, in their order.
    """
    kept = list(sizes)
    listed = ", ".join(f"{dim}: {n}" for dim, n in sizes.items())
    for rank in ("t", ""):
        single = [dim for dim in kept if sizes[dim] == 1 and axes[dim] == rank]
        for dim in single[: max(0, len(kept) - 3)]:
            kept.remove(dim)
    if len(kept) < 3:
        raise InputError(f"expected three dimensions, got ({listed})")
    if len(kept) > 3:
        extra = [d for d in kept if axes[d] == "t"] or [d for d in kept if not axes[d]] or [kept[0]]
        chosen = extra[: len(kept) - 3]
        raise InputError(
            f"expected three dimensions, got ({listed}); choose one of "
            f"{' and one of '.join(chosen)} with "
            f"isel={{{', '.join(f'{dim!r}: 0' for dim in chosen)}}} (by number; on the command "
            f"line --set 'isel={{{', '.join(f'{dim}=0' for dim in chosen)}}}') or "
            f"sel={{{chosen[0]!r}: …}} (by value)"
        )
    by_axis = {axes[dim]: dim for dim in reversed(kept) if axes[dim] in tuple(AXES)}
    rest = [dim for dim in kept if dim not in by_axis.values()]
    ordered = tuple(by_axis[axis] if axis in by_axis else rest.pop(0) for axis in AXES)
    if "t" in (axes[dim] for dim in ordered):
        raise InputError(
            f"({listed}) are not three dimensions of space; to take the time for one, say "
            f"dims={ordered}"
        )
    return ordered


def _line(data: xarray.Dataset, dim: str, upright: bool) -> Line:
    """Return the axis of a dimension; if it is upright, what grows downwards is turned around."""
    count = int(data.sizes[dim])
    of_calendar = dim in data.coords and _of_calendar(data.coords[dim])
    if dim not in data.coords or not (of_calendar or data.coords[dim].dtype.kind in "fiumM"):
        return Line(dim, np.arange(count + 1.0), counted=True)
    coordinate = data.coords[dim]
    values, unit = plain_values(coordinate), unit_in(coordinate)
    if of_calendar:
        values = (values - values[0]).astype("timedelta64[us]")
    if values.dtype.kind in "mM":
        values, unit = (values - values[0]) / np.timedelta64(1, "h"), "h"
    positive = str(coordinate.attrs.get("positive", "")).lower()
    down = upright and (positive == "down" or (positive != "up" and unit in _PRESSURES))
    values = (-1.0 if down else 1.0) * values.astype(np.float64)
    edges = _bounded(data, coordinate, down)
    flipped = count > 1 and bool(values[0] > values[-1])
    if edges is None:
        ordered = values[::-1] if flipped else values
        if not np.all(np.isfinite(values)) or np.any(np.diff(ordered) <= 0):
            raise InputError(
                f"the coordinate {dim!r} must ascend or descend strictly: sort the data with "
                f".sortby({dim!r}) or leave the coordinate out with .drop_vars({dim!r}) and count "
                "cells"
            )
        edges = edges_of_centers(ordered)
    return Line(dim, edges, unit, flipped, down=down)


def _bounded(data: xarray.Dataset, coordinate: xarray.DataArray, down: bool) -> np.ndarray | None:
    """Return the edges given by CF cell bounds; None if adjacent cells do not share them."""
    name = coordinate.attrs.get("bounds") or coordinate.encoding.get("bounds")
    if name not in data.variables or data[name].shape != (coordinate.size, 2):
        return None
    pairs = data[name].values
    if pairs.dtype.kind not in "fiu":
        return None
    pairs = np.sort((-1.0 if down else 1.0) * pairs.astype(np.float64), axis=1)
    pairs = pairs[::-1] if pairs[0, 0] > pairs[-1, 0] else pairs
    edges = np.append(pairs[:, 0], pairs[-1, 1])
    joined = np.allclose(pairs[1:, 0], pairs[:-1, 1], rtol=0, atol=1e-6 * np.ptp(edges))
    return edges if joined and np.all(np.diff(edges) > 0) else None


def unit_in(array: xarray.DataArray) -> str:
    """Return the unit of an array's values, or of its attributes as far as astropy knows it."""
    held = array.variable._data  # `data` would read a file
    written = str(getattr(held, "units", getattr(held, "unit", "")))  # pint, unyt, astropy
    if written in ("", "dimensionless"):
        return known_unit(str(array.attrs.get("units", array.attrs.get("unit", ""))))
    unit = known_unit(written)
    if not unit:
        raise UnitsError(f"{array.name} has values in {written!r}, which astropy does not know")
    return unit


def plain_values(array: xarray.DataArray) -> np.ndarray:
    """Return the values without the unit that pint and similar libraries attach."""
    held = array.data
    return np.asarray(getattr(held, "magnitude", held))


def _grid(lines: Sequence[Line], options: Mapping[str, Any]) -> CartesianGrid:
    """Return the grid of three axes.

    Coordinates are kept if they are all lengths, all of one unit, or all without one. Else those
    of a common unit are kept as plain numbers, and any other is fitted into the shortest side; a
    warning says so. The option `aspect` fits all into a box of these sides.
    """
    from ...grids import CartesianGrid

    given = [k for k in ("bounds", "spacing", "aspect") if options.get(k) is not None]
    if len(given) > 1:
        raise InputError(f"give one of bounds, spacing and aspect, not {' and '.join(given)}")
    unit, aspect = options.get("unit"), options.get("aspect")
    if aspect is not None:
        sides = np.asarray(aspect, np.float64) if np.shape(aspect) == (3,) else np.zeros(3)
        if not (np.all(sides > 0) and np.all(np.isfinite(sides))):
            raise InputError(
                "aspect must be three positive lengths of the sides along x, y and z, got "
                f"{aspect!r}"
            )
        fitted = (line.fitted(side) for line, side in zip(lines, sides.tolist(), strict=True))
        return CartesianGrid(*fitted, unit=unit)
    if given:
        return equal_cells(tuple(len(line.edges) - 1 for line in lines), options, unit)
    if len({line.kind for line in lines}) > 1:
        return CartesianGrid(*_mixed(lines), unit=unit)
    if unit is not None:
        return CartesianGrid(*(line.edges for line in lines), unit=unit)
    return CartesianGrid(*(line.quantity() for line in lines))


def _mixed(lines: Sequence[Line]) -> list[np.ndarray]:
    """Return edges along axes of different kinds; warns that their proportions are made up."""
    kinds = [line.kind for line in lines]
    common = max(kinds, key=kinds.count)
    kept, side = [kind == common and kinds.count(common) > 1 for kind in kinds], 1.0
    if any(kept):
        unit = parse_unit(lines[kept.index(True)].unit)
        if unit is not None:
            lines = [
                replace(line, edges=line.quantity().to_value(unit), unit=str(unit)) if k else line
                for line, k in zip(lines, kept, strict=True)
            ]
        side = min(float(np.ptp(line.edges)) for line, k in zip(lines, kept, strict=True) if k)
    listed = ", ".join(
        f"{axis} = {line.dim}: {line.unit or ('cells counted' if line.counted else 'no unit')}"
        for axis, line in zip(AXES, lines, strict=True)
    )
    fitted = " and ".join(axis for axis, k in zip(AXES, kept, strict=True) if not k)
    warnings.warn(
        f"the coordinates are of different kinds ({listed}): {fitted} "
        f"{'is' if any(kept) else 'are'} fitted into {side:g}, which is no physical length; give "
        "aspect=(…) for a box of other sides, or bounds=… or spacing=… for lengths",
        stacklevel=2,
    )
    return [line.edges if k else line.fitted(side) for line, k in zip(lines, kept, strict=True)]
