"""Fields interpolated along rays, and the medium evaluated on them."""

from __future__ import annotations

import copy
import math
from collections.abc import Hashable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from ...backend import dr
from ...backend.types import Float, Mask
from ...grids.cartesian.dual_walk import Chord
from ...grids.contract import Segment
from ...media.context import Context, completed
from ...media.contract import Medium
from ...media.edges import Level
from ...media.stretch import Panel, Straight, Stretch, within_limits
from ...schemes.base import Coefficients, Scheme
from ...schemes.path import Path, layer
from ..cache import Cache
from .cells import CellEvaluator, ray_coordinates
from .channel_layout import PerChannel, some_channels
from .corner_layouts import Corners, FieldLattice, get_lattices
from .empty_space import DUAL, get_blocks, get_exactness, pruned_walk, visible_leaves

# The smallest fraction of a peak that each precision represents.
_FAINTEST = {"single": 1e-37, "double": 1e-300}
# Path lengths for which a ray may follow a shell where it is faint: at least, and at most. Beyond
# the maximum the width of the faintest part of a peak no longer changes.
_SOME_PATHS, _MOST_PATHS = 10.0, 1e12
# Error due to the cubic fit on curvilinear grids, as a fraction of the tolerance; nearly all errors
# are smaller.
_LOST_BY_CUBICS = 0.1
# Error due to rounded positions, in ε (for a shell with σ = 1e-4 dex in a field of 3 dex), and its
# maximum.
_LOST_PER_EPS, _MOST_LOST = 0.1, 1e-3


@dataclass
class FieldsAlong:
    """All fields along a segment, from their values at the corners of its dual cell."""

    source: Interpolated
    chord: Chord
    corners: dict[str, Corners]

    def at(self, s: float) -> dict[str, Float]:
        """Return every field at the beginning (0) or the end (1) of the segment."""
        source, chord = self.source, self.chord
        fields = {
            name: source.in_unit(name, source.lattices[name].at(chord, c, s))
            for name, c in self.corners.items()
        }
        for a in source.coordinates:
            place = chord.position[a] + chord.step[a] if s else chord.position[a]
            fields["xyz"[a]] = source.context.real(place)
        return completed(source.context.ops, within_limits(fields, source.context), source.context)

    def polynomials(self, *, rough: bool = False) -> dict[str, list[Float]]:
        """Return every field as a polynomial of s from 0 to 1.

        Where the field is not a polynomial, it is approximated to fourth order, or to third
        (`rough`).
        """
        lattices, chord = self.source.lattices, self.chord
        fields = {
            name: lattices[name].along(chord, c, rough=rough) for name, c in self.corners.items()
        }
        for a in self.source.coordinates:
            fields["xyz"[a]] = [chord.position[a], chord.step[a]]
        return fields


class Interpolated:
    """Coefficients for schemes that interpolate fields along the ray.

    Attributes
    ----------
    numbers : PerChannel or SharedProfiles
        The integrated numbers.
    scalars : tuple of Expression
        Expressions whose values are carried from one stretch to the next.
    tolerance : tuple of arrays
        The errors of emission and transparency allowed in the first stretch of a ray, and their
        share of a pixel's error (`schemes.step_doubling.ErrorBudget`).
    neglected, neglected_depth : float
        Upper bounds of the emission and optical depth along a ray of faint places that are skipped.
    lost : float
        Relative error of a pixel due to the interpolation itself.
    smooth, quick, finer, linear : bool
        Sample means are accurate enough for some stretches, with an error estimate (single
        precision only: for linear fields panels reach double precision, samples do not); a rule
        with fewer samples exists; samples are accurate enough for parts of the other stretches;
        closed forms are best where scalars are linear.
    hollow, layered : bool
        The medium is empty between its edges; some part of it has zero width.
    steady : bool
        The source function is the same everywhere.
    """

    def __init__(
        self,
        evaluator: CellEvaluator,
        lattices: dict[str, FieldLattice],
        context: Context,
        blocks: Any,
        paths: float,
    ) -> None:
        self.lattices, self.context = lattices, context
        self.numbers, self.backend = evaluator.numbers, evaluator.backend
        self.blocks = blocks
        self.walk: Any = None  # through less than the whole grid, or in other steps
        self.walk_kind = "coarse" if blocks is not None and blocks.coarse else "dual"
        self.tolerance: tuple[Float, ...] = ()
        self.lost = 0.0
        # A ray may follow a shell over its whole length at a distance where the shell is neglected.
        most, (bright, dense) = float(np.finfo(self.backend.dtype).max), self.numbers.one_path()
        self.neglected = min(paths * context.faint * bright, 1e-3 * most)
        self.neglected_depth = min(paths * context.faint * dense, 1.0)
        self.largest = self.bounds = self.numbers.in_units(evaluator.largest)
        self.units = {
            name: context.number(lattice.unit)
            for name, lattice in lattices.items()
            if lattice.unit != 1.0
        }
        self.use(evaluator.medium)

    def use(self, medium: Medium) -> None:
        """Take a medium, and what schemes ask about it."""
        self.medium, parts = medium, medium.components()
        self.scalars, self.looks_inside = medium.scalars(), medium.looks_inside
        sampling = medium.sampling
        self.smooth = self.backend.precision == "single" and sampling.smooth
        self.quick, self.finer, self.linear = sampling.quick, sampling.finer, sampling.linear
        self.hollow, self.layered = medium.surface_only, any(part.surface_only for part in parts)
        self.steady = len(parts) == 1 and parts[0].constant_source_function
        every = "r" in medium.names or bool(self.context.coordinates)
        self.coordinates = [a for a, axis in enumerate("xyz") if axis in medium.names or every]

    def allow(self, emission: float, transparency: float, share: float) -> None:
        """Set the errors allowed in a pixel, and a segment's share; infinite ones are never
        exceeded.
        """
        o = self.backend.opaque
        most = 0.5 * float(np.finfo(self.backend.dtype).max)
        allowed = (min(share * error, most) for error in (emission, transparency))
        self.tolerance = (*map(o, allowed), o(share))

    def recording(self) -> AbstractContextManager[None]:
        """Return a context in which a panel is solved: nothing, but where it is differentiated."""
        return nullcontext()

    def accept(self, front: Path, panel: Path, where: Mask) -> None:
        """Take note of a panel that is accepted, and of the part of its segment in front of it."""

    def block(self, channels: slice) -> Interpolated:
        """Return the source of some of the channels; it shares fields and all that is skipped."""
        part = copy.copy(self)
        part.numbers = cast(PerChannel, self.numbers).block(channels)
        part.context = replace(self.context, radiance=part.numbers.radiance, _kept={})
        part.largest = part.bounds = some_channels(self.numbers, self.largest, channels)
        part.use(part.numbers.medium)
        return part

    def along(self, segment: Segment) -> FieldsAlong:
        """Return the fields around the dual cell of a segment."""
        chord, active = segment.walk.chord(segment.track, segment), segment.active
        corners = {name: lattice.corners(chord, active) for name, lattice in self.lattices.items()}
        return FieldsAlong(self, chord, corners)

    def stretch(
        self, cubics: dict[str, list[Float]], length: Float, *, rough: bool = False
    ) -> Stretch:
        """Return a stretch of ray, with fields in the type that expressions are evaluated in."""
        return Stretch(self._in_units(cubics), self.context, length, rough=rough)

    def straight(self, cubics: dict[str, list[Float]], length: Float) -> Straight:
        """Return the same stretch with scalars taken as linear."""
        return Straight(self._in_units(cubics), self.context, length)

    def _in_units(self, cubics: dict[str, list[Float]]) -> dict[str, list[Float]]:
        return {name: [self.in_unit(name, v) for v in c] for name, c in cubics.items()}

    def in_unit(self, name: str, value: Float) -> Float:
        """Return a value of a lattice in the field's unit."""
        value = self.context.real(value)
        return value * self.units[name] if name in self.units else value

    def means(self, panel: Panel) -> Coefficients:
        """Return mean j and α over a panel, per length of the grid's scale."""
        j, alpha = self.numbers.split(self.numbers.means(panel, self.context))
        # Unphysical values become NaN and reach the picture, which is checked afterwards.
        return j, [dr.select(a >= 0.0, a, math.nan) for a in alpha]

    def sampled(self, stretch: Stretch, *, fine: bool) -> list[Coefficients]:
        """Return mean, first and last j and α of a stretch, and the errors of the means."""
        samples = self.numbers.sampled(stretch, self.context, fine=fine)
        return [self.numbers.split(values) for values in samples]

    @property
    def edges(self) -> list[Level]:
        """Where the medium is discontinuous."""
        return self.medium.discontinuities(self.context)

    def layer(self, stretch: Stretch, place: Float) -> Path:
        """Return the parts of zero width that a stretch crosses, evaluated at a place."""
        sheet = self.medium.layer(stretch, self.context, place)
        assert sheet is not None  # `layered`
        return layer(*self.numbers.split(sheet.listed()))


def interpolated_fields(
    evaluator: CellEvaluator,
    cache: Cache,
    scheme: Scheme,
    tolerance: float,
    faintest: bool,
    whole: bool,
) -> Interpolated:
    """Return the medium on interpolated fields; their lattices are cached with the volume.

    Parameters
    ----------
    faintest : bool
        Whether to neglect only what the precision cannot represent.
    whole : bool
        No cells are hidden.
    """
    volume, backend, medium = evaluator.volume, evaluator.backend, evaluator.medium
    grid, numbers, statistics = volume.grid, evaluator.numbers, evaluator.statistics

    def key(*parts: Any) -> Hashable:
        unknown = parts[1] is None
        return None if unknown else (*parts, cache.statistics.digests(medium.names))

    single, contrast = get_exactness(evaluator, cache)
    largest = evaluator.largest
    numbers.normalise(evaluator.sizes)
    # In thick shells even the tails are dense: the neglected part is measured in optical depth per
    # cell.
    faint = min(0.01 * tolerance, 1e-3) / max(1.0, 10.0 * float(numbers.densest(largest)))
    # Without error control the neglected part is not reported. Else a ray may follow a shell all
    # the way across.
    paths = _SOME_PATHS
    if scheme.controlled:
        diagonal = float(np.linalg.norm(np.ptp(grid.bounds, axis=1))) / grid.scale
        paths = float(np.clip(numbers.paths(largest) * diagonal, _SOME_PATHS, _MOST_PATHS))
    least = _FAINTEST[backend.precision]
    faint = least if faintest else max(faint * (_SOME_PATHS / paths), least)
    real = backend.Float if single else backend.Wide
    extremes = {n: statistics.extremes(n) for n in medium.names if n in volume}
    context = replace(
        evaluator.context(real, evaluator.tape),
        narrow=backend.Float,
        scale=grid.scale,
        radiance=numbers.radiance,
        limits={n: tuple(dr.opaque(real, end) for end in ends) for n, ends in extremes.items()},
        faint=faint,
        tolerance=tolerance,
        coordinates=ray_coordinates(volume, medium.names),
    )
    blocks = get_blocks(evaluator, cache, faint, DUAL, scheme.coarseness if whole else 0.0)
    lattices = get_lattices(evaluator, cache, blocks)
    source = Interpolated(evaluator, lattices, context, blocks, paths)
    if whole and grid.can_be_pruned and all(name in volume for name in medium.names):

        def prune() -> Any:
            return pruned_walk(grid, visible_leaves(evaluator, lattices, faint), backend, "dual")

        source.walk = cache.get_or_make(key("pruned", medium.visible_key(), faint, backend), prune)
    if scheme.controlled:
        # Scalars have an error relative to their range, which matters where a ray grazes a shell.
        eps = float(np.finfo(backend.dtype).eps)
        source.lost = min(_LOST_PER_EPS * eps * contrast, _MOST_LOST)
        walk = source.walk or grid.walk(backend, source.walk_kind)
        if walk.approximate:  # fields along a segment are not polynomials themselves
            source.walk = walk.kept_to(tolerance / contrast)
            source.lost += _LOST_BY_CUBICS * tolerance
    return source
