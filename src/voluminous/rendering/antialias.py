"""Adaptive antialiasing: more rays where the picture is not smooth."""

from __future__ import annotations

import functools

import numpy as np

from .tracer import Paths, RayTracer

# Rays per pixel after each round.
_ROUNDS = (8, 16, 32, 64, 128, 256)
# A mean has converged when each of two consecutive rounds changed it by less than the tolerance.
_LEAST = 32
# Roberts' sequence in two dimensions: the inverse plastic number, x³ = x + 1, and its square.
_PLASTIC = 1.32471795724474602596
# Second differences of neighbours below this many tolerances are smooth. The difference between a
# pixel's mean and its centre value is a twelfth of them where the picture is smooth, and up to a
# half, a fourth on average over all positions, where it has small edges; this is included in the
# error.
_SMOOTH = 4.0


def refine(tracer: RayTracer, paths: Paths, tolerance: float) -> None:
    """Replace the paths of pixels where the picture is not smooth by means over more rays.

    Picture values are compared in rows: intensities, as fractions of the brightest, then
    transparencies.
    """
    values, (nx, ny) = _picture_values(tracer, paths), tracer.job.frame.pixels
    clear = len(paths.transparency)
    numbers = tracer.source.numbers
    scale = np.max(np.abs(values), axis=1, initial=0.0, keepdims=True)
    brightest = float(np.max(scale[:-clear])) or 1.0
    if not numbers.spectral:
        scale[:-clear] = brightest
    scale[-clear:] = 1.0
    scale[scale == 0.0] = 1.0
    values /= scale
    planes = values.reshape(-1, ny, nx)

    def add_error(pixel: np.ndarray, wrong: np.ndarray) -> None:
        if paths.error:
            unit = brightest / numbers.error_unit
            paths.error[0][pixel] += wrong[:-clear].max(axis=0) * unit
            paths.error[1][pixel] += wrong[-clear:].max(axis=0)

    bends = np.maximum(_bends(planes, 1), _bends(planes, 2))
    rough = (bends.max(axis=0) > _SMOOTH * tolerance)[None]
    rough = _over_neighbours(np.logical_or, rough, mode="constant").ravel()
    pixel, smooth = np.flatnonzero(rough), np.flatnonzero(~rough)
    add_error(smooth, bends.reshape(values.shape)[:, smooth] / _SMOOTH)
    # The least and largest values of single rays: the pixel's, and those through the centres of the
    # neighbouring pixels.
    low, high = (
        _over_neighbours(extreme, planes, mode="edge").reshape(values.shape)[:, pixel]
        for extreme in (np.minimum, np.maximum)
    )
    total, mean, last = paths.some(pixel), values[:, pixel], np.full_like(low, np.inf)
    done = 1
    for count in _ROUNDS:
        if not len(pixel):
            break
        for ray in range(done, count):
            # There may be many times as many rays as the picture has pixels.
            tracer.job.progress((ray - done) * len(pixel), (count - done) * len(pixel))
            new = tracer.rays(pixel, *_offsets(pixel, ray))
            total, seen = new.plus(total), _picture_values(tracer, new) / scale
            low, high = np.minimum(low, seen), np.maximum(high, seen)
        done, result = count, total.over_count(count)
        paths.put(pixel, result)
        before, mean = mean, _picture_values(tracer, result) / scale
        change = np.abs(mean - before)
        add_error(pixel, np.maximum(change, error_at_edges(high - low, count)))
        most = np.maximum(change, last).max(axis=0)
        more = np.flatnonzero((most > tolerance) | (count < _LEAST))
        pixel, total = pixel[more], total.some(more)
        low, high, mean, last = (rows[:, more] for rows in (low, high, mean, change))


def error_at_edges(height: np.ndarray, count: int) -> np.ndarray:
    """Return the error of means over a number of rays, due to an edge of some height.

    For sequences like these it was 0.3 of the returned value, which includes three deviations.
    """
    return np.asarray(height * count**-0.75)


def _offsets(pixel: np.ndarray, number: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a point of the sequence for each pixel, relative to its centre (-½ to ½)."""
    shifts = (_hashed(pixel, salt) for salt in (0x9E3779B9, 0x85EBCA6B))
    steps = (1.0 / _PLASTIC, 1.0 / _PLASTIC**2)
    du, dv = (np.mod(s + number * step, 1.0) - 0.5 for s, step in zip(shifts, steps, strict=True))
    return du, dv


def _hashed(pixel: np.ndarray, salt: int) -> np.ndarray:
    """Return pseudo-random numbers in [0, 1) for pixels (Steele et al. 2014)."""
    h = pixel.astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(salt)
    h = (h ^ (h >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    h = (h ^ (h >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.asarray(((h ^ (h >> np.uint64(31))) >> np.uint64(11)) * 2.0**-53)


def _picture_values(tracer: RayTracer, paths: Paths) -> np.ndarray:
    mixed = tracer.source.numbers.mix(paths.emission)
    return np.vstack([np.moveaxis(mixed, -1, 0), *(row[None] for row in paths.transparency)])


def _bends(planes: np.ndarray, axis: int) -> np.ndarray:
    """Return the second differences of planes along one axis, at each of their pixels.

    Pixels at the frame's edge take the value of the next ones. Two pixels in a row give their
    difference, a single one infinity.
    """
    size = planes.shape[axis]
    if size == 1:
        return np.full_like(planes, np.inf)
    bends = np.abs(np.diff(planes, min(size - 1, 2), axis=axis))
    around = [(0, 0)] * planes.ndim
    around[axis] = (1, size - 1 - bends.shape[axis])
    return np.pad(bends, around, mode="edge")


def _over_neighbours(combine: np.ufunc, planes: np.ndarray, *, mode: str) -> np.ndarray:
    """Return planes combined over each pixel and its eight neighbours."""
    _, ny, nx = planes.shape
    wide = np.pad(planes, ((0, 0), (1, 1), (1, 1)), mode=mode)  # type: ignore[call-overload]
    shifts = [wide[:, a : a + ny, b : b + nx] for a in range(3) for b in range(3)]
    return np.asarray(functools.reduce(combine, shifts))
