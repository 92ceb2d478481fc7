"""Where the mass of a table is in a panel over which its scalar is linear."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..backend import dr
from .modulation import Middle
from .table_means import Place, Sums, unit_exponent


class TableMiddles:
    """The centre of mass of a weight that is linear between nodes, for any panel.

    Parameters
    ----------
    real : type
        Dr.Jit float type.
    nodes, weight : array, shape (n,)
        As in `PiecewiseLinear`; not negative. The weight is the last column of the table in which
        places are looked up.
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

    def _apart(self, first: Place, last: Place, apart: Any) -> tuple[Any, Any, Any]:
        """Return mean, first moment from the first end, and mean square, in units of the way."""
        turned = last.x < first.x
        lower = dr.select(turned, last.interval, first.interval)
        upper = dr.select(turned, first.interval, last.interval)
        area, about_origin, square = self.sums.between(lower, upper, apart)
        start = dr.select(turned, last.x, first.x)
        way = dr.abs(last.x - first.x)
        lows, highs = (
            [dr.select(turned, b, a) for a, b in zip(own, other, strict=True)]
            for own, other in (
                (_to_node(first), _to_node(last)),
                (_from_node(last), _from_node(first)),
            )
        )
        mass = lows[0] + area + highs[0]
        moment = lows[1] + (about_origin - (start - self.origin) * area) + way * highs[0] - highs[1]
        per_way = dr.select(apart, 1.0 / dr.select(apart, way, 1.0), 0.0)
        mass, moment = mass * per_way, moment * per_way * per_way
        return (
            mass,
            dr.select(turned, mass - moment, moment),
            (lows[2] + square + highs[2]) * per_way,
        )


def _to_node(p: Place) -> list[Any]:
    return [p.right[-1], *_moments(p.high - p.x, p.value[-1], p.after[-1])]


def _from_node(p: Place) -> list[Any]:
    return [p.left[-1], *_moments(p.x - p.low, p.value[-1], p.before[-1])]


def _moments(way: Any, near: Any, far: Any) -> tuple[Any, Any]:
    return way * way * (near + 2.0 * far) / 6.0, way * _square(near, far)


def _square(a: Any, b: Any) -> Any:
    return (a * a + a * b + b * b) / 3.0
