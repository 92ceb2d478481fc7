"""Input of the guaranteed bounds: enclosures of the interpolated fields on panels."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from ..backend import dr
from ..backend.types import Float, Mask
from ..expressions.interval import Interval
from ..expressions.traced_interval import TracedInterval, extremes
from ..geometry import CARTESIAN
from ..grids.cartesian.grid import CartesianGrid
from ..grids.contract import Segment
from ..media.bound import Binding, BoundMedium
from ..media.contract import Medium
from ..media.ranges import RangeContext, largest
from ..ranges import DUAL, Ranges, most_in
from ..rendering.cache import Cache
from ..rendering.sources.cells import CellEvaluator, ray_coordinates
from ..rendering.sources.corner_layouts import get_lattices
from ..rendering.sources.empty_space import get_ranges, worthwhile_bricks
from ..schemes.base import Skipping
from ..schemes.channels import Channels, Tolerance
from .curved import CurvedField
from .enclosure import CubicSegment, EnclosedPanel, EnclosureContext, PanelBounds
from .enclosure import Segment as EnclosedSegment

if TYPE_CHECKING:
    from ..backend.device import Backend
    from ..grids.cartesian.dual_walk import Chord
    from ..grids.cartesian.leap import Bricks
    from ..schemes.base import Scheme
    from ..volume import Volume

_EPS = float(np.finfo(np.float64).eps)
# Rounding error of control points computed from the coefficients of a polynomial, in ε.
_LOSS = 64.0
# Rounding error of the place of a ray in a cell, in ε times the number of cells.
_LOSS_OF_PLACE = 16.0
# Coefficients below this fraction of the relevant size are neglected; the error includes a bound of
# them.
_FAINT = 1e-6
# Shells below this fraction of their peak are ignored: less than any rounding error.
_NOTHING = 1e-300


class EndsOfChannels(Channels):
    """The bounds of every channel, all drawn together."""

    def __init__(self, channels: Channels, each: int) -> None:
        super().__init__(channels.medium, channels.binding)
        self.count, self.spectral = self.emissions, False
        self.emissions = self.extinctions = each * self.count

    def groups(self, scheme: Scheme) -> list[slice]:
        return [slice(0, self.emissions)]


@dataclass
class Enclosed:
    """A field along a segment: a cubic, the bound of its error, and the limits of its values."""

    cubic: list[Float]
    slack: Float
    low: Float
    high: Float

    def on_panel(self, begin: Float, width: Float) -> CubicSegment:
        """Return the field on a panel of the segment."""
        c = moved(self.cubic, begin, width)
        inner = [control_point(c, k) for k in (1, 2)]
        return CubicSegment([c[0], *inner, sum(c[1:], c[0])], self.slack, self.low, self.high)


Fields: TypeAlias = "dict[str, Enclosed | CurvedField]"


class Bracketed:
    """Source of the coefficients for the scheme of guaranteed bounds.

    `signed`: the emissivity may be negative. `neglected`: bounds of the emission and absorption of
    skipped space. `tolerance`: largest widths of brackets per panel; set by the tracer.
    """

    def __init__(
        self,
        volume: Volume,
        medium: Medium,
        backend: Backend,
        tolerance: float,
        channels: slice = slice(None),
    ) -> None:
        bound = Channels(medium, replace(Binding.to(volume), channels=channels))
        evaluator, cache = CellEvaluator(volume, medium, backend).using(bound), Cache(volume)
        self.medium, self.backend, grid = bound.bound, backend, volume.grid
        self.lattices, ranges = get_lattices(evaluator, cache), get_ranges(evaluator, cache, DUAL)
        parts = zip(medium.components(), self.medium.parts, strict=True)
        self.signed = not all(_not_negative(*part, ranges) for part in parts)
        self.channels: Channels = EndsOfChannels(bound, 4 if self.signed else 2)
        opaque = backend.opaque
        self.context = EnclosureContext(backend.Float, opaque)
        self.scale = opaque(grid.scale)
        self.curved = tuple(grid.coordinates) != CARTESIAN
        cells = 1.0 / grid.resolution
        self._place = opaque(_LOSS_OF_PLACE * _EPS * cells)
        names = medium.names
        self.context.coordinates = ray_coordinates(volume, names)
        every = "r" in names or bool(self.context.coordinates)
        self.coordinates = [a for a, axis in enumerate("xyz") if axis in names or every]
        self.tolerance: Tolerance
        bricks, self.neglected = empty_bricks(evaluator, ranges, tolerance)
        self.skipping = Skipping(bricks)

    def along(self, segment: Segment) -> Fields:
        """Return every field along a segment."""
        chord, active = segment.walk.chord(segment.track, segment), segment.active
        found: Fields = {
            name: self._enclosed(lattice.corners(chord, active), chord)
            for name, lattice in self.lattices.items()
        }
        for a in self.coordinates:
            start, step = chord.position[a], chord.step[a]
            zero = type(start)(0)
            slack = _LOSS * _EPS * (dr.abs(start) + dr.abs(step))
            found["xyz"[a]] = Enclosed([start, step, zero, zero], slack, -dr.inf, dr.inf)
        return found

    def _enclosed(self, corners: Any, chord: Chord) -> Enclosed | CurvedField:
        if self.curved:
            return CurvedField(chord, corners, 3.0 * self._place, self.context.plain)
        cubic = chord.cubic(corners)
        low, high = extremes([v for face in corners for edge in face for v in edge])
        size = sum((dr.abs(c) for c in cubic[1:]), dr.abs(cubic[0]))
        unknown = dr.isnan(size)
        slack = _LOSS * _EPS * size + 3.0 * self._place * (high - low)
        return Enclosed(
            cubic, slack, dr.select(unknown, dr.nan, low), dr.select(unknown, dr.nan, high)
        )

    def unknown(self) -> list[Float]:
        """Return the placeholder of `ends` for unknown values."""
        count = 2 * len(self.lattices) if self.curved else 0
        return [self.backend.Float(math.nan) for _ in range(count)]

    def ends(self, cubics: Fields) -> list[Float]:
        """Return bounds of the fields at the end of a segment, if they may jump there."""
        found = [field.end(1.0) for field in _curved(cubics)]
        return [end for value in found for end in (value.lo, value.hi)]

    def jumps(self, cubics: Fields, before: list[Float]) -> Mask:
        """Return where fields jump from `before` to their values at the start of a segment.

        They do at the axis of a curvilinear grid, where the azimuth changes.
        """
        found = self.backend.Bool(False)
        ends = zip(before[::2], before[1::2], strict=True)
        for field, (low, high) in zip(_curved(cubics), ends, strict=True):
            field.before, start = TracedInterval(low, high), field.end(0.0)
            found |= (field.before.hi < start.lo) | (start.hi < field.before.lo)
        return found

    def panel(self, cubics: Fields, length: Float, begin: Float, width: Float) -> EnclosedPanel:
        """Return the enclosures of all scalars on a panel of a segment.

        A panel that begins before the segment is the jump to it, of length zero.
        """
        if self.curved:
            jump = begin < 0.0
            begin, width = dr.select(jump, 0.0, begin), dr.select(jump, 0.0, width)
        segments: dict[str, EnclosedSegment] = {}
        for name, field in cubics.items():
            if isinstance(field, CurvedField):
                segments[name] = field.on_panel(begin, width).after(field.before, jump)
            else:
                segments[name] = field.on_panel(begin, width)
        return EnclosedPanel(segments, length * width * self.scale, self.context)

    def components(self, panel: EnclosedPanel) -> list[PanelBounds]:
        """Return guaranteed bounds of the medium's components on a panel."""
        self.context.panel = panel
        return self.medium.panel_bounds(panel, self.context)


def _curved(fields: Fields) -> list[CurvedField]:
    return [field for field in fields.values() if isinstance(field, CurvedField)]


def _not_negative(part: Medium, bound: BoundMedium, ranges: Ranges) -> bool:
    peak = part.peak()
    if peak is not None:
        return peak[0] >= 0.0

    def negative(fields: dict[str, Interval]) -> list[np.ndarray]:
        found = bound.coefficients(fields, RangeContext())
        return [functools.reduce(np.logical_or, (~(j.lo >= 0.0) for j in found.emissivity))]

    return not np.any(most_in({name: ranges[name] for name in part.names}, negative)[0])


@dataclass
class Neglected:
    """Bounds of the emission per channel and the optical depth that skipping neglects."""

    emission: np.ndarray
    depth: float


def empty_bricks(
    evaluator: CellEvaluator, ranges: Ranges, tolerance: float
) -> tuple[Bricks | None, Neglected]:
    """Return bricks to skip (None if few are empty), and bounds of the neglected coefficients."""
    grid, channels = evaluator.grid, evaluator.channels.emissions
    nothing = Neglected(np.zeros(channels), 0.0)
    if not isinstance(grid, CartesianGrid):
        return None, nothing
    shape = DUAL.shape(grid.shape)
    emission, depth = np.zeros((channels, *shape)), np.zeros(shape)
    parts = zip(evaluator.medium.components(), evaluator.channels.bound.parts, strict=True)
    with np.errstate(all="ignore"):
        for part, bound in parts:

            def most(fields: dict[str, Interval], bound: BoundMedium = bound) -> list[np.ndarray]:
                return largest(bound, fields, _NOTHING).listed()

            found = most_in({name: ranges[name] for name in part.names}, most)
            j, alpha = (
                np.array([np.broadcast_to(row, shape) for row in rows])
                for rows in (found[:channels], found[channels:])
            )
            emission, depth = emission + j, depth + alpha.max(axis=0)
    diagonal = float(np.linalg.norm(np.ptp(grid.bounds, axis=1)))
    bright = np.where(np.isfinite(emission), emission, 0.0).max()
    # The brightest pixel may be much fainter than a path across the volume at its brightest place.
    visible = (emission.max(axis=0) > _FAINT**2 * tolerance * bright) | (
        depth * diagonal > _FAINT * tolerance
    )
    bricks = worthwhile_bricks(visible, evaluator.backend, DUAL)
    if bricks is None:
        return None, nothing
    missed = np.where(visible, 0.0, emission).max(axis=(1, 2, 3)) * diagonal
    return bricks, Neglected(missed, float(np.where(visible, 0.0, depth).max() * diagonal))


def control_point(cubic: Sequence[Any], number: int) -> Float:
    """Return a Bézier control point of a polynomial of at most third degree.

    It is the coefficient of the Bernstein polynomial `number` of degree 3: Σ c_k C(n, k) / C(3, k).
    """
    ratios = {1: (1.0, 1 / 3), 2: (1.0, 2 / 3, 1 / 3)}[number]
    total = cubic[0]
    for c, ratio in zip(cubic[1:], ratios[1:], strict=False):
        total = dr.fma(c, ratio, total)
    return total


def moved(cubic: Sequence[Any], start: Float, width: Float) -> list[Float]:
    """Return the coefficients of p(start + width s) (Horner's rule for all derivatives)."""
    shifted = list(cubic)
    count = len(shifted)
    for first in range(count - 1):
        for k in range(count - 2, first - 1, -1):
            shifted[k] = dr.fma(shifted[k + 1], start, shifted[k])
    power = width
    for k in range(1, count):
        shifted[k] = shifted[k] * power
        power = power * width
    return shifted
