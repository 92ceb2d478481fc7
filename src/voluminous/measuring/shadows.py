"""Cells thrown onto pixels: each pixel gets what it shows of them, and nothing is lost.

A cell's shadow is cut into columns of pixels, one lane of a kernel for each; in every row the part
of the cell left of the column's right edge is known in closed form (`box_spline`). What a column
gets is the difference to the one before: the sum over all columns and rows is the whole cell,
however the parts were rounded.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..backend import dr, from_host
from ..errors import InputError
from .box_spline import Box, BoxSpline

# Numbers computed in one kernel: 16 bytes each.
_BATCH = 1 << 22
# What differences of parts are good to.
_NOISE = 1e-13
# Half a cell, in pixels. What a pixel shows of it is 1e-10 of it: a difference good to 1e-4.
_WIDEST = 1e5


@dataclass(frozen=True)
class Screen:
    """Square pixels in a plane: (u, v) in pixels are ``axes @ point + origin``."""

    axes: np.ndarray
    origin: np.ndarray
    pixels: tuple[int, int]


def onto_pixels(
    screen: Screen, centers: np.ndarray, sizes: np.ndarray, amounts: np.ndarray, backend: Any
) -> np.ndarray:
    """Return what the pixels get of amounts that are spread evenly in boxes.

    Parameters
    ----------
    centers, sizes : array, shape (3, n)
        The boxes.
    amounts : array, shape (k, n)
        What is in each of them.
    backend : Backend
        In double precision.

    Returns
    -------
    array, shape (k, ny, nx)
        Sums are those of `amounts`, but for what falls beside the frame.

    Raises
    ------
    InputError
        If pixels are so small that differences of a cell's parts have no digits left.
    """
    nx, ny = screen.pixels
    spline = BoxSpline(screen.axes.T)
    place = screen.axes @ centers + screen.origin[:, None]
    reach = 0.5 * np.abs(screen.axes) @ sizes
    edge = np.array([[nx], [ny]])
    seen = np.flatnonzero(np.all((place + reach > 0) & (place - reach < edge), axis=0))
    widest = float(reach[:, seen].max(initial=0.0))
    if widest > _WIDEST:
        raise InputError(
            f"method='exact' knows columns of cells up to {2 * _WIDEST:.0e} pixels wide, here one "
            f"is {2 * widest:.1e}; in pixels that small method='rays' is as good"
        )
    # Margins take what falls beside; of each pixel what is added and taken.
    total = np.zeros((len(amounts), 2 * (nx + 3) * (ny + 2)))
    for cells, columns, rows in _groups(reach, seen, screen.pixels):
        boxes = _Boxes(*(each[:, cells] for each in (place, reach, sizes, amounts)))
        parts, pixels = _shadows(spline, boxes, columns, rows, screen.pixels, backend)
        for sums, part in zip(total, parts, strict=True):
            sums += np.bincount(pixels, part, len(sums))
    whole, rest = np.moveaxis(total.reshape(len(amounts), ny + 2, nx + 3, 2), -1, 0)
    gross, passed = (whole + rest)[:, 1:-1, 2:-1], whole[:, 1:-1, 1:-2]
    found = gross - passed
    # Where a shadow only just begins or ends there is nothing but rounding.
    found[np.abs(found) < _NOISE * np.maximum(np.abs(gross), np.abs(passed))] = 0.0
    return np.asarray(found)


@dataclass
class _Boxes:
    """Where boxes are on the screen, how far they reach, their sizes, and what is in them."""

    place: np.ndarray
    reach: np.ndarray
    sizes: np.ndarray
    amounts: np.ndarray


def _groups(
    reach: np.ndarray, seen: np.ndarray, pixels: tuple[int, int]
) -> Iterator[tuple[np.ndarray, int, int]]:
    """Yield cells of about one size, and the columns and rows that their shadows take at most.

    Of those that are wider than the frame only what is in it counts, and one column and row before.
    """
    reach = np.minimum(reach, 0.5 * np.array(pixels)[:, None])
    kinds: Any = np.rint(2.0 * np.log2(2.0 * reach.max(axis=0) + 1.0)).astype(np.int8)
    for kind in np.flatnonzero(np.bincount(kinds - kinds.min())) + kinds.min():
        cells = seen[kinds[seen] == kind]
        if not cells.size:
            continue
        columns, rows = (int(n) + 1 for n in np.ceil(2.0 * reach[:, cells].max(axis=1)))
        step = max(1, _BATCH // (columns * rows))
        for first in range(0, len(cells), step):
            yield cells[first : first + step], columns, rows


@dataclass
class _Columns:
    """Columns of pixels in the shadows of boxes, one per lane.

    Attributes
    ----------
    box : Box
        How much of each box a quarter-plane covers.
    v, dv, bottom : arrays
        Where the box is along the column, how far it reaches, and the row in which it begins.
    number, right : arrays
        Which column, and where it ends, or the box, counted from the middle of that.
    last, active : masks
        Whether it is the last column of the shadow, and whether it is one at all.
    """

    box: Box
    v: Any
    dv: Any
    bottom: Any
    number: Any
    right: Any
    last: Any
    active: Any

    def below(self, row: Any) -> Any:
        """Return the part of each box that is left of the column's end and below that of a row."""
        top = self.bottom + row + 1.0
        inside = top < self.v + self.dv
        limit = dr.select(inside, top, self.v + self.dv) - self.v
        part = self.box.covered(self.right, limit)
        # All of a box is one. For needles and plates it is not, to rounding: their last pixel makes
        # up for it. Of other boxes it would only get noise.
        lossy = self.last & ~inside & (dr.abs(part - 1.0) > _NOISE)
        return dr.select(lossy, 1.0, part)


def _columns(box: Box, place: list[Any], reach: list[Any], column: Any) -> _Columns:
    """Return columns of shadows, counted from the first, of boxes at places on the screen."""
    (u, v), (du, dv) = place, reach
    # What is beside the frame on the left or below is taken by one column and one row.
    left, bottom = (dr.select(p > -1.0, dr.floor(p), -1.0) for p in (u - du, v - dv))
    edge = left + column + 1.0
    last = edge >= u + du
    right = dr.select(last, u + du, edge) - u
    return _Columns(box, v, dv, bottom, left + column, right, last, edge - 1.0 < u + du)


@dataclass
class _State:
    """What goes round the rows: which one, and the part of the box below it."""

    row: Any
    below: Any


def _shadows(
    spline: BoxSpline, boxes: _Boxes, columns: int, rows: int, pixels: tuple[int, int], backend: Any
) -> tuple[list[np.ndarray], np.ndarray]:
    """Return parts of all amounts, and which sum each belongs to: (rows · cells · columns,)."""
    Float, UInt = backend.Float, backend.UInt
    count = boxes.place.shape[1]
    lanes = count * columns
    lane = dr.arange(UInt, lanes)
    cell = backend.quotient(lane, dr.opaque(UInt, columns))
    column = Float(lane - cell * dr.opaque(UInt, columns))

    def of_cell(values: np.ndarray) -> Any:
        return dr.gather(Float, from_host(Float, values), cell)

    place, reach = ([of_cell(c) for c in part] for part in (boxes.place, boxes.reach))
    box = spline.traced(backend).box([of_cell(boxes.sizes[k]) for k in spline.kept])
    under = _columns(box, place, reach, column)
    amounts = [of_cell(amount) for amount in boxes.amounts]
    nx, ny = (dr.opaque(Float, n) for n in pixels)
    # Beyond the frame nothing counts.
    across = dr.clip(under.number, -2.0, nx) + 2.0
    parts = [dr.empty(Float, lanes * rows) for _ in amounts]
    numbers = dr.empty(UInt, lanes * rows)

    def more(state: _State) -> Any:
        return state.row < dr.opaque(UInt, rows)

    def step(state: _State) -> tuple[_State]:
        row = Float(state.row)
        below = under.below(row)
        target = state.row * dr.opaque(UInt, lanes) + lane
        part = dr.select(under.active, below - state.below, 0.0)
        for amount, out in zip(amounts, parts, strict=True):
            dr.scatter(out, part * amount, target)
        line = dr.clip(under.bottom + row, -1.0, ny) + 1.0
        pixel = dr.fma(line, nx + 3.0, across)
        dr.scatter(numbers, 2 * UInt(pixel) + dr.select(under.last, UInt(1), 0), target)
        return (_State(state.row + 1, below),)

    start = _State(dr.zeros(UInt, lanes), dr.zeros(Float, lanes))
    dr.while_loop((start,), more, step, label="shadows")
    dr.eval(parts, numbers)
    return [part.numpy() for part in parts], numbers.numpy()
