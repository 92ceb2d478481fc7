"""The data that goes in: a grid and the fields on its cells."""

from __future__ import annotations

import copy
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from . import packages
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
from .progress import Progress, with_progress
from .regrid.resample import resampled_volume
from .regrid.slices import Slice, make_plane, slice_of
from .regrid.table import table_of_cells
from .regrid.unfold import unfolded_volume
from .units import parse_unit, shown, unit_name

if TYPE_CHECKING:
    from .grids.contract import Grid


class Volume(Evaluation):
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

    def __init__(self, grid: Grid, fields: Mapping[str, Any] | None = None, **named: Any) -> None:
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

    @classmethod
    def from_particles(cls, positions: Any, masses: Any, **options: Any) -> Volume:
        """Return a volume of particles, on an octree that is fine where they are.

        Parameters
        ----------
        positions : array_like or Quantity, shape (n, 3)
            In any order.
        masses : float, array_like or Quantity, shape (n,)
            One number is the mass of all. Ones make ``density`` a number density.
        **options
            ``smoothing_length, volume, density, fields, kernel, bounds, periodic, max_particles,
            cell_width, min_level, max_level, empty, unit, progress``: see
            `voluminous.particles.from_particles`, which also lists errors.

        Examples
        --------
        >>> import numpy as np, voluminous as vm
        >>> positions = np.random.default_rng(1).normal(size=(1000, 3))
        >>> volume = vm.Volume.from_particles(positions, 0.5, unit="pc")
        >>> volume.fields
        ('density',)
        """
        volume: Volume = packages.room("particles").from_particles(positions, masses, **options)
        return volume

    @classmethod
    def from_pyvista(cls, dataset: Any, fields: Any = None, **options: Any) -> Volume:
        """Return a volume of an object of PyVista or VTK.

        Arguments, with ``unit`` and ``resolution`` as options, and errors are those of
        `voluminous.io.vtk.objects.from_pyvista`.
        """
        volume: Volume = packages.room("io.vtk.objects").from_pyvista(dataset, fields, **options)
        return volume

    @classmethod
    def from_xarray(cls, data: Any, fields: Any = None, **options: Any) -> Volume:
        """Return the volume in an array of xarray with three dimensions, or in a set of them.

        Arguments, with ``dims, isel, sel, bounds, spacing, aspect, unit`` as options, and errors
        are those of `voluminous.io.from_xarray`.
        """
        volume: Volume = packages.room("io").from_xarray(data, fields, **options)
        return volume

    @classmethod
    def from_yt(cls, data: Any, fields: Any = None, **options: Any) -> Volume:
        """Return the volume of a data set of yt, or of a region of one, on its own cells.

        Arguments, with ``unit`` and ``units`` as options, and errors are those of
        `voluminous.io.yt.from_yt`.
        """
        volume: Volume = packages.room("io.yt").from_yt(data, fields, **options)
        return volume

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
        """Names of the coordinates that expressions know (x, y, z, r and the grid's own)."""
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

    def save(self, path: str | Path, *, format: str | None = None, **options: Any) -> None:
        """Write the volume to a file, whose suffix tells the format, such as ``.h5`` or ``.npz``.

        ``.h5`` holds every grid and all that belongs to a volume: `voluminous.open` returns it bit
        for bit. ``voluminous formats`` lists what else can be written. A file appears whole or not
        at all, and replaces one of the same name. A directory must be new, or empty.

        Parameters
        ----------
        path : str or Path
            Of the file; a directory for formats that consist of several files.
        format : str, optional
            Name of the format, if the suffix does not tell.
        **options
            Those of the format; ``.h5``: ``compress=True`` packs the fields.

        Raises
        ------
        UnknownNameError
            If no format that can be written has this suffix, or it has no such option.
        InputError
            If the format cannot hold this volume, or the directory is not empty.

        Examples
        --------
        >>> vm.models.sphere(8).save("sphere.h5")
        >>> vm.open("sphere.h5").grid.shape
        (8, 8, 8)
        """
        packages.room("io.saving").save(self, path, format=format, **options)

    @with_progress
    def resample(
        self,
        grid: Grid,
        fields: Iterable[str] | None = None,
        *,
        fill: float = 0.0,
        samples: int = 4,
        progress: Progress = None,
    ) -> Volume:
        """Return a volume with the same fields on another grid: means over its cells.

        Parameters
        ----------
        grid : grid
            Any, in the volume's length unit.
        fields : iterable of str, optional
            Which fields; all by default.
        fill : float
            The value outside this volume. With 0 the integral of a field over the volume is kept
            (as far as it is inside the new grid), so densities keep their mass. With NaN cells
            that are not entirely inside have no value.
        samples : int
            Points per axis and cell where cells are no boxes.
        progress
            As for `render`.

        Returns
        -------
        Volume
            Fields are float32 where they were, else float64. `meta` is kept; how scans are turned
            (``meta["direction"]``) only if the new grid has the same centre, about which they are.

        Raises
        ------
        UnknownNameError
            If there is no such field.
        UnitsError
            If the new grid has another length unit.
        MemoryNeededError
            If the result does not fit.

        Notes
        -----
        Between grids whose cells are boxes (Cartesian, octrees, patches) the volumes that cells
        share are computed exactly: Σ f V is kept to rounding. To and from spherical and cylindrical
        grids they are estimated with ``samples**3`` points in each of the smaller cells; a constant
        stays constant, and Σ f V is kept to the error of that estimate.
        """
        return resampled_volume(self, grid, fields, fill, samples)

    def unfolded(self, phi: int | None = None, theta: int | None = None) -> Volume:
        """Return a volume in which every cell is in one place, and not mirrored or all around.

        Both halves of a spherical grid that was made with ``mirror=True``; and many cells in place
        of each one that goes all around the axis, if `phi` says how many. So lines of sight,
        ``los("velocity")``, are known everywhere.

        What is below the midplane moves as its image above does, upside down: components along θ,
        or z, of vectors change sign.

        Parameters
        ----------
        phi : int, optional
            Cells in azimuth, of a grid of which one goes all around. A line of sight is that to a
            cell's middle: with 64 cells it is off by 0.05 radian at most, and by 0.001 where it
            is interpolated between them (``scheme="post-classified"``).
        theta : int, optional
            Cells from pole to pole, of a grid that has one; half of `phi` by default.

        Returns
        -------
        Volume
            With more cells; this volume itself where nothing is mirrored and nothing asked for.

        Raises
        ------
        InputError
            If the grid is refined, the cells do not go all around, or vectors are given along x
            and y in such cells.
        MemoryNeededError
            If there is not enough memory.

        Notes
        -----
        All vectors are taken as velocities are. A magnetic field is mirrored with the opposite sign
        (it is an axial vector): change that of its three components below the midplane afterwards.

        Examples
        --------
        >>> import numpy as np
        >>> import voluminous as vm
        >>> grid = vm.CylindricalGrid([1, 2, 3], [0, 2 * np.pi], [-1, 1])
        >>> disc = vm.Volume(grid, v_R="0", v_phi="1 / sqrt(R)", v_z="0")
        >>> disc.unfolded(phi=64).grid.shape
        (2, 64, 1)
        """
        return unfolded_volume(self, phi, theta)

    def slice(
        self,
        expression: Any,
        normal: Any = "z",
        position: Any = None,
        *,
        width: Any = None,
        center: Any = None,
        up: Any = None,
        resolution: Any = 400,
        camera: Any = None,
    ) -> Slice:
        """Return values on a plane through the volume, cell by cell.

        Parameters
        ----------
        expression : str or Expression
            A field or what is computed of fields; a vector gives three pictures.
        normal : {"x", "y", "z"} or three floats
            The axis that the plane is across, or its normal; it need not be of length one.
        position : float or Quantity, optional
            Where the plane meets the normal through the origin. By default through `center`.
        width : float, Quantity or pair of them, optional
            Width and height; all of the volume by default.
        center : three floats or Quantity, optional
            What is in the middle, moved onto the plane; by default the volume's centre.
        up : three floats, optional
            What points upwards. By default z; across an axis, the axes follow in turn: y to the
            right and z up across x, z and x across y, x and y across z.
        resolution : int or (int, int)
            Pixels along the longer side, or (nx, ny).
        camera : camera, optional
            For expressions with ``los(...)``.

        Returns
        -------
        Slice
            ``values`` (ny, nx) with row 0 at the bottom, NaN outside, and their ``extent``;
            `Slice.plot` draws them.

        Raises
        ------
        InputError
            If no pixel is in a cell, or the plane cannot be made.
        UnknownNameError
            If there is no such field.

        Examples
        --------
        >>> import voluminous as vm
        >>> core = vm.models.prestellar_core(32)
        >>> cut = core.slice("log10(density)", "x", resolution=64)
        >>> cut.values.shape
        (64, 64)
        """
        plane = make_plane(self.grid, normal, position, width, center, up, resolution)
        return slice_of(self, expression, plane, camera)

    def cells(
        self, fields: Iterable[str] | None = None, *, where: Any = None, kind: str = "dict"
    ) -> Any:
        """Return a table of cells: where they are, how large, and the values of fields.

        Parameters
        ----------
        fields : iterable of str, optional
            Fields or expressions; all fields by default.
        where : str or Expression, optional
            Only cells where this is true. Numbers that are compared may have units:
            ``"velocity_z > 5 km/s"``.
        kind : {"dict", "numpy", "astropy", "pandas"}
            A dict of arrays and Quantities, a structured array, a `QTable` or a `DataFrame`; the
            second and the last know no units.

        Returns
        -------
        table
            Columns ``cell`` (flat number), ``x, y, z`` and the grid's own coordinates of the
            centre, ``size_x`` … (widths along the own coordinates, as lengths), ``volume``,
            ``level``, and the fields; a field with one of these names gets a ``_`` behind it.
        """
        return table_of_cells(self, fields, where, kind)

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
