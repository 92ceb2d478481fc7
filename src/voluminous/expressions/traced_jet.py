"""Intervals with derivatives along a line: how much a value bends, and so how straight it is.

A jet holds, for all places u from 0 to 1 of a stretch, an interval of the value, of its first and
of its second derivative by u (Moore, Kearfott & Cloud 2009, *Introduction to Interval Analysis*,
chapter 9).
"""

from __future__ import annotations

from dataclasses import dataclass

from .traced_interval import TracedInterval

# A derivative that is zero everywhere is None: constants cost nothing.
Derivative = TracedInterval | None


@dataclass
class TracedJet:
    """Intervals of a value and of its derivatives.

    Attributes
    ----------
    value : TracedInterval
        All values.
    first, second : TracedInterval or None
        All values of the derivatives; (-∞, ∞) where nothing is known of them.
    """

    value: TracedInterval
    first: Derivative = None
    second: Derivative = None

    @property
    def fixed(self) -> bool:
        """Whether this is known to be one number."""
        return self.first is None and self.second is None


def plus(a: Derivative, b: Derivative) -> Derivative:
    """Return the sum of two derivatives."""
    if a is None or b is None:
        return b if a is None else a
    return a + b


def times(a: Derivative, b: Derivative) -> Derivative:
    """Return the product of two derivatives, or of one and a value."""
    return None if a is None or b is None else a * b


def negative(a: Derivative) -> Derivative:
    """Return minus a derivative."""
    return None if a is None else -a


def chain(
    x: TracedJet, value: TracedInterval, slope: TracedInterval, bend: TracedInterval
) -> TracedJet:
    """Return f(x) from f, f' and f'' over the range of x: (f' x')' = f'' x'² + f' x''."""
    second = times(slope, x.second)
    if x.first is not None:
        second = plus(times(bend, x.first * x.first), second)
    return TracedJet(value, times(slope, x.first), second)
