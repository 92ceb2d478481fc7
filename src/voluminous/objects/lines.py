"""Lines: orbits, streamlines, edges of boxes; antialiased, at their true depth."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import InputError
from ..units import as_given, is_quantity, plain, unit_of
from .colors import check_colors, intensities
from .contract import Layers, SceneObject
from .pieces import Pieces, between, image_of, short_pieces, straight_parts
from .strips import nearest_on_segments, strip_coverage
from .values import merged
from .view import View
from .windows import window_pixels

# Less of a pixel is nothing.
_LEAST = 1e-6


class Lines(SceneObject):
    """Polylines through space.

    Parameters
    ----------
    points : array_like or Quantity
        Of one line: shape (n, 3), in the volume's unit. Of several: a list of these, or an array of
        shape (lines, n, 3); segments are ``(m, 2, 3)``.
    colors : str, float, Quantity or array_like
        Intensity: one for all lines, or a list, as for `Spheres`.
    width : float or Quantity
        Plain numbers are pixels; a quantity is a length in space.
    opacity : float
        The part that lines hide of what is behind them.
    closed : bool
        Join the last point of each line to its first.
    depth, channel, relative
        As for `SceneObject`.

    Raises
    ------
    InputError
        For shapes that do not fit, or a width that is not positive.

    Notes
    -----
    A pixel is covered by the area of the strip in it, exactly where the line runs straight; ends
    and joints are round.
    """

    def __init__(
        self,
        points: Any,
        colors: Any = 1.0,
        *,
        width: Any = 1.0,
        opacity: float = 1.0,
        closed: bool = False,
        depth: str = "true",
        channel: int | None = None,
        relative: bool = False,
    ) -> None:
        super().__init__(depth=depth, channel=channel, relative=relative)
        self.points = merged(points)
        self.places, self.counts, self.unit = _lines(self.points)
        check_colors(colors, len(self.counts), "colors")
        if not 0.0 <= opacity <= 1.0:
            raise InputError(f"opacity must be from 0 to 1, got {opacity!r}")
        width = as_given(width, "width")
        thick = plain(width, unit_of(width), "width")
        if not isinstance(thick, float) or not 0.0 < thick < np.inf:
            raise InputError(f"width must be a positive number or a length, got {width!r}")
        self.colors, self.width = colors, width
        self.opacity, self.closed = float(opacity), closed

    def layers(self, view: View) -> Layers | None:
        line, begin, end = self._segments(view)
        if not len(line):
            return None
        pieces = short_pieces(self._pieces(begin, end, view), view.frame.pixels)
        piece, x, y, covered = _covered(pieces, line[pieces.segment], view.frame.pixels)
        segment = pieces.segment[piece]
        depth = _depths(begin[segment], end[segment], x, y, view)
        color = intensities(self, self.colors, len(self.counts), view, view.intensity_unit)
        pixel = y * view.frame.pixels[0] + x
        found = Layers.of(pixel, depth, covered, color[line[segment]], self.opacity)
        return found.some(np.flatnonzero(np.isfinite(depth)))

    def _segments(self, view: View) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the line that each segment is of, and its ends (n, 3) in the volume's unit."""
        places = self.places
        if self.unit is not None:
            places = np.asarray(view.length(places * self.unit, "points"))
        line = np.repeat(np.arange(len(self.counts)), self.counts)
        last = np.cumsum(self.counts) - 1
        after = np.arange(1, len(places) + 1)
        after[last] = last + 1 - self.counts  # back to the first point
        kept = np.ones(len(places), bool)
        kept[last] = self.closed
        return line[kept], places[kept], places[after[kept]]

    def _pieces(self, begin: np.ndarray, end: np.ndarray, view: View) -> Pieces:
        segment, first, last = straight_parts(begin, end, view)
        a, b = (image_of(segment, part, begin, end, view) for part in (first, last))
        if not is_quantity(self.width):
            return Pieces(segment, a, b, np.full(len(segment), float(self.width)))
        middle = between(segment, 0.5 * (first + last), begin, end)
        per_length = np.sqrt(view.pixels_per_area(middle))
        return Pieces(segment, a, b, view.length(self.width, "width") * per_length)


def _lines(points: Any) -> tuple[np.ndarray, np.ndarray, Any]:
    """Return all points (n, 3) as plain numbers, how many each line has, and their unit."""
    if isinstance(points, (list, tuple)) and len(points) and np.ndim(points[0]) == 2:
        unit = unit_of(points[0])
        lines = [np.asarray(plain(p, unit, "points")) for p in points]
        for line in lines:
            _check(line)
        counts = np.array([len(line) for line in lines])
        return np.concatenate(lines), counts, unit
    unit = unit_of(points)
    array = np.asarray(plain(points, unit, "points"))
    if array.size == 0:
        raise InputError("expected the points of a line or of several, got none")
    array = array if array.ndim == 3 else array[None]
    _check(array.reshape(-1, array.shape[-1]), array.shape[1])
    return array.reshape(-1, 3), np.full(len(array), array.shape[1]), unit


def _check(points: np.ndarray, count: int | None = None) -> None:
    count = len(points) if count is None else count
    if points.ndim != 2 or points.shape[1] != 3 or count < 2:
        raise InputError(
            "a line is an array of two points or more, shape (n, 3); several are a list of them, "
            f"or an array of shape (lines, n, 3); got a line of {count} points, shape "
            f"{points.shape}"
        )
    if not np.all(np.isfinite(points)):
        raise InputError("points of lines must be finite")


def _covered(
    pieces: Pieces, line: np.ndarray, pixels: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return which piece, x, y and the covered part of all pixels that are touched.

    Neighbours along a line that touch the same pixel are one layer: the piece that is nearest to
    its centre. Where the line comes back later, perhaps far behind, is another.
    """
    room = (0.5 * pieces.width)[:, None] + 0.25  # a pixel's corner reaches as far
    low = (np.minimum(pieces.begin, pieces.end) - room).T
    high = (np.maximum(pieces.begin, pieces.end) + room).T
    piece, x, y = window_pixels(low[0], high[0], low[1], high[1], pixels)
    centers = np.stack([x, y], axis=1).astype(np.float64)
    distance, normal = nearest_on_segments(centers, pieces.begin[piece], pieces.end[piece])
    best = _nearest_of_runs(piece, y * pixels[0] + x, distance, line)
    covered = strip_coverage(distance[best], normal[best], pieces.width[piece[best]])
    some = best[covered > _LEAST]
    return piece[some], x[some], y[some], covered[covered > _LEAST]


def _nearest_of_runs(
    piece: np.ndarray, pixel: np.ndarray, distance: np.ndarray, line: np.ndarray
) -> np.ndarray:
    """Return the nearest of each run of neighbouring pieces in the same pixel."""
    order = np.lexsort((piece, pixel))
    first, after = piece[order][:-1], piece[order][1:]
    new = np.ones(len(order), bool)
    new[1:] = (np.diff(pixel[order]) != 0) | (after - first > 1) | (line[after] != line[first])
    run = np.cumsum(new)
    inside = np.lexsort((distance[order], run))
    return np.asarray(order[inside][new])  # each run keeps its places


def _depths(
    begin: np.ndarray, end: np.ndarray, x: np.ndarray, y: np.ndarray, view: View
) -> np.ndarray:
    """Return how deep segments are where they come nearest to the rays of pixels."""
    origin, direction = view.rays(x.astype(float), y.astype(float))
    side, away = end - begin, begin - origin
    # Across the ray, segment and ray are a line and a point.
    across = side - np.sum(side * direction, axis=1, keepdims=True) * direction
    off = away - np.sum(away * direction, axis=1, keepdims=True) * direction
    square = np.sum(across**2, axis=1)
    part = -np.sum(off * across, axis=1) / np.where(square > 0.0, square, 1.0)
    point = away + np.clip(part, 0.0, 1.0)[:, None] * side
    depth = np.sum(point * direction, axis=1)
    if view.observer is None:
        return np.asarray(depth)
    return np.where(depth > 0.0, depth, np.nan)
