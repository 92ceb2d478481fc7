"""Conversion of xarray data to volumes; base class of readers of named dimensions."""

from __future__ import annotations

import functools
import re
import warnings
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...deferred import Deferred, Pieces
from ...errors import InputError, how_to_take
from ...packages import require
from ..contract import FieldInfo, Reader
from ..names import chosen_fields, field_name
from .layout import OPTIONS, NamedLayout, axis_in, dims_of, layout_of, selected, unit_in

if TYPE_CHECKING:
    import xarray

    from ...volume import Volume

# Fields up to this size are read immediately.
AT_ONCE = 256 << 20
# Attributes of variables that were opened without being decoded (CF conventions 2.5.1 and 8.1).
_PACKED = {"scale_factor", "add_offset", "_FillValue", "missing_value"}
# Attributes by which variables name others that describe them (CF conventions, appendix A).
_HELPERS = (
    *("ancillary_variables", "cell_measures", "coordinates", "formula_terms", "grid_mapping"),
    "quantization",
)
_EDGES = ("bounds", "cell_bounds", "climatology")
# Dimensions along which the corners of a cell lie, of which there are at most eight.
_CORNERS = re.compile(
    r"(axis_)?n?_?(bnds?|bounds?|corners?|vert(s|ex|ices)?)|[a-z]*_(bnds|bounds|vertices)|nvp?\d?",
    re.IGNORECASE,
)


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
        that up is up. ``volume.meta["axes"]`` says what x, y and z are, and `meta` has the other
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
    >>> vm.Volume.from_xarray(cube).grid.shape
    (4, 3, 2)
    """
    options = {"dims": dims, "isel": isel, "sel": sel, "bounds": bounds, "spacing": spacing}
    options |= {"aspect": aspect, "unit": unit}
    part = selected(_as_dataset(data), options)

    def reader_of(layout: NamedLayout, place: str) -> tuple[Callable[[], np.ndarray], Any]:
        return functools.partial(layout.values, part[place]), functools.partial(
            layout.part, part[place]
        )

    volume = _volume(part, fields, options, reader_of)
    return volume.load() if volume.bytes_waiting <= AT_ONCE else volume


def _as_dataset(data: Any) -> Any:
    xarray = require("xarray", "arrays", "from_xarray")
    if isinstance(data, xarray.Dataset):
        every = [*data.dims, *data.variables]
        names = {name: str(name) for name in every if not isinstance(name, str)}
        if set(names.values()) & set(every):
            raise InputError(f"names differ by their types only: {every}; rename some")
        data = data.rename(names)
        packed = any(_PACKED & variable.attrs.keys() for variable in data.variables.values())
        # A copy: decoding takes attributes away from what it is given.
        if packed:
            data = xarray.decode_cf(data.copy(), False, decode_times=False)
        return data
    if not isinstance(data, xarray.DataArray):
        raise InputError(
            f"from_xarray takes an xarray.DataArray or Dataset, got {type(data).__name__}"
            + how_to_take(data)
        )
    name = str(data.name or "data")
    taken = name in data.coords or name in data.dims
    return _as_dataset(data.rename(None).to_dataset(name=f"{name}_" if taken else name))


def _volume(
    data: xarray.Dataset,
    fields: Any,
    options: Mapping[str, Any],
    reader_of: Callable[[NamedLayout, str], tuple[Callable[[], np.ndarray], Any]],
) -> Volume:
    """Return the volume of a data set; `reader_of` gives what reads a variable, and a box of it."""
    from ...volume import Volume

    chosen = _chosen(data, fields)
    places = list(chosen.values())
    dims = []
    for place in places:
        array = data[place]
        if array.dtype.kind not in "fiub":
            parts = "; give its real and imaginary parts" if array.dtype.kind == "c" else ""
            raise InputError(f"{place!r} must be real numbers, got dtype {array.dtype}{parts}")
        if 0 in array.shape:
            raise InputError(f"{_described(data, place)} has no cells")
        dims.append(set(dims_of(data, array, options)))
        if dims[-1] != dims[0]:
            raise InputError(
                "fields must lie on the same three dimensions, got "
                f"{_described(data, places[0])} and {_described(data, place)}; choose some of one "
                "kind with fields=[…]"
            )
    layout = layout_of(data, data[places[0]], options)
    volume = Volume(layout.grid)
    for name, place in chosen.items():
        array = data[place]
        load, part = reader_of(layout, place)
        pieces = Pieces(part, layout.chunks(array))
        volume[name] = Deferred(load, array.dtype, unit_in(array), pieces=pieces)
    for key, coordinate in data.coords.items():
        single = coordinate.size == 1 and not set(coordinate.dims) & set(layout.dims)
        if single and coordinate.dtype.kind in "fiubMmUSO":
            value = coordinate.values.reshape(-1)[0]
            is_plain = isinstance(value, np.generic) and value.dtype.kind not in "mM"
            volume.meta[str(key)] = value.item() if is_plain else str(value)
    volume.meta["axes"] = {a: line.described() for a, line in zip("xyz", layout.lines, strict=True)}
    return volume


def _name(variable: str) -> str:
    """Return a name that expressions can use: a slash is part of a unit here, not of a path."""
    return field_name(variable.replace("/", "_"))


def _described(data: xarray.Dataset, place: str) -> str:
    return f"{place} ({', '.join(f'{dim}: {n}' for dim, n in data[place].sizes.items())})"


def _variables(data: xarray.Dataset) -> dict[str, xarray.DataArray]:
    edges = _named_by(data, _EDGES)
    result = {
        str(name): array
        for name, array in data.data_vars.items()
        if array.ndim >= 3 and array.dtype.kind in "fiub" and name not in edges
        if not any(n <= 8 and _CORNERS.fullmatch(str(dim)) for dim, n in array.sizes.items())
    }
    helpers = _named_by(data, _HELPERS)
    return {name: array for name, array in result.items() if name not in helpers} or result


def _named_by(data: xarray.Dataset, keys: tuple[str, ...]) -> set[str]:
    attributes = [of for v in data.variables.values() for of in (v.attrs, v.encoding)]
    return {word for of in attributes for key in keys for word in str(of.get(key, "")).split()}


def decoded(source: Any, **options: Any) -> Any:
    """Open a data set; times that no calendar tells are numbers."""
    xarray = require("xarray", "arrays", "reading arrays with named dimensions")
    options |= {"cache": False}  # memory is taken by the volume only
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", xarray.SerializationWarning)  # of early dates
        try:
            return xarray.open_dataset(source, decode_timedelta=False, **options)
        except (ValueError, OverflowError, ImportError):
            return xarray.open_dataset(source, decode_times=False, **options)


def _chosen(data: xarray.Dataset, fields: Any) -> dict[str, str]:
    """Return name → variable of what is asked for, or of all on the same dimensions as most."""
    if fields is not None:
        names = {str(name): _name(str(name)) for name in data.variables}
        return chosen_fields(names, fields, "variable")
    variables = _variables(data)
    if not variables:
        raise InputError(
            "expected a variable of three dimensions and of numbers; there are "
            + (", ".join(_described(data, str(name)) for name in data.data_vars) or "none")
        )
    groups: dict[frozenset[str], list[str]] = {}
    for place, array in variables.items():
        long = frozenset(str(dim) for dim, n in array.sizes.items() if n > 1)
        extent = long if len(long) >= 3 else frozenset(map(str, array.dims))
        groups.setdefault(extent, []).append(place)

    def rank(dims: frozenset[str]) -> tuple[bool, int]:
        return sum(axis_in(data, dim) != "t" for dim in dims) >= 3, len(groups[dims])

    main = groups[max(groups, key=rank)]
    left = [_described(data, p) for group in groups.values() if group is not main for p in group]
    if left:
        warnings.warn(
            f"left out, since they lie on other dimensions than {main[0]}: {', '.join(left)}; "
            "choose them with fields=…",
            stacklevel=2,
        )
    return chosen_fields({place: _name(place) for place in main}, None)


class LabelledReader(Reader):
    """Variables on coordinates, opened by xarray; a format has to provide `dataset`."""

    options = {  # noqa: RUF012 - as in Reader
        **OPTIONS,
        "group": "the group in the file; by default the outermost",
    }
    packages: tuple[str, ...] = ("xarray",)
    extra = "arrays"

    def dataset(self, path: Path, group: Any) -> AbstractContextManager[xarray.Dataset]:
        """Return a context that gives what is in a group, decoded but not read."""
        raise NotImplementedError

    def read(self, path: Path, fields: Any = None, **options: Any) -> Volume:
        group = options.pop("group", None)
        held: list[xarray.Dataset] = []  # the data while they are open

        def reader_of(layout: NamedLayout, place: str) -> tuple[Callable[[], np.ndarray], Any]:
            taken = functools.partial(self._taken, held, path, group, options, place)
            return functools.partial(taken, layout.values), functools.partial(taken, layout.part)

        with self.dataset(path, group) as data:
            held.append(selected(data, options))
            volume = _volume(held[0], fields, options, reader_of)
            if volume.bytes_waiting <= AT_ONCE:
                volume.load()  # opening the file again for each field would take longer
            held.clear()
        return volume

    def _taken(
        self,
        held: list[xarray.Dataset],
        path: Path,
        group: Any,
        options: Mapping[str, Any],
        place: str,
        take: Callable[..., np.ndarray],
        *box: Any,
    ) -> np.ndarray:
        """Return what `take` makes of a variable."""
        if held:
            return take(held[0][place], *box)
        with self.dataset(path, group) as data:
            values = take(selected(data, options)[place], *box)
            return np.array(values) if box else values

    def info(self, path: Path, **options: Any) -> tuple[FieldInfo, ...]:
        with self.dataset(path, options.get("group")) as data:
            return tuple(
                FieldInfo(_name(place), place, array.shape, str(array.dtype), unit_in(array))
                for place, array in _variables(data).items()
            )
