"""Error bounds of two-sample means of a piecewise-linear table along a ray segment.

The smaller of two bounds is used. For few nodes passed: the change of slope of the table at each
node, treated separately. For many: the distance of the table from a cubic polynomial P over a
window of its intervals. With R the largest distance, the error is at most 2 R plus the error for
P(x(s)): two Gauss-Legendre nodes are exact for cubics, and the fourth derivative follows from those
of P and x (chain rule, Faà di Bruno's formula).

If x is not a cubic, the error of two samples of x itself is added, times the steepest slope.

Bends of colormaps are even: in turbulent fields pictures take 0.45 of the time. Polynomials of
higher degree are nearer, but their derivatives are larger: bounds were, too.
"""

from __future__ import annotations

import numpy as np

from ..backend import dr
from ..backend.types import Float
from .piecewise_linear import PiecewiseLinear, Rows
from .sampled import PAIR

# Error for a change of slope of 1: half the square of the first place (Peano kernel).
BEND = 0.5 * PAIR[0] ** 2
# Error for a fourth derivative of 1.
_FOURTH = 1 / 4320
# Tables of more entries have no polynomials: half a second for as many.
_MOST = 2**16
# Narrow windows are fitted at so many places per interval; wide ones at the nodes.
_PARTS, _NARROW = 4, 16
# Places that differ by less, from -1 to 1 in windows, are the same in all of them.
_EVEN = 1e-6


class TableBends:
    """Bounds of what two samples of a table miss, for windows of its intervals.

    There are windows of 4, 8, 16 … intervals, from each on that is a multiple of a quarter of that.
    No two nodes may be equal.
    """

    def __init__(self, table: PiecewiseLinear, nodes: np.ndarray, columns: np.ndarray) -> None:
        self.table = table
        nodes = table.scaled(nodes)
        # Beyond both ends nothing changes.
        slopes = np.pad(np.diff(columns, axis=0) / np.diff(nodes)[:, None], [(1, 1), (0, 0)])
        changes = np.abs(np.diff(slopes, axis=0)).max(axis=1)
        self.bends = Rows(table.real, np.concatenate([[0.0], np.cumsum(changes)])[:, None])
        steep = np.abs(slopes).max(axis=1)
        rows = [_windows(nodes, columns, steep, width) for width in _widths(len(nodes))]
        starts = np.cumsum([0, *map(len, rows[:-1])])
        self.rows = Rows(table.real, np.concatenate(rows))
        self.starts = Rows(table.UInt, starts[:, None])

    def off(self, low: Float, high: Float, derivatives: list[Float], bow: Float) -> Float:
        """Return how far two samples may be off in any column.

        Parameters
        ----------
        low, high : arrays
            Between which x stays.
        derivatives : three arrays
            Bounds of the first three derivatives of x by the place.
        bow : array or float
            How far two samples are from the mean of x itself; zero for cubics.
        """
        x1, x2, x3 = (d * self.table.unit for d in derivatives)
        first, last = self.table.below(low), self.table.below(high)
        (start,), (end,) = self.bends.at(first), self.bends.at(last)
        rest, steep, second, third = self._window(first, last)
        # A node is passed twice where x turns, which it does no faster than it bends.
        kinks = BEND * (end - start) * (x1 + x2)
        fourth = dr.fma(6.0 * x1 * x1 * x2, third, (3.0 * x2 * x2 + 4.0 * x1 * x3) * second)
        smooth = dr.fma(_FOURTH, fourth, 2.0 * rest)
        off = dr.select(smooth < kinks, smooth, kinks)
        # However steep x is there: beside a vacuum log10 is, below all that shows.
        off = dr.select((first == last) & (low <= high), 0.0, off)
        return off + dr.select(steep > 0.0, steep * (bow * self.table.unit), 0.0)

    def _window(self, first: Float, last: Float) -> list[Float]:
        passed = dr.select(last > first, last - first, 0)
        # Of four and more: the least of which three quarters hold what is passed.
        steps = (passed + 2) // 3
        shift = dr.select(steps > 1, 32 - dr.lzcnt(steps - 1), 0)
        (start,) = self.starts.at(dr.select(passed > 0, shift + 1, 0))
        return self.rows.at(start + (first >> self.table.UInt(shift)))


def _widths(count: int) -> list[int]:
    """Return of how many intervals windows are; the widest hold all of a table's."""
    widths = [1, 4]
    while 3 * widths[-1] < 4 * count:
        widths.append(2 * widths[-1])
    return widths


def _windows(nodes: np.ndarray, columns: np.ndarray, steep: np.ndarray, width: int) -> np.ndarray:
    """Return R, the steepest slope, |P''| and |P'''| for windows of some intervals.

    Interval k ends at node k; the first and the last go on for ever, and have no polynomial.
    """
    count = len(nodes)
    first = np.arange(0, count + 1, max(width // 4, 1))
    rows = np.zeros((len(first), 4))
    own = np.minimum(first[:, None] + np.arange(width), count)
    rows[:, 0], rows[:, 1] = np.inf, steep[own].max(axis=1)
    if width == 1:
        return rows
    inner = np.flatnonzero((first > 0) & (first + width - 1 < count))
    if len(inner) and count <= _MOST:
        entry = first[inner, None] - 1 + np.arange(width + 1)
        parts = _PARTS if width <= _NARROW else 1
        rows[inner[:, None], [0, 2, 3]] = _polynomials(nodes[entry], columns[entry], parts)
    return rows


def _polynomials(nodes: np.ndarray, columns: np.ndarray, parts: int) -> np.ndarray:
    """Return R, |P''| and |P'''| for each window, P by least squares at parts of intervals."""
    places = _between(nodes[..., None], parts)[..., 0]
    half = 0.5 * (nodes[:, -1] - nodes[:, 0])[:, None]
    place = (places - nodes[:, :1]) / half - 1.0  # from -1 to 1
    widest = np.diff(place, axis=1).max(axis=1)[:, None]
    if np.ptp(place, axis=0).max() < _EVEN:  # half the time
        place = place[:1]
    powers = place[..., None] ** np.arange(4)
    turned = np.swapaxes(powers, 1, 2)
    values = _between(columns, parts)
    fit = np.linalg.inv(turned @ powers) @ turned @ values
    second, third = 2.0 * np.abs(fit[:, 2]), 6.0 * np.abs(fit[:, 3])
    # Between two places P is that far from its chord, on one side of it unless it turns.
    sag = np.where(third > second, 1.0, 0.5) * (second + third) * widest**2 / 8.0
    rest = 0.5 * np.ptp(values - powers @ fit, axis=1) + sag
    found = (rest, (second + third) / half**2, third / half**3)
    return np.stack([own.max(axis=1) for own in found], axis=1)


def _between(values: np.ndarray, parts: int) -> np.ndarray:
    """Return what is linear between neighbours at equal parts of all intervals, and the last."""
    start, rise = values[:, :-1, None], np.diff(values, axis=1)[:, :, None]
    part = np.arange(parts)[:, None] / parts
    inner = (start + rise * part).reshape(len(values), -1, values.shape[-1])
    return np.concatenate([inner, values[:, -1:]], axis=1)
