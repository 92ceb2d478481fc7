"""Surfaces of optical depth: how deep one sees."""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Real
from typing import TYPE_CHECKING, Any

import numpy as np

from ..backend import dr
from ..errors import InputError
from ..progress import Progress, with_progress
from ..rendering.options import refuse_unusable
from ..schemes import get_scheme
from .columns import depth_map, lines_of_sight
from .projections import NOTHING, Scanner, distance, scan

if TYPE_CHECKING:
    from ..backend.types import Float, Mask
    from ..cameras import Camera
    from ..grids.contract import Segment
    from ..image import Image
    from ..media import Medium
    from ..schemes.base import Position, Scheme, Source
    from ..schemes.path import Path
    from ..volume import Volume


@dataclass(frozen=True)
class TauSurface:
    """Where the optical depth from the observer reaches a value.

    Attributes
    ----------
    depth : Image
        One channel per extinction: the distance from the observer, or, for an orthographic camera,
        from the plane through its centre, away from the observer. NaN where it is not reached.
    points : float64 array (ny, nx, channel, 3)
        Its places, in the volume's coordinates.
    tau : float
    """

    depth: Image
    points: np.ndarray
    tau: float


@with_progress
def tau_surface(
    volume: Volume,
    medium: Medium,
    camera: Camera,
    tau: float = 1.0,
    *,
    scheme: Any = "first-order",
    precision: str = "double",
    device: str = "auto",
    progress: Progress = None,
) -> TauSurface:
    """Return where the optical depth, counted from the observer, reaches `tau`.

    Between the ends of a segment it is linear, as in RADMC-3D's ``tausurf``; in first order, where
    the extinction is constant in a cell, that is exact.

    Parameters
    ----------
    volume, medium, camera
        As for `render`.
    tau : float
        Positive.
    scheme : str
        What makes the optical depths of segments; see `render`.
    precision, device, progress
        As for `render`.

    Returns
    -------
    TauSurface
        The map `depth`, and `points` in space.

    Raises
    ------
    InputError
        If `tau` is not positive, or something cannot be rendered: where coefficients are not finite
        or extinctions negative.
    """
    if not isinstance(tau, Real) or not 0 < tau < np.inf:
        raise InputError(f"tau must be a positive number, got {tau!r}")
    inner = get_scheme(scheme, controlled=False)
    options = {"precision": precision, "device": device, "progress": progress}
    found = scan(volume, medium, camera, Surface(inner, float(tau)), **options)
    told = {"tau": float(tau), "scheme": inner.name}
    places, depths = np.split(found.values, 2)
    if np.isnan(depths).any():  # else it would seem that the surface is not reached
        refuse_unusable(precision)
    distances = found.length * np.moveaxis(places, 0, -1)
    image = depth_map(distances, volume, camera, told)
    return TauSurface(image, _points(volume, camera, image.intensity), float(tau))


def _points(volume: Volume, camera: Camera, depth: np.ndarray) -> np.ndarray:
    """Return the points at distances (ny, nx, channel) from the origins of rays."""
    origin, direction = lines_of_sight(camera, volume.grid)
    return np.asarray(origin[:, :, None] + depth[..., None] * direction[:, :, None])


class Surface(Scanner):
    """Carry where an optical depth is reached, the depths so far, and what a scheme carries."""

    def __init__(self, scheme: Scheme, tau: float) -> None:
        self.scheme, self.tau = scheme, tau
        self.name = f"{scheme.name} surface"
        self.coefficients_at = scheme.coefficients_at

    def count(self, numbers: Any) -> int:
        return 2 * int(numbers.extinctions)

    def start(self, position: Position, source: Source) -> list[Any]:
        """Carry nothing yet."""
        self.recorded, Float = self.count(source.numbers), source.backend.Float
        self.limit = source.backend.opaque(self.tau)
        places = [Float(np.nan) for _ in range(self.recorded // 2)]
        depths = [Float(0) for _ in places]
        return [*places, *depths, *self.scheme.start(position, source)]

    def after_skip(
        self, position: Position, source: Source, carried: list[Float], moved: Mask
    ) -> list[Any]:
        own = self.recorded
        inner = self.scheme.after_skip(position, source, carried[own:], moved)
        return [*carried[:own], *inner]

    def after_hidden(self, carried: list[Float], onward: list[Float]) -> list[Any]:
        own = self.recorded
        return [*carried[:own], *self.scheme.after_hidden(carried[own:], onward[own:])]

    def solve(
        self, segment: Segment, source: Source, carried: list[Float]
    ) -> tuple[Path, list[Float]]:
        """Solve one segment, and see if the depth is reached in it."""
        count = self.recorded // 2
        places, depths, inner = carried[:count], carried[count : 2 * count], carried[2 * count :]
        found, inner = self.scheme.solve(segment, source, inner)
        after = [d + more for d, more in zip(depths, found.depth, strict=True)]
        parts = zip(places, depths, after, found.depth, strict=True)
        reached = [self._reached(segment, *part) for part in parts]
        return NOTHING, [*reached, *after, *inner]

    def _reached(self, segment: Segment, place: Any, before: Any, after: Any, more: Any) -> Any:
        hit = dr.isnan(place) & (after >= self.limit) & segment.active
        part = (self.limit - before) / dr.select(hit, more, 1.0)
        here = dr.fma(dr.select(part < 1.0, part, 1.0), segment.length, segment.begin)
        return dr.select(hit, distance(segment.track, here), place)
