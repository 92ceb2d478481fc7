"""A warning if the medium is not visible in a picture, with the ranges of its expressions."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

import numpy as np

from ..media.bound import Binding
from ..media.ranges import RangeContext
from ..units import unit_name
from .job import RenderJob

_kept: ContextVar[list[str] | None] = ContextVar("kept", default=None)
# Coefficients below this fraction of their peak do not count.
_TAIL = 1e-3
_NOT_MET = (
    "no ray crosses an emitting or absorbing region. Increase the resolution if it is small, or "
    "call vm.render(volume) to let voluminous choose medium and camera"
)


def warn_of_nothing(job: RenderJob) -> None:
    """Warn that no pixel shows the medium."""
    volume, medium, statistics = job.volume, job.medium, job.cache.statistics
    context = RangeContext(_TAIL)
    with np.errstate(all="ignore"):
        ranges = {name: statistics.range_of(name) for name in medium.names}
        reason = _NOT_MET if job.clip is None else f"clip={job.clip.region} may leave nothing of it"
        if not np.any(medium.bind(Binding.to(volume)).may_show(ranges, context)):
            values = []
            for expr in dict.fromkeys(medium.scalars()):
                x, unit = context.evaluate(expr, ranges), unit_name(volume.expression_unit(expr))
                ends = f"{float(x.lo):.6g} to {float(x.hi):.6g}{f' {unit}' if unit else ''}"
                values.append(f"{expr.text} is from {ends} in this volume")
            reason = "; ".join(dict.fromkeys(values) or ["it is transparent in this volume"])
            if values:
                reason += ". Choose values in that range; vm.suggest_medium(volume, ...) finds some"
    message = f"the picture shows nothing of the medium: {reason}"
    if (kept := _kept.get()) is None:
        warn_caller(message)
    else:
        kept.append(message)


@contextmanager
def keeping(messages: list[str]) -> Iterator[None]:
    """Keep what is told of a part of the channels: others may show the medium."""
    token = _kept.set(messages)
    try:
        yield
    finally:
        _kept.reset(token)


def warn_caller(message: str) -> None:
    """Warn where this package is called from, however many frames that is away."""
    frame, level = sys._getframe(), 1
    while frame.f_back and frame.f_globals.get("__name__", "").startswith("voluminous"):
        frame, level = frame.f_back, level + 1
    warnings.warn(message, stacklevel=level)
