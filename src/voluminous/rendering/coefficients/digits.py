"""How exactly a medium's expressions must be known: are the digits of single precision enough?"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ...errors import UnitsError
from ...expressions import Expression, NumpyOps
from ...expressions.analysis import Margin
from ...expressions.expression import on_one_side
from ...fields import coordinates
from ...media.contract import Feature
from ...units import is_quantity, plain
from .classify import Classifier

# Cells looked at.
_SAMPLE = 4096
_RUN = 64
# What may be lost, of the range of an expression's values, and of the width of a shape.
_LOST, _LOST_OF_WIDTH = 1e-5, 0.01
# The same of the range alone: fields of 500 ± 1 are still drawn in single precision.
_LOST_OF_SPAN = 3e-5
# Sizes that leave room in single precision for products with widths and lengths.
_TINY, _HUGE = 1e-30, 1e30
# Sums below 1e-27 count as zero: so much larger they have errors that do not.
_TINY_SUM = 1e-22
# Of such optical depths the inverse is left room as well, and the square.
_DENSE = 1e12
# The contrast of media of which nothing is told.
_UNKNOWN = 10.0


class Exactness(NamedTuple):
    """How exactly the expressions of a medium are to be known.

    Attributes
    ----------
    single : bool
        In single precision they have nearly the same values as in double precision.
    contrast : float
        How many times narrower the medium's structures are than the ranges of what they show. So
        many times what fields are off by, as a part of their range, a picture may be.
    """

    single: bool
    contrast: float


def exactness(classifier: Classifier) -> Exactness:
    """Return how exactly a medium's expressions are to be known.

    Tried on a sample of cells: overflow and underflow (squares of lengths in cm), cancellation, and
    shells narrower than the spacing of single-precision numbers all show there.
    """
    expressions = plain_widths(classifier.volume, classifier.medium.features())
    if not expressions:
        return Exactness(False, _UNKNOWN)
    sample = _sample(classifier.volume, classifier.medium.names)
    # Coefficients are multiplied by the scale.
    single, contrast = not _tiny_or_huge(np.array(classifier.grid.scale)), 1.0
    with np.errstate(all="ignore"):
        for expr, least in expressions:
            exact, rounded = (_values(expr, sample, kind) for kind in (np.float64, np.float32))
            defined = np.isfinite(exact)
            single = single and np.array_equal(defined, np.isfinite(rounded))
            single = single and _same(exact[defined], rounded[defined], least)
            if least > 0.0:
                contrast = max(contrast, _span(exact[defined]) / least)
    return Exactness(single, contrast * classifier.medium.sensitivity)


def plain_widths(
    volume: Any, features: tuple[Feature, ...]
) -> tuple[tuple[Expression, float], ...]:
    """Return expressions and the widths that matter, as numbers in the volume's units."""
    return tuple((f.expr, _plain_width(volume, f.expr, f.width)) for f in features)


def _plain_width(volume: Any, expr: Expression, width: Any) -> float:
    if not is_quantity(width):
        return float(width)
    try:
        return float(plain(width, volume.expression_unit(expr), "width"))
    except UnitsError:
        return 0.0  # refused, by its own name, where the medium is evaluated


def beyond_single(volume: Any, medium: Any) -> bool:
    """Return True if what a medium is a function of is out of reach for single precision.

    Too small or too large, or small differences of large numbers: fields are rounded before they
    are interpolated, and no care taken afterwards brings digits back. The sizes of coefficients,
    gates and colours do not matter here: they are numbers of their own.
    """
    sample = _sample(volume, medium.names)
    rounded = {n: _disturbed(v) if n in volume else v for n, v in sample.items()}
    looked_at = {expr.text for expr in medium.scalars()}
    with np.errstate(all="ignore"):
        for expr, least in plain_widths(volume, medium.known_features()):
            if expr.text not in looked_at:
                beyond = _strays(expr, sample, rounded)
            else:
                exact, off = (_values(expr, fields, np.float64) for fields in (sample, rounded))
                beyond = _tiny_or_huge(exact) or _differs(exact, off, least)
            if beyond:
                return True
    return False


def _strays(
    expr: Expression, sample: dict[str, np.ndarray], rounded: dict[str, np.ndarray]
) -> bool:
    """Return True if an expression, or what is compared in it, is off by too much of its range.

    Comparisons hold where they do, since labels may be equal to what they are compared with. Where
    in space they change is to be known better than the rest, as something jumps there.
    """
    (piece,), sides = on_one_side((expr,))
    held = {side.name: _values(side.condition, sample, np.float64) for side in sides}
    sample, rounded = sample | held, rounded | held
    margins = (margin for side in sides for margin in side.condition.margins())
    return _lost_of_span(piece, sample, rounded) > _LOST_OF_SPAN or any(
        _lost_of_span(margin, sample, rounded) > _LOST for margin in margins
    )


def _lost_of_span(
    expr: Expression | Margin, sample: dict[str, np.ndarray], rounded: dict[str, np.ndarray]
) -> float:
    """Return what values are off by in the mean, as a part of their range.

    In the mean, since beside a pole there are always some that are off by much.
    """
    exact, off = (_values(expr, fields, np.float64) for fields in (sample, rounded))
    defined = np.isfinite(exact) & np.isfinite(off)
    span = _span(exact[defined])
    return float(np.mean(np.abs(exact - off)[defined])) / span if span > 0.0 else 0.0


def beyond_single_sums(numbers: Any, bounds: list[float]) -> bool:
    """Return True if what rays gather in a cell is out of reach for single precision.

    Optical depths, and emission compared with the colours: where colours are of a path length that
    is very short or very long, or only the tails of shells are there.

    Parameters
    ----------
    numbers : Direct or Shapes
        What is gathered.
    bounds : list of float
        Bounds of the numbers, as they are in kernels.
    """
    emission = np.array(bounds[: numbers.emissions])
    return _tiny_or_huge(emission, _TINY_SUM) or bool(numbers.densest(bounds) > _DENSE)


def _disturbed(values: np.ndarray) -> np.ndarray:
    """Return values up or down by what rounding to single precision may do to them."""
    signs = np.random.default_rng(0).choice((-1.0, 1.0), size=values.shape)
    return values * (1.0 + 0.5 * float(np.finfo(np.float32).eps) * signs)


def _differs(exact: np.ndarray, off: np.ndarray, least: float) -> bool:
    """Return True if values are off by too much of their range, or of a structure's width."""
    defined = np.isfinite(exact) & np.isfinite(off)
    lost = float(np.max(np.abs(exact - off)[defined], initial=0.0))
    span = _span(exact[defined])
    return lost > _LOST_OF_SPAN * span > 0.0 or lost > _LOST_OF_WIDTH * least > 0.0


def _tiny_or_huge(values: np.ndarray, tiny: float = _TINY) -> bool:
    size = float(np.max(np.abs(values[np.isfinite(values)]), initial=0.0))
    return 0.0 < size < tiny or size > _HUGE


def _sample(volume: Any, names: Any) -> dict[str, np.ndarray]:
    """Return all fields at cells spread over the volume, in double precision."""
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


def _same(exact: np.ndarray, rounded: np.ndarray, least: float) -> bool:
    lost = float(np.max(np.abs(exact - rounded), initial=0.0))
    size = float(np.max(np.abs(exact), initial=0.0))
    # Rounding of the values themselves, which the sample may show none of.
    lost = max(lost, size * float(np.finfo(np.float32).eps))
    few = lost <= _LOST * max(_span(exact), size)
    return not _tiny_or_huge(exact) and few and not 0 < least * _LOST_OF_WIDTH < lost


def _span(values: np.ndarray) -> float:
    return float(np.ptp(values)) if values.size else 0.0


def _values(expr: Expression | Margin, sample: dict[str, np.ndarray], kind: Any) -> np.ndarray:
    used = {name: sample[name].astype(kind) for name in expr.names}
    found: Any = np.asarray(expr.evaluate(NumpyOps(kind), used), dtype=np.float64)
    return np.atleast_1d(found)
