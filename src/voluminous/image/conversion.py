"""Unit conversion of images: lengths on the plane, and intensities, per beam or per pixel."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import UnitsError
from ..units import parse_unit
from .arguments import known_unit
from .beam import as_beam, beam_area, sky_matrix

if TYPE_CHECKING:
    from ..units import UnitLike
    from .image import Image


def to_unit(image: Image, unit: UnitLike, beam: Any = None) -> Image:
    """Return the image in another unit; see `Image.to`."""
    target, on_plane = parse_unit(unit), known_unit(image.unit)
    if on_plane is not None and target is not None and on_plane.is_equivalent(target):
        factor = float(on_plane.to(target))
        width, height = image.pixel_size
        size = (factor * width, factor * height)
        x, y = factor * image.x, factor * image.y
        image = image.replace(unit=str(target), x=x, y=y, pixel_size=size)
        own = known_unit(image.intensity_unit)
        if own is None or not own.is_equivalent(target):  # else a map of depths: convert both
            return image
    own = parse_unit(image.intensity_unit)
    if own is None:
        plane_unit = f", and its plane is in {image.unit}" if image.unit else ""
        raise UnitsError(
            f"the image's intensities have no unit{plane_unit}, so there is no {unit}; "
            "give Image(..., intensity_unit=, unit=), or emissivities with units (vm.Coefficients)"
        )
    factor = _factor(image, own, target, beam)
    scaled = {
        name: _scaled(plane, factor)
        for name in ("intensity", "error", "lower", "upper")
        if (plane := image.plane(name)) is not None
    }
    return image.replace(intensity_unit=target, **scaled)


def _scaled(values: np.ndarray, factor: float) -> np.ndarray:
    """Return values times a factor, in double precision if single over- or underflows."""
    wide = values.astype(np.float64) * factor
    info = np.finfo(values.dtype)
    before, after = np.abs(values), np.abs(wide)
    lost = (before >= info.tiny) & (after < info.tiny) | (before <= info.max) & (after > info.max)
    return wide if lost.any() else wide.astype(values.dtype)


def _factor(image: Image, own: Any, target: Any, beam: Any) -> float:
    """Return the factor from one unit to another, with solid angles of beams and pixels."""
    from astropy import units as u

    target = u.dimensionless_unscaled if target is None else target
    if own.is_equivalent(target):  # both units are per beam, or neither is
        return float(own.to(target))
    message = f"intensities in {own} cannot be converted to {target or 'no unit'}"
    for base, area in ((u.beam, _beam_area), (u.pix, _pixel_area)):
        powers = []
        for unit in (own, target):
            plain = unit.decompose()
            powers.append(float(dict(zip(plain.bases, plain.powers, strict=True)).get(base, 0.0)))
        if any(powers):
            angle = u.Unit(area(image, beam) * u.sr / base)
            own, target = own * angle ** powers[0], target * angle ** powers[1]
    try:
        return float((own / target).to(u.dimensionless_unscaled))
    except u.UnitConversionError as error:
        raise UnitsError(
            f"{message}: a beam or a pixel is a solid angle, and leads from Jy / sr to Jy / beam"
        ) from error


def _beam_area(image: Image, beam: Any) -> float:
    """Return the solid angle in sr of `beam`, or else of the beam in the image's provenance."""
    known = (image.provenance or {}).get("beam") if beam is None else beam
    if known is None:
        raise UnitsError("per beam needs to know which: give beam=, or convolve the image first")
    return beam_area(image, as_beam(known))


def _pixel_area(image: Image, beam: Any) -> float:
    to_sky = sky_matrix(image)
    if to_sky is None:
        raise UnitsError(
            "per pixel needs to know the pixels' solid angle: put the image on the sky with "
            "image.on_sky(distance=, position=)"
        )
    return abs(float(np.linalg.det(to_sky))) * float(np.deg2rad(1.0)) ** 2
