"""Guaranteed bounds of means over a panel: what they are on the chord, and what the bow can change.

A scalar is within u(1-u)/2 sup|x''| of its chord, so within sup|x''|/12 in the mean: the mean of a
function of it is that on the chord, in closed form, up to as much times the function's slope.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..backend import dr
from ..errors import InputError
from ..expressions.traced_interval import TracedInterval
from ..expressions.traced_rounding import float_info, lowered, raised
from .contract import Coefficients
from .part_bounds import PartBounds, meet, part_bounds
from .shape_means import box_mean
from .table_means import PiecewiseLinear

if TYPE_CHECKING:
    from .coefficients import Coefficients as CoefficientsMedium
    from .color_by import ColorBy
    from .course import Course, CourseContext, Courses
    from .modulation import Modulation
    from .shaped import Shaped
    from .table import Table

# What the closed forms lose in double precision, of the peak, and several times as much for safety.
_SHAPE_LOSS = 1e-14
_TABLE_LOSS = 1e-12
# In place of the slope of a jump: what it is multiplied with stays finite.
_STEEPEST = 1e150


def mean_of(course: Course) -> TracedInterval:
    """Return the mean of a scalar: half its ends' sum, and what the bow may change."""
    middle = 0.5 * (course.first + course.last)
    off = raised(course.bow * (1.0 / 12.0))
    return TracedInterval(lowered(middle.lo - off), raised(middle.hi + off), middle.nan)


def in_widths(course: Course, center: Any, width: Any) -> tuple[Any, Any, Any, Any]:
    """Return the ends' distances from a centre, and how far off the chord is in the mean, at most.

    Plain numbers; the rounding of the first two is counted with the others.
    """
    middles = [0.5 * (end.lo + end.hi) for end in (course.first, course.last)]
    first, last = ((x - center) / width for x in middles)
    sizes = dr.abs(middles[0]) + dr.abs(middles[1]) + 2.0 * dr.abs(center)
    rounding = 8.0 * float(float_info(type(first)).eps) * (sizes / width + 1.0)
    return first, last, course.off / width + rounding, course.farthest / width + rounding


def gaussian_bounds(mean: Any, off: Any, z: TracedInterval) -> TracedInterval:
    """Return the mean of exp(-z²/2), given that on the chord.

    Its slope z exp(-z²/2) is largest at 1 and falls to both sides.
    """
    near, far = z.smallest, z.size
    steepest = dr.select(far < 1.0, far, dr.select(near > 1.0, near, 1.0))
    slope = dr.select(steepest < 30.0, steepest * dr.exp(-0.5 * steepest * steepest), 1e-190)
    return _around(mean, raised(slope * off * (1.0 + 1e-12)) + _SHAPE_LOSS)


def box_bounds(first: Any, last: Any, farthest: Any) -> TracedInterval:
    """Return the part of a panel with z from -1 to 1: between those with limits moved both ways."""
    inner, outer = 1.0 - farthest, 1.0 + farthest
    some = dr.select(inner > 0.0, inner, 1.0)
    least = dr.select(inner > 0.0, box_mean(first / some, last / some), 0.0)
    most = box_mean(first / outer, last / outer)
    return TracedInterval(_unit(least - _SHAPE_LOSS), _unit(most + _SHAPE_LOSS))


def table_bounds(
    course: Course, nodes: np.ndarray, columns: np.ndarray, context: CourseContext, table: Any
) -> list[TracedInterval]:
    """Return the means of piecewise-linear columns of the order of one."""
    first, last = (0.5 * (end.lo + end.hi) for end in (course.first, course.last))
    means = table.means(table.at(first), table.at(last))
    rounding = 8.0 * float(float_info(type(first)).eps)
    off = course.off + rounding * (dr.abs(first) + dr.abs(last) + float(np.abs(nodes).max()))
    doubled, slopes = steepness(nodes, columns)
    steep = context.interpolate(course.values, doubled, list(slopes.T))
    return [
        _around(mean, raised(slope.hi * off) + _TABLE_LOSS)
        for mean, slope in zip(means, steep, strict=True)
    ]


def steepness(nodes: np.ndarray, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the magnitudes of columns' slopes as a table with jumps; zero beyond both ends."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        slopes = np.abs(np.diff(columns, axis=0) / np.diff(nodes)[:, None])
    slopes = np.minimum(np.nan_to_num(slopes, nan=0.0, posinf=_STEEPEST), _STEEPEST)
    none = np.zeros((1, columns.shape[1]))
    return np.repeat(nodes, 2), np.concatenate([none, np.repeat(slopes, 2, axis=0), none])


def shaped_parts(medium: Shaped, courses: Courses, context: CourseContext) -> list[PartBounds]:
    """Return what is certain of a Gaussian or rectangle."""
    center, width, length = medium.plain_numbers(context)
    course = courses.course(medium.expr)
    c, w = context.plain(center), context.plain(width)
    z = (course.values - context.number(center)) / context.number(width)
    shape = medium.mean_bounds(*in_widths(course, c, w), z)
    shape = TracedInterval(_unit(shape.lo), _unit(shape.hi)) * context.number(1.0 / length)
    means = Coefficients(
        [context.number(h) * shape for h in medium.color],
        [context.number(h) * shape for h in medium.opacity],
    )
    opacities = medium.opacity * (1 if len(medium.opacity) > 1 else medium.channels)
    sources = [
        TracedInterval.constant(context.plain(h / o)) if o > 0 else None
        for h, o in zip(medium.color, opacities, strict=True)
    ]
    ranged = medium.per_length(courses.fields, context)
    plain = [context.number(h) * ranged for h in medium.color]
    return [_modulated(medium, plain, means, sources, courses, context)]


def table_parts(
    medium: Table, length: float, courses: Courses, context: CourseContext
) -> list[PartBounds]:
    """Return what is certain of a table."""
    course = courses.course(medium.expr)
    nodes, columns = medium.nodes(context), medium.shape
    table = context.keep(
        (id(medium), "sums"), lambda: PiecewiseLinear(courses.real, nodes, columns)
    )
    heights = [context.number(float(h)) for h in medium.peaks / length]
    means = [
        h * m
        for h, m in zip(heights, table_bounds(course, nodes, columns, context, table), strict=True)
    ]
    found = Coefficients(means[: medium.channels], means[medium.channels :])
    values = context.interpolate(course.values, nodes, list((medium.rows / length).T))
    alphas = values[medium.channels :] * (medium.channels if medium.grey else 1)
    sources = [j / a for j, a in zip(values[: medium.channels], alphas, strict=True)]
    return [_modulated(medium, values[: medium.channels], found, sources, courses, context)]


def expression_parts(
    medium: CoefficientsMedium, courses: Courses, context: CourseContext
) -> list[PartBounds]:
    """Return what is certain of coefficients that are expressions."""
    means = _Means(context)
    return [
        part_bounds(
            medium.coefficients(courses.fields, context),
            medium.coefficients(courses.fields, means),  # type: ignore[arg-type]
            courses.length,
        )
    ]


class _Means:
    """A context in which an expression's value is its mean."""

    def __init__(self, context: CourseContext) -> None:
        self._courses, self.number = context.courses, context.number
        self.unit, self.unit_of = context.unit, context.unit_of

    def evaluate(self, expression: Any, fields: Any) -> TracedInterval:
        assert self._courses is not None
        return mean_of(self._courses.course(expression))


def _modulated(
    medium: Any,
    plain: list[TracedInterval],
    means: Coefficients,
    sources: list[Any],
    courses: Courses,
    context: CourseContext,
) -> PartBounds:
    """Return bounds of a medium with gates and colours, from values and means without them."""
    found = medium.ranges(courses.fields, context)
    modulation: Modulation = medium.modulation
    if modulation.shade is not None:
        raise InputError(
            "bounds=True is for media without shading, which is an illustration; use shading=0"
        )
    if modulation.color is not None:
        paint, mean_paint = _paint(modulation.color, courses, context)
        emitted = [
            _mean_product(*factors)
            for factors in zip(plain, means.emissivity, paint, mean_paint, strict=True)
        ]
        means = Coefficients(emitted, means.extinction)
        sources = [None if s is None else s * p for s, p in zip(sources, paint, strict=True)]
    if modulation.where is not None:
        gate = modulation.gate(courses.fields, context)
        means = Coefficients(
            [_mean_times(gate, *m) for m in zip(plain, means.emissivity, strict=True)],
            [gate * m for m in means.extinction],
        )
    ends = [None if s is None else (s.lo, s.hi) for s in sources]
    return part_bounds(found, means, courses.length, ends)


def _paint(
    color: ColorBy, courses: Courses, context: CourseContext
) -> tuple[list[TracedInterval], list[TracedInterval]]:
    nodes, rgb = color.nodes(context), color.scale.rgb
    course = courses.course(color.expr)
    table = context.keep((id(color), "sums"), lambda: PiecewiseLinear(courses.real, nodes, rgb))
    ranges = color.colors(courses.fields, context)
    means = table_bounds(course, nodes, rgb, context, table)
    return ranges, [meet(r, m) for r, m in zip(ranges, means, strict=True)]


def _mean_product(
    f: TracedInterval, mean_f: TracedInterval, g: TracedInterval, mean_g: TracedInterval
) -> TracedInterval:
    """Return the mean of a product: that of the means, up to Δf Δg / 4 (Grüss 1935)."""
    product = mean_f * mean_g
    apart = raised(0.25 * (f.hi - f.lo) * (g.hi - g.lo))
    bounds = TracedInterval(lowered(product.lo - apart), raised(product.hi + apart), product.nan)
    return meet(bounds, f * g)


def _mean_times(gate: TracedInterval, f: TracedInterval, mean: TracedInterval) -> TracedInterval:
    """Return the mean of a gate, from 0 to 1, times what may change its sign."""
    one_sign = (f.lo >= 0.0) | (f.hi <= 0.0)
    found = gate * mean
    return TracedInterval(
        dr.select(one_sign, found.lo, -dr.inf), dr.select(one_sign, found.hi, dr.inf)
    )


def _around(middle: Any, off: Any) -> TracedInterval:
    return TracedInterval(lowered(middle - off), raised(middle + off))


def _unit(value: Any) -> Any:
    """Return a number between 0 and 1; NaN, of which nothing is known, as it is."""
    return dr.select(value < 0.0, 0.0, dr.select(value > 1.0, 1.0, value))
