"""Consecutive cells of a grid, as a grid: what a part of a volume is defined on."""

from __future__ import annotations

import numpy as np

from .contract import BoxGrid, Grid, native_centers


class SomeCells(BoxGrid):
    """The cells from `first` to `last` of a grid. It is not walked through: `whole` is.

    Parameters
    ----------
    whole : Grid
    first, last : int
        Numbers of the first cell, and of the one after the last.
    """

    kind = "cells"
    size, shape, scale = 0, (0,), 1.0

    def __init__(self, whole: Grid, first: int, last: int) -> None:
        self.whole, self.first = whole, first
        self.size, self.shape = last - first, (last - first,)
        self.unit, self.scale, self.coordinates = whole.unit, whole.scale, whole.coordinates
        self.mirror = whole.mirror

    def cell_centers(self, first: int = 0, last: int | None = None) -> np.ndarray:
        return self.whole.cell_centers(*self._numbers(first, last))

    def native_centers(self, first: int = 0, last: int | None = None) -> np.ndarray:
        return native_centers(self.whole, *self._numbers(first, last))

    def cell_sizes(self, first: int = 0, last: int | None = None) -> np.ndarray:
        return self.whole.cell_sizes(*self._numbers(first, last))

    @property
    def cell_volumes(self) -> np.ndarray:
        """Volumes of the cells, of octrees and patches."""
        return np.asarray(np.prod(self.cell_sizes(), axis=0))

    def _numbers(self, first: int, last: int | None) -> tuple[int, int]:
        return self.first + first, self.first + (self.size if last is None else last)
