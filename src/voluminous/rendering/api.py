"""render(): from a volume, a medium and a camera to an image."""

from __future__ import annotations

import inspect
import time
from collections.abc import Callable, Generator, Iterable
from typing import Any, TypeAlias

import numpy as np

from ..errors import InputError, check_name
from ..image import Image
from ..media.contract import Medium
from ..media.ranges import RangeContext
from ..objects.values import MANY
from ..packages import room
from ..progress import Progress, silent, with_progress
from ..units import unit_name
from ..volume import Volume
from .empty_picture import warn_of_nothing
from .framing import first_camera, first_medium, framed
from .job import RenderJob
from .layers import with_channels
from .levels import at_level
from .objects import channel_count, check_objects, wide_background, with_objects
from .options import FINEST_SINGLE, background_array, name_slow_choices, refuse_unusable
from .pieces import pieces_of
from .prepare import prepare
from .run import RenderResult, run, run_in_batches
from .sky import image_wcs
from .sources.channel_layout import before
from .sweep import Sweep
from .tracer import exhausted

Steps: TypeAlias = Generator[tuple[np.ndarray, np.ndarray, np.ndarray], None, Image]

# What is drawn, beside which there are options.
_SCENE = ("volume", "medium", "camera")


@with_progress
def render(
    volume: Volume,
    medium: Medium | None = None,
    camera: Any = None,
    *,
    view: str | None = None,
    scheme: Any = None,
    tolerance: float | None = 1e-3,
    background: Any = 0.0,
    precision: str = "single",
    device: str = "auto",
    cutoff: float | None = None,
    samples: int = 1,
    antialias: str | None = None,
    bounds: bool = False,
    max_panels: int = 1024,
    objects: Any = (),
    memory: Any = None,
    executor: Any = None,
    checkpoint: Any = None,
    level: Any = None,
    progress: Progress = None,
) -> Image:
    """Solve the transfer equation along every ray of a camera.

    Parameters
    ----------
    volume : Volume
        Grid and fields.
    medium : Medium, optional
        From field values to emissivity and extinction. By default `suggest_medium` finds one.
    camera : Orthographic or Perspective, optional
        Which rays. By default the whole volume, from obliquely above (a patient from the
        front, a stack of pictures unrotated); without a medium, the visible part of the
        suggested one (`Orthographic.framing`).
    view : {"anterior", "posterior", "left", "right", "superior", "inferior", "stack"}, optional
        In place of a camera: the visible part of the medium, from a side of a patient, or along
        the stacking direction of pictures; see `Orthographic.framing`.
    scheme : {"post-classified", "pre-integrated", "second-order", "first-order", "olson-kunasz"}
        How one segment is solved; see the page on schemes. By default the first; label fields
        (media from `suggest_medium`) default to ``"first-order"``, because labels must not be
        interpolated.
    tolerance : float
        For ``"post-classified"``: the error allowed in a pixel, as a fraction of the brightest;
        of a spectrum (`Coefficients`, functions), of the brightest in each channel.
        `Image.error` holds the error reached. None disables error control, which is the scheme
        ``"pre-integrated"``: 2 to 6 times faster.
    background : float, sequence of float, array (ny, nx[, channel]) or Image
        Intensity behind everything.
    precision : {"single", "double"}
        Floating-point precision. Double precision is used anyway where single cannot resolve the
        grid's cells, or cannot represent the medium's variables (below 1e-30, above 1e30) or the
        sums along rays (optical depths above 1e12, less than 1e-22 of the colours), or where the
        tolerance is below 1e-5.
    device : {"auto", "cpu", "cuda", "metal"}
        Where to compute.
    cutoff : float, optional
        Transparency at which a ray stops; 0 turns it off. By default a ray stops where the rest
        can add less than 1e-4 of the intensity gathered so far, so the error is below 1e-4 of
        the image's maximum.
    samples : int
        n for n × n rays per pixel, at the centres of equal parts.
    antialias : {None, "adaptive", "radmc3d"}
        ``"adaptive"``: more rays where the picture is not smooth, up to 256 a pixel, until its mean
        has converged to the tolerance (to a tenth, if that is None). ``"radmc3d"``: RADMC-3D's
        recursion over parts of pixels, which conserves flux.
    bounds : bool
        Also compute `Image.lower` and `Image.upper`: guaranteed bounds of the intensity, per
        pixel and channel; for media of expressions, and ``"post-classified"``.
    max_panels : int
        Maximum number of panels per segment of a ray that are used to bring the bounds within
        the tolerance of each other.
    objects : sequence of SceneObject
        Stars, spheres, lines, boxes, axes: drawn at their true depth, or in the foreground. See
        `Stars`, `Spheres`, `Curves`, `Boxes`, `Axes`.
    memory : str or int, optional
        The memory that drawing may take, such as ``"2 GiB"``: the volume is read and drawn chunk by
        chunk, front to back, and may be larger than memory. For Cartesian grids, octrees and
        patches, and the schemes ``"post-classified"``, ``"pre-integrated"`` and
        ``"first-order"``; see the page on large data. By default all of it is read.
    executor : concurrent.futures.Executor or Dask client, optional
        Processes that draw blocks of chunks, which they read from files that all of them see;
        `memory` is that of each (2 GiB by default). The picture is the same to the bit for any
        number of them.
    checkpoint : str or Path, optional
        Folder in which finished blocks are kept until the picture is finished: where drawing was
        interrupted, the same call goes on.
    level : int or "auto", optional
        Draw a coarser level of the file (`Volume.level`); ``"auto"``: the coarsest whose cells are
        no wider than a pixel, where the visible ones are nearest; level 0, all cells, if the file
        has no levels. A picture of means is not the mean of pictures; how far it is from that of
        all cells is unknown, and `Image.error` None. ``image.provenance["level"]`` is the level.
    progress : bool or callable, optional
        True shows a bar, False none; by default a bar appears on a terminal and in a notebook if
        the render takes longer than two seconds. A function is called repeatedly as
        ``progress(done, total)``, with numbers of rays (of cells, with `memory`); it may raise to
        cancel.

    Returns
    -------
    Image
        Intensity (ny, nx, channel), transparency and optical depth. An opaque object makes the
        transparency zero; optical depths are always those of the medium alone.

    Warns
    -----
    UserWarning
        If the medium is not visible in the picture; the message gives the ranges of its
        expressions.

    Raises
    ------
    InputError
        For anything that cannot be rendered; a ValueError.
    UnknownNameError
        For a field, scheme, … that does not exist; a KeyError.
    MemoryNeededError
        If it does not fit into memory; raised before any is allocated.
    """
    return exhausted(in_steps(**locals()))


_OPTIONS = [n for n in inspect.signature(render).parameters if n not in _SCENE]


def check_options(options: Iterable[str]) -> None:
    """Refuse options of other functions that `render` does not have."""
    for name in options:
        check_name("option", name, _OPTIONS)


def in_steps(
    volume: Volume,
    medium: Medium | None,
    camera: Any,
    *,
    seconds: float | None = None,
    focus: tuple[float, float] | None = None,
    view: str | None = None,
    background: Any = 0.0,
    samples: int = 1,
    antialias: str | None = None,
    precision: str = "single",
    bounds: bool = False,
    max_panels: int = 1024,
    objects: Any = (),
    memory: Any = None,
    executor: Any = None,
    checkpoint: Any = None,
    level: Any = None,
    **options: Any,
) -> Steps:
    """Render in batches of a given duration; to cancel, stop iterating.

    Parameters
    ----------
    volume, medium, camera, view, background, …
        As in `render`.
    seconds : float, optional
        Duration of a batch; by default there are as few as possible.
    focus : (float, float), optional
        The pixel around which to begin; by default the middle of the picture.

    Yields
    ------
    pixel : array of int, shape (n,)
        Flat indices of the pixels that were traced; some may be traced again later.
    intensity : array, shape (n, channel)
    transparency : array, shape (n, channel or 1)

    Returns
    -------
    Image
        With all that is not in the batches, such as objects and the background.
    """
    if camera is not None and view is not None:
        raise InputError(f"give a camera or view={view!r}, not both")
    fitted = view is not None
    whole, drawn = volume, None
    if level is not None:
        if medium is None and isinstance(volume, Volume):
            medium, fitted = first_medium(volume), True
        if camera is None:
            camera = framed(volume, medium, view=view) if fitted else first_camera(volume)
        volume, medium, drawn = at_level(volume, medium, camera, level)
        if drawn and bounds:
            raise InputError(
                f"bounds=True is for all cells, this picture is drawn from level {drawn}: leave "
                "out bounds=True, or draw level=0"
            )
    pieces = sweep = None
    if executor is not None or checkpoint is not None:
        sweep = Sweep(executor, checkpoint)
    if memory is not None or sweep is not None:
        choices = {"antialias": antialias, "bounds": bounds, "objects": objects}
        pieces = pieces_of(volume, medium, memory, sweep, **choices)
        volume = pieces.outline
    if medium is None and isinstance(volume, Volume):
        medium, fitted = first_medium(volume), True
    if camera is None:
        camera = (
            framed(volume, medium, view=view, memory=memory) if fitted else first_camera(volume)
        )
    things = check_objects(objects, bounds)
    job, missing = prepare(
        volume,
        medium,
        camera,
        precision=precision,
        samples=samples,
        antialias=antialias,
        pieces=pieces,
        **options,
    )
    behind = background_array(background, job.frame.pixels, job.medium.channels)
    guaranteed = room("bounds.guaranteed")
    budget = guaranteed.check_bounds(bounds, max_panels, job)
    start = time.monotonic()
    planes = yield from run_in_batches(job, float(np.max(np.abs(behind))), seconds, focus)
    if sweep is not None:
        sweep.finish()
    if not planes.finite:
        refuse_unusable(job.backend.precision)
    if planes.nothing and not things:
        warn_of_nothing(job)
    rays = samples if antialias is None else antialias
    provenance: dict[str, Any] = {"samples": rays}
    if things:
        channels = channel_count(things, job)
        behind = wide_background(behind, job.medium.channels, channels)
        planes = with_objects(planes, job, things, behind, channels)
        provenance["objects"] = [one.describe(MANY) for one in things]
    if missing:
        provenance["missing"] = missing
    if drawn is not None:
        provenance["level"] = drawn
    intensity = planes.emission
    if np.any(behind):
        intensity = before(behind, intensity, planes.transparency)
    lower, upper = guaranteed.bracket(job, budget, intensity, behind)
    x, y = job.frame.coordinates()
    volume, context = job.volume, RangeContext(job.volume.unit, job.volume.expression_unit)
    image = Image(
        intensity,
        transparency=planes.transparency,
        optical_depth=_full_depth(job, planes) if planes.stopped else planes.depth,
        error=None if drawn else planes.error,
        lower=lower,
        upper=upper,
        x=x,
        y=y,
        intensity_unit=unit_name(job.medium.intensity_unit(context)),
        pixel_size=job.frame.pixel,
        unit=job.camera.plane_unit or unit_name(volume.unit),
        wcs=image_wcs(whole, job.camera, job.frame),
        camera=job.camera.describe(),
        provenance={**job.provenance(), **provenance},
    )
    slow = {"adaptive": job.adaptive, "bounds": budget > 0, "double": precision == "double"}
    slow["tolerance"] = job.scheme.controlled and job.tolerance < FINEST_SINGLE
    name_slow_choices(time.monotonic() - start, **slow)
    return image


def _full_depth(job: RenderJob, planes: RenderResult) -> Callable[[], np.ndarray]:
    channels = planes.emission.shape[2]

    def compute() -> np.ndarray:
        job.cutoff, job.progress = 0.0, silent
        if job.pieces is not None:
            job.pieces.report = silent
        return with_channels(run(job, 0.0).depth, channels, 0.0)

    return compute
