"""A field at the corners of cubes of 2, 4 and 8 dual cells, beside the field itself."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...backend import dr, from_host
from ...grids.cartesian.coarse_walk import CoarseChord, padded_count
from .lattice import Corners, Lattice, Nodes, Quads, faces


@dataclass
class Pyramid(Lattice):
    """Quads of every 2nd, 4th and 8th centre, one after the other, and all centres.

    Attributes
    ----------
    fine : Quads or Nodes
        All centres.
    data : array
        The quads of the coarser levels: an eighth of all for each level, or less.
    levels : list of tuples
        Per level, log2 of the cubes' size, where its quads begin, and how many there are along y
        and z.
    """

    fine: Quads | Nodes
    data: Any
    levels: list[tuple[Any, ...]]
    packet: Any

    def __post_init__(self) -> None:
        """Take the unit of the finest values."""
        self.unit = self.fine.unit

    def corners(self, chord: CoarseChord, active: Any) -> Corners:
        """Return the eight values around a cube of dual cells."""
        found: Corners = dr.if_stmt(
            args=(active,),
            cond=chord.width > 1.0,
            true_fn=functools.partial(self._coarse, chord),
            false_fn=functools.partial(self.fine.corners, chord),
        )
        return found

    def _coarse(self, chord: CoarseChord, active: Any) -> Corners:
        UInt = type(self.levels[0][0])
        wide = UInt(chord.width)
        step, first, ny, nz = self.levels[0]
        for level in self.levels[1:]:
            here = wide == (1 << level[0])
            step, first, ny, nz = (
                dr.select(here, a, b) for a, b in zip(level, (step, first, ny, nz), strict=True)
            )
        i, j, k = (UInt(b) >> step for b in chord.base)
        return faces(self.packet, self.data, first + (i * ny + j) * nz + k, ny * nz, active)


def make_pyramid(
    array: np.ndarray, fine: Quads | Nodes, steps: tuple[int, ...], backend: Any
) -> Pyramid:
    """Return the pyramid of a field, for steps of 2^k cells."""
    parts, levels, total = [], [], 0
    for step in steps:
        quads = _quads(array, step, backend.dtype, fine.unit)
        numbers = (step, total, *quads.shape[1:3])
        levels.append(tuple(dr.opaque(backend.UInt, n) for n in numbers))
        parts.append(quads.reshape(-1))
        total += parts[-1].size // 4
    # An array of Dr.Jit's own making: packets of one that NumPy made are not always aligned, and
    # then gathered number by number (core, 100³: 17 ms instead of 10).
    data = from_host(backend.Float, np.concatenate(parts))
    dr.eval(data)
    return Pyramid(fine, data, levels, backend.packet(4))


def _quads(array: np.ndarray, step: int, dtype: Any, unit: float) -> np.ndarray:
    cells = [padded_count(n) >> step for n in array.shape]
    place = [
        np.clip((np.arange(m + 1) << step) - 1, 0, n - 1)
        for m, n in zip(cells, array.shape, strict=True)
    ]
    nodes = array[np.ix_(*place)]
    nodes = (nodes / unit if unit != 1.0 else nodes).astype(dtype)
    quads = np.empty((cells[0] + 1, cells[1], cells[2], 4), dtype)
    for k, (y, z) in enumerate(((0, 0), (0, 1), (1, 0), (1, 1))):
        quads[..., k] = nodes[:, y : y + cells[1], z : z + cells[2]]
    return quads
