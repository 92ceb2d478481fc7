"""The precision a medium needs: single, or double where single loses too many digits."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

from ..errors import UnitsError
from ..expressions import Expression, NumpyOps
from ..expressions.expression import on_one_side
from ..fields import coordinates
from ..media.context import Feature
from ..media.contract import Medium
from ..units import is_quantity, plain
from ..volume import Volume

Sample = dict[str, np.ndarray]

# Number of sampled cells, and length of the runs of consecutive ones if coordinates are computed.
_SAMPLE, _RUN = 4096, 64
# Relative error allowed: of the range of values, of the width of a structure, and of the range
# alone (fields of 500 ± 1 are still drawn in single precision).
_LOST, _LOST_OF_WIDTH, _LOST_OF_SPAN = 1e-5, 0.01, 3e-5
# Sizes that leave room in single precision for products with widths and lengths.
_TINY, _HUGE = 1e-30, 1e30
# Sums below 1e-27 count as zero: the relative error of sums this large is small.
_TINY_SUM = 1e-22
# For optical depths up to this, the inverse and the square are in range as well.
_DENSE = 1e12
# Contrast of media without expressions.
_UNKNOWN = 10.0
_EPS = float(np.finfo(np.float32).eps)


class Exactness(NamedTuple):
    """Precision needed by the expressions of a medium.

    Attributes
    ----------
    single : bool
        Single precision gives nearly the same values as double.
    contrast : float
        Range of an expression over the width of the medium's structures: the factor by which it
        amplifies errors of fields, relative to their range.
    """

    single: bool
    contrast: float


def exactness(volume: Volume, medium: Medium) -> Exactness:
    """Return the precision needed by a medium's expressions, from a sample of cells.

    The sample reveals overflow, underflow (squares of lengths in cm), cancellation, and shells
    narrower than the spacing of single-precision numbers.
    """
    expressions = plain_widths(volume, medium.features())
    if not expressions:
        return Exactness(False, _UNKNOWN)
    sample = _sample(volume, medium.names)
    # Coefficients are multiplied by the scale.
    single, contrast = not _tiny_or_huge(np.array(volume.grid.scale)), 1.0
    with np.errstate(all="ignore"):
        for expr, width in expressions:
            exact, rounded = (_values(expr, sample, kind) for kind in (np.float64, np.float32))
            defined = np.isfinite(exact)
            single = single and np.array_equal(defined, np.isfinite(rounded))
            single = single and _same(exact[defined], rounded[defined], width)
            if width > 0.0:
                contrast = max(contrast, _span(exact[defined]) / width)
    return Exactness(single, contrast * medium.sensitivity)


def needs_double(volume: Volume, medium: Medium) -> bool:
    """Return whether single precision has too few digits for the fields of a medium.

    This is so for very small or large values, and small differences of large numbers. Fields are
    rounded before they are interpolated, and the lost digits cannot be recovered afterwards.
    """
    sample = _sample(volume, medium.names)
    signs = np.random.default_rng(0).choice((-1.0, 1.0), size=len(next(iter(sample.values()), [])))
    off = {n: v * (1.0 + 0.5 * _EPS * signs) if n in volume else v for n, v in sample.items()}
    scalars = {expr.text for expr in medium.scalars()}
    with np.errstate(all="ignore"):
        for expr, width in plain_widths(volume, medium.known_features()):
            if expr.text in scalars:
                few = _loses_digits(expr, sample, off, width)
            else:
                few = _loses_range(expr, sample, off)
            if few:
                return True
    return False


def _loses_digits(expr: Expression, sample: Sample, off: Sample, width: float) -> bool:
    exact, lost = _lost(expr, sample, off)
    most, span = float(np.max(lost, initial=0.0)), _span(exact)
    few = most > _LOST_OF_SPAN * span > 0.0 or most > _LOST_OF_WIDTH * width > 0.0
    return few or _tiny_or_huge(_values(expr, sample, np.float64))


def _loses_range(expr: Expression, sample: Sample, off: Sample) -> bool:
    """Return whether an expression, or a compared quantity in it, loses too much of its range.

    The error is averaged, because beside a pole some values always have a large one. Comparisons
    keep their exact outcome, since labels may equal the value they are compared with; the
    quantities compared must be more accurate where the outcome changes.
    """
    (piece,), sides = on_one_side((expr,))
    held = {side.name: _values(side.condition, sample, np.float64) for side in sides}
    margins = [margin for side in sides for margin in side.condition.margins()]
    for part, most in ((piece, _LOST_OF_SPAN), *((margin, _LOST) for margin in margins)):
        exact, lost = _lost(part, sample | held, off | held)
        span = _span(exact)
        if span > 0.0 and float(np.mean(lost)) > most * span:
            return True
    return False


def _lost(expr: Any, sample: Sample, off: Sample) -> tuple[np.ndarray, np.ndarray]:
    """Return the finite values of an expression, and their change when fields are disturbed."""
    exact, disturbed = (_values(expr, fields, np.float64) for fields in (sample, off))
    defined = np.isfinite(exact) & np.isfinite(disturbed)
    return exact[defined], np.abs(exact - disturbed)[defined]


def sums_need_double(numbers: Any, bounds: list[float]) -> bool:
    """Return whether sums along rays exceed the range of single precision.

    These are optical depths, and emission relative to the colours; they are extreme where path
    lengths are very short or very long, or where only the tails of shells are present.
    """
    emission = np.array(bounds[: numbers.emissions])
    return _tiny_or_huge(emission, _TINY_SUM) or bool(numbers.densest(bounds) > _DENSE)


def plain_widths(
    volume: Volume, features: Iterable[Feature]
) -> tuple[tuple[Expression, float], ...]:
    """Return expressions with the widths of their structures, in the volume's units."""
    return tuple((f.expr, _plain_width(volume, f.expr, f.width)) for f in features)


def _plain_width(volume: Volume, expr: Expression, width: Any) -> float:
    if not is_quantity(width):
        return float(width)
    try:
        return float(plain(width, volume.expression_unit(expr), "width"))
    except UnitsError:
        return 0.0  # refused, by its own name, where the medium is evaluated


def _tiny_or_huge(values: np.ndarray, tiny: float = _TINY) -> bool:
    size = float(np.max(np.abs(values[np.isfinite(values)]), initial=0.0))
    return 0.0 < size < tiny or size > _HUGE


def _sample(volume: Volume, names: Iterable[str]) -> Sample:
    """Return all fields at cells spread over the volume, in double precision."""
    names, size = list(names), volume.grid.size
    run = 1 if all(name in volume for name in names) else min(_RUN, size)
    starts = np.linspace(0, size - run, min(_SAMPLE, size) // run).astype(np.int64)
    chosen = (starts[:, None] + np.arange(run)).ravel()
    sample = {n: volume.array(n).reshape(-1)[chosen].astype(float) for n in names if n in volume}
    others = [name for name in names if name not in sample]
    if others:
        parts = [coordinates(volume.grid, others, first, first + run) for first in starts.tolist()]
        sample |= {name: np.concatenate([part[name] for part in parts]) for name in others}
    return sample


def _same(exact: np.ndarray, rounded: np.ndarray, width: float) -> bool:
    lost = float(np.max(np.abs(exact - rounded), initial=0.0))
    size = float(np.max(np.abs(exact), initial=0.0))
    # Include rounding of the values themselves, which the sample may not show.
    lost = max(lost, size * _EPS)
    few = lost <= _LOST * max(_span(exact), size)
    return not _tiny_or_huge(exact) and few and not 0 < width * _LOST_OF_WIDTH < lost


def _span(values: np.ndarray) -> float:
    return float(np.ptp(values)) if values.size else 0.0


def _values(expr: Any, sample: Sample, kind: type) -> np.ndarray:
    used: Any = {name: sample[name].astype(kind) for name in expr.names}
    return np.atleast_1d(np.asarray(expr.evaluate(NumpyOps(kind), used), dtype=np.float64))
