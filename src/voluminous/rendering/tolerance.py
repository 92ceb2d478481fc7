"""Renders to a tolerance: estimates the brightness, then traces pixels with large errors again."""

from __future__ import annotations

import functools
import math
from collections.abc import Generator
from typing import TYPE_CHECKING, Any

import numpy as np

from .sources.channel_layout import fits_single
from .tracer import MARGIN, Traced

if TYPE_CHECKING:
    from .tracer import Paths, RayTracer


# Error allowed in one segment, as a fraction of a pixel's; smaller in every round.
_SHARES = (0.05, 0.01, 0.002)
# Number of pixels that estimate the brightness of a picture, if it has at least a few times as
# many. Without the estimate half of the pixels of shells in real data were drawn twice: it takes
# 1.1 s instead of 1.7, and 1.5 instead of 2.4.
_SAMPLES, _WORTHWHILE = 2500, 4
# If the brightest sample exceeds nearly all others by this factor, it may be beside a peak that is
# brighter still.
_PEAK = 3.0
# Rounding error of a path of many segments, as a fraction of its brightness.
_ROUNDING = {"single": 3e-6, "double": 1e-14}
# Underflow may remove light below this fraction of the brightest pixel: e.g. far outside of a
# Gaussian pixels are black that should not be.
_UNDERFLOW = 1e-12


def render_to_tolerance(
    tracer: RayTracer,
    tolerance: float,
    background: float,
    seconds: float | None = None,
    focus: tuple[float, float] | None = None,
) -> Generator[Traced, None, tuple[Paths, bool]]:
    """Trace all pixels, then those again whose errors exceed the tolerance; yield each batch.

    Returns the paths, and False if the medium's faint places, which were skipped, may be visible.
    The errors are those of segments; `add_rounding_error` adds the others.
    """
    source = tracer.source
    behind = in_kernel_unit(background, source.numbers.unit)
    first, *shares = _SHARES
    scale = estimate_scale(tracer, behind)
    if scale > 0.0:
        source.allow(tolerance * scale, tolerance, first)
    else:
        shares = list(_SHARES)
    paths = yield from tracer.batches(seconds, focus)
    for share in shares:
        scale = _brightness(tracer, paths, behind).max()
        mended = mend(tracer, paths, tolerance, scale, behind, share)
        if mended is None:
            break
        yield Traced(mended, paths)
    source.allow(tolerance * scale, tolerance, first)  # for rays still to come
    return paths, source.neglected <= tolerance * scale


def mend(
    tracer: RayTracer, paths: Paths, tolerance: float, scale: Any, behind: Any, share: float
) -> np.ndarray | None:
    """Trace pixels with too large an error again, each segment with a share of the tolerance.

    Returns their flat indices; None if there are none.
    """
    wrong = _too_wrong(tracer, paths, tolerance, scale, behind)
    if not len(wrong):
        return None
    tracer.source.allow(tolerance * scale, tolerance, share)
    paths.put(wrong, tracer.pixels(wrong))
    return wrong


def in_kernel_unit(background: float, unit: float) -> Any:
    """Return a background in the kernel's unit, in double precision if its products need it."""
    found = background / unit
    return found if fits_single(found) else np.float64(found)


def _brightness(tracer: RayTracer, paths: Paths, behind: Any) -> Any:
    """Return the brightness of pixels in their brightest channels, in the kernel's unit."""
    seen = tracer.source.numbers.brightest_channel(paths.emission)
    through = functools.reduce(np.maximum, paths.transparency)
    # A picture without net emission is compared with the sum of magnitudes along the ray.
    bright = seen + through * behind
    return bright if np.any(bright) else paths.error[2]


def estimate_scale(tracer: RayTracer, behind: Any) -> float:
    """Return the maximum brightness of a sample of pixels at any error; 0 for a small picture."""
    tracer.source.allow(np.inf, np.inf, 1.0)
    nx, ny = tracer.job.frame.pixels
    if nx * ny < _WORTHWHILE * _SAMPLES:
        return 0.0
    step = nx * ny // _SAMPLES | 1  # odd: not in few columns
    pixel = np.arange(step // 2, nx * ny, step)
    found = _brightness(tracer, tracer.pixels(pixel), behind)
    brightest = float(np.max(found))
    if brightest <= _PEAK * float(np.quantile(found, 0.99)):
        return brightest
    around = tracer.pixels(_around(pixel[np.argmax(found)], step, nx, ny))
    return max(brightest, float(_brightness(tracer, around, behind).max()))


def _around(pixel: int, step: int, nx: int, ny: int) -> np.ndarray:
    reach = math.isqrt(step) + 1
    x, y = (
        np.arange(max(place - reach, 0), min(place + reach + 1, count))
        for place, count in ((pixel % nx, nx), (pixel // nx, ny))
    )
    return np.asarray((y[:, None] * nx + x).reshape(-1))


def _too_wrong(
    tracer: RayTracer, paths: Paths, tolerance: float, scale: Any, behind: Any
) -> np.ndarray:
    """Return which pixels exceed the tolerance, rounding included.

    Rounding counts up to half of the tolerance: where it alone exceeds it more panels do not help.
    """
    wrong, dim, _ = paths.error
    floor, dim_floor = _floor(tracer, paths)
    total = wrong + dim * behind + np.minimum(floor + dim_floor * behind, 0.5 * tolerance * scale)
    return np.flatnonzero((total > tolerance * scale) | (dim > tolerance))


def add_rounding_error(tracer: RayTracer, paths: Paths) -> None:
    """Add the errors due to rounding, underflow, skipped faint places and early termination."""
    wrong, dim, _ = paths.error
    floor, dim_floor = _floor(tracer, paths)
    wrong += floor
    dim += dim_floor


def _floor(tracer: RayTracer, paths: Paths) -> tuple[np.ndarray, float]:
    """Return the errors of emission and transparency besides those of segments."""
    brightness = paths.error[2]
    lost = _UNDERFLOW * float(np.max(brightness, initial=0.0)) + _flushed(tracer)
    floor = fixed_relative_error(tracer) * brightness + (tracer.source.neglected + lost)
    # For rays that stop early, the transparency states how much of the background is missing.
    return floor, _ROUNDING[tracer.backend.precision] + tracer.source.neglected_depth


def _flushed(tracer: RayTracer) -> float:
    """Return a bound of sums that were clamped to zero, given that colours are near one."""
    sums = tracer.source.numbers.emissions + 1
    return 2.0 * sums * MARGIN * float(np.finfo(tracer.backend.dtype).tiny)


def fixed_relative_error(tracer: RayTracer) -> float:
    """Return the relative error due to rounding, cubics and early termination."""
    lost = _ROUNDING[tracer.backend.precision]
    if tracer.ending is not None:
        lost += tracer.job.early_error
    if tracer.job.scheme.controlled:
        lost += tracer.source.lost
    return lost


def total_error(paths: Paths, background: float) -> Any:
    """Return the error of intensities in front of a background."""
    return paths.error[0] + paths.error[1] * background
