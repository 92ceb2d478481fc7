"""Choices lane by lane, and interpolation between the vertices of a cell or a wall."""

from __future__ import annotations

import functools
import operator

from ..backend import dr
from ..backend.types import Float, Int, Mask
from .contract import Corners


def lesser(a: Float, b: Float) -> Float:
    """Return the smaller of two numbers that are no NaN: one instruction, dr.minimum takes four."""
    return dr.select(a < b, a, b)


def greater(a: Float, b: Float) -> Float:
    """Return the larger of two numbers that are no NaN."""
    return dr.select(a > b, a, b)


def least(values: list[Float]) -> Float:
    """Return the smallest of some numbers."""
    return functools.reduce(lesser, values)


def nearest(distances: list[Float]) -> list[Mask]:
    """Return for each axis whether its wall is the nearest; the first one where several are."""
    through, taken = [], None
    for k, distance in enumerate(distances[:-1]):
        first = functools.reduce(operator.and_, [distance <= other for other in distances[k + 1 :]])
        first = first if taken is None else first & ~taken
        taken = first if taken is None else taken | first
        through.append(first)
    return [*through, distances[0] == distances[0] if taken is None else ~taken]


def pick(through: list[Mask], values: list[Float]) -> Float:
    """Return the value that belongs to the axis of the wall crossed, of three."""
    return dr.select(through[0], values[0], dr.select(through[1], values[1], values[2]))


def bilinear(base: Int, through: list[Mask], fractions: list[Float], strides: list[Int]) -> Corners:
    """Return the vertices of the wall across an axis, and bilinear weights.

    From its lower vertex, where in the cell the ray is along each axis, and the steps from vertex
    to vertex.
    """
    f, s = fractions, strides
    u, v = pick(through, [f[1], f[2], f[0]]), pick(through, [f[2], f[0], f[1]])
    du, dv = pick(through, [s[1], s[2], s[0]]), pick(through, [s[2], s[0], s[1]])
    # Four products instead of six: the last three weights are differences.
    both = u * v
    vertex = [base, base + du, base + dv, base + du + dv]
    return Corners(vertex, [1.0 - u - v + both, u - both, v - both, both])


def trilinear(base: Int, fractions: list[Float], strides: list[Int]) -> Corners:
    """Return the eight vertices of a cell from its lower one, with trilinear weights."""
    vertices, weights = [base], [type(fractions[0])(1)]
    for f, stride in zip(fractions, strides, strict=True):
        vertices += [v + stride for v in vertices]
        weights = [w * (1.0 - f) for w in weights] + [w * f for w in weights]
    return Corners(vertices, weights)
