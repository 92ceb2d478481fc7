"""Tables in expressions: places and entries as somebody gives them, checked."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import InputError


def table(places: Any, entries: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return the places and entries of a table that can be interpolated.

    Parameters
    ----------
    places, entries : array_like, shape (n,)
        At least two increasing places, and a number for each.

    Raises
    ------
    InputError
        If they are not.
    """
    x, y = (_numbers(v) for v in (places, entries))
    if x.ndim != 1 or x.shape != y.shape or len(x) < 2:
        raise InputError(
            "interp needs as many values as places, in two lists of at least two numbers, "
            f"got shapes {x.shape} and {y.shape}"
        )
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise InputError("the places and values of interp must be finite")
    wrong = np.flatnonzero(np.diff(x) <= 0)
    if len(wrong):
        before, after = x[wrong[0]], x[wrong[0] + 1]
        raise InputError(
            f"the places of interp must increase, but {before:g} is followed by {after:g}"
        )
    return x, y


def _numbers(values: Any) -> np.ndarray:
    unit = getattr(values, "unit", None)
    if unit is not None and str(unit):
        raise InputError(
            f"interp computes with plain numbers, got numbers in {unit}; give them in the units "
            "of the fields, as in places.to_value(unit)"
        )
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"interp needs lists of numbers, got {values!r}") from error
