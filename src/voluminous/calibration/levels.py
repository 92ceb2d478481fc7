"""Which values of a scalar are worth a shell each."""

from __future__ import annotations

import numpy as np

from .histogram import Histogram

# An isosurface is worth showing if its area is this part of the diagonal squared: a sphere a
# fiftieth of the diagonal across.
_SEEN = 1e-3
# Of data with one sign, what is lower than in nearly all of the volume surrounds nothing.
_LOWEST = 0.01
# The steepness is smoothed over this part of the distance of levels.
_SMOOTHING = 0.12


def levels(
    found: Histogram, n: int, *, signed: bool = False, floor: float = 0.0
) -> tuple[np.ndarray, float]:
    """Return n increasing levels and their typical distance.

    The range of values whose isosurfaces are large enough to be seen is cut into n equal slots,
    and each gets one level: where x is steepest, for that is where materials meet, with a
    preference for the middle of the slot (a factor 1 - u², u = ±1 at its ends), which keeps levels
    apart. Of data without materials, whose steepness is a power law, all slots look alike, and
    the levels are equally spaced.

    Parameters
    ----------
    found : Histogram
        Of the scalar.
    n : int
        Number of levels.
    signed : bool
        True if both ends of the range are of interest, as of a component of a velocity.
    floor : float
        If positive, what is below is noise.
    """
    low, high = _worth_showing(found, signed)
    if floor > 0:
        low = min(max(low, floor), 0.5 * (low + high))
    slot = (high - low) / n
    steep, x = found.steepness(_SMOOTHING * slot), found.centers
    chosen = []
    for k in range(n):
        u = (x - low - (k + 0.5) * slot) / (0.5 * slot)
        score = np.where(np.abs(u) < 1, steep * (1 - u * u), 0.0)
        best = int(np.argmax(score))
        chosen.append(float(x[best]) if score[best] > 0 else low + (k + 0.5) * slot)
    return np.array(chosen), slot


def _worth_showing(found: Histogram, signed: bool) -> tuple[float, float]:
    """Return the range of values with isosurfaces that are large enough to be seen."""
    large = np.flatnonzero(found.area >= min(_SEEN, 0.1 * found.area.max()))
    first, last = int(large[0]), int(large[-1])
    if not signed:
        below = np.cumsum(found.volume)
        first = min(max(first, int(np.searchsorted(below, _LOWEST * below[-1]))), last)
    return float(found.edges[first]), float(found.edges[last + 1])
