"""Keep a picture to its tolerance: find out how bright it is, then mend the pixels that are off."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from .drawing import Drawing
    from .paths import Paths

# What one segment may be off by, as a fraction of what a pixel may; lower in every round.
_SHARES = (0.1, 0.02, 0.004)
# Rounding of a path of many segments, as a fraction of its brightness.
_ROUNDING = {"single": 3e-6, "double": 1e-14}


def controlled(drawing: Drawing, tolerance: float, background: float) -> tuple[Paths, bool]:
    """Return the paths of all pixels, none off by more than the tolerance, if that can be had.

    The second value is False if the medium's faint places, which are left out, may show more.

    First every segment is solved in two panels, whatever its error. That tells how bright the
    picture is, and in most pixels it is good enough; the others are drawn again with narrower
    panels.

    Parameters
    ----------
    tolerance : float
        Fraction of the brightest pixel.
    background : float
        Brightest intensity behind the volume.
    """
    source = drawing.source
    behind = background / source.numbers.unit
    source.allow(np.inf, np.inf)
    paths = drawing.frame()
    for share in _SHARES:
        scale = float(np.max(paths.error[2], initial=0.0)) + behind
        wrong = _too_wrong(paths, tolerance, scale, behind)
        if not len(wrong):
            break
        source.allow(share * tolerance * scale, share * tolerance)
        paths.put(wrong, drawing.pixels(wrong))
    source.allow(_SHARES[0] * tolerance * scale, _SHARES[0] * tolerance)  # for rays still to come
    _add_floor(drawing, paths)
    return paths, source.neglected <= tolerance * scale


def _too_wrong(paths: Paths, tolerance: float, scale: float, behind: float) -> np.ndarray:
    """Return which pixels are off by more than the tolerance."""
    wrong, dim, _ = paths.error
    return np.flatnonzero((wrong + dim * behind > tolerance * scale) | (dim > tolerance))


def _add_floor(drawing: Drawing, paths: Paths) -> None:
    """Add to the errors what rounding, faint places and rays that stop early may have lost."""
    wrong, dim, brightness = paths.error
    wrong += lost_share(drawing) * brightness + drawing.source.neglected
    # Of what is behind, rays that stop early say so by their transparency.
    dim += _ROUNDING[drawing.backend.precision] + drawing.source.neglected_depth


def lost_share(drawing: Drawing) -> float:
    """Return what rounding and rays that stop early may have lost, as a fraction of brightness."""
    lost = drawing.job.early_error if drawing.ending is not None else 0.0
    return lost + _ROUNDING[drawing.backend.precision]


def total_error(paths: Paths, background: float) -> Any:
    """Return how far intensities in front of a background may be off."""
    return paths.error[0] + paths.error[1] * background
