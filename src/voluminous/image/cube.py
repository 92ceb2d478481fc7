"""`Cube`: an image whose channels are wavelengths, frequencies or velocities."""

from __future__ import annotations

from typing import Any

from numpy.typing import ArrayLike

from ..errors import InputError
from .image import Image
from .spectral_axis import SpectralAxis, as_spectral


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

    def __repr__(self) -> str:
        return super().__repr__().replace("<Image", "<Cube", 1)
