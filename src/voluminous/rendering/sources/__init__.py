"""Sources of coefficients for schemes: a table, cells on the ray, or interpolated fields."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ...backend import Backend
from ...media.contract import Medium
from ...schemes.base import Scheme
from ...volume import Volume
from ..cache import Cache
from .cells import CellEvaluator
from .channel_layout import choose_layout
from .interpolated import interpolated_fields
from .table import tabulated


def get_source(
    volume: Volume,
    medium: Medium,
    scheme: Scheme,
    backend: Backend,
    steps: float,
    report: Callable[..., None],
    tolerance: float = 1e-3,
    faintest: bool = False,
    *,
    cache: Cache,
    whole: bool = True,
) -> Any:
    """Return the coefficients for a scheme."""
    numbers = choose_layout(medium, scheme, backend)
    evaluator = CellEvaluator(volume, medium, numbers, backend, cache.statistics)
    if scheme.coefficients_at == "field":
        return interpolated_fields(evaluator, cache, scheme, tolerance, faintest, whole)
    return tabulated(evaluator, cache, scheme, steps, report, whole)
