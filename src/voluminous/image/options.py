"""Options that are passed on by keyword: their names, and numbers with units."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import Any

from ..errors import unknown_name
from ..units import as_quantity, is_quantity, plain


def check_options(kind: str, given: Iterable[str], known: Collection[str]) -> None:
    """Check that every option has a known name.

    Raises
    ------
    UnknownNameError
        For the first that has not; names the nearest.
    """
    for name in given:
        if name not in known:
            raise unknown_name(kind, name, known)


def plain_limits(options: dict[str, Any], unit: Any) -> dict[str, Any]:
    """Return display options with limits as plain numbers in the unit of what is shown.

    Raises
    ------
    UnitsError
        If a limit is a quantity that cannot be converted.
    """
    given = {name: options.get(name) for name in ("vmin", "vmax")}
    return options | {
        name: float(plain(value, unit or None, name))
        for name, value in given.items()
        if is_quantity(as_quantity(value))
    }
