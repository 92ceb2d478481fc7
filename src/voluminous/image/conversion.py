"""Unit conversion of images: lengths on the plane, and intensities, per beam or per pixel."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..errors import UnitsError
from ..units import parse_unit
from .arguments import known_unit
from .beam import as_beam, beam_area, sky_matrix

if TYPE_CHECKING:
    from ..units import UnitLike
    from .image import Image

_SCALED = ("error", "lower", "upper")


def to_unit(image: Image, unit: UnitLike, beam: Any = None) -> Image:
    """Return the image in another unit; see `Image.to`."""
    target, on_plane = parse_unit(unit), known_unit(image.unit)
    if on_plane is None or target is None or not on_plane.is_equivalent(target):
        return _to_intensity(image, target, unit, beam)
    factor = float(on_plane.to(target))
    size = (factor * image.pixel_size[0], factor * image.pixel_size[1])
    axes = {"x": factor * image.x, "y": factor * image.y, "pixel_size": size}
    image = image.replace(unit=str(target), **axes)
    own = known_unit(image.intensity_unit)
    lengths = own is not None and own.is_equivalent(target)  # a map of depths
    return _to_intensity(image, target, unit, beam) if lengths else image


def _to_intensity(image: Image, target: Any, unit: UnitLike, beam: Any) -> Image:
    """Return the image with intensities, errors and bounds in another unit."""
    own = parse_unit(image.intensity_unit)
    if own is None:
        plane_unit = f", and its plane is in {image.unit}" if image.unit else ""
        raise UnitsError(
            f"the image's intensities have no unit{plane_unit}, so there is no {unit}; "
            "give Image(..., intensity_unit=, unit=), or emissivities with units (vm.Coefficients)"
        )
    factor = _factor(image, own, target, beam)
    planes = {name: image.plane(name) for name in _SCALED}
    scaled = {name: _scaled(p, factor) for name, p in planes.items() if p is not None}
    intensity = _scaled(image.intensity, factor)
    return image.replace(intensity=intensity, intensity_unit=target, **scaled)


def _scaled(values: NDArray[Any], factor: float) -> NDArray[Any]:
    """Return values times a factor, in double precision if single over- or underflows."""
    wide = values.astype(np.float64) * factor
    info = np.finfo(values.dtype)
    before, after = np.abs(values), np.abs(wide)
    lost = ((before >= info.tiny) & (after < info.tiny)) | (
        (before <= info.max) & (after > info.max)
    )
    return wide if lost.any() else wide.astype(values.dtype)


def _factor(image: Image, own: Any, target: Any, beam: Any) -> float:
    from astropy import units as u

    target = u.dimensionless_unscaled if target is None else target
    if own.is_equivalent(target):  # both units are per beam, or neither is
        return float(own.to(target))
    told = f"intensities in {own} cannot be converted to {target or 'no unit'}"
    for base, area in ((u.beam, _beam_area), (u.pix, _pixel_area)):
        powers = [_power(unit, base) for unit in (own, target)]
        if any(powers):
            angle = u.Unit(area(image, beam) * u.sr / base)
            own, target = (x * angle**p for x, p in zip((own, target), powers, strict=True))
    try:
        return float((own / target).to(u.dimensionless_unscaled))
    except u.UnitConversionError as error:
        raise UnitsError(
            f"{told}: a beam or a pixel is a solid angle, and leads from Jy / sr to Jy / beam"
        ) from error


def _power(unit: Any, base: Any) -> float:
    plain = unit.decompose()
    return float(dict(zip(plain.bases, plain.powers, strict=True)).get(base, 0.0))


def _beam_area(image: Image, beam: Any) -> float:
    """Return the solid angle in sr of `beam`, or else of the beam in the image's provenance."""
    told = (image.provenance or {}).get("beam") if beam is None else beam
    if told is None:
        raise UnitsError("per beam needs to know which: give beam=, or convolve the image first")
    return beam_area(image, as_beam(told))


def _pixel_area(image: Image, beam: Any) -> float:
    to_sky = sky_matrix(image)
    if to_sky is None:
        raise UnitsError(
            "per pixel needs to know the pixels' solid angle: put the image on the sky with "
            "image.on_sky(distance=, position=)"
        )
    return abs(float(np.linalg.det(to_sky))) * np.deg2rad(1.0) ** 2
