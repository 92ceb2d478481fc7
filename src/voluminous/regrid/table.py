"""Cells as rows of a table."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError, MissingPackageError, check_name
from ..expressions import Expression
from ..grids.contract import BoxGrid, native_centers

if TYPE_CHECKING:
    from ..grids.contract import Grid

KINDS = ("dict", "numpy", "astropy", "pandas")


def cell_columns(grid: Grid) -> dict[str, tuple[np.ndarray, Any]]:
    """Return what a grid tells of its cells: columns and their units.

    Number, centre (x, y, z, and the grid's own coordinates), widths along these, volume, level.
    """
    from astropy.units import rad

    system, unit = tuple(grid.coordinates), grid.unit
    columns = {"cell": (np.arange(grid.size), None)}
    for name, values in zip("xyz", grid.cell_centers(0, grid.size), strict=True):
        columns[name] = (values, unit)
    for name, values in zip(system, native_centers(grid, 0, grid.size), strict=True):
        columns[name] = (values, rad if name in ("theta", "phi") else unit)
    for name, values in zip(system, grid.cell_sizes(0, grid.size), strict=True):
        columns[f"size_{name}"] = (values, unit)
    columns["volume"] = (np.reshape(grid.cell_volumes, -1), None if unit is None else unit**3)
    levels = grid.levels if isinstance(grid, BoxGrid) else np.zeros(grid.size, np.uint8)
    columns["level"] = (np.reshape(levels, -1), None)
    return columns


def table(columns: Mapping[str, tuple[np.ndarray, Any]], kind: str) -> Any:
    """Return columns with units as a table."""
    check_name("kind of table", kind, KINDS)
    if kind == "pandas":
        try:
            from pandas import DataFrame
        except ImportError as error:
            raise MissingPackageError(
                "kind='pandas' needs pandas: pip install pandas, or take another kind"
            ) from error
        return DataFrame({name: values for name, (values, _) in columns.items()})
    if kind == "numpy":
        types = [(name, values.dtype) for name, (values, _) in columns.items()]
        filled = np.empty(len(next(iter(columns.values()))[0]), types)
        for name, (values, _) in columns.items():
            filled[name] = values
        return filled
    from astropy import units as u

    united = {
        name: values if unit is None else u.Quantity(values, unit, copy=False, subok=True)
        for name, (values, unit) in columns.items()
    }
    if kind == "dict":
        return united
    from astropy.table import QTable

    return QTable(united)


def table_of_cells(volume: Any, fields: Iterable[str] | None, where: Any, kind: str) -> Any:
    """Return a table of the cells of a volume; see `Volume.cells`."""
    columns = cell_columns(volume.grid)
    for name in named_fields(volume, fields):
        values = volume.array(name) if name in volume.fields else volume.evaluate(name)
        unit = volume.expression_unit(Expression(name))
        columns[f"{name}_" if name in columns else name] = (values.reshape(-1), unit)
    if where is not None:
        chosen = volume.evaluate(Expression(where)).reshape(-1) != 0
        columns = {name: (values[chosen], unit) for name, (values, unit) in columns.items()}
    return table(columns, kind)


def named_fields(volume: Any, fields: Iterable[str] | None) -> tuple[str, ...]:
    """Return the names of fields that a user asks for: by default all."""
    if isinstance(fields, str):
        raise InputError(f"fields must be a list of names, got {fields!r}; write [{fields!r}]")
    try:
        return tuple(volume.fields if fields is None else fields)
    except TypeError:
        raise InputError(f"fields must be a list of names, got {fields!r}") from None
