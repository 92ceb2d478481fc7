"""Segments in space, cut into pieces whose images are straight, short and in the picture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError
from ..units import as_given, is_quantity, plain, unit_of
from .contract import Layers, SceneObject, View, intensities, window_pixels
from .values import check_colors, merged

if TYPE_CHECKING:
    from ..volume import Volume

# How far the image of a piece may bend, in pixels.
_BEND = 0.05
# How often a segment may be halved: that is 0.02 % of it, at the edge of what is seen.
_ROUNDS = 12
# Length of pieces in pixels: their windows then hold few pixels beside the line.
_SHORT = 8.0


@dataclass
class Pieces:
    """Straight lines in the picture.

    Attributes
    ----------
    segment : int array, shape (n,)
        Which segment in space each is a part of.
    begin, end : arrays, shape (n, 2)
        In pixels.
    width : array, shape (n,)
        In pixels.
    """

    segment: np.ndarray
    begin: np.ndarray
    end: np.ndarray
    width: np.ndarray


def straight_parts(
    begin: np.ndarray, end: np.ndarray, view: View
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return segment numbers, and where on them parts with straight images begin and end.

    What is not on the image plane at all, such as behind the observer, is left out.
    """
    segment = np.arange(len(begin))
    first, last = np.zeros(len(begin)), np.ones(len(begin))
    kept: list[tuple[np.ndarray, ...]] = []
    for _ in range(_ROUNDS):
        straight, bent = _judged(segment, first, last, begin, end, view)
        kept.append((segment[straight], first[straight], last[straight]))
        if not bent.any():
            break
        segment, first, last = np.tile(segment[bent], 2), first[bent], last[bent]
        middle = 0.5 * (first + last)
        first, last = np.concatenate([first, middle]), np.concatenate([middle, last])
    found = [np.concatenate(rows) for rows in zip(*kept, strict=True)]
    order = np.lexsort((found[1], found[0]))
    return found[0][order], found[1][order], found[2][order]


def _judged(
    segment: np.ndarray,
    first: np.ndarray,
    last: np.ndarray,
    begin: np.ndarray,
    end: np.ndarray,
    view: View,
) -> tuple[np.ndarray, np.ndarray]:
    """Return which parts are straight (or elsewhere), and which are to be halved."""
    images = [
        image_of(segment, part, begin, end, view) for part in (first, 0.5 * (first + last), last)
    ]
    a, middle, b = images
    unseen = np.isnan(images).any(axis=2)
    side = b - a
    off = np.abs(side[:, 0] * (middle - a)[:, 1] - side[:, 1] * (middle - a)[:, 0])
    length = np.hypot(*side.T)
    between = np.sum((middle - a) * (b - middle), axis=1) >= 0.0
    straight = ~unseen.any(axis=0) & (off <= _BEND * length) & (between | (length < _BEND))
    low, high = np.min(images, axis=0), np.max(images, axis=0)
    margin = high - low + 2.0
    with np.errstate(invalid="ignore"):
        far = np.any((high + margin < 0) | (low - margin > view.frame.pixels), axis=1)
    gone = unseen.all(axis=0) | far
    return straight & ~gone, ~straight & ~gone


def image_of(
    segment: np.ndarray, part: np.ndarray, begin: np.ndarray, end: np.ndarray, view: View
) -> np.ndarray:
    """Return the images (n, 2) of points a fraction along segments."""
    return np.stack(view.place(between(segment, part, begin, end))[:2], axis=-1)


def between(
    segment: np.ndarray, part: np.ndarray, begin: np.ndarray, end: np.ndarray
) -> np.ndarray:
    """Return points (n, 3) a fraction along segments."""
    way = part[:, None]
    return np.asarray((1.0 - way) * begin[segment] + way * end[segment])


def short_pieces(pieces: Pieces, pixels: tuple[int, int]) -> Pieces:
    """Return what is inside the picture, or almost, in short pieces, in the same order."""
    room = 0.5 * pieces.width + 2.0
    first, last = _clipped(pieces, room, pixels)
    length = np.hypot(*(pieces.end - pieces.begin).T) * np.maximum(last - first, 0.0)
    count = np.where(last > first, np.maximum(np.ceil(length / _SHORT), 1), 0)
    count = np.where((last == first) & (length == 0.0), 1, count).astype(np.int64)
    owner = np.repeat(np.arange(len(count)), count)
    number = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
    step = ((last - first) / np.maximum(count, 1))[owner]
    low = (first[owner] + number * step)[:, None]
    side = (pieces.end - pieces.begin)[owner]
    begin = pieces.begin[owner] + low * side
    return Pieces(pieces.segment[owner], begin, begin + step[:, None] * side, pieces.width[owner])


def _clipped(
    pieces: Pieces, room: np.ndarray, pixels: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the fractions between which pieces are inside the picture, with some room around.

    After Liang and Barsky (1984).
    """
    first, last = np.zeros(len(room)), np.ones(len(room))
    for axis, count in enumerate(pixels):
        start = pieces.begin[:, axis]
        way = pieces.end[:, axis] - start
        still = way == 0.0
        pace = 1.0 / np.where(still, 1.0, way)
        edges = np.stack([(-0.5 - room - start) * pace, (count - 0.5 + room - start) * pace])
        inside = (start > -0.5 - room) & (start < count - 0.5 + room)
        edges = np.where(still, np.where(inside, [[-1.0], [2.0]], [[2.0], [-1.0]]), edges)
        first = np.maximum(first, np.where(still, edges[0], edges.min(axis=0)))
        last = np.minimum(last, np.where(still, edges[1], edges.max(axis=0)))
    return first, last


# A pixel's shadow is a trapezium; along an axis its flanks are upright, here nearly so.
_UPRIGHT = 1e-5


def strip_coverage(distance: np.ndarray, normal: np.ndarray, width: np.ndarray) -> np.ndarray:
    """Return the parts of pixels of side 1 that lie in strips.

    Parameters
    ----------
    distance : array, shape (n,)
        From the pixel's centre to the middle of the strip.
    normal : array, shape (n, 2)
        Unit vectors across the strips.
    width : array, shape (n,)
    """
    large = np.max(np.abs(normal), axis=1)
    small = np.maximum(np.min(np.abs(normal), axis=1), _UPRIGHT)
    half = 0.5 * width
    part = _below(distance + half, large, small) - _below(distance - half, large, small)
    return np.asarray(np.clip(part, 0.0, 1.0))


def _below(place: np.ndarray, large: np.ndarray, small: np.ndarray) -> np.ndarray:
    """Return the area of a square of side 1 below a line at a distance from its centre.

    The square's extent along the normal is the sum of two uniform distributions, of the widths
    `large` and `small`: their distribution function is a second difference of squares.
    """
    outer, inner = 0.5 * (large + small), 0.5 * (large - small)
    squares = [np.maximum(place + edge, 0.0) ** 2 for edge in (outer, inner, -inner, -outer)]
    area = (squares[0] - squares[1] - squares[2] + squares[3]) / (2.0 * large * small)
    return np.where(place >= outer, 1.0, area)  # not but for rounding


def nearest_on_segments(
    points: np.ndarray, begin: np.ndarray, end: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the distances (n,) from points to segments in a plane, and unit vectors across.

    Beyond an end these point away from it: ends are round.
    """
    side, away = end - begin, points - begin
    square = np.sum(side**2, axis=1)
    part = np.sum(away * side, axis=1) / np.where(square > 0.0, square, 1.0)
    off = away - np.clip(part, 0.0, 1.0)[:, None] * side
    distance = np.hypot(*off.T)
    length = np.sqrt(np.where(square > 0.0, square, 1.0))[:, None]
    across = np.stack([-side[:, 1], side[:, 0]], axis=1) / length
    across = np.where((square > 0.0)[:, None], across, [1.0, 0.0])
    outward = off / np.where(distance > 0.0, distance, 1.0)[:, None]
    return distance, np.where((distance > 1e-9)[:, None], outward, across)


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


# How much nearer than it is an axis is drawn, as a fraction of the volume's diagonal.
_NEARER = 1e-6


class Axes(SceneObject):
    """Lines along x, y and z.

    Parameters
    ----------
    volume : Volume, optional
        Default: the one that is rendered.
    colors : optional
        As for `Lines`, for three lines. Default: red, green and blue where there are three
        channels, else white.
    origin : three floats or Quantity, optional
        Where they begin; default: the lower corner of the box around the volume.
    length : float, Quantity or three of them, optional
        Default: to the upper ends of that box.
    width, depth, channel
        As for `Lines`.
    relative : bool
        Colours count in units of the picture's brightest pixel.
    """

    def __init__(
        self,
        volume: Volume | None = None,
        colors: Any = None,
        *,
        origin: Any = None,
        length: Any = None,
        width: Any = 2.0,
        depth: str = "true",
        channel: int | None = None,
        relative: bool = True,
    ) -> None:
        super().__init__(depth=depth, channel=channel, relative=relative)
        self.grid = None if volume is None else volume.grid
        self.colors, self.width = colors, width
        self.origin, self.length = merged(origin), merged(length)

    def layers(self, view: View) -> Layers | None:
        grid = view.grid if self.grid is None else self.grid
        start, ends = grid.bounds[:, 0], grid.bounds[:, 1]
        if self.origin is not None:
            start = np.asarray(view.length(self.origin, "origin"))
        lengths = ends - start if self.length is None else view.length(self.length, "length")
        lines = [np.stack([start, start + way]) for way in np.broadcast_to(lengths, 3) * np.eye(3)]
        colors = self.colors
        if colors is None:
            colored = view.channels == 3 and self.channel is None
            colors = ("red", "lime", "blue") if colored else 1.0
        options: dict[str, Any] = {"depth": self.depth, "channel": self.channel}
        options |= {"relative": self.relative, "width": self.width}
        found = Lines(lines, colors, **options).layers(view)
        if found is not None:  # edges of boxes in the same place are behind
            found.depth -= _NEARER * float(np.linalg.norm(ends - grid.bounds[:, 0]))
        return found
