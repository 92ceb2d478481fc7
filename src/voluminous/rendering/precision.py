"""The precision a medium needs: single, or double where single loses too many digits."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import UnitsError
from ..expressions import Expression, NumpyOps
from ..expressions.expression import on_one_side
from ..expressions.interval import Interval
from ..fields import coordinates
from ..media.bound import Binding, BoundMedium
from ..media.context import Feature
from ..media.contract import Medium
from ..media.ranges import RangeContext
from ..schemes.base import VertexScheme, innermost, is_controlled
from ..schemes.channels import Channels
from ..units import is_quantity, plain
from ..volume import Volume
from .options import FINEST_SINGLE

if TYPE_CHECKING:
    from ..schemes.base import Scheme
    from .cache import Cache, VolumeStatistics

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
# Fields of which all combinations of ends are looked at.
_MOST_FIELDS = 8
# Contrast of media without expressions.
_UNKNOWN = 10.0
_EPS = float(np.finfo(np.float32).eps)


def decide(
    precision: str, device: str, cache: Cache, medium: Medium, scheme: Scheme, tolerance: float
) -> str:
    """Return the precision of a picture: as asked for, or double where single has too few digits.

    The volume is the cache's. The only other decisions: `exactness_of` expressions along rays, and
    `run`, which draws a picture again whose numbers are not finite.
    """
    volume, solver = cache.volume, innermost(scheme)
    if precision != "single" or volume.grid.needs_double():
        return "double"
    if is_controlled(scheme) and tolerance < FINEST_SINGLE and device != "metal":
        return "double"
    if isinstance(solver, VertexScheme) and solver.needs_double(medium):
        return "double"
    if scheme.coefficients_at == "field":
        widths = plain_widths(volume, medium.known_features())
        texts = tuple((expr.text, width) for expr, width in widths)
        key = ("needs double", texts, cache.statistics.digests(medium.names))
        if cache.get_or_make(key, lambda: loses_digits(volume, medium)):
            return "double"
    # Sums along rays are extreme where path lengths are very short or very long, and where nothing
    # but the tails of shells is present.
    channels = Channels(medium, Binding.to(volume, volume.grid.scale))
    largest = largest_coefficients(cache.statistics, channels)
    paths, dense = channels.paths(largest), channels.densest(largest) > _DENSE
    return "double" if 0.0 < paths < _TINY_SUM or paths > _HUGE or dense else "single"


def largest_coefficients(statistics: VolumeStatistics, channels: Channels) -> list[float]:
    """Return bounds of |j| and α from the ranges of the fields, in the units of channels."""
    medium, names = channels.medium, channels.medium.names

    def compute() -> tuple[float, ...]:
        fields = {name: statistics.range_of(name) for name in names}
        return tuple(float(v.max()) for v in sizes_of_coefficients(channels.bound, fields))

    if statistics.cache is None or not statistics.is_hashed(names):
        return list(compute())
    own = medium.key()
    key = None if own is None else ("largest", own, statistics.digests(names))
    return list(statistics.cache.get_or_make(key, compute))


def sizes_of_coefficients(medium: BoundMedium, fields: dict[str, Interval]) -> list[np.ndarray]:
    """Return bounds of |j| and α while the fields stay in ranges."""
    with np.errstate(all="ignore"):
        ranges = medium.coefficients(fields, RangeContext()).listed()
    return [np.maximum(np.abs(v.lo), np.abs(v.hi)) for v in ranges]


def exactness_of(cache: Cache, medium: Medium) -> tuple[bool, float]:
    """Return `exactness` of a medium in the cache's volume."""
    own = medium.key()
    key = None if own is None else ("exactness", own, cache.statistics.digests(medium.names))
    return cache.get_or_make(key, lambda: exactness(cache.volume, medium))


@np.errstate(all="ignore")
def exactness(volume: Volume, medium: Medium) -> tuple[bool, float]:
    """Return whether expressions can be evaluated in single precision, and their contrast.

    This is the range of an expression over the width of the medium's structures: the factor by
    which it amplifies errors of fields, relative to their range. The sample of cells reveals
    overflow, underflow (squares of lengths in cm), cancellation, and shells narrower than the
    spacing of single-precision numbers.
    """
    expressions = plain_widths(volume, medium.features())
    if not expressions:
        return False, _UNKNOWN
    sample = _sample(volume, medium.names)
    # Coefficients are multiplied by the scale.
    single, contrast = not _tiny_or_huge(np.array(volume.grid.scale)), 1.0
    for expr, width in expressions:
        exact, rounded = (_values(expr, sample, kind) for kind in (np.float64, np.float32))
        defined = np.isfinite(exact)
        single = single and np.array_equal(defined, np.isfinite(rounded))
        exact, rounded = exact[defined], rounded[defined]
        span, size = _span(exact), _largest(exact)
        if width > 0.0:
            contrast = max(contrast, span / width)
        if single:
            # Include rounding of the values themselves, which the sample may not show.
            lost = max(_largest(exact - rounded), size * _EPS)
            single = not _tiny_or_huge(exact) and lost <= _LOST * max(span, size)
            single = single and not 0 < width * _LOST_OF_WIDTH < lost
    return single, contrast * medium.sensitivity


@np.errstate(all="ignore")
def in_single_range(medium: Medium, ranges: dict[str, Interval]) -> bool:
    """Return whether single precision evaluates expressions at all ends of ranges of the fields.

    In few cells, which a sample misses, parts of an expression may be too large or too small for
    it, although the whole is not.
    """
    if len(ranges) > _MOST_FIELDS:
        return False
    ends = itertools.product(*((float(r.lo), float(r.hi)) for r in ranges.values()))
    corners = dict(zip(ranges, np.array(list(ends)).T, strict=True))
    for feature in medium.known_features():
        exact, rounded = (_values(feature.expr, corners, kind) for kind in (np.float64, np.float32))
        defined = np.isfinite(exact)
        lost = _largest((exact - rounded)[defined])
        if not np.array_equal(defined, np.isfinite(rounded)) or lost > _LOST * _largest(
            exact[defined]
        ):
            return False
    return True


@np.errstate(all="ignore")
def loses_digits(volume: Volume, medium: Medium) -> bool:
    """Return whether single precision has too few digits for the fields of a medium.

    This is so for very small or large values, and small differences of large numbers. Fields are
    rounded before they are interpolated, and the lost digits cannot be recovered afterwards.

    Of expressions that are not scalars the error is averaged, because beside a pole some values
    always have a large one. Comparisons keep their exact outcome, since labels may equal the value
    they are compared with; the quantities compared must be more accurate where the outcome changes.
    """
    sample = _sample(volume, medium.names)
    signs = np.random.default_rng(0).choice((-1.0, 1.0), size=len(next(iter(sample.values()), [])))
    off = {n: v * (1.0 + 0.5 * _EPS * signs) if n in volume else v for n, v in sample.items()}
    scalars = {expr.text for expr in medium.scalars()}
    for expr, width in plain_widths(volume, medium.known_features()):
        parts: list[tuple[Any, float]] = [(expr, _LOST_OF_SPAN)]
        held: Sample = {}
        if not (scalar := expr.text in scalars):
            (piece,), sides = on_one_side((expr,))
            margins = [margin for side in sides for margin in side.condition.margins()]
            parts = [(piece, _LOST_OF_SPAN), *((margin, _LOST) for margin in margins)]
            held = {side.name: _values(side.condition, sample, np.float64) for side in sides}
        for part, most in parts:
            exact, disturbed = (_values(part, f | held, np.float64) for f in (sample, off))
            defined = np.isfinite(exact) & np.isfinite(disturbed)
            lost, span = np.abs(exact[defined] - disturbed[defined]), _span(exact[defined])
            error = _largest(lost) if scalar else float(np.mean(lost)) if lost.size else 0.0
            if error > most * span > 0.0 or (scalar and error > _LOST_OF_WIDTH * width > 0.0):
                return True
            if scalar and _tiny_or_huge(exact):
                return True
    return False


def plain_widths(
    volume: Volume, features: Iterable[Feature]
) -> tuple[tuple[Expression, float], ...]:
    """Return expressions with the widths of their structures, in the volume's units."""

    def width(feature: Feature) -> float:
        if not is_quantity(feature.width):
            return float(feature.width)
        try:
            return float(plain(feature.width, volume.expression_unit(feature.expr), "width"))
        except UnitsError:
            return 0.0  # refused, by its own name, where the medium is evaluated

    return tuple((feature.expr, width(feature)) for feature in features)


def _sample(volume: Volume, names: Iterable[str]) -> Sample:
    names, size = list(names), volume.grid.size
    others = [name for name in names if name not in volume]
    run = min(_RUN, size) if others else 1
    starts = np.linspace(0, size - run, min(_SAMPLE, size) // run).astype(np.int64)
    chosen = (starts[:, None] + np.arange(run)).ravel()
    sample = {n: volume.array(n).reshape(-1)[chosen].astype(float) for n in names if n in volume}
    if others:
        parts = [coordinates(volume.grid, others, first, first + run) for first in starts.tolist()]
        sample |= {name: np.concatenate([part[name] for part in parts]) for name in others}
    return sample


def _values(expr: Any, sample: Sample, kind: type) -> np.ndarray:
    used: Any = {name: sample[name].astype(kind) for name in expr.names}
    return np.atleast_1d(np.asarray(expr.evaluate(NumpyOps(kind), used), dtype=np.float64))


def _tiny_or_huge(values: np.ndarray) -> bool:
    size = _largest(values[np.isfinite(values)])
    return 0.0 < size < _TINY or size > _HUGE


def _largest(values: np.ndarray) -> float:
    return float(np.max(np.abs(values), initial=0.0))


def _span(values: np.ndarray) -> float:
    return float(np.ptp(values)) if values.size else 0.0
