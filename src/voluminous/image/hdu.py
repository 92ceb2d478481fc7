"""Pixel coordinates as FITS cards: a linear WCS (Greisen & Calabretta 2002, A&A 395, 1061)."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from . import metadata
from .beam import fits_beam
from .sky import on_sky

if TYPE_CHECKING:
    from astropy.io.fits import Header, PrimaryHDU

    from .image import Image


Card = tuple[str, Any, str]
Linear = tuple[NDArray[np.float64], float]  # coordinates and their step
# Key and name of the WCS of the image plane in files whose first one is of the sky.
_PLANE, _PLANE_NAME = "A", "image plane"
# The spelling that radio astronomy software writes and expects.
_PER_BEAM = "Jy/beam"
# Coordinates this near to a linear axis (in pixels) count as linear; rounding is far below.
_LINEAR_TO = 1e-6
# Kinds of axes that are in degrees unless their header says otherwise.
_ON_SKY = re.compile("RA--|DEC-|[A-Z]{1,2}L(ON|AT)-")


def cards(image: Image) -> Iterator[Card]:
    """Yield the cards for x, y and, if there are several, the channels."""
    axes = 2 if image.channels == 1 else 3
    yield "WCSAXES", axes, "number of axes"
    if image.wcs is not None:
        world = image.wcs.to_header(relax=True).cards
        yield from (tuple(card) for card in world if card.keyword != "WCSAXES")
    yield from _plane_cards(image, "" if image.wcs is None else _PLANE)
    if axes == 3:
        indices = np.arange(image.channels, dtype=np.float64)
        yield from _axis_cards(3, "CHANNEL", indices, 1.0, "")


def _plane_cards(image: Image, key: str) -> Iterator[Card]:
    if key:
        yield f"WCSAXES{key}", 2, "number of axes"
        yield f"WCSNAME{key}", _PLANE_NAME, "coordinates on the image plane"
    yield from _axis_cards(1, "X", image.x, image.pixel_size[0], image.unit, key)
    yield from _axis_cards(2, "Y", image.y, image.pixel_size[1], image.unit, key)


def _axis_cards(
    number: int, name: str, centres: NDArray[np.float64], step: float, unit: str, key: str = ""
) -> Iterator[Card]:
    middle = (centres.size + 1) / 2
    value = (centres[0] + centres[-1]) / 2
    if not _agree(centres, _linear(centres.size, middle, value, step), step):
        return  # uneven spacing: no card can express it
    yield f"CTYPE{number}{key}", name, "linear"
    yield f"CRPIX{number}{key}", middle, "reference pixel; centre of the first is 1"
    yield f"CRVAL{number}{key}", float(value), "coordinate there"
    yield f"CDELT{number}{key}", step, "size of a pixel"
    if unit:
        yield f"CUNIT{number}{key}", unit_card(unit), "unit"


def _linear(count: int, pixel: float, value: float, step: float) -> NDArray[np.float64]:
    return np.float64(value) + step * (np.arange(1, count + 1, dtype=np.float64) - pixel)


def _agree(a: NDArray[np.float64], b: NDArray[np.float64], step: float) -> bool:
    return a.shape == b.shape and bool((np.abs(a - b) <= _LINEAR_TO * abs(step)).all())


def unit_card(unit: str) -> str:
    """Return the FITS name of a unit; the given name, in ASCII, if FITS has none."""
    if not unit:
        return ""
    from astropy import units as u

    try:
        parsed = u.Unit(unit)
        return _PER_BEAM if parsed == u.Unit(_PER_BEAM) else parsed.to_string("fits")
    except (ValueError, TypeError):
        return unit.encode("ascii", "replace").decode()[:68]


def read(
    header: Header, shape: tuple[int, ...], extras: dict[str, NDArray[Any]], pixel_size: Any
) -> dict[str, Any]:
    """Return those of x, y, unit and pixel_size that the header and the extensions define.

    The exact coordinates (extensions X and Y) are valid unless the header was edited afterwards.
    For a sky projection, coordinates are those of the projection plane: offsets from the reference
    point. Rotated axes have no separate coordinates and stay pixel indices. The unit is None if
    no card can express it, because both axes are uneven.
    """
    # If the first WCS is celestial, the plane's is the second, unless the picture was cropped.
    whole = [extras[axis].shape for axis in "XY" if axis in extras] == [shape[1:2], shape[:1]]
    key = _PLANE if whole and header.get(f"WCSNAME{_PLANE}") == _PLANE_NAME else ""
    across, up = (_linear_axis(header, n, shape[2 - n], key) for n in (1, 2))
    units = {_unit(header, n, key) for n, told in ((1, across), (2, up)) if told is not None}
    if len(units) > 1:
        return {}
    unit = units.pop() if units else None
    x = _untouched(extras.get("X"), across, shape[1])
    y = _untouched(extras.get("Y"), up, shape[0])
    if x is not None and y is not None:
        return {"x": x, "y": y, "unit": unit, "pixel_size": pixel_size}
    if across is None or up is None:
        return {}
    size = (across[1], up[1])
    return {"x": across[0], "y": up[0], "unit": unit, "pixel_size": size}


def _untouched(own: NDArray[Any] | None, axis: Linear | None, count: int) -> NDArray[Any] | None:
    """Return the exact coordinates if they still match the image and the cards."""
    if own is None or own.shape != (count,):
        return None
    return own if axis is None or _agree(own, *axis) else None


def _unit(header: Header, number: int, key: str) -> str:
    """Return the unit of an axis; celestial axes default to degrees."""
    default = "deg" if _ON_SKY.match(str(header.get(f"CTYPE{number}{key}", ""))) else ""
    return str(header.get(f"CUNIT{number}{key}", "")).strip() or default


def _linear_axis(header: Header, number: int, count: int, key: str) -> Linear | None:
    step = header.get(f"CDELT{number}{key}", header.get(f"CD{number}_{number}{key}"))
    other = 3 - number
    rotated = any(header.get(f"{m}{number}_{other}{key}", 0.0) for m in ("CD", "PC"))
    rotated |= any(header.get(f"CROTA{n}{key}", 0.0) for n in (1, 2))  # as AIPS writes it
    if not step or rotated:
        return None
    projected = "-" in str(header.get(f"CTYPE{number}{key}", ""))
    value = 0.0 if projected else header.get(f"CRVAL{number}{key}", 0.0)
    return _linear(count, header.get(f"CRPIX{number}{key}", 0.0), value, step), step


# The card with all other metadata, as JSON.
TEXT = "VOLMETA"
_ANGLES = {"incl": "inclination", "phi": "azimuth", "posang": "position angle"}


def to_hdu(
    image: Image, distance: Any = None, position: Any = None, posang: Any = 0.0
) -> PrimaryHDU:
    """Return an astropy PrimaryHDU; see `Image.to_hdu`."""
    from astropy.io import fits

    if distance is not None or position is not None or np.any(posang != 0.0):
        image = on_sky(image, distance, position, posang)
    return fits.PrimaryHDU(channels_first(image.intensity), header=_header(image))


def channels_first(planes: NDArray[Any]) -> NDArray[Any]:
    """Return (ny, nx) for one channel, else (channel, ny, nx): x is the first axis of FITS."""
    if planes.ndim == 2:
        return planes
    return planes[..., 0] if planes.shape[-1] == 1 else np.moveaxis(planes, -1, 0)


def _header(image: Image) -> Header:
    from astropy.io import fits

    header = fits.Header()
    header["CREATOR"] = metadata.KEY
    header["BUNIT"] = (unit_card(image.intensity_unit), "unit of intensity")
    for keyword, value, comment in (*cards(image), *_camera(image), *_beam(image)):
        header[keyword] = (value, comment)
    # Quotes and ampersands are special in FITS strings; JSON can escape them.
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
