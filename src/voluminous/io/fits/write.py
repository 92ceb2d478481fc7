"""Volumes as FITS cubes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import InputError
from ...image.sky import table_hdus, tables_of
from ..axes import cartesian
from .layout import DEPTH, UNIT, axis_name, is_place
from .units import fits_name

if TYPE_CHECKING:
    from astropy.io.fits import Header

    from ...volume import Volume


# Cards that a WCS header sets itself, or that would contradict it.
_OF_WCS = {"specsys", "radesys", "equinox", "restfrq", "restfreq", "restwav", "bunit"}
_LONGEST = 68


def write(volume: Volume, path: Path) -> None:
    """Write one HDU per field, the first one as the primary HDU."""
    from astropy.io import fits

    cards = _world_cards(volume)
    names = _written(volume)
    hdus = []
    for number, name in enumerate(names):
        header = fits.Header(cards)
        for key, value in _meta_cards(volume).items():
            header[key] = value
        header["EXTNAME"], header["BTYPE"] = name, name
        header["BUNIT"] = fits_name(volume.field_unit(name))
        kind = fits.ImageHDU if number else fits.PrimaryHDU
        hdus.append(kind(_storable(volume.array(name)).T, header=header))
    if volume.wcs is not None:
        hdus += table_hdus(tables_of(volume.wcs))
    fits.HDUList(hdus).writeto(path, output_verify="fix+ignore")


def _written(volume: Volume) -> list[str]:
    told = axis_name(volume.wcs) if _has_axis(volume) else None
    names = [name for name in volume.fields if name != told] or list(volume.fields)
    if not names:
        raise InputError("the volume has no fields to be written")
    for name in names:
        if not _fits_card(name):
            raise InputError(
                f"a FITS header holds names of up to {_LONGEST} ASCII characters, not the field's "
                f"{name!r}; rename it, or write .h5"
            )
    return names


def _has_axis(volume: Volume) -> bool:
    return volume.wcs is not None and not is_place(volume.wcs)


def _world_cards(volume: Volume) -> Header:
    """Return the cards with the cell positions."""
    from astropy.io import fits

    grid = cartesian(volume)
    if volume.wcs is not None and tuple(volume.wcs.pixel_shape or ()) == grid.shape:
        header = volume.wcs.to_header(relax=True)
        if _has_axis(volume):
            header[UNIT] = (fits_name(grid.unit), "unit of the grid")
            header[DEPTH] = (float(np.ptp(grid.edges[2])), "depth of the grid in it")
        return header
    if not grid.is_uniform:
        raise InputError(
            "FITS holds cells of equal width only; resample the volume first, or write .h5"
        )
    header = fits.Header()
    for number, (axis, edges) in enumerate(zip("XYZ", grid.edges, strict=True), start=1):
        header[f"CTYPE{number}"] = (axis, "linear")
        header[f"CRPIX{number}"] = (0.5, "the lower edge of the first cell")
        header[f"CRVAL{number}"] = float(edges[0])
        header[f"CDELT{number}"] = float(edges[-1] - edges[0]) / (len(edges) - 1)
        header[f"CUNIT{number}"] = fits_name(grid.unit)
    return header


def _meta_cards(volume: Volume) -> dict[str, Any]:
    return {
        key.upper(): value
        for key, value in volume.meta.items()
        if key not in _OF_WCS and len(key) <= 8 and _fits_card(value)
    }


def _fits_card(value: Any) -> bool:
    if isinstance(value, str):
        return value.isascii() and value.isprintable() and len(value) <= _LONGEST
    return isinstance(value, (bool, int, float)) and bool(np.isfinite(value))


def _storable(values: np.ndarray) -> np.ndarray:
    return values.view(np.uint8) if values.dtype == bool else values
