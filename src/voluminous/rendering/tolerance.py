"""Renders to a tolerance: estimates the brightness, then traces pixels with large errors again."""

from __future__ import annotations

import functools
import math
from collections.abc import Hashable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from .sources.channel_layout import fits_single
from .tracer import MARGIN, Batches, Paths, RayTracer

if TYPE_CHECKING:
    from .job import RenderJob

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


# Pixels that were traced, or None for all, and the arguments of the source's `allow`.
Limits: TypeAlias = tuple[np.ndarray | None, tuple[float, float, float]]


@dataclass
class Rounds:
    """With which limits the pixels of a picture were traced: what a probe of one needs to know.

    Attributes
    ----------
    limits : list of Limits
        In the order of tracing.
    faintest : bool
        Even the faintest places were not skipped.
    """

    limits: list[Limits]
    faintest: bool

    def of(self, pixel: int) -> tuple[float, float, float]:
        """Return the limits with which a pixel was traced last."""
        return next(
            limits for pixels, limits in self.limits[::-1] if pixels is None or pixel in pixels
        )

    @staticmethod
    def key(job: RenderJob, background: float) -> Hashable:
        """Return the key under which those of a job are cached; None if they cannot be."""
        rays = (repr(job.camera), job.frame.pixels, job.samples, job.recursive)
        return job.key("rounds", rays, (job.cutoff, background))


def render_to_tolerance(
    tracer: RayTracer,
    tolerance: float,
    background: float,
    seconds: float | None = None,
    focus: tuple[float, float] | None = None,
) -> Batches[tuple[Paths, list[Limits], bool]]:
    """Trace all pixels, then those again whose errors exceed the tolerance; yield each batch.

    Returns the paths, the limits, and False if the medium's faint places, which were skipped, may
    be visible. The errors are those of segments; `add_rounding_error` adds the others.
    """
    source = tracer.source
    behind = in_kernel_unit(background, source.numbers.unit)
    first, *shares = _SHARES
    scale = _estimate_scale(tracer, behind)
    if scale > 0.0:
        limits: list[Limits] = [(None, (tolerance * scale, tolerance, first))]
    else:
        limits, shares = [(None, (np.inf, np.inf, 1.0))], list(_SHARES)
    source.allow(*limits[0][1])
    paths = yield from tracer.batches(seconds, focus)
    for share in shares:
        scale = _brightness(tracer, paths, behind).max()
        wrong, dim, _ = paths.error
        floor, dim_floor = _floor(tracer, paths)
        # Rounding counts up to half of the tolerance: where it alone exceeds it more panels do not
        # help.
        rounding = np.minimum(floor + dim_floor * behind, 0.5 * tolerance * scale)
        exceeds = wrong + dim * behind + rounding > tolerance * scale
        pixel = np.flatnonzero(exceeds | (dim > tolerance))
        if not len(pixel):
            break
        limits.append((pixel, (tolerance * scale, tolerance, share)))
        source.allow(*limits[-1][1])
        paths.put(pixel, tracer.pixels(pixel))
        yield tracer, pixel, paths
    source.allow(tolerance * scale, tolerance, first)  # for rays still to come
    return paths, limits, source.neglected <= tolerance * scale


def in_kernel_unit(background: float, unit: float) -> Any:
    """Return a background in the kernel's unit, in double precision if its products need it."""
    value = background / unit
    return value if fits_single(value) else np.float64(value)


def _brightness(tracer: RayTracer, paths: Paths, behind: Any) -> np.ndarray:
    """Return the brightness of pixels in their brightest channels, in the kernel's unit."""
    brightest = tracer.source.numbers.brightest_channel(paths.emission)
    through = functools.reduce(np.maximum, paths.transparency)
    total: np.ndarray = brightest + through * behind
    # A picture without net emission is compared with the sum of magnitudes along the ray.
    return total if np.any(total) else paths.error[2]


def _estimate_scale(tracer: RayTracer, behind: Any) -> float:
    """Return the maximum brightness of a sample of pixels at any error; 0 for a small picture."""
    tracer.source.allow(np.inf, np.inf, 1.0)
    nx, ny = tracer.job.frame.pixels
    if nx * ny < _WORTHWHILE * _SAMPLES:
        return 0.0
    step = nx * ny // _SAMPLES | 1  # odd: not in few columns
    pixel = np.arange(step // 2, nx * ny, step)
    values = _brightness(tracer, tracer.pixels(pixel), behind)
    brightest = float(np.max(values))
    if brightest <= _PEAK * float(np.quantile(values, 0.99)):
        return brightest
    reach, peak = math.isqrt(step) + 1, int(pixel[np.argmax(values)])
    x, y = (
        np.arange(max(place - reach, 0), min(place + reach + 1, count))
        for place, count in ((peak % nx, nx), (peak // nx, ny))
    )
    around = tracer.pixels((y[:, None] * nx + x).reshape(-1))
    return max(brightest, float(_brightness(tracer, around, behind).max()))


def add_rounding_error(tracer: RayTracer, paths: Paths) -> None:
    """Add the errors due to rounding, underflow, skipped faint places and early termination."""
    wrong, dim, _ = paths.error
    floor, dim_floor = _floor(tracer, paths)
    wrong += floor
    dim += dim_floor


def _floor(tracer: RayTracer, paths: Paths) -> tuple[np.ndarray, float]:
    """Return the errors of emission and transparency besides those of segments."""
    source, brightness = tracer.source, paths.error[2]
    # Sums that were clamped to zero, given that colours are near one.
    clamped = 2.0 * (source.numbers.emissions + 1) * MARGIN * tracer.backend.tiny
    lost = _UNDERFLOW * float(np.max(brightness, initial=0.0)) + clamped
    floor = fixed_relative_error(tracer) * brightness + (source.neglected + lost)
    # For rays that stop early, the transparency states how much of the background is missing.
    return floor, _ROUNDING[tracer.backend.precision] + source.neglected_depth


def fixed_relative_error(tracer: RayTracer) -> float:
    """Return the relative error due to rounding, cubics and early termination."""
    lost = _ROUNDING[tracer.backend.precision]
    if tracer.ending is not None:
        lost += tracer.job.early_error
    return lost + tracer.source.lost if tracer.job.scheme.controlled else lost
