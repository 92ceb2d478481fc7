"""Fields interpolated along rays, and the medium evaluated on them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...backend import Backend, dr
from ...backend.types import Float
from ...expressions import Expression
from ...grids.cartesian.dual_walk import Chord
from ...grids.contract import Segment
from ...media.context import Context
from ...media.edges import Level
from ...media.stretch import Panel, Straight, Stretch, with_coordinates, within_limits
from ...schemes.base import Scheme
from ...schemes.path import Path, layer
from ..cache import Cache
from ..precision import Exactness, exactness
from .cells import CellEvaluator, ray_coordinates
from .corner_layouts import Corners, get_lattices
from .empty_space import DUAL, can_be_pruned, get_blocks, interpolated, pruned_walk


@dataclass
class FieldsAlong:
    """All fields along a segment, from their values at the corners of its dual cell."""

    source: Interpolated
    chord: Chord
    corners: dict[str, Corners]

    def at_begin(self) -> dict[str, Float]:
        return self.source.values(self.chord, self.corners, 0.0)

    def at_end(self) -> dict[str, Float]:
        return self.source.values(self.chord, self.corners, 1.0)

    def polynomials(self, *, rough: bool = False) -> dict[str, list[Float]]:
        """Return every field as a polynomial of s from 0 to 1; see `Interpolated.cubics`."""
        return self.source.cubics(self.chord, self.corners, rough=rough)


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
    """

    def __init__(
        self,
        evaluator: CellEvaluator,
        lattices: dict[str, Any],
        context: Context,
        blocks: Any,
        paths: float,
    ) -> None:
        self.evaluator, self.lattices, self.context = evaluator, lattices, context
        self.numbers, self.backend = evaluator.numbers, evaluator.backend
        self.blocks = blocks
        self.walk: Any = None  # through less than the whole grid, or in other steps
        self.walk_kind = "coarse" if blocks is not None and blocks.coarse else "dual"
        self.tolerance: tuple[Any, ...] = ()
        self.lost = 0.0
        # A ray may follow a shell over its whole length at a distance where the shell is neglected.
        most = 1e-3 * float(np.finfo(self.backend.dtype).max)
        self.neglected = min(paths * context.faint * self.numbers.one_path(), most)
        self.neglected_depth = min(paths * context.faint * self.numbers.one_depth(), 1.0)
        self.largest = self.bounds = self.numbers.in_units(evaluator.largest())
        self.looks_inside = evaluator.medium.looks_inside
        self.scalars: tuple[Expression, ...] = evaluator.medium.scalars()
        self.units = {
            name: context.number(lattice.unit)
            for name, lattice in lattices.items()
            if lattice.unit != 1.0
        }
        names = evaluator.medium.names
        every = "r" in names or bool(context.coordinates)
        self.coordinates = [a for a, axis in enumerate("xyz") if axis in names or every]

    def allow(self, emission: float, transparency: float, share: float) -> None:
        """Set the errors allowed in a pixel, and a segment's share; infinite ones are never
        exceeded.
        """
        o = self.backend.opaque
        most = 0.5 * float(np.finfo(self.backend.dtype).max)
        allowed = (min(share * error, most) for error in (emission, transparency))
        self.tolerance = (*map(o, allowed), o(share))

    def inputs(self) -> Any:
        return self.lattices, self.units, self.context.limits, self.tolerance, self.numbers.inputs()

    def along(self, segment: Segment) -> FieldsAlong:
        """Return the fields around the dual cell of a segment."""
        chord = segment.walk.chord(segment.track, segment)
        active = segment.active
        corners = {name: lattice.corners(chord, active) for name, lattice in self.lattices.items()}
        return FieldsAlong(self, chord, corners)

    def values(self, chord: Chord, corners: dict[str, Corners], s: float) -> dict[str, Any]:
        """Return every field at the beginning (0) or the end (1) of a segment."""
        found = {
            name: self._value(name, self.lattices[name].at(chord, c, s))
            for name, c in corners.items()
        }
        for a in self.coordinates:
            here = chord.position[a] + chord.step[a] if s else chord.position[a]
            found["xyz"[a]] = self.context.real(here)
        return with_coordinates(within_limits(found, self.context), self.context)

    def cubics(
        self, chord: Chord, corners: dict[str, Corners], *, rough: bool = False
    ) -> dict[str, list[Float]]:
        """Return every field along a segment, as a polynomial of s from 0 to 1.

        Where the field is not a polynomial, it is approximated to fourth order, or to third
        (`rough`).
        """
        found = {
            name: self.lattices[name].along(chord, c, rough=rough) for name, c in corners.items()
        }
        for a in self.coordinates:
            found["xyz"[a]] = [chord.position[a], chord.step[a]]
        return found

    def stretch(
        self, cubics: dict[str, list[Float]], length: Float, *, rough: bool = False
    ) -> Stretch:
        """Return a stretch of ray, with fields in the type that expressions are evaluated in."""
        return Stretch(self._own(cubics), self.context, length, rough=rough)

    def straight(self, cubics: dict[str, list[Float]], length: Float) -> Straight:
        """Return the same stretch with scalars taken as linear."""
        return Straight(self._own(cubics), self.context, length)

    def _own(self, cubics: dict[str, list[Float]]) -> dict[str, list[Float]]:
        return {name: [self._value(name, v) for v in c] for name, c in cubics.items()}

    def _value(self, name: str, value: Float) -> Any:
        value = self.context.real(value)
        return value * self.units[name] if name in self.units else value

    def means(self, panel: Panel) -> tuple[list[Any], list[Any]]:
        """Return mean j and α over a panel, per length of the grid's scale."""
        j, alpha = self.numbers.split(self.numbers.means(panel, self.context))
        # Unphysical values become NaN and reach the picture, which is checked afterwards.
        return j, [dr.select(a >= 0.0, a, math.nan) for a in alpha]

    @property
    def smooth(self) -> bool:
        """Whether sample means are accurate enough for some stretches, with an error estimate.

        Single precision only: for linear fields panels reach double precision, samples do not.
        """
        return self.backend.precision == "single" and self.evaluator.medium.sampling.smooth

    @property
    def edges(self) -> list[Level]:
        """Where the medium is discontinuous."""
        return self.evaluator.medium.discontinuities(self.context)

    @property
    def linear(self) -> bool:
        """Whether closed forms are best where scalars are linear."""
        return self.evaluator.medium.sampling.linear

    @property
    def hollow(self) -> bool:
        """Whether the medium is empty between its edges."""
        return self.evaluator.medium.surface_only

    @property
    def layered(self) -> bool:
        """Whether some part of the medium has zero width."""
        return any(part.surface_only for part in self.evaluator.medium.components())

    def layer(self, stretch: Stretch, place: Float) -> Path:
        """Return the parts of zero width that a stretch crosses, evaluated at a place."""
        found = self.evaluator.medium.layer(stretch, self.context, place)
        assert found is not None  # `layered`
        return layer(*self.numbers.split(found.listed()))

    @property
    def quick(self) -> bool:
        """Whether a rule with fewer samples exists."""
        return self.evaluator.medium.sampling.quick

    @property
    def finer(self) -> bool:
        """Whether samples are accurate enough for parts of the other stretches."""
        return self.evaluator.medium.sampling.finer

    def sampled(self, stretch: Stretch, *, fine: bool) -> list[tuple[list[Any], list[Any]]]:
        """Return mean, first and last j and α of a stretch, and the errors of the means."""
        found = self.numbers.sampled(stretch, self.context, fine=fine)
        return [self.numbers.split(own) for own in found]

    def cores(self, stretch: Stretch) -> list[list[Any]]:
        """Return the number of structures in each half of a stretch, for each part of a sum."""
        return [part.cores(stretch, self.context) for part in self.evaluator.medium.components()]

    def shares(self, path: Path, panel: Panel) -> list[tuple[Any, Any]]:
        """Return the brightness and the optical depth of each part of a sum on a solved panel."""
        return self.numbers.shares(path, panel, self.context)

    @property
    def steady(self) -> bool:
        """Whether the source function is the same everywhere."""
        parts = self.evaluator.medium.components()
        return len(parts) == 1 and parts[0].constant_source_function

    def sharpness(self, stretch: Stretch) -> tuple[Any, Any]:
        """Return how thin the medium's structures are, and the error of means due to curvature."""
        return self.evaluator.medium.sharpness(stretch, self.context)

    def visible(self, stretch: Stretch) -> tuple[Any, Any]:
        """Return where the medium may be noticeable, and where panels may miss that."""
        return self.evaluator.medium.visible(stretch, self.context)


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


def interpolated_fields(
    evaluator: CellEvaluator,
    cache: Cache,
    scheme: Scheme,
    tolerance: float,
    faintest: bool,
    whole: bool,
) -> Interpolated:
    """Return the medium on interpolated fields; their lattices are cached with the volume."""
    volume, backend = evaluator.volume, evaluator.backend
    needed = _remember(evaluator, cache)
    evaluator.numbers.normalise(evaluator.largest())
    # In thick shells even the tails are dense: the neglected part is measured in optical depth per
    # cell.
    dense = float(evaluator.numbers.densest(evaluator.largest()))
    faint = min(0.01 * tolerance, 1e-3) / max(1.0, 10.0 * dense)
    # Without error control the neglected part is not reported.
    paths = _path_lengths(evaluator) if scheme.controlled else _SOME_PATHS
    faint *= _SOME_PATHS / paths
    least = _FAINTEST[backend.precision]
    faint = least if faintest else max(faint, least)
    real = backend.Float if needed.single else backend.Wide
    context = replace(
        evaluator.context(real),
        narrow=backend.Float,
        scale=volume.grid.scale,
        radiance=evaluator.numbers.unit,
        limits=_limits(evaluator, real),
        faint=faint,
        tolerance=tolerance,
        coordinates=ray_coordinates(volume, evaluator.medium.names),
    )
    blocks = get_blocks(evaluator, cache, faint, DUAL, scheme.coarseness if whole else 0.0)
    lattices = get_lattices(evaluator, cache, blocks)
    source = Interpolated(evaluator, lattices, context, blocks, paths)
    if whole:
        source.walk = _pruned(evaluator, cache, lattices, faint)
    if scheme.controlled:
        source.lost = _lost_by_places(backend, needed.contrast)
        _keep_walk(source, tolerance, needed.contrast)
    return source


def _lost_by_places(backend: Backend, contrast: float) -> float:
    """Return the relative error of a pixel due to rounded positions.

    Scalars have this error relative to their range, which matters where a ray grazes a shell.
    """
    return min(_LOST_PER_EPS * float(np.finfo(backend.dtype).eps) * contrast, _MOST_LOST)


def _keep_walk(source: Interpolated, tolerance: float, contrast: float) -> None:
    """Use accurate polynomials where fields along a segment are not polynomials themselves."""
    walk = source.walk or source.evaluator.grid.walk(source.backend, source.walk_kind)
    if walk.approximate:
        source.walk = walk.kept_to(tolerance / contrast)
        source.lost += _LOST_BY_CUBICS * tolerance


def _path_lengths(evaluator: CellEvaluator) -> float:
    """Return the number of path lengths a ray may follow a shell: some, or all the way across."""
    grid, largest = evaluator.grid, evaluator.largest()
    diagonal = float(np.linalg.norm(np.ptp(grid.bounds, axis=1))) / grid.scale
    return float(np.clip(evaluator.numbers.paths(largest) * diagonal, _SOME_PATHS, _MOST_PATHS))


def _pruned(evaluator: CellEvaluator, cache: Cache, lattices: dict[str, Any], faint: float) -> Any:
    """Return the walk through the leaves that may be visible, or None; cached."""
    medium, backend = evaluator.medium, evaluator.backend
    if not can_be_pruned(evaluator):
        return None

    def make() -> Any:
        visible = interpolated(evaluator, lattices, faint)
        return pruned_walk(evaluator.grid, visible, backend, "dual")

    own = medium.visible_key()
    if own is None:
        return make()
    return cache.get_or_make(
        ("pruned", own, faint, cache.statistics.digests(medium.names), backend), make
    )


def _remember(evaluator: CellEvaluator, cache: Cache) -> Exactness:
    """Restore the cached results for the same medium, and return the precision it needs."""
    own = evaluator.medium.key()

    def make() -> tuple[list[float], Exactness]:
        return evaluator.largest(), exactness(evaluator.volume, evaluator.medium)

    if own is None:
        return make()[1]
    # The numbers of shapes differ from those of all their colours.
    kind = type(evaluator.numbers).__name__
    key = ("numbers", kind, own, cache.statistics.digests(evaluator.medium.names))
    found: tuple[list[float], Exactness] = cache.get_or_make(key, make)
    evaluator.expect(found[0])
    return found[1]


def _limits(evaluator: CellEvaluator, real: Any) -> dict[str, tuple[Any, Any]]:
    """Return the least and largest values of all fields, as kernel numbers."""
    volume = evaluator.volume
    extremes = {n: evaluator.statistics.extremes(n) for n in evaluator.medium.names if n in volume}
    return {
        name: (dr.opaque(real, low), dr.opaque(real, high))
        for name, (low, high) in extremes.items()
    }
