"""How rays cross empty space: from block to block of cells, or over many empty blocks at once.

A block is a cube of 2^bits cells along each axis. For every block its distance to the nearest block
that is not empty is known, in blocks and along the axis where it is largest (Chebyshev's): so all
blocks nearer than that, a cube, are empty and crossed in one step (Cohen & Sheffer 1994).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..backend import dr
from .cartesian_walk import CartesianWalk, Cursor, Track, least, nearest

BITS = 2


@dataclass
class Blocks:
    """Blocks of a grid on the device.

    Attributes
    ----------
    distance : array of UInt
        Per block, z fastest: 0 if there is something in it, else the distance to one that is not
        empty.
    shape : tuple of arrays of UInt
        Number of blocks along y and z.
    filled : float
        The part of all blocks that is not empty.
    bits : int
        A block is 2^bits cells wide.
    """

    distance: Any
    shape: tuple[Any, Any]
    filled: float
    bits: int = BITS


@dataclass
class Leap:
    """Where rays are while they look for the next block with something in it.

    Attributes
    ----------
    leave : array
        The distance where they leave the block they are in.
    moved : array of Bool
        Lanes that crossed empty space.
    found : array of Bool
        Lanes that need not go on: they are in a block with something in it, or outside.
    """

    cursor: Cursor
    leave: Any
    moved: Any
    found: Any


def block_shape(cells: Any, bits: int = BITS) -> tuple[int, ...]:
    """Return how many blocks there are along each axis."""
    return tuple((int(n) + (1 << bits) - 1) >> bits for n in cells)


def make_blocks(filled: np.ndarray, backend: Any, bits: int = BITS) -> Blocks:
    """Return blocks from a mask of those that are not empty, shape (nx, ny, nz) in blocks."""
    distance = chebyshev_distance(filled)
    _, ny, nz = filled.shape
    return Blocks(
        backend.UInt(distance.reshape(-1).astype(np.uint32)),
        (dr.opaque(backend.UInt, ny), dr.opaque(backend.UInt, nz)),
        float(filled.mean()),
        bits,
    )


def chebyshev_distance(filled: np.ndarray, most: int = 15) -> np.ndarray:
    """Return how many blocks away the nearest filled one is, along the axis where it is farthest.

    Counted up to `most`: longer leaps hardly save time, and each count is one pass over the blocks.
    Beyond the volume's faces nothing is filled.
    """
    empty = ~filled
    distance = empty.astype(np.uint8)
    for _ in range(1, most):
        for axis in range(3):
            empty = _eroded(empty, axis)
        if not empty.any():
            break
        distance += empty
    return distance


def _eroded(empty: np.ndarray, axis: int) -> np.ndarray:
    """Return where a place and both its neighbours along an axis are empty."""
    moved = np.moveaxis(empty, axis, 0)
    result = moved.copy()
    result[1:] &= moved[:-1]
    result[:-1] &= moved[1:]
    return np.moveaxis(result, 0, axis)


def leap(walk: CartesianWalk, track: Track, cursor: Cursor, blocks: Blocks) -> Leap:
    """Move rays to where they enter the next block that is not empty; those in one stay."""

    def searching(state: Leap) -> Any:
        return ~state.found

    def cross(state: Leap) -> tuple[Leap]:
        return (_cross(walk, track, state, blocks),)

    start = Leap(cursor, cursor.t, cursor.inside & False, ~cursor.inside)
    (state,) = dr.while_loop((start,), searching, cross, label="leap")
    return state


def _cross(walk: CartesianWalk, track: Track, state: Leap, blocks: Blocks) -> Leap:
    """Return rays at the far side of the empty cube they are in, or told where their block ends."""
    cursor, real = state.cursor, walk.backend.Float
    down = [stride < 0 for stride in track.cell_stride]
    distance, block = _look_up(walk, cursor, down, blocks)
    reach = dr.select(distance > 1, walk.backend.Int(distance), 1)
    walls = [
        real(_far_wall(b, reach, d, axis.last_cell + 1, blocks.bits))
        for b, d, axis in zip(block, down, walk.axes, strict=True)
    ]
    ways = [
        axis.crossing(t, w - 1.0) for axis, t, w in zip(walk.axes, track.axes, walls, strict=True)
    ]
    t, through = least(ways), nearest(ways)
    empty = (distance > 0) & ~state.found
    # A block is always entered, even if rounding puts its far wall where the ray is already.
    leave = dr.select(t > cursor.t, t, dr.fma(dr.abs(cursor.t), 1e-6, cursor.t) + 1e-6)
    index = [
        dr.select(crossed, w, _cell_ahead(axis, a, t, i, w - 1.0))
        for crossed, w, axis, a, i in zip(
            through, walls, walk.axes, track.axes, cursor.index, strict=True
        )
    ]
    there = walk.at(track, index, t)
    return Leap(
        dr.select(empty, there, cursor),
        dr.select(empty, state.leave, leave),
        state.moved | empty,
        ~empty | ~there.inside,
    )


def _look_up(
    walk: CartesianWalk, cursor: Cursor, down: list[Any], blocks: Blocks
) -> tuple[Any, list[Any]]:
    """Return the distance of the block a ray is in, and the block's place along each axis."""
    Int, UInt = walk.backend.Int, walk.backend.UInt
    block = []
    for i, is_down, axis in zip(cursor.index, down, walk.axes, strict=True):
        mirrored = Int(i)
        own = dr.select(is_down, axis.last_cell - mirrored, mirrored)
        block.append(dr.clip(own, 0, axis.last_cell) >> blocks.bits)
    ny, nz = blocks.shape
    flat = (UInt(block[0]) * ny + UInt(block[1])) * nz + UInt(block[2])
    return dr.gather(UInt, blocks.distance, flat, cursor.inside), block


def _far_wall(block: Any, reach: Any, down: Any, count: Any, bits: int) -> Any:
    """Return the mirrored number of the wall at the far side of a cube of blocks around one."""
    up_wall = (block + reach) << bits
    up_wall = dr.select(up_wall < count, up_wall, count)
    down_wall = (block - reach + 1) << bits
    down_wall = count - dr.select(down_wall > 0, down_wall, 0)
    return dr.select(down, down_wall, up_wall)


def _cell_ahead(axis: Any, track: Any, t: Any, low: Any, high: Any) -> Any:
    """Return the mirrored cell a ray is in at distance `t`, between two others.

    If rounding puts a wall of it behind the ray, that wall has been crossed.
    """
    index = axis.cell_at(track, t)
    index = dr.select(index > low, index, low)
    index = dr.select(index < high, index, high)
    passed = (axis.crossing(track, index) <= t) & (index < high)
    return dr.select(passed, index + 1.0, index)
