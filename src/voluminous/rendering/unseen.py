"""A picture that shows nothing says why."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

from ..expressions.interval import Interval
from ..media.bounds import RangeContext
from ..units import unit_name
from .coefficients.classify import range_of
from .job import Job, Planes


def warn_if_nothing_shows(job: Job, planes: Planes) -> None:
    """Warn where no pixel shows anything of the medium, with the ranges of what it looks at."""
    if planes.emission.any() or np.any(planes.transparency != 1.0):
        return
    warnings.warn(f"the picture shows nothing of the medium: {_reason(job)}", stacklevel=3)


def _reason(job: Job) -> str:
    extremes = job.store.extremes
    ranges = {name: range_of(job.volume, name, extremes) for name in job.medium.names}
    context = RangeContext(job.volume.unit, job.volume.expression_unit)
    with np.errstate(all="ignore"):
        missed = [
            part
            for part in job.medium.components()
            if part.scalars() and not np.any(part.visible_in(ranges, context))
        ]
        told = [_told(part, ranges, context) for part in missed]
    if not told or len(told) < len(job.medium.components()):
        return (
            "no ray of this camera meets it where it emits or absorbs; look at what there is with "
            "vm.render(volume), which finds a medium and a camera"
        )
    several = "; ".join(dict.fromkeys(told))
    return f"{several}. Choose values in that range; vm.auto(volume, ...) finds some"


def _told(part: Any, ranges: dict[str, Interval], context: RangeContext) -> str:
    """Return what a part of the medium looks for, and what there is."""
    known = part.describe()
    wanted = next((known[key] for key in ("level", "center", "vmin") if key in known), None)
    listed = wanted if isinstance(wanted, (list, tuple)) else [wanted]
    at = "" if wanted is None else f" at {', '.join(_short(value) for value in listed)}"
    found = []
    for expr in part.scalars():
        x = context.evaluate(expr, ranges)
        unit = unit_name(context.unit_of(expr))
        ends = f"from {float(x.lo):.6g} to {float(x.hi):.6g}{f' {unit}' if unit else ''}"
        found.append(f"{expr.text} is {ends} in this volume")
    gate = f" where {known['where']}" if known.get("where") else ""
    return f"its {known['type']}{at}{gate} lies outside of all there is: {', '.join(found)}"


def _short(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
