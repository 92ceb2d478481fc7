"""Data that is noise around zero, but for what rises above it."""

from __future__ import annotations

import numpy as np

# Fewer negative values say nothing.
_ENOUGH = 100
# Median over root mean square of the negative values: 0.67 for Gaussian noise, less where the noise
# is not the same everywhere; 0.87 if all values are alike often, 1 for a second material.
_MEDIAN = (0.45, 0.75)
# Noise has no values so far out (in its σ); data rises above it so many times.
_FARTHEST, _ABOVE = 10.0, 2.0
# Noise is symmetric: near zero there are no fewer positive values than negative ones (but for
# chance, where all is noise).
_SYMMETRIC = 0.9


def noise_of(values: np.ndarray) -> float:
    """Return the σ of the noise around zero in sorted values; zero if negative values mean more.

    The negative values are taken for half of the noise, of which the other half is among the
    positive ones: σ² is their mean square.
    """
    zero = int(np.searchsorted(values, 0.0, "left"))
    if zero < _ENOUGH:
        return 0.0
    below = -values[:zero].astype(np.float64)
    farthest, median = float(below[0]), float(np.median(below))
    # Squares of parts of the farthest are numbers, whatever the unit.
    sigma = farthest * float(np.sqrt(np.mean((below / farthest) ** 2)))
    beside = np.searchsorted(values, [-sigma, sigma])
    looks_like_noise = (
        _MEDIAN[0] * sigma < median < _MEDIAN[1] * sigma
        and farthest < _FARTHEST * sigma
        and float(values[-1]) > _ABOVE * farthest
        and beside[1] - zero > _SYMMETRIC * (zero - beside[0])
    )
    return sigma if looks_like_noise else 0.0
