"""Where a scheme gets its coefficients from: a table, cells on the ray, or interpolated fields."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ..cache import Cache
from .cells import CellEvaluator
from .channel_layout import choose_layout
from .interpolated import interpolated_fields
from .table import tabulated


def get_source(
    volume: Any,
    medium: Any,
    scheme: Any,
    backend: Any,
    steps: float,
    report: Callable[..., None],
    tolerance: float = 1e-3,
    faintest: bool = False,
    *,
    cache: Cache,
    whole: bool = True,
) -> Any:
    """Return the coefficients for a scheme.

    Parameters
    ----------
    steps : float
        About how many cells the rays will cross in all.
    report : callable
        Called as ``report(done, total)`` while classifying.
    tolerance : float
        What a scheme that controls its error is to keep to.
    faintest : bool
        Leave nothing out, however faint.
    cache : Cache
        What was made of the volume before.
    whole : bool
        No cell is hidden: rays may cross several at once.
    """
    numbers = choose_layout(medium, scheme, backend)
    evaluator = CellEvaluator(volume, medium, numbers, backend, cache.statistics)
    if scheme.coefficients_at == "field":
        return interpolated_fields(evaluator, cache, scheme, tolerance, faintest, whole)
    return tabulated(evaluator, cache, scheme, steps, report, whole)
