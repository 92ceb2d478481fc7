"""From xarray to volumes."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ...deferred import Deferred
from ...errors import InputError, how_to_take
from ...packages import require
from .layout import Layout, layout_of, selected
from .lines import unit_in
from .variables import check_same, check_variable, chosen_variables

if TYPE_CHECKING:
    import xarray

    from ...volume import Volume

# Fields that take no more are read at once.
AT_ONCE = 256 << 20
# Attributes of variables that were opened without being decoded (CF conventions 2.5.1 and 8.1).
_PACKED = {"scale_factor", "add_offset", "_FillValue", "missing_value"}


def from_xarray(
    data: Any,
    fields: Any = None,
    *,
    dims: Any = None,
    isel: Mapping[str, Any] | None = None,
    sel: Mapping[str, Any] | None = None,
    bounds: Any = None,
    spacing: Any = None,
    aspect: Any = None,
    unit: Any = None,
) -> Volume:
    """Return the volume in an array with named dimensions, or in a set of them.

    Parameters
    ----------
    data : xarray.DataArray or xarray.Dataset
        In memory, in a file or in pieces (dask): what takes more than 256 MiB is read or computed
        when it is first used.
    fields : None, str, sequence of str or dict, optional
        Which variables of a data set: all that lie on the same three dimensions, one, several, or
        ``{name: variable}``.
    dims : three str, or dict, optional
        The dimensions along x, y and z. By default the coordinates' CF attributes tell (`axis`,
        `standard_name`, `positive`, `units`), else the names of the dimensions, else their order,
        x first. Others must be of length one.
    isel, sel : dict, optional
        Part of the data, by number or by value of the coordinate: ``isel={"time": 0}``.
    bounds, spacing, aspect : optional
        Where the cells are, in place of the coordinates: the ends of a grid of equal cells, their
        widths, or the sides of a box that the coordinates are fitted into.
    unit : str or unit, optional
        Unit of length; by default that of the coordinates.

    Returns
    -------
    Volume
        Coordinates are cell centres: edges are in the middle between them, or where CF's bounds
        say. Axes ascend; heights that are counted downwards (depths, pressures) are negative, so
        that up is up. ``volume.meta["axes"]`` tells what x, y and z are, and `meta` has the other
        coordinates that have one value. Missing values are NaN; integers stay integers.

    Raises
    ------
    InputError
        If there are no three dimensions, or others of more than one entry; says what to choose.
    UnknownNameError
        If there is no such variable or dimension.

    Warns
    -----
    UserWarning
        If the coordinates are no three lengths (angles and heights, say): such a grid has no
        physical proportions. If variables are left out since they lie on other dimensions.

    Notes
    -----
    Attributes and names are those of the CF conventions, https://cfconventions.org.

    Examples
    --------
    >>> import numpy as np, xarray as xr, voluminous as vm
    >>> cube = xr.DataArray(np.ones((2, 3, 4)), dims=("z", "y", "x"), name="rho")
    >>> vm.from_xarray(cube).grid.shape
    (4, 3, 2)
    """
    options = {
        "dims": dims,
        "isel": isel,
        "sel": sel,
        "bounds": bounds,
        "spacing": spacing,
        "aspect": aspect,
        "unit": unit,
    }
    whole = as_dataset(data)
    part = selected(whole, options)

    def reader_of(layout: Layout, place: str) -> Callable[[], np.ndarray]:
        return functools.partial(layout.values, part[place])

    volume = volume_of(part, fields, options, reader_of)
    return volume.load() if volume.bytes_waiting <= AT_ONCE else volume


def as_dataset(data: Any) -> xarray.Dataset:
    """Return an array as a set of one.

    Raises
    ------
    InputError
        If it is neither.
    """
    xarray = require("xarray", "arrays", "from_xarray")
    if isinstance(data, xarray.Dataset):
        packed = any(_PACKED & variable.attrs.keys() for variable in data.variables.values())
        # A copy: decoding takes attributes away from what it is given.
        return xarray.decode_cf(data.copy(), False, decode_times=False) if packed else data
    if not isinstance(data, xarray.DataArray):
        raise InputError(
            f"from_xarray takes an xarray.DataArray or Dataset, got {type(data).__name__}"
            + how_to_take(data)
        )
    name = str(data.name or "data")
    taken = name in data.coords or name in data.dims
    return as_dataset(data.rename(None).to_dataset(name=f"{name}_" if taken else name))


def volume_of(
    data: xarray.Dataset,
    fields: Any,
    options: Mapping[str, Any],
    reader_of: Callable[[Layout, str], Callable[[], np.ndarray]],
) -> Volume:
    """Return the volume of (a part of) a data set.

    Parameters
    ----------
    data : Dataset
        The part that is `selected`.
    fields : None, str, sequence of str or dict
        As for `from_xarray`.
    options : mapping
        As for `layout_of`.
    reader_of : callable
        Gives, for the layout and the name of a variable, what reads it.
    """
    from ...volume import Volume

    chosen = chosen_variables(data, fields)
    places = list(chosen.values())
    for place in places:
        check_variable(data[place], place)
    layout = layout_of(data, data[places[0]], options)
    for place in places[1:]:
        check_same(data, places[0], place, options)
    volume = Volume(layout.grid)
    for name, place in chosen.items():
        array = data[place]
        volume[name] = Deferred(reader_of(layout, place), array.dtype, unit_in(array))
    volume.meta |= _meta(data, layout)
    return volume


def _meta(data: xarray.Dataset, layout: Layout) -> dict[str, Any]:
    told: dict[str, Any] = {}
    for name, coordinate in data.coords.items():
        single = coordinate.size == 1 and not set(coordinate.dims) & set(layout.dims)
        if single and coordinate.dtype.kind in "fiubMmUSO":
            told[str(name)] = _plain(coordinate.values.reshape(-1)[0])
    return {**told, "axes": layout.described()}


def _plain(value: Any) -> Any:
    if isinstance(value, (np.datetime64, np.timedelta64)):
        return str(value)
    return value.item() if isinstance(value, np.generic) else str(value)
