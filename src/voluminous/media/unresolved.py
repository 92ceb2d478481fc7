"""Errors of unresolved shells: curvature of the scalar, and colour varying across an opaque shell.

A panel uses the colour in the middle of a shell, but the front of an absorbing shell is seen better
than its back. If the colour varies across an opaque shell, this is an error that step doubling does
not detect while the shell lies within one half.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

from ..backend import dr
from ..backend.functions import precision_of
from ..backend.types import Float, Mask
from .shading import change_across
from .stretch import Straight, extremes

if TYPE_CHECKING:
    from ..expressions import Expression
    from .context import Context
    from .stretch import Panel, Stretch


# A scalar is taken as quadratic only where its slope changes by less than this over a panel.
_MOST_CHANGE = 0.5
# Second differences below this fraction of a scalar may be nothing but rounding.
_NOISE = {"single": 2e-6, "double": 4e-15}


def slope_factor(panel: Panel, expr: Expression, place: Float) -> Float:
    """Return the mean slope of a scalar over its slope at a place in a panel.

    The mean of a shape over a panel is, with x for the variable of integration, that of shape/x';
    with a quadratic through the three nodes of the stretch it is that for a line, times this factor
    at the shape's centre of mass. One order more than a line gives, for thin shells and for wide.

    The centre of mass, `place`, is a fraction of the panel.
    """
    first, middle, last = panel.stretch.nodes(expr)
    narrow = panel.stretch.context.narrow
    bow = narrow(2.0 * (first - 2.0 * middle + last))
    noise = narrow(_NOISE[precision_of(type(first))] * (dr.abs(first) + dr.abs(last)))
    bow = dr.select(dr.abs(bow) > noise, bow, 0.0)
    ends = panel.ends(expr)
    rise = narrow(ends[1] - ends[0])
    width = panel.last - panel.first
    change = 2.0 * width * width * bow * (place - 0.5)
    # An infinite rise is that of log10 from where nothing is.
    near = (dr.abs(change) < _MOST_CHANGE * dr.abs(rise)) & dr.isfinite(rise)
    if not expr.smooth:
        near &= ~_kinked(panel.stretch, expr)
    return dr.select(near, rise / dr.select(near, rise + change, 1.0), 1.0)


def _kinked(stretch: Stretch, expr: Expression) -> Mask:
    """Return where a scalar may have a kink, which a parabola cannot represent.

    Step doubling does not detect a kink beside an end.
    """
    return ~(stretch.spread(expr)[2] < dr.inf)


def bend(
    stretch: Stretch,
    expr: Expression,
    narrowness: Float,
    center: Float,
    low: Float,
    high: Float,
) -> Float:
    """Return the relative error by curvature of a scalar for a thin shell on a stretch.

    It follows from the cubic part of the scalar (the third difference of its control points), which
    step doubling may miss by accident: a quadratic through the nodes misses half of it in slope.
    The result is eight times that, since the slope is uncertain where a ray grazes a shell (of 1600
    rays through a thin shell of a smooth field 0.8 % then exceed the estimate, 1.3 % with a quarter
    of it). It is zero for shells much wider than the change of the scalar.

    The shell is seen from `low` to `high` beyond its centre; `narrowness` is one over its width.
    """
    controls = stretch.controls(expr)
    narrow = stretch.context.narrow
    b0, b1, b2, b3 = (narrow(x - center) for x in controls)
    cubic = dr.abs(b3 - 3.0 * b2 + 3.0 * b1 - b0)
    # In narrow panels differences are nothing but rounding: more the narrower they are.
    rounding = _NOISE[precision_of(type(controls[0]))] * (dr.abs(controls[0]) + dr.abs(controls[3]))
    cubic = dr.select(cubic > type(cubic)(rounding), cubic, 0.0)
    nodes = [narrow(x - center) for x in stretch.nodes(expr)]
    total = cubic * 0.0
    for a, b in ((nodes[0], nodes[1]), (nodes[1], nodes[2])):
        least, largest = extremes([a, b])
        rise = largest - least
        wide = rise * narrowness
        thin = 0.25 * wide * wide
        # The slope per stretch is twice the rise of a half.
        own = dr.select(thin < 1.0, thin, 1.0) * 2.0 * cubic / dr.select(rise > 0.0, rise, 1.0)
        own = dr.select(dr.isnan(own), 0.0, own)  # of infinite values: log10 of zeros
        own = dr.select((largest >= low) & (least <= high), own, 0.0)
        total = dr.select(own > total, own, total)
    return dr.select(total < 1.0, total, 1.0)


def thinness(stretch: Stretch, expr: Expression, narrowness: Float) -> Float:
    """Return the thinness of a shell relative to the halves of a stretch: 0 (wide) to 1."""
    narrow, (a, b, c) = stretch.context.narrow, stretch.nodes(expr)
    first, last = narrow(dr.abs(b - a)), narrow(dr.abs(c - b))
    wide = dr.select(first > last, first, last) * narrowness
    thin = 0.25 * wide * wide
    return dr.select(thin < 1.0, thin, 1.0)


def extent_of(values: list[Float], thickness: Float) -> Float:
    """Return the part of the steeper half of a stretch that a shell fills."""
    a, b, c = values
    rise = extremes([dr.abs(b - a), dr.abs(c - b)])[1]
    return dr.select(rise > 0.0, thickness / dr.select(rise > 0.0, rise, 1.0), dr.inf)


# Distance of a parabola from its chord, as a fraction of the second difference; and the excess of
# u³ over that in the second half of a stretch.
_SAG, _CUBIC = 0.125, 0.1
# Errors are relative to the factors at a shell, which may be this much fainter than the brightest
# on the stretch; below, panels must be narrower if more than the second part may be missed.
_FAINTEST, _LOST = 0.05, 1e-3


@dataclass
class LookedUp:
    """Shells of one scalar on a stretch, within which colours, light and gates vary.

    They are seen in `ranges` of the scalar; `thin` is their thinness, from 0 to 1, since curvature
    does not move the middle of a wide shell. A shell fills a part `extent` of the steeper half of
    the stretch, with an optical depth (zero where its colour cannot vary unseen). `factors` are
    those of extinction and each channel at both ends and in the middle; empty if they are one.
    """

    expr: Expression
    ranges: list[tuple[Float, Float]]
    thin: Float
    extent: Float
    depth: Float
    factors: list[list[Float]]

    def error(self, stretch: Stretch, context: Context) -> Float:
        """Return the hidden relative error of emission and extinction."""
        misplaced, _ = self._misplaced(stretch, context)
        if not self.factors or not self.factors[0][1:]:
            return misplaced + stretch.length * 0.0
        return misplaced + change_across([f[1:] for f in self.factors], self.extent, self.depth)

    def lost(self, stretch: Stretch, context: Context) -> Mask:
        """Return where the factors are too small for a relative error: panels must be narrower."""
        return self._misplaced(stretch, context)[1]

    def _misplaced(self, stretch: Stretch, context: Context) -> tuple[Float, Mask]:
        """Return the error of factors evaluated where the chord, not the curve, meets a shell."""
        total, lost = stretch.length * 0.0, stretch.length < 0.0
        if not self.factors or isinstance(stretch, Straight):
            return total, lost
        nodes = stretch.nodes(self.expr)
        sag = context.narrow(_sag(stretch, self.expr))
        for half, ends in enumerate(pairwise(nodes)):
            low, high = extremes(ends)
            near = stretch.length < 0.0
            for first, last in self.ranges:
                near |= (high >= first) & (low <= last)
            rise = context.narrow(high - low)
            off = dr.select(sag < rise, sag / dr.select(rise > 0.0, rise, 1.0), 1.0)
            off = dr.select(near & (sag > 0.0), self.thin * off, 0.0)
            # The gate alone, to which extinction is proportional, and the colours seen through it.
            for group in ([f[:1] for f in self.factors], [f[1:] for f in self.factors]):
                if group[0]:
                    change, least = _change(group, half)
                    lost |= (least < _FAINTEST) & (off * change > _LOST)
                    own = off * change / dr.select(least > _FAINTEST, least, _FAINTEST)
                    total = dr.select(own > total, own, total)
        return total, lost


def _sag(stretch: Stretch, expr: Expression) -> Float:
    """Return the distance of a scalar from its chords, above rounding."""
    first, middle, last = stretch.nodes(expr)
    b0, b1, b2, b3 = stretch.controls(expr)
    noise = _NOISE[precision_of(type(first))] * (dr.abs(first) + dr.abs(last))
    bow = dr.abs(first - 2.0 * middle + last)
    cubic = dr.abs(b3 - 3.0 * b2 + 3.0 * b1 - b0)
    sag = dr.select(bow > noise, _SAG * bow, 0.0) + dr.select(cubic > noise, _CUBIC * cubic, 0.0)
    return dr.select(dr.isfinite(sag), sag, 0.0)  # log10 of zeros is treated elsewhere


def _change(places: list[list[Float]], half: int) -> tuple[Float, Float]:
    """Return the change of factors in a half, and their least size, relative to the largest."""
    change = extremes([dr.abs(b - a) for a, b in zip(*places[half : half + 2], strict=True)])[1]
    bright = [extremes([dr.abs(value) for value in place])[1] for place in places]
    least, most = extremes(bright)
    per_most = dr.select(most > 0.0, 1.0 / dr.select(most > 0.0, most, 1.0), 0.0)
    return change * per_most, least * per_most


# The count of a structure wider than a panel, relative to a narrower one.
WIDE = 0.75


def core(there: Mask, narrow: Mask, varies: bool, like: Float) -> Float:
    """Return the count of a structure `there` in a half of a stretch, see `Medium.cores`.

    A `narrow` one whose colour varies counts as two, one in front of the other, whose mixture step
    doubling may not detect.
    """
    own = dr.select(narrow, like * 0.0 + (2.0 if varies else 1.0), WIDE)
    return dr.select(there, own, 0.0)
