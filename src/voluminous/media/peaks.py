"""Peaks and steps of expressions that places on a stretch do not show: what derivatives allow."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from ..backend import dr
from ..expressions import Expression
from ..expressions.traced_rounding import larger
from .stretch import extremes
from .turning import may_turn, undecided, within

if TYPE_CHECKING:
    from .stretch import Stretch

# By so much more than at both ends and in the middle a peak counts as hidden.
_MORE = 0.25
# A stretch is too wide for places on it to tell what is between, where the second derivative, with
# its length as unit, may be so many times the size of what is seen, and the first so many. Before
# that was asked, 3 to 18 % of the pixels of noise were beyond their error behind peaks and steps a
# hundredth of the noise wide, by up to 0.06 of the maximum; now 0 to 0.5 %, by less than the
# tolerance, in 1 to 1.4 of the time.
_BENT, _STEEP = 64.0, 4.0
_FAR = 0.5
# Halves of a panel have no order from such a second derivative on.
_SHARP = 16.0
# What a mean loses by a kink at which a slope of one turns round, where it is as far from an end of
# a panel as the nearest place in one of its halves (Gauss-Legendre): no place is beyond.
_BLIND = (0.5 * (0.5 - math.sqrt(0.15))) ** 2


def sharpness(stretch: Stretch, expr: Expression) -> Any:
    """Return how sharply an expression may bend, over how large it is: 0 (hardly) to 1 (a kink)."""
    _, _, bow = stretch.spread(expr)
    size = _SHARP * _size(stretch, expr)
    return dr.select(bow < size, bow / size, dr.select(bow > 0.0, 1.0, 0.0))


def unseen_kink(stretch: Stretch, expr: Expression) -> Any:
    """Return the relative error of means that a kink beside an end of a stretch may make.

    A panel and its halves agree about it. What is too steep for them is a matter of `may_peak`.
    """
    _, slope, bow = stretch.spread(expr)
    size = _size(stretch, expr)
    kinked = ~(bow < dr.inf) & (slope <= _STEEP * size) & (size > 0.0) & (size < dr.inf)
    return dr.select(kinked, _BLIND * slope / dr.select(kinked, size, 1.0), 0.0)


def _size(stretch: Stretch, expr: Expression) -> Any:
    return extremes([dr.abs(x) for x in stretch.nodes(expr)])[1]


def may_peak(stretch: Stretch, expr: Expression, least: Any) -> Any:
    """Return where there may be peaks or steps that places on a stretch do not show.

    Parameters
    ----------
    least : array
        What goes less far than that is no matter.
    """
    if stretch.rough:
        found, width = _may_exceed(stretch, expr, least)
    else:
        width, slope, bow = stretch.spread(expr)
        size = larger(_size(stretch, expr), least)
        calm = (bow <= _BENT * size) | (slope <= _STEEP * size)
        # Where nothing is known of derivatives, as of ``n % 0.3``, it must not go far.
        calm |= ~(slope < dr.inf) & (width <= _FAR * size)
        found = ~(calm | (width <= least))
    return found & ~undecided(stretch, expr, width)


def _may_exceed(stretch: Stretch, expr: Expression, least: Any) -> tuple[Any, Any]:
    """Return where an expression may exceed what is seen of it by a quarter, and by what shows.

    And how far it may go.
    """
    low, high = _range(stretch, expr)
    below, above = extremes(stretch.nodes(expr))
    size = dr.fma(_MORE, extremes([dr.abs(below), dr.abs(above)])[1], least)
    return (high - above > size) | (below - low > size), high - low


def _range(stretch: Stretch, expr: Expression) -> tuple[Any, Any]:
    """Return between which values an expression stays: quickly, if not closely."""
    if not may_turn(expr, stretch.context):
        return stretch.hull(expr)
    found = within(stretch, expr)
    return found.lo, found.hi
