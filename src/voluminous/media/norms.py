"""Norms from matplotlib, which is imported only when one is asked for."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import numpy as np

from ..errors import InputError, unknown_name


def values_at(position: np.ndarray, norm: Any, vmin: float, vmax: float) -> np.ndarray:
    """Return the values that a norm over a range maps to positions from 0 to 1, ends exact.

    Raises
    ------
    InputError
        If the norm has no inverse.
    """
    fitted = get_norm(norm, vmin, vmax)
    try:
        values = np.array(fitted.inverse(position), dtype=np.float64)
    except (ValueError, AttributeError) as error:
        raise InputError(
            f"a {type(norm).__name__} cannot be used from {vmin:g} to {vmax:g}: {error}; use an "
            "invertible norm, such as 'linear' or 'log', or a Table"
        ) from error
    values[0], values[-1] = vmin, vmax
    return values


def get_norm(norm: Any, vmin: float, vmax: float) -> Any:
    """Return an invertible matplotlib norm over a range, from its name (default linear) or itself.

    A norm object is copied, and takes the range where it has none of its own.

    Raises
    ------
    UnknownNameError
        If there is no scale of that name.
    InputError
        If the range does not suit it (a logarithm of something not positive), or is not its own.
    """
    if norm is None or isinstance(norm, str):
        return _named_norm(norm or "linear", vmin, vmax)
    from matplotlib import colors

    if not isinstance(norm, colors.Normalize):
        raise InputError(f"norm must be the name of a norm or a matplotlib one, got {norm!r}")
    fitted = copy.deepcopy(norm)
    for what, value in (("vmin", vmin), ("vmax", vmax)):
        own = getattr(fitted, what)
        if own is None:
            setattr(fitted, what, value)
        elif own != value:
            raise InputError(
                f"{what} is {value:g}, but the norm has {what} = {own:g}; "
                f"give the same, or a norm without {what}"
            )
    return fitted


def _named_norm(name: str, vmin: float, vmax: float) -> Any:
    from matplotlib import colors

    linear_below = 1e-3 * max(abs(vmin), abs(vmax))
    named: dict[str, Callable[[], Any]] = {
        "linear": lambda: colors.Normalize(vmin, vmax),
        "log": lambda: colors.LogNorm(vmin, vmax),
        "symlog": lambda: colors.SymLogNorm(linear_below, vmin=vmin, vmax=vmax),
        "asinh": lambda: colors.AsinhNorm(linear_below, vmin=vmin, vmax=vmax),
    }
    if name not in named:
        raise unknown_name("norm", name, named)
    if name == "log" and vmin <= 0:
        raise InputError(f"a logarithmic norm needs a positive vmin, got {vmin:g}")
    return named[name]()
