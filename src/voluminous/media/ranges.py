"""Between which values the coefficients of a medium stay while its fields stay in ranges.

A medium says what its coefficients are; evaluated on intervals in place of numbers, in a
`RangeContext`, the same formulas say which they can be.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import InputError
from ..expressions import Expression, IntervalOps
from ..expressions.interval import Interval
from ..expressions.interval_ops import interpolate_ranges
from .context import Context
from .contract import Medium


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


class RangeContext(Context):
    """Context for evaluating a medium on intervals.

    Parameters
    ----------
    unit : astropy unit or None
        The volume's length unit.
    unit_of : callable
        Returns the unit of an `Expression`, or None.
    faint : float
        Coefficients below this fraction of their peak may be neglected.
    """

    def __init__(
        self, unit: Any, unit_of: Callable[[Expression], Any], faint: float = 1e-8
    ) -> None:
        super().__init__(Interval.of, Interval.of, unit, unit_of, faint=faint)

    @property
    def ops(self) -> IntervalOps:
        return IntervalOps()

    def interpolate(
        self, x: Any, nodes: np.ndarray, columns: Sequence[np.ndarray]
    ) -> list[Interval]:
        return interpolate_ranges(x, nodes, columns)


def bounds(
    medium: Medium,
    lo: Mapping[str, Any],
    hi: Mapping[str, Any],
    unit: Any,
    unit_of: Callable[[Expression], Any],
) -> Bounds:
    """Return bounds of the coefficients of a medium; see `Medium.bounds`."""
    fields = _intervals(lo, hi)
    with np.errstate(all="ignore"):
        found = medium.ranges(fields, RangeContext(unit, unit_of))
    shape = np.broadcast_shapes(*(field.lo.shape for field in fields.values()))
    j = [_ends(interval, shape) for interval in found.emissivity]
    a = [_ends(interval, shape) for interval in found.extinction]
    return Bounds(
        [ends[0] for ends in j],
        [ends[1] for ends in j],
        [ends[0] for ends in a],
        [ends[1] for ends in a],
    )


def _intervals(lo: Mapping[str, Any], hi: Mapping[str, Any]) -> dict[str, Interval]:
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


def _ends(interval: Interval, shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return both ends as arrays, infinite where a coefficient may be NaN."""
    lo = np.where(interval.nan, -np.inf, interval.lo)
    hi = np.where(interval.nan, np.inf, interval.hi)
    return np.broadcast_to(lo, shape), np.broadcast_to(hi, shape)
