"""What rays find on their way, in place of what they gather: a place, the largest value."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..rendering import prepare
from ..rendering.rays.drawing import Drawing
from ..rendering.rays.march import State
from ..schemes.path import Path


class Scanner:
    """A scheme that gathers nothing: what it carries is what it has found.

    Attributes
    ----------
    recorded : int
        How many of the numbers that it carries are to be known in the end: those that come first.
    """

    order = 1
    linear = True
    controlled = False
    reckoned = False
    coarseness = 0.0
    complete = True
    recorded = 1

    def count(self, numbers: Any) -> int:
        """Return `recorded`, where it depends on what is integrated."""
        return self.recorded

    def leapt(
        self, source: Any, walk: Any, track: Any, cursor: Any, carried: list[Any], moved: Any
    ) -> list[Any]:
        """Go on as before: nothing is found in empty space."""
        return carried

    def passed(self, carried: list[Any], onward: list[Any]) -> list[Any]:
        """Go on as before: nothing is found in cells without values."""
        return carried


NOTHING = Path([], [], [])


class Scan(Drawing):
    """Rays that tell what their scheme, a `Scanner`, carries in the end."""

    @property
    def counts(self) -> tuple[int, int, int]:
        return self.job.scheme.count(self.source.numbers), 0, 0

    def nothing(self) -> Path:
        return NOTHING

    def _followed(self, ray: Any) -> State:
        state = super()._followed(ray)
        return replace(state, path=Path(state.carried[: self.counts[0]], [], []))


@dataclass
class Scanned:
    """What the rays through the pixels' centres have found.

    Attributes
    ----------
    values : float64 array, shape (recorded, ny, nx)
    unit, length : float
        What tabulated coefficients are multiplied by, to be those of the medium, and distances, to
        be in the volume's unit: single precision may not hold them.
    """

    values: np.ndarray
    unit: float
    length: float


def scan(volume: Any, medium: Any, camera: Any, scheme: Any, **options: Any) -> Scanned:
    """Follow the rays through the pixels' centres.

    Parameters
    ----------
    scheme : Scanner
    **options
        ``precision``, ``device``, ``progress``: as for `voluminous.render`.
    """
    job, _ = prepare(volume, medium, camera, scheme=scheme, cutoff=0.0, **options)
    nx, ny = job.frame.pixels
    paths, numbers = job.drawn(Scan)
    values = np.stack(paths.emission).astype(np.float64).reshape(-1, ny, nx)
    return Scanned(values, numbers.unit / volume.grid.scale, volume.grid.scale)


def distance(track: Any, t: Any) -> Any:
    """Return how far a point of a ray is from its origin, in units of the scale (traced)."""
    return type(t)(track.entry + t)
