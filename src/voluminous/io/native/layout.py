"""How a native file is laid out, and how it is known.

``/grid`` holds what makes the grid again, ``/fields`` one data set per field in the grid's order of
cells, ``/meta`` (JSON) and ``/wcs`` (a FITS header) what a file tells besides. Attributes say in
words what is what, so that h5py is all that anybody needs.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ...errors import FileFormatError
from ..hdf5 import is_hdf5, opened

MARK = "voluminous volume"
VERSION = 1
GRID, FIELDS, META, WCS = "grid", "fields", "meta", "wcs"
TABLES = "wcs_tables"  # of a WCS with an axis in a table (-TAB)
ABOUT = (
    "A volume: /grid says where the cells are (its attribute 'order' how they are counted), "
    "/fields/NAME holds one value per cell in 'units'. Read it with voluminous.open(path)."
)


def is_native(path: Path, head: bytes) -> bool:
    """Return True for a file with the mark; never raises."""
    if not is_hdf5(head):
        return False

    try:
        with opened(path) as file:
            return bool(_text(file.attrs.get("format")) == MARK)
    except Exception:  # a damaged file is for the general reader to explain
        return False


def check_version(file: Any) -> None:
    """Refuse a file that a later version of the format describes.

    Raises
    ------
    FileFormatError
        If its version is not one that is known.
    """
    version = file.attrs.get("version")
    if version != VERSION:
        raise FileFormatError(
            f"it is a volume in version {version} of the native format, expected {VERSION}; "
            "a newer voluminous may read it"
        )


def attribute(item: Any, name: str) -> str:
    """Return an attribute that is a text; empty where there is none."""
    return _text(item.attrs.get(name))


def _text(value: Any) -> str:
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace")
    return value if isinstance(value, str) else ""
