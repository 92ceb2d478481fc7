"""The shadow of a box on square pixels, in closed form.

The column of an even box, seen along any direction, is the convolution of three segments: its
projected edges. Its mean over a pixel is that convolved with two more, the pixel's edges: a
bivariate box spline of five directions (de Boor, Höllig & Riemenschneider 1993, *Box Splines*). It
is summed up here over all pixels to the left and below, and given by differences of truncated
powers,

    F(x) = Σ_k (-1)^|k| T(x - Σ k_i e_i),        k_i = 0, 1,  e_i the box's edges,

where T, the truncated power of the five directions ξ = (ℓ, τ ℓ), is a univariate B-spline N of
their slopes τ (Curry & Schoenberg 1966): T(s, m) = s³ N(m/s | τ) / (3! Π ℓ (τ_5 - τ_1)). The
recursion of de Boor and Cox evaluates it without any loss of digits, also where directions
coincide; multiplied out with s it has no quotient.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..backend import dr, from_host
from ..errors import InputError

if TYPE_CHECKING:
    from ..backend import Backend

# An edge shorter than this, of the longest, is seen along its length: leaving it out changes the
# mean by the square of that, and its inverse would cost as many digits.
_SHORT = 3e-5
# Slopes closer than this are one.
_SAME = 1e-9


class BoxSplineFootprint:
    """The shadows of boxes with edges in three given directions.

    Parameters
    ----------
    directions : array, shape (3, 2)
        Where edges of unit length end, in pixels.

    Attributes
    ----------
    kept : list of int
        The edges that are seen at all.
    """

    def __init__(self, directions: np.ndarray) -> None:
        lengths = np.hypot(*directions.T)
        self.kept = [k for k in range(3) if lengths[k] > _SHORT * lengths.max()]
        along = _along(directions[self.kept])
        self.axes = np.array([along, [-along[1], along[0]]])
        edges = directions[self.kept]
        # A box is the same when its edges are counted the other way.
        self.edges = edges * np.where(edges @ along < 0, -1.0, 1.0)[:, None]
        own = np.concatenate([self.edges, np.eye(2)]) @ self.axes.T
        self.slopes = _merged(np.sort(own[:, 1] / own[:, 0]))
        self.lead = 1.0 / (
            math.factorial(len(own) - 2) * np.prod(own[:, 0]) * (self.slopes[-1] - self.slopes[0])
        )

    def traced(self, backend: Backend) -> TracedFootprint:
        """Return it as run-time data of a kernel."""
        return TracedFootprint(self, backend)


def _along(edges: np.ndarray) -> np.ndarray:
    """Return a direction in the first quadrant that is farthest from the normals of all edges."""
    normals = (np.arctan2(edges[:, 1], edges[:, 0]) + 0.5 * np.pi) % np.pi
    angles = np.sort([0.0, 0.5 * np.pi, *normals[normals < 0.5 * np.pi]])
    widest = int(np.argmax(np.diff(angles)))
    angle = 0.5 * (angles[widest] + angles[widest + 1])
    return np.array([np.cos(angle), np.sin(angle)])


def _merged(slopes: np.ndarray) -> np.ndarray:
    for k in range(1, len(slopes)):
        if slopes[k] - slopes[k - 1] < _SAME:
            slopes[k] = slopes[k - 1]
    return slopes


class TracedFootprint:
    """A `BoxSplineFootprint` in a kernel."""

    def __init__(self, spline: BoxSplineFootprint, backend: Backend) -> None:
        o = backend.opaque
        self.real = backend.Float
        self.along, self.across = [[o(float(c)) for c in axis] for axis in spline.axes]
        self.edges = [[o(float(c)) for c in edge] for edge in spline.edges]
        self.slopes = [o(float(t)) for t in spline.slopes]
        self.lead = o(float(spline.lead))
        self.inverse = [
            [o(_inverse(b - a)) for a, b in zip(spline.slopes, spline.slopes[k:], strict=False)]
            for k in range(1, len(spline.slopes) - 1)
        ]

    def box(self, lengths: list[Any]) -> TracedBox:
        """Return boxes with edges of given lengths (arrays)."""
        return TracedBox(self, lengths)

    def turned(self, x: Any, y: Any) -> tuple[Any, Any]:
        """Return a vector's components along and across."""
        (a, b), (c, d) = self.along, self.across
        return dr.fma(a, x, b * y), dr.fma(c, x, d * y)

    def power(self, s: Any, m: Any) -> Any:
        """Return T without its leading factor: s³ N(m/s), by de Boor's recursion."""
        d = [dr.fma(-slope, s, m) for slope in self.slopes]
        above = [value >= 0.0 for value in d]
        zero = self.real(0)
        # The first two steps at once: one of the intervals between slopes holds m/s.
        part = [dr.select(above[j] & ~above[j + 1], self.real(1), zero) for j in range(len(d) - 1)]
        for k, inverse in enumerate(self.inverse, 1):
            part = [
                dr.fma(d[j] * inverse[j], part[j], -(d[j + k + 1] * inverse[j + 1]) * part[j + 1])
                for j in range(len(part) - 1)
            ]
        return dr.select(s > 0.0, part[0], zero)


class TracedBox:
    """Boxes of one kind: what is the same wherever their shadows are looked at."""

    def __init__(self, spline: TracedFootprint, lengths: list[Any]) -> None:
        self.spline, real = spline, spline.real
        edges = [[h * c for c in edge] for h, edge in zip(lengths, spline.edges, strict=True)]
        self.lead = spline.lead
        for h in lengths:
            self.lead = self.lead / h
        self.origin = [-0.5 * sum(edge[a] for edge in edges) for a in range(2)]
        turned = [spline.turned(*edge) for edge in edges]
        self.corners = []
        for subset in itertools.product((0, 1), repeat=len(edges)):
            there = [t for t, k in zip(turned, subset, strict=True) if k]
            s, m = (sum((t[a] for t in there), real(0)) for a in range(2))
            self.corners.append((-1.0 if sum(subset) % 2 else 1.0, s, m))

    def covered(self, x: Any, y: Any) -> Any:
        """Return the part of a box, centred at 0, whose shadow is to the left of x and below y."""
        s, m = self.spline.turned(x - self.origin[0], y - self.origin[1])
        total = self.spline.real(0)
        for sign, ds, dm in self.corners:
            total = dr.fma(sign, self.spline.power(s - ds, m - dm), total)
        return total * self.lead


def _inverse(width: float) -> float:
    return 1.0 / width if width > 0.0 else 0.0


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


def project_cells(
    screen: Screen, centers: np.ndarray, sizes: np.ndarray, amounts: np.ndarray, backend: Backend
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
    """
    nx, ny = screen.pixels
    spline = BoxSplineFootprint(screen.axes.T)
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
    box : TracedBox
        How much of each box a quarter-plane covers.
    v, dv, bottom : arrays
        Where the box is along the column, how far it reaches, and the row in which it begins.
    number, right : arrays
        Which column, and where it ends, or the box, counted from the middle of that.
    last, active : masks
        Whether it is the last column of the shadow, and whether it is one at all.
    """

    box: TracedBox
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


def _columns(box: TracedBox, place: list[Any], reach: list[Any], column: Any) -> _Columns:
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
    spline: BoxSplineFootprint,
    boxes: _Boxes,
    columns: int,
    rows: int,
    pixels: tuple[int, int],
    backend: Backend,
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
