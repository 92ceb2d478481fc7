"""render(): from a volume, a medium and a camera to an image."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ..backend import get_backend
from ..calibration import calibrate
from ..errors import InputError
from ..image import Image
from ..media.bounds import RangeContext
from ..media.contract import Medium
from ..schemes import get_scheme
from ..units import unit_name
from ..volume import Volume
from .bounds import bracket, check_bounds
from .job import Job, Planes
from .missing import complete
from .options import (
    background_array,
    check_cutoff,
    check_order,
    check_tolerance,
    check_walk,
    is_recursive,
    sample_count,
)
from .sky import image_wcs


def render(
    volume: Volume,
    medium: Medium,
    camera: Any,
    *,
    scheme: Any = "post-classified",
    tolerance: float | None = 1e-3,
    background: Any = 0.0,
    precision: str = "single",
    device: str = "auto",
    order: str = "front-to-back",
    cutoff: float | None = None,
    samples: Any = 1,
    bounds: bool | int = False,
    progress: Callable[[int, int], None] | None = None,
) -> Image:
    """Solve the transfer equation along every ray of a camera.

    Parameters
    ----------
    volume : Volume
        Grid and fields.
    medium : Medium
        From field values to emissivity and extinction.
    camera : Orthographic or Perspective
        Which rays.
    scheme : {"post-classified", "second-order", "first-order", "olson-kunasz"}
        How one segment is solved; see the page on schemes.
    tolerance : float
        For ``"post-classified"``: the error allowed in a pixel, as a fraction of the brightest.
        `Image.error` tells what was reached. None: do not look, which takes half the time.
    background : float, sequence of float, array (ny, nx[, channel]) or Image
        Intensity behind everything.
    precision : {"single", "double"}
        Floating-point precision. Where single cannot tell the grid's cells apart, double is taken.
    device : {"auto", "cpu", "cuda", "metal"}
        Where to compute.
    order : {"front-to-back", "back-to-front"}
        The direction in which rays are folded; the result is the same to rounding.
    cutoff : float, optional
        Transparency at which a ray stops; 0 turns it off. By default a ray stops where all that
        may still come is below 1e-4 of what it has gathered, so the error is below 1e-4 of the
        image's maximum.
    samples : int, "adaptive" or "flux-conserving"
        n for n × n rays per pixel, at the centres of equal parts; or more rays where the picture is
        not smooth, up to 256 a pixel, until its mean has settled to the tolerance; or RADMC-3D's
        recursion.
    bounds : bool or int
        Also give `Image.lower` and `Image.upper`: what the intensity is at least and at most, with
        certainty, per pixel and channel; for media of expressions, and ``"post-classified"``. They
        are brought within the tolerance of each other unless that takes more than 1024 panels, or
        so many as given, on a segment of a ray.
    progress : callable, optional
        Called as ``progress(done, total)`` now and then; may raise to cancel.

    Returns
    -------
    Image
        Intensity (ny, nx, channel), transparency and optical depth.

    Raises
    ------
    InputError
        For anything that cannot be rendered; a ValueError.
    UnknownNameError
        For a field, scheme, order, … that does not exist; a KeyError.
    MemoryNeededError
        If it does not fit into memory, before any is taken.
    """
    _check_types(volume, medium, camera)
    solver = get_scheme(scheme, controlled=tolerance is not None)
    check_walk(solver, volume.grid)
    volume = volume.seen_by(camera)
    medium = calibrate(medium, volume)
    if precision == "single" and volume.grid.needs_double():
        precision = "double"
    volume.refresh()  # derivatives of fields that were changed in place
    completed = complete(volume, medium.names, solver.place == "field")
    job = Job(
        volume=completed.volume,
        store=completed.store,
        hidden=completed.hidden,
        medium=medium,
        camera=camera,
        frame=camera.frame(volume.grid),
        scheme=solver,
        backend=get_backend(device, precision),
        backward=check_order(order),
        cutoff=check_cutoff(cutoff),
        tolerance=check_tolerance(tolerance),
        progress=progress or silent,
    )
    job.adaptive = isinstance(samples, str) and samples == "adaptive"
    job.recursive = is_recursive(samples, volume.grid)
    job.samples = 1 if job.adaptive else sample_count(samples, job.frame, volume.grid)
    behind = background_array(background, job.frame.pixels, medium.channels)
    budget = check_bounds(bounds, job)
    planes = job.run(float(np.max(np.abs(behind))))
    told = {"samples": samples, "order": order}
    if completed.counts:
        told["missing"] = completed.counts
    return _image(job, planes, behind, budget, told)


def _image(
    job: Job, planes: Planes, behind: np.ndarray, budget: int, told: dict[str, Any]
) -> Image:
    if not np.all(np.isfinite(planes.emission)) or not np.all(np.isfinite(planes.depth)):
        raise InputError(
            "the picture is not finite: the medium gives coefficients that are not, or a negative "
            "extinction, in cells that rays visit; look at the fields with `volume.evaluate(...)`"
        )
    intensity = planes.emission
    if np.any(behind):
        intensity = (intensity + planes.transparency * behind).astype(intensity.dtype)
    lower, upper = bracket(job, budget, intensity, behind)
    x, y = job.frame.coordinates()
    return Image(
        intensity,
        transparency=planes.transparency,
        optical_depth=_full_depth(job) if planes.stopped else planes.depth,
        error=planes.error,
        lower=lower,
        upper=upper,
        x=x,
        y=y,
        intensity_unit=_intensity_unit(job),
        pixel_size=job.frame.pixel,
        unit=job.camera.plane_unit or unit_name(job.volume.unit),
        wcs=image_wcs(job.volume, job.camera, job.frame),
        camera=job.camera.describe(),
        provenance=_provenance(job, told),
    )


def _intensity_unit(job: Job) -> str:
    volume = job.volume
    context = RangeContext(volume.unit, volume.expression_unit)
    return unit_name(job.medium.intensity_unit(context))


def _full_depth(job: Job) -> Callable[[], np.ndarray]:
    """Return what computes the optical depth through everything, for rays that stopped early."""

    def compute() -> np.ndarray:
        job.cutoff, job.progress = 0.0, silent
        return job.run(0.0).depth

    return compute


def _provenance(job: Job, told: dict[str, Any]) -> dict[str, Any]:
    from .. import __version__

    return {
        "software": f"voluminous {__version__}",
        "scheme": job.scheme.name,
        "precision": job.backend.precision,
        "device": job.backend.device,
        "medium": job.medium.describe(),
        "volume": job.volume.describe(),
        **told,
    }


def _check_types(volume: Any, medium: Any, camera: Any) -> None:
    if not isinstance(volume, Volume):
        raise InputError(f"render needs a vm.Volume first, got {type(volume).__name__}")
    if not isinstance(medium, Medium):
        raise InputError(
            f"render needs a medium (vm.Gaussian, vm.Table, …) second, got {type(medium).__name__}"
        )
    if not hasattr(camera, "frame") or not hasattr(camera, "rays"):
        raise InputError(
            f"render needs a camera (vm.Orthographic, vm.Perspective), got {type(camera).__name__}"
        )


def silent(done: int, total: int) -> None:
    """Report nothing."""
