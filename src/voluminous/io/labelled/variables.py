"""Which variables of a data set are fields, and which of them a user asks for."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from ...errors import InputError
from ..contract import FieldInfo
from ..names import chosen_fields, field_name
from .layout import axis_in, dims_of
from .lines import unit_in

if TYPE_CHECKING:
    import xarray


def infos(data: xarray.Dataset) -> tuple[FieldInfo, ...]:
    """Return all variables of three dimensions or more."""
    return tuple(
        FieldInfo(_name(place), place, array.shape, str(array.dtype), unit_in(array))
        for place, array in _variables(data).items()
    )


def _name(variable: str) -> str:
    """Return a name that expressions can use: a slash is part of a unit here, not of a path."""
    return field_name(variable.replace("/", "_"))


# Attributes by which variables name others that describe them (CF conventions, appendix A).
_HELPERS = (
    *("ancillary_variables", "bounds", "cell_measures", "climatology", "coordinates"),
    *("formula_terms", "grid_mapping", "quantization"),
)


def _variables(data: xarray.Dataset) -> dict[str, xarray.DataArray]:
    """Return the variables that can be fields, without those that only describe others."""
    found = {
        str(name): array
        for name, array in data.data_vars.items()
        if array.ndim >= 3 and array.dtype.kind in "fiub"
    }
    helpers = _helpers(data)
    return {name: array for name, array in found.items() if name not in helpers} or found


def _helpers(data: xarray.Dataset) -> set[str]:
    """Return the variables that others name in their attributes: ``"area: cell_area"``."""
    texts = (
        str(attributes.get(key, ""))
        for variable in data.variables.values()
        for attributes in (variable.attrs, variable.encoding)
        for key in _HELPERS
    )
    return {word for text in texts for word in text.split() if not word.endswith(":")}


def chosen_variables(data: xarray.Dataset, fields: Any) -> dict[str, str]:
    """Return name → variable of what is asked for, or of all on the same dimensions as most.

    Raises
    ------
    InputError
        If there is none; says what there is.
    UnknownNameError
        If there is none of a name.
    """
    if fields is not None:
        known = {str(name): _name(str(name)) for name in data.variables}
        return chosen_fields(known, fields, "variable")
    variables = _variables(data)
    if not variables:
        raise InputError(
            "expected a variable of three dimensions and of numbers; there are "
            + (", ".join(_told(str(n), a) for n, a in data.data_vars.items()) or "none")
        )
    groups: dict[frozenset[str], list[str]] = {}
    for place, array in variables.items():
        groups.setdefault(_extent(array), []).append(place)
    main = max(groups, key=lambda dims: (_spatial(data, dims) >= 3, len(groups[dims])))
    left = [_told(p, variables[p]) for dims, g in groups.items() for p in g if dims != main]
    if left:
        warnings.warn(
            f"left out, since they lie on other dimensions than {groups[main][0]}: "
            f"{', '.join(left)}; choose them with fields=…",
            stacklevel=2,
        )
    return chosen_fields({place: _name(place) for place in groups[main]}, None)


def _extent(array: xarray.DataArray) -> frozenset[str]:
    """Return the dimensions that count; all of them if that leaves fewer than three."""
    long = frozenset(str(dim) for dim, n in array.sizes.items() if n > 1)
    return long if len(long) >= 3 else frozenset(str(dim) for dim in array.dims)


def _spatial(data: xarray.Dataset, dims: frozenset[str]) -> int:
    return sum(axis_in(data, dim) != "t" for dim in dims)


def check_variable(array: xarray.DataArray, place: str) -> None:
    """Check that a variable can be a field.

    Raises
    ------
    InputError
        If it is not of real numbers, or has no cells.
    """
    if array.dtype.kind not in "fiub":
        parts = "; give its real and imaginary parts" if array.dtype.kind == "c" else ""
        raise InputError(f"{place!r} must be real numbers, got dtype {array.dtype}{parts}")
    if 0 in array.shape:
        raise InputError(f"{_told(place, array)} has no cells")


def _told(place: str, array: xarray.DataArray) -> str:
    return f"{place} ({', '.join(f'{dim}: {n}' for dim, n in array.sizes.items())})"


def check_same(data: xarray.Dataset, first: str, place: str, options: Mapping[str, Any]) -> None:
    """Check that a field lies where the first does.

    Raises
    ------
    InputError
        If it has other dimensions.
    """
    mine, other = (set(dims_of(data, data[name], options)) for name in (place, first))
    if mine != other:
        raise InputError(
            f"fields must lie on the same three dimensions, got {_told(first, data[first])} and "
            f"{_told(place, data[place])}; choose some of one kind with fields=[…]"
        )
