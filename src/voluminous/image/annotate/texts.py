"""Title and time."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from ...errors import InputError
from ...units import as_quantity, is_quantity
from .lengths import number_text, readable, with_unit

if TYPE_CHECKING:
    from .sheet import Sheet

_TITLE = 1.25


def time_text(time: Any, volume: Any) -> str:
    """Return the time stamp; the empty string if there is none.

    Parameters
    ----------
    time : bool, str, float or Quantity
        True: what ``volume.meta`` tells.
    volume : Volume or None

    Raises
    ------
    InputError
        If it is nothing that can be written.
    """
    if time is True:
        return _of_meta({} if volume is None else volume.meta)
    if time is None or time is False:
        return ""
    if isinstance(time, str):
        return time
    time = as_quantity(time)
    if is_quantity(time):
        return _stamp(float(time.value), str(time.unit))
    try:
        return _stamp(float(time), "")
    except (TypeError, ValueError) as error:
        raise InputError(f"time must be a text, a number or a quantity, got {time!r}") from error


def _of_meta(meta: dict[str, Any]) -> str:
    time: Any = meta.get("time")
    redshift: Any = meta.get("redshift")
    words = []
    if is_quantity(time):
        words.append(_stamp(float(time.value), str(time.unit)))
    elif _is_number(time):
        words.append(_stamp(float(time), str(meta.get("time_unit", ""))))
    if _is_number(redshift):
        words.append(f"z = {float(redshift):.4g}")
    return ", ".join(words)


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def _stamp(number: float, unit: str) -> str:
    try:
        factor, name = readable(number, unit)
    except ValueError:  # a unit of a code
        factor, name = 1.0, unit
    return f"t = {with_unit(number * factor, name)}" if name else f"t = {number_text(number)}"


def draw_time(sheet: Sheet, words: str) -> None:
    """Write the time at the upper left."""
    x, y = sheet.pad, sheet.height - sheet.pad
    inks = sheet.inks(x, y - sheet.em, 0.5 * sheet.em * len(words), sheet.em)
    sheet.rimmed(x, y, words, inks, ha="left", va="top", gid="time")


def draw_title(sheet: Sheet, words: str, above: float) -> None:
    """Write the title above the picture, in letters small enough that it is no wider."""
    text = sheet.text(
        0.5 * sheet.width,
        sheet.height + above + 0.5 * sheet.em,
        words,
        fontsize=_TITLE * sheet.em,
        ha="center",
        va="bottom",
        gid="title",
    )
    renderer = sheet.canvas.get_renderer()
    try:
        wide = text.get_window_extent(renderer).width
    except ValueError:  # dollars that are no formula of matplotlib's
        text.set_parse_math(False)
        wide = text.get_window_extent(renderer).width
    if wide > sheet.width:
        text.set_fontsize(_TITLE * sheet.em * sheet.width / wide)
