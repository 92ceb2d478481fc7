"""FITS: everything at full precision, with a WCS that other programs understand."""

from __future__ import annotations

import warnings
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

from ...errors import FileFormatError
from .. import hdu, metadata, spectral_axis
from ..arguments import PLANES, known_unit
from ..cube import Cube
from ..fits_header import beam_of, lenient_unit, text, world_of
from ..sky import OFFSETS

if TYPE_CHECKING:
    from astropy.io.fits import HDUList, Header
    from astropy.wcs import WCS

    from ..image import Image

_COUNT = "NEXTEND"
# Types of third axes from which nobody expects a spectrum.
_NO_SPECTRUM = ("", "CHANNEL", "STOKES")
# Bytes of a block of a file, and channels that are written together: a line of the cache.
_BLOCK, _TOGETHER = 2880, 16


def write(
    image: Image, path: Path, *, distance: Any = None, position: Any = None, posang: Any = 0.0
) -> None:
    """Write intensities into the primary HDU, all other planes into image extensions.

    `distance`, `position` and `posang` are those of `Image.on_sky`.
    """
    from astropy.io import fits

    large = [hdu.to_hdu(image, distance, position, posang)]
    for name, plane in metadata.planes(image):
        large.append(fits.ImageHDU(hdu.channels_first(plane), name=name.upper()))
    # A header can only express uniform spacing; these extensions hold the exact coordinates.
    small = [fits.ImageHDU(image.x, name="X"), fits.ImageHDU(image.y, name="Y")]
    if isinstance(image, Cube):
        small += spectral_axis.hdus(image.spectral)
    last_axis = f"NAXIS{large[0].data.ndim}"
    large[0].header.set("EXTEND", True, "extensions follow", after=last_axis)
    large[0].header[_COUNT] = (len(large) + len(small) - 1, "number of extensions")
    with open(path, "wb") as file:
        for one in large:
            _write(one, file)
    with fits.open(path, mode="append", memmap=False) as hdus:
        hdus.extend(small)


def _write(one: Any, file: BinaryIO) -> None:
    """Write an image, a few channels at a time: astropy would copy all of them."""
    file.write(one.header.tostring().encode("ascii"))
    planes = one.data if one.data.ndim == 3 else one.data[None]
    kind = planes.dtype.newbyteorder(">")
    for first in range(0, len(planes), _TOGETHER):
        file.write(np.ascontiguousarray(planes[first : first + _TOGETHER], kind).data)
    file.write(bytes(-planes.nbytes % _BLOCK))


def read(path: Path) -> dict[str, Any]:
    """Read the first image of a FITS file: a plane, and channels if there is a third axis.

    Cards that another program has edited override the JSON text.
    """
    from astropy.io import fits

    doubts: list[str] = []
    # astropy does not close a truncated file that it has opened itself. All is read at once.
    with warnings.catch_warnings(), open(path, "rb") as file:
        warnings.simplefilter("ignore")
        # astropy only warns about this, and may then return a part of the file.
        warnings.filterwarnings("error", message=".*truncated.*")
        with fits.open(file, memmap=False, lazy_load_hdus=False) as hdus:
            first = next((h for h in hdus if h.is_image and h.header.get("NAXIS", 0) >= 2), None)
            if first is None:
                raise FileFormatError("expected an image with two axes or more; there is none")
            sides = first.shape[::-1]
            wcs, header = _world(first.header, sides, hdus, doubts)
            plane, channel = _axes(sides, wcs, header)
            intensity = _channels_last(first.data, [*plane, *channel])
            known = metadata.loads(header.get(hdu.TEXT), intensity.shape)
            axis = spectral_axis.read(
                header,
                hdus,
                intensity.shape[2],
                known.pop("spectral", None),
                wcs.sub([channel[0] + 1]) if channel else None,
            )
            beam = beam_of(header, hdus, intensity.shape[2])
            extras = {h.name: np.array(h.data) for h in hdus[1:] if h.is_image and h is not first}
            found, count = len(hdus) - 1, header.get(_COUNT, 0)
    if hdu.TEXT in header and found < count:
        raise FileFormatError(f"expected {count} extensions, found {found}: the file is cut short")
    shape = intensity.shape
    image = known
    if axis is not None:
        image = {**known, "spectral": axis}
    elif channel and (kind := text(header, f"CTYPE{channel[0] + 1}")) not in _NO_SPECTRUM:
        doubts.append(f"its axis {kind} is no spectrum: channels have numbers only")
    how = known.get("provenance") or {}
    if beam is not None and "beam" not in how:
        image["provenance"] = {**how, "beam": beam}
    unit, bright = image.pop("unit", ""), image.pop("intensity_unit", "")
    numbers = [k + 1 for k in plane]
    axes = hdu.read(header, numbers, shape, extras, image.pop("pixel_size", None))
    if axes and axes["unit"] in (None, hdu.unit_card(unit)):
        axes["unit"] = unit
    card = str(header.get("BUNIT", ""))
    for name in PLANES:
        extra = extras.get(name.upper())
        if extra is not None and extra.ndim >= 2 and extra.shape[-2:] == shape[:2]:
            image[name] = _channels_last(extra, list(range(min(extra.ndim, 3))))
    place = wcs.sub(numbers)
    place.pixel_shape = shape[1::-1]
    # Axes without a name, or named X and Y, as `write` does it, are plain coordinates.
    kinds = list(place.wcs.ctype)
    plain = not all(kinds) or kinds == ["X", "Y"] or header.get("WCSNAME") == OFFSETS
    image |= {"intensity": intensity, "wcs": None if plain else place, **axes}
    for doubt in doubts:
        warnings.warn(f"{path}: {doubt}", stacklevel=5)
    return {**image, "intensity_unit": bright if card == hdu.unit_card(bright) else _unit(card)}


def _world(
    header: Header, sides: tuple[int, ...], hdus: HDUList, doubts: list[str]
) -> tuple[WCS, Header]:
    """Return the WCS of a header, and the header as it is meant.

    A plane without a usable one remains a picture; a cube would lose its spectrum.
    """
    from astropy.wcs import WCS

    try:
        return world_of(header, sides, lambda: nullcontext(hdus))
    except Exception as error:  # wcslib and astropy raise many exception types
        reason = f"its world coordinates cannot be used ({str(error).strip().splitlines()[-1]})"
        if sum(n > 1 for n in sides) > 2:
            raise FileFormatError(f"{reason}; vm.open reads it with wcs=False") from error
        doubts.append(reason)
        return WCS(naxis=len(sides)), header


def _axes(sides: tuple[int, ...], wcs: WCS, header: Header) -> tuple[list[int], list[int]]:
    """Return the axes (0 is NAXIS1) along x and y, and that of the channels, if any."""
    every, spectral = range(len(sides)), wcs.wcs.spec
    plane = [wcs.wcs.lng, wcs.wcs.lat]
    if not set(plane) <= set(every):  # no sky: what is no spectrum comes first
        long = [k for k in every if k < 2 or sides[k] > 1]
        plane = sorted(sorted(long, key=lambda k: k == spectral)[:2])
    # Radio images have an axis of one polarisation.
    others = [k for k in every if k not in plane and (sides[k] > 1 or k == spectral)]
    if len(others) > 1:
        listed = ", ".join(f"{text(header, f'CTYPE{k + 1}') or '?'} of {sides[k]}" for k in every)
        raise FileFormatError(
            f"expected an image of two or three axes, got {listed}; write one plane of the others"
        )
    return plane, others


def _unit(text: str) -> str:
    """Return a unit as astropy writes it, unless it reads the text; a text that is none stays."""
    meant = None if known_unit(text) is not None else lenient_unit(text)
    return text if meant is None else str(meant)


def _channels_last(data: Any, axes: list[int]) -> np.ndarray:
    """Return an array (ny, nx, channel); `axes` (0 is NAXIS1) are along x, y and the channels."""
    array = np.asarray(data)
    if array.dtype.byteorder == ">" and array.flags.writeable:  # in place: no second cube
        array = array.byteswap(inplace=True).view(array.dtype.newbyteorder("="))
    last = array.ndim - 1
    rest = [k for k in range(array.ndim) if k not in axes]  # of length one
    array = array.transpose([last - k for k in (axes[1], axes[0], *axes[2:], *rest)])
    return np.asarray(array.reshape(*array.shape[:2], -1))
