"""A third axis whose coordinates are in a table: ``-TAB`` of FITS paper III (section 6), and SKIRT.

SKIRT writes the centres along the third axis as an extension beside the cube; they are passed to
wcslib as a ``-TAB`` axis.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ...errors import FileFormatError
from .blocks import Part, card
from .units import fits_name, lenient_unit

_SKIRT = "Z-AXIS COORDINATE VALUES"
_TABLE, _COLUMN = "VOLTABLE", "CENTERS"
_KINDS = {"length": "WAVE", "frequency": "FREQ", "energy": "ENER"}


def skirt_table(part: Part, header: Any) -> Any:
    """Make the third axis of a header ``-TAB`` if SKIRT's table of its coordinates is in the file.

    Returns
    -------
    HDUList or None
        With the table that the header names.

    Raises
    ------
    FileFormatError
        If the table is not one of strictly ascending or descending numbers, one per plane.
    """
    from astropy.io import fits

    if header.get("NAXIS") != 3 or str(card(header, "CTYPE3", "")).strip():
        return None
    with fits.open(part.path, memmap=False) as hdus:
        table = next((hdu for hdu in hdus if hdu.name == _SKIRT), None)
        if table is None:
            return None
        if len(table.columns) != 1:
            raise FileFormatError(f"{_SKIRT} has {len(table.columns)} columns, expected one")
        centers = np.asarray(table.data.field(0), np.float64)
        text = table.columns[0].unit or str(card(header, "CUNIT3", ""))
    steps = np.diff(centers)
    if centers.shape != (header["NAXIS3"],) or not (np.all(steps > 0) or np.all(steps < 0)):
        raise FileFormatError(
            f"{_SKIRT} has values {centers}, expected {header['NAXIS3']} that rise or fall"
        )
    unit = lenient_unit(text)
    for key in [k for k in header if k[:2] in ("CD", "PC") and k[2:4] == "3_"] + ["CROTA3"]:
        header.remove(key, ignore_missing=True)
    kinds = (k for m, k in _KINDS.items() if unit is not None and unit.physical_type == m)
    header["CTYPE3"] = next(kinds, "ZVAL") + "-TAB"
    header["CUNIT3"] = fits_name(unit)
    header["CRPIX3"] = header["CRVAL3"] = header["CDELT3"] = 1.0
    header["PS3_0"], header["PS3_1"] = _TABLE, _COLUMN
    header["PV3_1"] = header["PV3_2"] = header["PV3_3"] = 1.0
    return fits.HDUList([fits.PrimaryHDU(), table_hdu(_TABLE, {_COLUMN: centers[:, None]})])


def tables_of(wcs: Any) -> list[Any]:
    """Return the tables of a WCS as HDUs, each for an axis of its own."""
    texts = {(axis, m): text for axis, m, text in wcs.wcs.get_ps()}
    made = []
    for table in wcs.wcs.tab:
        axis = int(table.map[0]) + 1
        columns = {texts[axis, 1]: np.reshape(table.coord, (-1, 1))}
        if texts.get((axis, 2), "").strip():
            columns[texts[axis, 2]] = np.ravel(table.index[0])
        made.append(table_hdu(texts[axis, 0], columns))
    return made


def table_hdu(name: str, columns: Mapping[str, np.ndarray]) -> Any:
    """Return a table of one row: coordinates (n, 1), and perhaps an index (n,)."""
    from astropy.io import fits

    made = []
    for title, values in columns.items():
        dim = None if values.ndim == 1 else f"(1,{len(values)})"
        made.append(fits.Column(title, f"{values.size}D", dim=dim, array=values[None]))
    return fits.BinTableHDU.from_columns(made, name=name)
