"""FITS: everything at full precision, with a WCS that other programs understand."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...errors import FileFormatError
from .. import hdu, metadata
from ..arguments import PLANES
from ..hdu import TEXT as _TEXT
from ..hdu import channels_first, to_hdu
from ..sky import wcs_of_header
from .contract import Format

if TYPE_CHECKING:
    from astropy.io.fits import Header

    from ..image import Image

_COUNT = "NEXTEND"
# All of a file is read at once.
_WHOLE: dict[str, Any] = {"memmap": False, "lazy_load_hdus": False}


def write(image: Image, path: Path, **sky: Any) -> None:
    """Write intensities into the primary HDU, all other planes into image extensions.

    Parameters
    ----------
    image : Image
    path : Path
    **sky
        ``distance``, ``position`` and ``posang``, as in `Image.on_sky`.
    """
    from astropy.io import fits

    hdus = [to_hdu(image, **sky)]
    for name in PLANES:
        found = image.plane(name)
        if found is not None:
            hdus.append(fits.ImageHDU(channels_first(found), name=name.upper()))
    # A header can only express uniform spacing; these extensions hold the exact coordinates.
    hdus += [fits.ImageHDU(image.x, name="X"), fits.ImageHDU(image.y, name="Y")]
    hdus[0].header[_COUNT] = (len(hdus) - 1, "number of extensions")
    fits.HDUList(hdus).writeto(path)


def read(path: Path) -> dict[str, Any]:
    """Read the first image of a FITS file, with two axes or channels as the third."""
    from astropy.io import fits

    # astropy does not close a truncated file that it has opened itself.
    with _strict(), open(path, "rb") as file, fits.open(file, **_WHOLE) as hdus:
        first = next((h for h in hdus if h.is_image and h.header.get("NAXIS", 0) >= 2), None)
        if first is None:
            raise FileFormatError("expected an image with two axes or more; there is none")
        intensity = _channels_last(first.data)
        header = first.header
        extras = {h.name: np.array(h.data) for h in hdus[1:] if h.is_image and h is not first}
        _check_whole(header, len(hdus) - 1)
    return {"intensity": intensity, **_planes(extras, intensity.shape)} | _known(
        header, extras, intensity.shape
    )


@contextmanager
def _strict() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        # astropy only warns about this, and may then return a part of the file.
        warnings.filterwarnings("error", message=".*truncated.*")
        yield


def _check_whole(header: Header, extensions: int) -> None:
    if _TEXT in header and extensions < header.get(_COUNT, 0):
        raise FileFormatError(
            f"expected {header[_COUNT]} extensions, found {extensions}: the file is cut short"
        )


def _channels_last(data: Any) -> NDArray[Any]:
    array = np.asarray(data)
    while array.ndim > 3 and array.shape[0] == 1:  # radio images have an axis of one polarisation
        array = array[0]
    if array.ndim > 3:
        raise FileFormatError(f"expected an image of two or three axes, got shape {array.shape}")
    return np.moveaxis(array, 0, -1) if array.ndim == 3 else array[..., None]


def _planes(extras: dict[str, NDArray[Any]], shape: tuple[int, ...]) -> dict[str, Any]:
    found = {name: extras.get(name.upper()) for name in PLANES}
    return {
        name: _channels_last(data)
        for name, data in found.items()
        if data is not None and data.ndim >= 2 and data.shape[-2:] == shape[:2]
    }


def _known(
    header: Header, extras: dict[str, NDArray[Any]], shape: tuple[int, ...]
) -> dict[str, Any]:
    """Return units, coordinates and metadata; edited cards override the JSON text."""
    ours = metadata.loads(header.get(_TEXT), shape)
    unit = ours.pop("unit", "")
    bright = ours.pop("intensity_unit", "")
    axes = hdu.read(header, shape, extras, ours.pop("pixel_size", None))
    if axes and axes["unit"] in (None, hdu.unit_card(unit)):
        axes["unit"] = unit
    card = str(header.get("BUNIT", ""))
    ours["wcs"] = wcs_of_header(header)
    return ours | axes | {"intensity_unit": bright if card == hdu.unit_card(bright) else card}


FORMAT = Format(
    "a FITS image",
    (".fits", ".fit", ".fts"),
    (b"SIMPLE  =",),
    write,
    read,
    frozenset({"distance", "position", "posang"}),
)
