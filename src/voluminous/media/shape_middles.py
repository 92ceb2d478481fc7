"""Where the mass of a shape is in a panel over which its argument is linear."""

from __future__ import annotations

from typing import Any

from ..backend import dr
from ..backend.functions import decay
from .modulation import Middle

# Half width, in σ, up to which little is lost by a rational function.
_NARROW = 0.25


def gaussian_middle(first: Any, last: Any, mean: Any) -> Middle:
    """Return where the mass of exp(-z²/2) is between two distances from the centre.

    With t from -1 to 1 over the panel, z = m + h t, the mean of z is the difference of exp(-z²/2)
    at both ends over its integral. For narrow panels, where that is 0/0, t = -m h / (h² + 3). The
    variance is 1/3 for narrow panels and 1/h² for wide ones: 1/(h² + 3).

    Parameters
    ----------
    mean : array
        The mean of exp(-z²/2) over the panel.
    """
    middle, half = 0.5 * (first + last), 0.5 * (last - first)
    variance = 1.0 / (half * half + 3.0)
    mass = 2.0 * half * mean
    drop = decay(0.5 * first * first) - decay(0.5 * last * last)
    wide = (dr.abs(half) > _NARROW) & (mean > 0.0) & dr.isfinite(half)
    center = (drop / dr.select(wide, mass, 1.0) - middle) / dr.select(wide, half, 1.0)
    return _middle(dr.select(wide, center, -middle * half * variance), variance)


def box_middle(first: Any, last: Any) -> Middle:
    """Return where the part of the panel is in which z is from -1 to 1; exact."""
    low, high = _part_within(first, last)
    half = 0.5 * (last - first)
    per_half = dr.select(half == 0.0, 0.0, 1.0 / half)
    extent = dr.select(half == 0.0, 1.0, 0.5 * (high - low) * per_half)
    center = 0.5 * (low + high) - 0.5 * (first + last)
    return _middle(center * per_half, extent * extent / 3.0)


def box_extent(first: Any, last: Any) -> Any:
    """Return what part of the panel it is in which z is from -1 to 1."""
    low, high = _part_within(first, last)
    way = dr.abs(last - first)
    inside = dr.select((first >= -1.0) & (first <= 1.0), type(way)(1), 0.0)
    return dr.select(way == 0.0, inside, (high - low) / dr.select(way == 0.0, 1.0, way))


def _part_within(first: Any, last: Any) -> tuple[Any, Any]:
    low, high = dr.select(first < last, first, last), dr.select(first < last, last, first)
    return _within(low), _within(high)


def _within(z: Any) -> Any:
    return dr.select(z < -1.0, -1.0, dr.select(z > 1.0, 1.0, z))


def _middle(t: Any, variance: Any) -> Middle:
    """Return the middle for a centre of mass and a variance on [-1, 1]."""
    t = dr.select(dr.isnan(t), 0.0, t)  # of infinite ends: log10 where nothing is
    t = dr.select(t < -1.0, -1.0, dr.select(t > 1.0, 1.0, t))
    # What is inside has at most the variance of masses at both ends, 1 - t².
    room = 1.0 - t * t
    spread = variance / dr.select(room > 0.0, room, 1.0)
    return Middle(0.5 + 0.5 * t, dr.select(spread < 1.0 / 3.0, spread, 1.0 / 3.0))
