"""A picture as a FITS HDU: data, world coordinates, units, the camera and how it was made."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from . import fits_axes, metadata
from .beam import fits_beam
from .celestial import on_sky
from .fits_axes import Card

if TYPE_CHECKING:
    from .image import Image

# The card with all that is known besides, as JSON.
TEXT = "VOLMETA"
_ANGLES = {"incl": "inclination", "phi": "azimuth", "posang": "position angle"}


def to_hdu(
    image: Image, distance: Any = None, position: Any = None, position_angle: Any = 0.0
) -> Any:
    """Return an astropy PrimaryHDU; see `Image.to_hdu`."""
    from astropy.io import fits

    if distance is not None or position is not None or np.any(position_angle != 0.0):
        image = on_sky(image, distance, position, position_angle)
    return fits.PrimaryHDU(channels_first(image.intensity), header=_header(image))


def channels_first(planes: NDArray[Any]) -> NDArray[Any]:
    """Return (ny, nx) for one channel, else (channel, ny, nx): x is the first axis of FITS."""
    if planes.ndim == 2:
        return planes
    return planes[..., 0] if planes.shape[-1] == 1 else np.moveaxis(planes, -1, 0)


def _header(image: Image) -> Any:
    from astropy.io import fits

    header = fits.Header()
    header["CREATOR"] = metadata.KEY
    header["BUNIT"] = (fits_axes.unit_card(image.intensity_unit), "unit of intensity")
    for keyword, value, comment in (*fits_axes.cards(image), *_camera(image), *_beam(image)):
        header[keyword] = (value, comment)
    # Quotes and ampersands have a meaning of their own in FITS strings; JSON can spell them.
    text = metadata.dumps(image, coordinates=False)
    header[TEXT] = text.replace("'", "\\u0027").replace("&", "\\u0026")
    return header


def _camera(image: Image) -> Iterator[Card]:
    camera = image.camera or {}
    if isinstance(camera.get("type"), str):
        yield "CAMERA", camera["type"], "what saw it"
    for name, what in _ANGLES.items():
        if isinstance(camera.get(name), (int, float)):
            yield name.upper(), camera[name], f"[deg] {what} of the camera"


def _beam(image: Image) -> Iterator[Card]:
    beam = fits_beam(image)
    if beam is not None:
        yield "BMAJ", beam[0], "[deg] full width of the beam at half maximum"
        yield "BMIN", beam[1], "[deg] across"
        yield "BPA", beam[2], "[deg] from north to east"
