"""Functions for media written in Python (`Medium.from_function`); they trace, on every device.

NumPy's functions do as well where a function is read as formulas (`expressions.symbols`); these
also work where it cannot be read and gets Dr.Jit's arrays. Use `where` instead of ``if``: the
function is called once, to record its operations, and then compiled for all cells.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from .errors import unknown_name
from .expressions.symbols import apply, is_symbolic

if TYPE_CHECKING:
    from .backend.types import Float, Mask

_SAME = "exp log log2 sqrt sin cos tan tanh sinh cosh abs floor ceil minimum maximum clip fma erf"
_NAMES = (*_SAME.split(), "atan2", "power")

__all__ = ["interp", "log10", "where", *_NAMES]


def where(condition: Mask, if_true: Float, if_false: Float) -> Float:
    """Return `if_true` where the condition holds, else `if_false`."""
    from .backend import dr

    if is_symbolic(condition, if_true, if_false):
        return apply("where", condition, if_true, if_false)
    return dr.select(condition, if_true, if_false)


def interp(x: Float, xp: Any, fp: Any) -> Float:
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
    from .expressions.drjit_ops import interpolate
    from .expressions.parser import table

    if is_symbolic(x):
        return apply("interp", x, xp, fp)
    places, values = table(xp, fp)
    return interpolate(type(x), x, places, [values])[0]


def log10(x: Float) -> Float:
    """Return the decimal logarithm."""
    return apply("log10", x) if is_symbolic(x) else _evaluated("log2", x) * 0.30102999566398119521


def _evaluated(name: str, *values: Float) -> Float:
    from .backend import dr

    return apply(name, *values) if is_symbolic(*values) else getattr(dr, name)(*values)


def __getattr__(name: str) -> Callable[..., Float]:
    if name in _NAMES:
        return functools.partial(_evaluated, name)
    raise AttributeError(str(unknown_name("function", name, __all__)))
