"""Fields interpolated along rays, and the medium evaluated on them."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ...backend import Backend, dr
from ...backend.types import Float, Mask
from ...grids.contract import Segment
from ...grids.straight_chord import trilinear
from ...media.context import Context, completed
from ...media.panel import NODES, PLACES, Panel, Straight, may_turn, within_limits
from ...ranges import DUAL
from ...schemes.base import FieldScheme, Node, Scheme, Skipping, is_controlled
from ...schemes.channels import Channels, Tolerance
from ..cache import Cache
from ..precision import exactness_of
from .cells import FEW_CELLS, CellEvaluator, along_sight, ray_coordinates
from .corner_layouts import (
    KEEPS_SUMS,
    Corners,
    FieldLattice,
    get_lattices,
    lattices_of_leaves,
    make_nodes,
)
from .empty_space import get_bricks, get_pruned_walk

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
    """All fields along a segment (`schemes.base.Fields`), computed where they are asked for."""

    def __init__(self, source: Interpolated, segment: Segment) -> None:
        chord = segment.walk.chord(segment.track, segment)
        self.source, self.chord, self.segment = source, chord, segment
        self.looks_inside = source.looks_inside
        ray = segment.ray
        self.sight: list[Float] = []  # away from the observer
        if source.channels.medium.sight and ray is not None:
            self.sight = list(ray.direction)
        # In a cube of cells each place has its own corners.
        self.one_cell = chord.width is None
        self.corners: dict[str, Corners] = {}
        if self.one_cell:
            self._corners(chord, source.in_scalars)

    def _corners(self, cell: Any, names: Iterable[str]) -> dict[str, Corners]:
        """Return the corners of some fields, those in one cell gathered once.

        Who first asks for others than scalars need is in the branch of what may be seen: with all
        gathered before it shaded bone took 1.1 times as long without error control.
        """
        found = self.corners if self.one_cell else {}
        for name in names:
            if name not in found:
                found[name] = self.source.lattices[name].corners(cell, self.segment.active)
        return {name: found[name] for name in names}

    def at(self, s: Float, names: Iterable[str] | None = None) -> dict[str, Float]:
        source, chord, real = self.source, self.chord, self.source.context.real
        cell, place = chord.at(s)
        corners = self._corners(cell, source.lattices if names is None else names)
        fields = {name: source.in_unit(name, trilinear(c, place)) for name, c in corners.items()}
        for a in source.coordinates:
            fields["xyz"[a]] = real(dr.fma(s, chord.step[a], chord.position[a]))
        if self.sight:
            place = [dr.fma(s, d, o) for o, d in zip(chord.position, chord.step, strict=True)]
            found = along_sight(source.channels.medium.sight, self.sight, place, source.mirror)
            fields |= {name: real(value) for name, value in found.items()}
        return within_limits(fields, source.context)

    def scalars(self, s: Float) -> list[Float]:
        return self._scalars(self.at(s, self.source.in_scalars))

    def node(self, s: Float, *, culling_only: bool = False) -> Node:
        fields = self.at(s, self.source.in_scalars if culling_only else None)
        return fields if self.looks_inside else {}, self._scalars(fields)

    def _scalars(self, fields: dict[str, Float]) -> list[Float]:
        context = self.source.context
        fields = completed(context.ops, dict(fields), context)
        return [context.evaluate(expr, fields) for expr in self.source.channels.scalars]

    def panel(
        self,
        nodes: Sequence[Node],
        begin: Float = 0.0,
        width: Float = 1.0,
        *,
        straight: bool = False,
        culling_only: bool = False,
    ) -> Panel:
        places, values = zip(*nodes, strict=True)
        where = NODES if len(nodes) == len(NODES) else PLACES
        options: dict[str, Any] = {"where": where, "culling_only": culling_only}
        if not culling_only:
            options["many"] = self._many
            if self.looks_inside:
                options["ahead"] = self._ahead()
                options["between"] = lambda s: self.at(dr.fma(width, s, begin))
        length = self.segment.length * width
        panel = (Straight if straight else Panel)(places, self.source.context, length, **options)
        for s, scalars in zip(where, values, strict=True):
            for expr, value in zip(self.source.channels.scalars, scalars, strict=False):
                panel.set_scalar(expr, s, value)
        return panel

    @property
    def _many(self) -> Mask:
        """Where the segment is a step through many cells."""
        return self.source.backend.Bool(False) if self.one_cell else self.chord.width > 1.0

    def _ahead(self) -> list[Float] | None:
        """Return the vector from beginning to end, if the medium uses coordinates."""
        real = self.source.context.real
        return [real(d) for d in self.chord.step] if len(self.source.coordinates) == 3 else None


@dataclass
class Interpolated:
    """Coefficients for schemes that interpolate fields along the ray.

    Attributes
    ----------
    channels : Channels
    context : Context
    lattices : dict of FieldLattice
        The fields.
    largest : list of float
        Bounds of j and α per unit of the grid's scale.
    mirror : bool
        Below the midplane the volume is the mirror image of that above.
    lost : float
        Relative error of a pixel due to the interpolation itself.
    tolerance : Tolerance
        The errors that are allowed in a segment; set by the tracer.
    """

    channels: Channels
    context: Context
    backend: Backend
    lattices: dict[str, FieldLattice]
    largest: list[float]
    mirror: bool
    skipping: Skipping
    lost: float
    tolerance: Tolerance | None = None

    @functools.cached_property
    def looks_inside(self) -> bool:
        """Whether panels need fields: of other media the scalars at their nodes are enough."""
        turning = any(may_turn(expr, self.context) for expr in self.channels.scalars)
        return self.channels.looks_inside or bool(self.channels.jumps) or turning

    @functools.cached_property
    def in_scalars(self) -> list[str]:
        """The fields that the medium's scalars use; of lines, which are shifted, all."""
        used = {name for expr in self.channels.scalars for name in expr.names}
        every = self.channels.medium.sight or not used
        return [name for name in self.lattices if name in used or every]

    @functools.cached_property
    def coordinates(self) -> list[int]:
        """Those of x, y and z that the medium uses."""
        names = self.channels.medium.names
        every = "r" in names or bool(self.context.coordinates)
        return [a for a, axis in enumerate("xyz") if axis in names or every]

    def within(self, padded: dict[str, np.ndarray]) -> Interpolated:
        """Return the source in a box of cells, given these and one layer more on the low sides.

        Around them is a rim of one layer, which repeats the outermost ones. Each value is kept
        once: to make quads takes longer than they save (512³, 800² rays: 9.6 s instead of 6.1).
        """
        lattices: dict[str, FieldLattice] = {
            name: make_nodes(padded[name], self.backend, lattice.unit)
            for name, lattice in self.lattices.items()
        }
        return replace(self, lattices=lattices)

    def within_leaves(
        self, leaves: LeavesWithGhosts, fields: dict[str, np.ndarray]
    ) -> Interpolated:
        """Return the source in some leaves of a tree, given their values and those of ghosts."""
        units = [lattice.unit for lattice in self.lattices.values()]
        arrays = [fields[name] for name in self.lattices]
        sums = [name.startswith(KEEPS_SUMS) for name in self.lattices]
        made = lattices_of_leaves(leaves, arrays, units, self.backend, sums)
        return replace(self, lattices=dict(zip(self.lattices, made, strict=True)))

    def group(self, channels: slice) -> Interpolated:
        """Return the source of some of the channels; it shares fields and all that is skipped."""
        some, context = self.channels.group(channels), replace(self.context, _kept={})
        largest = self.channels.some_of(self.largest, channels)
        return replace(self, channels=some, context=context, largest=largest)

    def along(self, segment: Segment) -> FieldsAlong:
        return FieldsAlong(self, segment)

    def in_unit(self, name: str, value: Float) -> Float:
        """Return a value of a lattice in the field's unit."""
        value, unit = self.context.real(value), self.lattices[name].unit
        return value if unit == 1.0 else value * self.context.kept_number(unit)


def interpolated_fields(
    evaluator: CellEvaluator,
    cache: Cache,
    scheme: Scheme,
    tolerance: float,
    faintest: bool,
    whole: bool,
    steps: float = np.inf,
    *,
    in_blocks: bool = False,
) -> Interpolated:
    """Return the medium on interpolated fields; their lattices are cached with the volume.

    Parameters
    ----------
    faintest : bool
        Whether to neglect only what the precision cannot represent.
    whole : bool
        No cells are hidden.
    steps : float
        Estimate of the number of cells that all rays cross.
    in_blocks : bool
        Leave out the fields themselves: `Interpolated.within` takes those of parts of the volume.
    """
    evaluator = evaluator.normalised()
    volume, backend, medium = evaluator.volume, evaluator.backend, evaluator.medium
    channels, grid, controlled = evaluator.channels, volume.grid, is_controlled(scheme)
    single, contrast = exactness_of(cache, medium)
    paths = _most_paths(evaluator) if controlled else _SOME_PATHS
    faint = _faint(evaluator, paths, tolerance, faintest)
    real = backend.Float if single else backend.Wide
    extremes = {n: evaluator.statistics.extremes(n) for n in medium.names if n in volume}
    context = replace(
        evaluator.context(real, evaluator.tape),
        narrow=backend.Float,
        limits={n: tuple(dr.opaque(real, end) for end in ends) for n, ends in extremes.items()},
        faint=faint,
        tolerance=tolerance,
        coordinates=ray_coordinates(volume, medium.names),
    )
    # A ray may follow a shell over its whole length at a distance where the shell is neglected.
    most, (bright, dense) = float(np.finfo(backend.dtype).max), channels.one_path()
    skipping = Skipping(
        neglected_emission=min(paths * faint * bright, 1e-3 * most),
        neglected_depth=min(paths * faint * dense, 1.0),
    )
    lattices: dict[str, FieldLattice]
    if in_blocks:
        lattices = {n: FieldLattice.of_range(*ends, backend) for n, ends in extremes.items()}
    else:
        coarseness = 0.0
        if whole and isinstance(scheme, FieldScheme) and _wide_steps_pay(evaluator, cache, steps):
            coarseness = scheme.coarseness(tolerance)
        lattices = get_lattices(evaluator, cache)  # first: bricks would take the cache's room
        skipping.bricks = get_bricks(evaluator, cache, faint, DUAL, coarseness)
        if whole:
            skipping.walk = get_pruned_walk(evaluator, cache, faint, "dual", lattices)
    # Scalars have an error relative to their range, which matters where a ray grazes a shell.
    lost = min(_LOST_PER_EPS * float(np.finfo(backend.dtype).eps) * contrast, _MOST_LOST)
    largest = channels.in_units(evaluator.largest)
    return Interpolated(channels, context, backend, lattices, largest, grid.mirror, skipping, lost)


def _wide_steps_pay(evaluator: CellEvaluator, cache: Cache, steps: float) -> bool:
    # Rays have crossed more cells than there are: of 512³, 800² rays save 8 s for 3.6 spent here.
    medium, size = evaluator.medium, evaluator.grid.size
    if size <= FEW_CELLS or (own := medium.visible_key()) is None:
        return True
    return bool(size <= cache.crossed((own, cache.statistics.digests(medium.names)), steps))


def _most_paths(evaluator: CellEvaluator) -> float:
    """Return how many path lengths a ray may follow a shell: all the way across the volume."""
    grid = evaluator.grid
    diagonal = float(np.linalg.norm(np.ptp(grid.bounds, axis=1))) / grid.scale
    paths = evaluator.channels.paths(evaluator.largest) * diagonal
    return float(np.clip(paths, _SOME_PATHS, _MOST_PATHS))


def _faint(evaluator: CellEvaluator, paths: float, tolerance: float, faintest: bool) -> float:
    """Return the part of a peak below which coefficients are neglected.

    In thick shells even the tails are dense: the neglected part is measured in optical depth per
    cell.
    """
    least = _FAINTEST[evaluator.backend.precision]
    densest = float(evaluator.channels.densest(evaluator.largest))
    faint = min(0.01 * tolerance, 1e-3) / max(1.0, 10.0 * densest)
    return least if faintest else max(faint * (_SOME_PATHS / paths), least)
