"""Two histograms of a scalar in a volume: the volume at each value, and the steepness there."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..expressions import Expression
from ..grids.cartesian.grid import CartesianGrid
from ..volume import Volume
from .samples import BUDGET, Run, cell_runs, of_runs

_BINS = 1024
# Quantiles of the values between which the histogram extends, so that outliers do not coarsen it.
_LEAST, _GREATEST = 1e-4, 1 - 1e-5
# Bins are distinct in double precision if they are this much of the values, or wider.
_DIGITS = 2.0**-50
# Enough values for such quantiles.
_VALUES = 1 << 20


@dataclass
class Histogram:
    """Volumes of cells, as fractions of the domain, and areas in bins of equal width.

    The mean area of the isosurfaces in a bin, in squares of the domain's diagonal, is the sum of
    |∇x| dV over the width of the bin (the coarea formula).
    """

    edges: np.ndarray
    volume: np.ndarray
    area: np.ndarray

    @property
    def centers(self) -> np.ndarray:
        """The middles of the bins."""
        return np.asarray(0.5 * (self.edges[1:] + self.edges[:-1]))

    def steepness(self, smoothing: float) -> np.ndarray:
        """Return the mean |∇x| as a function of x, smoothed over a length in x; zero without data.

        Its peaks are the boundaries of materials: Kindlmann & Durkin (1998), "Semi-automatic
        generation of transfer functions for direct volume rendering", section 4.
        """
        step = self.edges[1] - self.edges[0]
        reach = int(np.ceil(3 * smoothing / step))
        offsets = np.arange(-reach, reach + 1) * step / smoothing
        kernel = np.exp(-0.5 * offsets**2)
        amount, steep = (
            np.convolve(v, kernel)[reach : reach + len(v)] for v in (self.volume, self.area)
        )
        enough = amount > 1e-12 * amount.max()
        return np.asarray(np.divide(steep, amount, out=np.zeros(len(steep)), where=enough))


def sampled_values(volume: Volume, expr: Expression) -> np.ndarray:
    """Return finite values of an expression, about a million of them, evenly spread and sorted."""
    step = max(1, min(volume.grid.size, BUDGET) // _VALUES)
    # An odd number that divides no usual side: a step along all three axes, not along one.
    step += step > 1 and step % 2 == 0
    values = np.concatenate([run.x.ravel()[::step] for run in cell_runs(volume, expr)])
    return np.sort(values[~np.isnan(values)])


def is_constant(low: float, high: float) -> bool:
    """Return whether two values differ by so little that bins between them are not distinct."""
    return not high - low > _BINS * _DIGITS * max(abs(low), abs(high))


def histogram(volume: Volume, expr: Expression, values: np.ndarray) -> Histogram:
    """Return the histogram of an expression over the range of `values` (sorted, not constant)."""
    last = len(values) - 1
    low, high = (float(values[k]) for k in (math.ceil(_LEAST * last), int(_GREATEST * last)))
    if is_constant(low, high):  # all but a few are equal
        low, high = float(values[0]), float(values[-1])

    def counted(run: Run) -> tuple[np.ndarray, np.ndarray, float]:
        inside = (run.x >= low) & (run.x <= high)
        size = np.broadcast_to(run.volume, inside.shape)
        x, weights = run.x[inside], size[inside]
        both = weights, run.slope[inside] * weights
        cells, steep = (np.histogram(x, _BINS, (low, high), weights=w)[0] for w in both)
        return cells, steep, float(size.sum())

    cells, steep, total = np.zeros(_BINS), np.zeros(_BINS), 0.0
    for some, some_steep, size in of_runs(counted, volume, expr):
        cells, steep, total = cells + some, steep + some_steep, total + size
    grid = volume.grid
    sides = np.ptp(grid.bounds, axis=1) / grid.scale
    domain = (
        np.prod(sides)
        if isinstance(grid, CartesianGrid)
        else np.sum(grid.cell_volumes) / grid.scale**3
    )
    # The rest of the volume is taken to be like the sampled part.
    per_area = float(domain) / total / float(np.sum(sides**2))
    edges = np.linspace(low, high, _BINS + 1)
    return Histogram(edges, cells / total, steep / (high - low) * (per_area * _BINS))
