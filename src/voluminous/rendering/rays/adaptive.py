"""More rays where the picture is not smooth: antialiasing where it is needed.

Every pixel gets a ray through its centre. Where the picture bends more than the tolerance allows,
pixels get more, at the points of a low-discrepancy sequence that is shifted at random, though
always alike, from pixel to pixel: so no pattern shows. A pixel is done when its mean has settled.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .control import in_kernel_unit
from .paths import Paths

if TYPE_CHECKING:
    from .drawing import Drawing

# Rays per pixel after each round.
_ROUNDS = (8, 16, 32, 64, 128, 256)
# A mean has settled when two rounds after one another changed it by less than the tolerance.
_LEAST = 32
# Roberts' sequence in two dimensions: the inverse plastic number, x³ = x + 1, and its square.
_PLASTIC = 1.32471795724474602596
# Second differences of neighbours below this many tolerances are smooth. A pixel's mean differs
# from its centre by a twelfth of them where the picture is smooth indeed, and by up to a half, in
# the mean over all places by a fourth, where it has small edges: that is counted.
_SMOOTH = 4.0


@dataclass
class Means:
    """Sums over the rays of some pixels, what they show, and by how much that may be off.

    Rows are what a picture shows, see `_seen`, in parts of what differences are compared with.

    Attributes
    ----------
    seen : array, shape (row, n)
        The mean over the rays so far.
    low, high : array, shape (row, n)
        The least and the most that single rays show: own ones, and those through the centres of
        the pixels around.
    off : array, shape (row, n)
        By how much the last rays changed the mean.
    """

    pixel: np.ndarray
    total: Paths
    count: int
    seen: np.ndarray
    low: np.ndarray
    high: np.ndarray
    off: np.ndarray

    def take(self, drawing: Drawing, scale: np.ndarray, count: int) -> None:
        """Take more rays, so that there are so many.

        Each of them is reported: there may be many times as many as the picture has pixels.
        """
        numbers = range(self.count, count)
        for done, number in enumerate(numbers):
            drawing.job.progress(done * len(self.pixel), len(numbers) * len(self.pixel))
            found = drawing.rays(self.pixel, *_offsets(self.pixel, number))
            self._add(found, _seen(drawing, found) / scale)
        self.count = count
        now = _seen(drawing, self.mean()) / scale
        self.seen, self.off = now, np.abs(now - self.seen)

    def _add(self, found: Paths, seen: np.ndarray) -> None:
        self.total = self.total.plus(found)
        self.low, self.high = np.minimum(self.low, seen), np.maximum(self.high, seen)

    def mean(self) -> Paths:
        """Return the mean paths."""
        return self.total.times(1.0 / self.count)

    def wrong(self) -> np.ndarray:
        """Return by how much rows may be off."""
        return np.maximum(self.off, left_of_edges(self.high - self.low, self.count))

    def some(self, index: np.ndarray) -> Means:
        """Return some of the pixels."""
        rows = (row[:, index] for row in (self.seen, self.low, self.high, self.off))
        return Means(self.pixel[index], self.total.some(index), self.count, *rows)


def refine(drawing: Drawing, paths: Paths, tolerance: float) -> None:
    """Replace the paths of pixels where the picture is not smooth by means over more rays.

    Parameters
    ----------
    paths : Paths
        One ray through the centre of every pixel.
    tolerance : float
        Differences that matter, as a fraction of the brightest pixel (of transparencies: as such).
    """
    seen, pixels = _seen(drawing, paths), drawing.job.frame.pixels
    scale = _scale(seen, len(paths.transparency))
    seen = seen / scale
    low, high = _around(seen, pixels)
    bends = _bends(seen, pixels)
    rough = _rough(bends, pixels, _SMOOTH * tolerance)
    smooth = np.setdiff1d(np.arange(seen.shape[1]), rough, assume_unique=True)
    unit = drawing.source.numbers.unit
    _count(paths, smooth, bends[:, smooth] / _SMOOTH, scale, unit)
    unsettled = np.full_like(seen, np.inf)
    everywhere = Means(np.arange(seen.shape[1]), paths, 1, seen, low, high, unsettled)
    means = everywhere.some(rough)
    for count in _ROUNDS:
        if not len(means.pixel):
            break
        before = means.off
        means.take(drawing, scale, count)
        paths.put(means.pixel, means.mean())
        _count(paths, means.pixel, means.wrong(), scale, unit)
        changed = np.maximum(means.off, before).max(axis=0)
        means = means.some(np.flatnonzero((changed > tolerance) | (count < _LEAST)))


def left_of_edges(spread: np.ndarray, count: int) -> np.ndarray:
    """Return what means over so many rays may be off by, of an edge of some height.

    It was 0.3 of that for sequences like these, and three deviations are counted.
    """
    return np.asarray(spread * count**-0.75)


def _offsets(pixel: np.ndarray, number: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a point of the sequence for each pixel, from its centre (-½ to ½)."""
    shifts = (_hashed(pixel, salt) for salt in (0x9E3779B9, 0x85EBCA6B))
    steps = (1.0 / _PLASTIC, 1.0 / _PLASTIC**2)
    du, dv = (np.mod(s + number * step, 1.0) - 0.5 for s, step in zip(shifts, steps, strict=True))
    return du, dv


def _hashed(pixel: np.ndarray, salt: int) -> np.ndarray:
    """Return random-looking numbers in [0, 1) that belong to pixels (Steele et al. 2014)."""
    h = pixel.astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(salt)
    h = (h ^ (h >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    h = (h ^ (h >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return ((h ^ (h >> np.uint64(31))) >> np.uint64(11)) * 2.0**-53


def _seen(drawing: Drawing, paths: Paths) -> np.ndarray:
    """Return what a picture shows of paths, in rows: intensities, and transparencies."""
    mixed = drawing.source.numbers.mix(paths.emission)
    return np.vstack([np.moveaxis(mixed, -1, 0), *(row[None] for row in paths.transparency)])


def _scale(seen: np.ndarray, extinctions: int) -> np.ndarray:
    brightest = float(np.max(np.abs(seen[:-extinctions]), initial=0.0))
    column = np.full((len(seen), 1), brightest if brightest > 0 else 1.0, seen.dtype)
    column[-extinctions:] = 1.0
    return column


def _bends(seen: np.ndarray, pixels: tuple[int, int]) -> np.ndarray:
    """Return by how much rows bend at each pixel: the larger of the second differences.

    Pixels of the frame's edge bend as the next ones do. Of two pixels in a row the difference
    tells, one does not tell anything.
    """
    nx, ny = pixels
    planes = seen.reshape(-1, ny, nx)
    found = [_bends_along(planes, axis) for axis in (1, 2)]
    return np.maximum(*found).reshape(seen.shape)


def _bends_along(planes: np.ndarray, axis: int) -> np.ndarray:
    """Return by how much planes bend along one axis, at each of their pixels."""
    size = planes.shape[axis]
    if size == 1:
        return np.full_like(planes, np.inf)
    bends = np.abs(np.diff(planes, min(size - 1, 2), axis=axis))
    around = [(0, 0)] * planes.ndim
    around[axis] = (1, size - 1 - bends.shape[axis])
    return np.pad(bends, around, mode="edge")


def _rough(bends: np.ndarray, pixels: tuple[int, int], limit: float) -> np.ndarray:
    """Return the flat numbers of pixels at or beside which rows bend by more than a limit."""
    nx, ny = pixels
    bent = bends.max(axis=0) > limit
    return np.flatnonzero(_dilated(bent.reshape(ny, nx)))


def _around(seen: np.ndarray, pixels: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Return the least and the most that a pixel and its neighbours show, in the same rows."""
    nx, ny = pixels
    planes = np.pad(seen.reshape(-1, ny, nx), ((0, 0), (1, 1), (1, 1)), mode="edge")
    shifts = [planes[:, a : a + ny, b : b + nx] for a in range(3) for b in range(3)]
    low, high = (functools.reduce(extreme, shifts) for extreme in (np.minimum, np.maximum))
    return low.reshape(seen.shape), high.reshape(seen.shape)


def _dilated(mask: np.ndarray) -> np.ndarray:
    wide = np.pad(mask, 1)
    return np.logical_or.reduce(
        [wide[a : a + mask.shape[0], b : b + mask.shape[1]] for a in range(3) for b in range(3)]
    )


def _count(
    paths: Paths, pixel: np.ndarray, wrong: np.ndarray, scale: np.ndarray, unit: float
) -> None:
    """Count what rows of some pixels may be off by.

    Errors of intensities are in the unit of kernels, see `Direct`; those of transparencies count as
    much as there is behind.
    """
    if paths.error:
        extinctions = len(paths.transparency)
        brightest = in_kernel_unit(float(scale[0, 0]), unit)
        paths.error[0][pixel] += wrong[:-extinctions].max(axis=0) * brightest
        paths.error[1][pixel] += wrong[-extinctions:].max(axis=0)
