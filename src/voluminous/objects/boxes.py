"""Edges of boxes on a lattice of whole numbers: those of each, or of all of them as one body."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..colormaps import is_name_and_alpha
from ..errors import InputError, check_flag
from ..geometry import CARTESIAN, CYLINDRICAL, SPHERICAL, position
from ..grids.curvilinear.refined import RefinedCells
from ..grids.trees.octree import OctreeGrid
from ..grids.trees.patch_tree import expanded
from ..grids.trees.patches import PatchGrid
from ..units import is_listed
from .contract import Layers, SceneObject, View
from .curves import Curves

if TYPE_CHECKING:
    from ..grids.contract import Grid
    from ..volume import Volume

# Leaves looked at at once.
_CHUNK = 1 << 20
_ROUNDING = 1e-9
_QUARTERS = 4
# Around an edge are four places for blocks, by their sides along two axes: bits 2 i + j. Two next
# to each other make a face that goes on, four the inside; all else is an edge of the body.
_FACE_ALONG_FIRST, _FACE_ALONG_SECOND = (0b0101, 0b1010), (0b0011, 0b1100)
_FLAT = (*_FACE_ALONG_FIRST, *_FACE_ALONG_SECOND, 0b1111)
_SIDES = ((0, 0), (0, 1), (1, 0), (1, 1))
_OTHERS = ((1, 2), (0, 2), (0, 1))
# An arc is straight for so long (radian): half of that from its chord, 2e-4 of the radius.
_STRAIGHT = np.pi / 90
# Compared with the size of a domain these are one point.
_POINT = 1e-12


@dataclass
class BlockLattice:
    """Blocks of one size that fill a part of a grid, and the boxes that it is made of.

    `own` leads from whole numbers (3, n) to the grid's own coordinates, named in `system`; `block`
    (n, 3) are places of the blocks in units of their `size`, and `boxes` the corners (m, 3) of the
    boxes, None where there is but the domain. After `period` blocks an axis closes upon itself; 0
    if it does not. Before the blocks `seams` there is a line on surfaces that go on.
    """

    own: Callable[[np.ndarray], np.ndarray]
    block: np.ndarray
    size: np.ndarray
    boxes: tuple[np.ndarray, np.ndarray] | None = None
    system: tuple[str, ...] = CARTESIAN
    period: Sequence[int] = (0, 0, 0)
    seams: Sequence[Any] = ((), (), ())


def level_count(grid: Grid) -> int:
    """Return how many levels a grid has; level 0 is the domain."""
    if isinstance(grid, PatchGrid):
        return int(grid.patches.level.max()) + 1
    return int(grid.places.deepest) + 1 if isinstance(grid, (OctreeGrid, RefinedCells)) else 1


def lattice_of(grid: Any, level: int) -> BlockLattice:
    """Return what is refined `level` times or more; of level 0 the domain, and its patches."""
    if isinstance(grid, PatchGrid):
        return _of_patches(grid, level)
    domain = np.zeros((1, 3), np.int64)
    if level == 0:
        if grid.coordinates in (SPHERICAL, CYLINDRICAL):
            return replace(_bent(grid, [e[[0, -1]] for e in grid.edges], domain), boxes=None)
        return BlockLattice(_between(list(grid.bounds)), domain, np.ones(3, np.int64))
    nodes, size = _refined_nodes(grid, level - 1)
    if isinstance(grid, OctreeGrid):
        return BlockLattice(grid.position, nodes, size, (nodes * size, (nodes + 1) * size))
    return _bent(grid, [e[::step] for e, step in zip(grid.fine_edges, size, strict=True)], nodes)


def _between(walls: list[np.ndarray]) -> Callable[[np.ndarray], np.ndarray]:
    return lambda place: np.stack([w[k] for w, k in zip(walls, place, strict=True)])


def _of_patches(grid: Any, level: int) -> BlockLattice:
    patches = grid.patches
    low, high = patches.corners
    here = patches.level == level
    boxes = (low[here], high[here])
    if level == 0:
        boxes = (np.vstack([0 * grid.extent, low[here]]), np.vstack([grid.extent, high[here]]))
    cell, some = patches.sizes[level], patches.level >= level
    first, last = low[some] // cell, -(-high[some] // cell)
    common = np.gcd.reduce(np.concatenate([first, last]), axis=0)
    _, index = expanded(first // common, last // common)
    block = np.unique(index, axis=1).T
    return BlockLattice(lambda place: grid.position(place), block, cell * common, boxes)


def _refined_nodes(grid: Any, level: int) -> tuple[np.ndarray, np.ndarray]:
    size = np.array(grid.divisions)
    size[list(grid.places.axes)] >>= level
    # The first leaf in each of them: finer than it, and where it begins.
    first = (grid.places.aligned_levels() <= level) & (grid.levels > level)
    nodes = [np.empty((3, 0), np.int64)]
    for begin in range(0, grid.size, _CHUNK):
        chosen = np.flatnonzero(first[begin : begin + _CHUNK])
        if chosen.size:
            low, _ = grid.boxes(begin, min(begin + _CHUNK, grid.size))
            nodes.append(low[:, chosen] // size[:, None])
    return np.concatenate(nodes, axis=1).T, size


def _bent(grid: Any, walls: list[np.ndarray], block: np.ndarray) -> BlockLattice:
    """Return blocks between walls of r, θ, φ or R, φ, z; a mirror shows them twice.

    An azimuth that is one closed block is cut in quarters, and θ above and below the midplane in
    two: there would be no line to be seen of a sphere.
    """
    phi, middle = grid.coordinates.index("phi"), 0.5 * np.pi
    has_theta = "theta" in grid.coordinates

    def cut(axis: int, edges: np.ndarray) -> np.ndarray:
        """Set the walls of an axis; return blocks that fill all of what was one block."""
        walls[axis] = edges
        parts = np.repeat(block[None], len(edges) - 1, axis=0)
        parts[:, :, axis] = np.arange(len(edges) - 1)[:, None]
        return parts.reshape(-1, 3)

    if has_theta and grid.mirror:
        below = block.copy()
        below[:, 1] = 2 * (len(walls[1]) - 1) - 1 - block[:, 1]
        walls[1] = np.concatenate([walls[1], np.pi - walls[1][-2::-1]])
        block = np.concatenate([block, below])
    elif has_theta and len(walls[1]) == 2 and walls[1][0] < middle < walls[1][1]:
        block = cut(1, np.array([walls[1][0], middle, walls[1][1]]))
    period, seams = [0, 0, 0], [np.array([], int) for _ in range(3)]
    if grid.is_periodic:
        if len(walls[phi]) == 2:
            block = cut(phi, np.linspace(walls[phi][0], walls[phi][-1], _QUARTERS + 1))
        period[phi] = count = len(walls[phi]) - 1
        seams[phi] = np.unique(np.round(np.arange(_QUARTERS) * count / _QUARTERS)).astype(int)
    if has_theta:
        seams[1] = np.flatnonzero(np.abs(walls[1] - middle) < _ROUNDING)
    boxes, size = (block, block + 1), np.ones(3, np.int64)
    return BlockLattice(_between(walls), block, size, boxes, grid.coordinates, period, seams)


@dataclass(frozen=True)
class Edges:
    """Edges along the axes of a lattice, from `start` (n, 3) to `stop` (n,) along `axis` (n,).

    A `seam` is a line drawn on a face that goes on, to show how it curves.
    """

    axis: np.ndarray
    start: np.ndarray
    stop: np.ndarray
    seam: np.ndarray

    @classmethod
    def of(cls, parts: list[tuple[int, np.ndarray, np.ndarray, np.ndarray]]) -> Edges:
        """Return all edges of parts (axis, start, stop, seam)."""
        axis = np.repeat([part[0] for part in parts], [len(part[1]) for part in parts])
        return cls(axis, *(np.concatenate([part[k] for part in parts]) for k in (1, 2, 3)))

    def some(self, index: np.ndarray) -> Edges:
        """Return some of them."""
        return Edges(self.axis[index], self.start[index], self.stop[index], self.seam[index])

    def ends(self) -> tuple[np.ndarray, np.ndarray]:
        """Return both ends, shape (n, 3) each."""
        last = self.start.copy()
        last[np.arange(len(last)), self.axis] = self.stop
        return self.start, last


def every_edge(low: np.ndarray, high: np.ndarray) -> Edges:
    """Return the twelve edges of each box between corners (n, 3)."""
    corners, parts = (low, high), []
    for axis in range(3):
        for sides in _SIDES:
            start = low.copy()
            for other, side in zip(_OTHERS[axis], sides, strict=True):
                start[:, other] = corners[side][:, other]
            parts.append((axis, start, high[:, axis], np.zeros(len(low), bool)))
    return Edges.of(parts)


def creases(
    block: np.ndarray, period: Sequence[int] = (0, 0, 0), seams: Sequence[Any] = ((), (), ())
) -> Edges:
    """Return where the surface of the body that equal blocks (n, 3) make has an edge.

    `period` and `seams` are those of a `BlockLattice`.
    """
    parts = []
    for axis, (first, second) in enumerate(_OTHERS):
        moved = np.zeros((4, 1, 3), np.int64)
        moved[:, 0, [first, second]] = _SIDES
        start = (block + moved).reshape(-1, 3)
        for other in (first, second):
            if period[other]:
                start[:, other] %= period[other]
        order, number = same_rows(start)
        bits = np.repeat([1 << k for k in range(4)], len(block))[order]
        around = np.bincount(number, weights=bits).astype(np.int64)
        start = start[order][np.diff(number, prepend=-1) > 0]
        seam = np.isin(start[:, first], seams[first]) & np.isin(around, _FACE_ALONG_FIRST)
        seam |= np.isin(start[:, second], seams[second]) & np.isin(around, _FACE_ALONG_SECOND)
        sharp = seam | ~np.isin(around, _FLAT)
        parts.append((axis, start[sharp], start[sharp, axis] + 1, seam[sharp]))
    return Edges.of(parts)


def joined_edges(edges: Edges) -> Edges:
    """Return edges with those on one line that touch or overlap made one."""
    line, count = edges.start.copy(), len(edges.axis)
    if not count:
        return edges
    begin = line[np.arange(count), edges.axis]
    line[np.arange(count), edges.axis] = 0
    order, number = same_rows(np.column_stack([edges.axis, line]), begin)
    begin, stop = begin[order], edges.stop[order]
    # The farthest stop on the line so far: ranks, so that lines stay apart.
    values, rank = np.unique(stop, return_inverse=True)
    farthest = np.maximum.accumulate(number * len(values) + rank)
    reached = values[farthest - number * len(values)]
    new = np.diff(number, prepend=-1) > 0
    new[1:] |= begin[1:] > reached[:-1]
    last = np.append(np.flatnonzero(new)[1:], count) - 1
    return replace(edges.some(order[new]), stop=reached[last])


def same_rows(rows: np.ndarray, *then: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return an order that brings equal rows (n, k) together, and their numbers in that order.

    Equal rows are in the order of what is given `then`.
    """
    order = np.lexsort((*then, *rows.T[::-1]))
    apart = np.any(np.diff(rows[order], axis=0) != 0, axis=1)
    return order, np.concatenate([np.zeros(min(1, len(rows)), np.int64), np.cumsum(apart)])


def outline(grid: Grid, level: int, merged: bool) -> list[np.ndarray]:
    """Return polylines around what is refined `level` times: (lines, n, 3) for each n."""
    lattice = lattice_of(grid, level)
    if merged or lattice.boxes is None:
        edges = creases(lattice.block, lattice.period, lattice.seams)
        start, stop = edges.start * lattice.size, edges.stop * lattice.size[edges.axis]
        edges = Edges(edges.axis, start, stop, edges.seam)
    else:
        edges = every_edge(*lattice.boxes)
        for axis, period in enumerate(lattice.period):
            if period:
                edges.start[edges.axis != axis, axis] %= period
    if lattice.system != CARTESIAN:
        edges = _visible(edges, lattice)
    edges = joined_edges(edges)
    first, last = (lattice.own(place.T) for place in edges.ends())
    turned = np.isin(np.array(lattice.system)[edges.axis], ("theta", "phi"))
    length = np.abs(last - first)[edges.axis, np.arange(len(edges.axis))]
    steps = np.where(turned, np.ceil(length / _STRAIGHT - 1e-6), 1).astype(int)
    lines: list[np.ndarray] = []
    for count in np.unique(steps):
        parts = np.linspace(first[:, steps == count], last[:, steps == count], count + 1)
        ends = np.moveaxis(parts, 2, 0).reshape(-1, 3).T  # parts: points, axes, lines
        lines.append(position(lattice.system, ends).T.reshape(-1, count + 1, 3))
    return lines


def _visible(edges: Edges, lattice: BlockLattice) -> Edges:
    ends = [position(lattice.system, lattice.own(place.T)) for place in edges.ends()]
    near = _POINT * max(np.abs(end).max(initial=0.0) for end in ends)
    axial = np.all([np.hypot(end[0], end[1]) <= near for end in ends], axis=0)
    phi, away = lattice.system.index("phi"), np.abs(ends[1] - ends[0]).max(axis=0) > near
    # A circle ends where it begins; on the axis it is a point.
    along = edges.axis == phi
    shown = np.where(axial, away & ~along, away | along)
    # Lines on planes need no seams to be seen.
    flat = edges.axis == 0
    if "theta" in lattice.system:
        flat &= np.isin(edges.start[:, 1], lattice.seams[1])
    shown &= ~(edges.seam & (axial | flat))
    edges.start[axial, phi] = 0
    return edges.some(shown)


class Boxes(SceneObject):
    """The outlines of a grid as lines: of the domain, of patches, of what is refined.

    Of a Cartesian grid it is a box; of spherical and cylindrical ones the arcs and circles where
    they end, and where all around there is no end, four meridians and the equator.

    Parameters
    ----------
    volume : Volume, optional
        Default: the one that is rendered.
    colors : optional
        As for `Curves`; a list has one for each level that is drawn, or more.
    levels : int or sequence of int, optional
        Which levels to draw: 0 is the domain (and the coarsest patches), k what is refined k
        times or more. Levels that a grid does not have are left out. Default: all of them.
    merged : bool, optional
        Draw the edges of all that is refined to a level as one body; else of each patch of a
        `PatchGrid`, or of each cell that is split. Default: each patch, but trees as one body.
    width, opacity, depth, channel
        As for `Curves`.
    relative : bool
        Colours count in units of the picture's brightest pixel.

    Raises
    ------
    InputError
        If levels are no whole numbers from 0, or `volume` is none; when they are drawn, if a grid
        has none of them, or if there are fewer colours.
    """

    def __init__(
        self,
        volume: Volume | None = None,
        colors: Any = 1.0,
        *,
        levels: Any = None,
        merged: bool | None = None,
        width: Any = 1.0,
        opacity: float = 1.0,
        depth: str = "true",
        channel: int | None = None,
        relative: bool = True,
    ) -> None:
        placed: dict[str, Any] = {"depth": depth, "channel": channel, "relative": relative}
        super().__init__(**placed)
        if volume is not None and not hasattr(volume, "grid"):
            raise InputError(
                f"Boxes: expected a vm.Volume, or colors=…, got {type(volume).__name__} first"
            )
        if merged is not None:
            check_flag("merged", merged)
        several = isinstance(levels, Sequence) or np.ndim(levels) == 1
        chosen = list(levels) if several else [] if levels is None else [levels]
        whole = all(isinstance(k, (int, np.integer)) and not isinstance(k, bool) for k in chosen)
        if not whole or min(chosen, default=0) < 0 or (several and not chosen):
            raise InputError(f"levels must be a whole number from 0, or several, got {levels!r}")
        self.grid = None if volume is None else volume.grid
        self.colors, self.levels, self.merged = colors, levels, merged
        self._levels, self._style = chosen, {"width": width, "opacity": opacity, **placed}
        self._outlines: tuple[Any, Any, np.ndarray] | None = None
        first = colors[:1] if _are_several(colors) else colors
        Curves(np.zeros((1, 2, 3)), first, **self._style)  # refuses what lines cannot be

    def layers(self, view: View) -> Layers | None:
        grid = view.grid if self.grid is None else self.grid
        if self._outlines is None or self._outlines[0] is not grid:  # once for many pictures
            self._outlines = (grid, *self._lines(grid))
        _, groups, level = self._outlines
        colors = self.colors
        if _are_several(colors) and len(colors) > 1:
            if len(colors) <= level.max():
                raise InputError(
                    f"colors: there are {len(colors)}, for {level.max() + 1} levels drawn"
                )
            listed = isinstance(colors, (list, tuple))
            colors = [colors[k] for k in level] if listed else colors[level]
        unit = 1.0 if grid.unit is None else grid.unit
        return Curves([group * unit for group in groups], colors, **self._style).layers(view)

    def _lines(self, grid: Grid) -> tuple[list[np.ndarray], np.ndarray]:
        merged = not isinstance(grid, PatchGrid) if self.merged is None else self.merged
        count = level_count(grid)
        levels = [k for k in range(count) if self.levels is None or k in self._levels]
        if not levels:
            raise InputError(f"levels={self.levels!r}: the grid has levels 0 to {count - 1}")
        parts = [outline(grid, level, merged) for level in levels]
        which = [np.full(sum(map(len, part)), k) for k, part in enumerate(parts)]
        return [group for part in parts for group in part], np.concatenate(which)


def _are_several(colors: Any) -> bool:
    if not is_listed(colors) or is_name_and_alpha(colors) or not len(colors):
        return False
    return isinstance(colors[0], str) or np.ndim(colors[0]) == 1
