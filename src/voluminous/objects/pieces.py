"""Segments in space, cut into pieces whose images are straight, short and in the picture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .view import View

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
