"""How arrays with named dimensions become fields: which part, in which order, on which grid."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import InputError, UnitsError, unknown_name
from ...units import parse_unit
from ..arrays.layout import equal_cells
from ..axis_names import AXES, axis_of
from ..edges import edges_of_centers
from ..unit_texts import known_unit

if TYPE_CHECKING:
    import xarray

    from ...grids import CartesianGrid
# Which part of the data, and where its cells are.
OPTIONS = {
    "dims": "the dimensions along x, y and z, if they do not tell: ('lon', 'lat', 'lev')",
    "isel": "which part of other dimensions, by number: {'time': 0}; slices cut a part out",
    "sel": "the same by the value of the coordinate: {'time': '2001-01-31'}",
    "bounds": "(low, high) or ((x0, x1), (y0, y1), (z0, z1)) of a grid of equal cells, in place of "
    "the coordinates",
    "spacing": "cell width, or one per axis, of a grid that starts at 0, in place of coordinates",
    "aspect": "lengths of the sides of the box (x, y, z) that coordinates of different kinds, such "
    "as angles and pressures, are fitted into",
    "unit": "unit of length",
}


def checked_dims(dims: Any, there: Sequence[str]) -> tuple[str, ...]:
    """Return the dimensions that a user names for x, y and z."""
    names = [dims.get(axis) for axis in AXES] if isinstance(dims, Mapping) else dims
    listed = list(names) if isinstance(names, (list, tuple)) else []
    if len(listed) != 3 or len({str(name) for name in listed}) != 3:
        raise InputError(
            f"dims must name the dimensions along x, y and z, such as {tuple(there)[-3:][::-1]}, "
            f"got {dims!r}"
        )
    for name in listed:
        if name not in there:
            raise unknown_name("dimension", str(name), there)
    return tuple(listed)


def spatial_dims(sizes: Mapping[str, int], axes: Mapping[str, str]) -> tuple[str, ...]:
    """Return the dimensions of an array along x, y and z.

    Where there are more than three, those of length one that are no axes of space are left out.
    Dimensions that do not tell what they are get the axes that are left, in their order.
    """
    kept = list(sizes)
    for rank in ("t", ""):
        single = [dim for dim in kept if sizes[dim] == 1 and axes[dim] == rank]
        for dim in single[: max(0, len(kept) - 3)]:
            kept.remove(dim)
    if len(kept) != 3:
        raise InputError(_told(sizes, kept, axes))
    ordered = _ordered(kept, axes)
    if "t" in (axes[dim] for dim in ordered):
        raise InputError(
            f"({_listed(sizes)}) are not three dimensions of space; to take the time for one, say "
            f"dims={ordered}"
        )
    return ordered


def _ordered(dims: Sequence[str], axes: Mapping[str, str]) -> tuple[str, ...]:
    found: dict[str, str] = {}
    for dim in dims:
        if axes[dim] in tuple(AXES):
            found.setdefault(axes[dim], dim)
    rest = [dim for dim in dims if dim not in found.values()]
    return tuple(found[axis] if axis in found else rest.pop(0) for axis in AXES)


def _told(sizes: Mapping[str, int], kept: Sequence[str], axes: Mapping[str, str]) -> str:
    if len(kept) < 3:
        return f"expected three dimensions, got ({_listed(sizes)})"
    extra = [d for d in kept if axes[d] == "t"] or [d for d in kept if not axes[d]] or [kept[0]]
    chosen = extra[: len(kept) - 3]
    first = ", ".join(f"{dim!r}: 0" for dim in chosen)
    typed = ", ".join(f"{dim}=0" for dim in chosen)
    return (
        f"expected three dimensions, got ({_listed(sizes)}); choose one of "
        f"{' and one of '.join(chosen)} with isel={{{first}}} (by number; on the command line "
        f"--set 'isel={{{typed}}}') or sel={{{chosen[0]!r}: …}} (by value)"
    )


def _listed(sizes: Mapping[str, int]) -> str:
    return ", ".join(f"{dim}: {n}" for dim, n in sizes.items())


# Pressure grows downwards, whether or not its coordinate says so (CF conventions 4.3.1).
_PRESSURES = ("Pa", "hPa", "mbar", "dbar", "kPa", "bar")


@dataclass(frozen=True)
class Line:
    """One axis of a grid."""

    dim: str  # its dimension
    edges: np.ndarray  # of the cells, ascending; negative depths or pressures where `down`
    unit: str = ""  # astropy's name, empty where there is none
    flipped: bool = False  # true if values come in the opposite order
    counted: bool = False  # true if there is no coordinate, and cells are counted
    down: bool = False  # true if the coordinate grows downwards

    @property
    def cells(self) -> int:
        """Number of cells."""
        return len(self.edges) - 1

    def described(self) -> dict[str, Any]:
        """Return name, unit and ends as plain values, as they are in the data."""
        ends = [float(self.edges[0]), float(self.edges[-1])]
        first, last = [-end for end in ends] if self.down else ends
        return {"name": self.dim, "unit": self.unit, "from": first, "to": last}


def line_of(data: xarray.Dataset, dim: str, upright: bool = False) -> Line:
    """Return the axis of a dimension."""
    count = int(data.sizes[dim])
    if dim not in data.coords or data.coords[dim].dtype.kind not in "fiumM":
        return Line(dim, np.arange(count + 1.0), counted=True)
    coordinate = data.coords[dim]
    attributes = coordinate.attrs
    values, unit = _numbers(plain_values(coordinate), unit_in(coordinate))
    told = str(attributes.get("positive", "")).lower()
    down = upright and (told == "down" or (told != "up" and unit in _PRESSURES))
    sign = -1.0 if down else 1.0
    edges = _bounded(data, coordinate, sign, values)
    if edges is None:
        edges = edges_of_centers(_ascending(dim, sign * values))
    flipped = count > 1 and bool(sign * values[0] > sign * values[-1])
    return Line(dim, edges, unit, flipped, down=down)


def unit_in(array: xarray.DataArray) -> str:
    """Return the unit of an array, or of its attributes as far as astropy knows it."""
    held = array.variable._data  # `data` would read a file
    own = str(getattr(held, "units", getattr(held, "unit", "")))
    if own not in ("", "dimensionless"):
        unit = known_unit(own)
        if not unit:
            raise UnitsError(f"{array.name} has values in {own!r}, which astropy does not know")
        return unit
    return known_unit(str(array.attrs.get("units", array.attrs.get("unit", ""))))


def plain_values(array: xarray.DataArray) -> np.ndarray:
    """Return the values without the unit that pint and others keep with them."""
    held = array.data
    return np.asarray(getattr(held, "magnitude", held))


def _numbers(values: np.ndarray, unit: str) -> tuple[np.ndarray, str]:
    if values.dtype.kind in "mM":
        return (values - values[0]) / np.timedelta64(1, "h"), "h"
    return values.astype(np.float64), unit


def _ascending(dim: str, values: np.ndarray) -> np.ndarray:
    ordered = values[::-1] if values[0] > values[-1] else values
    if not np.all(np.isfinite(values)) or np.any(np.diff(ordered) <= 0):
        raise InputError(
            f"the coordinate {dim!r} must ascend or descend strictly: sort the data with "
            f".sortby({dim!r}) or leave the coordinate out with .drop_vars({dim!r}) and count cells"
        )
    return ordered


def _bounded(
    data: xarray.Dataset, coordinate: xarray.DataArray, sign: float, centers: np.ndarray
) -> np.ndarray | None:
    """Return the edges that the bounds of cells tell, None where they do not join up."""
    name = coordinate.attrs.get("bounds") or coordinate.encoding.get("bounds")
    if name not in data.variables or data[name].shape != (len(centers), 2):
        return None
    pairs = data[name].values
    if pairs.dtype.kind not in "fiu":
        return None
    pairs = np.sort(sign * pairs.astype(np.float64), axis=1)
    pairs = pairs[::-1] if pairs[0, 0] > pairs[-1, 0] else pairs
    edges = np.append(pairs[:, 0], pairs[-1, 1])
    joined = np.allclose(pairs[1:, 0], pairs[:-1, 1], rtol=0, atol=1e-6 * np.ptp(edges))
    return edges if joined and np.all(np.diff(edges) > 0) else None


def grid_of(lines: Sequence[Line], options: Mapping[str, Any]) -> CartesianGrid:
    """Return the grid of three axes.

    Coordinates are kept if they are all lengths, all of one unit, or all without one. Else those
    of a common unit are kept as plain numbers, and any other is fitted into the shortest side; a
    warning says so. The option `aspect` fits all into a box of these sides.
    """
    from ...grids import CartesianGrid

    given = [k for k in ("bounds", "spacing", "aspect") if options.get(k) is not None]
    if len(given) > 1:
        raise InputError(f"give one of bounds, spacing and aspect, not {' and '.join(given)}")
    unit = options.get("unit")
    if options.get("aspect") is not None:
        sides = _sides(options["aspect"])
        return CartesianGrid(
            *(_fitted(line, side) for line, side in zip(lines, sides, strict=True)), unit=unit
        )
    if given:
        return equal_cells(tuple(line.cells for line in lines), options, unit)
    if len(_units(lines)) > 1:
        return CartesianGrid(*_mixed(lines), unit=unit)
    if unit is not None:
        return CartesianGrid(*(line.edges for line in lines), unit=unit)
    return CartesianGrid(*(_quantity(line) for line in lines))


def _quantity(line: Line) -> Any:
    unit = parse_unit(line.unit)
    return line.edges if unit is None else line.edges * unit


def _units(lines: Sequence[Line]) -> set[str]:
    """Return the kinds of unit of some axes: those that convert into each other are one."""
    return {_kind(line) for line in lines}


def _kind(line: Line) -> str:
    unit = parse_unit(line.unit)
    return "" if unit is None else str(unit.decompose().bases)


def _mixed(lines: Sequence[Line]) -> list[np.ndarray]:
    kinds = [_kind(line) for line in lines]
    common = max(kinds, key=kinds.count)
    if kinds.count(common) == 1:
        sides, kept = (1.0, 1.0, 1.0), [False] * 3
    else:
        kept = [kind == common for kind in kinds]
        lines = _converted(lines, kept)
        shortest = min(float(np.ptp(line.edges)) for line, k in zip(lines, kept, strict=True) if k)
        sides = (shortest,) * 3
    told = ", ".join(_box_told(axis, line) for axis, line in zip(AXES, lines, strict=True))
    fitted = " and ".join(a for a, k in zip(AXES, kept, strict=True) if not k)
    warnings.warn(
        f"the coordinates are of different kinds ({told}): {fitted} {'is' if any(kept) else 'are'} "
        f"fitted into {sides[0]:g}, which is no physical length; give aspect=(…) for a box of "
        "other sides, or bounds=… or spacing=… for lengths",
        stacklevel=2,
    )
    return [
        line.edges if keep else _fitted(line, side)
        for line, keep, side in zip(lines, kept, sides, strict=True)
    ]


def _converted(lines: Sequence[Line], kept: Sequence[bool]) -> list[Line]:
    """Return axes of which those that are kept have the unit of the first of them."""
    unit = parse_unit(next(line.unit for line, keep in zip(lines, kept, strict=True) if keep))
    if unit is None:
        return list(lines)
    return [
        replace(line, edges=_quantity(line).to_value(unit), unit=str(unit)) if keep else line
        for line, keep in zip(lines, kept, strict=True)
    ]


def _box_told(axis: str, line: Line) -> str:
    unit = line.unit or ("cells counted" if line.counted else "no unit")
    return f"{axis} = {line.dim}: {unit}"


def _fitted(line: Line, side: float) -> np.ndarray:
    low, high = line.edges[0], line.edges[-1]
    return np.asarray((line.edges - low) * (side / (high - low)))


def _sides(aspect: Any) -> tuple[float, ...]:
    sides = np.asarray(aspect, np.float64) if np.shape(aspect) == (3,) else np.zeros(3)
    if not (np.all(sides > 0) and np.all(np.isfinite(sides))):
        raise InputError(
            f"aspect must be three positive lengths of the sides along x, y and z, got {aspect!r}"
        )
    return tuple(float(side) for side in sides)


@dataclass(frozen=True)
class Layout:
    """What is the same for all fields: dimensions along x, y, z, and those that run backwards."""

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
        return values.transpose([kept.index(dim) for dim in self.dims])[senses]

    def described(self) -> dict[str, Any]:
        """Return what x, y and z are, as plain values."""
        return {a: line.described() for a, line in zip(AXES, self.lines, strict=True)}


def selected(data: xarray.Dataset, options: Mapping[str, Any]) -> xarray.Dataset:
    """Return the part of a data set that `isel` and `sel` name."""
    for kind in ("isel", "sel"):
        given = options.get(kind) or {}
        if not isinstance(given, Mapping):
            raise InputError(f"{kind} must be {{dimension: entry}}, got {given!r}")
        for dim, entry in given.items():
            if dim not in data.sizes:
                raise unknown_name("dimension", str(dim), [str(d) for d in data.sizes])
            data = _one(data, kind, dim, entry)
    return data


def _one(data: xarray.Dataset, kind: str, dim: str, entry: Any) -> xarray.Dataset:
    try:
        return data.isel({dim: entry}) if kind == "isel" else data.sel({dim: entry})
    except (IndexError, KeyError, TypeError, ValueError) as error:
        count = data.sizes[dim]
        if kind == "isel":
            expected = f"it has {count} entries, 0 … {count - 1}"
        else:
            expected = f"it has {_nearest(data, dim, entry)}"
        raise InputError(f"no {dim} = {entry!r}: {expected}") from error


def _nearest(data: xarray.Dataset, dim: str, entry: Any) -> str:
    """Return the entries of a coordinate that are near to one that is not there."""
    if dim not in data.coords:
        return "no coordinate; choose by number with isel"
    try:
        near = data[dim].sel({dim: entry}, method="nearest").values
    except (KeyError, TypeError, ValueError, NotImplementedError):
        near = None
    values = data[dim].values
    told = f"values {values[0]} … {values[-1]}"
    return told if near is None else f"{told}; the nearest is {near}"


def layout_of(data: xarray.Dataset, array: xarray.DataArray, options: Mapping[str, Any]) -> Layout:
    """Return where an array lies."""
    names = dims_of(data, array, options)
    lines = tuple(line_of(data, n, axis == "z") for n, axis in zip(names, AXES, strict=True))
    return Layout(lines, grid_of(lines, options))


def dims_of(
    data: xarray.Dataset, array: xarray.DataArray, options: Mapping[str, Any]
) -> tuple[str, ...]:
    """Return the dimensions of an array along x, y and z."""
    sizes = {str(dim): int(n) for dim, n in array.sizes.items()}
    if options.get("dims") is None:
        return spatial_dims(sizes, {dim: axis_in(data, dim) for dim in sizes})
    names = checked_dims(options["dims"], tuple(sizes))
    # Those that the user names are the only ones that are known: the error tells of the others.
    return spatial_dims(sizes, {d: AXES[names.index(d)] if d in names else "" for d in sizes})


def axis_in(data: xarray.Dataset, dim: str) -> str:
    """Return what a dimension of a data set is: x, y, z, t or unknown."""
    attributes = data.coords[dim].attrs if dim in data.coords else {}
    is_time = dim in data.coords and data.coords[dim].dtype.kind == "M"
    return "t" if is_time else axis_of(dim, attributes)
