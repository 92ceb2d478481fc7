"""The four vertices of the wall that a ray crosses, and their weights."""

from __future__ import annotations

from typing import Any

from ..backend import dr
from .contract import Corners


def pick(through: list[Any], values: list[Any]) -> Any:
    """Return the value that belongs to the axis of the wall crossed."""
    return dr.select(through[0], values[0], dr.select(through[1], values[1], values[2]))


def bilinear(base: Any, through: list[Any], fractions: list[Any], strides: list[Any]) -> Corners:
    """Return the vertices of a wall from its lower one, with bilinear weights."""
    f, s = fractions, strides
    u, v = pick(through, [f[1], f[2], f[0]]), pick(through, [f[2], f[0], f[1]])
    du, dv = pick(through, [s[1], s[2], s[0]]), pick(through, [s[2], s[0], s[1]])
    # Four products instead of six: the last three weights are differences.
    both = u * v
    vertex = [base, base + du, base + dv, base + du + dv]
    return Corners(vertex, [1.0 - u - v + both, u - both, v - both, both])


def trilinear(base: Any, fractions: list[Any], strides: list[Any]) -> Corners:
    """Return the eight vertices of a cell from its lower one, with trilinear weights."""
    vertices, weights = [base], [type(fractions[0])(1)]
    for f, stride in zip(fractions, strides, strict=True):
        vertices += [v + stride for v in vertices]
        weights = [w * (1.0 - f) for w in weights] + [w * f for w in weights]
    return Corners(vertices, weights)
