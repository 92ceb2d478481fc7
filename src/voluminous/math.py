"""Functions for media written in Python (`Medium.from_function`); they trace, on every device.

NumPy's functions do as well where a function is read as formulas (`expressions.symbols`); these
also where it cannot be and is given arrays of Dr.Jit's. Use `where` instead of ``if``: the function
is run once, to record what it computes, and then compiled for all cells at once.
"""

from __future__ import annotations

import functools
from typing import Any

from .errors import unknown_name
from .expressions.symbols import apply, is_symbolic

_SAME = (
    "exp",
    "log",
    "log2",
    "sqrt",
    "sin",
    "cos",
    "tan",
    "tanh",
    "sinh",
    "cosh",
    "abs",
    "floor",
    "ceil",
    "minimum",
    "maximum",
    "clip",
    "fma",
    "erf",
    "atan2",
    "power",
)

__all__ = ["interp", "log10", "where", *_SAME]


def where(condition: Any, if_true: Any, if_false: Any) -> Any:
    """Return `if_true` where the condition holds, else `if_false`."""
    from .backend import dr

    if is_symbolic(condition, if_true, if_false):
        return apply("where", condition, if_true, if_false)
    return dr.select(condition, if_true, if_false)


def interp(x: Any, xp: Any, fp: Any) -> Any:
    """Return the values of a table interpolated at x, as `numpy.interp` does.

    Parameters
    ----------
    x : number
        Where to evaluate; the traced argument.
    xp, fp : array_like, shape (n,)
        Increasing nodes, and the values there: linear in between, constant beyond both ends.

    Raises
    ------
    InputError
        If there are fewer than two nodes, they do not increase, or there are not as many values.
    """
    from .expressions.interpolation import interpolate
    from .expressions.parser import table

    if is_symbolic(x):
        return apply("interp", x, xp, fp)
    places, values = table(xp, fp)
    return interpolate(type(x), x, places, [values])[0]


def log10(x: Any) -> Any:
    """Return the decimal logarithm."""
    from .backend import dr

    return apply("log10", x) if is_symbolic(x) else dr.log2(x) * 0.30102999566398119521


def _evaluated(name: str, *values: Any) -> Any:
    """Return one of Dr.Jit's functions of arrays, or write it down for symbols."""
    from .backend import dr

    return apply(name, *values) if is_symbolic(*values) else getattr(dr, name)(*values)


def __getattr__(name: str) -> Any:
    if name in _SAME:
        return functools.partial(_evaluated, name)
    raise AttributeError(str(unknown_name("function", name, __all__)))
