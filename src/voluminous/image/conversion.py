"""Unit conversion of images: lengths on the plane, and intensities, per beam, pixel or channel."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import UnitsError
from ..units import parse_unit
from .arguments import Array, known_unit
from .beam import angle_matrix, as_beam, beam_area
from .cube import Cube
from .sky import plane_factor

if TYPE_CHECKING:
    from ..units import UnitLike
    from .image import Image, Own

# Rows of a cube are treated together up to so many numbers: what is made on the way stays small.
_TOGETHER = 2**20


def to_unit(image: Own, unit: UnitLike, beam: Any = None) -> Own:
    """Return the image in another unit; see `Image.to`."""
    target, on_plane = parse_unit(unit), known_unit(image.unit)
    known = on_plane is not None and target is not None
    if known and (scale := plane_factor(image, on_plane, target)) is not None:
        width, height = image.pixel_size
        size = (scale * width, scale * height)
        x, y = scale * image.x, scale * image.y
        image = image.replace(unit=str(target), x=x, y=y, pixel_size=size)
        present = known_unit(image.intensity_unit)
        if present is None or not present.is_equivalent(
            target
        ):  # else a map of depths: convert both
            return image
    present = parse_unit(image.intensity_unit)
    if present is None:
        plane_unit = f", and its plane is in {image.unit}" if image.unit else ""
        raise UnitsError(
            f"the image's intensities have no unit{plane_unit}, so there is no {unit}; "
            "give Image(..., intensity_unit=, unit=), or emissivities with units (vm.Coefficients)"
        )
    factor = conversion(image, present, target, beam)
    scaled = {
        name: _scaled(plane, factor)
        for name in ("intensity", "lower", "upper")
        if (plane := image.plane(name)) is not None
    }
    if image.error is not None:  # a fraction of the largest intensity, in every channel
        both = (image.intensity, scaled["intensity"])
        largest = [max(np.nanmax(values), -np.nanmin(values)) for values in both]
        same = np.ndim(factor) == 0 or not 0 < largest[0] < np.inf
        factor = np.max(factor) if same else largest[1] / largest[0]
        scaled["error"] = _scaled(image.error, factor)
    return image.replace(intensity_unit=target, **scaled)


def rows_of(cube: Image) -> Iterator[slice]:
    """Return slices of a few rows each, which cover the picture."""
    ny, nx, count = cube.shape
    step = max(1, _TOGETHER // (nx * count))
    return (slice(first, min(first + step, ny)) for first in range(0, ny, step))


def _scaled(values: Array, factor: Any) -> Array:
    info = np.finfo(values.dtype)
    result = np.empty(values.shape, values.dtype)
    parts = max(1, values.size // _TOGETHER)
    for old, new in zip(np.array_split(values, parts), np.array_split(result, parts), strict=True):
        wide = old.astype(np.float64) * factor
        before, after = np.abs(old), np.abs(wide)
        lost = before >= info.tiny
        lost &= after < info.tiny
        lost |= (before <= info.max) & (after > info.max)
        if lost.any() and values.dtype != np.float64:
            return np.asarray(values * np.asarray(factor, np.float64), np.float64)
        new[...] = wide
    return result


def conversion(image: Image, present: Any, target: Any, beam: Any = None) -> Any:
    """Return the factor from one unit to another, with solid angles of beams and pixels.

    Of a cube it may differ between channels: brightness temperatures by the law of Rayleigh and
    Jeans, T = c² I / (2 k ν²), as radio astronomers define them, and what is per wavelength.
    """
    from astropy import units as u

    target = u.dimensionless_unscaled if target is None else target
    if beam is not None and u.beam not in (*present.decompose().bases, *target.decompose().bases):
        raise UnitsError(
            f"beam= is for units per beam, but it is from {present} to {target}: leave it out"
        )
    if present.is_equivalent(target):  # both units are per beam, or neither is
        return float(present.to(target))
    angles: Any = 1.0
    message = f"intensities in {present} cannot be converted to {target or 'no unit'}"
    for base, area in ((u.beam, _beam_area), (u.pix, _pixel_area)):
        powers = []
        for unit in (present, target):
            plain = unit.decompose()
            powers.append(float(dict(zip(plain.bases, plain.powers, strict=True)).get(base, 0.0)))
        if any(powers):
            angles = angles * area(image, beam) ** (powers[0] - powers[1])  # beams may differ
            present, target = (
                x * (u.sr / base) ** power
                for x, power in zip((present, target), powers, strict=True)
            )
    if present.is_equivalent(target):
        return angles * float((present / target).to(u.dimensionless_unscaled))
    if target.is_equivalent(u.rad) and not present.is_equivalent(u.rad):
        raise UnitsError(
            f"{message}, nor lengths on the image plane: say how far it is with "
            "image.replace(distance=140 * u.pc)"
        )
    if not isinstance(image, Cube):
        hint = "a beam or a pixel is a solid angle, and leads from Jy / sr to Jy / beam"
        if target.is_equivalent(u.K):
            hint = "a temperature needs the frequency of each channel: see vm.Cube"
        raise UnitsError(f"{message}: {hint}")
    nu = image.spectral.frequencies * u.Hz
    laws = u.brightness_temperature(nu) + u.spectral_density(nu)
    try:
        factor = present.to(target, np.ones(len(nu)), equivalencies=laws)
        return np.asarray(angles * factor, np.float64)
    except u.UnitConversionError as error:
        raise UnitsError(
            f"{message}: a beam or a pixel is a solid angle, and leads from Jy / sr to Jy / beam"
        ) from error


def _beam_area(image: Image, beam: Any) -> Any:
    """Return the solid angle in sr of `beam`, or else of the beam in the image's provenance."""
    known = (image.provenance or {}).get("beam") if beam is None else beam
    if known is None:
        raise UnitsError("per beam needs to know which: give beam=, or convolve the image first")
    return beam_area(image, as_beam(known))


def _pixel_area(image: Image, beam: Any) -> float:
    to_sky = angle_matrix(image)
    if to_sky is None:
        raise UnitsError(
            "per pixel needs to know the pixels' solid angle: say how far the image is with "
            "image.replace(distance=140 * u.pc), or image.on_sky(distance=, position=)"
        )
    return abs(float(np.linalg.det(to_sky))) * float(np.deg2rad(1.0)) ** 2
