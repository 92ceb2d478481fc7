"""How exactly a medium's expressions must be known: are the digits of single precision enough?"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...expressions import Expression, NumpyOps
from ...fields import coordinates
from .classify import Classifier

# Cells looked at.
_SAMPLE = 4096
_RUN = 64
# What may be lost, of the range of an expression's values, and of the width of a shape.
_LOST, _LOST_OF_WIDTH = 1e-5, 0.01
# The contrast of media of which nothing is told.
_UNKNOWN = 10.0


def enough_in_single(classifier: Classifier) -> bool:
    """Return True if all expressions have nearly the same values in single as in double precision.

    Tried on a sample of cells: overflow and underflow (squares of lengths in cm), cancellation, and
    shells narrower than the spacing of single-precision numbers all show there.
    """
    try:
        expressions = classifier.medium.expressions()
    except NotImplementedError:
        return False
    sample = _sample(classifier)
    return all(_same(expr, least, sample) for expr, least in expressions)


def contrast(classifier: Classifier) -> float:
    """Return how many times narrower a medium's structures are than the ranges of what they show.

    So many times what interpolated fields are off by, as a part of their range, a picture may be.
    """
    try:
        expressions = classifier.medium.expressions()
    except NotImplementedError:
        return _UNKNOWN
    sample, most = _sample(classifier), 1.0
    with np.errstate(all="ignore"):
        for expr, width in expressions:
            values = _values(expr, sample, np.float64)
            values = values[np.isfinite(values)]
            if width > 0.0 and values.size:
                most = max(most, float(np.ptp(values)) / width)
    return most


def _sample(classifier: Classifier) -> dict[str, np.ndarray]:
    """Return all fields at cells spread over the volume, in double precision."""
    volume, names = classifier.volume, classifier.medium.names
    size = volume.grid.size
    # Coordinates are computed for runs of cells.
    run = 1 if all(name in volume for name in names) else min(_RUN, size)
    starts = np.linspace(0, size - run, min(_SAMPLE, size) // run).astype(np.int64)
    chosen = (starts[:, None] + np.arange(run)).ravel()
    found = {n: volume.array(n).reshape(-1)[chosen].astype(float) for n in names if n in volume}
    others = [name for name in names if name not in found]
    if others:
        parts = [coordinates(volume.grid, others, first, first + run) for first in starts.tolist()]
        found |= {name: np.concatenate([part[name] for part in parts]) for name in others}
    return found


def _same(expr: Expression, least: float, sample: dict[str, np.ndarray]) -> bool:
    with np.errstate(all="ignore"):
        exact = _values(expr, sample, np.float64)
        rounded = _values(expr, sample, np.float32)
        defined = np.isfinite(exact)
        if not np.array_equal(defined, np.isfinite(rounded)):
            return False
        exact, rounded = exact[defined], rounded[defined]
        lost = float(np.max(np.abs(exact - rounded), initial=0.0))
        size = float(np.max(np.abs(exact), initial=0.0))
        # Rounding of the values themselves, which the sample may show none of.
        lost = max(lost, size * float(np.finfo(np.float32).eps))
    span = float(np.ptp(exact)) if exact.size else 0.0
    tiny = 0.0 < size < 1e-30 or size > 1e30
    return not tiny and (lost <= _LOST * max(span, size)) and not 0 < least * _LOST_OF_WIDTH < lost


def _values(expr: Expression, sample: dict[str, np.ndarray], kind: Any) -> np.ndarray:
    used = {name: sample[name].astype(kind) for name in expr.names}
    found: Any = np.asarray(expr.evaluate(NumpyOps(kind), used), dtype=np.float64)
    return np.atleast_1d(found)
