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
from .columns import as_map, lines_of_sight
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
    scheme: str | Scheme = "first-order",
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
        Computes the optical depths of segments; see `render`.
    precision, device, progress
        As for `render`.

    Returns
    -------
    TauSurface
        The map `depth`, and `points` in space.

    Raises
    ------
    InputError
        If `tau` is not positive, coefficients are not finite, or extinctions negative.
    """
    if not isinstance(tau, Real) or not 0 < tau < np.inf:
        raise InputError(f"tau must be a positive number, got {tau!r}")
    surface = _Surface(get_scheme(scheme, controlled=False), float(tau))
    options: dict[str, Any] = {"precision": precision, "device": device, "progress": progress}
    results, _ = scan(volume, medium, camera, surface, **options)
    places, depths = np.split(results, 2)
    if np.isnan(depths).any():  # else it would seem that the surface is not reached
        refuse_unusable(precision)
    provenance = {"tau": float(tau), "scheme": surface.scheme.name, "map": "depth"}
    distances = volume.grid.scale * np.moveaxis(places, 0, -1)
    depth = as_map(distances, volume.unit, volume, camera, provenance)
    origin, direction = (a[:, :, None] for a in lines_of_sight(camera, volume.grid))
    points = origin + depth.intensity[..., None] * direction
    return TauSurface(depth, np.asarray(points), float(tau))


class _Surface(Scanner):
    """Carry where an optical depth is reached, the depths so far, and a scheme's own numbers."""

    def __init__(self, scheme: Scheme, tau: float) -> None:
        self.scheme, self.tau = scheme, tau
        self.name = f"{scheme.name} surface"
        self.coefficients_at = scheme.coefficients_at

    def count(self, extinctions: int) -> int:
        return 2 * extinctions

    def start(self, position: Position, source: Source) -> list[Float]:
        self.own, Float = self.count(source.numbers.extinctions), source.backend.Float
        self.limit = source.backend.opaque(self.tau)
        places = [Float(np.nan) for _ in range(self.own // 2)]
        depths = [Float(0) for _ in places]
        return [*places, *depths, *self.scheme.start(position, source)]

    def after_skip(
        self, position: Position, source: Source, carried: list[Float], moved: Mask
    ) -> list[Float]:
        inner = self.scheme.after_skip(position, source, carried[self.own :], moved)
        return [*carried[: self.own], *inner]

    def after_hidden(self, carried: list[Float], onward: list[Float]) -> list[Float]:
        inner = self.scheme.after_hidden(carried[self.own :], onward[self.own :])
        return [*carried[: self.own], *inner]

    def solve(
        self, segment: Segment, source: Source, carried: list[Float]
    ) -> tuple[Path, list[Float]]:
        count = self.own // 2
        places, depths, inner = carried[:count], carried[count : self.own], carried[self.own :]
        solution, inner = self.scheme.solve(segment, source, inner)
        after = [d + more for d, more in zip(depths, solution.depth, strict=True)]

        def reached(place: Float, before: Float, after: Float, more: Float) -> Float:
            hit = dr.isnan(place) & (after >= self.limit) & segment.active
            part = (self.limit - before) / dr.select(hit, more, 1.0)
            here = dr.fma(dr.select(part < 1.0, part, 1.0), segment.length, segment.begin)
            return dr.select(hit, distance(segment.track, here), place)

        return NOTHING, [*map(reached, places, depths, after, solution.depth), *after, *inner]
