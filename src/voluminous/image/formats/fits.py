"""FITS: everything at full precision, with a WCS that other programs understand."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import FileFormatError
from .. import hdu, metadata
from ..arguments import PLANES
from ..sky import wcs_of_header

if TYPE_CHECKING:
    from ..image import Image

_COUNT = "NEXTEND"


def write(
    image: Image, path: Path, *, distance: Any = None, position: Any = None, posang: Any = 0.0
) -> None:
    """Write intensities into the primary HDU, all other planes into image extensions.

    `distance`, `position` and `posang` are those of `Image.on_sky`.
    """
    from astropy.io import fits

    hdus = [hdu.to_hdu(image, distance, position, posang)]
    for name in PLANES:
        plane = image.plane(name)
        if plane is not None:
            hdus.append(fits.ImageHDU(hdu.channels_first(plane), name=name.upper()))
    # A header can only express uniform spacing; these extensions hold the exact coordinates.
    hdus += [fits.ImageHDU(image.x, name="X"), fits.ImageHDU(image.y, name="Y")]
    hdus[0].header[_COUNT] = (len(hdus) - 1, "number of extensions")
    fits.HDUList(hdus).writeto(path)


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
            intensity, header = _channels_last(first.data), first.header
            extras = {h.name: np.array(h.data) for h in hdus[1:] if h.is_image and h is not first}
            found, count = len(hdus) - 1, header.get(_COUNT, 0)
    if hdu.TEXT in header and found < count:
        raise FileFormatError(f"expected {count} extensions, found {found}: the file is cut short")
    shape = intensity.shape
    image = metadata.loads(header.get(hdu.TEXT), shape)
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


def _channels_last(data: Any) -> np.ndarray:
    array = np.asarray(data)
    while array.ndim > 3 and array.shape[0] == 1:  # radio images have an axis of one polarisation
        array = array[0]
    if array.ndim > 3:
        raise FileFormatError(f"expected an image of two or three axes, got shape {array.shape}")
    return np.moveaxis(array, 0, -1) if array.ndim == 3 else array[..., None]
