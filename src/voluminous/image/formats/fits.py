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
from .. import metadata
from ..planes import PLANES, gathered
from . import fits_axes
from .contract import Format

if TYPE_CHECKING:
    from ..image import Image

_TEXT = "VOLMETA"
_COUNT = "NEXTEND"


def write(image: Image, path: Path) -> None:
    """Write intensities into the primary HDU, all else that is known into image extensions."""
    from astropy.io import fits

    hdus = [fits.PrimaryHDU(_channels_first(image.intensity), header=_header(image))]
    for name in PLANES:
        plane = getattr(image, name)
        if plane is not None:
            hdus.append(fits.ImageHDU(_channels_first(gathered(plane)), name=name.upper()))
    # A header has room for an even spacing only; these hold the coordinates bit for bit.
    hdus += [fits.ImageHDU(image.x, name="X"), fits.ImageHDU(image.y, name="Y")]
    hdus[0].header[_COUNT] = (len(hdus) - 1, "number of extensions")
    fits.HDUList(hdus).writeto(path)


def _channels_first(planes: NDArray[Any]) -> NDArray[Any]:
    if planes.ndim == 2:
        return planes
    return planes[..., 0] if planes.shape[-1] == 1 else np.moveaxis(planes, -1, 0)


def _header(image: Image) -> Any:
    from astropy.io import fits

    header = fits.Header()
    header["CREATOR"] = metadata.KEY
    header["BUNIT"] = (fits_axes.unit_card(image.intensity_unit), "unit of intensity")
    for keyword, value, comment in fits_axes.cards(image):
        header[keyword] = (value, comment)
    # Quotes and ampersands have a meaning of their own in FITS strings; JSON can spell them.
    text = metadata.dumps(image, coordinates=False)
    header[_TEXT] = text.replace("'", "\\u0027").replace("&", "\\u0026")
    return header


def read(path: Path) -> dict[str, Any]:
    """Read the first image of a FITS file, with two axes or channels as the third."""
    from astropy.io import fits

    with _strict(), fits.open(path, memmap=False, lazy_load_hdus=False) as hdus:
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
        # astropy only warns of this, and may then give a part of the file.
        warnings.filterwarnings("error", message=".*truncated.*")
        yield


def _check_whole(header: Any, extensions: int) -> None:
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


def _known(header: Any, extras: dict[str, NDArray[Any]], shape: tuple[int, ...]) -> dict[str, Any]:
    """Return units, coordinates and the rest; cards that were edited count more than our text."""
    ours = metadata.loads(header.get(_TEXT), shape)
    unit = ours.pop("unit", "")
    bright = ours.pop("intensity_unit", "")
    axes = fits_axes.read(header, shape, extras, ours.pop("pixel_size", None))
    if axes and axes["unit"] == fits_axes.unit_card(unit):
        axes["unit"] = unit
    card = str(header.get("BUNIT", ""))
    return ours | axes | {"intensity_unit": bright if card == fits_axes.unit_card(bright) else card}


FORMAT = Format("a FITS image", (".fits", ".fit", ".fts"), (b"SIMPLE  =",), write, read)
