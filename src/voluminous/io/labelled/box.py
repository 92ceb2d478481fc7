"""The grid of three axes: their coordinates where these are lengths, else a box."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import InputError
from ...units import parse_unit
from ..arrays.layout import AXES, equal_cells
from .lines import Line

if TYPE_CHECKING:
    from ...grids import CartesianGrid

# Where the cells are, if the coordinates shall not say it.
OPTIONS = {
    "bounds": "(low, high) or ((x0, x1), (y0, y1), (z0, z1)) of a grid of equal cells, in place of "
    "the coordinates",
    "spacing": "cell width, or one per axis, of a grid that starts at 0, in place of coordinates",
    "aspect": "lengths of the sides of the box (x, y, z) that coordinates of different kinds, such "
    "as angles and pressures, are fitted into",
    "unit": "unit of length",
}


def grid_of(lines: Sequence[Line], options: Mapping[str, Any]) -> CartesianGrid:
    """Return the grid of three axes.

    Coordinates are kept if they are all lengths, all of one unit, or all without one. Else those
    of a common unit are kept as plain numbers, and any other is fitted into the shortest side; a
    warning says so. The option `aspect` fits all into a box of these sides.

    Raises
    ------
    InputError
        If options contradict each other or do not fit.
    """
    from ...grids import CartesianGrid

    given = [k for k in ("bounds", "spacing", "aspect") if options.get(k) is not None]
    if len(given) > 1:
        raise InputError(f"give one of bounds, spacing and aspect, not {' and '.join(given)}")
    unit = options.get("unit")
    if options.get("aspect") is not None:
        sides = _sides(options["aspect"])
        return CartesianGrid(
            *(_fitted(line, side) for line, side in zip(lines, sides, strict=True)), unit=unit
        )
    if given:
        return equal_cells(tuple(line.cells for line in lines), options, unit)
    if len(_units(lines)) > 1:
        return CartesianGrid(*_mixed(lines), unit=unit)
    if unit is not None:
        return CartesianGrid(*(line.edges for line in lines), unit=unit)
    return CartesianGrid(*(_quantity(line) for line in lines))


def _quantity(line: Line) -> Any:
    unit = parse_unit(line.unit)
    return line.edges if unit is None else line.edges * unit


def _units(lines: Sequence[Line]) -> set[str]:
    """Return the kinds of unit of some axes: those that convert into each other are one."""
    return {_kind(line) for line in lines}


def _kind(line: Line) -> str:
    unit = parse_unit(line.unit)
    return "" if unit is None else str(unit.decompose().bases)


def _mixed(lines: Sequence[Line]) -> list[np.ndarray]:
    kinds = [_kind(line) for line in lines]
    common = max(kinds, key=kinds.count)
    if kinds.count(common) == 1:
        sides, kept = (1.0, 1.0, 1.0), [False] * 3
    else:
        kept = [kind == common for kind in kinds]
        lines = _converted(lines, kept)
        shortest = min(float(np.ptp(line.edges)) for line, k in zip(lines, kept, strict=True) if k)
        sides = (shortest,) * 3
    told = ", ".join(_told(axis, line) for axis, line in zip(AXES, lines, strict=True))
    fitted = " and ".join(a for a, k in zip(AXES, kept, strict=True) if not k)
    warnings.warn(
        f"the coordinates are of different kinds ({told}): {fitted} {'is' if any(kept) else 'are'} "
        f"fitted into {sides[0]:g}, which is no physical length; give aspect=(…) for a box of "
        "other sides, or bounds=… or spacing=… for lengths",
        stacklevel=2,
    )
    return [
        line.edges if keep else _fitted(line, side)
        for line, keep, side in zip(lines, kept, sides, strict=True)
    ]


def _converted(lines: Sequence[Line], kept: Sequence[bool]) -> list[Line]:
    """Return axes of which those that are kept have the unit of the first of them."""
    unit = parse_unit(next(line.unit for line, keep in zip(lines, kept, strict=True) if keep))
    if unit is None:
        return list(lines)
    return [
        replace(line, edges=_quantity(line).to_value(unit), unit=str(unit)) if keep else line
        for line, keep in zip(lines, kept, strict=True)
    ]


def _told(axis: str, line: Line) -> str:
    unit = line.unit or ("cells counted" if line.counted else "no unit")
    return f"{axis} = {line.dim}: {unit}"


def _fitted(line: Line, side: float) -> np.ndarray:
    low, high = line.edges[0], line.edges[-1]
    return np.asarray((line.edges - low) * (side / (high - low)))


def _sides(aspect: Any) -> tuple[float, ...]:
    sides = np.asarray(aspect, np.float64) if np.shape(aspect) == (3,) else np.zeros(3)
    if not (np.all(sides > 0) and np.all(np.isfinite(sides))):
        raise InputError(
            f"aspect must be three positive lengths of the sides along x, y and z, got {aspect!r}"
        )
    return tuple(float(side) for side in sides)
