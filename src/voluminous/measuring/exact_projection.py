"""The shadow of a box on square pixels, in closed form.

The column of a homogeneous box, seen from any direction, is the convolution of three segments: its
projected edges. Its mean over a pixel is that convolved with two more, the pixel's edges: a
bivariate box spline of five directions (de Boor, Höllig & Riemenschneider 1993, *Box Splines*).
Here it is summed over all pixels to the left and below, and computed as differences of truncated
powers,

    F(x) = Σ_k (-1)^|k| T(x - Σ k_i e_i),        k_i = 0, 1,  e_i the box's edges,

where T, the truncated power of the five directions ξ = (ℓ, τ ℓ), is a univariate B-spline N of
their slopes τ (Curry & Schoenberg 1966): T(s, m) = s³ N(m/s | τ) / (3! Π ℓ (τ_5 - τ_1)). The
recursion of de Boor and Cox evaluates it without loss of digits, also where directions coincide;
multiplied by s it has no quotient.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..backend import Float, Int, Mask, dr, from_host
from ..backend.functions import loop
from ..errors import InputError

if TYPE_CHECKING:
    from ..backend import Backend
    from ..cameras import Frame

# An edge shorter than this, relative to the longest, is seen along its length: leaving it out
# changes the mean by the square of that, and its inverse would cost as many digits.
_SHORT = 3e-5
# Slopes closer than this are merged.
_SAME = 1e-9
# Numbers computed in one kernel: 16 bytes each.
_BATCH = 1 << 22
# Accuracy of differences of parts.
_NOISE = 1e-13
# Half a cell, in pixels. A pixel shows 1e-10 of it: a difference good to 1e-4.
_WIDEST = 1e5


class Screen(NamedTuple):
    """Square pixels in a plane: (u, v) in pixels are ``axes @ point + origin``."""

    axes: np.ndarray
    origin: np.ndarray
    pixels: tuple[int, int]

    @classmethod
    def of(cls, frame: Frame) -> Screen:
        """Return the pixels of an orthographic camera."""
        center, right, up = frame.vectors[:3]
        pixel = np.asarray(frame.pixel)
        axes = np.stack([right, up]) / pixel[:, None]
        middle = 0.5 * np.asarray(frame.pixels) - np.asarray(frame.shift) / pixel
        return cls(axes, middle - axes @ center, frame.pixels)


class _BoxSpline:
    """The shadows of boxes with edges in three directions, as run-time data of a kernel.

    `directions`, of shape (3, 2), are the ends of edges of unit length, in pixels. Edges that are
    not seen along their length are `visible`.
    """

    def __init__(self, directions: np.ndarray, backend: Backend) -> None:
        lengths = np.hypot(*directions.T)
        self.visible = [k for k in range(3) if lengths[k] > _SHORT * lengths.max()]
        edges = directions[self.visible]
        along = _along(edges)
        axes = np.array([along, [-along[1], along[0]]])
        # A box is the same when its edges are reversed.
        edges = edges * np.where(edges @ along < 0, -1.0, 1.0)[:, None]
        turned = np.concatenate([edges, np.eye(2)]) @ axes.T
        slopes = np.sort(turned[:, 1] / turned[:, 0])
        for k in range(1, len(slopes)):
            if slopes[k] - slopes[k - 1] < _SAME:
                slopes[k] = slopes[k - 1]
        lead = 1.0 / np.prod(turned[:, 0]) / (slopes[-1] - slopes[0])

        def opaque(values: np.ndarray) -> list[Float]:
            return [backend.opaque(float(v)) for v in values]

        self.real, self.slopes = backend.Float, opaque(slopes)
        self.axes, self.edges = list(map(opaque, axes)), list(map(opaque, edges))
        self.lead = backend.opaque(float(lead / math.factorial(len(turned) - 2)))
        self.inverse = [
            opaque(np.array([1.0 / w if w > 0.0 else 0.0 for w in slopes[k:] - slopes[:-k]]))
            for k in range(1, len(slopes) - 1)
        ]

    def turned(self, x: Float, y: Float) -> tuple[Float, Float]:
        """Return a vector's components along and across."""
        (a, b), (c, d) = self.axes
        return dr.fma(a, x, b * y), dr.fma(c, x, d * y)

    def power(self, s: Float, m: Float) -> Float:
        """Return T without its leading factor: s³ N(m/s), by de Boor's recursion."""
        d = [dr.fma(-slope, s, m) for slope in self.slopes]
        above, zero = [value >= 0.0 for value in d], self.real(0)
        # The first two steps at once: one of the intervals between slopes contains m/s.
        part = [
            dr.select(low & ~high, self.real(1), zero) for low, high in itertools.pairwise(above)
        ]
        for k, inverse in enumerate(self.inverse, 1):
            part = [
                dr.fma(d[j] * inverse[j], part[j], -(d[j + k + 1] * inverse[j + 1]) * part[j + 1])
                for j in range(len(part) - 1)
            ]
        return dr.select(s > 0.0, part[0], zero)

    def boxes(self, lengths: list[Float]) -> Callable[[Float, Float], Float]:
        """Return a function of x and y: the part of a box at 0 with shadow left of x and below y.

        `lengths` are those of the visible edges.
        """
        edges = [[h * c for c in edge] for h, edge in zip(lengths, self.edges, strict=True)]
        lead = self.lead
        for h in lengths:
            lead = lead / h
        x0, y0 = (-0.5 * sum(edge[a] for edge in edges) for a in range(2))
        turned = [self.turned(*edge) for edge in edges]
        corners = []
        for subset in itertools.product((0, 1), repeat=len(edges)):
            chosen = [t for t, k in zip(turned, subset, strict=True) if k]
            s, m = (sum((t[a] for t in chosen), self.real(0)) for a in range(2))
            corners.append((-1.0 if sum(subset) % 2 else 1.0, s, m))

        def covered(x: Float, y: Float) -> Float:
            s, m = self.turned(x - x0, y - y0)
            total = self.real(0)
            for sign, ds, dm in corners:
                total = dr.fma(sign, self.power(s - ds, m - dm), total)
            return total * lead

        return covered


def _along(edges: np.ndarray) -> np.ndarray:
    normals = (np.arctan2(edges[:, 1], edges[:, 0]) + 0.5 * np.pi) % np.pi
    angles = np.sort([0.0, 0.5 * np.pi, *normals[normals < 0.5 * np.pi]])
    widest = int(np.argmax(np.diff(angles)))
    angle = 0.5 * (angles[widest] + angles[widest + 1])
    return np.array([np.cos(angle), np.sin(angle)])


def empty_sums(screen: Screen, count: int) -> np.ndarray:
    """Return sums to which `project_cells` adds.

    Each pixel has a sum of additions, and one of subtractions; margins receive what falls beside.
    """
    nx, ny = screen.pixels
    return np.zeros((count, 2 * (nx + 3) * (ny + 2)))


def received(screen: Screen, sums: np.ndarray) -> np.ndarray:
    """Return what the pixels (k, ny, nx) receive of all that was added."""
    nx, ny = screen.pixels
    whole, rest = np.moveaxis(sums.reshape(len(sums), ny + 2, nx + 3, 2), -1, 0)
    gross, passed = (whole + rest)[:, 1:-1, 2:-1], whole[:, 1:-1, 1:-2]
    result = gross - passed
    # Where a shadow only just begins or ends there is only rounding error.
    result[np.abs(result) < _NOISE * np.maximum(np.abs(gross), np.abs(passed))] = 0.0
    return np.asarray(result)


def project_cells(
    screen: Screen,
    centers: np.ndarray,
    sizes: np.ndarray,
    amounts: np.ndarray,
    backend: Backend,
    sums: np.ndarray,
) -> None:
    """Add to the sums of pixels what they receive of amounts (k, n) distributed evenly in boxes.

    The total is that of `amounts`, except for what falls beside the frame. The backend must be in
    double precision.
    """
    nx, ny = screen.pixels
    frame = np.array([[nx], [ny]])
    spline = _BoxSpline(screen.axes.T, backend)
    place = screen.axes @ centers + screen.origin[:, None]
    reach = 0.5 * np.abs(screen.axes) @ sizes
    visible = np.flatnonzero(np.all((place + reach > 0) & (place - reach < frame), axis=0))
    widest = float(reach[:, visible].max(initial=0.0))
    if widest > _WIDEST:
        raise InputError(
            f"method='exact' knows columns of cells up to {2 * _WIDEST:.0e} pixels wide, here one "
            f"is {2 * widest:.1e}; in pixels that small method='rays' is as good"
        )
    # Cells are processed in groups of similar size. Of those wider than the frame only the part in
    # it counts, and one column and row before.
    shown = np.minimum(reach, 0.5 * frame)
    kinds = np.rint(2.0 * np.log2(2.0 * shown.max(axis=0) + 1.0)).astype(int)
    for kind in np.unique(kinds[visible]):
        cells = visible[kinds[visible] == kind]
        columns, rows = (int(n) + 1 for n in np.ceil(2.0 * shown[:, cells].max(axis=1)))
        step = max(1, _BATCH // (columns * rows))
        for some in (cells[first : first + step] for first in range(0, len(cells), step)):
            boxes = np.concatenate([each[:, some] for each in (place, reach, sizes, amounts)])
            parts, pixels = _shadows(spline, boxes, (columns, rows), screen.pixels, backend)
            for own, part in zip(sums, parts, strict=True):
                own += np.bincount(pixels, part, len(own))


def _shadows(
    spline: _BoxSpline,
    boxes: np.ndarray,
    size: tuple[int, int],
    pixels: tuple[int, int],
    backend: Backend,
) -> tuple[list[np.ndarray], np.ndarray]:
    """Return parts of all amounts, and the sum that each belongs to, of shape (rows · lanes,).

    `boxes` are their places (2), reaches (2), sizes (3) and amounts (k). `size` is the number of
    columns and rows of pixels that shadows cover at most; each column is a lane.
    """
    real, UInt = backend.Float, backend.UInt
    columns, rows = size
    lanes = boxes.shape[1] * columns
    lane = dr.arange(UInt, lanes)
    cell = backend.quotient(lane, dr.opaque(UInt, columns))
    column = real(lane - cell * dr.opaque(UInt, columns))
    values = [dr.gather(real, from_host(real, row), cell) for row in boxes]
    (u, v, du, dv), lengths, amounts = values[:4], values[4:7], values[7:]
    covered = spline.boxes([lengths[k] for k in spline.visible])
    # What is beside the frame on the left or below belongs to one column and one row.
    left, bottom = (dr.select(p > -1.0, dr.floor(p), -1.0) for p in (u - du, v - dv))
    edge = left + column + 1.0
    last, active = edge >= u + du, edge - 1.0 < u + du
    right = dr.select(last, u + du, edge) - u
    nx, ny = (dr.opaque(real, n) for n in pixels)
    # Beyond the frame nothing counts.
    across = dr.clip(left + column, -2.0, nx) + 2.0
    parts = [dr.empty(real, lanes * rows) for _ in amounts]
    numbers = dr.empty(UInt, lanes * rows)

    def covered_below(row: Float) -> Float:
        top = bottom + row + 1.0
        inside = top < v + dv
        part = covered(right, dr.select(inside, top, v + dv) - v)
        # The whole of a box is one. For needles and plates rounding makes it differ, which their
        # last pixel corrects. Other boxes would only get noise.
        lossy = last & ~inside & (dr.abs(part - 1.0) > _NOISE)
        return dr.select(lossy, 1.0, part)

    def step(number: Int, before: Float) -> tuple[Int, Float]:
        row = real(number)
        below = covered_below(row)
        target = number * dr.opaque(UInt, lanes) + lane
        part = dr.select(active, below - before, 0.0)
        for amount, out in zip(amounts, parts, strict=True):
            dr.scatter(out, part * amount, target)
        line = dr.clip(bottom + row, -1.0, ny) + 1.0
        pixel = dr.fma(line, nx + 3.0, across)
        dr.scatter(numbers, 2 * UInt(pixel) + dr.select(last, UInt(1), 0), target)
        return number + 1, below

    def more(number: Int, before: Float) -> Mask:
        return number < dr.opaque(UInt, rows)

    start = dr.zeros(UInt, lanes), dr.zeros(real, lanes)
    loop(start, more, step, label="shadows")
    dr.eval(parts, numbers)
    return [part.numpy() for part in parts], numbers.numpy()
