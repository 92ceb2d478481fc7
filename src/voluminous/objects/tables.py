"""Columns of tables, whoever made them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..errors import InputError, unknown_name


def is_column(table: Any, name: str) -> bool:
    """Return True if a table has a column of this name."""
    return name in _names(table)


def column(table: Any, name: str) -> Any:
    """Return a column as an array, or as a Quantity if it has a unit; masked values are NaN.

    Raises
    ------
    InputError
        If it is no table.
    UnknownNameError
        If there is none of this name; names the nearest.
    """
    if not is_column(table, name):
        raise unknown_name("column", str(name), _names(table))
    found = table[name]
    if hasattr(found, "filled") and np.asarray(found).dtype.kind == "f":
        found = found.filled(np.nan)
    if getattr(found, "unit", None) is None:
        return np.asarray(found)
    return getattr(found, "quantity", found)  # of astropy's Column


def _names(table: Any) -> list[str]:
    for place in ("colnames", "columns"):
        if hasattr(table, place):
            return [str(name) for name in getattr(table, place)]
    dtype = getattr(table, "dtype", None)
    if dtype is None and not isinstance(table, Mapping):
        raise InputError(
            "expected a table of astropy or pandas, a dictionary of columns, or an array with "
            f"fields, got {type(table).__name__}"
        )
    return [str(name) for name in (table if dtype is None else dtype.names or ())]
