"""How media are evaluated on intervals inside kernels, as `bounds` does on the host."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..expressions import Expression
from ..expressions.traced_interpolation import interpolate_traced_ranges
from ..expressions.traced_interval import TracedInterval, traced
from ..expressions.traced_interval_ops import TracedIntervalOps
from .context import Context


class TracedRangeContext(Context):
    """How a medium is evaluated on intervals inside a kernel.

    Parameters
    ----------
    float_type : type
        Dr.Jit float type of the ends.
    number : callable
        Turns a finite Python float into run-time data of that type.
    unit : astropy unit or None
        The volume's length unit.
    unit_of : callable
        Returns the unit of an `Expression`, or None.
    faint : float
        Coefficients below this fraction of their peak may be neglected.
    """

    def __init__(
        self,
        float_type: Any,
        number: Callable[[float], Any],
        unit: Any,
        unit_of: Callable[[Expression], Any],
        faint: float = 1e-8,
    ) -> None:
        self._float, self._constant = float_type, number

        def constant(value: float) -> TracedInterval:
            return TracedInterval.constant(number(value))

        real = functools.partial(traced, float_type)
        super().__init__(real, constant, unit, unit_of, faint=faint)

    @property
    def ops(self) -> TracedIntervalOps:
        return TracedIntervalOps(self._float, self._constant)

    def interpolate(
        self, x: Any, nodes: np.ndarray, columns: Sequence[np.ndarray]
    ) -> list[TracedInterval]:
        return interpolate_traced_ranges(x, nodes, columns)
