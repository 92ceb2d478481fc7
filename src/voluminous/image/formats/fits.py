"""FITS: everything at full precision, with a WCS that other programs understand."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

from ...errors import FileFormatError
from .. import hdu, metadata, spectral_fits
from ..arguments import PLANES
from ..cube import Cube
from ..sky import wcs_of_header

if TYPE_CHECKING:
    from ..image import Image

_COUNT = "NEXTEND"
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
        small += spectral_fits.hdus(image.spectral)
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
    """Read the first image of a FITS file, with two axes or channels as the third.

    Cards that another program has edited override the JSON text.
    """
    from astropy.io import fits

    # astropy does not close a truncated file that it has opened itself. All is read at once.
    with warnings.catch_warnings(), open(path, "rb") as file:
        warnings.simplefilter("ignore")
        # astropy only warns about this, and may then return a part of the file.
        warnings.filterwarnings("error", message=".*truncated.*")
        with fits.open(file, memmap=False, lazy_load_hdus=False) as hdus:
            first = next((h for h in hdus if h.is_image and h.header.get("NAXIS", 0) >= 2), None)
            if first is None:
                raise FileFormatError("expected an image with two axes or more; there is none")
            header = first.header
            intensity = _channels_last(first.data, spectral_fits.number(header))
            known = metadata.loads(header.get(hdu.TEXT), intensity.shape)
            axis = spectral_fits.read(header, hdus, intensity.shape[2], known.pop("spectral", None))
            extras = {h.name: np.array(h.data) for h in hdus[1:] if h.is_image and h is not first}
            found, count = len(hdus) - 1, header.get(_COUNT, 0)
    if hdu.TEXT in header and found < count:
        raise FileFormatError(f"expected {count} extensions, found {found}: the file is cut short")
    shape = intensity.shape
    image = known
    if axis is not None:
        how, beam = known.get("provenance") or {}, hdu.beam_of(header)
        image = {**known, "spectral": axis}
        if beam is not None and "beam" not in how:
            image["provenance"] = {**how, "beam": beam}
    unit, bright = image.pop("unit", ""), image.pop("intensity_unit", "")
    axes = hdu.read(header, shape, extras, image.pop("pixel_size", None))
    if axes and axes["unit"] in (None, hdu.unit_card(unit)):
        axes["unit"] = unit
    card = str(header.get("BUNIT", ""))
    for name in PLANES:
        plane = extras.get(name.upper())
        if plane is not None and plane.ndim >= 2 and plane.shape[-2:] == shape[:2]:
            image[name] = _channels_last(plane)
    image |= {"intensity": intensity, "wcs": wcs_of_header(header), **axes}
    return {**image, "intensity_unit": bright if card == hdu.unit_card(bright) else card}


def _channels_last(data: Any, spectral: int = 0) -> np.ndarray:
    """Return an array (ny, nx, channel); `spectral` is the number of the axis of channels."""
    array = np.asarray(data)
    if array.dtype.byteorder == ">" and array.flags.writeable:  # in place: no second cube
        array = array.byteswap(inplace=True).view(array.dtype.newbyteorder("="))
    spare = [k for k in range(array.ndim - 2) if array.shape[k] == 1 and array.ndim - k != spectral]
    # Radio images have an axis of one polarisation.
    array = np.squeeze(array, tuple(spare[: max(array.ndim - 3, 0)]))
    if array.ndim > 3:
        raise FileFormatError(f"expected an image of two or three axes, got shape {array.shape}")
    return np.moveaxis(array, 0, -1) if array.ndim == 3 else array[..., None]
