"""Fields interpolated along rays, and the medium evaluated on them."""

from __future__ import annotations

import copy
import math
from collections.abc import Hashable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from ...backend import dr
from ...backend.types import Float, Mask
from ...grids.contract import Segment
from ...grids.straight_chord import trilinear
from ...grids.trees.octree import OctreeGrid
from ...media.context import Context, completed
from ...media.contract import Medium
from ...media.jumps import Jump
from ...media.panel import Panel, Straight, may_turn, within_limits
from ...schemes.base import Coefficients, Scheme
from ...schemes.path import Path, layer
from ..cache import Cache
from .cells import CellEvaluator, along_sight, ray_coordinates
from .channel_layout import PerChannel, some_channels
from .corner_layouts import (
    KEEPS_SUMS,
    Corners,
    FieldLattice,
    get_lattices,
    lattices_of_leaves,
    make_nodes,
)
from .empty_space import DUAL, get_bricks, get_exactness, pruned_walk, visible_leaves

if TYPE_CHECKING:
    from ...grids.trees.ghosts import LeavesWithGhosts

# The smallest fraction of a peak that each precision represents.
_FAINTEST = {"single": 1e-37, "double": 1e-300}
# Path lengths for which a ray may follow a shell where it is faint: at least, and at most. Beyond
# the maximum the width of the faintest part of a peak no longer changes.
_SOME_PATHS, _MOST_PATHS = 10.0, 1e12
# Error due to rounded positions, in ε (for a shell with σ = 1e-4 dex in a field of 3 dex), and its
# maximum.
_LOST_PER_EPS, _MOST_LOST = 0.1, 1e-3


class FieldsAlong:
    """All fields along a segment; what is asked for is computed where it is asked for."""

    def __init__(self, source: Interpolated, chord: Any, segment: Segment) -> None:
        self.source, self.chord, self.active = source, chord, segment.active
        ray, self.continuous = segment.ray, segment.walk.continuous
        self.sight: list[Float] = []  # away from the observer
        if source.medium.sight and ray is not None:
            self.sight = list(ray.direction)
        # In a cube of cells each place has its own corners.
        self.one_cell = chord.width is None
        self.corners = self._corners(chord) if self.one_cell else {}

    def _corners(self, cell: Any) -> dict[str, Corners]:
        lattices = self.source.lattices
        return {name: lattice.corners(cell, self.active) for name, lattice in lattices.items()}

    def own(self, s: Float) -> dict[str, Float]:
        """Return every field, and coordinate, that the medium uses at a place from 0 to 1."""
        source, chord = self.source, self.chord
        cell, place = chord.at(s)
        corners = self.corners if self.one_cell else self._corners(cell)
        fields = {name: source.in_unit(name, trilinear(c, place)) for name, c in corners.items()}
        for a in source.coordinates:
            fields["xyz"[a]] = source.context.real(dr.fma(s, chord.step[a], chord.position[a]))
        if self.sight:
            place = [dr.fma(s, d, o) for o, d in zip(chord.position, chord.step, strict=True)]
            found = along_sight(source.medium.sight, self.sight, place, source.mirror)
            fields |= {name: source.context.real(value) for name, value in found.items()}
        return within_limits(fields, source.context)

    def at(self, s: Float) -> dict[str, Float]:
        """Return the same, and the coordinates that follow from x, y and z."""
        return self.source.completed(self.own(s))

    @property
    def many(self) -> Mask:
        """Where the segment is a step through many cells."""
        if self.one_cell:
            return self.source.backend.Bool(False)
        return self.chord.width > 1.0

    @property
    def ahead(self) -> list[Float] | None:
        """From its beginning to its end, if the medium uses coordinates."""
        real = self.source.context.real
        return [real(d) for d in self.chord.step] if len(self.source.coordinates) == 3 else None


class Interpolated:
    """Coefficients for schemes that interpolate fields along the ray.

    Attributes
    ----------
    numbers : PerChannel or SharedProfiles
        The integrated numbers.
    scalars : tuple of Expression
        Expressions whose values are carried from one panel to the next.
    tolerance : pair of arrays
        The errors of emission and transparency that are allowed in a segment, as seen.
    neglected, neglected_depth : float
        Upper bounds of the emission and optical depth along a ray of faint places that are skipped.
    lost : float
        Relative error of a pixel due to the interpolation itself.
    surface_only, layered : bool
        The medium is empty between its surfaces; some part of it has zero width.
    constant_source_function : bool
        The source function is the same everywhere.
    constant_source_functions : list of bool
        That of each part is.
    """

    def __init__(
        self,
        evaluator: CellEvaluator,
        lattices: dict[str, FieldLattice],
        context: Context,
        bricks: Any,
        paths: float,
    ) -> None:
        self.lattices, self.context = lattices, context
        self.numbers, self.backend = evaluator.numbers, evaluator.backend
        self.bricks, self.mirror = bricks, evaluator.grid.mirror
        self.walk: Any = None  # through less than the whole grid, or in other steps
        self.walk_kind = "coarse" if bricks is not None and bricks.coarse else "dual"
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
        self.medium, parts, self.bound = medium, medium.components(), self.numbers.bound
        self.scalars = medium.scalars()
        # Whether panels need fields: of others the scalars at their places are enough.
        turning = any(may_turn(expr, self.context) for expr in self.scalars)
        self.looks_inside = medium.looks_inside or bool(self.jumps) or turning
        self.surface_only, self.layered = (
            medium.surface_only,
            any(part.surface_only for part in parts),
        )
        self.constant_source_functions = [part.constant_source_function for part in parts]
        self.constant_source_function = self.constant_source_functions == [True]
        every = "r" in medium.names or bool(self.context.coordinates)
        self.coordinates = [a for a, axis in enumerate("xyz") if axis in medium.names or every]

    def allow(self, emission: float, transparency: float, share: float) -> None:
        """Set the errors allowed in a pixel, and a segment's share; infinite ones are never
        exceeded.
        """
        o = self.backend.opaque
        most = 0.5 * float(np.finfo(self.backend.dtype).max)
        allowed = (min(share * error, most) for error in (emission, transparency))
        self.tolerance = tuple(map(o, allowed))

    def recording(self) -> AbstractContextManager[None]:
        """Return a context in which a panel is solved: nothing, but where it is differentiated."""
        return nullcontext()

    def accept(self, front: Path, panel: Path, where: Mask) -> None:
        """Take note of a panel that is accepted, and of the part of its segment in front of it."""

    def within(self, padded: dict[str, np.ndarray]) -> Interpolated:
        """Return the source in a box of cells, given these and one layer more on the low sides.

        Around them is a rim of one layer, which repeats the outermost ones. Each value is kept
        once: to make quads takes longer than they save (512³, 800² rays: 9.6 s instead of 6.1).
        """
        part = copy.copy(self)
        part.lattices = {
            name: make_nodes(padded[name], self.backend, lattice.unit)
            for name, lattice in self.lattices.items()
        }
        return part

    def within_leaves(
        self, leaves: LeavesWithGhosts, fields: dict[str, np.ndarray]
    ) -> Interpolated:
        """Return the source in some leaves of a tree, given their values and those of ghosts."""
        part, units = copy.copy(self), [lattice.unit for lattice in self.lattices.values()]
        arrays = [fields[name] for name in self.lattices]
        sums = [name.startswith(KEEPS_SUMS) for name in self.lattices]
        made = lattices_of_leaves(leaves, arrays, units, self.backend, sums)
        part.lattices = dict(zip(self.lattices, made, strict=True))
        return part

    def group(self, channels: slice) -> Interpolated:
        """Return the source of some of the channels; it shares fields and all that is skipped."""
        part = copy.copy(self)
        part.numbers = cast(PerChannel, self.numbers).group(channels)
        part.context = replace(self.context, _kept={})
        part.largest = part.bounds = some_channels(self.numbers, self.largest, channels)
        part.use(part.numbers.medium)
        return part

    def along(self, segment: Segment) -> FieldsAlong:
        """Return the fields around the dual cell of a segment."""
        return FieldsAlong(self, segment.walk.chord(segment.track, segment), segment)

    def completed(self, fields: dict[str, Float]) -> dict[str, Float]:
        """Return fields with the coordinates that follow from x, y and z."""
        return completed(self.context.ops, dict(fields), self.context)

    def evaluated(self, fields: dict[str, Float]) -> list[Float]:
        """Return the medium's scalars at a place."""
        fields = self.completed(fields)
        return [self.context.evaluate(expr, fields) for expr in self.scalars]

    def panel(
        self,
        places: Sequence[dict[str, Float]],
        values: Sequence[Sequence[Float]],
        length: Float,
        *,
        straight: bool = False,
        **options: Any,
    ) -> Panel:
        """Return a piece of a ray with the fields, and the scalars, at its places.

        `values` are lists of scalars; a `straight` one needs those at both ends. Options are those
        of `Panel`.
        """
        kind = Straight if straight else Panel
        made = kind(places, self.context, length, **options)
        for s, own in zip((0.0, 1.0) if straight else made.where, values, strict=True):
            for expr, value in zip(self.scalars, own, strict=True):
                made.set_scalar(expr, s, value)
        return made

    def in_unit(self, name: str, value: Float) -> Float:
        """Return a value of a lattice in the field's unit."""
        value = self.context.real(value)
        return value * self.units[name] if name in self.units else value

    def means(self, panel: Panel) -> Coefficients:
        """Return mean j and α over a panel, per length of the grid's scale."""
        j, alpha = self.numbers.split(self.numbers.means(panel))
        # Unphysical values become NaN and reach the picture, which is checked afterwards.
        return j, [dr.select(a >= 0.0, a, math.nan) for a in alpha]

    def integrate(self, panel: Panel) -> list[Coefficients]:
        """Return mean j and α over both halves of a panel, and the errors of those over it."""
        *means, error = self.numbers.integrate(panel)
        found = [self.numbers.split(values) for values in means]
        usable = [(j, [dr.select(a >= 0.0, a, math.nan) for a in alpha]) for j, alpha in found]
        return [*usable, self.numbers.split(error)]

    @property
    def jumps(self) -> list[Jump]:
        """Where the medium is discontinuous."""
        return self.bound.jumps()

    def layer(self, panel: Panel, place: Float) -> Path:
        """Return the parts of zero width that a panel crosses, evaluated at a place."""
        sheet = self.bound.sheet(panel, place)
        assert sheet is not None  # `layered`
        return layer(*self.numbers.split(sheet.listed()))


def interpolated_fields(
    evaluator: CellEvaluator,
    cache: Cache,
    scheme: Scheme,
    tolerance: float,
    faintest: bool,
    whole: bool,
    in_pieces: bool = False,
) -> Interpolated:
    """Return the medium on interpolated fields; their lattices are cached with the volume.

    Parameters
    ----------
    faintest : bool
        Whether to neglect only what the precision cannot represent.
    whole : bool
        No cells are hidden.
    in_pieces : bool
        Leave out the fields themselves: `Interpolated.within` takes those of parts of the volume.
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
        limits={n: tuple(dr.opaque(real, end) for end in ends) for n, ends in extremes.items()},
        faint=faint,
        tolerance=tolerance,
        coordinates=ray_coordinates(volume, medium.names),
    )
    bricks: Any = None
    if in_pieces:
        lattices = {n: FieldLattice.of_range(*ends, backend) for n, ends in extremes.items()}
    else:
        coarseness = scheme.coarseness_for(tolerance) if whole else 0.0
        bricks = get_bricks(evaluator, cache, faint, DUAL, coarseness)
        lattices = get_lattices(evaluator, cache)
    source = Interpolated(evaluator, lattices, context, bricks, paths)
    known = all(name in volume for name in medium.names)
    if whole and known and isinstance(grid, OctreeGrid) and not in_pieces:

        def prune() -> Any:
            return pruned_walk(grid, visible_leaves(evaluator, lattices, faint), backend, "dual")

        source.walk = cache.get_or_make(key("pruned", medium.visible_key(), faint, backend), prune)
    if scheme.controlled:
        # Scalars have an error relative to their range, which matters where a ray grazes a shell.
        eps = float(np.finfo(backend.dtype).eps)
        source.lost = min(_LOST_PER_EPS * eps * contrast, _MOST_LOST)
    return source
