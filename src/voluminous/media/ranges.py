"""Ranges of the coefficients of a medium while its fields stay in ranges.

The formulas of a medium, evaluated on intervals in a `RangeContext`, give enclosures.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError
from ..expressions import IntervalOps
from ..expressions.interval import Interval
from ..expressions.interval_ops import interpolate_ranges
from .context import Context, MediumSample

if TYPE_CHECKING:
    from .bound import BoundMedium


@dataclass(frozen=True)
class Bounds:
    """Least and largest emissivities and extinctions; each list has one array per channel.

    Attributes
    ----------
    j_lo, j_hi : list of array
        Emissivity per channel.
    a_lo, a_hi : list of array
        Extinction: one array (grey), or one per channel.
    """

    j_lo: list[np.ndarray]
    j_hi: list[np.ndarray]
    a_lo: list[np.ndarray]
    a_hi: list[np.ndarray]

    @classmethod
    def of(cls, found: MediumSample, fields: Mapping[str, Interval]) -> Bounds:
        """Return the ends of intervals, infinite where a coefficient may be NaN."""
        shape = np.broadcast_shapes(*(field.lo.shape for field in fields.values()))
        columns = []
        for values in (found.emissivity, found.extinction):
            lows = [np.where(v.nan, -np.inf, v.lo) for v in values]
            highs = [np.where(v.nan, np.inf, v.hi) for v in values]
            columns += [[np.broadcast_to(v, shape) for v in ends] for ends in (lows, highs)]
        return cls(*columns)


class RangeContext(Context):
    """Context for evaluating a medium on intervals; see `Context`.

    With `on_rays` coefficients are bounds of those on any ray; else of those at places.
    """

    encloses = True

    def __init__(self, faint: float = 1e-8, *, on_rays: bool = False) -> None:
        super().__init__(Interval.of, Interval.of, faint=faint)
        self.on_rays = on_rays

    @property
    def ops(self) -> IntervalOps:
        return IntervalOps()

    def interpolate(
        self, x: Any, nodes: np.ndarray, columns: Sequence[np.ndarray]
    ) -> list[Interval]:
        return interpolate_ranges(x, nodes, columns)


def intervals(lo: Mapping[str, Any], hi: Mapping[str, Any]) -> dict[str, Interval]:
    """Return the ranges of fields from their smallest and largest values."""
    if not (isinstance(lo, Mapping) and isinstance(hi, Mapping)):
        raise InputError(f"bounds needs two dictionaries of field values, got {lo!r} and {hi!r}")
    one_sided = sorted(lo.keys() ^ hi.keys())
    if one_sided:
        raise InputError(
            f"give both the smallest and the largest value of every field; "
            f"one is missing for {', '.join(one_sided)}"
        )
    return {name: _interval(name, lo[name], hi[name]) for name in lo}


def _interval(name: str, lo: Any, hi: Any) -> Interval:
    low, high = np.asarray(lo, dtype=np.float64), np.asarray(hi, dtype=np.float64)
    try:
        low, high = np.broadcast_arrays(low, high)
    except ValueError:
        raise InputError(
            f"the smallest and largest values of field {name!r} have shapes {low.shape} and "
            f"{high.shape}, expected the same"
        ) from None
    wrong = low > high
    if np.any(wrong):
        raise InputError(
            f"the smallest value of field {name!r} is above the largest one: "
            f"{low[wrong][0]:g} and {high[wrong][0]:g}; give lo first, then hi"
        )
    return Interval(low, high)


def largest(medium: BoundMedium, ranges: dict[str, Interval], faint: float) -> MediumSample:
    """Return upper bounds of |j| and α on a ray while the fields stay in ranges (NumPy)."""
    context = RangeContext(faint, on_rays=True)

    def most(value: Interval) -> np.ndarray:
        return np.where(value.nan, np.inf, value.size)

    return MediumSample.of(most, medium.coefficients(ranges, context))
