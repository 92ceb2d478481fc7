"""The data that goes in: a grid and the fields on its cells."""

from __future__ import annotations

import keyword
import unicodedata
from collections import OrderedDict
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from .errors import InputError, UnitsError, unknown_name
from .expressions import CONSTANTS, FUNCTIONS, Expression, NumpyOps, UnitOps, check_names
from .units import is_quantity, parse_unit, unit_name

COORDINATES = ("x", "y", "z", "r")
# Cells evaluated at once: temporary arrays stay small beside the fields.
_CHUNK = 1 << 20


class Volume:
    """Fields on the cells of a grid.

    Parameters
    ----------
    grid : grid
        For example a `CartesianGrid`.
    fields : mapping, optional
        Names and arrays, as an alternative to keywords (for names that are no identifiers).
    **named : array_like or Quantity
        Cell-centred arrays of the grid's shape, index ``[ix, iy, iz]``: float32, float64, integer
        or boolean, with or without a unit. A vector is three fields ``velocity_x``, ``velocity_y``,
        ``velocity_z``. Arrays are not copied if they are C-contiguous.

    Raises
    ------
    InputError
        If an array has another shape than the grid, is not real numbers, or a name is reserved.

    Examples
    --------
    >>> import numpy as np, voluminous as vm
    >>> grid = vm.CartesianGrid.uniform(8, (-1, 1))
    >>> volume = vm.Volume(grid, density=np.ones(grid.shape))
    >>> volume["logn"] = "log10(density) + r"
    >>> volume.fields
    ('density', 'logn')
    """

    def __init__(self, grid: Any, fields: Mapping[str, Any] | None = None, **named: Any) -> None:
        self.grid = grid
        self._fields: dict[str, np.ndarray] = {}
        self._units: dict[str, Any] = {}
        # Coefficients tabulated for this volume (see `render.tables`), newest last.
        self.tables: OrderedDict[Any, Any] = OrderedDict()
        for name, value in {**(fields or {}), **named}.items():
            self[name] = value

    @property
    def unit(self) -> Any:
        """Length unit (astropy), or None for dimensionless."""
        return self.grid.unit

    @property
    def fields(self) -> tuple[str, ...]:
        """Names of the fields."""
        return tuple(self._fields)

    @property
    def units(self) -> dict[str, str]:
        """Unit of each field, empty where it has none."""
        return {name: unit_name(unit) for name, unit in self._units.items()}

    def field_unit(self, name: str) -> Any:
        """Return the astropy unit of a field or coordinate, or None."""
        return self.unit if name in COORDINATES and name not in self._fields else self._units[name]

    def array(self, name: str) -> np.ndarray:
        """Return a field as a plain, read-only view, in its own unit.

        Raises
        ------
        UnknownNameError
            If there is no such field.
        """
        if name not in self._fields:
            raise unknown_name("field", name, self._fields)
        view = self._fields[name].view()
        view.setflags(write=False)
        return view

    def __getitem__(self, name: str) -> Any:
        """Return a field: an array, or a Quantity if it has a unit."""
        array = self.array(name)
        unit = self._units[name]
        return array if unit is None else unit_quantity(array, unit)

    def __setitem__(self, name: str, value: Any) -> None:
        """Add or replace a field: an array, a Quantity, or an expression of other fields."""
        name = _check_name(name)
        if isinstance(value, (str, Expression)):
            expression = Expression(value)
            array, unit = self.evaluate(expression), self.expression_unit(expression)
        else:
            unit = parse_unit(value.unit) if is_quantity(value) else None
            array = np.asarray(value.value if is_quantity(value) else value)
        self._fields[name] = _checked(name, array, self.grid.shape)
        self._units[name] = unit
        self.tables.clear()

    def set_unit(self, name: str, unit: Any) -> None:
        """Say which unit a field's plain values are in (values stay as they are)."""
        self.array(name)
        self._units[name] = parse_unit(unit)
        self.tables.clear()

    def __delitem__(self, name: str) -> None:
        self.array(name)
        del self._fields[name], self._units[name]
        self.tables.clear()

    def __contains__(self, name: object) -> bool:
        return name in self._fields

    def __iter__(self) -> Iterator[str]:
        return iter(self._fields)

    def __len__(self) -> int:
        return len(self._fields)

    def evaluate(self, expression: Any) -> np.ndarray:
        """Return an expression of fields and coordinates on all cells, as a plain array.

        Parameters
        ----------
        expression : str or Expression
            May use the coordinates ``x, y, z`` of the cell centres and their distance ``r`` from
            the origin, in the volume's unit.

        Raises
        ------
        UnknownNameError
            If it names a field that does not exist.
        """
        parsed = Expression(expression)
        self.check_names(parsed)
        out: np.ndarray | None = None
        ops = NumpyOps()
        # Whole layers of the first axis at a time.
        step = max(1, _CHUNK // max(1, self.grid.size // self.grid.shape[0]))
        for first in range(0, self.grid.shape[0], step):
            part = slice(first, min(first + step, self.grid.shape[0]))
            values = {name: self._layers(name, part) for name in parsed.names}
            result = np.asarray(parsed.evaluate(ops, values))
            if out is None:
                kind = np.float32 if result.dtype == np.float32 else np.float64
                out = np.empty(self.grid.shape, dtype=kind)
            out[part] = result
        assert out is not None
        return out

    def check_names(self, expression: Expression) -> None:
        """Raise the error that names the nearest field if an expression uses an unknown one."""
        check_names(expression, (*self._fields, *COORDINATES))

    def _layers(self, name: str, part: slice) -> np.ndarray:
        if name in self._fields:
            return self._fields[name][part]
        return coordinate(self.grid.centers, name, part)

    def expression_unit(self, expression: Expression) -> Any:
        """Return the unit of an expression by evaluating it on units, None where it has none.

        An expression that takes a number out of a unit (``log10(density)``) has none: its value is
        what the fields' own units make it.
        """
        units = {name: self.field_unit(name) for name in expression.names}
        if not any(unit is not None for unit in units.values()):
            return None
        from astropy import units as u

        ones = {
            name: u.Quantity(1.0, unit if unit is not None else u.dimensionless_unscaled)
            for name, unit in units.items()
        }
        try:
            value = expression.evaluate(UnitOps(), ones)
        except (u.UnitsError, TypeError, ValueError, UnitsError):
            return None
        return parse_unit(getattr(value, "unit", None))

    def describe(self) -> dict[str, Any]:
        """Return grid and fields as plain values."""
        return {
            "grid": self.grid.describe(),
            "fields": {
                name: {"dtype": str(array.dtype), "unit": unit_name(self._units[name])}
                for name, array in self._fields.items()
            },
        }

    def __repr__(self) -> str:
        listed = ", ".join(
            f"{name} ({' '.join((str(array.dtype), unit_name(self._units[name]))).strip()})"
            for name, array in self._fields.items()
        )
        return f"<Volume on {self.grid!r}: {listed or 'no fields'}>"


def coordinate(centers: Any, name: str, part: slice) -> np.ndarray:
    """Return a coordinate of cell centres for layers of the first axis."""
    x, y, z = centers[0][part, None, None], centers[1][None, :, None], centers[2][None, None, :]
    if name == "r":
        return np.sqrt(x * x + y * y + z * z)
    shape = (x.shape[0], y.shape[1], z.shape[2])
    return np.broadcast_to({"x": x, "y": y, "z": z}[name], shape)


def unit_quantity(array: np.ndarray, unit: Any) -> Any:
    """Return an array as a Quantity without copying it."""
    from astropy import units as u

    return u.Quantity(array, unit, copy=False, subok=True)


def _check_name(name: Any) -> str:
    """Return the name as expressions know it (Unicode-normalised, as in Python)."""
    if not isinstance(name, str) or not name.isidentifier() or keyword.iskeyword(name):
        raise InputError(
            f"a field's name must be an identifier (letters, digits, _), got {name!r}; "
            "expressions refer to fields by it"
        )
    if name in FUNCTIONS or name in CONSTANTS or name in COORDINATES:
        raise InputError(f"{name!r} is reserved for expressions; give the field another name")
    return unicodedata.normalize("NFKC", name)


def _checked(name: str, array: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    if array.dtype.kind not in "fiub":
        raise InputError(
            f"field {name!r} must be real numbers, got dtype {array.dtype}"
            + ("; give its real and imaginary parts" if array.dtype.kind == "c" else "")
        )
    if array.shape != shape:
        raise InputError(
            f"field {name!r} has shape {array.shape}, expected the grid's {shape}"
            + ("; transpose it (index is [ix, iy, iz])" if array.T.shape == shape else "")
        )
    if array.dtype == np.float16:
        array = array.astype(np.float32)
    elif array.dtype.kind == "f" and array.dtype.itemsize > 8:
        array = array.astype(np.float64)
    return np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("="))
