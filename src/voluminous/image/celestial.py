"""The plane of a picture as a part of the sky: a projection around a position, at a distance."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError, UnitsError
from ..units import as_quantity, degrees, is_quantity, parse_unit
from .changed import changed

if TYPE_CHECKING:
    from .image import Image

# A picture's pixels must be as even as this part of one, for a header has but one size of them.
_EVEN_TO = 1e-6


def on_sky(image: Image, distance: Any, position: Any, position_angle: Any) -> Image:
    """Return the image with celestial world coordinates; see `Image.on_sky`."""
    scale, projection = _plane(image, distance)
    steps = np.array(image.pixel_size) * scale
    reference = [
        _zero(c, step) for c, step in zip((image.x, image.y), image.pixel_size, strict=True)
    ]
    center = as_position(position)
    wcs = _frame_wcs(center, projection)
    angle = np.deg2rad(_finite(degrees(position_angle, "position_angle"), "position_angle"))
    wcs.wcs.crpix = reference
    # Seen from here east is on the left: right ascension grows against x.
    wcs.wcs.cdelt = np.rad2deg([-steps[0], steps[1]])
    # Up is north turned towards east. The angle belongs to lengths: pixels may be oblong.
    c, s, ratio = np.cos(angle), np.sin(angle), steps[1] / steps[0]
    wcs.wcs.pc = [[c, -s * ratio], [s / ratio, c]]
    wcs.pixel_shape = (image.shape[1], image.shape[0])
    wcs.wcs.set()
    return changed(image, wcs=wcs)


def _plane(image: Image, distance: Any) -> tuple[float, str]:
    """Return radians per unit of the picture's plane at its middle, and the projection's name.

    Seen from one point, the plane is a screen at unit distance, or a dome. Parallel rays show a
    plane through the object, which is a screen at its distance.
    """
    unit = parse_unit(image.unit)
    if unit is not None and unit.is_equivalent("rad"):
        if distance is not None:
            raise InputError(
                f"this picture's plane is measured in {image.unit}, so it has no distance; "
                "leave distance= out"
            )
        dome = (image.camera or {}).get("projection") == "spherical"
        return float(unit.to("rad")), "ARC" if dome else "TAN"
    if distance is None:
        raise InputError(
            "a picture on the sky needs distance=, such as 140 * u.pc, and position= of its origin"
        )
    return 1.0 / _length(distance, image.unit), "TAN"


def _length(distance: Any, unit: str) -> float:
    from astropy import units as u

    distance = as_quantity(distance)
    try:
        given = u.Quantity(distance) if is_quantity(distance) or isinstance(distance, str) else None
        own = u.Unit(unit or "")
        value = float(distance) if given is None else given.to_value(own)
    except (u.UnitConversionError, TypeError, ValueError) as error:
        raise UnitsError(
            f"distance must be a length such as 140 * u.pc, got {distance!r}; the picture's plane "
            f"is in {unit or 'no unit'}"
        ) from error
    if not np.isfinite(value) or value <= 0:
        raise InputError(f"distance must be positive and finite, got {distance!r}")
    return float(value)


def as_position(position: Any) -> Any:
    """Return a place on the sky as one SkyCoord.

    Parameters
    ----------
    position : SkyCoord, (ra, dec) or str
        Plain numbers are degrees, texts such as ``"05h35m17.3s -05d23m28s"``; both ICRS.

    Raises
    ------
    InputError
        If it is something else.
    """
    from astropy.coordinates import SkyCoord

    if position is None:
        raise InputError(
            "a picture on the sky needs position= of its origin: a SkyCoord or (ra, dec) in degrees"
        )
    try:
        if isinstance(position, SkyCoord):
            found = position
        elif isinstance(position, str):
            found = SkyCoord(position)
        else:
            ra, dec = (_finite(degrees(angle, "position"), "position") for angle in position)
            found = SkyCoord(ra, dec, unit="deg")
        if found.isscalar:
            _finite(found.spherical.lon.deg + found.spherical.lat.deg, "position")
    except (ValueError, TypeError, UnitsError) as error:
        raise InputError(
            f"position must be a SkyCoord, (ra, dec) in degrees or a text such as "
            f"'05h35m17.3s -05d23m28s', got {position!r}: {error}"
        ) from error
    if not found.isscalar:
        raise InputError(f"position must be one place on the sky, got {found.shape} of them")
    return found


def _finite(angle: float, what: str) -> float:
    if not np.isfinite(angle):
        raise InputError(f"{what} must be finite, got {angle} degrees")
    return angle


def _frame_wcs(center: Any, projection: str) -> Any:
    from astropy.wcs.utils import celestial_frame_to_wcs

    try:
        wcs = celestial_frame_to_wcs(center.frame, projection=projection)
    except ValueError:  # a frame that FITS has no name for
        center = center.icrs
        wcs = celestial_frame_to_wcs(center.frame, projection=projection)
    sphere = center.spherical
    wcs.wcs.crval = [sphere.lon.wrap_at("360d").deg, sphere.lat.deg]
    return wcs


def _zero(centres: np.ndarray, step: float) -> float:
    even = centres[0] + step * np.arange(centres.size)
    if np.abs(even - centres).max() > _EVEN_TO * abs(step):
        raise InputError("the pixels of this picture are not evenly spaced, as FITS needs them")
    return float(1.0 - centres[0] / step)
