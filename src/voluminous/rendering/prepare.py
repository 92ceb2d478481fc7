"""Creates a `RenderJob` from the arguments of render(), which are validated."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ..backend import get_backend
from ..calibration import calibrated
from ..cameras.contract import check_camera
from ..errors import InputError, UnitsError, how_to_take
from ..media.contract import Medium
from ..media.function import with_formulas
from ..media.sum import with_each
from ..progress import Progress, silent
from ..schemes import get_scheme
from ..volume import Volume
from .cache import Cache
from .job import RenderJob
from .missing import Completed, complete
from .options import (
    FINEST_SINGLE,
    check_antialias,
    check_coordinates,
    check_cutoff,
    check_order,
    check_pixels,
    check_tolerance,
    check_walk,
    sample_count,
)
from .precision import needs_double, plain_widths
from .sources.cells import check_fields

if TYPE_CHECKING:
    from ..cameras.contract import Camera


def prepare(
    volume: Volume,
    medium: Medium,
    camera: Camera,
    *,
    scheme: Any = None,
    tolerance: float | None = 1e-3,
    precision: str = "single",
    device: str = "auto",
    order: str = "front-to-back",
    cutoff: float | None = None,
    samples: int = 1,
    antialias: str | None = None,
    progress: Progress = None,
) -> tuple[RenderJob, dict[str, int]]:
    """Return everything that a picture needs, and the number of missing values in each field.

    See `voluminous.render` for the arguments and errors.
    """
    _check_types(volume, medium, camera)
    check_antialias(samples, antialias, camera)
    scheme = _usual_scheme(medium) if scheme is None else scheme
    solver = get_scheme(scheme, controlled=tolerance is not None)
    check_walk(solver, volume.grid)
    volume = volume.seen_by(camera)
    volume.refresh()  # derivatives of fields that were changed in place
    cache = Cache(volume)
    medium = with_formulas(calibrated(medium, volume, cache.measurements))
    if solver.coefficients_at == "field":
        medium = with_each(medium, lambda part: part.on_rays())
    if precision == "single" and (
        volume.grid.needs_double() or _is_fine(solver, tolerance, device)
    ):
        precision = "double"
    check_fields(volume, medium)
    check_coordinates(solver, volume.grid, medium.names)
    _check_units(volume, medium)
    completed = complete(cache, medium.names, solver.coefficients_at == "field")
    if (
        solver.coefficients_at == "field"
        and precision == "single"
        and _double_for_fields(completed, medium)
    ):
        precision = "double"
    job = RenderJob(
        volume=completed.volume,
        cache=completed.cache,
        hidden=completed.hidden,
        medium=medium,
        camera=camera,
        frame=camera.frame(volume.grid),
        scheme=solver,
        backend=get_backend(device, precision),
        backward=check_order(order),
        cutoff=check_cutoff(cutoff),
        tolerance=check_tolerance(tolerance),
        progress=progress if callable(progress) else silent,
    )
    check_pixels(job.frame.pixels, medium.channels, job.backend)
    job.adaptive = antialias == "adaptive"
    job.recursive = antialias == "radmc3d" and not volume.grid.is_rectilinear
    job.samples = sample_count(samples, antialias, job.frame, volume.grid)
    return job, completed.counts


def _is_fine(scheme: Any, tolerance: float | None, device: str) -> bool:
    """Return whether the requested tolerance is below the rounding error of single precision."""
    asked = check_tolerance(tolerance) if scheme.controlled else 1.0
    return asked < FINEST_SINGLE and device != "metal"


def _usual_scheme(medium: Medium) -> str:
    """Return the default scheme of a medium: labels must not be interpolated."""
    return "first-order" if medium.discrete else "post-classified"


def _check_units(volume: Volume, medium: Medium) -> None:
    """Refuse expressions with units; only media defined outside this package can have them."""
    for expr in (feature.expr for feature in medium.known_features()):
        if volume.without_units(expr) is not expr:
            raise UnitsError(
                f"{expr.text!r} combines numbers in different units, which this kind of medium "
                "cannot convert; make it a derived field first: volume['name'] = expression"
            )


def _double_for_fields(completed: Completed, medium: Medium) -> bool:
    """Return True if single precision cannot resolve the fields that the medium uses."""
    cache = completed.cache
    widths = plain_widths(completed.volume, medium.known_features())
    told = tuple((expr.text, least) for expr, least in widths)
    key = ("beyond single", told, cache.statistics.digests(medium.names))
    found: bool = cache.get_or_make(key, lambda: needs_double(completed.volume, medium))
    return found


def _check_types(volume: Any, medium: Medium, camera: Camera) -> None:
    if not isinstance(volume, Volume):
        raise InputError(
            f"render needs a vm.Volume first, got {type(volume).__name__}{how_to_take(volume)}"
        )
    if not isinstance(medium, Medium):
        raise InputError(
            f"render needs a medium (vm.Gaussian, vm.Table, …) second, got {type(medium).__name__}"
            + ("; media are added: first + second" if isinstance(medium, (list, tuple)) else "")
        )
    check_camera(camera, "render")
