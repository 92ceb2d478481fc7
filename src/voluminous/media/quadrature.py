"""Means over both halves of a panel of a ray, and their errors."""

from __future__ import annotations

from collections.abc import Sequence

from ..backend import dr
from ..backend.types import Float, Mask
from .panel import extremes

# Means converge with their order p: the error of the halves is their difference from the whole over
# 2^p - 1 (Richardson 1911), which is subtracted where the difference is below a part of the mean.
_SUBTRACTED = {1: 0.0, 2: 1 / 3, 4: 1 / 15}
_CLOSE = 0.05
# The error, as a part of the difference: at first order (kinks and jumps), where
# structures are in one half only, and in steps of many cells, whose walls are kinks, the difference
# may be small by accident. It is larger the larger the difference is.
_TOLD = {1: 3.0, 2: 1.0, 4: 0.45}
_TOLD_IF_THIN, _TOLD_IF_MANY, _TOLD_IF_FAR = 2.0, 1.0, 2.0
_MORE = 10.0


def doubled(
    whole: Float, first: Float, last: Float, order: int, many: Mask
) -> tuple[Float, Float, Float]:
    """Return the means over both halves of a panel, corrected by step doubling, and the error."""
    mean = 0.5 * (first + last)
    off, size = dr.abs(mean - whole), dr.abs(mean)
    close = off < _CLOSE * size
    close &= size > 0.0
    part = dr.select(close, _SUBTRACTED[order] * (mean - whole) / dr.select(close, mean, 1.0), 0.0)
    uneven = dr.abs(first - last) / dr.select(size > 0.0, 2.0 * size, 1.0)
    thin = uneven * uneven
    thin = thin * thin
    share = dr.select(many, _TOLD_IF_MANY, dr.fma(_TOLD_IF_THIN, thin, _TOLD[order]))
    share = dr.fma(_MORE, off / dr.select(close, size, 1.0), share)
    first, last = dr.fma(part, first, first), dr.fma(part, last, last)
    return first, last, off * dr.select(close, share, _TOLD_IF_FAR)


def simpson(first: Float, middle: Float, last: Float) -> Float:
    """Return the mean by Simpson's rule."""
    return dr.fma(2 / 3, middle, (1 / 6) * (first + last))


def with_values(values: Sequence[Float]) -> list[Float]:
    """Return values at places in a row, with that of a neighbour where there is none.

    Beside a vacuum, where n/t is 0/0, single places may have no value.
    """
    found = list(values)
    last = len(found) - 1
    pairs = [*((k, k - 1) for k in range(1, last + 1)), *((k, k + 1) for k in range(last)[::-1])]
    for k, near in pairs:
        found[k] = dr.select(dr.isfinite(found[k]), found[k], found[near])
    return found


def boole(values: Sequence[Float]) -> Float:
    """Return the mean by Boole's rule, from five values."""
    a, b, c, d, e = values
    return (7 / 90) * (a + e) + (32 / 90) * (b + d) + (12 / 90) * c


# Weights of five values in their quartic, half way from the first to the second, and to the third.
_MIDWAY = ((35, 140, -70, 28, -5), (-5, 60, 90, -20, 3))


def midway(values: Sequence[Float]) -> list[Float]:
    """Return five evenly spaced values, and those of their quartic between them, in order."""
    found = [values[0]]
    for k, value in enumerate(values[1:]):
        weights = _MIDWAY[k] if k < 2 else _MIDWAY[3 - k][::-1]
        found.append(
            sum(
                (w / 128 * v for w, v in zip(weights[1:], values[1:], strict=True)),
                weights[0] / 128 * values[0],
            )
        )
        found.append(value)
    return found


# The error of a parabola, as a part of the third difference times the distance from its ends.
_TOLD_BY_CUBIC = 0.7
# A scalar is inverted where its slope is at least this part of its mean slope.
_LEAST_SLOPE = 0.2
# And where the mean inverse slope differs by less than this from that at the centre of mass.
_MOST_CURVED = 0.3
# Errors of the mean inverse slope, as parts of the terms of second order and the quartic's slope.
_TOLD_BY_CHANGE, _TOLD_BY_CURVE, _TOLD_BY_BEND = 0.4, 0.4, 0.4


def inverse_slope(
    nodes: list[Float], cubic: Float, quartic: Float, place: Float, deviation: Float
) -> tuple[Float, Float, Mask]:
    """Return the mean inverse slope of a scalar over a shape, its error, and where it is usable.

    The mean of a shape over s is that of shape/x' over x, which has a closed form where x' is
    constant: this is the factor for a scalar that bends, relative to its mean slope.

    Parameters
    ----------
    nodes : list of arrays
        The scalar at the ends and in the middle.
    cubic, quartic : arrays
        Its third difference, and the fourth.
    place, deviation : arrays
        Centre of mass and standard deviation of the shape, as fractions of the change of x.
    """
    a, m, b = nodes
    rise, bow, c = b - a, 2.0 * (a - 2.0 * m + b), (4 / 3) * cubic
    per_rise = 1.0 / dr.select(rise == 0.0, 1.0, rise)
    bow, c = bow * per_rise, c * per_rise
    ends = 1.0 + 0.5 * c
    monotonic = (ends - dr.abs(bow) > _LEAST_SLOPE) & (1.0 - 0.25 * c > _LEAST_SLOPE)

    def slope(u: Float) -> Float:
        t = 2.0 * u - 1.0
        return dr.fma(c, dr.fma(0.75 * t, t, -0.25), dr.fma(bow, t, 1.0))

    def newton(u: Float, y: Float) -> Float:
        off = u * (u - 1.0) * dr.fma(c, u - 0.5, bow) + (u - y)
        u = u - off / slope(u)
        return dr.select(u > 0.0, dr.select(u < 1.0, u, 1.0), 0.0)

    near = newton(place, place)
    middle = newton(near, place)
    center = 1.0 / slope(middle)
    turn = 2.0 * dr.fma(c, 3.0 * middle - 1.5, bow) * center
    change = deviation * center * turn
    square = change * change
    second = 1.5 * square - 3.0 * c * center * (deviation * center) * (deviation * center)
    mean = dr.fma(center, second, center)
    missed = turn * (middle - near)
    error = missed * missed + _TOLD_BY_CHANGE * square + _TOLD_BY_CURVE * dr.abs(second)
    error = error + _TOLD_BY_BEND * dr.abs(quartic * per_rise) * mean
    good = monotonic & dr.isfinite(mean) & (dr.abs(second) < _MOST_CURVED)
    return mean, error * mean, good


def parabola(
    values: Sequence[Float], cubic: Float, place: Float, spread: Float
) -> tuple[Float, Float]:
    """Return the mean of a parabola through three values over a shape, and its error.

    It is not beyond the values: a gate is not negative.

    Parameters
    ----------
    values : sequence of arrays
        At the ends and in the middle.
    cubic : array
        The third difference, which tells the error.
    place, spread : arrays
        Centre of mass of the shape, and its variance as a part of `place` (1 - `place`).
    """
    a, m, b = values
    bow = 2.0 * (a - 2.0 * m + b)
    off = place * (1.0 - place) * (1.0 - spread)
    mean, (low, high) = dr.fma(place, b - a, a) - bow * off, extremes(values)
    mean = dr.select(mean > low, dr.select(mean < high, mean, high), low)
    return mean, _TOLD_BY_CUBIC * dr.abs(cubic) * off
