"""`Cube`: an image whose channels are wavelengths, frequencies or velocities."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError
from .image import Image
from .spectral_axis import SpectralAxis, as_spectral

if TYPE_CHECKING:
    from ..units import UnitLike
    from .spectrum import Spectrum


# Options of `to_rgb` that say which channels are shown, and how.
_OF_CHANNELS = ("channels", "mix", "colormap")


class Cube(Image):
    """A picture with a spectrum in every pixel, the result of `vm.observe`.

    It is an `Image`, with the same methods, and those below.

    Parameters
    ----------
    intensity : array_like or Quantity, shape (ny, nx, channel)
        As in `Image`.
    spectral : SpectralAxis, Quantity or array_like, shape (channel,)
        Of each channel: `vm.channels`, or wavelengths, frequencies or velocities with a unit; plain
        numbers are wavelengths in micron.
    **known
        All others of `Image`. With a `distance` pixels have solid angles.

    Raises
    ------
    InputError
        If there is not one place on the spectral axis for each channel.
    """

    spectral: SpectralAxis

    def __init__(self, intensity: ArrayLike, *, spectral: Any, **known: Any) -> None:
        super().__init__(intensity, **known)
        axis = as_spectral(spectral)
        if len(axis) != self.channels:
            raise InputError(
                f"spectral has {len(axis)} places, expected one for each of {self.channels} "
                "channels; an Image has channels without them"
            )
        vars(self)["spectral"] = axis

    def at_rest(self, rest: Any) -> Cube:
        """Return the cube with a frequency (or wavelength) at rest, for velocities."""
        return self.replace(spectral=self.spectral.at_rest(rest))

    @property
    def exposure(self) -> float:
        """The automatic exposure of the picture in colours; see `Image.exposure`."""
        return super().exposure if self.channels == 1 else self.in_colors().exposure

    def in_colors(self) -> Image:
        """Return a picture of red, green and blue: what recedes, or has long waves, is red.

        The spectrum of the whole picture makes grey. `to_rgb`, PNG files and notebooks show it; for
        the same colours in several pictures give them a ``mix``.
        """
        from .spectra import in_colors

        return in_colors(self)

    def to_rgb(self, *args: Any, **options: Any) -> NDArray[np.float32]:
        """Return display values of `in_colors`; options as `Image.to_rgb` has them.

        With ``channels``, ``mix`` or ``colormap`` channels are shown as in any `Image`.
        """
        if self.channels == 1 or any(options.get(o) is not None for o in _OF_CHANNELS):
            return super().to_rgb(*args, **options)
        return self.in_colors().to_rgb(*args, **options)

    def moment(self, order: int, *, threshold: Any = None) -> Image:
        """Return a moment of the lines along velocity.

        Parameters
        ----------
        order : {0, 1, 2}
            0: the integral over velocity, in the cube's unit times km/s. 1: the mean velocity,
            Σ I v Δv / Σ I Δv, in km/s. 2: the dispersion about it, the root of the variance, in
            km/s.
        threshold : float, str or Quantity, optional
            Fainter channels of a pixel count as empty; plain numbers are in the cube's unit.

        Returns
        -------
        Image
            NaN where there is nothing: in moment 0 if every channel is below the threshold, in the
            others also where the sum is zero.

        Raises
        ------
        InputError
            If velocities need a frequency at rest (`at_rest`), or there is only one channel.

        Notes
        -----
        Of each channel its value times its width Δv. For a Gaussian line of dispersion σ this sum
        is exact to 2 exp(-2 π² σ² / Δv²), which is 5e-9 for Δv = σ.
        """
        from .spectra import moment

        return moment(self, order, threshold)

    def subtract_continuum(self, channels: Any = None, *, order: int = 0) -> Cube:
        """Return the cube without its continuum: that of channels without lines, in every pixel.

        Parameters
        ----------
        channels : slice, list of slices, mask or numbers, optional
            Channels without lines. Default: a tenth of all at each end.
        order : {0, 1}
            0 takes off their mean, 1 a straight line through them (least squares).

        Raises
        ------
        InputError
            If there are no such channels, or too few.
        """
        from .spectra import subtract_continuum

        return subtract_continuum(self, channels, order)

    def channel_maps(self, count: int | None = None) -> Cube:
        """Return means of neighbouring channels: ``cube.channel_maps().plot()`` fits on a page.

        Parameters
        ----------
        count : int, optional
            Most maps there shall be. Default: 24. A cube with fewer channels stays as it is; what
            is left over after means of equally many channels is dropped at both ends.
        """
        from .spectra import channel_maps

        return channel_maps(self, count)

    def plot(
        self,
        ax: Any = None,
        *,
        unit: UnitLike = None,
        scale_bar: Any = False,
        colorbar: bool = True,
        **options: Any,
    ) -> Any:
        """Draw a panel for each channel, with one colour scale and the beam, or one picture.

        Parameters
        ----------
        ax : matplotlib Axes or sequence of them, optional
            One for each panel, in any arrangement; or one for a picture in colours. Default: a new
            figure.
        unit : str or unit, optional
            As in `Image.plot`.
        scale_bar, colorbar
            As in `Image.plot`.
        **options
            Those of `to_rgb`. ``channels`` or ``mix`` choose channels for one picture, as an
            `Image` has it; so does a cube of one channel.

        Returns
        -------
        array of matplotlib Axes, or matplotlib Axes for one picture
        """
        alone = ax is not None and np.ndim(np.array(ax, dtype=object)) == 0
        if self.channels == 1 or alone or any(options.get(o) is not None for o in _OF_CHANNELS[:2]):
            bars = {"scale_bar": scale_bar, "colorbar": colorbar}
            return super().plot(ax, unit=unit, **bars, **options)
        from .plot import plot_maps as draw

        return draw(self, ax, unit=unit, scale_bar=scale_bar, colorbar=colorbar, **options)

    def spectrum_at(self, x: Any, y: Any, *, pixel: bool = False) -> Spectrum:
        """Return the spectrum of the pixel at a place, in the cube's unit.

        Parameters
        ----------
        x, y : float, str or Quantity
            A place on the image plane; plain numbers are in `unit`. Angles count from its origin,
            x to the right, if the cube has a `distance`.
        pixel : bool
            Take x and y as numbers of a column and a row, from 0.

        Raises
        ------
        InputError
            If it is outside the picture.
        """
        from .spectra import spectrum_at

        return spectrum_at(self, x, y, pixel)

    def total(self, *, beam: Any = None) -> Spectrum:
        """Return the flux density of the whole picture in each channel, in Jy.

        Missing pixels (NaN) count as dark.

        Parameters
        ----------
        beam : optional
            As in `to`, for a cube in units per beam.

        Raises
        ------
        UnitsError
            If a pixel has no known solid angle: give the cube a `distance`.
        """
        from .spectra import total

        return total(self, beam)

    def position_velocity(self, *points: Any, width: Any = None) -> Image:
        """Return a cut through the cube: positions along a path, and velocities.

        Parameters
        ----------
        *points : (x, y)
            Two places on the image plane or more, which the path joins by straight lines. Plain
            numbers are in `unit`; angles as in `spectrum_at`.
        width : float, str or Quantity, optional
            Mean over a strip so wide. Default: values on the path, between pixels linear.

        Returns
        -------
        Image
            With world coordinates: the offset from the first point (of type OFFSET, in arcsec if
            angles are known), and the third axis of the cube, as pvextractor writes them. NaN
            outside the cube.

        Raises
        ------
        InputError
            If a path has no length, or channels are not evenly spaced.
        """
        from .spectra import cut

        return cut(self, points, width)

    def __repr__(self) -> str:
        return super().__repr__().replace("<Image", "<Cube", 1)
