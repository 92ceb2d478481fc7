"""Draws a `RenderJob`: the planes of an image, at once or batch by batch."""

from __future__ import annotations

import functools
from collections.abc import Generator
from dataclasses import dataclass

import numpy as np

from ..backend import dr
from ..schemes.channels import channels_last, in_units_of
from .antialias import refine
from .job import RenderJob
from .tolerance import Rounds, add_rounding_error, in_error_unit, render_to_tolerance
from .tracer import Batches, RayTracer, exhausted


@dataclass
class RenderResult:
    """The pixels' paths as NumPy arrays (ny, nx, channel or 1), and whether rays stopped early."""

    emission: np.ndarray
    transparency: np.ndarray
    depth: np.ndarray
    # Of the intensity, (ny, nx): in the worst channel, or of a spectrum in the brightest one.
    error: np.ndarray | None
    stopped: bool
    # For further rays.
    tracer: RayTracer
    # Of a picture that was drawn to a tolerance.
    rounds: Rounds | None

    @functools.cached_property
    def ends(self) -> tuple[float, float]:
        """The smallest emission, which may be negative, and the largest; NaN if one is."""
        return float(self.emission.min()), float(self.emission.max())

    @functools.cached_property
    def finite(self) -> bool:
        """Whether all results are finite; testing only their extremes takes a fifth of the time."""
        return bool(np.all(np.isfinite([*self.ends, self.depth.max(), self.depth.min()])))

    @property
    def nothing(self) -> bool:
        """Whether nothing emits or absorbs."""
        through = self.transparency
        return self.ends == (0.0, 0.0) and through.min() == 1.0 == through.max()


def run(job: RenderJob, brightest_background: float) -> RenderResult:
    """Draw all pixels."""
    return exhausted(_run(job, brightest_background))


def run_in_batches(
    job: RenderJob, background: float, seconds: float | None, focus: tuple[float, float] | None
) -> Generator[tuple[np.ndarray, np.ndarray, np.ndarray], None, RenderResult]:
    """Draw in batches: yield pixels, intensities and transparencies; see `api.in_steps`."""
    drawing = _run(job, background, seconds, focus)
    while True:
        try:
            tracer, pixel, paths = next(drawing)
        except StopIteration as end:
            result: RenderResult = end.value
            return result
        batch = paths.some(pixel)
        intensity = tracer.source.channels.intensity(batch.emission)
        yield pixel, intensity, np.stack(batch.transparency, axis=-1)


def _run(
    job: RenderJob,
    background: float,
    seconds: float | None = None,
    focus: tuple[float, float] | None = None,
) -> Batches[RenderResult]:
    """Draw all pixels; in double precision where results of single precision are not finite.

    In a quotient of two fields that vanish at the same place, rounding makes the denominator zero
    first on one ray in some thousand.
    """
    result = yield from _draw(job, background, seconds, focus)
    if not result.finite and job.backend.precision == "single" and job.backend.device != "metal":
        job.take_double()
        result = yield from _draw(job, background, seconds, focus)
    return result


def _draw(
    job: RenderJob,
    background: float,
    seconds: float | None,
    focus: tuple[float, float] | None,
) -> Batches[RenderResult]:
    tracer, rounds = make_tracer(job, background), None
    if job.controlled:
        options = job.tolerance, background, seconds, focus
        paths, done, enough = yield from render_to_tolerance(tracer, *options)
        if not enough:  # everything visible is as faint as the skipped places
            tracer = make_tracer(job, background, faintest=True)
            paths, done, _ = yield from render_to_tolerance(tracer, *options)
        rounds = Rounds(done, faintest=not enough)
        if key := Rounds.key(job, background):
            job.cache.put(key, rounds)
    else:
        paths = yield from tracer.batches(seconds, focus)
    if job.adaptive:
        refine(tracer, paths, job.tolerance)
    if job.controlled:
        add_rounding_error(tracer, paths)
    if len(tracer.groups) > 1:  # memory of their tables
        dr.flush_malloc_cache()
    (nx, ny), channels = job.frame.pixels, tracer.source.channels
    emission, through, depth, error = (
        [row.reshape(ny, nx) for row in rows]
        for rows in (paths.emission, paths.transparency, paths.depth, paths.error)
    )
    wrong = None
    if error:
        behind = in_error_unit(background, channels)
        wrong = in_units_of(channels.error_unit, error[0] + error[1] * behind)
    planes = channels.intensity(emission), channels_last(through), channels_last(depth), wrong
    return RenderResult(*planes, paths.stopped, tracer, rounds)


def make_tracer(job: RenderJob, background: float, *, faintest: bool = False) -> RayTracer:
    """Return the tracer of a job's pixels."""
    return job.partition.tracer(job, job.source(faintest), background, faintest)
