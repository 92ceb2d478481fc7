"""Tables of measurements: how they are shown and written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import InputError, UnitsError, unknown_name
from ..files import replacing
from ..units import parse_unit, unit_name

if TYPE_CHECKING:
    from astropy.table import QTable

    from ..measuring import Measurement

_FORMATS = {".ecsv": "ascii.ecsv", ".csv": "ascii.csv", ".fits": "fits"}


def check_table(path: Path) -> None:
    """Refuse, before any work, a table that cannot be written in the end.

    Raises
    ------
    InputError
        If its suffix stands for no format, or there is no such directory.
    """
    if path.suffix.lower() not in _FORMATS:
        raise InputError(f"a table is written as {', '.join(_FORMATS)}, got {path}")
    if not path.resolve().parent.is_dir():
        raise InputError(f"the directory {path.parent} does not exist; create it first")


def one_row(found: Measurement) -> QTable:
    """Return a measurement as a table."""
    from astropy import units as u
    from astropy.table import QTable

    values: dict[str, Any] = {**found.totals, "volume": found.volume}
    table = QTable({name: u.Quantity([value]) for name, value in values.items()})
    table["cells"] = [found.cells]
    return table


def with_units(table: QTable, units: Mapping[str, str], totals: Sequence[str]) -> QTable:
    """Convert columns to the units asked for.

    Raises
    ------
    UnknownNameError
        For a column that is not there.
    UnitsError
        If a unit does not fit.
    """
    known = [*totals, "volume"]
    for name, unit in units.items():
        if name not in known:
            raise unknown_name("total", name, known)
        own = table[name].unit
        try:
            table[name] = table[name].to(parse_unit(unit))
        except (ValueError, TypeError) as error:
            raise UnitsError(f"{name} is in {unit_name(own) or 'no unit'}, not {unit}") from error
    return table


def text_of(table: QTable) -> str:
    """Return a table as text, with units below the names."""
    shown = table.copy()
    for name in shown.colnames:
        if shown[name].dtype.kind == "f":
            shown[name].info.format = ".8g"
    return "\n".join(shown.pformat(max_lines=-1, max_width=-1, show_unit=True))


def write_table(table: QTable, path: Path) -> None:
    """Write a table; a .csv knows no units, so these follow the names."""
    form = _FORMATS[path.suffix.lower()]
    if form == "ascii.csv":
        table = table.copy()
        for name in table.colnames:
            unit = unit_name(getattr(table[name], "unit", None))
            if unit:
                table.rename_column(name, f"{name} [{unit}]")
    with replacing(path) as temporary:
        table.write(temporary, format=form, overwrite=True)
