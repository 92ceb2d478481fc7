"""Fits cameras to the visible part of a medium: data often fill a small part of their box."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from ..calibration import calibrated
from ..calibration.samples import measurable
from ..cameras import Orthographic
from ..cameras.views import view_angles
from ..errors import InputError
from ..expressions.interval import Interval
from ..fields import COORDINATES, coordinate_extremes
from ..geometry import FIRST_INCL, FIRST_PHI, mirror_images, position
from ..grids.contract import DualGrid
from ..grids.structured import is_structured
from ..media.bound import Binding, BoundMedium
from ..media.contract import Medium
from ..media.ranges import RangeContext, largest
from ..ranges import Ranges, sums_in
from ..schemes.pre_integrated import PreIntegrated
from ..volume import Volume
from .cache import Cache
from .empty_picture import warn_of_nothing
from .job import RenderJob
from .options import RenderOptions
from .partition import Partition
from .prepare import prepare
from .run import RenderResult, run
from .sources.empty_space import ranges_of_cells

if TYPE_CHECKING:
    from ..cameras.contract import Frame


# Pixels per side of a coarse picture that shows where the medium is visible:
_COARSE = 96
# brighter than the first fraction of the maximum, except for the second fraction of the total light
# (faint wisps).
_FAINT, _WISPS = 0.02, 2e-3
# The visible part fills the first fraction of the frame; a frame filled to the second is unchanged.
_FILLED, _FULL = 0.85, 0.7
# What spans fewer pixels of the coarse picture, which may even miss it, is drawn again, closer: so
# often, because a point is one pixel in any of them.
_FEW, _CLOSER = 12, 3


def framed(
    volume: Volume,
    medium: Medium | None = None,
    incl: Any = None,
    phi: Any = None,
    *,
    view: str | None = None,
    resolution: Any = 400,
    partition: Partition | None = None,
) -> Orthographic:
    """Return a camera around the visible part of a medium; see `Orthographic.framing`."""
    return _framed(volume, medium, incl, phi, view, resolution, partition)[0]


def framed_or_warned(*args: Any) -> tuple[Orthographic, float]:
    """Return the same, and how far behind its centre that part is; warn if nothing shows."""
    if not hasattr(args[0], "grid"):
        raise InputError(f"framing needs a vm.Volume first, got {type(args[0]).__name__}")
    camera, depth, empty = _framed(*args)
    if empty is not None:
        warn_of_nothing(empty)
    return camera, depth


def _framed(
    volume: Volume,
    medium: Medium | None,
    incl: Any,
    phi: Any,
    view: str | None,
    resolution: Any,
    partition: Partition | None = None,
) -> tuple[Orthographic, float, RenderJob | None]:
    camera = first_camera(volume, incl, phi, view=view).replace(resolution=resolution)
    if medium is None:
        return camera, 0.0, None
    if isinstance(volume, Volume) and isinstance(medium, Medium):  # `prepare` refuses others
        medium = calibrated(medium, volume, Cache(volume).measurements)
        level = measurable(volume)
        partition = None if level is not volume or partition is None else partition.alone()
        volume = level
    # Where steps can be wide is for larger pictures (512³, four shells: 4 s of a processor).
    dual = isinstance(volume.grid, DualGrid) and not getattr(medium, "discrete", False)
    scheme = PreIntegrated(coarseness=0.0) if dual else "first-order"
    options = RenderOptions(scheme=scheme, tolerance=None)

    def draw(camera: Orthographic) -> tuple[RenderJob, RenderResult]:
        job, _ = prepare(volume, medium, camera, options, partition)
        return job, run(job, 0.0)

    coarse = camera.replace(resolution=_COARSE)
    job, drawn = draw(coarse)
    limits, pixel = _limits(drawn, job.frame), job.frame.pixel[0]
    *places, reach = _visible_cells(job, drawn.tracer.source)
    if reach.size:
        cells = np.array([[(p - reach).min(), (p + reach).max()] for p in places])
        limits = cells[:2] if _side(cells[:2]) < _FEW * pixel else limits
    if limits is None:
        return camera, 0.0, job
    whole = _COARSE * pixel
    for _ in range(_CLOSER):
        if _side(limits) >= _FEW * pixel:
            break
        part, drawn = draw(_around(coarse, limits))
        found, pixel = _limits(drawn, part.frame), part.frame.pixel[0]
        limits = limits if found is None else found  # rays may miss it
    if _side(limits) > _FULL * whole:
        return camera, 0.0, None
    inside = [(p + reach > a) & (p - reach < b) for p, (a, b) in zip(places, limits, strict=False)]
    depth = places[2][inside[0] & inside[1]]
    middle = 0.5 * float(depth.min() + depth.max()) if depth.size else 0.0
    return _around(camera, limits), middle, None


def perspective(
    framing: Orthographic, depth: float, volume: Volume, fov: float
) -> tuple[Any, Any, np.ndarray]:
    """Return position, target and up vector of a perspective view; `fov` is in degrees.

    A cube as wide as the frame, at a depth behind its centre, fills the picture with its front.
    """
    frame = framing.frame(volume.grid)
    center, right, up, into = frame.vectors[:4]
    target = center + frame.shift[0] * right + frame.shift[1] * up + depth * into
    width = max(frame.width)
    away = 0.5 * width * (1.0 + 1.0 / np.tan(0.5 * np.deg2rad(fov)))
    return (target - away * into).tolist(), target.tolist(), up


def first_camera(
    volume: Volume, incl: Any = None, phi: Any = None, *, view: str | None = None
) -> Orthographic:
    """Return a camera that shows the whole volume from given angles, or in a view."""
    if incl is None and phi is None:
        return Orthographic(**view_angles(getattr(volume, "meta", {}), view))
    if view is not None:
        raise InputError(f"give angles or view={view!r}, not both")
    return Orthographic(FIRST_INCL if incl is None else incl, FIRST_PHI if phi is None else phi)


def _limits(drawn: RenderResult, frame: Frame) -> np.ndarray | None:
    """Return the limits of the visible part along both axes of the image plane; None: nothing is.

    What only absorbs is seen by what it takes away.
    """
    light = drawn.emission.sum(axis=-1, dtype=np.float64)
    if not light.max() > 0.0:
        light = 1.0 - drawn.transparency.min(axis=-1)
    if not light.max() > 0.0:
        return None
    light = np.where(light > _FAINT * light.max(), light, 0.0)
    limits = []
    for axis, places in enumerate(frame.coordinates()):
        total = np.cumsum(light.sum(axis=axis)) / max(light.sum(), 1e-300)
        first, last = np.searchsorted(total, [_WISPS, 1.0 - _WISPS])
        last = min(last, len(places) - 1)
        # Between few rays its ends are anywhere.
        beyond = (0.5 if last - first >= _FEW else 1.0) * frame.pixel[axis]
        limits.append((places[first] - beyond, places[last] + beyond))
    return np.array(limits)


def _side(limits: np.ndarray) -> float:
    return float(np.ptp(limits, axis=1).max())


def _around(camera: Orthographic, limits: np.ndarray) -> Orthographic:
    pixels = camera.resolution
    width = max(pixels) * max(s / n for s, n in zip(np.ptp(limits, axis=1), pixels, strict=True))
    return camera.replace(
        width=_rounded(width / _FILLED, width),
        shift=tuple(_rounded(middle, width) for middle in limits.mean(axis=1)),
    )


def _visible_cells(job: RenderJob, source: Any) -> np.ndarray:
    """Return x, y and depth on the image plane, and reach, of the cells that may show, (4, n).

    Rays in a coarse picture miss small cells. Where bounds of what a cell shows are infinite, or
    undefined, it may.
    """
    bound = job.medium.bind(Binding.to(job.volume))
    center, axes, found = job.frame.vectors[0], job.frame.vectors[1:4], []
    with np.errstate(all="ignore"):
        for fields, centers, reach in _parts(job, source):
            seen, emission, depth = sums_in(job.medium, bound, fields, _shown)
            seen, depth = np.broadcast_to(seen, reach.shape), reach * depth
            light = reach * emission / (1.0 + depth)
            for image in mirror_images(job.volume.grid):
                places = axes @ (centers * image[:, None] - center[:, None])
                found.append(np.vstack([light, depth, places, reach])[:, seen])
    light, depth, *cells = np.concatenate(found, axis=1)
    light = light if np.any(light > 0.0) else depth
    most = light.max(initial=0.0, where=np.isfinite(light))
    return np.array(cells)[:, ~(light < _WISPS * most)]


def _shown(bound: BoundMedium, fields: dict[str, Interval]) -> list[np.ndarray]:
    most = largest(bound, fields, _WISPS)
    seen = np.asarray(bound.may_show(fields, RangeContext(_WISPS)))
    return [seen, *(sum(rows, np.zeros(())) for rows in (most.emissivity, most.extinction))]


def _parts(job: RenderJob, source: Any) -> Iterator[tuple[Ranges, np.ndarray, np.ndarray]]:
    """Yield ranges of what the medium uses, centres, and what is how far around, of many cells.

    Of arrays the cells are boxes, 64³ at most, or chunks.
    """
    volume, grid, names = job.volume, job.volume.grid, job.medium.names
    own = [name for name in names if name in volume]
    found: Any = ()
    if is_structured(grid):
        steps = zip(grid.edges, job.partition.ranged, strict=True)
        walls = [np.append(e[:-1:step], e[-1]) for e, step in steps]
        low, high = (
            np.reshape(np.meshgrid(*(w[part] for w in walls), indexing="ij"), (3, -1))
            for part in (slice(None, -1), slice(1, None))
        )
        center, *corners = (
            position(tuple(grid.coordinates), low + np.array(place)[:, None] * (high - low))
            for place in [(0.5, 0.5, 0.5), *itertools.product((0.0, 1.0), repeat=3)]
        )
        reach = np.max([np.linalg.norm(c - center, axis=0) for c in corners], axis=0)
        found = [(job.partition.ranges_around(job.cache, own), center, reach)]
    else:
        found = (
            (
                ranges,
                grid.cell_centers(part.start, part.stop),
                0.5 * np.linalg.norm(grid.cell_sizes(part.start, part.stop), axis=0),
            )
            for part, ranges in ranges_of_cells(volume, own, getattr(source, "lattices", {}))
        )
    for ranges, center, reach in found:
        for name in set(names) - set(own):
            ranges[name] = Interval(*map(np.asarray, coordinate_extremes(grid, name)))
            if name in COORDINATES:
                away = np.linalg.norm(center, axis=0)
                middle = away if name == "r" else center["xyz".index(name)]
                ranges[name] = Interval(middle - reach, middle + reach)
        for axis in job.medium.sight:
            ranges[f"los.{axis}"] = Interval(np.asarray(-1.0), np.asarray(1.0))
        yield ranges, center, reach


def _rounded(value: float, size: float) -> float:
    return round(float(value), 3 - int(np.floor(np.log10(size))))
