"""Which of several comes first, lane by lane."""

from __future__ import annotations

import functools
from typing import Any

from ...backend import dr


def either(a: Any, b: Any) -> Any:
    """Return where one of two holds."""
    return a | b


def both(a: Any, b: Any) -> Any:
    """Return where both of two hold."""
    return a & b


def later(a: Any, b: Any) -> Any:
    """Return the larger of two numbers that are no NaN."""
    return dr.select(a > b, a, b)


def lesser(a: Any, b: Any) -> Any:
    """Return the smaller of two numbers that are no NaN."""
    return dr.select(a < b, a, b)


def nearest(ways: list[Any]) -> list[Any]:
    """Return for each family whether its wall is the nearest; the first one where several are."""
    through, taken = [], None
    for k, way in enumerate(ways[:-1]):
        first = functools.reduce(both, [way <= other for other in ways[k + 1 :]])
        first = first if taken is None else first & ~taken
        taken = first if taken is None else taken | first
        through.append(first)
    return [*through, ~taken] if taken is not None else [ways[0] == ways[0]]
