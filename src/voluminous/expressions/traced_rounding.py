"""Ends of intervals in kernels, moved out by what rounding may lose.

A few ε of the value are simpler and faster than error-free transformations (`error_free`), and wide
enough on devices whose division and square root are not rounded correctly.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..backend import dr

# In ε: what one of the four operations loses is 0.5, and 2 by division on a GPU.
ROUNDING = 4.0


def float_info(real: Any) -> Any:
    """Return NumPy's description of the numbers of a Dr.Jit type."""
    return np.finfo(f"f{dr.itemsize_v(real)}")


def lowered(value: Any, loss: Any = ROUNDING) -> Any:
    """Return what a computed value may be at least, if it is off by `loss` ε.

    Parameters
    ----------
    value : Dr.Jit float array
        As computed. A positive one never becomes negative; of zero it is not known whether it is
        an underflow, so that it does. An infinite one may be an overflow.
    loss : float or array
        In ε of the value.
    """
    info = float_info(type(value))
    # Dr.Jit's functions overflow a little below the largest number.
    most = 2.0 ** (info.maxexp - 1)
    capped = dr.select(value > most, most, value)
    # They underflow just above the smallest normal number.
    moved = dr.fma(dr.abs(capped), -float(info.eps) * loss, capped) - 2 * float(info.tiny)
    return dr.select((value > 0) & (moved < 0), 0, moved)


def raised(value: Any, loss: Any = ROUNDING) -> Any:
    """Return what a computed value may be at most; see `lowered`."""
    return -lowered(-value, loss)


def smaller(left: Any, right: Any) -> Any:
    """Return the smaller of two arrays without NaN (`dr.minimum` looks for them)."""
    return dr.select(left < right, left, right)


def larger(left: Any, right: Any) -> Any:
    """Return the larger of two arrays without NaN."""
    return dr.select(left > right, left, right)


def positive(value: Any) -> Any:
    """Return a value without NaN, and zero in place of negative ones."""
    return dr.select(value < 0, 0, value)
