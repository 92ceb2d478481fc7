"""Guaranteed bounds of a picture: brackets along rays, narrowed where they are too wide."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..errors import InputError
from ..media import Medium
from ..rendering.job import RenderJob
from ..rendering.pixels import TILE
from ..rendering.tracer import Paths, RayTracer, exhausted
from ..schemes.channels import channel_groups
from .bracket import Bracket
from .fields import Bracketed

# Largest bracket width of one panel, relative to that of a pixel; lowered in every round.
_SHARES = (0.03, 0.004, 0.0005)
# Rounding error of one panel, in ε of the accumulated value.
_ROUNDING = 256 * float(np.finfo(np.float64).eps)
# Sums that are smaller count as zero in kernels.
_TINY = 1e-290
# A panel takes as long as some hundred cells do otherwise.
_SMALLER_BATCHES = 64


def check_bounds(bounds: Any, max_panels: Any, job: RenderJob) -> int:
    """Return the budget of panels per segment; 0 for no bounds."""
    if not isinstance(bounds, bool):
        raise InputError(
            f"bounds must be True or False, got {bounds!r}; max_panels limits the panels per "
            "segment, as in bounds=True, max_panels=64"
        )
    if not isinstance(max_panels, (int, np.integer)) or max_panels < 1:
        raise InputError(f"max_panels must be a whole number from 1, got {max_panels!r}")
    if not bounds:
        return 0
    if job.scheme.coefficients_at != "field":
        raise InputError(
            "bounds are of fields interpolated between cell centres: take "
            f"scheme='post-classified', got {job.scheme.name!r}"
        )
    if job.medium.thermal or job.medium.sight:
        raise InputError(
            "bounds are of media of expressions; of spectral media image.error is an estimate: "
            "leave out bounds=True, or give a smaller tolerance"
        )
    if job.clip is not None:
        raise InputError("bounds are of whole rays: leave out clip=, or bounds=True")
    if job.adaptive or job.recursive:
        raise InputError("bounds need to know the rays of a pixel: leave out antialias")
    return min(int(max_panels), 1 << 31)


def bracket(
    job: RenderJob, budget: int, intensity: np.ndarray, background: np.ndarray
) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Return lower and upper bounds of the intensity, shape (ny, nx, channel); None without budget.

    The job is repeated in double precision, front to back, and without a cut-off; the tolerance is
    relative to the brightest pixel of the picture.
    """
    if not budget:
        return None, None
    for component in job.medium.components():
        if not _is_bounded(component):
            raise InputError(
                f"nothing is known of the range of {component!r}, so that there are no bounds; "
                "functions have some if they compute with nothing but arithmetic, comparisons and "
                "NumPy's or vm.math's exp, log10, sqrt, where, ... of single numbers (no erf, no "
                "if)"
            )
    backend, brightest = job.backend.with_precision("double"), float(np.max(np.abs(intensity)))
    behind = np.broadcast_to(background, intensity.shape)
    lower, upper = np.empty((2, *intensity.shape))
    for group in channel_groups(job.medium, job.scheme):
        source = Bracketed(job.volume, job.medium, backend, job.tolerance, group)
        scheme = Bracket(budget, source.signed)
        one = replace(job, scheme=scheme, backend=backend, cutoff=0.0, done=0)
        paths = _narrowed(one, source, brightest, float(np.max(np.abs(behind[..., group]))))
        ends = _intensities(one, paths, source, behind[..., group])
        lower[..., group], upper[..., group] = ends
    return lower, upper


def _is_bounded(medium: Medium) -> bool:
    return type(medium).bind is not Medium.bind or type(medium).ranges is not Medium.ranges


def _narrowed(job: RenderJob, source: Any, brightest: float, behind: float) -> Paths:
    tracer = RayTracer(job, source, 0.0)
    tracer.batch = max(1, tracer.batch // _SMALLER_BATCHES // TILE**2) * TILE**2
    allowed = job.tolerance * brightest
    tracer.allow(_SHARES[0] * allowed, _SHARES[0] * job.tolerance)
    paths = exhausted(tracer.batches())
    for share in _SHARES[1:]:
        lower, upper = _ends(paths, source.channels.count)
        gap = np.max(upper.emission - lower.emission, axis=0)
        dim = np.max(upper.transparency - lower.transparency, axis=0)
        wide = np.flatnonzero(~(gap + dim * behind <= allowed))
        if not len(wide):
            break
        tracer.allow(share * allowed, share * job.tolerance)
        paths.put(wide, tracer.pixels(wide))
    return paths


def _intensities(
    job: RenderJob, paths: Paths, source: Bracketed, background: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    neglected, (nx, ny) = source.neglected, job.frame.pixels
    lower, upper = _ends(paths, source.channels.count)
    panels = paths.depth[0] * job.samples**2
    with np.errstate(invalid="ignore", over="ignore"):
        lost = (neglected.depth + _ROUNDING * (panels + 1.0)) * upper.size
        lost = lost + neglected.emission[:, None] + _TINY
        ends = [lower.emission - lost, upper.emission + lost]
    if not source.signed:
        ends[0] = np.maximum(ends[0], 0.0)
    low, high = (end.T.reshape(ny, nx, -1) for end in ends)
    dim, clear = (end.transparency.T.reshape(ny, nx, -1) for end in (lower, upper))
    blur = _ROUNDING * (panels.reshape(ny, nx, 1) + 1.0)
    dim, clear = dim * np.exp(-neglected.depth) * (1.0 - blur), clear * (1.0 + blur)
    low = low + np.where(background < 0.0, clear, dim) * background
    high = high + np.where(background < 0.0, dim, clear) * background
    return _defined(low, -np.inf), _defined(high, np.inf)


@dataclass
class _End:
    """Lower or upper ends: emissions and transparencies (channel, pixel), and magnitudes."""

    emission: np.ndarray
    transparency: np.ndarray
    size: np.ndarray


def _ends(paths: Paths, channels: int) -> tuple[_End, _End]:
    emissions = np.stack(paths.emission)
    emissions = emissions.reshape(-1, 2, channels, emissions.shape[1])
    through = np.stack(paths.transparency)
    dim, clear = through[:channels], through[channels : 2 * channels]
    size = np.abs(emissions).sum(axis=(0, 1))
    low, high = emissions[0] - emissions[1] if len(emissions) > 1 else emissions[0]
    return (
        _End(_defined(low, -np.inf), _defined(dim, 0.0), size),
        _End(_defined(high, np.inf), _defined(clear, 1.0), _defined(size, np.inf)),
    )


def _defined(values: np.ndarray, otherwise: float) -> np.ndarray:
    return np.where(np.isnan(values), otherwise, values)
