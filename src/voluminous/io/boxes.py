"""Boxes of arrays whose axes a file has in another order, or runs through backwards."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence

import numpy as np

from ..deferred import Pieces
from ..store import level_factors

Load = Callable[[tuple[slice, ...], int], np.ndarray]


def boxes(
    load: Load,
    shapes: Sequence[tuple[int, ...]],
    chunks: Sequence[int] = (),
    order: Sequence[int] = (0, 1, 2),
    backward: Sequence[bool] = (False, False, False),
) -> Pieces:
    """Return how boxes of a field are read from a file.

    Parameters
    ----------
    load : callable
        Returns a part of the array of a level, by a slice for each of the file's axes. A volume
        goes to other processes if this can be pickled: no function within another.
    shapes : sequence of tuples
        Shapes of the levels in the file's axes, finest first. Those from the first on whose cells
        do not cover powers of two of the finest are left out.
    chunks : sequence of int
        Cells of the stored pieces; empty if any box is as good.
    order, backward
        The file's axes that become the grid's, and which of the grid's run against them.
    """

    def turned(numbers: Sequence[int]) -> tuple[int, ...]:
        return tuple(int(numbers[source]) for source in order)

    sides, coarser = turned(shapes[0]), []
    for shape in shapes[1:]:
        factors = level_factors(sides, turned(shape))
        # Backwards, the cell that covers fewer would be the first.
        ends = zip(sides, factors or sides, backward, strict=True)
        if factors is None or any(back and n % f for n, f, back in ends):
            break
        coarser.append(turned(shape))
    read = functools.partial(_read, load, tuple(shapes), tuple(order), tuple(backward))
    return Pieces(read, turned(chunks) if chunks else None, tuple(coarser))


def _read(
    load: Load,
    shapes: Sequence[tuple[int, ...]],
    order: Sequence[int],
    backward: Sequence[bool],
    low: Sequence[int],
    high: Sequence[int],
    level: int,
) -> np.ndarray:
    index = [slice(None)] * len(order)
    for a, b, source, back in zip(low, high, order, backward, strict=True):
        n = shapes[level][source]
        index[source] = slice(n - b, n - a) if back else slice(a, b)
    values = np.transpose(load(tuple(index), level), order)
    return np.asarray(values[tuple(slice(None, None, -1 if b else None) for b in backward)])
