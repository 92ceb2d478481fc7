"""Guaranteed bounds of means over a panel: closed forms on the chord, and a curvature correction.

A scalar is within u(1-u)/2 sup|x''| of its chord, so within sup|x''|/12 in the mean: the mean of a
function of it is that on the chord, in closed form, up to this distance times the largest slope of
the function.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from ..backend import dr
from ..backend.types import Float, Mask
from ..errors import InputError
from ..expressions import Expression
from ..expressions.traced_interval import (
    TracedInterval,
    float_info,
    larger,
    lowered,
    positive,
    raised,
    smaller,
)
from ..media.arguments import depth_of, length_in
from ..media.coefficients import Coefficients
from ..media.context import MediumSample
from ..media.contract import Medium
from ..media.gaussian import Gaussian, gaussian_mean
from ..media.isosurface import Isosurface
from ..media.piecewise_linear import PiecewiseLinear
from ..media.profiles import Shaped
from ..media.rectangle import Rectangle, box_mean
from ..media.shading import HEADLIGHT
from ..media.sum import Sum
from ..media.table import Table

if TYPE_CHECKING:
    from .scalars import Course, CourseContext, Courses

Ends: TypeAlias = tuple[Float, Float]


@dataclass
class PartBounds:
    """Intervals of a part's coefficients on a panel, times the panel's length.

    Of j per channel and α (one if grey): their values anywhere, and their integrals `emitted` and
    `depth`. `source` has bounds of j/α per channel; None where those of j and α give them.
    """

    emissivity: list[TracedInterval]
    extinction: list[TracedInterval]
    emitted: list[TracedInterval]
    depth: list[TracedInterval]
    source: Sequence[Ends | None]

    def spread(self, count: int) -> PartBounds:
        """Return the same with a number of extinctions."""
        if len(self.extinction) == count:
            return self
        return replace(self, extinction=self.extinction * count, depth=self.depth * count)

    def source_of(self, channel: int) -> Ends:
        """Return bounds of j/α; infinite where there are none."""
        known = self.source[channel]
        if known is not None:
            return known
        alpha = self.extinction[channel if len(self.extinction) > 1 else 0]
        quotient = self.emissivity[channel] / alpha
        return quotient.lo, quotient.hi


def part_bounds(
    ranges: MediumSample,
    means: MediumSample,
    length: TracedInterval,
    source: Sequence[Ends | None] | None = None,
) -> PartBounds:
    """Return bounds from the ranges and the means of the coefficients over a panel."""
    j, alpha = ([length * v for v in own] for own in (ranges.emissivity, ranges.extinction))
    emitted = [meet(length * v, own) for v, own in zip(means.emissivity, j, strict=True)]
    depth = [meet(length * v, own) for v, own in zip(means.extinction, alpha, strict=True)]
    return PartBounds(j, alpha, emitted, depth, [None] * len(j) if source is None else source)


def total_bounds(parts: list[PartBounds]) -> PartBounds:
    """Return the bounds of a sum; its j/α lies in the hull of j/α of the parts present."""
    if len(parts) == 1:
        return parts[0]
    columns = zip(*((p.emissivity, p.extinction, p.emitted, p.depth) for p in parts), strict=True)
    sums = [[functools.reduce(operator.add, own) for own in zip(*c, strict=True)] for c in columns]
    channels = range(len(sums[0]))
    total = PartBounds(sums[0], sums[1], sums[2], sums[3], [None for _ in channels])
    return replace(total, source=[_source(parts, total, c) for c in channels])


def _source(parts: list[PartBounds], total: PartBounds, channel: int) -> Ends:
    """Return the hull of j/α over all parts that may absorb or emit, intersected with the sum's."""
    own = total.source_of(channel)
    low, high = dr.inf, -dr.inf
    for part in parts:
        alpha = part.extinction[channel if len(part.extinction) > 1 else 0]
        there = (alpha.hi > 0.0) | (part.emissivity[channel].size > 0.0)
        below, above = part.source_of(channel)
        low = dr.select(there & ~(below >= low), below, low)
        high = dr.select(there & ~(above <= high), above, high)
    return larger(own[0], low), smaller(own[1], high)


def meet(a: TracedInterval, b: TracedInterval) -> TracedInterval:
    """Return the intersection of two intervals that hold the same number."""
    return TracedInterval(larger(a.lo, b.lo), smaller(a.hi, b.hi), a.nan & b.nan)


# Rounding errors of the closed forms in double precision, relative to the peak, with safety factor.
_SHAPE_LOSS = 1e-14
_TABLE_LOSS = 1e-12
# Replaces the slope of a jump, so that products with it stay finite.
_STEEPEST = 1e150


@functools.singledispatch
def bounds_on_panel(medium: Medium, courses: Courses, context: CourseContext) -> list[PartBounds]:
    """Return bounds on a panel of a ray for each part of a medium that is a sum.

    The default is the ranges of the coefficients. The types registered here have narrower bounds,
    from their means.
    """
    found = medium.ranges(courses.fields, context)
    return [part_bounds(found, found, courses.length)]


@bounds_on_panel.register(Sum)
def _of_sum(medium: Sum, courses: Courses, context: CourseContext) -> list[PartBounds]:
    return [part for one in medium.parts for part in bounds_on_panel(one, courses, context)]


def is_bounded(medium: Medium) -> bool:
    """Return whether the coefficients of a medium have bounds."""
    own, base = bounds_on_panel.dispatch(type(medium)), bounds_on_panel.dispatch(Medium)
    return own is not base or type(medium).ranges is not Medium.ranges


def in_widths(course: Course, center: Float, width: Float) -> tuple[Float, Float, Float, Float]:
    """Return the distances of both ends from a centre, and the mean and largest chord error.

    In units of the width. The errors include the rounding of the distances.
    """
    middles = course.middles()
    first, last = ((x - center) / width for x in middles)
    sizes = dr.abs(middles[0]) + dr.abs(middles[1]) + 2.0 * dr.abs(center)
    rounding = 8.0 * float(float_info(type(first)).eps) * (sizes / width + 1.0)
    return first, last, course.off / width + rounding, course.farthest / width + rounding


def _mean_of_profile(
    medium: Shaped, course: Course, center: float, width: float, context: CourseContext
) -> TracedInterval:
    """Return the mean of a profile; without a closed form, the range of its values."""
    offset = course.values - context.number(center)
    if isinstance(medium, (Gaussian, Rectangle)):
        c, w = context.plain(center), context.plain(width)
        first, last, off, farthest = in_widths(course, c, w)
        if isinstance(medium, Rectangle):
            return box_bounds(first, last, farthest)
        z = offset / context.number(width)
        return gaussian_bounds(gaussian_mean(first, last), off, z)
    found: TracedInterval = medium.shape(context.ops, offset, context.number(width))
    return found


def gaussian_bounds(mean: Float, off: Float, z: TracedInterval) -> TracedInterval:
    """Return bounds of the mean of exp(-z²/2), given the mean on the chord.

    The slope z exp(-z²/2) is largest at 1 and falls to both sides.
    """
    near, far = z.smallest, z.size
    steepest = dr.select(far < 1.0, far, dr.select(near > 1.0, near, 1.0))
    slope = dr.select(steepest < 30.0, steepest * dr.exp(-0.5 * steepest * steepest), 1e-190)
    return _around(mean, raised(slope * off * (1.0 + 1e-12)) + _SHAPE_LOSS)


def box_bounds(first: Float, last: Float, farthest: Float) -> TracedInterval:
    """Return bounds of the part of a panel with |z| < 1, from limits moved in and out."""
    inner, outer = 1.0 - farthest, 1.0 + farthest
    some = dr.select(inner > 0.0, inner, 1.0)
    least = dr.select(inner > 0.0, box_mean(first / some, last / some), 0.0)
    most = box_mean(first / outer, last / outer)
    return _unit(TracedInterval(least - _SHAPE_LOSS, most + _SHAPE_LOSS))


def table_bounds(
    course: Course, nodes: np.ndarray, columns: np.ndarray, context: CourseContext, table: Any
) -> list[TracedInterval]:
    """Return bounds of the means of piecewise-linear columns, scaled to the order of one."""
    first, last = course.middles()
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


@bounds_on_panel.register(Shaped)
def _of_profile(medium: Shaped, courses: Courses, context: CourseContext) -> list[PartBounds]:
    center, width, length = medium.plain_numbers(context)
    course = courses.course(medium.expr)
    shape = _unit(_mean_of_profile(medium, course, center, width, context))
    shape = shape * context.number(1.0 / length)
    means = medium.split([context.number(h) * shape for h in (*medium.color, *medium.opacity)])
    opacities = medium.opacity * (1 if len(medium.opacity) > 1 else medium.channels)
    sources = [
        TracedInterval.constant(context.plain(h / o)) if o > 0 else None
        for h, o in zip(medium.color, opacities, strict=True)
    ]
    ranged = medium.per_length(courses.fields, context)
    plain = [context.number(h) * ranged for h in medium.color]
    return [_modulated(medium, plain, means, sources, courses, context)]


@bounds_on_panel.register(Table)
def _of_table(medium: Table, courses: Courses, context: CourseContext) -> list[PartBounds]:
    length = length_in(medium.path_length, context.unit)
    course = courses.course(medium.expr)
    nodes, columns = medium.nodes(context), medium.shape
    table = context.keep(
        (id(medium), "sums"), lambda: PiecewiseLinear(courses.real, nodes, columns)
    )
    means = table_bounds(course, nodes, columns, context, table)
    heights = [context.number(float(h)) for h in medium.peaks / length]
    means = [h * mean for h, mean in zip(heights, means, strict=True)]
    values = medium.split(context.interpolate(course.values, nodes, [*(medium.rows / length).T]))
    alphas = values.extinction * (medium.channels if medium.grey else 1)
    sources = [j / a for j, a in zip(values.emissivity, alphas, strict=True)]
    return [_modulated(medium, values.emissivity, medium.split(means), sources, courses, context)]


@bounds_on_panel.register(Coefficients)
def _of_expressions(
    medium: Coefficients, courses: Courses, context: CourseContext
) -> list[PartBounds]:
    ranges = medium.coefficients(courses.fields, context)
    means = medium.coefficients(courses.fields, _Means(courses, context))  # type: ignore[arg-type]
    return [part_bounds(ranges, means, courses.length)]


class _Means:
    """A context in which the value of an expression is its mean: of its ends, ± sup|x''|/12."""

    def __init__(self, courses: Courses, context: CourseContext) -> None:
        self._courses, self.number = courses, context.number
        self.unit, self.unit_of = context.unit, context.unit_of

    def evaluate(self, expression: Any, fields: Any) -> TracedInterval:
        course = self._courses.course(expression)
        middle = 0.5 * (course.first + course.last)
        off = raised(course.bow * (1.0 / 12.0))
        return TracedInterval(lowered(middle.lo - off), raised(middle.hi + off), middle.nan)


def _modulated(
    medium: Shaped | Table,
    plain: list[TracedInterval],
    means: MediumSample,
    sources: Sequence[TracedInterval | None],
    courses: Courses,
    context: CourseContext,
) -> PartBounds:
    ranges, modulation = medium.ranges(courses.fields, context), medium.modulation
    if modulation.shade is not None:
        raise InputError(
            "bounds=True is for media without shading, which is an illustration; use shading=0"
        )
    if modulation.color is not None:
        color = modulation.color
        nodes, rgb = color.nodes(context), color.range.rows
        paint = color.colors(courses.fields, context)
        table = context.keep((id(color), "sums"), lambda: PiecewiseLinear(courses.real, nodes, rgb))
        mean_paint = table_bounds(courses.course(color.expr), nodes, rgb, context, table)
        mean_paint = [meet(r, m) for r, m in zip(paint, mean_paint, strict=True)]
        emitted = [
            _mean_product(*factors)
            for factors in zip(plain, means.emissivity, paint, mean_paint, strict=True)
        ]
        means = MediumSample(emitted, means.extinction)
        sources = [None if s is None else s * p for s, p in zip(sources, paint, strict=True)]
    if modulation.where is not None:
        gate = modulation.gate(courses.fields, context)
        means = MediumSample(
            [_mean_times(gate, *m) for m in zip(plain, means.emissivity, strict=True)],
            [gate * m for m in means.extinction],
        )
    ends = [None if s is None else (s.lo, s.hi) for s in sources]
    return part_bounds(ranges, means, courses.length, ends)


def _mean_product(
    f: TracedInterval, mean_f: TracedInterval, g: TracedInterval, mean_g: TracedInterval
) -> TracedInterval:
    """Return bounds of the mean of a product: the product of the means ± Δf Δg / 4 (Grüss 1935)."""
    product = mean_f * mean_g
    apart = raised(0.25 * (f.hi - f.lo) * (g.hi - g.lo))
    bounds = TracedInterval(lowered(product.lo - apart), raised(product.hi + apart), product.nan)
    return meet(bounds, f * g)


def _mean_times(gate: TracedInterval, f: TracedInterval, mean: TracedInterval) -> TracedInterval:
    """Return bounds of the mean of a gate, from 0 to 1, times f; unbounded if f changes sign."""
    one_sign = (f.lo >= 0.0) | (f.hi <= 0.0)
    found = gate * mean
    return TracedInterval(
        dr.select(one_sign, found.lo, -dr.inf), dr.select(one_sign, found.hi, dr.inf)
    )


def _around(middle: Float, off: Float) -> TracedInterval:
    return TracedInterval(lowered(middle - off), raised(middle + off))


def _unit(x: TracedInterval) -> TracedInterval:
    """Return an interval clipped to [0, 1]; NaN stays NaN."""
    ends = [dr.select(v < 0.0, 0.0, dr.select(v > 1.0, 1.0, v)) for v in (x.lo, x.hi)]
    return TracedInterval(*ends)


@bounds_on_panel.register(Isosurface)
def _of_surfaces(medium: Isosurface, courses: Courses, context: CourseContext) -> list[PartBounds]:
    levels, width = medium.plain_numbers(context)
    course, modulation = courses.course(medium.expr), medium.modulation
    colors = [_light(medium, courses, context)] * medium.channels
    if modulation.color is not None:
        paint = modulation.color.colors(courses.fields, context)
        colors = [light * own for light, own in zip(colors, paint, strict=True)]
    parts = []
    for level, color, row in zip(levels, medium.colors, medium.opacities, strict=True):
        value, wide = context.plain(level), context.plain(width)
        crossed, densest = _shell(course, value, wide) if width else _crossings(course, value)
        if medium.density == "gradient":
            steep = courses.course(medium.slope).values * courses.length
            crossed = _oblique(course, steep, crossed)
            if width:
                crossed, densest = _sheet(course, value, wide, steep, crossed)
        if modulation.where is not None:  # both are zero where the gate is closed
            gate = modulation.gate(courses.fields, context)
            most, densest = (dr.select(gate.hi > 0.0, v, 0.0) for v in (crossed.hi, densest))
            crossed = TracedInterval(gate.lo * crossed.lo, most)
        anywhere = TracedInterval(type(densest)(0), densest)
        # An amount may be infinite, times a depth of zero.
        extinction, depth = (
            [context.number(o) * amount if o else context.number(0.0) for o in map(depth_of, row)]
            for amount in (anywhere, crossed)
        )
        source = [context.number(h) * own for h, own in zip(color, colors, strict=True)]
        emissivity, emitted = (
            [h * own[c if len(own) > 1 else 0] for c, h in enumerate(source)]
            for own in (extinction, depth)
        )
        ends = [(h.lo, h.hi) for h in source]
        parts.append(PartBounds(emissivity, extinction, emitted, depth, ends))
    return parts


def _crossings(course: Course, level: Float) -> tuple[TracedInterval, Float]:
    """Return bounds of the number of crossings of a level, and the density: infinite or zero."""
    first, last, x = course.first, course.last, course.values
    apart = ((first.hi < level) & (last.lo >= level)) | ((last.hi < level) & (first.lo >= level))
    never = (x.hi < level) | (x.lo >= level)
    many = dr.select(_monotonic(course), type(level)(1), dr.inf)
    crossed = TracedInterval(dr.select(apart, type(level)(1), 0), dr.select(never, 0, many))
    return crossed, dr.select(never, type(level)(0), dr.inf)


def _shell(course: Course, level: Float, width: Float) -> tuple[TracedInterval, Float]:
    first, last, x = (_place(v, level, width) for v in (course.first, course.last, course.values))
    never = (x.hi <= 0.0) | (x.lo >= 1.0)
    densest = dr.select(never, 0.0, raised(course.slope.size / width))
    way = abs(last - first)
    most = dr.select(_monotonic(course), smaller(way.hi, densest), densest)
    return TracedInterval(dr.select(never, 0.0, way.lo), most), densest


def _place(x: TracedInterval, level: Float, width: Float) -> TracedInterval:
    return _unit((x - level) / TracedInterval.constant(width) + 0.5)


def _monotonic(course: Course) -> Mask:
    return (course.slope.lo >= 0.0) | (course.slope.hi <= 0.0)


def _oblique(course: Course, steep: TracedInterval, crossed: TracedInterval) -> TracedInterval:
    ratio = steep / abs(course.slope)
    one = type(course.bow)(1)
    result = crossed * TracedInterval(larger(ratio.lo, one), larger(ratio.hi, one))
    # Without a crossing an infinite ratio does not matter.
    none = crossed.hi <= 0.0
    low, high = (dr.select(none, 0.0, end) for end in (positive(result.lo), result.hi))
    return TracedInterval(low, high)


def _sheet(
    course: Course, level: Float, width: Float, steep: TracedInterval, oblique: TracedInterval
) -> tuple[TracedInterval, Float]:
    """Return bounds of the amount of a sheet of finite thickness, and its largest density.

    A panel parallel to the sheet may be inside it without a crossing.
    """
    first, x = (_place(v, level, width) for v in (course.first, course.values))
    never = (x.hi <= 0.0) | (x.lo >= 1.0)
    dense = steep / TracedInterval.constant(width)
    densest = dr.select(never, 0.0, raised(larger(dense.hi, course.slope.size / width)))
    always = (x.lo > 0.0) & (x.hi < 1.0)
    least = dr.select(always, larger(oblique.lo, positive(dense.lo)), oblique.lo)
    # A panel outside the sheet or parallel to it has no crossing.
    along = (oblique.hi <= 0.0) & (first.hi > 0.0) & (first.lo < 1.0)
    most = dr.select(along, densest, smaller(oblique.hi, densest))
    return TracedInterval(dr.select(never, 0.0, least), most), densest


def _light(medium: Isosurface, courses: Courses, context: CourseContext) -> TracedInterval:
    one: TracedInterval = context.number(1.0)
    if medium.shading == 0:
        return one
    if medium.lights != ((HEADLIGHT, 1.0),):
        raise InputError("bounds=True is for a headlight alone; leave lights= out")
    normal = [courses.course(e).values for e in medium.normal]
    way = [courses.course(Expression(axis)).slope for axis in "xyz"]
    along, across, length = (
        a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
        for a, b in ((normal, way), (normal, normal), (way, way))
    )
    cosine = abs(along) / context.ops.sqrt(across * length)
    size = dr.select(cosine.hi < 1.0, cosine.hi, 1.0)
    # A normal that may vanish counts as facing the camera.
    limited = TracedInterval(positive(dr.select(cosine.lo > 1.0, 1.0, cosine.lo)), size)
    share: TracedInterval = context.number(medium.shading)
    return (one - share) + share * limited
