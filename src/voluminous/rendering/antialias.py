"""Adaptive antialiasing: more rays where the picture is not smooth."""

from __future__ import annotations

import functools

import numpy as np

from .pixels import subpixel_offsets
from .tracer import Paths, RayTracer

# Rays per pixel along each axis, in each round. In turbulence at 200² the first is the picture of
# `samples=4`, to 2e-4 of the maximum; a random sequence of up to 256 rays took ten times as long.
_ROUNDS = (4, 8, 16)
# Rows and columns of rays are compared in so many bands.
_BANDS = 4
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
    channels = tracer.source.channels
    scale = np.max(np.abs(values), axis=1, initial=0.0, keepdims=True)
    brightest = float(np.max(scale[:-clear])) or 1.0
    if not channels.spectral:
        scale[:-clear] = brightest
    scale[-clear:] = 1.0
    scale[scale == 0.0] = 1.0
    values /= scale
    planes = values.reshape(-1, ny, nx)

    def add_error(pixel: np.ndarray, wrong: np.ndarray) -> None:
        if paths.error:
            unit = brightest / channels.error_unit
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
    total: Paths | None
    for n in _ROUNDS:
        if not len(pixel):
            break
        bands, total = np.zeros((2, _BANDS, *low.shape)), None
        for ray, (du, dv) in enumerate(subpixel_offsets(n)):
            # There may be many times as many rays as the picture has pixels.
            tracer.job.progress(ray * len(pixel), n * n * len(pixel))
            new = tracer.rays(pixel, np.full(len(pixel), du), np.full(len(pixel), dv))
            total, seen = new.plus(total), _picture_values(tracer, new) / scale
            low, high = np.minimum(low, seen), np.maximum(high, seen)
            for own, part in zip(bands, (du, dv), strict=True):
                own[int((part + 0.5) * _BANDS)] += seen
        assert total is not None
        paths.put(pixel, total.over_count(n * n))
        change = _unevenness(bands / (n * n / _BANDS)) / (8.0 * n)
        add_error(pixel, np.maximum(change, error_at_edges(high - low, n * n)))
        more = np.flatnonzero(change.max(axis=0) > tolerance)
        pixel, low, high = pixel[more], low[:, more], high[:, more]


def _unevenness(bands: np.ndarray) -> np.ndarray:
    a, b, c, d = np.moveaxis(bands, 1, 0)
    found: np.ndarray = np.abs(a - b - c + d) + np.abs(a - 3.0 * b + 3.0 * c - d)
    return np.asarray(found.max(axis=0))


def error_at_edges(height: np.ndarray, count: int) -> np.ndarray:
    """Return the error of means over a number of rays, due to an edge of some height.

    Of evenly spaced rays the edge may miss half a row.
    """
    return np.asarray(0.5 * height * count**-0.5)


def _picture_values(tracer: RayTracer, paths: Paths) -> np.ndarray:
    mixed = tracer.source.channels.intensity(paths.emission)
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
    _, ny, nx = planes.shape
    wide = np.pad(planes, ((0, 0), (1, 1), (1, 1)), mode=mode)  # type: ignore[call-overload]
    shifts = [wide[:, a : a + ny, b : b + nx] for a in range(3) for b in range(3)]
    return np.asarray(functools.reduce(combine, shifts))
