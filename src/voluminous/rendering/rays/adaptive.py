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

from .paths import Paths

if TYPE_CHECKING:
    from .drawing import Drawing

# Rays per pixel after each round.
_ROUNDS = (8, 16, 32, 64, 128, 256)
# A mean has settled when two rounds after one another changed it by less than the tolerance.
_LEAST = 32
# Roberts' sequence in two dimensions: the inverse plastic number, x³ = x + 1, and its square.
_PLASTIC = 1.32471795724474602596
# Second differences of neighbours below this many tolerances are smooth: a twelfth of them is what
# a pixel's mean differs from its centre.
_SMOOTH = 4.0


@dataclass
class Means:
    """Sums over the rays of some pixels, what they show, and by how much that changed."""

    pixel: np.ndarray
    total: Paths
    count: int
    seen: np.ndarray
    off: np.ndarray


def refine(drawing: Drawing, paths: Paths, tolerance: float) -> None:
    """Replace the paths of pixels where the picture is not smooth by means over more rays.

    Parameters
    ----------
    paths : Paths
        One ray through the centre of every pixel.
    tolerance : float
        Differences that matter, as a fraction of the brightest pixel (of transparencies: as such).
    """
    seen = _seen(drawing, paths)
    scale = _scale(seen, drawing)
    rough = _rough(seen / scale, drawing.job.frame.pixels, _SMOOTH * tolerance)
    contrast = _contrast(seen / scale, drawing.job.frame.pixels)
    brightest = float(np.max(scale[:-1], initial=0.0))
    means = Means(
        rough, paths.some(rough), 1, (seen / scale)[:, rough], np.full(len(rough), np.inf)
    )
    for count in _ROUNDS:
        if not len(means.pixel):
            break
        more = _drawn(drawing, means.pixel, range(means.count, count))
        total = means.total.plus(more)
        now = _seen(drawing, total.times(1.0 / count)) / scale
        off = np.max(np.abs(now - means.seen), axis=0)
        # What such sequences leave of an edge through a pixel (0.3, and three deviations).
        edge = contrast[means.pixel] * count**-0.75
        _store(paths, means.pixel, total, count, np.maximum(off, edge) * brightest)
        rest = np.flatnonzero((np.maximum(off, means.off) > tolerance) | (count < _LEAST))
        means = Means(means.pixel[rest], total.some(rest), count, now[:, rest], off[rest])


def _drawn(drawing: Drawing, pixel: np.ndarray, numbers: range) -> Paths:
    """Return the sums of the paths of the rays with some numbers through each pixel.

    Each of them is reported: there may be many times as many as the picture has pixels.
    """
    total = None
    for done, number in enumerate(numbers):
        drawing.job.progress(done * len(pixel), len(numbers) * len(pixel))
        du, dv = _offsets(pixel, number)
        found = drawing.rays(pixel, du, dv)
        total = found if total is None else total.plus(found)
    assert total is not None
    return total


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
    """Return what a picture shows of paths, in rows: intensities, and the mean transparency."""
    mixed = drawing.source.numbers.mix(paths.emission)
    return np.vstack([np.moveaxis(mixed, -1, 0), np.mean(paths.transparency, axis=0)[None]])


def _scale(seen: np.ndarray, drawing: Drawing) -> np.ndarray:
    """Return what differences in each row are compared with."""
    brightest = float(np.max(np.abs(seen[:-1]), initial=0.0))
    column = np.full((len(seen), 1), brightest if brightest > 0 else 1.0, seen.dtype)
    column[-1] = 1.0
    return column


def _rough(seen: np.ndarray, pixels: tuple[int, int], limit: float) -> np.ndarray:
    """Return the flat numbers of pixels at or beside which rows bend by more than a limit."""
    nx, ny = pixels
    planes = seen.reshape(-1, ny, nx)
    bent = np.zeros((ny, nx), bool)
    for axis in (1, 2):
        if planes.shape[axis] > 2:
            bends = np.abs(np.diff(planes, 2, axis=axis)).max(axis=0) > limit
            inner = [slice(None), slice(None)]
            inner[axis - 1] = slice(1, -1)
            bent[tuple(inner)] |= bends
        elif planes.shape[axis] == 2:
            bent |= np.abs(np.diff(planes, axis=axis)).max(axis=0) > limit
    return np.flatnonzero(_dilated(bent))


def _contrast(seen: np.ndarray, pixels: tuple[int, int]) -> np.ndarray:
    """Return by how much a pixel and its neighbours differ at most."""
    nx, ny = pixels
    planes = np.pad(seen.reshape(-1, ny, nx), ((0, 0), (1, 1), (1, 1)), mode="edge")
    shifts = [planes[:, a : a + ny, b : b + nx] for a in range(3) for b in range(3)]
    spread = functools.reduce(np.maximum, shifts) - functools.reduce(np.minimum, shifts)
    return spread.max(axis=0).reshape(-1)


def _dilated(mask: np.ndarray) -> np.ndarray:
    """Return a mask with all neighbours of what is true."""
    wide = np.pad(mask, 1)
    return np.logical_or.reduce(
        [wide[a : a + mask.shape[0], b : b + mask.shape[1]] for a in range(3) for b in range(3)]
    )


def _store(paths: Paths, pixel: np.ndarray, total: Paths, count: int, off: np.ndarray) -> None:
    """Put the means of some pixels in the place of what they were."""
    paths.put(pixel, total.times(1.0 / count))
    if paths.error:
        paths.error[0][pixel] += off
