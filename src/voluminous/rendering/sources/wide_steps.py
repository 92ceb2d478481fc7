"""Finds bricks where rays can take wider steps, because a coarser interpolant is accurate there.

In a cube of 2, 4 or 8 dual cells, the fields interpolated between its eight corners are compared
with the fields themselves at every cell centre inside. Where the error of each of the medium's
expressions is below a fraction of the width of its structures, the cube is one step of a ray. In
the wings of a shell, where it is faint, a larger error is allowed: up to its width. Steps become
fewer where fields are smooth, and stay the same elsewhere.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...backend import dr, from_host
from ...backend.functions import loop
from ...backend.types import Float, Int, Mask
from ...expressions import Expression
from ...expressions.interval import Interval
from ...grids.cartesian.dual_walk import WIDEST
from ...grids.cartesian.leap import BITS
from ...grids.straight_chord import trilinear
from ...media.bound import BoundMedium
from ...media.context import Context
from ...media.profiles import Shaped
from ...ranges import Numbers, Ranges, sums_in
from ..precision import plain_widths, sizes_of_coefficients
from .cells import CellEvaluator


@dataclass(frozen=True)
class Deviation:
    """Error allowed in a scalar of a part of a medium."""

    part: BoundMedium
    expr: Expression
    # Of the part's structures: the limit where they are nearly invisible.
    width: float
    # The limit where they are fully visible, as a fraction of the width.
    fraction: float

    @property
    def key(self) -> tuple[Any, ...]:
        """Return everything that bricks depend on, besides the part of the medium."""
        return (self.expr.text, self.width, self.fraction)

    def holds(self, exact: Float, approximate: list[Float], context: Context) -> Mask:
        """Return where approximate values are within the limit of the exact ones (traced).

        The limit scales with the root of the largest visibility of any of the values: this takes a
        fifth fewer steps than one limit everywhere, at the same errors (without the root they grow
        by a tenth). NaN is never within the limit.
        """
        width = context.kept_number(self.width)
        most = context.kept_number(self.width * self.fraction)
        prominence = getattr(self.part, "prominence", _everywhere)
        shown = prominence(exact, context)
        for value in approximate:
            shown = dr.maximum(shown, prominence(value, context))
        holds, root = ~dr.isnan(exact), dr.sqrt(shown)
        for value in approximate:
            off = dr.abs(value - exact)
            holds &= (off * root <= most) & (off <= width)
        return holds


def _everywhere(x: Float, context: Context) -> Float:
    return x * 0.0 + 1.0


def difference_limits(evaluator: CellEvaluator, fraction: float) -> tuple[Deviation, ...] | None:
    """Return the error allowed in every expression, or None if the medium excludes wider steps.

    Wider steps are for media that depend only on scalars with structures of known widths.
    """
    medium, grid = evaluator.medium, evaluator.grid
    if medium.looks_inside or fraction <= 0 or not grid.is_uniform:
        return None
    scalars = medium.scalars()
    used = {name for expr in scalars for name in expr.names}
    if not scalars or used != set(medium.names) or not all(n in evaluator.volume for n in used):
        return None
    limits = []
    for part, bound in zip(medium.components(), evaluator.channels.bound.parts, strict=True):
        least: dict[str, float] = {}
        for expr, width in plain_widths(evaluator.volume, part.features()):
            least[expr.text] = min(width, least.get(expr.text, np.inf))
        limits += [Deviation(bound, e, least.get(e.text, 0.0), fraction) for e in part.scalars()]
    return tuple(limits) if all(0 < limit.width < np.inf for limit in limits) else None


# The corners of a cube.
_UP = tuple(itertools.product((0, 1), repeat=3))
# Maximum optical depth of a step: within a panel the order of several shells is unknown.
_DEEPEST = 0.4
# Cubes compared at once: limits the memory of temporary arrays.
_AT_ONCE = 1 << 22
# Fraction of steps that must become wider for this to pay, since the walk itself is slower.
_WORTHWHILE = 0.1


def wide_steps(
    evaluator: CellEvaluator,
    visible: np.ndarray,
    ranges: Ranges,
    limits: tuple[Deviation, ...],
    single: bool,
) -> np.ndarray | None:
    """Return log2 of the step width allowed in each brick, or None if few may be wide.

    Expressions are evaluated in `single` precision where that is exact enough.
    """
    # The width that keeps the optical depth low enough; for a single shell with proportional j and
    # α any depth is allowed.
    most, parts = np.full(visible.shape, WIDEST, np.uint8), evaluator.medium.components()
    if len(parts) > 1 or not isinstance(parts[0], Shaped):
        channels = evaluator.channels

        def densest(bound: BoundMedium, fields: dict[str, Interval]) -> list[np.ndarray]:
            return [channels.densest(sizes_of_coefficients(bound, fields))]

        (deepest,) = sums_in(evaluator.medium, channels.bound, ranges, densest)
        most = np.sum([deepest * (1 << k) <= _DEEPEST for k in range(1, WIDEST + 1)], axis=0)
    cubes, steps = _Cubes(evaluator, limits, single), np.zeros(visible.shape, np.uint8)
    for step in range(WIDEST, 0, -1):
        left = visible & (steps == 0) & (most >= step)
        inside = _resized(left, BITS - step, np.any)
        smooth = np.zeros(inside.shape, bool)
        layers = max(1, _AT_ONCE * len(inside) // inside.size)
        for low in range(0, len(inside), layers):
            x, y, z = np.nonzero(inside[low : low + layers])
            if len(x):
                place = x + low, y, z
                first = [from_host(evaluator.backend.Int, p << step) for p in place]
                smooth[place] = np.asarray(cubes.smooth(first, 1 << step))
        smooth = _resized(smooth, step - BITS, np.all)
        steps[left & smooth[tuple(slice(n) for n in left.shape)]] = step
    return steps if np.count_nonzero(steps) > _WORTHWHILE * np.count_nonzero(visible) else None


def _resized(cubes: np.ndarray, bits: int, all_or_any: Callable[..., Any]) -> np.ndarray:
    """Return a mask of cubes 2^bits times smaller, or of larger ones by `all_or_any`."""
    if bits >= 0:
        for axis in range(3):
            cubes = np.repeat(cubes, 1 << bits, axis=axis)
        return cubes
    side = 1 << -bits
    padded = np.pad(cubes, [(0, -n % side) for n in cubes.shape])
    nx, ny, nz = (n // side for n in padded.shape)
    return np.asarray(all_or_any(padded.reshape(nx, side, ny, side, nz, side), axis=(1, 3, 5)))


class _Cubes:
    """Cubes of dual cells, one per lane.

    Rays take expressions as linear between entry into a cube and exit from it, with fields that are
    trilinear between the corners. Both approximations are compared with the exact values at all
    centres inside.
    """

    def __init__(
        self, evaluator: CellEvaluator, limits: tuple[Deviation, ...], single: bool
    ) -> None:
        self.backend, self.limits = evaluator.backend, limits
        self.real = self.backend.Float if single else self.backend.Wide
        self.context = evaluator.context(self.real)
        volume = evaluator.volume
        self.shape = volume.grid.shape
        self.data = {
            name: Numbers(volume.array(name).reshape(-1), self.backend)
            for name in evaluator.medium.names
        }

    def smooth(self, first: list[Int], side: int) -> Mask:
        """Return which cubes, given by their first dual cells, may be crossed in one step."""
        UInt, backend = self.backend.UInt, self.backend
        corners = [
            self._fields([f + side * b for f, b in zip(first, up, strict=True)]) for up in _UP
        ]
        cubes = {}
        for name in self.data:
            values = [corner[name] for corner in corners]
            cubes[name] = [[values[4 * i + 2 * j :][:2] for j in (0, 1)] for i in (0, 1)]
        exprs = {limit.expr.text: limit.expr for limit in self.limits}
        planes = {text: self._plane(expr, corners) for text, expr in exprs.items()}
        row = dr.opaque(UInt, side + 1)
        count = row * row * row

        def going_on(number: Int, good: Mask) -> Mask:
            return good & (number < count)

        def body(number: Int, good: Mask) -> tuple[Int, Mask]:
            # From the middle on, where most cubes fail that do (512³, two shells: 0.7).
            place = number + (count >> 1)
            place = dr.select(place < count, place, place - count)
            plane = backend.quotient(place, row)
            layer = backend.quotient(plane, row)
            inner = [backend.Int(i) for i in (layer, plane - layer * row, place - plane * row)]
            exact = self._fields([f + i for f, i in zip(first, inner, strict=True)])
            fraction = [self.real(i) * (1.0 / side) for i in inner]
            near = {name: trilinear(values, fraction) for name, values in cubes.items()}
            good = dr.full(backend.Bool, True, 1)
            for limit in self.limits:
                mean, *rises = planes[limit.expr.text]
                flat = mean + sum(r * (2.0 * f - 1.0) for r, f in zip(rises, fraction, strict=True))
                value, inside = (self.context.evaluate(limit.expr, f) for f in (exact, near))
                good &= limit.holds(value, [inside, flat], self.context)
            return number + 1, good

        lanes = dr.width(first[0])
        state = (dr.zeros(UInt, lanes), dr.full(backend.Bool, True, lanes))
        _, good = loop(state, going_on, body, label="coarse")
        return good

    def _fields(self, node: list[Int]) -> dict[str, Float]:
        """Return all fields at a centre; number 0 lies outside and repeats the first."""
        Int, backend = self.backend.Int, self.backend
        flat = Int(0)
        for i, n in zip(node, self.shape, strict=True):
            flat = flat * dr.opaque(Int, n) + dr.clip(i - 1, 0, dr.opaque(Int, n - 1))
        return {
            name: self.real(data.gather(backend.UInt(flat))) for name, data in self.data.items()
        }

    def _plane(self, expr: Expression, corners: list[dict[str, Float]]) -> list[Float]:
        """Return the least-squares plane through an expression's values at the corners.

        Its mean, and half its rise along each axis.
        """
        values = [self.context.evaluate(expr, corner) for corner in corners]
        rises = [
            sum(v if up[axis] else -v for v, up in zip(values, _UP, strict=True)) * 0.125
            for axis in range(3)
        ]
        return [sum(values) * 0.125, *rises]
