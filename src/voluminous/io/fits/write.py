"""Volumes as FITS cubes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import InputError
from ...grids.cartesian.grid import CartesianGrid
from ...image.fits_header import fits_name
from ...image.sky import table_hdus, tables_of
from ..axes import cartesian
from .layout import DEPTH, UNIT, axis_name, is_place

if TYPE_CHECKING:
    from astropy.io.fits import Header

    from ...volume import Volume


# Cards that a WCS header sets itself, or that would contradict it.
_OF_WCS = {"specsys", "radesys", "equinox", "restfrq", "restfreq", "restwav", "bunit"}
_LONGEST = 68


def write(volume: Volume, path: Path) -> None:
    """Write one HDU per field, the first one as the primary HDU."""
    from astropy.io import fits

    wcs = volume.wcs
    has_axis = wcs is not None and not is_place(wcs)
    third = axis_name(wcs) if has_axis else None
    names = [name for name in volume.fields if name != third] or list(volume.fields)
    if not names or not all(map(_fits_card, names)):
        raise InputError(
            f"no fields can be written: a FITS header holds names of up to {_LONGEST} ASCII "
            f"characters, got {names}; rename them, or write .h5"
        )
    cards = _world_cards(volume, has_axis)
    for key, value in volume.meta.items():
        if key not in _OF_WCS and len(key) <= 8 and _fits_card(value):
            cards[key.upper()] = value
    hdus: list[Any] = []
    for name in names:
        header, values = fits.Header(cards), volume.array(name)
        header["EXTNAME"], header["BTYPE"] = name, name
        header["BUNIT"] = fits_name(volume.field_unit(name))
        kind = fits.ImageHDU if hdus else fits.PrimaryHDU
        hdus.append(kind((values.view(np.uint8) if values.dtype == bool else values).T, header))
    tables = [] if wcs is None else table_hdus(tables_of(wcs))
    fits.HDUList([*hdus, *tables]).writeto(path, output_verify="fix+ignore")


def _world_cards(volume: Volume, has_axis: bool) -> Header:
    from astropy.io import fits

    grid = cartesian(volume)
    if volume.wcs is not None and tuple(volume.wcs.pixel_shape or ()) == grid.shape:
        header = volume.wcs.to_header(relax=True)
        if has_axis:
            header[UNIT] = (fits_name(grid.unit), "unit of the grid")
            header[DEPTH] = (float(np.ptp(grid.edges[2])), "depth of the grid in it")
        return header
    if not (isinstance(grid, CartesianGrid) and grid.is_uniform):
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


def _fits_card(value: Any) -> bool:
    if isinstance(value, str):
        return value.isascii() and value.isprintable() and len(value) <= _LONGEST
    return isinstance(value, (bool, int, float)) and bool(np.isfinite(value))
