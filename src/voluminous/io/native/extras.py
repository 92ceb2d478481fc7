"""What a volume knows besides its fields: plain values as JSON, the sky as a FITS header."""

from __future__ import annotations

import json
from typing import Any

from ...errors import FileFormatError
from ...image.sky import table_hdus, tables_of
from .layout import META, TABLES, WCS


def write_extras(file: Any, volume: Any) -> None:
    """Write `meta` and `wcs`, as far as there are any."""
    if volume.meta:
        file[META] = json.dumps(volume.meta, default=_plain, ensure_ascii=False)
        file[META].attrs["about"] = "what was known of the data, in JSON"
    if volume.wcs is not None:
        file[WCS] = _header(volume.wcs)
        file[WCS].attrs["about"] = "a FITS header with the world coordinates of the grid's axes"
        for (table, column), values in tables_of(volume.wcs).items():
            file[f"{TABLES}/{table}/{column}"] = values


def read_extras(file: Any, volume: Any) -> None:
    """Read `meta` and `wcs` into a volume.

    Raises
    ------
    FileFormatError
        If `meta` is no table in JSON.
    """
    if META in file:
        meta = json.loads(_text(file, META))
        if not isinstance(meta, dict):
            raise FileFormatError(f"/{META} must be a table in JSON, got {meta!r:.40}")
        volume.meta.update(meta)
    if WCS in file:
        volume.wcs = _wcs(_text(file, WCS), file.get(TABLES, {}))


def _text(file: Any, name: str) -> str:
    import h5py

    link = file.get(name, getlink=True)
    item = file[name] if isinstance(link, h5py.HardLink) else None
    if not isinstance(item, h5py.Dataset) or h5py.check_string_dtype(item.dtype) is None:
        raise FileFormatError(f"/{name} must be a text")
    if item.shape != ():
        raise FileFormatError(f"/{name} must be one text, got an array of shape {item.shape}")
    text: str = item.asstr()[()]
    return text


def _plain(value: Any) -> Any:
    """Return what JSON has no word for: NumPy's numbers as lists and numbers, others as text."""
    return value.tolist() if hasattr(value, "tolist") and not hasattr(value, "unit") else str(value)


def _header(wcs: Any) -> str:
    from astropy import wcs as astropy_wcs

    # All digits of a double, and all keywords.
    header = wcs.to_header(relax=astropy_wcs.WCSHDO_all | astropy_wcs.WCSHDO_P17)
    for axis, count in enumerate(wcs.pixel_shape or (), start=1):
        header[f"NAXIS{axis}"] = count
    text: str = header.tostring(sep="\n")
    return text


def _wcs(text: str, tables: Any) -> Any:
    from astropy.io.fits import HDUList, Header, PrimaryHDU
    from astropy.wcs import WCS as AstropyWCS

    found = {(name, title): values[()] for name in tables for title, values in tables[name].items()}
    hdus = HDUList([PrimaryHDU(), *table_hdus(found)])
    return AstropyWCS(Header.fromstring(text, sep="\n"), hdus if found else None)
