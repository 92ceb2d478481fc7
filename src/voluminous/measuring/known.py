"""Where a quantity has a value: expressions need not have one in every cell."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from ..errors import InputError
from ..expressions import Expression
from ..expressions.interval_ops import IntervalOps
from ..rendering.coefficients.classify import extremes_of, range_of

# Cells looked at at once.
_CHUNK = 1 << 20


def with_known(volume: Any, expressions: Sequence[Expression]) -> tuple[Any, list[Expression]]:
    """Return a volume, and expressions of its fields that have a value wherever these have one.

    An expression that has none in some cells, such as ``log10(a)`` where a is negative, becomes a
    field that lacks it there: what is missing in fields counts nothing along rays.

    Raises
    ------
    InputError
        If one is infinite somewhere, or has no value anywhere.
    """
    arrays: dict[str, np.ndarray] = {}
    found = []
    for expression in expressions:
        values = None if _defined(volume, expression) else _lacking(volume, expression)
        if values is None:
            found.append(expression)
            continue
        name = _free_name(volume, len(arrays))
        arrays[name] = values
        found.append(Expression(name))
    return (_with_fields(volume, arrays) if arrays else volume), found


def check_finite(values: np.ndarray, expression: Expression, first: int, grid: Any) -> None:
    """Refuse a quantity that is infinite in one of consecutive cells.

    Raises
    ------
    InputError
        Names the first of them.
    """
    infinite = np.flatnonzero(np.isinf(values))
    if infinite.size:
        place = np.unravel_index(first + int(infinite[0]), grid.shape)
        raise InputError(
            f"{expression.text!r} is infinite in cells, the first of which is "
            f"{tuple(int(i) for i in place)}: leave them out, where(…, …, 0), or have them missing "
            "(NaN)"
        )


def _defined(volume: Any, expression: Expression) -> bool:
    """Return whether the ranges of the fields alone say that it is finite everywhere."""
    if not expression.partial:
        return True
    with np.errstate(all="ignore"):
        extremes = functools.partial(extremes_of, volume)
        fields = {name: range_of(volume, name, extremes) for name in expression.names}
        ops = IntervalOps()
        range_ = ops.number(expression.evaluate(ops, fields))
    return bool(np.isfinite(range_.lo) & np.isfinite(range_.hi))


def _lacking(volume: Any, expression: Expression) -> np.ndarray | None:
    values = np.concatenate(list(_pieces(volume, expression)))
    unknown = np.isnan(values)
    if unknown.all():
        raise InputError(f"{expression.text!r} has no value in any cell")
    return values.reshape(volume.grid.shape) if unknown.any() else None


def _pieces(volume: Any, expression: Expression) -> Iterator[np.ndarray]:
    size = volume.grid.size
    for first in range(0, size, _CHUNK):
        last = min(first + _CHUNK, size)
        values = volume.evaluate_cells(expression, first, last, double=True)
        check_finite(values, expression, first, volume.grid)
        yield np.asarray(values, np.float64)


def _free_name(volume: Any, number: int) -> str:
    name = f"quantity_{number}"
    while name in volume:
        name += "_"
    return name


def _with_fields(volume: Any, arrays: dict[str, np.ndarray]) -> Any:
    other = volume.with_arrays(arrays)
    for name in arrays:
        other.set_unit(name, None)
    return other
