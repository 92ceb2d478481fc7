"""The data that goes in: a grid and the fields on its cells."""

from __future__ import annotations

import copy
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager
from typing import Any

import numpy as np

from .deferred import Deferred, Fields
from .derivatives import Derivatives, LinesOfSight, component
from .digest import digest
from .errors import ImmutableError, InputError, unknown_name
from .evaluation import Evaluation
from .expressions import DerivedField, Expression, derived_field, required_names
from .fields import (
    check_order,
    checked_array,
    checked_grid,
    checked_name,
    coordinate_names,
    is_angle,
    packed,
    split_unit,
    unit_quantity,
    without_mask,
)
from .memory import check_memory
from .regrid import OnOtherCells
from .units import parse_unit, shown, unit_name


class Volume(Evaluation, OnOtherCells):
    """Fields on the cells of a grid.

    Parameters
    ----------
    grid : grid
        For example a `CartesianGrid`.
    fields : mapping, optional
        Names and arrays, as an alternative to keywords (for names that are no identifiers).
    **named : array_like or Quantity
        Cell-centred arrays of the grid's shape (index ``[ix, iy, iz]`` of a Cartesian grid, one
        value per leaf of a tree, one array per patch of patches): float32, float64, integer or
        boolean, with or without a unit. A vector is three fields ``velocity_x``, ``velocity_y``,
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
        self.grid = checked_grid(grid)
        # What a file tells besides: "time", "redshift", "object" …, as plain values or texts.
        self.meta: dict[str, Any] = {}
        # The sky and the spectrum behind the grid's x, y, z: an astropy WCS, or None.
        self.wcs: Any = None
        self._fields = Fields()
        self._units: dict[str, Any] = {}
        self._derivatives = Derivatives()
        # From where it is seen; see `seen_by`.
        self.sight = LinesOfSight(grid)
        # Cached for pictures (see `rendering.cache`), newest last, with the bytes that it takes.
        self.tables: OrderedDict[Any, Any] = OrderedDict()
        if isinstance(named.get("unit"), str):
            raise InputError(
                f"unit={named['unit']!r} would be a field: the unit of length is the grid's, as in "
                "vm.CartesianGrid.uniform(64, (0, 1), unit='pc'); those of fields come with "
                "quantities, or volume.set_unit(name, unit)"
            )
        if fields is not None and not isinstance(fields, Mapping):
            raise InputError(
                "fields must be a mapping of names and arrays, such as {'density': array}, got "
                + shown(fields)
            )
        for name, value in {**(fields or {}), **named}.items():
            self[name] = value

    def __setattr__(self, name: str, value: Any) -> None:
        free = name in ("meta", "wcs", "sight", "tables") or name.startswith("_")
        if not free and (name != "grid" or "grid" in self.__dict__):
            raise ImmutableError(
                f"Volume.{name} cannot be assigned: a field is volume[{name!r}] = …, its unit "
                "volume.set_unit(name, unit); lengths and their unit are the grid's, and "
                "vm.Volume(grid, …) makes another volume"
            )
        object.__setattr__(self, name, value)

    @property
    def unit(self) -> Any:
        """Length unit (astropy), or None for dimensionless."""
        return self.grid.unit

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the coordinates that expressions know: x, y, z, r and the grid's own."""
        return coordinate_names(self.grid)

    @property
    def fields(self) -> tuple[str, ...]:
        """Names of the fields."""
        return tuple(self._fields)

    @property
    def units(self) -> dict[str, str]:
        """Unit of each field, empty where it has none."""
        return {name: unit_name(unit) for name, unit in self._units.items()}

    def field_unit(self, name: str) -> Any:
        """Return the astropy unit of a field, derivative or coordinate, or None."""
        if name in self._fields:
            return self._units[name]
        derived = self._derived(name)
        if derived is not None:
            return self._derivatives.unit(self, derived)
        if name in self.coordinates:
            return None if is_angle(name) else self.unit
        return self._units[name]

    def array(self, name: str) -> np.ndarray:
        """Return a field as a plain, read-only view, in its own unit.

        Parameters
        ----------
        name : str
            A field; a derivative of fields such as ``gradmag(density)``; or a component of a vector
            that is given by others, such as ``velocity_x`` where there are ``velocity_r``,
            ``velocity_theta`` and ``velocity_phi``. What is computed is kept until a field it is
            made of is set, or `refresh` finds it changed.

        Raises
        ------
        UnknownNameError
            If there is no such field.
        InputError
            If it is a component along the line of sight, and no camera is known; see `seen_by`.
        """
        derived = self._derived(name)
        if derived is None:
            self._check_field(name)
            view = self._fields[name].view()
        else:
            for argument in derived.arguments:
                self.check_names(argument)
            view = self._derivatives.array(self, derived).view()
        view.setflags(write=False)
        return view

    def _derived(self, name: str) -> DerivedField | None:
        """Return what a name stands for that is no field but made of fields; None if nothing is."""
        if name in self._fields:
            return None
        return derived_field(name) or component(name, self._fields, self.grid)

    def given(self, names: Iterable[str]) -> set[str]:
        """Return the fields among some names, and those that the others are made of."""
        found: set[str] = set()
        for name in names:
            derived = self._derived(name)
            if derived is None:
                found |= {name} & self._fields.keys()
            else:
                found |= self.given(n for a in derived.arguments for n in required_names(a))
        return found

    def _check_field(self, name: str) -> None:
        if name not in self._fields:
            raise unknown_name("field", name, self._fields)

    def refresh(self) -> None:
        """Look for arrays that were changed in place, and forget the derivatives made of them.

        `evaluate` and indexing do it; it takes the time to read all fields that derivatives are
        kept of.
        """
        self._derivatives.refresh(self)

    def __getitem__(self, name: str) -> Any:
        """Return a field: an array, or a Quantity if it has a unit."""
        if name not in self._fields:
            self.refresh()
        array, unit = self.array(name), self.field_unit(name)
        return array if unit is None else unit_quantity(array, unit)

    def __setitem__(self, name: str, value: Any) -> None:
        """Add or replace a field: an array, a Quantity, or an expression of other fields."""
        name = checked_name(name, self.coordinates)
        if isinstance(value, (str, Expression)):
            expression, unit = self.resolved(Expression(value))
            array = self.evaluate(expression)
            given = [self.array(n) for n in expression.names if n in self]
            self._keep(name, array, unit)
            if not any(np.may_share_memory(array, other) for other in given):
                self._fields.own(name)
            return
        elif isinstance(value, Deferred):
            self._defer(name, value)
            return
        else:
            check_order(name, value)
            values, unit = split_unit(without_mask(value))
            array = packed(name, values, self.grid)
        self._keep(name, array, unit)

    def _keep(self, name: str, array: np.ndarray, unit: Any) -> None:
        self._fields[name] = checked_array(name, array, self.grid)
        self._units[name] = unit
        self._forget(name)

    def own(self) -> None:
        """Say that nobody else has the arrays of fields: they cannot change but by setting them.

        Of a volume that was read from a file. Pictures then need not look whether they have
        (512³ numbers: 20 ms of 60).
        """
        self._fields.own(*self._fields)

    def digest(self, name: str) -> bytes:
        """Return what tells whether a field has changed: a hash of its contents, if it can."""
        array = self.array(name)
        number = None if self._derived(name) else self._fields.sealed(name)
        return digest(array) if number is None else b"sealed %d" % number

    def _defer(self, name: str, value: Deferred) -> None:
        def check() -> None:
            size = 0 if value.mapped else self.grid.size * np.dtype(value.dtype).itemsize
            advice = "make a coarser volume of it, or use a machine with more memory"
            check_memory(size, f"reading {name!r}", advice)

        def load() -> np.ndarray:
            check()
            return checked_array(name, self.grid.pack(value.load()), self.grid)

        check()  # what can never be read is refused at once
        self._fields.defer(name, load, value)
        self._units[name] = parse_unit(value.unit)
        self._forget(name)

    def load(self, *names: str) -> Volume:
        """Read fields now that would be read when they are first used; by default all.

        Returns
        -------
        Volume
            This volume.

        Raises
        ------
        MemoryNeededError
            If they do not fit into the memory that there is.
        """
        for name in names or self.fields:
            self.array(name)
        return self

    @property
    def waiting(self) -> tuple[str, ...]:
        """Names of the fields that are in a file, and read when they are first used."""
        return self._fields.waiting

    @property
    def bytes_waiting(self) -> int:
        """Memory that `load` would take."""
        return self._fields.bytes_waiting(self.grid.size)

    def explain_reading(self, reading: Callable[[], AbstractContextManager[None]]) -> None:
        """Read what is waiting within a context, which makes errors name the file."""
        self._fields.guard(reading)

    def set_unit(self, name: str, unit: Any) -> None:
        """Say which unit a field's plain values are in (values stay as they are)."""
        self._check_field(name)
        self._units[name] = parse_unit(unit)
        self._forget(name)

    def __delitem__(self, name: str) -> None:
        self._check_field(name)
        del self._fields[name], self._units[name]
        self._forget(name)

    def _forget(self, name: str) -> None:
        self._derivatives.forget(name)
        self.tables.clear()

    def __copy__(self) -> Volume:
        """Return another that shares all, what is kept for pictures too."""
        other = object.__new__(type(self))
        vars(other).update(vars(self))
        return other

    def __getstate__(self) -> dict[str, Any]:
        """Return what deep copies and pickles hold: not what was made for pictures, on a device."""
        return {**vars(self), "tables": OrderedDict()}

    def __contains__(self, name: object) -> bool:
        """Return True for fields, and for what can be made of fields and coordinates."""
        derived = self._derived(name) if isinstance(name, str) else None
        if derived is None:
            return name in self._fields
        needed = {n for a in derived.arguments for n in required_names(a)}
        return all(n in self.coordinates or n in self for n in needed)

    def __iter__(self) -> Iterator[str]:
        return iter(self._fields)

    def __len__(self) -> int:
        return len(self._fields)

    def seen_by(self, camera: Any) -> Volume:
        """Return the volume as a camera sees it: expressions know the line of sight, ``los(v)``.

        Fields, and all that is kept of them, are this volume's own. `render` does it.
        """
        seen = copy.copy(self)
        seen.sight = LinesOfSight(self.grid, camera)
        return seen

    def with_arrays(self, arrays: Mapping[str, np.ndarray]) -> Volume:
        """Return a volume of the same fields, some of them with other values; nothing is kept."""
        other = copy.copy(self)
        other._fields, other._derivatives = copy.copy(self._fields), Derivatives()
        other._units, other.tables = dict(self._units), OrderedDict()
        for name, array in arrays.items():
            other._fields[name] = array
        other._fields.own(*arrays)
        return other

    def describe(self) -> dict[str, Any]:
        """Return grid and fields as plain values."""
        return {
            "grid": self.grid.describe(),
            "fields": {
                name: {"dtype": str(self._fields.dtype(name)), "unit": unit_name(self._units[name])}
                for name in self._fields
            },
        }

    def __repr__(self) -> str:
        listed = ", ".join(
            f"{name} ({' '.join((str(told['dtype']), told['unit'])).strip()})"
            for name, told in self.describe()["fields"].items()
        )
        return f"<Volume on {self.grid!r}: {listed or 'no fields'}>"

    def _repr_html_(self) -> str:
        from .regrid.thumbnail import volume_html

        return volume_html(self)

    def _repr_png_(self) -> bytes | None:
        from .regrid.thumbnail import shown_field, slices_png

        name = shown_field(self)
        return None if name is None else slices_png(self, name)
