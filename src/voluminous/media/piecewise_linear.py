"""Piecewise-linear tables inside kernels: values, and exact means between two places.

The mean of a column c between x₀ and x₁ is ∫ c dx / (x₁ - x₀). Integrals between nodes are
differences of a cumulative table. To avoid cancellation its entries are sums of two numbers, the
larger of which are subtracted first; the pieces between an end and the next node are added, never
subtracted from each other.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..backend import Int, dr, from_host
from ..backend.functions import first_true, precision_of
from ..backend.types import Float, Mask
from .panel import Middle, extremes

# Nodes this close to evenly spaced ones, in spacings, are located by arithmetic and one correction.
_EVEN = 0.4
# Rows of tables up to this long are selected from numbers in registers; longer ones are gathered (a
# head CT at 1e-3 with eight entries: 1.24 s instead of 0.98).
_FEW = 16
# In units of the range of the nodes; beyond, x is as good as infinite.
_FAR = {"single": 1e37, "double": 1e300}


@dataclass
class Place:
    """The place of x in a table: its interval (0 below the first node), and the nodes around it.

    With the columns at the node before x, at x, and at the node behind, and their integrals from
    the node before x to x (`left`), and from x to the node behind.
    """

    x: Float
    interval: Float
    low: Float
    high: Float
    narrowness: Float
    before: list[Float]
    value: list[Any]
    after: list[Float]
    left: list[Float]
    right: list[Float]

    def slopes(self) -> list[Float]:
        """Return the slope of each column in its interval."""
        return [(b - a) * self.narrowness for a, b in zip(self.before, self.after, strict=True)]


class PiecewiseLinear:
    """Columns (n, m) linear between increasing nodes, constant beyond; two equal nodes: a jump.

    The entries should be of the order of one.
    """

    def __init__(self, real: Any, nodes: np.ndarray, columns: np.ndarray) -> None:
        self.real, self.UInt = real, dr.uint32_array_t(real)
        precision = precision_of(real)
        dtype = np.float32 if precision == "single" else np.float64
        self.exponent = unit_exponent(nodes)
        self.unit = dr.opaque(real, 2.0**self.exponent)
        nodes = self.scaled(nodes)
        self.far = _FAR[precision]
        self.last = dr.opaque(self.UInt, len(nodes))
        rounded = nodes.astype(dtype)
        self.pieces = Rows(real, _pieces(nodes, rounded))
        # Per interval: the columns' values at both ends.
        self.before = Rows(real, np.concatenate([columns[:1], columns]))
        self.after = Rows(real, np.concatenate([columns, columns[-1:]]))
        areas = np.diff(nodes)[:, None] * 0.5 * (columns[1:] + columns[:-1])
        self.sums = Sums(real, areas)
        self.few = [dr.opaque(real, float(node)) for node in rounded] if len(nodes) <= _FEW else []
        self.walls = from_host(real, np.concatenate([[-np.inf], rounded, [np.inf]]))
        start, spacing, off = _spacing(rounded)
        even = off <= _EVEN
        self.even = (dr.opaque(real, start), dr.opaque(real, 1.0 / spacing)) if even else None
        # Where nodes are off by no more than rounding, nothing need be corrected.
        self.regular = off <= 4.0 * len(nodes) * float(np.finfo(dtype).eps)

    def scaled(self, nodes: np.ndarray) -> np.ndarray:
        """Return values of x in the unit that kernels look them up in."""
        return np.asarray(np.ldexp(nodes, self.exponent))

    def at(self, x: Float) -> Place:
        """Return where x lies, and the columns there; NaN where x is."""
        x = self._near(x)
        k = self._interval(x)
        low, high, narrowness, panel = self.pieces.at(k)
        f = _fraction((x - low) * narrowness)
        before, after = self.before.at(k), self.after.at(k)
        value = [dr.fma(f, b - a, a) for a, b in zip(before, after, strict=True)]
        to_x, from_x = (0.5 * panel * (x - low), 0.5 * panel * (high - x))
        left = [to_x * (a + v) for a, v in zip(before, value, strict=True)]
        right = [from_x * (v + b) for v, b in zip(value, after, strict=True)]
        return Place(x, k, low, high, narrowness, before, value, after, left, right)

    def values(self, x: Float) -> list[Float]:
        """Return the columns at x; NaN where x is."""
        if not self.regular:
            return self.at(x).value
        place = self._position(self._near(x))
        most = self.real(self.last) - 2.0
        k = dr.floor(dr.select(place > 0.0, dr.select(place < most, place, most), 0.0))
        f = _fraction(place - k)
        before, after = (rows.at(self.UInt(k) + 1) for rows in (self.before, self.after))
        return [dr.fma(f, b - a, a) for a, b in zip(before, after, strict=True)]

    def bent_means(
        self, first: Place, last: Place, bow: Float, missed: Float | None
    ) -> list[tuple[Float, Float]]:
        """Return the means of the columns where x is a parabola between two places, and errors.

        `bow` is the factor of s (s - 1) in x, with s from 0 to 1. Where a column is linear in x,
        its mean is exact: a sixth of the bow times its slope is added. At kinks between the places
        the slope of x matters, which changes by the bow.
        """
        rise = last.x - first.x
        gentle = dr.abs(bow) < dr.abs(rise)
        part = bow / dr.select(gentle, rise, 1.0)
        found = []
        slopes = zip(first.slopes(), last.slopes(), strict=True)
        values = zip(first.value, last.value, self.means(first, last), strict=True)
        for (a, b, mean), (one, other) in zip(values, slopes, strict=True):
            change = dr.select(gentle, part * (b - a), 0.5 * bow * (one + other))
            moved = dr.fma(-1 / 6, change, mean)
            kinks = dr.abs(mean - 0.5 * (a + b))
            turned = dr.abs(bow * (one - other))
            error = dr.select(gentle, dr.abs(part) * kinks, turned + kinks)
            if missed is not None:
                error = dr.fma(missed, extremes([dr.abs(one), dr.abs(other)])[1], error)
            found.append((dr.select(moved * mean > 0.0, moved, mean), error))
        return found

    def means(self, first: Place, last: Place) -> list[Float]:
        """Return the means of the columns between two places, in either order."""
        together = first.interval == last.interval
        turned = last.x < first.x
        # By their numbers: what is NaN is in none, and below nothing.
        lower = dr.minimum(first.interval, last.interval)
        upper = dr.maximum(first.interval, last.interval)
        between = self.sums.between(lower, upper, ~together)
        change = dr.abs(last.x - first.x)
        per_change = 1.0 / dr.select(together, 1.0, change)
        found = []
        for c, inner in enumerate(between):
            ends = dr.select(turned, last.right[c] + first.left[c], first.right[c] + last.left[c])
            middle = 0.5 * (first.value[c] + last.value[c])
            found.append(dr.select(together, middle, per_change * (inner + ends)))
        return found

    def _near(self, x: Float) -> Mask:
        x = x * self.unit
        return dr.select(x > self.far, self.far, dr.select(x < -self.far, -self.far, x))

    def _position(self, x: Float) -> Any:
        assert self.even is not None
        start, per_node = self.even
        return (x - start) * per_node

    def below(self, x: Float) -> Float:
        """Return the number of nodes that are not above x; rounded where they are regular."""
        x = self._near(x)
        if not self.regular:
            return self._interval(x)
        place, most = self._position(x) + 1.0, self.real(self.last)
        return self.UInt(dr.select(place > 0.0, dr.select(place < most, place, most), 0.0))

    def _interval(self, x: Float) -> Any:
        if self.few:
            return sum((dr.select(x >= node, self.UInt(1), 0) for node in self.few), self.UInt(0))
        if self.even is None:
            return first_true(
                len(self.walls) - 2,
                self.UInt,
                lambda k: dr.gather(self.real, self.walls, k + 1) > x,
            )
        guess = self._position(x) + 1.0
        most = self.real(self.last)
        guess = dr.select(guess > 0.0, dr.select(guess < most, guess, most), 0.0)
        k = self.UInt(guess)
        below = x < dr.gather(self.real, self.walls, k)
        beyond = x >= dr.gather(self.real, self.walls, k + 1)
        return dr.select(below, k - 1, dr.select(beyond, k + 1, k))


class Rows:
    """Rows of numbers, selected if they are few, or fetched in packets of 4, 2 or 1 numbers."""

    def __init__(self, real: Any, rows: np.ndarray) -> None:
        self.real, self.count = real, rows.shape[1]
        self.few = numbers(real, rows)
        self.parts: list[tuple[Any, Any, int]] = []
        start = 0
        while start < self.count:
            width = next(w for w in (4, 2, 1) if start + w <= self.count)
            data = from_host(real, rows[:, start : start + width].reshape(-1))
            self.parts.append((_packet(real, width), data, width))
            start += width

    def at(self, index: Int) -> list[Float]:
        found: list[Any] = []
        if self.few:
            found = self.few[0]
            for k, row in enumerate(self.few):
                found = [dr.select(index < k, a, b) for a, b in zip(found, row, strict=True)]
            return found
        for kind, data, width in self.parts:
            got = dr.gather(kind, data, index)
            found += [got] if width == 1 else list(got)
        return found


class Sums:
    """Sums of integrals (n - 1, m) between neighbouring nodes, from any node to any later one."""

    def __init__(self, real: Any, steps: np.ndarray) -> None:
        dtype = np.float32 if precision_of(real) == "single" else np.float64
        self.few = numbers(real, steps)
        self.parts = [Rows(real, part) for part in running_sums(steps, dtype)]

    def between(self, lower: Float, upper: Float, apart: Float) -> list[Float]:
        """Return the sums from the end of one interval to the start of a later one."""
        if self.few:
            found: list[Any] = [0.0] * len(self.few[0])
            for k, row in enumerate(self.few, start=1):
                inside = (lower < k) & (upper > k)
                found = [a + dr.select(inside, b, 0.0) for a, b in zip(found, row, strict=True)]
            return found
        (high_0, low_0), (high_1, low_1) = (
            [rows.at(k) for rows in self.parts]
            for k in (dr.select(apart, lower, 0), dr.select(apart, upper - 1, 0))
        )
        return [(b - a) + (d - c) for a, b, c, d in zip(high_0, high_1, low_0, low_1, strict=True)]


def numbers(real: Any, rows: np.ndarray) -> list[list[Float]]:
    """Return rows as kernel constants, if they are few."""
    few = rows.tolist() if len(rows) <= _FEW + 1 else []
    return [[dr.opaque(real, value) for value in row] for row in few]


def _fraction(f: Float) -> Float:
    return dr.select(f < 0.0, 0.0, dr.select(f > 1.0, 1.0, f))


def _packet(real: Any, width: int) -> Any:
    if width == 1:
        return real
    suffix = "f" if precision_of(real) == "single" else "f64"
    return getattr(sys.modules[real.__module__], f"Array{width}{suffix}")


def _pieces(nodes: np.ndarray, rounded: np.ndarray) -> np.ndarray:
    """Return per interval its ends, 1/width, and its true width over that of the rounded ends.

    The last preserves the integral over a spike whose ends are nearly equal after rounding.
    """
    low = np.concatenate([rounded[:1], rounded])
    high = np.concatenate([rounded, rounded[-1:]])
    width = (high - low).astype(np.float64)
    true = np.concatenate([[0.0], np.diff(nodes), [0.0]])
    some = width > 0
    narrowness = np.divide(1.0, width, out=np.zeros(len(width)), where=some)
    ratio = np.divide(true, width, out=np.ones(len(width)), where=some)
    return np.stack([low, high, narrowness, ratio], axis=1)


def unit_exponent(nodes: np.ndarray) -> int:
    """Return the power of two that brings any unit near one, and rounds nothing."""
    extent = float(np.ptp(nodes))
    return int(np.clip(-round(np.log2(extent)), -120, 120)) if extent > 0 else 0


def running_sums(steps: np.ndarray, dtype: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return the sums of all rows before each as sums of a large and a small part.

    What every addition rounds away (Knuth's two-sum) is added up on its own.
    """
    nothing = np.zeros((1, steps.shape[1]))
    total = np.concatenate([nothing, np.cumsum(steps, axis=0)])
    before, after = total[:-1], total[1:]
    taken = after - before
    lost = (before - (after - taken)) + (steps - taken)
    rest = np.concatenate([nothing, np.cumsum(lost, axis=0)])
    large = total.astype(dtype)
    return large, (total - large + rest).astype(dtype)


def _spacing(nodes: np.ndarray) -> tuple[float, float, float]:
    start, count = float(nodes[0]), len(nodes) - 1
    spacing = (float(nodes[-1]) - start) / count
    if spacing <= 0:
        return start, 1.0, np.inf
    off = np.abs(nodes.astype(np.float64) - (start + spacing * np.arange(count + 1)))
    return start, spacing, float(off.max()) / spacing


class TableMiddles:
    """The centre of mass of a weight that is linear between nodes, for any panel.

    The weight is not negative, and the last column of the table in which places are looked up.
    """

    def __init__(self, real: Any, nodes: np.ndarray, weight: np.ndarray) -> None:
        nodes = np.ldexp(nodes, unit_exponent(nodes))
        origin = 0.5 * float(nodes[0] + nodes[-1])
        self.origin = dr.opaque(real, origin)
        step, a, b = np.diff(nodes), weight[:-1], weight[1:]
        area = 0.5 * step * (a + b)
        moment = (nodes[:-1] - origin) * area + step * step * (a + 2 * b) / 6
        square = step * (a * a + a * b + b * b) / 3
        self.sums = Sums(real, np.stack([area, moment, square], axis=1))

    def between(self, first: Place, last: Place) -> Middle:
        """Return the middle of the mass between two places."""
        v, w = first.value[-1], last.value[-1]
        together = first.interval == last.interval
        mass, moment, square = (
            dr.select(together, near, far)
            for near, far in zip(
                (0.5 * (v + w), (v + 2.0 * w) / 6.0, _square(v, w)),
                self._apart(first, last, ~together),
                strict=True,
            )
        )
        some = mass > 0.0
        place = dr.select(some, moment / dr.select(some, mass, 1.0), 0.5)
        place = dr.select(place > 0.0, dr.select(place < 1.0, place, 1.0), 0.0)
        # The mass in a box: as wide as its mean is over the mean of its square.
        extent = dr.select(some, mass * mass / dr.select(some, square, 1.0), 1.0)
        room = place * (1.0 - place)
        spread = extent * extent / (12.0 * dr.select(room > 0.0, room, 1.0))
        return Middle(place, dr.select(spread < 1.0 / 3.0, spread, 1.0 / 3.0))

    def _apart(self, first: Place, last: Place, apart: Float) -> tuple[Any, Any, Any]:
        turned = last.x < first.x
        lower = dr.select(turned, last.interval, first.interval)
        upper = dr.select(turned, first.interval, last.interval)
        area, about_origin, square = self.sums.between(lower, upper, apart)
        start = dr.select(turned, last.x, first.x)
        change = dr.abs(last.x - first.x)
        lows, highs = (
            [dr.select(turned, b, a) for a, b in zip(one, other, strict=True)]
            for one, other in (
                (_to_node(first), _to_node(last)),
                (_from_node(last), _from_node(first)),
            )
        )
        mass = lows[0] + area + highs[0]
        moment = (
            lows[1] + (about_origin - (start - self.origin) * area) + change * highs[0] - highs[1]
        )
        per_change = dr.select(apart, 1.0 / dr.select(apart, change, 1.0), 0.0)
        mass, moment = mass * per_change, moment * per_change * per_change
        return (
            mass,
            dr.select(turned, mass - moment, moment),
            (lows[2] + square + highs[2]) * per_change,
        )


def _to_node(p: Place) -> list[Float]:
    return [p.right[-1], *_moments(p.high - p.x, p.value[-1], p.after[-1])]


def _from_node(p: Place) -> list[Float]:
    return [p.left[-1], *_moments(p.x - p.low, p.value[-1], p.before[-1])]


def _moments(width: Float, near: Float, far: Float) -> tuple[Float, Float]:
    return width * width * (near + 2.0 * far) / 6.0, width * _square(near, far)


def _square(a: Float, b: Float) -> Float:
    return (a * a + a * b + b * b) / 3.0
