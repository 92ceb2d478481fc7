"""probe(): what one ray saw."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ...progress import Progress, with_progress
from ...rendering import prepare
from ...rendering.options import background_array
from .follow import PixelPlace, assembled, follow, wanted
from .result import Probe

if TYPE_CHECKING:
    from ...cameras import Camera
    from ...media import Medium
    from ...volume import Volume


@with_progress
def probe(
    volume: Volume,
    medium: Medium,
    camera: Camera,
    pixel: Any = None,
    *,
    at: Any = None,
    also: Any = (),
    scheme: Any = None,
    tolerance: float | None = 1e-3,
    background: Any = 0.0,
    precision: str = "single",
    device: str = "auto",
    order: str = "front-to-back",
    cutoff: float | None = None,
    progress: Progress = None,
) -> Probe:
    """Return what one ray saw: every segment that `render` solves, as it solves it.

    It is one ray, through the medium alone. Pictures with `samples` have the mean of several rays
    in a pixel, and those with `objects` have stars and lines between the segments: neither is told
    here.

    Parameters
    ----------
    volume, medium, camera
        As for `render`.
    pixel : (int, int)
        ix and iy, counted from 0 at the lower left: the ray through the centre of
        ``image.intensity[iy, ix]``.
    at : (float, float) or Quantity, optional
        A point of the image plane instead, in the unit of its coordinates.
    also : str, Expression or sequence of them
        More fields or expressions to tell, as they are in the cells.
    scheme, tolerance, background, precision, device, order, cutoff
        As for `render`. With a tolerance the whole picture is drawn once, since its brightest pixel
        says what is good enough in this one. With ``tolerance=None`` steps are as wide as those of
        the picture: up to eight cells, and none in empty space. ``cutoff=0`` follows the ray to its
        end.
    progress : bool or callable, optional
        As for `render`.

    Returns
    -------
    Probe
        Arrays per segment; `Probe.table`, `Probe.plot`, and ``print(probe)``.

    Raises
    ------
    InputError, UnknownNameError, UnitsError
        For a pixel, point, field … that does not exist, and what cannot be rendered.
    """
    job, _ = prepare(
        volume,
        medium,
        camera,
        scheme=scheme,
        tolerance=tolerance,
        precision=precision,
        device=device,
        order=order,
        cutoff=cutoff,
        progress=progress,
    )
    place = PixelPlace.of(pixel, at, job.frame, camera.plane_unit or volume.unit)
    ix, iy = place.pixel
    flat = iy * job.frame.pixels[0] + ix
    seen = volume.seen_by(camera)
    more = wanted(seen, also)
    behind = background_array(background, job.frame.pixels, job.medium.channels)
    names = job.medium.names if job.scheme.coefficients_at == "field" else ()
    found = follow(job, (flat, *place.offset), names, float(np.max(np.abs(behind))))
    full = np.broadcast_to(behind, (*job.frame.pixels[::-1], job.medium.channels))
    return assembled(job, seen, place, found, more, full[iy, ix])
