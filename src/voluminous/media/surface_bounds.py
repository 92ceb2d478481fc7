"""What is certain of isosurfaces on a panel of a ray: how often it crosses a level.

It does so once, for sure, if the scalar grows all along and is on different sides at both ends.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ..backend import dr
from ..errors import InputError
from ..expressions import Expression
from ..expressions.traced_interval import TracedInterval
from ..expressions.traced_rounding import larger, positive, raised, smaller
from .part_bounds import PartBounds
from .shade import HEADLIGHT
from .surface_given import depth_of

if TYPE_CHECKING:
    from .course import Course, CourseContext, Courses
    from .isosurface import Isosurface


def surface_parts(medium: Isosurface, courses: Courses, context: CourseContext) -> list[PartBounds]:
    """Return what is certain of each level."""
    levels, width = medium.plain_numbers(context)
    course = courses.course(medium.expr)
    light = _lit(medium, courses, context)
    found = []
    for level, color, row in zip(levels, medium.colors, medium.opacities, strict=True):
        value = context.plain(level)
        if width > 0:
            crossed, densest = _shell(course, value, context.plain(width))
        else:
            crossed, densest = _crossings(course, value)
        if medium.density == "gradient":
            steep = courses.course(medium.slope).values * courses.length
            crossed = _oblique(course, steep, crossed)
            if width > 0:
                crossed, densest = _sheet(course, value, context.plain(width), steep, crossed)
        if medium.modulation.where is not None:
            gate = medium.modulation.gate(courses.fields, context)
            crossed, densest = _gated(gate, crossed, densest)
        depths = [depth_of(o) for o in row]
        found.append(_part(color, depths, crossed, densest, light, context))
    return found


def _part(
    color: tuple[float, ...],
    depths: list[float],
    crossed: TracedInterval,
    densest: Any,
    light: list[TracedInterval],
    context: CourseContext,
) -> PartBounds:
    """Return bounds from how much is crossed, and how much there is at most anywhere."""
    anywhere = TracedInterval(type(densest)(0), densest)
    extinction = [_times(context, d, anywhere) for d in depths]
    depth = [_times(context, d, crossed) for d in depths]
    own = [0 if len(depths) == 1 else c for c in range(len(color))]
    shown = [context.number(h) * lit for h, lit in zip(color, light, strict=True)]
    return PartBounds(
        [h * extinction[e] for h, e in zip(shown, own, strict=True)],
        extinction,
        [h * depth[e] for h, e in zip(shown, own, strict=True)],
        depth,
        [(h.lo, h.hi) for h in shown],
    )


def _gated(
    gate: TracedInterval, crossed: TracedInterval, densest: Any
) -> tuple[TracedInterval, Any]:
    """Return the same where a gate lets them through; what is closed, holds nothing."""
    most = dr.select(gate.hi > 0.0, crossed.hi, 0.0)
    return TracedInterval(gate.lo * crossed.lo, most), dr.select(gate.hi > 0.0, densest, 0.0)


def _times(context: CourseContext, depth: float, amount: TracedInterval) -> TracedInterval:
    """Return a depth times an amount that may be infinite: nothing, if the depth is none."""
    return context.number(0.0) if depth == 0.0 else context.number(depth) * amount


def _crossings(course: Course, level: Any) -> tuple[TracedInterval, Any]:
    """Return how often a level is passed, and how dense that is: without limit, or nothing."""
    first, last, x = course.first, course.last, course.values
    apart = ((first.hi < level) & (last.lo >= level)) | ((last.hi < level) & (first.lo >= level))
    never = (x.hi < level) | (x.lo >= level)
    many = dr.select(_monotonic(course), type(level)(1), dr.inf)
    crossed = TracedInterval(dr.select(apart, type(level)(1), 0), dr.select(never, 0, many))
    return crossed, dr.select(never, type(level)(0), dr.inf)


def _shell(course: Course, level: Any, width: Any) -> tuple[TracedInterval, Any]:
    """Return how much of a shell is passed, up and down, and how dense it is at most."""
    first, last, x = (_place(v, level, width) for v in (course.first, course.last, course.values))
    never = (x.hi <= 0.0) | (x.lo >= 1.0)
    densest = dr.select(never, 0.0, raised(course.slope.size / width))
    way = abs(last - first)
    most = dr.select(_monotonic(course), smaller(way.hi, densest), densest)
    return TracedInterval(dr.select(never, 0.0, way.lo), most), densest


def _place(x: TracedInterval, level: Any, width: Any) -> TracedInterval:
    inside = (x - level) / TracedInterval.constant(width) + 0.5
    ends = [dr.select(v < 0.0, 0.0, dr.select(v > 1.0, 1.0, v)) for v in (inside.lo, inside.hi)]
    return TracedInterval(*ends)


def _monotonic(course: Course) -> Any:
    return (course.slope.lo >= 0.0) | (course.slope.hi <= 0.0)


def _oblique(course: Course, steep: TracedInterval, crossed: TracedInterval) -> TracedInterval:
    """Return the same for a sheet of equal thickness everywhere, by the whole gradient of x."""
    ratio = steep / abs(course.slope)
    one = type(course.bow)(1)
    found = crossed * TracedInterval(larger(ratio.lo, one), larger(ratio.hi, one))
    # Where nothing is crossed, a ratio without limit does not matter.
    none = crossed.hi <= 0.0
    return TracedInterval(dr.select(none, 0.0, positive(found.lo)), dr.select(none, 0.0, found.hi))


def _sheet(
    course: Course, level: Any, width: Any, steep: TracedInterval, oblique: TracedInterval
) -> tuple[TracedInterval, Any]:
    """Return how much there is of a sheet of some thickness, and how dense it is at most.

    A panel along it crosses nothing, and is in it all the same.
    """
    first, x = (_place(v, level, width) for v in (course.first, course.values))
    never = (x.hi <= 0.0) | (x.lo >= 1.0)
    dense = steep / TracedInterval.constant(width)
    densest = dr.select(never, 0.0, raised(larger(dense.hi, course.slope.size / width)))
    always = (x.lo > 0.0) & (x.hi < 1.0)
    least = dr.select(always, larger(oblique.lo, positive(dense.lo)), oblique.lo)
    # Nothing is crossed outside, or along it.
    along = (oblique.hi <= 0.0) & (first.hi > 0.0) & (first.lo < 1.0)
    most = dr.select(along, densest, smaller(oblique.hi, densest))
    return TracedInterval(dr.select(never, 0.0, least), most), densest


def _lit(medium: Isosurface, courses: Courses, context: CourseContext) -> list[TracedInterval]:
    """Return what multiplies each channel's colour: light, and the colours of another field."""
    lit = [_shade(medium, courses, context)] * medium.channels
    if medium.modulation.color is None:
        return lit
    paint = medium.modulation.color.colors(courses.fields, context)
    return [a * b for a, b in zip(lit, paint, strict=True)]


def _shade(medium: Isosurface, courses: Courses, context: CourseContext) -> TracedInterval:
    """Return how bright the surface may look by the light of a lamp at the camera."""
    one = context.number(1.0)
    if medium.shading == 0:
        return one
    if medium.lights != ((HEADLIGHT, 1.0),):
        raise InputError("bounds=True is for a headlight alone; leave lights= out")
    normal = [courses.course(e).values for e in medium.normal]
    way = [courses.course(Expression(axis)).slope for axis in "xyz"]
    ops = context.ops
    cosine = abs(_dot(normal, way)) / ops.sqrt(_dot(normal, normal) * _dot(way, way))
    size = dr.select(cosine.hi < 1.0, cosine.hi, 1.0)
    # A normal that may vanish counts as facing the camera.
    limited = TracedInterval(positive(dr.select(cosine.lo > 1.0, 1.0, cosine.lo)), size)
    share = context.number(medium.shading)
    return (one - share) + share * limited


def _dot(a: list[TracedInterval], b: list[TracedInterval]) -> TracedInterval:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
