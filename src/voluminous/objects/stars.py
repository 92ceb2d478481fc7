"""Stars: discs of a radius, or points that carry a flux to the pixel they are in."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..errors import InputError, check_flag
from ..units import as_given, plain, unit_of
from .balls import nearby
from .contract import REACH, Layers, PointLights, View
from .spheres import Spheres
from .values import column, column_names

# Full width at half maximum of a Gaussian of unit width.
_FWHM = 2.0 * np.sqrt(2.0 * np.log(2.0))


class Stars(Spheres):
    """Stars with radii, or points with luminosities.

    A star of radius R and intensity I has the luminosity L = π R² I: the integral of the intensity
    over its disc. One without a radius is the limit of small R: all of L is seen in the pixel that
    it is in, dimmed by what is in front of the star itself. The sum of all pixels times their area
    is L for an orthographic camera, and L/D² at a distance D in the middle of a perspective
    picture (elsewhere as the projection magnifies). A point with a luminosity hides nothing; one
    with a radius (`points`) the part of its pixel that its disc covers.

    Parameters
    ----------
    positions : array_like or Quantity, shape (n, 3)
        In the volume's unit.
    colors : str, float, Quantity or array_like
        As for `Spheres`: intensities; or, where there are luminosities, what these are multiplied
        by in each channel.
    radii : float, array_like or Quantity, shape (n,), optional
    luminosities : float, array_like or Quantity, shape (n,), optional
        Intensity times area, in the volume's unit of length.
    psf : float, Quantity or pair of them, optional
        Spread points over a Gaussian of this full width at half maximum: plain numbers are pixels,
        quantities in the unit of the image plane. Cut off at 4 standard deviations; its sum is 1.
    points : bool
        Draw stars with radii as points, for discs far smaller than a pixel: all of the light is in
        the pixel that the star is in, dimmed along the ray to the star itself.
    opacity, limb_darkening
        As for `Spheres`; of stars with radii.
    depth, channel, relative
        As for `SceneObject`.

    Raises
    ------
    InputError
        If there are neither radii nor luminosities, or a number cannot be used.
    """

    def __init__(
        self,
        positions: Any,
        colors: Any = 1.0,
        *,
        radii: Any = None,
        luminosities: Any = None,
        psf: Any = None,
        points: bool = False,
        opacity: Any = 1.0,
        limb_darkening: Any = 0.0,
        depth: str = "true",
        channel: int | None = None,
        relative: bool = False,
    ) -> None:
        check_flag("points", points)
        if radii is None and luminosities is None:
            raise InputError("give a star a radius, or, as a point of light, a luminosity")
        if psf is not None and radii is not None and not points:
            raise InputError("a psf is for points: stars with a luminosity and without a radius")
        options = {"opacity": opacity, "limb_darkening": limb_darkening}
        placed: dict[str, Any] = {"depth": depth, "channel": channel, "relative": relative}
        super().__init__(positions, 1.0 if radii is None else radii, colors, **options, **placed)
        self.radii = None if radii is None else self.radii
        self.luminosities = as_given(luminosities, "luminosities")
        self.psf, self.points = as_given(psf, "psf"), bool(points)
        if luminosities is not None:
            self._checked(self.luminosities, "luminosities", np.inf)
        if psf is not None:
            array = np.asarray(plain(psf, unit_of(psf), "psf"))
            if array.shape not in ((), (2,)) or not np.all((array > 0.0) & np.isfinite(array)):
                raise InputError(f"psf must be a positive width or a pair of them, got {psf!r}")

    @classmethod
    def from_table(
        cls,
        table: Any,
        position: Sequence[str] = ("x", "y", "z"),
        *,
        color: Any = 1.0,
        radius: Any = None,
        luminosity: Any = None,
        opacity: Any = 1.0,
        **options: Any,
    ) -> Stars:
        """Return the stars in a table: of astropy, pandas, or a dictionary of columns.

        Parameters
        ----------
        table : table
            Its columns may have units.
        position : three str
            Names of the columns of x, y and z.
        color, radius, luminosity, opacity : str, or as for `Stars`
            The name of a column (of `color`: one, or a list with one per channel), or one value
            for all.
        **options
            ``psf``, ``depth``, ``channel`` …

        Raises
        ------
        UnknownNameError
            If there is no such column; names the nearest.
        """
        x, y, z = (column(table, name) for name in position)
        unit = unit_of(x)
        positions = np.stack([plain(c, unit, "position") for c in (x, y, z)], axis=-1)
        given = {"radii": radius, "luminosities": luminosity, "opacity": opacity}
        values = {k: column(table, v) if isinstance(v, str) else v for k, v in given.items()}
        if unit is not None:
            positions = positions * unit
        return cls(positions, _colors_in(table, color), **values, **options)

    def layers(self, view: View) -> Layers | None:
        return None if self.radii is None or self.points else super().layers(view)

    def lights(self, view: View) -> PointLights | None:
        if (self.radii is not None and not self.points) or not self.count:
            return None
        positions = np.asarray(view.length(self.positions, "positions"))
        x, y, depth = view.place(positions)
        sigma = np.zeros(2)
        if self.psf is not None:
            width, unit = self.psf, None
            if unit_of(width) is not None:
                unit = view.camera.plane_unit or view.grid.unit
            pixel = 1.0 if unit is None else np.abs(view.frame.pixel)
            sigma = np.broadcast_to(np.asarray(plain(width, unit, "psf")) / pixel, 2) / _FWHM
        (nx, ny), reach = view.frame.pixels, REACH * sigma
        inside = (np.abs(x - 0.5 * (nx - 1)) < 0.5 * nx + reach[0]) & (
            np.abs(y - 0.5 * (ny - 1)) < 0.5 * ny + reach[1]
        )
        some = np.flatnonzero(inside)  # never where x is NaN
        some = some[nearby(x[some], y[some], depth[some])]
        per_area, area = view.pixels_per_area(positions[some]), np.zeros(len(some))
        if self.radii is None or self.luminosities is not None:
            flux = self._luminosity(view)[some]
        if self.radii is not None:
            radius = np.broadcast_to(view.length(self.radii, "radii"), self.count)
            area = np.pi * radius[some] ** 2
            if self.luminosities is None:
                area = area * (1.0 - self.darkening[some] / 3.0)
                flux = self._surface(view, radius)[some] * area[:, None]
        shaded = np.minimum(area * per_area, 1.0) * self.opacities[some] * (self.psf is None)
        return PointLights(x[some], y[some], depth[some], flux * per_area[:, None], sigma, shaded)

    def _luminosity(self, view: View) -> np.ndarray:
        unit = view.intensity_unit
        if view.grid.unit is not None:
            unit = view.grid.unit**2 * (1 if unit is None else unit)
        total = plain(self.luminosities, unit, "luminosities")
        color = self.intensities(self.colors, self.count, view, None)
        return np.asarray(np.broadcast_to(total, self.count)[:, None] * color)

    def _surface(self, view: View, radius: np.ndarray) -> np.ndarray:
        if self.luminosities is None:
            return super()._surface(view, radius)
        # The mean over a disc of 1 - u (1 - μ) is 1 - u/3.
        area = np.pi * radius**2 * (1.0 - self.darkening / 3.0)
        return np.asarray(self._luminosity(view) / area[:, None])


def _colors_in(table: Any, color: Any) -> Any:
    names = [color] if isinstance(color, str) else color
    if not isinstance(names, (list, tuple)) or not all(isinstance(n, str) for n in names):
        return color
    if not set(names) & set(column_names(table)):
        return color
    columns = [column(table, name) for name in names]
    if len(columns) == 1 and np.asarray(columns[0]).dtype.kind in "OUS":
        return [str(name) for name in columns[0]]
    unit = unit_of(columns[0])
    values = np.stack([plain(c, unit, "color") for c in columns], axis=-1)
    return values if unit is None else values * unit
