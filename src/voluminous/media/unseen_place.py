"""Colours and gates of thin shells that are looked up at the wrong place.

A panel looks where a line through its ends passes a shell. Where the scalar bends, the shell is
elsewhere; a panel and its halves do not show that where they find one colour at two wrong places,
beyond an end of a colormap say.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any

from ..backend import dr
from ..backend.functions import precision_of
from .stretch import NODES, Straight, extremes

if TYPE_CHECKING:
    from ..expressions import Expression
    from .context import Context
    from .modulation import Modulation
    from .stretch import Stretch

# How far a parabola is from the line through two of its points, of the second difference of these
# and a third, as far away; and what u³ has of that more in the second half of a stretch.
_SAG, _CUBIC = 0.125, 0.1
# Second differences below this fraction of a scalar may be nothing but rounding.
_NOISE = {"single": 2e-6, "double": 4e-15}
# What is found may be so much fainter than the brightest on the stretch, for all that errors are
# told as parts of it; where it may be fainter still, so much of the brightest may be missed.
_FAINTEST, _LOST = 0.05, 1e-3


def misplaced_change(
    modulation: Modulation,
    stretch: Stretch,
    context: Context,
    expr: Expression,
    ranges: Any,
    thin: Any,
) -> tuple[Any, Any]:
    """Return the relative error of what shells show that lie elsewhere than a line says.

    Parameters
    ----------
    expr : Expression
        What the shells are shells of.
    ranges : sequence of pairs of arrays
        Between which of its values shells are seen.
    thin : array or float
        How thin they are: the middle of a wide shell is where it is, whatever bends do.

    Returns
    -------
    error : array
        Of emission and extinction, as a part of them.
    lost : array of bool
        Where that says nothing, since hardly anything is found, and panels must be narrower.
    """
    total, lost = stretch.length * 0.0, stretch.length < 0.0
    if modulation.fixed or isinstance(stretch, Straight):
        return total, lost
    nodes = stretch.nodes(expr)
    sag = context.narrow(_sag(stretch, expr))
    factors = [modulation.at_node(stretch, s, context) for s in NODES]
    for half, ends in enumerate(pairwise(nodes)):
        low, high = extremes(ends)
        near = stretch.length < 0.0
        for first, last in ranges:
            near |= (high >= first) & (low <= last)
        rise = context.narrow(high - low)
        off = dr.select(sag < rise, sag / dr.select(rise > 0.0, rise, 1.0), 1.0)
        off = dr.select(near & (sag > 0.0), thin * off, 0.0)
        # The gate alone, which extinction goes with, and the colours seen through it.
        for group in ([f[:1] for f in factors], [f[1:] for f in factors]):
            if group[0]:
                change, least = _change(group, half)
                lost |= (least < _FAINTEST) & (off * change > _LOST)
                own = off * change / dr.select(least > _FAINTEST, least, _FAINTEST)
                total = dr.select(own > total, own, total)
    return total, lost


def _sag(stretch: Stretch, expr: Expression) -> Any:
    first, middle, last = stretch.nodes(expr)
    b0, b1, b2, b3 = stretch.controls(expr)
    noise = _NOISE[precision_of(type(first))] * (dr.abs(first) + dr.abs(last))
    bow = dr.abs(first - 2.0 * middle + last)
    cubic = dr.abs(b3 - 3.0 * b2 + 3.0 * b1 - b0)
    sag = dr.select(bow > noise, _SAG * bow, 0.0) + dr.select(cubic > noise, _CUBIC * cubic, 0.0)
    return dr.select(dr.isfinite(sag), sag, 0.0)  # log10 of nothing: other rules see to that


def _change(places: list[list[Any]], half: int) -> tuple[Any, Any]:
    """Return what factors change by in a half, and what they are at least, in their largest."""
    change = extremes([dr.abs(b - a) for a, b in zip(*places[half : half + 2], strict=True)])[1]
    bright = [extremes([dr.abs(value) for value in place])[1] for place in places]
    least, most = extremes(bright)
    per_most = dr.select(most > 0.0, 1.0 / dr.select(most > 0.0, most, 1.0), 0.0)
    return change * per_most, least * per_most
