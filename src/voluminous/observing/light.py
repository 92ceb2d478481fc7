"""Stars, surfaces and backgrounds with spectra, at the frequencies of an observation."""

from __future__ import annotations

from dataclasses import replace
from numbers import Real
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError
from ..image.spectral_axis import LIGHT_MICRON, SpectralAxis
from ..objects import SceneObject, Stars
from ..objects.values import is_spectrum
from ..spectral.medium import SpectralMedium, model_of
from ..units import is_listed, is_quantity, parse_unit, plain, shown, unit_of

if TYPE_CHECKING:
    from ..media.contract import Medium
    from ..spectral.medium import Bands
    from ..volume import Volume

# How many times the unit of a channel a light may be. Single precision ends at 2^128.
_BRIGHTEST = 2.0**90
# An observer nearer than this part of the volume's width was not meant in centimetres.
_NEAREST = 1e-6
# Longer waves than those of this frequency (Hz) are not observed from space or ground. A cloud as
# luminous as the Sun (1e46 photons a second) sends one photon in a day at this hν/kT.
_LOWEST, _COLDEST = 1e5, 115.0
INTENSITY = "erg / (s cm2 Hz sr)"


def model_stars(volume: Volume) -> list[SceneObject]:
    """Return the stars of a model of RADMC-3D, as points; none of other volumes."""
    stars = model_of(volume, "model_stars").stars if "radmc3d" in volume.meta else ()
    if not stars:
        return []
    cm = 1.0 if volume.unit is None else float(parse_unit("cm").to(volume.unit))
    return [
        Stars(
            [tuple(float(x) * cm for x in star.position) for star in stars],
            [star.spectrum for star in stars],
            radii=[star.radius * cm for star in stars],
            points=True,
        )
    ]


def scene_objects(objects: Any, volume: Volume) -> list[SceneObject]:
    """Return what is drawn besides the medium: by default the stars of the volume's model."""
    things = model_stars(volume) if objects is None else objects
    if isinstance(things, SceneObject):
        return [things]
    if not is_listed(things):
        raise InputError(f"objects is a list of stars, spheres, lines …, got {things!r}")
    return list(things)


def model_background(volume: Volume) -> Any:
    """Return the external field of a model of RADMC-3D; zero for other volumes."""
    if "radmc3d" not in volume.meta:
        return 0.0
    field = model_of(volume, "model_background").external
    return 0.0 if field is None else field


def with_room_for(lights: list[Any], bands: Bands) -> Bands:
    """Return bands in whose units single precision holds all lights: objects and the background.

    Where dust is dark, far in Wien's tail, stars may be 1e60 times brighter, or more.
    """
    peaks = np.zeros(len(bands.unit))
    for light in lights:
        things = isinstance(light, SceneObject)
        colors = getattr(lit(light, bands), "colors", 0.0) if things else intensities(light, bands)
        if not _is_named(colors):
            rows = np.atleast_2d(np.asarray(colors, dtype=np.float64))
            peaks = np.maximum(peaks, rows.reshape(-1, rows.shape[-1]).max(axis=0))
    beyond = np.ceil(np.log2(np.maximum(peaks / _BRIGHTEST, 1.0)))
    return replace(bands, unit=bands.unit * 2.0**beyond) if beyond.any() else bands


def check_distance(distance: Any, volume: Volume) -> None:
    """Refuse a plain number of something else than centimetres, such as 140 for parsecs.

    Raises
    ------
    InputError
        If the observer would be a millionth of the volume's width away.
    """
    if not isinstance(distance, Real):
        return
    width = float(np.ptp(volume.grid.bounds, axis=1).max())
    width *= 1.0 if volume.unit is None else float(volume.unit.to("cm"))
    if 0.0 < distance < _NEAREST * width:  # type: ignore[operator]
        raise InputError(
            f"plain numbers are centimetres: the observer is {distance} cm from a volume of "
            f"{width:.2g} cm; give distance={distance} * u.pc"
        )


def check_channels(name: str, value: Any, medium: Medium, bands: Bands, dark: bool) -> None:
    """Refuse plain wavelengths (micron) and frequencies (Hz) at which nothing is seen.

    `dark`: nothing else shines.

    Raises
    ------
    InputError
        If they are beyond radio waves, or so far in the Wien tail that no photon is emitted.
    """
    if isinstance(value, SpectralAxis) or unit_of(value) is not None:
        return
    nu, why = bands.frequencies, f"waves longer than {LIGHT_MICRON / _LOWEST / 1e6:.0f} m"
    parts = [part for part in medium.components() if isinstance(part, SpectralMedium)]
    lowest = bands.constants.planck_exponent * nu.min() / bands.hottest
    if dark and all(part.temperatures(bands.volume) for part in parts) and lowest > _COLDEST:
        why = f"hν/kT is {lowest:.3g}, and more, where it is hottest ({bands.hottest:.3g} K)"
    elif nu.max() >= _LOWEST:
        return
    unit, meant = ("micron", "mm") if name == "wavelengths" else ("Hz", "GHz")
    raise InputError(
        f"plain numbers are {unit}, and nothing is seen there: {why}. If another unit was meant, "
        f"give it: {name}={shown(value)} * u.{meant}"
    )


def lit(thing: SceneObject, bands: Bands) -> SceneObject:
    """Return an object with its colours at the frequencies, in the units of channels."""
    colors = getattr(thing, "colors", None)
    if colors is None:
        return thing
    if is_spectrum(colors):
        listed = colors if isinstance(colors, (list, tuple)) else [colors]
        values = np.array([intensities(one, bands) for one in listed])
    elif thing.channel is not None or thing.relative or _is_named(colors):
        return thing
    else:
        values = np.asarray(_plain(colors)) / bands.unit
    return thing.replace(colors=values)


def intensities(light: Any, bands: Bands) -> np.ndarray:
    """Return the intensity of a spectrum, or of numbers, in the units of channels."""
    if is_spectrum(light):
        found = np.asarray(light.intensity(bands.frequencies, bands.constants))
    else:
        found = np.asarray(_plain(light))
    if found.ndim and found.shape[-1] not in (1, len(bands.unit)):
        raise InputError(
            f"expected an intensity, or {len(bands.unit)} (one per frequency), got shape "
            f"{found.shape}"
        )
    if np.any(found < 0.0):
        raise InputError(f"an intensity must not be negative, got {shown(light)}")
    return np.asarray(found / bands.unit)


def _plain(light: Any) -> Any:
    own = unit_of(light)
    if own is not None and own.is_equivalent("K"):
        raise InputError(f"expected an intensity, got {light}; vm.Blackbody(2.7 * u.K) is one")
    return plain(light, parse_unit(INTENSITY) if is_quantity(light) else None, "intensity")


def _is_named(colors: Any) -> bool:
    first = colors[0] if isinstance(colors, (list, tuple)) and colors else colors
    return isinstance(first, str)
