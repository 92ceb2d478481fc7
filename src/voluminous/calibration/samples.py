"""Values and gradients of a scalar on the cells of a volume, in runs of bounded memory.

Lengths are in units of the grid's scale.
"""

from __future__ import annotations

import contextvars
import functools
import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import TypeAlias, TypeVar

import numpy as np

from ..derivatives import BoxesOfTree, NeighbourDifferences, differences
from ..expressions import Expression
from ..grids.cartesian.grid import CartesianGrid
from ..grids.contract import basis
from ..levels import kept_level, level_within
from ..volume import Volume

# Cells sampled: enough for any median or histogram, and a second of work at most.
BUDGET = 1 << 22
# They are taken in so many batches: their temporary arrays take some tens of MiB.
_BATCHES = 8
# Threads that measure batches: each has such arrays.
_THREADS = 4
# On trees consecutive cells are neighbours: of large trees many short runs are sampled, and a run
# has many of them, since one is too short for more than one thread (four times as fast).
_RUN, _RUNS = 1 << 12, 64
# Cost of a cell whose neighbours are searched for, relative to one of an array.
_SEARCH = 16
# Lines through the domain along each axis, and points on each.
_LINES, _POINTS = 32, 256


Item = TypeVar("Item")
Made = TypeVar("Made")


@dataclass
class Samples:
    """A scalar in regions of space where it is linear, each perhaps on a numbered line.

    Its value in the middle (NaN where it is not finite), the largest distance `reach` of its values
    from that, |∇x|, and volumes, of a shape that broadcasts.
    """

    x: np.ndarray
    reach: np.ndarray
    slope: np.ndarray
    volume: np.ndarray
    line: np.ndarray | None = None

    def lengths_along_lines(self, mean: np.ndarray) -> list[np.ndarray]:
        """Return the lengths that lines see of something with this mean in each part."""
        return [] if self.line is None else [np.bincount(self.line, mean * self.volume)]


class CellRuns:
    """Runs of cells of any grid; neighbours are searched for only if slopes are used."""

    def __init__(
        self,
        cells: NeighbourDifferences | BoxesOfTree,
        volumes: np.ndarray,
        runs: Sequence[tuple[int, int]],
    ) -> None:
        self._cells, self._runs = cells, runs
        self.volume = np.concatenate([volumes[first:last] for first, last in runs])
        self.x = _finite(np.concatenate([cells.values[first:last] for first, last in runs]))

    @functools.cached_property
    def _gradient(self) -> tuple[np.ndarray, np.ndarray]:
        with np.errstate(all="ignore"):
            gradient, surface = self._cells.gradient(self._runs)
        return np.where(np.isfinite(gradient), gradient, 0.0), surface

    @functools.cached_property
    def slope(self) -> np.ndarray:
        # Squares would overflow or underflow where x is very large or small.
        return np.asarray(np.hypot.reduce(self._gradient[0], axis=0) * self._cells.grid.scale)

    @functools.cached_property
    def reach(self) -> np.ndarray:
        """Half the sum of the changes over the cell along each of its coordinates."""
        grid = self._cells.grid
        vectors = np.concatenate([basis(grid, *run) for run in self._runs], axis=-1)
        sizes = np.concatenate([grid.cell_sizes(*run) for run in self._runs], axis=-1)
        along = np.einsum("kan,an->kn", vectors, self._gradient[0])
        return np.asarray(0.5 * np.sum(np.abs(along) * sizes, axis=0))

    def lengths_along_lines(self, mean: np.ndarray) -> list[np.ndarray]:
        return []

    def outermost(self) -> np.ndarray:
        """Return the scalar in the cells at the surface of the domain."""
        return np.asarray(self.x[self._gradient[1]])


class GridLayers:
    """GridLayers of the first axis of a rectilinear grid, from `first` to `stop`."""

    def __init__(self, volume: Volume, expr: Expression, first: int, stop: int) -> None:
        grid, (count, ny, nz) = volume.grid, volume.grid.shape
        low, high = max(0, first - 1), min(count, stop + 1)  # differences need the layers beside
        x = volume.evaluate_cells(expr, low * ny * nz, high * ny * nz).reshape(-1, ny, nz)
        # In cgs units differences in single precision would have few digits, or none.
        self._around = _finite(x.astype(np.float64))
        self._layers = slice(first - low, stop - low)
        self._edges = [edges / grid.scale for edges in grid.edges]
        self._edges[0] = self._edges[0][low : high + 1]
        self._uniform = grid.is_uniform
        self.x = self._around[self._layers]
        self._widths = [
            np.diff(e).reshape([-1 if k == axis else 1 for k in range(3)])
            for axis, e in enumerate(self._edges)
        ]
        self._widths[0] = self._widths[0][self._layers]

    @functools.cached_property
    def _slopes(self) -> list[np.ndarray]:
        """|∂x/∂i| along the axes, by central differences; zero where that is not finite."""
        found = []
        for axis, edges in enumerate(self._edges):
            slope = np.zeros_like(self._around)
            if len(edges) > 2:
                centers = 0.5 * (edges[1:] + edges[:-1])
                spacing = (edges[-1] - edges[0]) / len(centers) if self._uniform else centers
                with np.errstate(all="ignore"):
                    slope = np.gradient(self._around, spacing, axis=axis)
            slope[~np.isfinite(slope)] = 0.0
            found.append(np.abs(slope[self._layers]))
        return found

    @functools.cached_property
    def slope(self) -> np.ndarray:
        # Squares would overflow or underflow where x is very large or small.
        return np.asarray(functools.reduce(np.hypot, self._slopes))

    @functools.cached_property
    def reach(self) -> np.ndarray:
        pairs = zip(self._slopes, self._widths, strict=True)
        return np.asarray(sum(0.5 * slope * width for slope, width in pairs))

    @property
    def volume(self) -> np.ndarray:
        return np.asarray(self._widths[0] * self._widths[1] * self._widths[2])

    def lengths_along_lines(self, mean: np.ndarray) -> list[np.ndarray]:
        return [(mean * self._widths[axis]).sum(axis=axis).ravel() for axis in (1, 2)]

    def outermost(self) -> np.ndarray:
        """Return the scalar in the outermost cells in y and z, and in x where the domain begins."""
        x, begins = self.x, self._layers.start == 0
        faces = [x[:, 0], x[:, -1], x[:, :, 0], x[:, :, -1], *([x[0]] if begins else [])]
        return np.concatenate([face.ravel() for face in faces])

    def between_centers(self) -> Iterator[Samples]:
        """Yield the scalar from each centre to the next one, along the three axes."""
        for axis in range(3):
            # Along the first axis also to the layer behind, with which another run begins.
            some = slice(self._layers.start, self._layers.stop + (axis == 0))
            walls = slice(some.start, some.stop + 1) if axis == 0 else slice(None)
            edges = self._edges[axis][walls]
            step = np.diff(0.5 * (edges[1:] + edges[:-1]))[:, None, None]
            across, along = (w for k, w in enumerate(self._widths) if k != axis)
            x = np.moveaxis(self._around[some], axis, 0)
            rise = np.abs(np.diff(x, axis=0))
            area = np.moveaxis(across * along, axis, 0)
            yield Samples(0.5 * x[1:] + 0.5 * x[:-1], 0.5 * rise, rise / step, step * area)


Run: TypeAlias = Samples | CellRuns | GridLayers


def measurable(volume: Volume) -> Volume:
    """Return the level of a large volume that has few enough cells to be measured; else itself.

    Of a file that is larger than memory most would be read: a layer of cells is in many chunks.
    """
    level: Volume = kept_level(volume, level_within(volume, BUDGET))
    return level


def cell_runs(
    volume: Volume, expr: Expression, budget: float = BUDGET
) -> Iterator[GridLayers | CellRuns]:
    """Yield all cells, or evenly spread runs if there are more than `budget`."""
    volume.check_names(expr)
    grid = volume.grid
    if isinstance(grid, CartesianGrid):
        thick = max(1, int(min(budget, BUDGET)) * grid.shape[0] // grid.size // _BATCHES)
        for run in _runs(grid.shape[0], thick, grid.size / budget):
            yield GridLayers(volume, expr, *run)
        return
    cells = differences(grid, lambda first, last: volume.evaluate_cells(expr, first, last))
    volumes = np.reshape(grid.cell_volumes, -1) / grid.scale**3
    runs = _runs(grid.size, _RUN, _SEARCH * grid.size / budget)
    for first in range(0, len(runs), _RUNS):
        yield CellRuns(cells, volumes, runs[first : first + _RUNS])


def of_runs(
    work: Callable[[GridLayers | CellRuns], Made],
    volume: Volume,
    expr: Expression,
    budget: float = BUDGET,
) -> Iterator[Made]:
    """Yield what `work` returns of each of the `cell_runs`, several of large arrays at a time."""
    runs, grid = cell_runs(volume, expr, budget), volume.grid
    many = isinstance(grid, CartesianGrid) and grid.size > BUDGET // _BATCHES
    return side_by_side(work, runs) if many else map(work, runs)


def side_by_side(work: Callable[[Item], Made], items: Iterable[Item]) -> Iterator[Made]:
    """Yield what `work` returns of items, in order; NumPy's loops run beside each other."""
    allowed = getattr(os, "sched_getaffinity", None)  # Linux
    threads = min(len(allowed(0)) if allowed else os.cpu_count() or 1, _THREADS)
    pending: deque[Future[Made]] = deque()
    with ThreadPoolExecutor(threads) as pool:
        for item in items:
            pending.append(pool.submit(contextvars.copy_context().run, work, item))
            if len(pending) > threads:
                yield pending.popleft().result()
        while pending:
            yield pending.popleft().result()


def _runs(size: int, length: int, excess: float) -> list[tuple[int, int]]:
    """Return runs of numbers below `size`, of which every k-th is taken if there is an excess."""
    count = -(-size // length)
    step = min(count, max(1, int(np.ceil(excess))))
    return [(k * length, min((k + 1) * length, size)) for k in range((step - 1) // 2, count, step)]


def between_centers(volume: Volume, expr: Expression) -> Iterator[Samples]:
    """Yield a scalar from one cell's centre to the next: where it jumps, no cell shows a slope."""
    if not isinstance(volume.grid, CartesianGrid):
        yield lines(volume, expr)
        return
    for run in cell_runs(volume, expr):
        assert isinstance(run, GridLayers)
        yield from run.between_centers()


def lines(volume: Volume, expr: Expression) -> Samples:
    """Return a scalar along lines through the domain, parallel to x, y and z.

    They reach from the middle of a line's path in one cell to that in the next; their volumes are
    lengths.
    """
    grid = volume.grid
    values = _finite(volume.evaluate(expr).reshape(-1).astype(np.float64))
    columns = []
    for axis in range(3):
        counts = [_POINTS if a == axis else _LINES for a in range(3)]
        places = [
            low + (np.arange(n) + 0.5) / n * (high - low)
            for (low, high), n in zip(grid.bounds, counts, strict=True)
        ]
        mesh = np.stack(np.meshgrid(*places, indexing="ij"), axis=-1)
        cell = grid.locate(np.moveaxis(mesh, axis, 2).reshape(-1, 3))
        new = np.diff(cell.reshape(_LINES**2, _POINTS), axis=1, prepend=-2) != 0
        starts = np.flatnonzero(new)
        middle = 0.5 * (starts + np.append(starts[1:], cell.size))
        line, here = starts // _POINTS, cell[starts]
        x = np.where(here >= 0, values[here], np.nan)
        good = (line[1:] == line[:-1]) & ~np.isnan(x[1:]) & ~np.isnan(x[:-1])
        step = float(np.ptp(grid.bounds[axis])) / _POINTS / grid.scale
        length, rise = step * np.diff(middle)[good], np.abs(np.diff(x)[good])
        mean = 0.5 * (x[1:] + x[:-1])[good]
        columns.append((mean, 0.5 * rise, rise / length, length, axis * _LINES**2 + line[1:][good]))
    return Samples(*(np.concatenate(column) for column in zip(*columns, strict=True)))


def _finite(x: np.ndarray) -> np.ndarray:
    return np.where(np.isfinite(x), x, np.nan)
