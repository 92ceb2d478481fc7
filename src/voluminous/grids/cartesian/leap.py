"""How rays cross empty space: from brick to brick of cells, or over many empty bricks at once.

A brick is a cube of `BRICK` cells along each axis. For every empty brick, and for rays into each of
the eight octants, it is known how many bricks ahead along all three axes are empty: that cube is
crossed in one step. (Distances that are the same in all directions, as of Cohen & Sheffer 1994,
count what is behind a ray too: it leaves a surface in small steps.) Of bricks with something in
them it is known how wide steps may be there (`grids.cartesian.dual_walk`).
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from ...backend import Int, dr, from_host
from ...backend.functions import branch, loop
from ...backend.types import Float, Mask
from ..box_walk import AxisTrack
from ..contract import Landing
from ..lanes import least, lesser, nearest
from .walk import BRICK

if TYPE_CHECKING:
    from ...backend.device import Backend

# A brick is 2^BITS cells wide.
BITS = BRICK.bit_length() - 1
# Bits of a brick's code that tell how far it is empty ahead, and what is told apart in them.
_DISTANCE_BITS = 4
_SIZES = (1, 2, 3, 4, 6, 8, 12, 15)
_FARTHEST = (1 << _DISTANCE_BITS) - 1


@dataclass
class Bricks:
    """Bricks of a grid on the device.

    `code`: per brick, z fastest: for an empty one how many are empty ahead, four bits for each
    octant; else, below 16, the log2 of how many cells wide a step may be; `shape`: number of bricks
    along y and z; `filled`: the part of all bricks that is not empty; `steps`: log2 of how wide the
    steps are that are wider than a cell; `share`: the mean part of a step that a cell is.
    """

    code: Int
    shape: tuple[Int, Int]
    filled: float
    steps: tuple[int, ...] = ()
    share: float = 1.0

    @property
    def coarse(self) -> bool:
        """Whether some steps may be wider than a cell."""
        return bool(self.steps)


@dataclass
class Search:
    """Where rays are while they look.

    `brick`: the brick they are in: mirrored numbers; `t`: the distance where they enter it; `code`:
    the brick's code; zero outside of the volume.
    """

    brick: list[Int]
    t: Float
    code: Int

    @property
    def empty(self) -> Mask:
        """Lanes in an empty brick, which look further."""
        return self.code > _FARTHEST


def brick_shape(cells: Int) -> tuple[int, ...]:
    """Return how many bricks there are along each axis."""
    return tuple((int(n) + BRICK - 1) >> BITS for n in cells)


def make_bricks(filled: np.ndarray, backend: Backend, steps: np.ndarray | None = None) -> Bricks:
    """Return bricks."""
    code = empty_ahead(filled)
    wide = np.zeros(1, np.uint8) if steps is None else steps[filled]
    if steps is not None:
        code[filled] = wide
    _, ny, nz = filled.shape
    return Bricks(
        from_host(backend.UInt, code.reshape(-1)),
        (dr.opaque(backend.UInt, ny), dr.opaque(backend.UInt, nz)),
        float(filled.mean()),
        tuple(int(k) for k in np.unique(wide) if k),
        float(np.mean(0.5**wide)) if wide.size else 1.0,
    )


def empty_ahead(filled: np.ndarray) -> np.ndarray:
    """Return how many bricks are empty along all axes, for rays into each octant.

    Four bits for each octant, numbered by the axes that rays run down, x first; zero in bricks that
    are filled. Only some distances are told apart, those of `_SIZES`: each takes a pass over all
    bricks. Beyond the volume's faces nothing is filled.
    """
    code = np.zeros(filled.shape, np.uint32)
    for octant, down in enumerate(itertools.product((False, True), repeat=3)):
        sense = tuple(slice(None, None, -1 if d else 1) for d in down)
        ahead = _cube_ahead(np.ascontiguousarray(~filled[sense]))
        code |= ahead[sense].astype(np.uint32) << np.uint32(_DISTANCE_BITS * octant)
    return code


def _cube_ahead(empty: np.ndarray) -> np.ndarray:
    size = empty.astype(np.uint8)
    for smaller, larger in pairwise(_SIZES):
        for axis in range(3):
            # Where a place is empty, and the one so far ahead along an axis (or outside).
            both, distance = empty.copy(), larger - smaller
            near, far = (np.moveaxis(a, axis, 0) for a in (both, empty))
            near[:-distance] &= far[distance:]
            empty = both
        size += np.uint8(larger - smaller) * empty
    return size


class BrickRays:
    """Moves rays to where they enter the next brick that is not empty; see `Walk.skipper`.

    Bricks are counted along each axis in the sense of the ray, like cells.

    Bricks begin with the first cell of the volume. So for a ray that runs down an axis the first
    one it meets may lack some cells: those before the first that it counts. To be made outside of
    loops: what is constant along rays is then computed once.
    """

    def __init__(self, walk: Any, track: Any, bricks: Bricks) -> None:
        self.walk, self.track, self.bricks = walk, track, bricks
        self.backend = walk.backend
        self.side = float(BRICK)
        down = [stride < 0 for stride in track.cell_stride]
        self.lacking = [dr.select(d, n, 0.0) for d, n in zip(down, walk.lacking, strict=True)]
        ny, nz = (self.backend.Int(n) for n in bricks.shape)
        strides = [ny * nz, nz, self.backend.Int(1)]
        self.strides = [dr.select(d, -s, s) for d, s in zip(down, strides, strict=True)]
        self.lasts = [self.backend.Float(axis.last_cell) for axis in walk.axes]
        counts = [axis.last_cell >> BITS for axis in walk.axes]
        lasts = [dr.select(d, s * n, 0) for d, s, n in zip(down, strides, counts, strict=True)]
        self.first = lasts[0] + lasts[1] + lasts[2]
        octant = sum(dr.select(d, self.backend.UInt(4 >> axis), 0) for axis, d in enumerate(down))
        self.shift = octant * _DISTANCE_BITS

    def __call__(self, cursor: Any) -> Landing:
        """Return rays where something is; those that are there stay."""
        cursor = self.walk.precise(self.track, cursor)
        brick = [self.brick(axis, i) for axis, i in enumerate(cursor.index)]
        start = Search(brick, cursor.t, self.code(brick, cursor.inside))
        moved = start.empty

        def searching(state: Search) -> Mask:
            return state.empty

        def cross(state: Search) -> tuple[Search]:
            return (self.cross(state),)

        (end,) = loop((start,), searching, cross, label="leap")
        # Most rays are where something is, and stay: what the others need is computed in a branch.
        index = branch(
            args=(cursor.index, end.brick, end.t),
            cond=moved,
            true_fn=self.cells,
            false_fn=lambda index, *_: index,
        )
        there = self.walk.at(self.track, index, end.t)
        if self.bricks.coarse:
            there = self.walk.settle(there, self.backend.Float(1 << self.backend.Int(end.code)))
        # Where steps may be wide, one is taken at a time.
        leave = None if self.bricks.coarse else self.leave(end)
        return Landing(
            dr.select(cursor.inside, there, cursor), moved, lambda later: later.t < leave
        )

    def brick(self, axis: int, index: Int) -> Float:
        return dr.floor((index + self.lacking[axis]) * (1.0 / self.side))

    def wall(self, axis: int, brick: Int) -> Float:
        """Return the cell that a brick begins with."""
        return dr.fma(brick, self.side, -self.lacking[axis])

    def cell(self, axis: int, brick: Int, t: Float) -> Int:
        low = self.wall(axis, brick)
        low, high = dr.select(low > 0.0, low, 0.0), low + (self.side - 1.0)
        high = lesser(high, self.lasts[axis])
        return cell_ahead(self.walk.axes[axis], self.track.axes[axis], t, low, high)

    def cells(self, index: list[Float], brick: list[Int], t: Float) -> list[Float]:
        """Return the cells of bricks that rays enter at distance `t`."""
        return [self.cell(axis, b, t) for axis, b in enumerate(brick)]

    def cross(self, state: Search) -> Search:
        """Return rays at the far side of what is empty around them."""
        real, axes = self.backend.Float, range(len(self.walk.axes))
        reach = real((state.code >> self.shift) & _FARTHEST)
        ahead = [b + reach for b in state.brick]
        distances = self._distances(ahead)
        t, through = least(distances), nearest(distances)
        brick = [dr.select(through[a], ahead[a], self._brick_at(a, t, state, reach)) for a in axes]
        return Search(brick, t, self.code(brick, t < self.track.leave))

    def leave(self, state: Search) -> Float:
        t = least(self._distances([b + 1.0 for b in state.brick]))
        # A brick is always entered, even if rounding puts its far wall where the ray is.
        return dr.select(t > state.t, t, dr.fma(dr.abs(state.t), 1e-6, state.t) + 1e-6)

    def _distances(self, ahead: list[Float]) -> list[Float]:
        return [
            axis.crossing(self.track.axes[a], lesser(self.wall(a, ahead[a]) - 1.0, self.lasts[a]))
            for a, axis in enumerate(self.walk.axes)
        ]

    def code(self, brick: list[Int], inside: Mask) -> Int:
        """Return the codes of the bricks that rays are in; zero outside."""
        flat = self.first
        for b, stride in zip(brick, self.strides, strict=True):
            flat = flat + self.backend.Int(b) * stride  # += would change `first` itself
        return dr.gather(self.backend.UInt, self.bricks.code, self.backend.UInt(flat), inside)

    def _brick_at(self, axis: int, t: Float, state: Search, reach: Float) -> Float:
        """Return the brick where a ray is at distance `t`, not before where it was."""
        old = state.brick[axis]
        index = self.walk.axes[axis].cell_at(self.track.axes[axis], t)
        brick = self.brick(axis, lesser(index, self.lasts[axis]))
        return lesser(dr.select(brick > old, brick, old), old + (reach - 1.0))


def cell_ahead(axis: Any, track: AxisTrack, t: Float, low: Float, high: Float) -> Float:
    """Return the mirrored cell a ray is in at distance `t`, between two others.

    If rounding puts a wall of it behind the ray, that wall has been crossed.
    """
    index = axis.cell_at(track, t)
    index = dr.select(index > low, index, low)
    index = dr.select(index < high, index, high)
    passed = (axis.crossing(track, index) <= t) & (index < high)
    return dr.select(passed, index + 1.0, index)
