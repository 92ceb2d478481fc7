"""Segments in space, cut into pieces whose images are straight, short and in the picture."""

from __future__ import annotations

from numbers import Real
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..errors import InputError, check_flag
from ..units import as_given, is_quantity, plain, unit_of
from .contract import Layers, SceneObject, View, numbered, window_pixels
from .values import check_colors

if TYPE_CHECKING:
    from ..volume import Volume

# How far the image of a piece may bend, in pixels.
_BEND = 0.05
# How often a segment may be halved: that is 0.02 % of it, at the edge of what is seen.
_ROUNDS = 12
# Length of pieces in pixels: their windows then hold few pixels beside the line.
_SHORT = 8.0
# A pixel's shadow is a trapezium; along an axis its flanks are upright, here nearly so.
_UPRIGHT = 1e-5
# Less of a pixel is nothing.
_LEAST = 1e-6
# How much nearer than it is an axis is drawn, as a fraction of the volume's diagonal.
_NEARER = 1e-6


class Segments(NamedTuple):
    """Segments in space: the line that each is of, shape (n,), and its ends, shape (n, 3)."""

    line: np.ndarray
    begin: np.ndarray
    end: np.ndarray

    def points(self, segment: np.ndarray, part: np.ndarray) -> np.ndarray:
        """Return points (k, 3) a fraction along segments."""
        direction = part[:, None]
        return np.asarray((1.0 - direction) * self.begin[segment] + direction * self.end[segment])

    def images(self, segment: np.ndarray, part: np.ndarray, view: View) -> np.ndarray:
        """Return the images (k, 2) of points a fraction along segments."""
        return np.stack(view.place(self.points(segment, part))[:2], axis=-1)


class Pieces(NamedTuple):
    """Straight lines in the picture: parts of segments, their ends (n, 2) and widths in pixels."""

    segment: np.ndarray
    begin: np.ndarray
    end: np.ndarray
    width: np.ndarray


def straight_parts(segments: Segments, view: View) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return segment numbers, and where on them parts with straight images begin and end.

    What is not on the image plane at all, such as behind the observer, is left out, and so is what
    is outside the picture.
    """
    count = len(segments.line)
    segment, first, last = np.arange(count), np.zeros(count), np.ones(count)
    straight_ones: list[tuple[np.ndarray, ...]] = []
    for _ in range(_ROUNDS):
        middle = 0.5 * (first + last)
        images = [segments.images(segment, part, view) for part in (first, middle, last)]
        a, m, b = images
        unseen = np.isnan(images).any(axis=2)
        side, half = b - a, m - a
        off = np.abs(side[:, 0] * half[:, 1] - side[:, 1] * half[:, 0])
        length = np.hypot(*side.T)
        between = np.sum(half * (b - m), axis=1) >= 0.0
        straight = ~unseen.any(axis=0) & (off <= _BEND * length) & (between | (length < _BEND))
        low, high = np.min(images, axis=0), np.max(images, axis=0)
        margin = high - low + 2.0
        with np.errstate(invalid="ignore"):
            far = np.any((high + margin < 0) | (low - margin > view.frame.pixels), axis=1)
        shown = ~(unseen.all(axis=0) | far)
        done, bent = straight & shown, ~straight & shown
        straight_ones.append((segment[done], first[done], last[done]))
        if not bent.any():
            break
        first, middle, last = first[bent], middle[bent], last[bent]
        segment = np.tile(segment[bent], 2)
        first, last = np.concatenate([first, middle]), np.concatenate([middle, last])
    segment, first, last = (np.concatenate(rows) for rows in zip(*straight_ones, strict=True))
    order = np.lexsort((first, segment))
    return segment[order], first[order], last[order]


def short_pieces(pieces: Pieces, pixels: tuple[int, int]) -> Pieces:
    """Return what is inside the picture, or almost, in short pieces, in the same order.

    Clipped after Liang and Barsky (1984).
    """
    room, side = 0.5 * pieces.width + 2.0, pieces.end - pieces.begin
    first, last = np.zeros(len(room)), np.ones(len(room))
    for start, direction, count in zip(pieces.begin.T, side.T, pixels, strict=True):
        still = direction == 0.0
        pace = 1.0 / np.where(still, 1.0, direction)
        edges = np.stack([(-0.5 - room - start) * pace, (count - 0.5 + room - start) * pace])
        inside = (start > -0.5 - room) & (start < count - 0.5 + room)
        edges = np.where(still, np.where(inside, [[-1.0], [2.0]], [[2.0], [-1.0]]), edges)
        first = np.maximum(first, np.where(still, edges[0], edges.min(axis=0)))
        last = np.minimum(last, np.where(still, edges[1], edges.max(axis=0)))
    length = np.hypot(*side.T) * np.maximum(last - first, 0.0)
    parts = np.where(last > first, np.maximum(np.ceil(length / _SHORT), 1), 0)
    parts = np.where((last == first) & (length == 0.0), 1, parts).astype(np.int64)
    owner, number = numbered(parts)
    step = ((last - first) / np.maximum(parts, 1))[owner]
    begin = pieces.begin[owner] + (first[owner] + number * step)[:, None] * side[owner]
    end = begin + step[:, None] * side[owner]
    return Pieces(pieces.segment[owner], begin, end, pieces.width[owner])


def strip_coverage(distance: np.ndarray, normal: np.ndarray, width: np.ndarray) -> np.ndarray:
    """Return the parts of pixels of side 1 that lie in strips of some width (n,).

    `distance` (n,) is that from the pixel's centre to the middle of the strip, along `normal` (n,
    2).
    """
    large = np.max(np.abs(normal), axis=1)
    small = np.maximum(np.min(np.abs(normal), axis=1), _UPRIGHT)
    outer, inner = 0.5 * (large + small), 0.5 * (large - small)

    def below(place: np.ndarray) -> np.ndarray:
        """Return the area of a square of side 1 below a line at a distance from its centre.

        The square's extent along the normal is the sum of two uniform distributions, of the widths
        `large` and `small`: their distribution function is a second difference of squares.
        """
        squares = [np.maximum(place + edge, 0.0) ** 2 for edge in (outer, inner, -inner, -outer)]
        area = (squares[0] - squares[1] - squares[2] + squares[3]) / (2.0 * large * small)
        return np.where(place >= outer, 1.0, area)  # not but for rounding

    part = below(distance + 0.5 * width) - below(distance - 0.5 * width)
    return np.asarray(np.clip(part, 0.0, 1.0))


def nearest_on_segments(
    points: np.ndarray, begin: np.ndarray, end: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the distances (n,) from points to segments in a plane, and unit vectors across.

    Beyond an end these point away from it: ends are round.
    """
    side, away = end - begin, points - begin
    square = np.sum(side**2, axis=1)
    divisor = np.where(square > 0.0, square, 1.0)
    part = np.sum(away * side, axis=1) / divisor
    off = away - np.clip(part, 0.0, 1.0)[:, None] * side
    distance = np.hypot(*off.T)
    across = np.stack([-side[:, 1], side[:, 0]], axis=1) / np.sqrt(divisor)[:, None]
    across = np.where((square > 0.0)[:, None], across, [1.0, 0.0])
    outward = off / np.where(distance > 0.0, distance, 1.0)[:, None]
    return distance, np.where((distance > 1e-9)[:, None], outward, across)


class Curves(SceneObject):
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
        self.points, self.width = as_given(points, "points"), as_given(width, "width")
        self.places, self.counts, self.unit = _lines(self.points)
        self.colors = colors
        check_colors(colors, len(self.counts), "colors")
        if not isinstance(opacity, Real) or not 0.0 <= opacity <= 1.0:
            raise InputError(f"opacity must be from 0 to 1, got {opacity!r}")
        check_flag("closed", closed)
        thick = plain(self.width, unit_of(self.width), "width")
        if not isinstance(thick, float) or not 0.0 < thick < np.inf:
            raise InputError(f"width must be a positive number or a length, got {width!r}")
        self.opacity: float = float(opacity)
        self.closed: bool = bool(closed)

    def layers(self, view: View) -> Layers | None:
        segments = self._segments(view)
        if not len(segments.line):
            return None
        segment, first, last = straight_parts(segments, view)
        begin, end = (segments.images(segment, part, view) for part in (first, last))
        if is_quantity(self.width):
            middle = segments.points(segment, 0.5 * (first + last))
            width = view.length(self.width, "width") * np.sqrt(view.pixels_per_area(middle))
        else:
            width = np.full(len(segment), float(self.width))
        pixels = view.frame.pixels
        pieces = short_pieces(Pieces(segment, begin, end, width), pixels)
        piece, x, y, covered = _covered(pieces, segments.line[pieces.segment], pixels)
        segment = pieces.segment[piece]
        depth = _depths(segments.begin[segment], segments.end[segment], x, y, view)
        color = self.intensities(self.colors, len(self.counts), view, view.intensity_unit)
        emission = covered[:, None] * color[segments.line[segment]]
        layers = Layers(y * pixels[0] + x, depth, emission, covered * self.opacity)
        return layers.some(np.flatnonzero(np.isfinite(depth)))

    def _segments(self, view: View) -> Segments:
        places = self.places
        if self.unit is not None:
            places = np.asarray(view.length(places * self.unit, "points"))
        line = np.repeat(np.arange(len(self.counts)), self.counts)
        last = np.cumsum(self.counts) - 1
        after = np.arange(1, len(places) + 1)
        after[last] = last + 1 - self.counts  # back to the first point
        drawn = np.ones(len(places), bool)
        drawn[last] = self.closed
        return Segments(line[drawn], places[drawn], places[after[drawn]])


def _lines(points: Any) -> tuple[np.ndarray, np.ndarray, Any]:
    """Return all points (n, 3) as plain numbers, how many each line has, and their unit."""
    unit = unit_of(points)
    several = isinstance(points, (list, tuple))
    parts = [np.asarray(plain(part, unit, "points")) for part in (points if several else [points])]
    if several and parts and all(part.ndim == 1 for part in parts):  # the points of one line
        if len({part.shape for part in parts}) > 1:
            raise InputError("points of a line must all be (x, y, z)")
        parts = [np.stack(parts)]
    blocks = [part if part.ndim == 3 else part[None] for part in parts if part.size]
    if not blocks:
        raise InputError("expected the points of a line or of several, got none")
    for block in blocks:
        if block.ndim != 3 or block.shape[2] != 3 or block.shape[1] < 2:
            raise InputError(
                "a line is an array of two points or more, shape (n, 3); several are a list of "
                f"them, or an array of shape (lines, n, 3); got one of shape {block.shape[1:]}"
            )
    places = np.concatenate([block.reshape(-1, 3) for block in blocks])
    if not np.all(np.isfinite(places)):
        raise InputError("points of lines must be finite")
    return places, np.concatenate([np.full(len(b), b.shape[1]) for b in blocks]), unit


def _covered(
    pieces: Pieces, line: np.ndarray, pixels: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return which piece, x, y and the covered part of all pixels that are touched.

    Neighbours along a line that touch the same pixel are one layer: the piece that is nearest to
    its centre. Where the line comes back later, perhaps far behind, is another.
    """
    room = (0.5 * pieces.width)[:, None] + 0.25  # a pixel's corner reaches as far
    low, high = np.minimum(pieces.begin, pieces.end), np.maximum(pieces.begin, pieces.end)
    window = np.stack([low - room, high + room])
    piece, x, y = window_pixels(window[..., 0], window[..., 1], pixels)
    centers = np.stack([x, y], axis=1).astype(np.float64)
    distance, normal = nearest_on_segments(centers, pieces.begin[piece], pieces.end[piece])
    # Runs of neighbouring pieces in the same pixel, and the nearest of each.
    pixel = y * pixels[0] + x
    order = np.lexsort((piece, pixel))
    one = piece[order]
    new = np.ones(len(order), bool)
    new[1:] = (np.diff(pixel[order]) != 0) | (np.diff(one) > 1) | (np.diff(line[one]) != 0)
    inside = np.lexsort((distance[order], np.cumsum(new)))
    best = order[inside][new]  # each run keeps its places
    covered = strip_coverage(distance[best], normal[best], pieces.width[piece[best]])
    some = best[covered > _LEAST]
    return piece[some], x[some], y[some], covered[covered > _LEAST]


def _depths(
    begin: np.ndarray, end: np.ndarray, x: np.ndarray, y: np.ndarray, view: View
) -> np.ndarray:
    origin, direction = view.rays(x.astype(float), y.astype(float))
    side, away = end - begin, begin - origin
    # Across the ray, segment and ray are a line and a point.
    across = side - np.sum(side * direction, axis=1, keepdims=True) * direction
    off = away - np.sum(away * direction, axis=1, keepdims=True) * direction
    square = np.sum(across**2, axis=1)
    part = -np.sum(off * across, axis=1) / np.where(square > 0.0, square, 1.0)
    point = away + np.clip(part, 0.0, 1.0)[:, None] * side
    depth = np.asarray(np.sum(point * direction, axis=1))
    return depth if view.observer is None else np.where(depth > 0.0, depth, np.nan)


class Axes(SceneObject):
    """Lines along x, y and z.

    Parameters
    ----------
    volume : Volume, optional
        Default: the one that is rendered.
    colors : optional
        As for `Curves`, for three lines. Default: red, green and blue where there are three
        channels, else white.
    origin : three floats or Quantity, optional
        Where they begin; default: the lower corner of the box around the volume.
    length : float, Quantity or three of them, optional
        Default: to the upper ends of that box.
    width, depth, channel
        As for `Curves`.
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
        if volume is not None and not hasattr(volume, "grid"):
            raise InputError(f"Axes: expected a vm.Volume first, got {type(volume).__name__}")
        self.grid = None if volume is None else volume.grid
        self.colors, self.width = colors, width
        self.origin, self.length = as_given(origin, "origin"), as_given(length, "length")

    def layers(self, view: View) -> Layers | None:
        low, high = (view.grid if self.grid is None else self.grid).bounds.T
        start = low if self.origin is None else np.asarray(view.length(self.origin, "origin"))
        lengths = high - start if self.length is None else view.length(self.length, "length")
        lines = [
            np.stack([start, start + direction])
            for direction in np.broadcast_to(lengths, 3) * np.eye(3)
        ]
        colors = self.colors
        if colors is None:
            colored = view.channels == 3 and self.channel is None
            colors = ("red", "lime", "blue") if colored else 1.0
        options = {name: getattr(self, name) for name in ("width", "depth", "channel", "relative")}
        layers = Curves(lines, colors, **options).layers(view)
        if layers is None:
            return None
        # Edges of boxes in the same place are behind.
        nearer = _NEARER * float(np.linalg.norm(high - low))
        return layers._replace(depth=layers.depth - nearer)
