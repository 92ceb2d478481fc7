"""Values and gradients of a scalar on the cells of a volume, in pieces of bounded memory."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..derivatives import BoxesOfTree, NeighbourDifferences, differences
from ..expressions import Expression
from ..volume import Volume

# Cells of a run: the cells of trees that follow each other are neighbours, so of large ones many
# short runs are looked at.
_RUN = 1 << 12
# Runs of a piece: one after the other they took four times as long (1.2 million cells, 0.4 s for
# each field), since a run is too short for more than one thread.
_RUNS = 64
# What a cell costs, neighbours and all, beside one in an array: so fewer are looked at.
_DEAR = 16
# LineSamples through the domain along each axis, and points on each.
_LINES, _POINTS = 32, 256


class ScatteredPiece:
    """Some cells. Lengths are in units of the grid's scale; see `samples.LayerPiece`.

    Neighbours are looked for only where slopes are asked for: that takes most of the time.

    Parameters
    ----------
    cells : NeighbourDifferences or BoxesOfTree
    volumes : array
        Of all cells.
    runs : sequence of (int, int)
        First and last numbers of cells that follow each other.

    Attributes
    ----------
    x, slope, reach, volume : arrays, shape (n,)
        As of a `LayerPiece`; the reach is measured along the cell's own coordinates.
    """

    def __init__(
        self,
        cells: NeighbourDifferences | BoxesOfTree,
        volumes: np.ndarray,
        runs: Sequence[tuple[int, int]],
    ) -> None:
        self._cells, self._runs = cells, runs
        self.volume = np.concatenate([volumes[first:last] for first, last in runs])
        x = np.concatenate([cells.values[first:last] for first, last in runs])
        self.x = np.where(np.isfinite(x), x, np.nan)

    @functools.cached_property
    def _looked_at(self) -> tuple[np.ndarray, np.ndarray]:
        """The gradients, per length of the grid's unit, and which cells are at the surface."""
        with np.errstate(all="ignore"):
            gradient, surface = self._cells.gradient(self._runs)
        return np.where(np.isfinite(gradient), gradient, 0.0), surface

    @property
    def slope(self) -> np.ndarray:
        """|∇x|."""
        gradient, _ = self._looked_at
        # Not by squares, which leave the range of numbers where x is very large or small.
        return np.asarray(np.hypot.reduce(gradient, axis=0) * self._cells.grid.scale)

    @functools.cached_property
    def reach(self) -> np.ndarray:
        """How far x goes from its value at the centre, up and down."""
        grid, (gradient, _) = self._cells.grid, self._looked_at
        basis = np.concatenate([grid.basis(*run) for run in self._runs], axis=-1)
        sizes = np.concatenate([grid.cell_sizes(*run) for run in self._runs], axis=-1)
        along = np.einsum("kan,an->kn", basis, gradient)
        return np.asarray(0.5 * np.sum(np.abs(along) * sizes, axis=0))

    def seen(self, mean: np.ndarray) -> list[np.ndarray]:
        """Return nothing: lines go through cells that are elsewhere; see `lines`."""
        return []

    def outermost(self) -> np.ndarray:
        """Return the scalar in the cells with nothing beyond one of their faces."""
        return np.asarray(self.x[self._looked_at[1]])


def scattered_pieces(volume: Volume, expr: Expression, budget: float) -> Iterator[ScatteredPiece]:
    """Yield all cells in pieces, or every k-th run where there are more cells than `budget`."""
    grid = volume.grid
    cells = differences(grid, lambda first, last: volume.evaluate_cells(expr, first, last))
    volumes = np.reshape(grid.cell_volumes, -1) / grid.scale**3
    count = -(-grid.size // _RUN)
    step = min(count, max(1, int(np.ceil(_DEAR * grid.size / budget))))
    runs = [(k * _RUN, min((k + 1) * _RUN, grid.size)) for k in range((step - 1) // 2, count, step)]
    for first in range(0, len(runs), _RUNS):
        yield ScatteredPiece(cells, volumes, runs[first : first + _RUNS])


@dataclass
class LineSamples:
    """A scalar along lines through the domain: pieces between one cell's middle and the next.

    Attributes
    ----------
    x, reach : arrays, shape (n,)
        Mean and half difference of the scalar at the ends of a piece.
    length : array, shape (n,)
        In units of the grid's scale.
    line : int array, shape (n,)
        Which line a piece is of.
    """

    x: np.ndarray
    reach: np.ndarray
    length: np.ndarray
    line: np.ndarray

    def seen(self, mean: np.ndarray) -> np.ndarray:
        """Return the lengths that lines see of something."""
        return np.bincount(self.line, mean * self.length)


def lines(volume: Volume, expr: Expression) -> LineSamples:
    """Return a scalar along lines through the domain, parallel to x, y and z."""
    grid = volume.grid
    values = volume.evaluate(expr).reshape(-1).astype(np.float64)
    found = []
    for axis in range(3):
        points, step = _points_on_lines(grid.bounds, axis)
        cell = grid.locate(points).reshape(_LINES**2, _POINTS)
        found.append(_along(cell, values, step / grid.scale, axis * _LINES**2))
    return LineSamples(*(np.concatenate(parts) for parts in zip(*found, strict=True)))


def _points_on_lines(bounds: np.ndarray, axis: int) -> tuple[np.ndarray, float]:
    """Return points (lines * points, 3) on a regular set of lines, and their distance."""
    counts = [_POINTS if a == axis else _LINES for a in range(3)]
    places = [
        low + (np.arange(n) + 0.5) / n * (high - low)
        for (low, high), n in zip(bounds, counts, strict=True)
    ]
    mesh = np.stack(np.meshgrid(*places, indexing="ij"), axis=-1)
    points = np.moveaxis(mesh, axis, 2).reshape(-1, 3)
    return points, float(np.ptp(bounds[axis])) / _POINTS


def _along(cell: np.ndarray, values: np.ndarray, step: float, first: int) -> tuple[np.ndarray, ...]:
    """Return `LineSamples` of the cells (lines, points) that points on lines are in."""
    changes = np.diff(cell, axis=1, prepend=-2) != 0
    starts = np.flatnonzero(changes)
    ends = np.append(starts[1:], cell.size)
    middle, line, own = 0.5 * (starts + ends), starts // cell.shape[1], cell.reshape(-1)[starts]
    x = np.where(own >= 0, values[own], np.nan)
    x[~np.isfinite(x)] = np.nan
    good = (line[1:] == line[:-1]) & np.isfinite(x[1:]) & np.isfinite(x[:-1])
    before, behind = x[:-1][good], x[1:][good]
    length = step * (middle[1:] - middle[:-1])[good]
    return 0.5 * (before + behind), 0.5 * np.abs(behind - before), length, first + line[:-1][good]


# Cells sampled: enough for any median or histogram, and a second of work at most.
BUDGET = 1 << 22
# Cells of a piece: its temporary arrays take some tens of MiB.
_PIECE = 1 << 19


@dataclass
class Between:
    """A scalar from one cell centre to the next, where it is linear; see `LayerPiece`."""

    x: np.ndarray
    reach: np.ndarray
    slope: np.ndarray
    volume: np.ndarray

    def seen(self, mean: np.ndarray) -> list[np.ndarray]:
        """Return nothing: along the other axes no line is looked at."""
        return []


class LayerPiece:
    """Whole layers of the first axis. Lengths are in units of the grid's scale.

    Parameters
    ----------
    around : array, shape (layers, ny, nz)
        The scalar at the cell centres, with a layer more on each side where there is one.
    edges : list of three arrays
        Edges of these cells.
    own : slice
        Which layers are the piece's.
    is_uniform : bool
        All cells are alike.

    Attributes
    ----------
    x : array, shape (layers, ny, nz)
        The scalar; NaN where it is not finite.
    widths : list of three arrays
        Cell widths, each with three axes.
    first : bool
        Here the domain begins.
    """

    def __init__(
        self, around: np.ndarray, edges: list[np.ndarray], own: slice, *, is_uniform: bool
    ) -> None:
        self._around, self._edges, self._own, self._uniform = around, edges, own, is_uniform
        self.x = np.where(np.isfinite(around[own]), around[own], np.nan)
        self.widths = [_samples_along(np.diff(e), axis) for axis, e in enumerate(edges)]
        self.widths[0] = self.widths[0][own]
        self.first = own.start == 0

    @functools.cached_property
    def _slopes(self) -> list[np.ndarray]:
        """|∂x/∂i| along the axes: a third of those who look at values ask for none."""
        return [
            np.abs(_derivative(self._around, self._edges[axis], axis, self._uniform)[self._own])
            for axis in range(3)
        ]

    @functools.cached_property
    def slope(self) -> np.ndarray:
        """|∇x| at the centres."""
        # Not by squares, which leave the range of numbers where x is very large or small.
        return np.asarray(functools.reduce(np.hypot, self._slopes))

    @functools.cached_property
    def reach(self) -> np.ndarray:
        """How far x goes from its value at the centre, up and down, in cells where it is linear.

        ½ Σ |∂x/∂i| hᵢ.
        """
        pairs = zip(self._slopes, self.widths, strict=True)
        return np.asarray(sum(0.5 * slope * width for slope, width in pairs))

    @property
    def volume(self) -> np.ndarray:
        """Volumes of the cells, of a shape that broadcasts."""
        return self.widths[0] * self.widths[1] * self.widths[2]

    def seen(self, mean: np.ndarray) -> list[np.ndarray]:
        """Return the lengths that lines along y and z see of something."""
        return [(mean * self.widths[axis]).sum(axis=axis).ravel() for axis in (1, 2)]

    def between(self) -> Iterator[Between]:
        """Yield the scalar from each centre to the next one, along the three axes."""
        for axis in range(3):
            # Of the first axis also on to the layer behind, which another piece begins with.
            own = slice(self._own.start, self._own.stop + (axis == 0))
            known = np.where(np.isfinite(self._around[own]), self._around[own], np.nan)
            edges = self._edges[axis][own.start : own.stop + 1] if axis == 0 else self._edges[axis]
            step = np.diff(0.5 * (edges[1:] + edges[:-1]))[:, None, None]
            across, along = (w for k, w in enumerate(self.widths) if k != axis)
            values = np.moveaxis(known, axis, 0)
            rise = np.abs(np.diff(values, axis=0))
            yield Between(
                0.5 * values[1:] + 0.5 * values[:-1],
                0.5 * rise,
                rise / step,
                step * np.moveaxis(across * along, axis, 0),
            )

    def outermost(self) -> np.ndarray:
        """Return the scalar in the outermost cells in y and z, and in x where the domain begins."""
        x = self.x
        faces = [x[:, 0], x[:, -1], x[:, :, 0], x[:, :, -1], *([x[0]] if self.first else [])]
        return np.concatenate([face.ravel() for face in faces])


def pieces(
    volume: Volume, expr: Expression, budget: float = BUDGET
) -> Iterator[LayerPiece | ScatteredPiece]:
    """Yield all pieces of a volume, or every k-th if there are more cells than `budget`."""
    volume.check_names(expr)
    if not volume.grid.is_rectilinear:
        yield from scattered_pieces(volume, expr, budget)
        return
    for first, stop in _parts(volume.grid.shape, budget):
        yield _piece(volume, expr, first, stop)


def _parts(shape: tuple[int, ...], budget: float) -> list[tuple[int, int]]:
    layers, size = shape[0], int(np.prod(shape, dtype=object))
    thick = max(1, _PIECE * layers // size)
    count = -(-layers // thick)
    step = min(count, max(1, int(np.ceil(size / budget))))
    return [(k * thick, min((k + 1) * thick, layers)) for k in range((step - 1) // 2, count, step)]


def _piece(volume: Volume, expr: Expression, first: int, stop: int) -> LayerPiece:
    """Return the layers from `first` to `stop`; differences look one layer further."""
    low, high = max(0, first - 1), min(volume.grid.shape[0], stop + 1)
    own = slice(first - low, stop - low)
    x = _evaluate(volume, expr, low, high)
    edges = [e / volume.grid.scale for e in volume.grid.edges]
    edges[0] = edges[0][low : high + 1]
    return LayerPiece(x, edges, own, is_uniform=volume.grid.is_uniform)


def _evaluate(volume: Volume, expr: Expression, low: int, high: int) -> np.ndarray:
    _, ny, nz = volume.grid.shape
    x = volume.evaluate_cells(expr, low * ny * nz, high * ny * nz).reshape(-1, ny, nz)
    # In cgs units differences in single precision would have few digits, or none.
    return np.array(x, dtype=np.float64)


def _derivative(x: np.ndarray, edges: np.ndarray, axis: int, uniform: bool) -> np.ndarray:
    """Return ∂x/∂axis by central differences; zero where it is not finite, or there is one cell."""
    if x.shape[axis] < 2:
        return np.zeros_like(x)
    centers = 0.5 * (edges[1:] + edges[:-1])
    spacing = (edges[-1] - edges[0]) / (len(edges) - 1) if uniform else centers
    with np.errstate(all="ignore"):
        slope = np.gradient(x, spacing, axis=axis)
    slope[~np.isfinite(slope)] = 0.0
    return slope


def _samples_along(values: np.ndarray, axis: int) -> np.ndarray:
    return values.reshape([-1 if k == axis else 1 for k in range(3)])
