"""Axes whose coordinates are in a table: ``-TAB`` of FITS paper III (section 6), and SKIRT's.

All become a ``-TAB`` axis with one coordinate per pixel and no index, whatever the file has.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...errors import FileFormatError
from ...image.sky import table_hdus
from .blocks import Part, card
from .units import fits_name, lenient_unit

_SKIRT = "Z-AXIS COORDINATE VALUES"
_TABLE, _COLUMN = "VOLTABLE", "CENTERS"
_KINDS = {"length": "WAVE", "frequency": "FREQ", "energy": "ENER"}


def skirt_centers(part: Part, header: Any) -> dict[int, np.ndarray]:
    """Return ``{2: coordinates}`` if SKIRT's table of the third axis is in the file, else nothing.

    The header gets the kind and the unit of the axis.

    Raises
    ------
    FileFormatError
        If the table has other columns.
    """
    from astropy.io import fits

    if header.get("NAXIS") != 3 or str(card(header, "CTYPE3", "")).strip().endswith("-TAB"):
        return {}
    with fits.open(part.path, memmap=False) as hdus:
        table = next((hdu for hdu in hdus if hdu.name == _SKIRT), None)
        if table is None:
            return {}
        if len(table.columns) != 1:
            raise FileFormatError(f"{_SKIRT} has {len(table.columns)} columns, expected one")
        centers = np.asarray(table.data.field(0), np.float64)
        unit = lenient_unit(table.columns[0].unit or str(card(header, "CUNIT3", "")))
    kinds = (k for m, k in _KINDS.items() if unit is not None and unit.physical_type == m)
    header["CTYPE3"], header["CUNIT3"] = next(kinds, "ZVAL") + "-TAB", fits_name(unit)
    return {2: centers}


def put_centers(header: Any, axis: int, centers: np.ndarray) -> Any:
    """Make an axis (from 0) of a header that of coordinates at pixels; return the table of these.

    Raises
    ------
    FileFormatError
        If they are not one per pixel, ascending or descending.
    """
    k, steps = axis + 1, np.diff(centers)
    count = header[f"NAXIS{k}"]
    if centers.shape != (count,) or not (np.all(steps > 0) or np.all(steps < 0)):
        raise FileFormatError(
            f"the coordinates of axis {k} in a table are {centers}, expected {count} that rise or "
            "fall"
        )
    for key in [key for key in header if key.startswith((f"CD{k}_", f"PC{k}_", f"PS{k}_"))]:
        del header[key]
    header.remove(f"CROTA{k}", ignore_missing=True)
    for key in ("CRPIX", "CRVAL", "CDELT"):
        header[f"{key}{k}"] = 1.0
    header[f"PS{k}_0"], header[f"PS{k}_1"] = f"{_TABLE}{k}", _COLUMN
    header[f"PV{k}_1"] = header[f"PV{k}_2"] = header[f"PV{k}_3"] = 1.0
    return table_hdus({(f"{_TABLE}{k}", _COLUMN): centers})[0]
