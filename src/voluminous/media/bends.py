"""How a scalar departs from a line along a stretch of ray, and what that does to thin shells."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ..backend import dr
from ..backend.functions import precision_of
from .stretch import extremes

if TYPE_CHECKING:
    from ..expressions import Expression
    from .stretch import Panel, Stretch

# A scalar is taken as quadratic only where its slope changes by less than this over a panel.
_MOST_CHANGE = 0.5
# Second differences below this fraction of a scalar may be nothing but rounding.
_NOISE = {"single": 2e-6, "double": 4e-15}


def slope_factor(panel: Panel, expr: Expression, place: Any, narrow: Any) -> Any:
    """Return the mean slope of a scalar over its slope at a place in a panel.

    The mean of a shape over a panel is, with x for the variable of integration, that of shape/x';
    with a quadratic through the three nodes of the stretch it is that for a line, times this factor
    at the shape's centre of mass. One order more than a line gives, for thin shells and for wide.

    Parameters
    ----------
    place : array
        The centre of mass, as a fraction of the panel.
    """
    first, middle, last = panel.stretch.nodes(expr)
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


def _kinked(stretch: Stretch, expr: Expression) -> Any:
    """Return where a scalar may have a kink, which is no parabola.

    A panel and its halves would agree about one beside an end, all of them wrong.
    """
    _, _, bow = stretch.spread(expr)
    return ~(bow < dr.inf)


def bend(
    stretch: Stretch, expr: Expression, narrowness: Any, offset: Any, low: Any, high: Any
) -> Any:
    """Return the relative error that the bends of a scalar may make in a thin shell on a stretch.

    From the cubic part of the scalar (the third difference of its control points), which two halves
    and the whole may agree about by accident: a quadratic through the nodes misses half of it in
    slope; eight times that, since where a ray grazes a shell little is known of the slope there
    (of 1600 rays through a thin shell of a smooth field 0.8 % are then off by more than is said,
    1.3 % with a quarter of it).
    Zero for shells much wider than the change of the scalar.

    Parameters
    ----------
    narrowness : array
        One over the width of the shell.
    offset : callable
        Returns how far values of the scalar are from the shell's centre.
    low, high : array
        Between which offsets the shell is seen.
    """
    controls = stretch.controls(expr)
    b0, b1, b2, b3 = (offset(x) for x in controls)
    cubic = dr.abs(b3 - 3.0 * b2 + 3.0 * b1 - b0)
    # In narrow panels differences are nothing but rounding: more the narrower they are.
    rounding = _NOISE[precision_of(type(controls[0]))] * (dr.abs(controls[0]) + dr.abs(controls[3]))
    cubic = dr.select(cubic > type(cubic)(rounding), cubic, 0.0)
    nodes = [offset(x) for x in stretch.nodes(expr)]
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


def thinness(stretch: Stretch, expr: Expression, narrowness: Any, narrow: Any) -> Any:
    """Return how thin a shell is compared with the halves of a stretch: 0 (wide) to 1."""
    nodes = stretch.nodes(expr)
    first, last = (dr.abs(narrow(b - a)) for a, b in ((nodes[0], nodes[1]), (nodes[1], nodes[2])))
    wide = dr.select(first > last, first, last) * narrowness
    thin = 0.25 * wide * wide
    return dr.select(thin < 1.0, thin, 1.0)
