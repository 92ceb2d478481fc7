"""The colour of thin shells that absorb: more of their front is seen than of their back.

A panel takes the colour in the middle of a shell. Where the colour varies across the shell, and the
shell is opaque, that is off; a panel and its halves do not show it while the shell lies within one
of them, and agree about where its middle is.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ..backend import dr
from .stretch import NODES, extremes

if TYPE_CHECKING:
    from .context import Context
    from .modulation import Modulation
    from .stretch import Stretch

# What is seen of a slab of optical depth τ comes from τ/12 of its thickness before its middle on
# average, and from half of it at most.
_PER_DEPTH = 1.0 / 12.0
_MOST = 0.5


def extent_of(values: list[Any], thickness: Any) -> Any:
    """Return what part of the steeper half of a stretch a shell takes, from a scalar at nodes."""
    a, b, c = values
    rise = extremes([dr.abs(b - a), dr.abs(c - b)])[1]
    return dr.select(rise > 0.0, thickness / dr.select(rise > 0.0, rise, 1.0), dr.inf)


def unseen_change(
    modulation: Modulation, stretch: Stretch, context: Context, extent: Any, depth: Any
) -> Any:
    """Return the relative error of a shell's emission that its own absorption may make.

    Parameters
    ----------
    extent : array
        What part of a half of the stretch the shell takes. More than all of it counts as all.
    depth : array
        Its optical depth in a half.
    """
    if not modulation.painted:
        return stretch.length * 0.0
    nodes = [modulation.at_node(stretch, s, context)[1:] for s in NODES]
    return change_across(nodes, extent, depth)


def change_across(nodes: list[list[Any]], extent: Any, depth: Any) -> Any:
    """Return the same for a colour, or light, with given values at the three nodes.

    Parameters
    ----------
    nodes : three lists of arrays
        What each channel is multiplied with there.
    extent, depth : array
        As for `unseen_change`.
    """
    change = most = depth * 0.0
    for a, b, c in zip(*nodes, strict=True):
        change = extremes([change, dr.abs(b - a), dr.abs(c - b)])[1]
        most = extremes([most, dr.abs(a), dr.abs(b), dr.abs(c)])[1]
    shift = _PER_DEPTH * depth
    shift = dr.select(shift < _MOST, shift, _MOST)
    part = dr.select(extent < 1.0, extent, 1.0)
    off = change * part * shift / dr.select(most > 0.0, most, 1.0)
    return dr.select(off < 1.0, off, 1.0)
