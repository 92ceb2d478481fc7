"""Cells that hold no value: transparent, whatever a scheme would make of them."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...backend import dr
from ...backend.types import Float, Int, Mask
from ...grids.contract import Segment
from ...grids.two_walks import TwoWalks, cell_of
from ...schemes.base import Position, Scheme, Solution
from ...schemes.path import empty_path


class Hidden:
    """Which cells show nothing, one bit each.

    Parameters
    ----------
    missing : array of bool
        One per cell, in the order of their numbers.
    """

    def __init__(self, missing: np.ndarray) -> None:
        self.count = int(missing.sum())
        packed = np.packbits(missing.reshape(-1), bitorder="little")
        self.words = np.pad(packed, (0, -len(packed) % 4)).view("<u4")

    def on(self, backend: Any) -> Any:
        """Return the bits where kernels find them."""
        return backend.UInt(np.ascontiguousarray(self.words, np.uint32))


def through_cells(walk: Any, grid: Any, backend: Any) -> Any:
    """Return a walk whose segments lie in one cell of the grid each."""
    return walk if walk.in_cells else TwoWalks(walk, grid.walk(backend))


class Hiding(Scheme):
    """A scheme that leaves out segments in hidden cells; otherwise it is another."""

    def __init__(self, scheme: Scheme, bits: Int) -> None:
        self.scheme, self.bits = scheme, bits
        self.name, self.coefficients_at = scheme.name, scheme.coefficients_at
        self.controlled = scheme.controlled

    def start(self, position: Position, source: Any) -> list[Float]:
        return self.scheme.start(position, source)

    def after_skip(
        self, position: Position, source: Any, carried: list[Float], moved: Mask
    ) -> list[Float]:
        return self.scheme.after_skip(position, source, carried, moved)

    def solve(
        self, segment: Segment, source: Any, carried: list[Float]
    ) -> tuple[Solution, list[Float]]:
        cell = cell_of(segment)
        word = dr.gather(type(self.bits), self.bits, cell >> 5, segment.active)
        hidden = (word >> (cell & 31)) & 1 == 1
        found, onward = self.scheme.solve(segment, source, carried)
        parts = (found.emission, found.transparency, found.error)
        nothing = empty_path(type(segment.length), *(len(part) for part in parts))
        beyond = self.scheme.after_hidden(carried, onward)
        return dr.select(hidden, nothing, found), dr.select(hidden, beyond, onward)
