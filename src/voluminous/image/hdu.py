"""Pixel coordinates as FITS cards: a linear WCS (Greisen & Calabretta 2002, A&A 395, 1061)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from . import metadata, spectral_axis
from .conversion import fits_beam
from .cube import Cube
from .fits_header import ON_SKY
from .sky import offsets, on_sky

if TYPE_CHECKING:
    from astropy.io.fits import Header, PrimaryHDU

    from .image import Image


Card = tuple[str, Any, str]
Linear = tuple[np.ndarray, float]  # coordinates and their step
# The card with all other metadata, as JSON.
TEXT = "VOLMETA"
# Key and name of the WCS of the image plane in files whose first one is of the sky.
_PLANE, _PLANE_NAME = "A", "image plane"
# How radio astronomy software spells what is per beam or pixel.
_PER = {"beam": "/beam", "pix": "/pixel"}
# Coordinates this near to a linear axis (in pixels) count as linear; rounding is far below.
_LINEAR_TO = 1e-6
_ANGLES = {"incl": "inclination", "phi": "azimuth", "posang": "position angle"}


def to_hdu(
    image: Image, distance: Any = None, position: Any = None, posang: Any = 0.0
) -> PrimaryHDU:
    """Return an astropy PrimaryHDU; see `Image.to_hdu`."""
    from astropy.io import fits

    if distance is not None or position is not None or np.any(posang != 0.0):
        image = on_sky(image, distance, position, posang)
    header = fits.Header()
    header["CREATOR"] = metadata.KEY
    header["BUNIT"] = (unit_card(image.intensity_unit), "unit of intensity")
    for keyword, value, comment in _cards(image):
        header[keyword] = (value, comment)
    header[TEXT] = metadata.fits_text(metadata.dumps(image, coordinates=False))
    planes = channels_first(image.intensity)
    if isinstance(image, Cube) and planes.ndim == 2:
        planes = planes[None]  # a single channel, too, has an axis that says which
    return fits.PrimaryHDU(planes, header=header)


def channels_first(planes: np.ndarray) -> np.ndarray:
    """Return (ny, nx) for one channel, else (channel, ny, nx): x is the first axis of FITS."""
    if planes.ndim == 2:
        return planes
    return planes[..., 0] if planes.shape[-1] == 1 else np.moveaxis(planes, -1, 0)


def _cards(image: Image) -> Iterator[Card]:
    several = image.channels > 1 or isinstance(image, Cube)
    yield "WCSAXES", 2 + several, "number of axes"
    key, wcs = "", offsets(image) if image.wcs is None else image.wcs
    if wcs is not None:
        world = wcs.to_header(relax=True).cards
        yield from (tuple(card) for card in world if card.keyword != "WCSAXES")
        if image.wcs is None:
            yield "WCSNAME", wcs.wcs.name, "from the origin; its position is not known"
        key = _PLANE
        yield f"WCSAXES{key}", 2, "number of axes"
        yield f"WCSNAME{key}", _PLANE_NAME, "coordinates on the image plane"
    yield from _axis_cards(f"1{key}", "X", image.x, image.pixel_size[0], image.unit)
    yield from _axis_cards(f"2{key}", "Y", image.y, image.pixel_size[1], image.unit)
    if isinstance(image, Cube):
        yield from spectral_axis.cards(image.spectral)
    elif several:
        yield from _axis_cards("3", "CHANNEL", np.arange(float(image.channels)), 1.0, "")
    camera = image.camera or {}
    if isinstance(camera.get("type"), str):
        yield "CAMERA", camera["type"], "what saw it"
    for name, what in _ANGLES.items():
        if isinstance(camera.get(name), (int, float)):
            yield name.upper(), camera[name], f"[deg] {what} of the camera"
    if (beam := fits_beam(image)) is not None:
        yield "BMAJ", beam[0], "[deg] full width of the beam at half maximum"
        yield "BMIN", beam[1], "[deg] across"
        yield "BPA", beam[2], "[deg] from north to east"


def _axis_cards(
    number: str, name: str, centres: np.ndarray, step: float, unit: str
) -> Iterator[Card]:
    middle = (centres.size + 1) / 2
    value = (centres[0] + centres[-1]) / 2
    if not _agree(centres, _linear(centres.size, middle, value, step)):
        return  # uneven spacing: no card can express it
    yield f"CTYPE{number}", name, "linear"
    yield f"CRPIX{number}", middle, "reference pixel; centre of the first is 1"
    yield f"CRVAL{number}", float(value), "coordinate there"
    yield f"CDELT{number}", step, "size of a pixel"
    if unit:
        yield f"CUNIT{number}", unit_card(unit), "unit"


def _linear(count: int, pixel: float, value: float, step: float) -> Linear:
    return np.float64(value) + step * (np.arange(1, count + 1, dtype=np.float64) - pixel), step


def _agree(centres: np.ndarray, axis: Linear) -> bool:
    expected, step = axis
    same = centres.shape == expected.shape
    return same and bool((np.abs(centres - expected) <= _LINEAR_TO * abs(step)).all())


def unit_card(unit: str) -> str:
    """Return the FITS name of a unit; the given name, in ASCII, if FITS has none."""
    if not unit:
        return ""
    from astropy import units as u

    try:
        parsed = u.Unit(unit)
        for name, ending in _PER.items():
            above = (parsed * u.Unit(name)).to_string("fits")
            if above.isalpha() and name not in above:
                return f"{above}{ending}"
        return str(parsed.to_string("fits"))
    except (ValueError, TypeError, u.UnitsError):  # dex, among others
        return unit.encode("ascii", "replace").decode()[:68]


def read(
    header: Header,
    plane: list[int],
    shape: tuple[int, ...],
    extras: dict[str, np.ndarray],
    pixel_size: Any,
) -> dict[str, Any]:
    """Return those of x, y, unit and pixel_size that the header and the extensions define.

    `plane` are the numbers, from 1, of the axes along x and y.
    The exact coordinates (extensions X and Y) are valid unless the header was edited afterwards.
    For a sky projection, coordinates are those of the projection plane: offsets from the reference
    point. Rotated axes have no separate coordinates and stay pixel indices. The unit is None if
    no card can express it, because both axes are uneven.
    """
    counts = (shape[1], shape[0])
    exact = [extras[name] for name in "XY" if name in extras]
    whole = [centres.shape for centres in exact] == [(count,) for count in counts]
    # If the first WCS is celestial, the plane's is the second, unless the picture was cropped.
    key = _PLANE if whole and header.get(f"WCSNAME{_PLANE}") == _PLANE_NAME else ""
    axes = [_linear_axis(header, plane[k], plane[1 - k], counts[k], key) for k in (0, 1)]
    units = set()
    for n, axis in zip(plane, axes, strict=True):
        if axis is not None:
            default = "deg" if ON_SKY.match(str(header.get(f"CTYPE{n}{key}", ""))) else ""
            units.add(str(header.get(f"CUNIT{n}{key}", "")).strip() or default)
    if len(units) > 1:
        return {}
    unit = next(iter(units), None)
    if whole and all(a is None or _agree(c, a) for c, a in zip(exact, axes, strict=True)):
        return {"x": exact[0], "y": exact[1], "unit": unit, "pixel_size": pixel_size}
    across, up = axes
    if across is None or up is None:
        return {}
    return {"x": across[0], "y": up[0], "unit": unit, "pixel_size": (across[1], up[1])}


def _linear_axis(header: Header, number: int, other: int, count: int, key: str) -> Linear | None:
    step = header.get(f"CD{number}_{number}{key}", header.get(f"CDELT{number}{key}", 0.0))
    step *= header.get(f"PC{number}_{number}{key}", 1.0)
    rotated = any(header.get(f"{m}{number}_{other}{key}", 0.0) for m in ("CD", "PC"))
    rotated |= any(header.get(f"CROTA{n}{key}", 0.0) for n in (number, other))  # AIPS writes it
    if not step or rotated:
        return None
    projected = "-" in str(header.get(f"CTYPE{number}{key}", ""))
    value = 0.0 if projected else header.get(f"CRVAL{number}{key}", 0.0)
    return _linear(count, header.get(f"CRPIX{number}{key}", 0.0), value, step)
