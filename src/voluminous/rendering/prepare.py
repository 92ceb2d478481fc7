"""Creates a `RenderJob`, or a `RayJob`, from the arguments of render(), which are validated."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..backend.device import PRECISIONS, get_backend
from ..calibration import calibrated
from ..cameras.contract import check_camera
from ..errors import InputError, UnitsError, check_name, how_to_take
from ..grids.arguments import on_grid
from ..grids.cartesian.grid import CartesianGrid
from ..media.contract import Medium
from ..media.function import with_formulas
from ..media.sum import with_each
from ..progress import silent
from ..regions import Clip
from ..schemes import get_scheme
from ..volume import Volume
from .cache import Cache
from .job import RayJob, RenderJob
from .options import (
    RenderOptions,
    check_antialias,
    check_coordinates,
    check_cutoff,
    check_pixels,
    check_tolerance,
    check_walk,
    sample_count,
)
from .partition import Partition
from .precision import decide
from .sources.cells import check_fields

if TYPE_CHECKING:
    from ..cameras.contract import Camera


def prepare(
    volume: Volume,
    medium: Medium,
    camera: Camera,
    options: RenderOptions,
    partition: Partition | None = None,
    *,
    derivatives: bool = False,
) -> tuple[RenderJob, dict[str, int]]:
    """Return everything that a picture needs, and the number of missing values in each field.

    See `voluminous.render` for the arguments and errors; with `derivatives` what is drawn can be
    differentiated.
    """
    if not isinstance(volume, Volume):
        raise InputError(
            f"render needs a vm.Volume first, got {type(volume).__name__}{how_to_take(volume)}"
        )
    if not isinstance(medium, Medium):
        raise InputError(
            f"render needs a medium (vm.Gaussian, vm.Table, …) second, got {type(medium).__name__}"
            + ("; media are added: first + second" if isinstance(medium, (list, tuple)) else "")
        )
    if not medium.channels:
        raise InputError(
            f"{medium!r} emits at any frequency, so there is nothing to draw yet: give some, as in "
            "vm.observe(volume, medium, camera, wavelengths=[0.87] * u.mm)"
        )
    check_camera(camera, "render")
    check_antialias(options.samples, options.antialias, camera)
    frame = camera.frame(volume.grid)
    samples = sample_count(options.samples, options.antialias, frame, volume.grid)
    (nx, ny), others = frame.pixels, (derivatives, camera, partition)
    rays, missing = prepare_rays(volume, medium, options, float(nx * ny) * samples**2, *others)
    job = RenderJob(
        **vars(rays),
        camera=camera,
        frame=frame,
        progress=options.progress if callable(options.progress) else silent,
        samples=samples,
        adaptive=options.antialias == "adaptive",
        recursive=options.antialias == "radmc3d" and not isinstance(volume.grid, CartesianGrid),
    )
    check_pixels(frame.pixels, job.medium, job.backend)
    job.partition.plan(job.medium, job.scheme, frame.pixels)
    return job, missing


def prepare_rays(
    volume: Volume,
    medium: Medium,
    options: RenderOptions,
    rays: float,
    derivatives: bool = False,
    camera: Camera | None = None,
    partition: Partition | None = None,
) -> tuple[RayJob, dict[str, int]]:
    """Return what rays from anywhere need, see `prepare`; with ``los(...)`` there is a camera."""
    scheme, tolerance, precision = options.scheme, options.tolerance, options.precision
    partition = Partition(volume) if partition is None else partition
    if scheme is None:
        scheme = partition.labels if medium.discrete else "post-classified"
    solver = get_scheme(scheme, controlled=tolerance is not None)
    by_field = solver.coefficients_at == "field"
    check_walk(solver, volume.grid)
    volume = partition.seen_by(camera, medium, solver)
    volume.refresh()  # derivatives of fields that were changed in place
    cache = Cache(volume)
    for part in medium.components():
        if not isinstance(part.path_length, (str, type(None))):  # texts have a unit
            on_grid(part.path_length, volume.grid, "path_length", across=True)
    medium = with_formulas(calibrated(medium, volume, cache.measurements))
    if by_field:
        medium = with_each(medium, lambda part: part.on_rays())
    allowed = check_tolerance(tolerance)
    check_name("precision", precision, PRECISIONS)
    check_fields(volume, medium)
    check_coordinates(solver, volume.grid, medium.names)
    for expr in (feature.expr for feature in medium.known_features()):
        # Of media that are defined outside this package.
        if volume.without_units(expr) is not expr:
            raise UnitsError(
                f"{expr.text!r} combines numbers in different units, which this kind of medium "
                "cannot convert; make it a derived field first: volume['name'] = expression"
            )
    volume, cache, hidden, missing = partition.complete(cache, medium.names, by_field)
    precision = decide(precision, options.device, cache, medium, solver, allowed)
    job = RayJob(
        volume=volume,
        cache=cache,
        hidden=hidden,
        clip=None if options.clip is None else Clip(options.clip, volume.grid),
        medium=medium,
        rays=rays,
        scheme=solver,
        backend=get_backend(options.device, precision, derivatives),
        cutoff=check_cutoff(options.cutoff),
        tolerance=allowed,
        partition=partition,
    )
    return job, missing
