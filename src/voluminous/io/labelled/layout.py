"""How arrays with named dimensions become fields: which part, in which order, on which grid."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import InputError, unknown_name
from ..axis_names import AXES, axis_of
from .axes import checked_dims, spatial_dims
from .box import grid_of
from .lines import Line, line_of, plain_values

if TYPE_CHECKING:
    import xarray

    from ...grids import CartesianGrid

# Which part of the data, beside what says where the cells are.
OPTIONS = {
    "dims": "the dimensions along x, y and z, if they do not tell: ('lon', 'lat', 'lev')",
    "isel": "which part of other dimensions, by number: {'time': 0}; slices cut a part out",
    "sel": "the same by the value of the coordinate: {'time': '2001-01-31'}",
}


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
    """Return the part of a data set that `isel` and `sel` name.

    Raises
    ------
    UnknownNameError
        If there is no such dimension.
    InputError
        If there is no such entry along it; names the nearest.
    """
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
    """Return where an array lies.

    Parameters
    ----------
    data : Dataset
        Where the coordinates are; the part that is `selected`.
    array : DataArray
        One of the fields.
    options : mapping
        ``dims``, ``bounds``, ``spacing``, ``aspect`` and ``unit``.
    """
    names = dims_of(data, array, options)
    lines = tuple(line_of(data, n, axis == "z") for n, axis in zip(names, AXES, strict=True))
    return Layout(lines, grid_of(lines, options))


def dims_of(
    data: xarray.Dataset, array: xarray.DataArray, options: Mapping[str, Any]
) -> tuple[str, ...]:
    """Return the dimensions of an array along x, y and z.

    Raises
    ------
    InputError
        If there are others, of more than one entry.
    """
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
