"""Colours of objects: an intensity per channel."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..colormaps import get_color, is_name_and_alpha, without_alpha
from ..errors import InputError
from ..units import plain, unit_of

if TYPE_CHECKING:
    from .contract import SceneObject
    from .view import View


def check_colors(colors: Any, count: int, what: str) -> None:
    """Refuse what cannot be colours of `count` things, whatever the picture.

    Raises
    ------
    InputError
        If they are no finite numbers, or not as many.
    UnknownNameError
        If there is no colour of a name.
    """
    if _named(colors):
        _rgb(colors, count, what)
        return
    colors = without_alpha(colors, what)
    array = np.asarray(plain(colors, unit_of(colors), what), dtype=np.float64)
    if not np.all(np.isfinite(array)):
        raise InputError(f"{what} must be finite")
    if array.ndim > 2 or (array.ndim == 2 and len(array) not in (1, count)):
        raise InputError(
            f"{what} must be one for all (a name, a number, or one per channel), or a list of "
            f"{count} of them; got shape {array.shape}"
        )


def intensities(thing: SceneObject, colors: Any, count: int, view: View, unit: Any) -> np.ndarray:
    """Return the intensities of `count` things in all channels of a picture, shape (count, all).

    Parameters
    ----------
    colors : str, float, Quantity or array_like
        A name, a number, one per channel; or a list of `count` of them.
    unit : astropy unit or None
        What they are to be expressed in.

    Raises
    ------
    InputError
        If names or numbers do not fit the channels.
    """
    own = view.channels if thing.channel is None else 1
    if _named(colors):
        if view.channels != 3 or thing.channel is not None:
            place = "one channel" if thing.channel is not None else f"{view.channels} channel(s)"
            raise InputError(f"colors: names are red, green and blue; in {place} give numbers")
        array = _rgb(colors, count, "colors")
    else:
        colors = colors if own == 4 else without_alpha(colors, "colors")
        array = np.asarray(plain(colors, unit, "colors"), dtype=np.float64)
    array = array if array.ndim else np.full(own, float(array))
    if array.shape[-1] not in (1, own):
        raise InputError(
            f"colors: expected a number, or {own} (one per channel), or a list of {count} of "
            f"these, of shape ({count}, 1) or ({count}, {own}); got shape {array.shape}"
        )
    first = 0 if thing.channel is None else thing.channel
    found = np.zeros((count, view.all_channels))
    found[:, first : first + own] = array * (view.brightest if thing.relative else 1.0)
    return found


def _named(colors: Any) -> bool:
    if is_name_and_alpha(colors):  # which is refused, or a colour
        return False
    return isinstance(colors, str) or (
        isinstance(colors, (list, tuple, np.ndarray))
        and np.ndim(colors) > 0
        and len(colors) > 0
        and isinstance(colors[0], str)
    )


def _rgb(names: Any, count: int, what: str) -> np.ndarray:
    listed = [names] if isinstance(names, str) else list(names)
    if len(listed) not in (1, count):
        raise InputError(f"{what}: expected one name, or {count}, got {len(listed)}")
    return np.array([get_color(name) for name in listed])
