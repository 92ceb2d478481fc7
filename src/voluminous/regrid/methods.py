"""What volumes can do with other cells: `Volume` inherits it, and has the fields."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from ..errors import InputError
from ..expressions import Expression
from ..progress import Progress, with_progress
from ..units import plain, shown
from .resample import resampled
from .slices import Slice, cells_on, make_plane, make_slice
from .table import cell_columns, table
from .unfold import divided, unfolded


class OnOtherCells:
    """Resampling, slices and tables of a volume."""

    @with_progress
    def resample(
        self: Any,
        grid: Any,
        fields: Iterable[str] | None = None,
        *,
        fill: float = 0.0,
        samples: int = 4,
        progress: Progress = None,
    ) -> Any:
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
        names = _named(self, fields)
        values = {name: self.array(name) for name in names}
        found = resampled(values, self.grid, grid, _number(fill), samples)
        single = {name for name in names if self.array(name).dtype == np.float32}
        other = type(self)(grid)
        for name in names:
            other[name] = found[name].astype(np.float32) if name in single else found[name]
            other.set_unit(name, self.field_unit(name))
        other.meta |= _meta_on(self, grid)
        return other

    def unfolded(self: Any, phi: int | None = None, theta: int | None = None) -> Any:
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
        return divided(unfolded(self), phi, theta)

    def slice(
        self: Any,
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
        values = self.evaluate(expression, camera=camera)
        is_vector = values.ndim > len(self.grid.shape)
        unit = None if is_vector else self.expression_unit(Expression(expression))
        cells, name = cells_on(self.grid, plane), str(getattr(expression, "text", expression))
        return make_slice(self.grid, plane, cells, values, unit, name)

    def cells(
        self: Any, fields: Iterable[str] | None = None, *, where: Any = None, kind: str = "dict"
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
        columns = cell_columns(self.grid)
        for name in _named(self, fields):
            values = self.array(name) if name in self.fields else self.evaluate(name)
            unit = self.expression_unit(Expression(name))
            columns[f"{name}_" if name in columns else name] = (values.reshape(-1), unit)
        if where is not None:
            chosen = self.evaluate(Expression(where)).reshape(-1) != 0
            columns = {name: (values[chosen], unit) for name, (values, unit) in columns.items()}
        return table(columns, kind)


def _meta_on(volume: Any, grid: Any) -> dict[str, Any]:
    meta = dict(volume.meta)
    old, new = (np.mean(g.bounds, axis=1) for g in (volume.grid, grid))
    if "direction" in meta and not np.allclose(old, new, rtol=0, atol=1e-9 * volume.grid.scale):
        # Where the patient's axes are is then not known either.
        del meta["direction"]
        meta.pop("orientation", None)
    return meta


def _number(fill: Any) -> float:
    number = None if fill is None else plain(fill, None, "fill")
    if not isinstance(number, float):
        raise InputError(f"fill must be one number, got {shown(fill)}")
    return number


def _named(volume: Any, fields: Iterable[str] | None) -> tuple[str, ...]:
    if isinstance(fields, str):
        raise InputError(f"fields must be a list of names, got {fields!r}; write [{fields!r}]")
    try:
        return tuple(volume.fields if fields is None else fields)
    except TypeError:
        raise InputError(f"fields must be a list of names, got {fields!r}") from None
