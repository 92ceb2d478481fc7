"""Coefficients per cell or vertex: tabulated beforehand, or evaluated on the ray."""

from __future__ import annotations

import copy
import math
from collections.abc import Hashable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ...backend import Backend, dr
from ...backend.functions import flush_subnormal
from ...backend.types import Float, Int, Mask
from ...errors import InputError
from ...grids.contract import Corners, Segment
from ...grids.structured import is_structured
from ...grids.trees.octree import OctreeGrid
from ...memory import check_memory, fits
from ...progress import reporter
from ...ranges import CELLS, Numbers, is_packed
from ...schemes.base import JAlpha, Scanner, Scheme, Skipping, VertexScheme, innermost
from ...schemes.channels import Channels, ColouredShapes
from ...volume import Volume
from ..cache import SLABS, Cache
from ..precision import exactness_of, in_single_range
from .cells import FEW_CELLS, LARGEST, SLAB, CellEvaluator, along_sight
from .empty_space import get_bricks, get_pruned_walk, pruned_walk

_ADVICE = (
    "use precision='single', scheme='first-order' (which can do without a table), "
    "or a coarser or smaller volume"
)
# Tabulated coefficients below this fraction of their peak are neglected: below rounding.
_FAINT = {"single": 1e-9, "double": 1e-18}
# With fewer cells than this for each that rays may cross, in all pictures so far, a table is made
# (three Gaussians, 512³ and 800² rays: with 0.15 it saves nothing). Of 512³ cells and 400² rays the
# first four pictures, on the ray, take 2.4 s of a processor and then 0.7 s each, where the one with
# the table took 8.2 s; those after it take 0.6 s.
CELLS_PER_STEP = 0.125
# Shapes per cell below this, or above its inverse, are tabulated as coefficients, which have units.
_LEAST_SHAPE = 1e-18


@dataclass
class CoefficientTable:
    """Tabulated coefficients, for look-up by schemes.

    Attributes
    ----------
    packets : list of arrays
        Interleaved values, one flat array per packet of 4, 2 or 1.
    channels : Channels
        What the values are.
    highest : list of float
        Largest magnitude of each value.
    """

    packets: list[Float]
    widths: list[int]
    channels: Channels
    highest: list[float]
    backend: Backend
    skipping: Skipping = field(default_factory=Skipping)

    @classmethod
    def empty(cls, evaluator: CellEvaluator, size: int) -> CoefficientTable:
        channels, backend = evaluator.channels, evaluator.backend
        count = channels.count
        widths = [4] * (count // 4) + [w for w in (2, 1) if count & w]
        if size * max(widths) > LARGEST:
            raise InputError(
                f"a table of {size} x {max(widths)} numbers exceeds the {LARGEST} that an array "
                "can hold; render the volume in parts, or with scheme='first-order'"
            )
        packets = [dr.empty(backend.Float, size * width) for width in widths]
        return cls(packets, widths, channels, [0.0] * count, backend)

    @property
    def largest(self) -> list[float]:
        """Bounds of j and α per unit of the grid's scale."""
        return self.channels.largest(self.highest)

    def store(self, values: list[Float], first: int, *also: Any, measured: bool = True) -> None:
        """Write the values of consecutive places, in one kernel with `also`.

        The largest of them are `measured`, unless their bounds will do.
        """
        real, UInt = self.backend.Float, self.backend.UInt
        values = [flush_subnormal(real(v)) for v in values]
        index = dr.arange(UInt, max(len(v) for v in values)) + dr.opaque(UInt, first)
        position = 0
        for data, width in zip(self.packets, self.widths, strict=True):
            part = values[position : position + width]
            dr.scatter(data, part[0] if width == 1 else self.backend.packet(width)(part), index)
            position += width
        size = [dr.abs(v) for v in values if measured]
        dr.eval(self.packets, size, *also)
        for k, v in enumerate(size):
            self.highest[k] = max(self.highest[k], float(dr.max(v)[0]))

    def gather(self, index: Int, active: Mask) -> list[Float]:
        values: list[Float] = []
        mode = dr.ReduceMode.Auto
        if self.backend.derivatives and self.backend.device == "cpu":
            size = sum(map(len, self.packets)) * self.backend.dtype.itemsize
            if fits(size * dr.thread_count()):  # each thread has its sums: a third of the time
                mode = dr.ReduceMode.Expand
        for data, width in zip(self.packets, self.widths, strict=True):
            kind, at = self.backend.packet(width), self.backend.UInt(index)
            packet = dr.gather(kind, data, at, active, mode=mode)
            values += [packet] if width == 1 else list(packet)
        return values

    def at(self, segment: Segment) -> JAlpha:
        return self.channels.split(self.gather(segment.cell, segment.active))

    def interpolate(self, corners: Corners, active: Mask) -> list[Float]:
        total: list[Float] = []
        for vertex, weight in zip(corners.vertex, corners.weight, strict=True):
            values = self.gather(vertex, active)
            if total:
                total = [dr.fma(weight, v, t) for v, t in zip(values, total, strict=True)]
            else:
                total = [weight * v for v in values]
        return total

    def visible(self, faint: float) -> np.ndarray:
        """Return which places have coefficients above a fraction of their peak."""
        visible: Any = False
        highest = iter(self.highest)
        for data, width in zip(self.packets, self.widths, strict=True):
            for values in np.asarray(data).reshape(-1, width).T:
                visible = visible | (np.abs(values) > faint * next(highest))
        return np.asarray(visible)


def cell_table(
    evaluator: CellEvaluator, low: int, high: int, *, measured: bool = True
) -> CoefficientTable:
    """Return the coefficients of consecutive cells."""
    table = CoefficientTable.empty(evaluator, high - low)
    for first in range(low, high, SLAB):
        values, bad = evaluator.classify(first, min(SLAB, high - first))
        table.store(values, first - low, bad, measured=measured)
        if dr.any(bad):
            evaluator.refuse(values, bad, first)
        reporter()(0, 1)
    return table


def vertex_table(evaluator: CellEvaluator, *, measured: bool = True) -> CoefficientTable:
    """Return the coefficients at all vertices: plain means over the cells that touch them.

    RADMC-3D's rule: cells outside the domain are excluded, not counted as zero. Each cell is
    classified once or twice.
    """
    grid, UInt, Float = evaluator.grid, evaluator.backend.UInt, evaluator.backend.Float
    table = CoefficientTable.empty(evaluator, grid.vertex_count)
    cells, held = None, (0, 0)
    for (first, last), around in _vertex_pieces(grid, 8 * SLAB // max(8, evaluator.channels.count)):
        if around != held or cells is None:
            cells = None  # one at a time
            cells, held = cell_table(evaluator, *around, measured=False), around
        vertex = dr.arange(UInt, last - first) + dr.opaque(UInt, first)
        begin = dr.opaque(UInt, around[0])
        total, number = [Float(0)] * evaluator.channels.count, Float(0)
        for cell, there in grid.vertex_cells(vertex, evaluator.backend):
            values = cells.gather(UInt(cell) - begin, there)
            total = [t + v for t, v in zip(total, values, strict=True)]
            number += dr.select(there, 1.0, 0.0)
        table.store([t / number for t in total], first, measured=measured)
    return table


def _vertex_pieces(grid: Any, places: int) -> Iterator[tuple[tuple[int, int], tuple[int, int]]]:
    """Yield ranges of some vertices, and of the cells around them.

    Layers of the first axis touch two layers of cells; for trees all leaves are needed.
    """
    if not is_structured(grid):
        for first in range(0, grid.vertex_count, places):
            yield (first, min(first + places, grid.vertex_count)), (0, grid.size)
        return
    n, plane = grid.shape[0], grid.size // grid.shape[0]
    vertices = grid.vertex_count // (n + 1)
    step = max(1, places // plane)
    for first in range(0, n + 1, step):
        last = min(first + step, n + 1)
        low, high = max(first - 1, 0), min(last, n)
        yield (first * vertices, last * vertices), (low * plane, high * plane)


class OnRay:
    """The medium evaluated in every cell that a ray visits; the same bits as from a table.

    Unusable coefficients become NaN, which reaches the picture and is checked there.

    Parameters
    ----------
    evaluator : CellEvaluator
        In units that suit kernels.
    single : bool
        Evaluate it in the precision of the picture; the bits then differ from a table's.
    read : bool
        Take the fields of the volume; else `within` gives those of a part of it.
    """

    def __init__(
        self,
        evaluator: CellEvaluator,
        skipping: Skipping | None = None,
        *,
        single: bool = False,
        read: bool = True,
    ) -> None:
        self.evaluator, self.backend = evaluator, evaluator.backend
        self.real = self.backend.Float if single else self.backend.Wide
        self.channels, self.skipping = evaluator.channels, skipping or Skipping()
        self.largest = self.channels.in_units(evaluator.largest)
        self.fields: dict[str, Numbers] = {}
        if read:
            self._read(evaluator)

    def _read(self, evaluator: CellEvaluator) -> None:
        volume = evaluator.volume
        for name in evaluator.medium.names:
            if name in volume:
                array = volume.array(name)
                if array.dtype.kind != "f" and not is_packed(array):
                    size = array.size * (4 if array.dtype.itemsize <= 2 else 8)
                    advice = "crop or coarsen the volume"
                    check_memory(size, "an integer field as floating point", advice)
                self.fields[name] = Numbers(array.reshape(-1), self.backend)
        evaluator.all_coordinates  # noqa: B018 (made before rays are traced)

    def within(self, volume: Volume, origin: tuple[int, int, int]) -> OnRay:
        """Return the source in a part of the volume that begins at a cell, in the same units."""
        part = copy.copy(self)
        part.evaluator, part.fields = self.evaluator.within(volume, origin), {}
        part._read(part.evaluator)
        return part

    def tabulated(self, volume: Volume, origin: tuple[int, int, int]) -> CoefficientTable:
        """Return the coefficients of all cells of such a part."""
        evaluator = self.evaluator.within(volume, origin)
        return cell_table(evaluator, 0, volume.grid.size, measured=False)

    def group(self, channels: slice) -> OnRay:
        """Return the source of some of the channels."""
        part = copy.copy(self)
        part.channels = self.channels.group(channels)
        part.evaluator = self.evaluator.using(part.channels)
        part.largest = self.channels.some_of(self.largest, channels)
        return part

    def at(self, segment: Segment) -> JAlpha:
        cell, active = segment.cell, segment.active
        places = self.evaluator.coordinates(cell, active)
        fields = {name: self.real(value) for name, value in places.items()}
        for name, data in self.fields.items():
            fields[name] = self.real(data.gather(self.backend.UInt(cell), active))
        if sight := self.evaluator.medium.sight:
            fields |= self._sight(segment, sight)
        values = self.evaluator.evaluate(fields, self.real)
        for k in range(self.channels.signed, len(values)):
            values[k] = dr.select(values[k] >= 0, values[k], math.nan)
        return self.channels.split([flush_subnormal(self.backend.Float(v)) for v in values])

    def _sight(self, segment: Segment, axes: tuple[str, ...]) -> dict[str, Float]:
        ray, grid = segment.ray, self.evaluator.grid
        assert ray is not None
        middle = (segment.track.entry + 0.5 * (segment.begin + segment.end)) * grid.scale
        place = [dr.fma(middle, d, o) for o, d in zip(ray.origin, ray.direction, strict=True)]
        ahead = [-d if segment.backward else d for d in ray.direction]
        found = along_sight(axes, ahead, place, grid.mirror)
        return {name: self.real(value) for name, value in found.items()}


class TablesOfGroups:
    """Coefficients at vertices, tabulated for one group of channels after the other.

    In memory there is one table at a time.
    """

    def __init__(self, evaluator: CellEvaluator, skipping: Skipping) -> None:
        self.evaluator, self.backend, self.skipping = evaluator, evaluator.backend, skipping
        self.channels = evaluator.channels
        self.largest = self.channels.in_units(evaluator.largest)

    def group(self, channels: slice) -> CoefficientTable:
        """Return the source of some of the channels."""
        dr.sync_thread()  # the table before is free only now
        table = vertex_table(self.evaluator.using(self.channels.group(channels)), measured=False)
        table.skipping = self.skipping
        table.highest = self.channels.some_of(self.largest, channels)
        return table


def tabulated(
    evaluator: CellEvaluator, cache: Cache, scheme: Scheme, steps: float, whole: bool
) -> CoefficientTable | OnRay | TablesOfGroups:
    """Return a new or cached table, or the medium on the ray where a table does not pay.

    Many channels are evaluated on the ray, or tabulated group by group.

    Parameters
    ----------
    steps : float
        Estimate of the number of cells that all rays cross.
    whole : bool
        No cells are hidden.
    """
    evaluator, backend, grid = _in_tables(evaluator, scheme), evaluator.backend, evaluator.grid
    channels, by_cell = evaluator.channels, scheme.coefficients_at == "cell"
    places = grid.size if by_cell else grid.vertex_count
    needed = places * channels.count * backend.dtype.itemsize
    recorded = evaluator.tape is not None
    if recorded and by_cell:  # the gradient of a table takes 1.3 times as long, its memory apart
        return OnRay(evaluator.normalised())
    sight = evaluator.medium.sight
    crowded = by_cell and _crowded(channels, needed, grid.size / steps)
    if crowded and not evaluator.volume.tables:  # not even hashed: it takes a while for 1024³
        return OnRay(evaluator.normalised())
    faint = 0.0 if isinstance(scheme, Scanner) else _FAINT[backend.precision]
    everywhere = isinstance(scheme, Scanner) and scheme.everywhere

    def on_ray(single: bool = False) -> OnRay:
        skipping = Skipping()
        if not everywhere:
            skipping.bricks = get_bricks(evaluator, cache, faint, CELLS)
        if whole and not everywhere:
            skipping.walk = get_pruned_walk(evaluator, cache, 0.0, "cells", {})
        return OnRay(evaluator.normalised(), skipping, single=single)

    if _without_table(evaluator, scheme):
        if by_cell:
            return on_ray(_fits_in_single(evaluator, cache))
        skipping = Skipping(None if everywhere else get_bricks(evaluator, cache, faint, CELLS))
        count = len(channels.groups(scheme))
        check_memory(needed // count + SLABS, f"the table of scheme {scheme.name!r}", _ADVICE)
        return TablesOfGroups(evaluator.normalised(), skipping)
    key: Hashable = None
    if (own := channels.key()) is not None and not recorded:
        digests = cache.statistics.digests(evaluator.medium.names)
        seen = evaluator.volume.sight.key() if sight else None
        key = (own, scheme.coefficients_at, (faint, everywhere), backend, digests, seen)
        found: CoefficientTable | None = cache.get(key)
        if found is not None:
            return replace(found, channels=channels.reuse(found.channels))
    if crowded:
        return OnRay(evaluator.normalised())
    large = by_cell and not recorded and grid.size > FEW_CELLS
    if large and grid.size > CELLS_PER_STEP * cache.crossed(key, steps):
        return on_ray()
    check_memory(needed + SLABS, f"the table of scheme {scheme.name!r}", _ADVICE)
    evaluator = evaluator.normalised()
    table = cell_table(evaluator, 0, grid.size) if by_cell else vertex_table(evaluator)
    if not everywhere:
        table.skipping.bricks = get_bricks(evaluator, cache, faint, CELLS)
        if whole and by_cell and isinstance(grid, OctreeGrid):
            table.skipping.walk = pruned_walk(grid, table.visible(faint), backend, "cells")
    return table if key is None else cache.put(key, table)


def _in_tables(evaluator: CellEvaluator, scheme: Scheme) -> CellEvaluator:
    """Return an evaluator of the values that a table of a scheme holds."""
    medium, binding = evaluator.medium, evaluator.channels.binding
    context = evaluator.context(evaluator.backend.Float, evaluator.tape)
    if isinstance(solver := innermost(scheme), VertexScheme):
        channels = solver.channels(medium, binding, context)
        if channels is not None:
            return evaluator.using(channels)
    if ColouredShapes.serve(medium) and len(evaluator.channels.groups(scheme)) == 1:
        shapes = ColouredShapes(medium, binding, context)
        if _LEAST_SHAPE < shapes.brightest(shapes.in_units(evaluator.largest)) < 1.0 / _LEAST_SHAPE:
            return evaluator.using(shapes)
    return evaluator


def on_ray_in_blocks(evaluator: CellEvaluator, cache: Cache, scheme: Scheme) -> OnRay:
    """Return the medium on the ray, or for tables, of which parts of the volume are drawn.

    The bits are those of `tabulated`.
    """
    evaluator = _in_tables(evaluator, scheme)
    single = _without_table(evaluator, scheme) and _fits_in_single(evaluator, cache)
    return OnRay(evaluator.normalised(), single=single, read=False)


def _without_table(evaluator: CellEvaluator, scheme: Scheme) -> bool:
    """Return whether there is no table of all channels: of many, or of lines, which rays shift."""
    many = len(evaluator.channels.groups(scheme)) > 1
    many |= scheme.coefficients_at == "cell" and bool(evaluator.medium.sight)
    return many and not evaluator.backend.derivatives


def _fits_in_single(evaluator: CellEvaluator, cache: Cache) -> bool:
    """Return whether single precision evaluates the medium, for all values that fields have."""
    medium, statistics = evaluator.medium, cache.statistics
    if not exactness_of(cache, medium)[0]:
        return False

    def check() -> bool:
        return in_single_range(medium, {name: statistics.range_of(name) for name in medium.names})

    own = medium.key()
    key = None if own is None else ("in range", own, statistics.digests(medium.names))
    return cache.get_or_make(key, check)


def _crowded(channels: Channels, needed: int, cells_per_step: float) -> bool:
    """Return True if the medium is better evaluated on the ray than for all cells beforehand.

    That is so where the rays visit few of the cells, unless the table can be cached and leaves
    enough memory: it then serves the next pictures, too.
    """
    if not fits(needed + SLABS):
        return True
    return cells_per_step >= 0.5 and (channels.key() is None or not fits(4 * needed))
