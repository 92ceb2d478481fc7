"""Derivatives of pictures by the numbers of a medium: rays are traced again, from front to back.

The intensity of a ray is B = b₁ + θ₁ (b + θ b₂), for a segment (b, θ) behind (b₁, θ₁) and before
(b₂, θ₂). With B known from a first pass, B - b₁ - θ₁ b is what is seen of all that lies behind, so

    ∂B/∂b = θ₁,    ∂B/∂θ = (B - b₁ - θ₁ b) / θ

need nothing but the path in front (Vicini, Speierer & Jakob 2021, *Path replay backpropagation*).
Each segment is differentiated where it is solved, with everything that it depends on evaluated
again; nothing is stored along a ray.
"""

from __future__ import annotations

import copy
import functools
import operator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..backend import dr, from_host
from ..backend.types import Float, Mask
from ..errors import InputError
from ..grids.contract import Segment
from ..media.context import Tape
from ..schemes.base import Around, Position, Scheme, Solution, Source
from ..schemes.path import Path, empty_path, over
from ..schemes.post_classified import PostClassified
from .job import RenderJob
from .pixels import whole_picture
from .run import make_tracer, run
from .tracer import RayTracer


@dataclass
class _Before:
    """What a segment begins with.

    The path in front, the scheme's state, where that was not carried from the segment before
    (`fresh`), and that segment.
    """

    path: Path
    state: list[Float]
    fresh: Mask
    segment: tuple[Any, ...]


_PARTS = "cell", "length", "begin", "end", "active", "exit"
_parts = operator.attrgetter(*_PARTS)


class Replay(Around[Source]):
    """A scheme that adds the derivatives of Σ `weights` · intensity to all that segments depend on.

    What is carried in a loop has no derivatives: the scheme's state is computed again where it was
    computed first, in the previous segment.
    """

    def __init__(self, scheme: Scheme[Source], total: Path, weights: list[Float]) -> None:
        super().__init__(scheme)
        self.total, self.weights = total, weights

    def start(self, position: Position, source: Source) -> list[Any]:
        first, _ = position.walk.next(position.track, position.cursor)
        own = self.scheme.start(position, source)
        return [_Before(self._nothing(source), own, position.cursor.inside, _parts(first))]

    def after_skip(
        self, position: Position, source: Source, carried: list[Any], moved: Mask
    ) -> list[Any]:
        (before,) = carried
        return [replace(before, fresh=before.fresh | moved)]

    def solve(
        self, segment: Segment, source: Source, carried: list[Any]
    ) -> tuple[Solution, list[Any]]:
        (before,) = carried
        never, place = before.fresh & False, Position(segment.walk, segment.track, segment.entry)
        if isinstance(self.scheme, PostClassified):
            own: Any = copy.copy(self.scheme)
            own.recording = dr.resume_grad
            own.accepted = functools.partial(self._add, before, segment.active)
            state = own.after_skip(place, source, before.state, before.fresh)
            solution, state = own.solve(segment, source, state)
        else:
            previous = replace(segment, **dict(zip(_PARTS, before.segment, strict=True)))
            with dr.resume_grad():  # type: ignore[no-untyped-call]
                _, state = self.scheme.solve(previous, source, before.state)
                state = self.scheme.after_skip(place, source, state, before.fresh)
                solution, _ = self.scheme.solve(segment, source, state)
            self._add(before, segment.active, solution, segment.active)
        solution, state = dr.detach(solution), dr.detach(state)
        return solution, [_Before(over(before.path, solution), state, never, _parts(segment))]

    def _add(self, before: _Before, shown: Mask, piece: Path, where: Mask) -> None:
        with dr.resume_grad():  # type: ignore[no-untyped-call]
            seen = over(before.path, dr.detach(piece)).emission
            loss: Float = 0.0
            for c, (weight, b) in enumerate(zip(self.weights, piece.emission, strict=True)):
                k = c if len(piece.transparency) > 1 else 0
                theta = piece.transparency[k]
                behind = self.total.emission[c] - seen[c]
                behind = behind / dr.select(theta > 0.0, dr.detach(theta), 1.0)
                loss = loss + weight * dr.fma(before.path.transparency[k], b, behind * theta)
            dr.backward_from(dr.select(where & shown, loss, 0.0))

    def _nothing(self, source: Source) -> Path:
        return empty_path(source.backend.Float, len(self.weights), len(self.total.transparency))


def tracer_like(job: RenderJob, drawn: RayTracer | None) -> RayTracer:
    """Return a tracer with the tolerance of one that has drawn, if there is one."""
    tracer = make_tracer(job, 0.0)
    if drawn is not None:
        tracer.tolerance = drawn.tolerance
    return tracer


def gradient(job: RenderJob, weights: np.ndarray) -> tuple[np.ndarray, Tape]:
    """Return intensities, and the numbers of the medium with the gradient of Σ weights · intensity.

    Parameters
    ----------
    job : RenderJob
        One whose backend has derivatives. Each pixel is one ray.
    weights : float array, shape (ny, nx, channel)
        The derivatives of a loss by the intensities, for example.

    Returns
    -------
    intensity : float array, shape (ny, nx, channel)
        Without a background.
    tape : Tape
        `drjit.grad` of its numbers is the gradient. Numbers in tables of media are not among them.

    Raises
    ------
    InputError
        If rays run towards the observer, or the scheme ends panels at the medium's jumps.
    """
    if job.backward:
        raise InputError(
            f"scheme {job.scheme.name!r} has no gradient: its rays run to the observer"
        )
    lanes, (nx, ny) = whole_picture(job.frame.pixels, job.backend), job.frame.pixels
    with dr.suspend_grad():  # type: ignore[no-untyped-call]
        drawn = run(job, 0.0).tracer if job.controlled else None
    tape = job.tape = Tape()
    tracer = tracer_like(job, drawn)
    if job.controlled and tracer.source.channels.bound.jumps():
        raise InputError(
            f"scheme {job.scheme.name!r} ends its panels where a medium jumps, and has no gradient "
            "by the places of its jumps (of vm.Rectangle, where=…); take scheme='pre-integrated'"
        )
    ray = tracer.ray(lanes)
    with dr.suspend_grad():  # type: ignore[no-untyped-call]
        total = tracer.march(ray).path
        dr.eval(total)
    dr.enable_grad(list(tape.numbers.values()))
    tracer = tracer_like(job, drawn)  # its tables depend on the numbers
    channels, real = tracer.source.channels, job.backend.Float
    intensity = np.zeros((len(total.emission), ny * nx))
    there = np.asarray(lanes.there)
    intensity[:, np.asarray(lanes.target)[there]] = [np.asarray(b)[there] for b in total.emission]
    given = [
        dr.gather(real, from_host(real, channel), lanes.target, lanes.there)
        for channel in (np.reshape(weights, (-1, len(total.emission))) * channels.unit).T
    ]
    tracer.scheme = Replay(tracer.scheme, total, given)
    with dr.suspend_grad():  # type: ignore[no-untyped-call]
        dr.eval(tracer.march(ray).path)
    return channels.intensity(intensity.reshape(-1, ny, nx)), tape
