"""render(): from a volume, a medium and a camera to an image."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Hashable
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from ..bounds import guaranteed
from ..calibration import presets, suggest_medium
from ..errors import InputError
from ..image import Image
from ..image.metadata import oriented
from ..large.levels import at_level
from ..large.partition import drawn_in_blocks
from ..media.contract import Medium
from ..media.details import intensity_unit
from ..objects import SceneObject
from ..objects.values import MANY
from ..progress import Progress, silent, with_progress
from ..regions import Region
from ..rendering.cache import Cache
from ..rendering.empty_picture import warn_of_nothing
from ..rendering.framing import first_camera, framed
from ..rendering.job import RenderJob
from ..rendering.layers import with_channels
from ..rendering.objects import channel_count, check_objects, wide_background, with_objects
from ..rendering.options import (
    FINEST_SINGLE,
    RenderOptions,
    background_array,
    name_slow_choices,
    refuse_unusable,
)
from ..rendering.partition import Partition
from ..rendering.prepare import prepare
from ..rendering.run import RenderResult, run, run_in_batches
from ..rendering.tracer import exhausted
from ..schemes.channels import before
from ..units import unit_name
from ..volume import Volume
from .sky import image_wcs

Steps: TypeAlias = Generator[tuple[np.ndarray, np.ndarray, np.ndarray], None, Image]


@with_progress
def render(
    volume: Volume,
    medium: Medium | None = None,
    camera: Any = None,
    *,
    view: str | None = None,
    objects: Any = (),
    background: Any = 0.0,
    clip: Region | str | None = None,
    scheme: Any = None,
    tolerance: float | None = 1e-3,
    precision: str = "single",
    cutoff: float | None = None,
    bounds: bool = False,
    max_panels: int = 1024,
    samples: int = 1,
    antialias: str | None = None,
    memory: Any = None,
    executor: Any = None,
    checkpoint: Any = None,
    level: Any = None,
    device: str = "auto",
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
    objects : sequence of SceneObject
        Stars, spheres, lines, boxes, axes: drawn at their true depth, or in the foreground. See
        `Stars`, `Spheres`, `Curves`, `Boxes`, `Axes`.
    background : float, sequence of float, array (ny, nx[, channel]) or Image
        Intensity behind everything.
    clip : Region or str, optional
        The part of space that is drawn, of `voluminous.regions` or as a text, such as
        ``"halfspace((0, 0, 0), (1, 0, 0)) & ~sphere((0, 0, 0), 1 pc)"``. Rays begin and end at its
        surface, wherever that cuts a cell: the cut shows the inside. Objects are drawn wherever
        they are. The camera does not depend on it.

    Accuracy
    --------
    scheme : {"post-classified", "pre-integrated", "second-order", "first-order", "olson-kunasz"}
        How one segment is solved; see the page on schemes. By default the first; labels
        default to ``"second-order"``, or chunk by chunk to ``"first-order"``, because their
        numbers must not be interpolated.
    tolerance : float
        For ``"post-classified"``: the error allowed in a pixel, as a fraction of the brightest;
        of a spectrum (`Coefficients`, functions), of the brightest in each channel.
        `Image.error` holds the error reached. None disables error control, which is the scheme
        ``"pre-integrated"``: 2 to 6 times faster.
    precision : {"single", "double"}
        Floating-point precision. Double precision is used anyway where single cannot resolve the
        grid's cells, or cannot represent the medium's variables (below 1e-30, above 1e30) or the
        sums along rays (optical depths above 1e12, less than 1e-22 of the colours), or where the
        tolerance is below 1e-5.
    cutoff : float, optional
        Transparency at which a ray stops; 0 turns it off. By default a ray stops where the rest
        can add less than 1e-4 of the intensity gathered so far, so the error is below 1e-4 of
        the image's maximum.
    bounds : bool
        Also compute `Image.lower` and `Image.upper`: guaranteed bounds of the intensity, per
        pixel and channel; for media of expressions, and ``"post-classified"``.
    max_panels : int
        Maximum number of panels per segment of a ray that are used to bring the bounds within
        the tolerance of each other.

    Sampling
    --------
    samples : int
        n for n × n rays per pixel, at the centres of equal parts.
    antialias : {None, "adaptive", "radmc3d"}
        ``"adaptive"``: more rays where the picture is not smooth, up to 256 a pixel, until its mean
        has converged to the tolerance (to a tenth, if that is None). ``"radmc3d"``: RADMC-3D's
        recursion over parts of pixels, which conserves flux.

    Large data
    ----------
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

    Extras
    ------
    device : {"auto", "cpu", "cuda", "metal"}
        Where to compute.
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
    options = RenderOptions(
        view=view,
        objects=objects,
        background=background,
        clip=clip,
        scheme=scheme,
        tolerance=tolerance,
        precision=precision,
        cutoff=cutoff,
        bounds=bounds,
        max_panels=max_panels,
        samples=samples,
        antialias=antialias,
        memory=memory,
        executor=executor,
        checkpoint=checkpoint,
        level=level,
        device=device,
        progress=progress,
    )
    return exhausted(in_steps(volume, medium, camera, options))


def in_steps(
    volume: Volume,
    medium: Medium | None,
    camera: Any,
    options: RenderOptions,
    *,
    seconds: float | None = None,
    focus: tuple[float, float] | None = None,
) -> Steps:
    """Render in batches of a given duration; to cancel, stop iterating.

    Parameters
    ----------
    volume, medium, camera, options
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
    drawing = prepared(volume, medium, camera, options)
    start, brightest = time.monotonic(), float(np.max(np.abs(drawing.background)))
    planes = yield from run_in_batches(drawing.job, brightest, seconds, focus)
    drawing.job.partition.finish()
    image = assembled(drawing, planes)
    name_slow_choices(
        time.monotonic() - start,
        adaptive=drawing.job.adaptive,
        bounds=drawing.panels > 0,
        double=options.precision == "double",
        tolerance=drawing.job.controlled and drawing.job.tolerance < FINEST_SINGLE,
    )
    return image


@dataclass
class Drawing:
    """A picture whose arguments are checked.

    Attributes
    ----------
    whole : Volume
        As it was given: `job` may have a coarser level.
    level : int or None
        The level that is drawn, if one was asked for.
    missing : dict
        Number of missing values in each field.
    background : float array
        Broadcasts to (ny, nx, channel).
    panels : int
        Most panels per segment for guaranteed bounds; 0: none are asked for.
    """

    job: RenderJob
    options: RenderOptions
    whole: Volume
    level: int | None
    missing: dict[str, int]
    objects: list[SceneObject]
    background: np.ndarray
    panels: int


def prepared(volume: Volume, medium: Medium | None, camera: Any, options: RenderOptions) -> Drawing:
    """Return a picture to be drawn; its level, chunks, medium and camera are chosen here."""
    view, memory = options.view, options.memory
    if camera is not None and view is not None:
        raise InputError(f"give a camera or view={view!r}, not both")
    fitted, whole, level = view is not None, volume, None
    if options.level is not None:
        if medium is None and isinstance(volume, Volume):
            medium, fitted = first_medium(volume), True
        if camera is None:
            camera = framed(volume, medium, view=view) if fitted else first_camera(volume)
        volume, medium, level = at_level(volume, medium, camera, options.level)
        if level and options.bounds:
            raise InputError(
                f"bounds=True is for all cells, this picture is drawn from level {level}: leave "
                "out bounds=True, or draw level=0"
            )
    partition = Partition(volume)
    if not (memory is None and options.executor is None and options.checkpoint is None):
        workers = options.executor, options.checkpoint
        partition = drawn_in_blocks(volume, medium, memory, *workers, options.bounds)
        volume = partition.volume
    if medium is None and isinstance(volume, Volume):
        medium, fitted = first_medium(volume), True
    if camera is None:
        camera = (
            framed(volume, medium, view=view, partition=partition)
            if fitted
            else first_camera(volume)
        )
    objects = check_objects(options.objects, options.bounds)
    job, missing = prepare(volume, medium, camera, options, partition)
    background = background_array(options.background, job.frame.pixels, job.medium.channels)
    panels = guaranteed.check_bounds(options.bounds, options.max_panels, job)
    return Drawing(job, options, whole, level, missing, objects, background, panels)


def first_medium(volume: Volume) -> Medium:
    """Return the preset that suits, or `suggest_medium` as cached for the last picture.

    The latter takes a second for a million cells of patches, the picture itself a tenth.
    """

    def key() -> Hashable:  # fields that are not read yet do not count
        read = [name for name in volume.fields if name not in volume.waiting]
        return "first medium", Cache(volume).statistics.digests(read)

    medium: Medium | None = Cache(volume).get(key())
    if medium is None:
        preset = getattr(presets, next(iter(presets.recognised(volume)[0]), ""), suggest_medium)
        medium = preset(volume)
        Cache(volume).put(key(), medium)  # fields may have been read only now
    return medium


def assembled(drawing: Drawing, planes: RenderResult) -> Image:
    """Return the image: with objects, the background, bounds, coordinates and provenance."""
    job, options, background = drawing.job, drawing.options, drawing.background
    if not planes.finite:
        refuse_unusable(job.backend.precision)
    if planes.nothing and not drawing.objects:
        warn_of_nothing(job)
    rays = options.samples if options.antialias is None else options.antialias
    provenance = {**job.provenance(), **oriented(drawing.whole.meta), "samples": rays}
    if drawing.objects:
        channels = channel_count(drawing.objects, job)
        background = wide_background(background, job.medium.channels, channels)
        planes = with_objects(planes, job, drawing.objects, background, channels)
        provenance["objects"] = [one.describe(MANY) for one in drawing.objects]
    if drawing.missing:
        provenance["missing"] = drawing.missing
    if drawing.level is not None:
        provenance["level"] = drawing.level
    intensity = planes.emission
    if np.any(background):
        intensity = before(background, intensity, planes.transparency)
    lower, upper = guaranteed.bracket(job, drawing.panels, intensity, background)
    (x, y), sky = job.frame.coordinates(), drawing.whole.wcs
    return Image(
        intensity,
        transparency=planes.transparency,
        optical_depth=_full_depth(job, planes) if planes.stopped else planes.depth,
        error=None if drawing.level else planes.error,
        lower=lower,
        upper=upper,
        x=x,
        y=y,
        intensity_unit=unit_name(intensity_unit(job.medium, job.volume)),
        pixel_size=job.frame.pixel,
        unit=job.camera.plane_unit or unit_name(job.volume.unit),
        wcs=None if sky is None else image_wcs(drawing.whole, job.camera, job.frame),
        camera=job.camera.describe(),
        provenance=provenance,
    )


def _full_depth(job: RenderJob, planes: RenderResult) -> Callable[[], np.ndarray]:
    channels = planes.emission.shape[2]

    def compute() -> np.ndarray:
        job.cutoff, job.progress = 0.0, silent
        return with_channels(run(job, 0.0).depth, channels, 0.0)

    return compute
