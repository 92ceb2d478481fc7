"""Values and gradients of a scalar on the cells of a volume, in pieces of bounded memory."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..expressions import Expression
from ..volume import Volume
from .scattered import ScatteredPiece, scattered_pieces

# Cells looked at: enough for any median or histogram, and a second of work at most.
BUDGET = 1 << 22
# Cells of a piece: its temporary arrays take some tens of MiB.
_PIECE = 1 << 19


@dataclass
class Between:
    """A scalar from one cell centre to the next, where it is linear; see `Piece`."""

    x: np.ndarray
    reach: np.ndarray
    slope: np.ndarray
    volume: np.ndarray

    def seen(self, mean: np.ndarray) -> list[np.ndarray]:
        """Return nothing: along the other axes no line is looked at."""
        return []


class Piece:
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
        self.widths = [_along(np.diff(e), axis) for axis, e in enumerate(edges)]
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
) -> Iterator[Piece | ScatteredPiece]:
    """Yield pieces of a volume: all of it, or every k-th where there are more cells than `budget`.

    Parameters
    ----------
    volume : Volume
        On any grid; pieces of a `CartesianGrid` are layers, of others cells in the order they are.
    expr : Expression
        The scalar x.
    budget : float
        Number of cells to be looked at; infinity for all.

    Raises
    ------
    UnknownNameError
        If the expression names a field that does not exist.
    """
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


def _piece(volume: Volume, expr: Expression, first: int, stop: int) -> Piece:
    """Return the layers from `first` to `stop`; differences look one layer further."""
    low, high = max(0, first - 1), min(volume.grid.shape[0], stop + 1)
    own = slice(first - low, stop - low)
    x = _evaluate(volume, expr, low, high)
    edges = [e / volume.grid.scale for e in volume.grid.edges]
    edges[0] = edges[0][low : high + 1]
    return Piece(x, edges, own, is_uniform=volume.grid.is_uniform)


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


def _along(values: np.ndarray, axis: int) -> np.ndarray:
    return values.reshape([-1 if k == axis else 1 for k in range(3)])
