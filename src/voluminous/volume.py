"""`Volume`, the input of all rendering and measuring: a grid and the fields on its cells."""

from __future__ import annotations

import copy
import functools
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .deferred import Deferred, Fields, Pieces
from .derivatives import Derivatives, LinesOfSight, component
from .digest import content_key, digest
from .errors import ImmutableError, InputError, check_flag, check_text, unknown_name
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
from .files import stamp
from .levels import level_of_volume
from .memory import check_memory
from .progress import Progress, with_progress
from .regrid.crop import cropped_volume
from .regrid.resample import resampled_volume
from .regrid.slices import Slice, make_plane, slice_of
from .regrid.table import table_of_cells
from .regrid.unfold import unfolded_volume
from .store import FieldStore
from .units import parse_unit, shown, unit_name

if TYPE_CHECKING:
    from .grids.contract import Grid

_SMALLER = "make a coarser volume of it, or use a machine with more memory"


class Volume(Evaluation):
    """Fields on the cells of a grid.

    Parameters
    ----------
    grid : grid
        For example a `CartesianGrid`.
    fields : mapping, optional
        Names and arrays, as an alternative to keywords (for names that are not Python identifiers).
    **named : array_like or Quantity
        Cell-centred arrays of the grid's shape (index ``[ix, iy, iz]`` of a Cartesian grid, one
        value per leaf of a tree, one array per patch): real numbers, with or without a unit. A
        vector is three fields ``velocity_x``, … Arrays are not copied if they are C-contiguous.

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
        # Metadata of the file ("time", "redshift", "object" …), as plain values or strings.
        self.meta: dict[str, Any] = {}
        # World coordinates (sky, spectrum) of the grid's x, y, z: an astropy WCS, or None.
        self.wcs: Any = None
        self._fields = Fields()
        self._units: dict[str, Any] = {}
        self._derivatives = Derivatives()
        # Lines of sight of the current camera; see `seen_by`.
        self.sight = LinesOfSight(grid)
        # Cache for rendering (see `rendering.cache`), newest last, with sizes in bytes.
        self.tables: OrderedDict[Any, Any] = OrderedDict()
        if isinstance(named.get("unit"), str):
            raise InputError(
                f"unit={named['unit']!r} would be a field: the unit of length is the grid's, as in "
                "vm.CartesianGrid.uniform(64, (0, 1), unit='pc'); those of fields come with "
                "quantities, or volume.set_unit(name, unit)"
            )
        if fields is not None and not isinstance(fields, Mapping):
            wanted = "a mapping of names and arrays, such as {'density': array}"
            raise InputError(f"fields must be {wanted}, got {shown(fields)}")
        for name, value in {**(fields or {}), **named}.items():
            self[name] = value

    @classmethod
    def from_particles(cls, positions: Any, masses: Any, **options: Any) -> Volume:
        """Return a volume from particles, on an octree refined where the particles are.

        Parameters
        ----------
        positions : array_like or Quantity, shape (n, 3)
            In any order.
        masses : float, array_like or Quantity, shape (n,)
            One number is the mass of each particle. With ones, ``density`` is a number density.
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
        from .particles import from_particles

        return from_particles(positions, masses, **options)

    @classmethod
    def from_pyvista(cls, dataset: Any, fields: Any = None, **options: Any) -> Volume:
        """Return a volume from a PyVista or VTK object; options: ``unit``, ``resolution``.

        For arguments and errors see `voluminous.io.vtk.objects.from_pyvista`.
        """
        from .io.vtk.objects import from_pyvista

        return from_pyvista(dataset, fields, **options)

    @classmethod
    def from_xarray(cls, data: Any, fields: Any = None, **options: Any) -> Volume:
        """Return a volume from a three-dimensional xarray DataArray, or from a Dataset.

        For the arguments (options: ``dims, isel, sel, bounds, spacing, aspect, unit``) and errors
        see `voluminous.io.from_xarray`.
        """
        from .io.labelled.convert import from_xarray

        return from_xarray(data, fields, **options)

    @classmethod
    def from_yt(cls, data: Any, fields: Any = None, **options: Any) -> Volume:
        """Return a volume from a yt data set, or from a region of one, on the original cells.

        For arguments (options: ``unit``, ``units``) and errors see `voluminous.io.yt.from_yt`.
        """
        from .io.yt.volume import from_yt

        return from_yt(data, fields, **options)

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
        """Coordinate names allowed in expressions (x, y, z, r and those of the grid)."""
        return coordinate_names(self.grid)

    @property
    def fields(self) -> tuple[str, ...]:
        """Names of the fields."""
        return tuple(self._fields)

    @property
    def units(self) -> dict[str, str]:
        """Unit of each field; an empty string for a field without unit."""
        return {name: unit_name(unit) for name, unit in self._units.items()}

    def field_unit(self, name: str) -> Any:
        """Return the astropy unit of a field, derivative or coordinate, or None."""
        if name in self._fields:
            return self._units[name]
        if (derived := self._derived(name)) is not None:
            return self._derivatives.unit(self, derived)
        if name not in self.coordinates:
            raise unknown_name("field", name, self._fields)
        return None if is_angle(name) else self.unit

    def array(self, name: str) -> np.ndarray:
        """Return a field as a plain, read-only view, in its unit.

        Parameters
        ----------
        name : str
            A field; a derivative such as ``gradmag(density)``; or a vector component that follows
            from others, such as ``velocity_x`` from those along r, θ and φ. Computed arrays are
            cached until one of their fields is set, or `refresh` detects a change.

        Raises
        ------
        UnknownNameError
            If there is no such field.
        InputError
            If it is a component along the line of sight and no camera is set; see `seen_by`.
        """
        if (derived := self._derived(name)) is None:
            self._check_field(name)
            view: np.ndarray = self._fields[name].view()
        else:
            for argument in derived.arguments:
                self.check_names(argument)
            view = self._derivatives.array(self, derived).view()
        view.setflags(write=False)
        return view

    def _derived(self, name: str) -> DerivedField | None:
        """Return the derivative or vector component of this name; None for fields and others."""
        if name in self._fields:
            return None
        check_text("the name of a field", name)
        return derived_field(name) or component(name, self._fields, self.grid)

    def given(self, names: Iterable[str]) -> set[str]:
        """Return the fields that these names refer to, directly or through derived fields."""
        fields: set[str] = set()
        for name in names:
            if (derived := self._derived(name)) is not None:
                fields |= self.given(_needed(derived))
            elif name in self._fields:
                fields.add(name)
        return fields

    def _check_field(self, name: str) -> None:
        if name not in self._fields:
            raise unknown_name("field", name, self._fields)

    def refresh(self) -> None:
        """Drop cached derivatives of arrays that were changed in place, as `evaluate` does."""
        self._derivatives.refresh(self)

    def __getitem__(self, name: str) -> Any:
        """Return a field: an array, or a Quantity if it has a unit."""
        if name not in self._fields:
            self.refresh()
        array, unit = self.array(name), self.field_unit(name)
        return array if unit is None else unit_quantity(array, unit)

    def __setitem__(self, name: str, value: Any) -> None:
        """Add or replace a field: an array, a Quantity, or an expression of other fields."""
        name, fields = checked_name(name, self.coordinates), self._fields
        if isinstance(value, (str, Expression)):
            expression, unit = self.resolved(Expression(value))
            array = self.evaluate(expression)
            used = [self.array(n) for n in expression.names if n in self]
            fields[name] = checked_array(name, array, self.grid)
            if not any(np.may_share_memory(array, other) for other in used):
                fields.own(name)
        elif isinstance(value, Deferred):
            unit = parse_unit(value.unit)
            self._defer(name, value)
        else:
            check_order(name, value)
            values, unit = split_unit(without_mask(value))
            fields[name] = checked_array(name, packed(name, values, self.grid), self.grid)
        self._units[name] = unit
        self._forget(name)

    def own(self) -> None:
        """Declare that no other code holds the arrays, as for volumes read from files.

        Rendering then skips the search for changes in place (512³ numbers: 20 ms of 60).
        """
        self._fields.own(*self._fields)

    def digest(self, name: str) -> bytes:
        """Return a hash of a field's contents, or of its version number if the array is owned."""
        number = self._fields.sealed(name) if name in self._fields else None
        return digest(self.array(name)) if number is None else b"sealed %d" % number

    def fingerprint(self) -> str:
        """Return a hash of grid and fields that is the same in all processes, today and tomorrow.

        Fields of a file are not read: the file's name, size and time of change stand for them.
        """
        origins = {name: self._fields.origin(name) for name in self._fields}
        identity = [
            (name, self.units[name], origin[1] if origin else self.array(name))
            for name, origin in origins.items()
        ]
        files = {origin[2] or stamp(origin[0]) for origin in origins.values() if origin}
        return content_key(identity, sorted(files), self.grid, self.meta, self.wcs)

    def _defer(self, name: str, value: Deferred) -> None:
        size = self.grid.size * np.dtype(value.dtype).itemsize
        if value.pieces is None:
            check_memory(size, f"reading {name!r}", _SMALLER)
        load = functools.partial(_load, name, self.grid, value, size)
        self._fields.defer(name, load, value, self.grid.shape)

    def load(self, *names: str) -> Volume:
        """Read deferred fields now, by default all; return this volume."""
        for name in names or self.fields:
            self.array(name)
        return self

    @property
    def waiting(self) -> tuple[str, ...]:
        """Names of the deferred fields, which are read from their file at first use."""
        names: tuple[str, ...] = self._fields.waiting
        return names

    @property
    def bytes_waiting(self) -> int:
        """Bytes that `load` would take."""
        return int(self._fields.bytes_waiting(self.grid.size))

    @property
    def store(self) -> FieldStore:
        """The fields in pieces: boxes of cells, without reading the rest of a file.

        Boxes are read from Zarr, OME-Zarr, HDF5, NetCDF, ``.npy`` and raw files. Fields of others,
        and those that were set, are parts of their arrays. Cells of refined grids are counted
        along one axis.

        Examples
        --------
        >>> sphere = vm.models.sphere(8)
        >>> sphere.store.read("inside", (0, 2, 4), (4, 4, 8)).shape
        (4, 2, 4)
        """
        return FieldStore(self.grid.shape, self._fields)

    def level(self, level: int) -> Volume:
        """Return a coarser level of the file as a volume, of which nothing is read yet.

        It has the same fields, bounds and units; a cell is the mean of 2, 4 … cells along each
        axis. Zarr that was saved with ``levels=True`` has levels, and OME-Zarr.

        Parameters
        ----------
        level : int
            0 is this volume itself. ``volume.store.levels`` is their number.

        Raises
        ------
        InputError
            If there is no such level, or the grid is not Cartesian.

        Examples
        --------
        >>> vm.models.sphere(32).save("levels.zarr", levels=True, chunks=8)
        >>> coarse = vm.open("levels.zarr").level(2)
        >>> coarse.grid.shape
        (8, 8, 8)
        """
        coarse: Volume = level_of_volume(self, level, Volume)
        return coarse

    def unread(self) -> Volume:
        """Return this volume without what is read again where it is used: for other processes.

        Fields in memory stay, unless they are those of a file that is read in pieces.
        """
        other = self.with_arrays({})
        other._fields.unread()
        return other

    def explain_reading(
        self,
        reading: Callable[[], AbstractContextManager[None]],
        origin: tuple[Path, str, str] | None = None,
        again: Callable[[str], np.ndarray] | None = None,
    ) -> None:
        """Read deferred fields within a context that adds the file name to errors.

        `origin` is the file of all fields that there are, how it is read, and its stamp when it
        was opened (empty for a directory); see `fingerprint`. `again` reads a field in other
        processes, where the functions of a reader may not go.
        """
        self._fields.guard(reading, origin, again)

    def set_unit(self, name: str, unit: Any) -> None:
        """Set the unit of a field; its values do not change."""
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
        """Return a shallow copy, which shares the caches too."""
        other = object.__new__(type(self))
        vars(other).update(vars(self))
        return other

    def __getstate__(self) -> dict[str, Any]:
        """Return the state for deep copies and pickles, without the rendering cache."""
        return {**vars(self), "tables": OrderedDict()}

    def __contains__(self, name: object) -> bool:
        """Return True for fields, and for fields derived from fields and coordinates."""
        if not isinstance(name, str) or (derived := self._derived(name)) is None:
            return name in self._fields
        return all(n in self.coordinates or n in self for n in _needed(derived))

    def __iter__(self) -> Iterator[str]:
        return iter(self._fields)

    def __len__(self) -> int:
        return len(self._fields)

    def seen_by(self, camera: Any) -> Volume:
        """Return the volume with a camera's lines of sight, for ``los(v)``; it shares caches."""
        seen = copy.copy(self)
        seen.sight = LinesOfSight(self.grid, camera)
        return seen

    def with_arrays(self, arrays: Mapping[str, np.ndarray]) -> Volume:
        """Return a volume with some fields replaced, and with empty caches."""
        other = copy.copy(self)
        other._fields, other._derivatives = copy.copy(self._fields), Derivatives()
        other._units, other.tables = dict(self._units), OrderedDict()
        for name, array in arrays.items():
            other._fields[name] = array
        other._fields.own(*arrays)
        return other

    def save(self, path: str | Path, *, format: str | None = None, **options: Any) -> None:
        """Write the volume to a file; its suffix sets the format, such as ``.h5`` or ``.npz``.

        ``.h5`` stores any grid and the complete volume: `voluminous.open` returns it bit for bit.
        So does ``.zarr``, in chunks, for grids that are not refined and fields larger than memory.
        ``voluminous formats`` lists the other formats. A file is written completely or not at all,
        and replaces one of the same name. A directory must be new, or empty.

        Parameters
        ----------
        path : str or Path
            A directory for formats that consist of several files.
        format : str, optional
            Name of the format, if it does not follow from the suffix.
        **options
            Options of the format; ``.h5``: ``compress=True`` compresses the fields. ``.zarr``:
            ``levels=True`` adds coarser levels, ``stats=True`` the range of each chunk;
            ``keep_bits=10`` rounds real numbers, by 5e-4 at most; ``chunks=128`` cells along the
            sides of a chunk.

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
        from .io.registry import save

        save(self, path, format=format, **options)

    @with_progress
    def resample(
        self,
        grid: Grid,
        fields: Iterable[str] | None = None,
        *,
        fill: float = 0.0,
        samples: int = 4,
        deferred: bool = False,
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
            The value outside this volume. With 0 the integral of a field is conserved, as far as
            it is inside the new grid. With NaN, cells that are not entirely inside are NaN.
        samples : int
            Points per axis and cell where cells are not boxes.
        deferred : bool
            True to make no field now, but boxes of it when they are used: for a Cartesian grid
            that is larger than memory, which ``save("big.zarr")`` writes, and `render` with
            ``memory=`` draws, chunk by chunk. Cells must be boxes.
        progress
            As for `render`.

        Returns
        -------
        Volume
            Fields that were float32 remain so, others become float64. `meta` is copied, with the
            orientation of scans; a turned one stays turned about its ``meta["direction_center"]``.

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
        Between grids whose cells are boxes (Cartesian, octrees, patches) overlap volumes are exact:
        Σ f V is conserved to rounding. To and from other grids they are estimated with
        ``samples**3`` points in each of the smaller cells; a constant stays constant.
        """
        check_flag("deferred", deferred)
        later = _made_in_boxes if deferred else None
        resampled: Volume = resampled_volume(self, grid, fields, fill, samples, later)
        return resampled

    def crop(self, x: Any = None, y: Any = None, z: Any = None) -> Volume:
        """Return the cells between two walls along each axis; the others need no memory.

        Fields of a file that can be read in pieces are read when they are used, this part alone.

        Parameters
        ----------
        x, y, z : (low, high), optional
            Numbers in the volume's unit or lengths, None for an end. Cells that are partly within
            stay whole: ``clip=`` of `render` also cuts cells.

        Raises
        ------
        InputError
            If the grid is not Cartesian, or has no cells there.
        """
        cropped: Volume = cropped_volume(self, {"x": x, "y": y, "z": z}, _made_in_boxes)
        return cropped

    def unfolded(self, phi: int | None = None, theta: int | None = None) -> Volume:
        """Return a volume without mirror images and, with `phi`, without axisymmetric cells.

        A spherical grid made with ``mirror=True`` gets both halves. Each cell that goes all around
        the axis becomes `phi` cells. Lines of sight, ``los("velocity")``, are then defined
        everywhere. Vectors below the midplane are the mirror images of those above: their
        components along θ, or z, change sign. (A magnetic field is an axial vector: change the sign
        of its three components below the midplane afterwards.)

        Parameters
        ----------
        phi : int, optional
            Cells in azimuth, for a grid whose cells go all around. With 64 cells the error of lines
            of sight, to the centres of cells, is at most 0.05 radian, or 0.001 if interpolated.
        theta : int, optional
            Cells from pole to pole, for a grid with one; half of `phi` by default.

        Returns
        -------
        Volume
            With more cells; this volume itself if nothing is mirrored and no numbers are given.

        Raises
        ------
        InputError
            If the grid is refined, cells do not go all around, or have vectors along x and y.
        MemoryNeededError
            If there is not enough memory.

        Examples
        --------
        >>> import numpy as np
        >>> grid = vm.CylindricalGrid([1, 2, 3], [0, 2 * np.pi], [-1, 1])
        >>> disc = vm.Volume(grid, v_R="0", v_phi="1 / sqrt(R)", v_z="0")
        >>> disc.unfolded(phi=64).grid.shape
        (2, 64, 1)
        """
        unfolded: Volume = unfolded_volume(self, phi, theta)
        return unfolded

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
            A field or an expression of fields; a vector gives three pictures.
        normal : {"x", "y", "z"} or three floats
            The normal of the plane: an axis, or a vector of any length.
        position : float or Quantity, optional
            Distance from the origin along the normal; by default the plane contains `center`.
        width : float, Quantity or pair of them, optional
            Width and height; all of the volume by default.
        center : three floats or Quantity, optional
            Centre of the picture, projected onto the plane; the volume's by default.
        up : three floats, optional
            Upward direction. By default z; for a normal along x, y is to the right and z up, and
            so on, cyclically.
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
        """Return a table of cells: positions, sizes and values of fields.

        Parameters
        ----------
        fields : iterable of str, optional
            Fields or expressions; all fields by default.
        where : str or Expression, optional
            Only cells where this is true. Numbers in comparisons may have units:
            ``"velocity_z > 5 km/s"``.
        kind : {"dict", "numpy", "astropy", "pandas"}
            A dict of arrays and Quantities, a structured array, a `QTable` or a `DataFrame`; the
            second and the last have no units.

        Returns
        -------
        table
            Columns ``cell`` (flat number), the centre in ``x, y, z`` and in the grid's coordinates,
            ``size_x`` … (widths along these, as lengths), ``volume``, ``level``, and the fields; a
            field with one of these names gets a ``_`` appended.
        """
        return table_of_cells(self, fields, where, kind)

    def describe(self) -> dict[str, Any]:
        """Return a description of grid and fields as plain values."""
        return {
            "grid": self.grid.describe(),
            "fields": {
                name: {"dtype": str(self._fields.dtype(name)), "unit": unit_name(self._units[name])}
                for name in self._fields
            },
        }

    def __repr__(self) -> str:
        fields = self.describe()["fields"].items()
        listed = (f"{name} ({f['dtype']} {f['unit']}".strip() + ")" for name, f in fields)
        return f"<Volume on {self.grid!r}: {', '.join(listed) or 'no fields'}>"

    def _repr_html_(self) -> str:
        from .regrid.slices import volume_html

        return volume_html(self)

    def _repr_png_(self) -> bytes | None:
        from .regrid.slices import shown_field, slices_png

        name = shown_field(self)
        return None if name is None else slices_png(self, name)


def _needed(derived: DerivedField) -> set[str]:
    return {name for argument in derived.arguments for name in required_names(argument)}


def _made_in_boxes(read: Any, dtype: Any, shape: tuple[int, ...]) -> Deferred:
    return Deferred(functools.partial(read, (0,) * len(shape), shape), dtype, pieces=Pieces(read))


def _load(name: str, grid: Grid, value: Deferred, size: int) -> np.ndarray:
    check_memory(size, f"reading {name!r}", _SMALLER)
    return checked_array(name, grid.pack(value.load()), grid)
