"""Cells that hold no value: transparent, whatever a scheme would make of them."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...backend import dr
from ...grids.two_walks import TwoWalks, cell_of
from ...schemes.contract import carried_beyond
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


class Hiding:
    """A scheme that leaves out segments in hidden cells; otherwise it is another."""

    def __init__(self, scheme: Any, bits: Any) -> None:
        self.scheme, self.bits = scheme, bits

    def __getattr__(self, name: str) -> Any:
        return getattr(self.scheme, name)

    def solve(
        self, source: Any, walk: Any, track: Any, segment: Any, carried: list[Any], backward: bool
    ) -> tuple[Any, list[Any]]:
        """Return the segment's solution, and what to carry on."""
        cell = cell_of(segment)
        word = dr.gather(type(self.bits), self.bits, cell >> 5, segment.active)
        hidden = (word >> (cell & 31)) & 1 == 1
        found, onward = self.scheme.solve(source, walk, track, segment, carried, backward)
        parts = (found.emission, found.transparency, found.error)
        nothing = empty_path(type(segment.length), *(len(part) for part in parts))
        beyond = carried_beyond(self.scheme, carried, onward)
        return dr.select(hidden, nothing, found), dr.select(hidden, beyond, onward)
