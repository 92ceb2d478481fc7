"""Files of what one ray saw: tables and plots, by suffix."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ...errors import unknown_name
from ...files import replacing

if TYPE_CHECKING:
    from .result import Probe

# What astropy calls the formats of tables.
_TABLES = {".csv": "ascii.csv", ".ecsv": "ascii.ecsv", ".fits": "fits"}
_PLOTS = (".png", ".pdf", ".svg")
_DPI = 150


def check_suffix(path: Path) -> str:
    """Return the suffix of a file that can be written.

    Raises
    ------
    UnknownNameError
        If it stands for neither a table nor a plot.
    """
    suffix = path.suffix.lower()
    if suffix not in (*_TABLES, *_PLOTS):
        raise unknown_name("suffix of a table or plot", suffix, (*_TABLES, *_PLOTS))
    return suffix


def save(probe: Probe, path: Path) -> None:
    """Write a table or a plot; see `Probe.save`."""
    suffix = check_suffix(path)
    with replacing(path) as temporary:
        if suffix in _TABLES:
            probe.table().write(temporary, format=_TABLES[suffix], overwrite=True)
        else:
            probe.plot().savefig(temporary, dpi=_DPI, format=suffix[1:])
