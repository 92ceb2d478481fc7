"""Which channels are shown, and in what colours."""

from __future__ import annotations

import operator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..colormaps import get_color, without_alpha
from ..errors import InputError

# Two channels get colours that people with any kind of colour vision tell apart, and that add up
# to a near white: orange and blue.
_TWO = ((1.0, 0.6, 0.2), (0.1, 0.4, 1.0))
_WHITE = (1.0, 1.0, 1.0)


def chosen(channels: Any, count: int) -> list[int]:
    """Return the indices of the channels to show, out of `count`.

    Raises
    ------
    InputError
        If an index is not an integer from 0 to count − 1.
    """
    if channels is None:
        return list(range(count))
    try:
        indices = [operator.index(c) for c in np.atleast_1d(np.asarray(channels))]
    except TypeError:
        indices = []
    if not indices or min(indices) < 0 or max(indices) >= count:
        raise InputError(
            f"channels must be integers from 0 to {count - 1}, as the image has {count} "
            f"channel{'s' * (count > 1)}; got {channels!r}"
        )
    return indices


def single(channels: Any, count: int, why: str) -> int:
    """Return the index of the one channel to show.

    Raises
    ------
    InputError
        If more than one is left; says `why` it must be one.
    """
    indices = chosen(channels, count)
    if len(indices) != 1:
        raise InputError(
            f"{why} shows one channel, not {len(indices)}: choose one with channels=0 … {count - 1}"
        )
    return indices[0]


def matrix(mix: Any, count: int) -> NDArray[np.float64]:
    """Return red, green and blue of each of `count` channels, shape (count, 3).

    Parameters
    ----------
    mix : array_like or None
        Numbers or names of colours; None for the default: one channel grey, two orange and
        blue, three red, green and blue, and every further one white.

    Raises
    ------
    InputError
        If the shape is wrong or a value is not finite.
    """
    if mix is None:
        return _default(count)
    if isinstance(mix, (list, tuple, np.ndarray)):
        mix = [get_color(c) if isinstance(c, str) else without_alpha(c, "mix") for c in mix]
    try:
        colors = np.array(mix, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"mix must be numbers, a row (r, g, b) per channel; got {mix!r}") from None
    if colors.shape != (count, 3) or not np.isfinite(colors).all():
        raise InputError(
            f"mix must have shape ({count}, 3) and be finite: a row (r, g, b) for each channel "
            f"that is shown; got shape {colors.shape}"
        )
    return colors


def _default(count: int) -> NDArray[np.float64]:
    if count == 1:
        return np.array([_WHITE])
    if count == 2:
        return np.array(_TWO)
    return np.array([*np.eye(3), *[_WHITE] * (count - 3)])
