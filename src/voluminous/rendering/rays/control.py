"""Keep a picture to its tolerance: find out how bright it is, then mend the pixels that are off."""

from __future__ import annotations

import functools
import math
from typing import TYPE_CHECKING, Any

import numpy as np

from ..coefficients.emission_unit import fits_single
from .found import MARGIN

if TYPE_CHECKING:
    from .drawing import Drawing
    from .paths import Paths

# What one segment may be off by, as a fraction of what a pixel may; lower in every round.
_SHARES = (0.05, 0.01, 0.002)
# So many pixels tell how bright a picture is, if it has at least a few times as many. Of shells in
# real data half of the pixels were drawn twice without that: 1.1 s in place of 1.7, 1.5 of 2.4.
_SAMPLES, _WORTHWHILE = 2500, 4
# Where the brightest of them is so many times as bright as nearly all others, it may be beside a
# peak that is brighter still.
_PEAK = 3.0
# Rounding of a path of many segments, as a fraction of its brightness.
_ROUNDING = {"single": 3e-6, "double": 1e-14}
# What is that much fainter than the brightest pixel may be lost to underflow: e.g. far outside of a
# Gaussian, where pixels are black that are not in truth.
_UNDERFLOW = 1e-12


def controlled(drawing: Drawing, tolerance: float, background: float) -> tuple[Paths, bool]:
    """Return the paths of all pixels, none off by more than the tolerance, if that can be had.

    The second value is False if the medium's faint places, which are left out, may show more. The
    errors are those of segments; `add_floor` adds the others.

    Some pixels tell how bright the picture is, and so what segments may be off by: narrower panels
    where two per segment are not good enough. Pixels in which that still adds up to too much are
    drawn again with smaller shares.

    Parameters
    ----------
    tolerance : float
        Fraction of the brightest pixel.
    background : float
        Brightest intensity behind the volume.
    """
    source = drawing.source
    behind = in_kernel_unit(background, source.numbers.unit)
    first, *shares = _SHARES
    source.allow(np.inf, np.inf, 1.0)  # until it is known how bright the picture is
    scale = _sampled_brightness(drawing, behind)
    if scale > 0.0:
        source.allow(tolerance * scale, tolerance, first)
    else:
        shares = list(_SHARES)
    paths = drawing.frame()
    for share in shares:
        scale = _brightness(drawing, paths, behind).max()
        wrong = _too_wrong(drawing, paths, tolerance, scale, behind)
        if not len(wrong):
            break
        source.allow(tolerance * scale, tolerance, share)
        paths.put(wrong, drawing.pixels(wrong))
    source.allow(tolerance * scale, tolerance, first)  # for rays still to come
    return paths, source.neglected <= tolerance * scale


def in_kernel_unit(background: float, unit: float) -> Any:
    """Return a background in a unit: in double precision where its products may need it."""
    found = background / unit
    return found if fits_single(found) else np.float64(found)


def _brightness(drawing: Drawing, paths: Paths, behind: Any) -> Any:
    """Return how bright pixels are in their brightest channels, in the kernel's unit."""
    seen = drawing.source.numbers.brightest_channel(paths.emission)
    through = functools.reduce(np.maximum, paths.transparency)
    # What emits nothing, or as much as it takes away, is compared with what it is made of.
    bright = seen + through * behind
    return bright if np.any(bright) else paths.error[2]


def _sampled_brightness(drawing: Drawing, behind: Any) -> float:
    """Return how bright the brightest of some pixels is, without looking at errors; 0 of few."""
    nx, ny = drawing.job.frame.pixels
    if nx * ny < _WORTHWHILE * _SAMPLES:
        return 0.0
    step = nx * ny // _SAMPLES | 1  # odd: not in few columns
    pixel = np.arange(step // 2, nx * ny, step)
    found = _brightness(drawing, drawing.pixels(pixel), behind)
    brightest = float(np.max(found))
    if brightest <= _PEAK * float(np.quantile(found, 0.99)):
        return brightest
    around = drawing.pixels(_around(pixel[np.argmax(found)], step, nx, ny))
    return max(brightest, float(_brightness(drawing, around, behind).max()))


def _around(pixel: int, step: int, nx: int, ny: int) -> np.ndarray:
    reach = math.isqrt(step) + 1
    x, y = (
        np.arange(max(place - reach, 0), min(place + reach + 1, count))
        for place, count in ((pixel % nx, nx), (pixel // nx, ny))
    )
    return np.asarray((y[:, None] * nx + x).reshape(-1))


def _too_wrong(
    drawing: Drawing, paths: Paths, tolerance: float, scale: Any, behind: Any
) -> np.ndarray:
    """Return which pixels are off by more than the tolerance, with what `add_floor` will add.

    Up to half of the tolerance: where rounding alone exceeds it nothing is gained by more panels.
    """
    wrong, dim, _ = paths.error
    floor, dim_floor = _floor(drawing, paths)
    total = wrong + dim * behind + np.minimum(floor + dim_floor * behind, 0.5 * tolerance * scale)
    return np.flatnonzero((total > tolerance * scale) | (dim > tolerance))


def add_floor(drawing: Drawing, paths: Paths) -> None:
    """Add to the errors what rounding, underflow, faint places and early ends may have lost."""
    wrong, dim, _ = paths.error
    floor, dim_floor = _floor(drawing, paths)
    wrong += floor
    dim += dim_floor


def _floor(drawing: Drawing, paths: Paths) -> tuple[np.ndarray, float]:
    """Return what emission and transparency may be off by besides the errors of segments."""
    brightness = paths.error[2]
    lost = _UNDERFLOW * float(np.max(brightness, initial=0.0)) + _flushed(drawing)
    floor = lost_share(drawing) * brightness + (drawing.source.neglected + lost)
    # Of what is behind, rays that stop early say so by their transparency.
    return floor, _ROUNDING[drawing.backend.precision] + drawing.source.neglected_depth


def _flushed(drawing: Drawing) -> float:
    """Return what may be lost because sums that are smaller count as zero: colours are near one."""
    sums = drawing.source.numbers.emissions + 1
    return 2.0 * sums * MARGIN * float(np.finfo(drawing.backend.dtype).tiny)


def lost_share(drawing: Drawing) -> float:
    """Return what rounding, cubics and early ends may have lost, as a fraction of brightness."""
    lost = _ROUNDING[drawing.backend.precision]
    if drawing.ending is not None:
        lost += drawing.job.early_error
    if drawing.job.scheme.controlled:
        lost += drawing.source.lost
    return lost


def total_error(paths: Paths, background: float) -> Any:
    """Return how far intensities in front of a background may be off."""
    return paths.error[0] + paths.error[1] * background
