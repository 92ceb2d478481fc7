"""Curves from 0 (black) to 1 (white) that bring out what is faint."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ..errors import InputError, unknown_name


class Curve(NamedTuple):
    """An increasing function of [0, 1] onto itself, and its inverse."""

    forward: Callable[[Any], Any]
    inverse: Callable[[Any], Any]


def _power(gamma: float) -> Curve:
    return Curve(lambda v: v ** (1 / gamma), lambda w: w**gamma)


def _asinh(softening: float) -> Curve:
    top = np.arcsinh(1 / softening).item()
    return Curve(lambda v: np.arcsinh(v / softening) / top, lambda w: softening * np.sinh(w * top))


def _log(softening: float) -> Curve:
    top = np.log1p(1 / softening).item()
    return Curve(lambda v: np.log1p(v / softening) / top, lambda w: softening * np.expm1(w * top))


LINEAR = Curve(lambda v: v, lambda w: w)
GAMMA = 2.2  # the usual stand-in for the encoding of displays
_FIXED = {
    "linear": LINEAR,
    "sqrt": Curve(np.sqrt, np.square),
    "gamma": _power(GAMMA),
}
_SOFT = {"asinh": (_asinh, 0.1), "log": (_log, 0.01)}
STRETCHES = (*_FIXED, *_SOFT)


def curve(stretch: str | float, softening: float | None = None) -> Curve:
    """Return the curve for the name of a stretch, or for a number g the curve v**(1/g).

    Parameters
    ----------
    stretch : {"linear", "sqrt", "gamma", "asinh", "log"} or float
        Which curve.
    softening : float, optional
        For "asinh" and "log": where the linear part ends, in units of white.

    Raises
    ------
    UnknownNameError
        If there is no such stretch.
    InputError
        If a number is not positive, or the stretch has no softening.
    """
    if softening is not None and stretch not in tuple(_SOFT):
        raise InputError(f"softening is for the stretches {' and '.join(_SOFT)}, not {stretch!r}")
    if not isinstance(stretch, str):
        return _power(positive(stretch, "stretch"))
    if stretch in _FIXED:
        return _FIXED[stretch]
    if stretch not in _SOFT:
        raise unknown_name("stretch", stretch, STRETCHES)
    make, default = _SOFT[stretch]
    return make(default if softening is None else positive(softening, "softening"))


def positive(value: Any, what: str) -> float:
    """Return `value` as a float if it is a positive finite number.

    Raises
    ------
    InputError
        If it is not.
    """
    number = finite(value, what)
    if number <= 0:
        raise InputError(f"{what} must be greater than 0, got {value!r}")
    return number


def finite(value: Any, what: str) -> float:
    """Return `value` as a float if it is a finite number.

    Raises
    ------
    InputError
        If it is not.
    """
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise InputError(f"{what} must be a number, got {value!r}") from None
    if not np.isfinite(number):
        raise InputError(f"{what} must be finite, got {value!r}")
    return number
