"""Functions for media written in Python (`Medium.from_function`); they trace, on every device.

Use these instead of NumPy's, and `where` instead of ``if``: the function is run once, to record
what it computes, and then compiled for all cells at once.
"""

from __future__ import annotations

from typing import Any

from .errors import unknown_name

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

__all__ = ["log10", "where", *_SAME]


def where(condition: Any, if_true: Any, if_false: Any) -> Any:
    """Return `if_true` where the condition holds, else `if_false`."""
    from .backend import dr

    return dr.select(condition, if_true, if_false)


def log10(x: Any) -> Any:
    """Return the decimal logarithm."""
    from .backend import dr

    return dr.log2(x) * 0.30102999566398119521


def __getattr__(name: str) -> Any:
    if name in _SAME:
        from .backend import dr

        return getattr(dr, name)
    raise AttributeError(str(unknown_name("function", name, __all__)))
