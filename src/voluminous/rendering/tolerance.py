"""Renders to a tolerance: estimates the brightness, then traces pixels with large errors again."""

from __future__ import annotations

import functools
import math
from collections.abc import Hashable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from ..schemes.channels import Channels, fits_single
from ..schemes.path import PathError
from .tracer import MARGIN, Batches, Paths, RayTracer

if TYPE_CHECKING:
    from .job import RenderJob

# Error allowed in one segment, as a fraction of a pixel's; smaller in every round.
_SHARES = (0.15, 0.03, 0.006)
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


# Pixels that were traced, or None for all; the arguments of the tracer's `allow`, and the peaks of
# channels to which errors are relative.
Allowed: TypeAlias = tuple[float, float, float]
Round: TypeAlias = tuple[np.ndarray | None, Allowed, np.ndarray]


@dataclass
class Rounds:
    """With which limits the pixels of a picture were traced: what a probe of one needs to know.

    Attributes
    ----------
    rounds : list of Round
        In the order of tracing.
    faintest : bool
        Even the faintest places were not skipped.
    """

    rounds: list[Round]
    faintest: bool

    def of(self, pixel: int) -> tuple[Allowed, np.ndarray]:
        """Return the limits with which a pixel was traced last."""
        last = self.rounds[::-1]
        return next((a, m) for pixels, a, m in last if pixels is None or pixel in pixels)

    @staticmethod
    def key(job: RenderJob, background: float) -> Hashable:
        """Return the key under which those of a job are cached; None if they cannot be."""
        clip = job.clip and str(job.clip.region)
        rays = (repr(job.camera), clip, job.frame.pixels, job.samples, job.recursive)
        return job.key("rounds", rays, (job.cutoff, background))


def render_to_tolerance(
    tracer: RayTracer,
    tolerance: float,
    background: float,
    seconds: float | None = None,
    focus: tuple[float, float] | None = None,
) -> Batches[tuple[Paths, list[Round], bool]]:
    """Trace all pixels, then those again whose errors exceed the tolerance; yield each batch.

    Returns the paths, the rounds, and False if the medium's faint places, which were skipped, may
    be visible. The errors are those of segments; `add_rounding_error` adds the others.
    """
    channels: Channels = tracer.source.channels
    spectral = channels.spectral
    first, *shares = _SHARES
    if spectral:
        scale = _estimate_maxima(tracer, background)
    else:
        scale = _estimate_scale(tracer, background)
    if scale > 0.0:
        allowed = tolerance * scale, tolerance, first
    else:
        allowed, shares = (np.inf, np.inf, 1.0), list(_SHARES)
    rounds: list[Round] = [(None, allowed, channels.peaks)]
    tracer.allow(*allowed)
    paths = yield from tracer.batches(seconds, focus)
    for share in shares:
        if spectral:
            _weigh(tracer, paths, background)
        else:
            scale = _brightness(tracer, paths, background).max()
        behind, error = in_error_unit(background, channels), PathError(*paths.error)
        floor, dim_floor = _floor(tracer, paths)
        # Rounding counts up to half of the tolerance: where it alone exceeds it more panels do not
        # help.
        rounding = np.minimum(floor + dim_floor * behind, 0.5 * tolerance * scale)
        exceeds = error.emission + error.transparency * behind + rounding > tolerance * scale
        pixel = np.flatnonzero(exceeds | (error.transparency > tolerance))
        if not len(pixel):
            break
        allowed = tolerance * scale, tolerance, share
        rounds.append((pixel, allowed, channels.peaks))
        tracer.allow(*allowed)
        paths.put(pixel, tracer.pixels(pixel))
        yield tracer, pixel, paths
    tracer.allow(tolerance * scale, tolerance, first)  # for rays still to come
    neglected = tracer.source.skipping.neglected_emission * channels.heaviest
    return paths, rounds, neglected <= tolerance * scale


def in_error_unit(background: float, channels: Channels) -> Any:
    """Return a background in the unit of errors, in double precision if its products need it."""
    value = background / channels.faintest_unit
    return value if fits_single(value) else np.float64(value)


def _brightness(tracer: RayTracer, paths: Paths, background: float) -> np.ndarray:
    channels: Channels = tracer.source.channels
    brightest = functools.reduce(np.maximum, map(np.abs, paths.emission))
    through = functools.reduce(np.maximum, paths.transparency)
    total: np.ndarray = brightest + through * in_error_unit(background, channels)
    # A picture without net emission is compared with the sum of magnitudes along the ray.
    return total if np.any(total) else PathError(*paths.error).brightness


def _estimate_maxima(tracer: RayTracer, background: float) -> float:
    """Estimate the maxima of a spectrum's channels from a sample of pixels; return their unit.

    A wrong estimate costs time: errors will be relative to the maxima of the picture itself.
    """
    channels, count = tracer.source.channels, int(np.prod(tracer.job.frame.pixels))
    channels.weigh(np.ones(channels.emissions))
    tracer.allow(np.inf, np.inf)
    step = max(count // _SAMPLES, _WORTHWHILE) | 1  # odd: not in few columns
    paths = tracer.pixels(np.arange(min(step // 2, count - 1), count, step))
    _weigh(tracer, paths, background)
    return 1.0


def _weigh(tracer: RayTracer, paths: Paths, background: float) -> None:
    channels, error = tracer.source.channels, PathError(*paths.error)
    growth = channels.weigh(channels.maxima(paths.emission, paths.transparency, background))
    for part in (error.emission, error.brightness):
        part *= growth
    if channels.medium.thermal:  # nothing is negative: brightness is no more than all channels'
        total = sum(b / peak for b, peak in zip(paths.emission, channels.peaks, strict=True))
        np.minimum(error.brightness, total, out=error.brightness)


def _estimate_scale(tracer: RayTracer, background: float) -> float:
    """Return the maximum brightness of a sample of pixels at any error; 0 for a small picture."""
    tracer.allow(np.inf, np.inf)
    nx, ny = tracer.job.frame.pixels
    if nx * ny < _WORTHWHILE * _SAMPLES:
        return 0.0
    step = nx * ny // _SAMPLES | 1  # odd: not in few columns
    pixel = np.arange(step // 2, nx * ny, step)
    values = _brightness(tracer, tracer.pixels(pixel), background)
    brightest = float(np.max(values))
    if brightest <= _PEAK * float(np.quantile(values, 0.99)):
        return brightest
    reach, peak = math.isqrt(step) + 1, int(pixel[np.argmax(values)])
    x, y = (
        np.arange(max(place - reach, 0), min(place + reach + 1, count))
        for place, count in ((peak % nx, nx), (peak // nx, ny))
    )
    around = tracer.pixels((y[:, None] * nx + x).reshape(-1))
    return max(brightest, float(_brightness(tracer, around, background).max()))


def add_rounding_error(tracer: RayTracer, paths: Paths) -> None:
    """Add the errors due to rounding, underflow, skipped faint places and early termination."""
    error = PathError(*paths.error)
    for part, floor in zip(error, _floor(tracer, paths), strict=False):
        part += floor


def _floor(tracer: RayTracer, paths: Paths) -> tuple[np.ndarray, float]:
    channels, skipping = tracer.source.channels, tracer.source.skipping
    brightness = PathError(*paths.error).brightness
    # Sums that were clamped to zero, given that colours are near one.
    clamped = 2.0 * (channels.emissions + 1) * MARGIN * tracer.backend.tiny
    lost = _UNDERFLOW * float(np.max(brightness, initial=0.0))
    lost += (skipping.neglected_emission + clamped) * channels.heaviest
    floor = fixed_relative_error(tracer) * brightness + lost
    # For rays that stop early, the transparency states how much of the background is missing.
    return floor, _ROUNDING[tracer.backend.precision] + skipping.neglected_depth


def fixed_relative_error(tracer: RayTracer) -> float:
    """Return the relative error due to rounding, cubics and early termination."""
    lost = _ROUNDING[tracer.backend.precision]
    if tracer.ending is not None:
        lost += tracer.job.early_error
    return lost + tracer.source.lost if tracer.job.controlled else lost
