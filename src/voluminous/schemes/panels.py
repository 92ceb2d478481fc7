"""Panels: parts of a segment that are as wide as the medium lets them be."""

from __future__ import annotations

from typing import Any

from ..backend import dr


def next_panel(good: Any, begin: Any, width: Any) -> tuple[Any, Any]:
    """Return where the panel begins that comes after one, and how wide it is, in segments.

    One that is good enough is left behind, and the next tried twice as wide, if there is room;
    another is tried again, half as wide.
    """
    begin = dr.select(good, begin + width, begin)
    width = dr.select(good, 2.0 * width, 0.5 * width)
    return begin, dr.select(width < 1.0 - begin, width, 1.0 - begin)


def known_stretch(source: Any, cubics: Any, known: Any, length: Any, *, rough: bool = False) -> Any:
    """Return a segment's stretch with what was computed of it outside of a branch."""
    whole = source.stretch(cubics, length, rough=rough)
    for expr, values in zip(source.scalars, known, strict=True):
        whole.set_known(expr, values)
    return whole
