"""Stars and lines in a picture: additional pairs (b, θ), placed at their depths in the medium.

Rays of pixels that objects cover are traced again up to them, see `layers`. Points of light
are added, each attenuated by the medium along a ray to it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError
from ..media.contract import Medium
from ..media.ranges import RangeContext
from ..objects import SceneObject
from ..objects.contract import REACH, Layers, PointLights, View
from .layers import Pairs, Stretches, fold, lay, with_channels

if TYPE_CHECKING:
    from .job import RenderJob, RenderResult
    from .layers import Stretches


# The integral of a Gaussian, at equal steps: between them it is linear to 1e-8.
_STEPS = 1 << 14
_BELOW = np.array(
    [math.erf(REACH * (2.0 * k / _STEPS - 1.0) / math.sqrt(2.0)) for k in range(_STEPS + 1)]
)
_BELOW *= 0.5 / _BELOW[-1]
_RISE = np.append(np.diff(_BELOW), 0.0)


def spread(
    points: PointLights, flux: np.ndarray, pixels: tuple[int, int]
) -> tuple[np.ndarray, int]:
    """Return the light of points in some rows of a picture, and the index of the first row."""
    (nx, ny), (width, height) = pixels, points.sigma.tolist()
    x, share = _shares(points.x, width, nx)
    y, other = _shares(points.y, height, ny)
    first, last = int(y.min(initial=ny)), int(y.max(initial=0))
    count = max(last + 1 - first, 0)
    # The many points are the fastest axis: with the PSF there NumPy is three times slower.
    place = ((y - first) * nx)[:, None] + x
    light = [
        np.bincount(place.ravel(), ((f * other)[:, None] * share).ravel(), count * nx)
        for f in np.ascontiguousarray(flux.T)
    ]
    return np.reshape(light, (len(light), count, nx)), first


def _shares(place: np.ndarray, sigma: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return pixels in one dimension, and each point's share of flux in them, shape (k, n) each.

    Pixels outside the picture are moved to its edge, with a share of zero.
    """
    nearest, reach = np.floor(place + 0.5), math.ceil(REACH * sigma)
    pixel = nearest.astype(np.int64) + np.arange(-reach, reach + 1)[:, None]
    share = np.ones(pixel.shape) if sigma == 0.0 else _parts(nearest - place, sigma, reach)
    inside = (pixel >= 0) & (pixel < count)
    return np.clip(pixel, 0, count - 1), np.where(inside, share, 0.0)


def _parts(offset: np.ndarray, sigma: float, reach: int) -> np.ndarray:
    """Return the shares of Gaussians in the pixels around their central one, shape (k, n)."""
    edges = np.arange(-reach, reach + 2)[:, None] - 0.5 + offset
    step = np.clip((edges / sigma + REACH) * (0.5 * _STEPS / REACH), 0.0, _STEPS)
    number = step.astype(np.int64)
    return np.diff(_BELOW.take(number) + (step - number) * _RISE.take(number), axis=0)


def seen_through(
    points: PointLights, layers: Layers, tracer: Stretches
) -> tuple[np.ndarray, np.ndarray]:
    """Return the transparency in front of each point of light, and its error."""
    nx, ny = tracer.job.frame.pixels
    x, y = (np.clip(np.floor(w + 0.5), 0, n - 1) for w, n in ((points.x, nx), (points.y, ny)))
    pixel = (y * nx + x).astype(np.int64)
    found = tracer.to(pixel, points.x - x, points.y - y, points.depth)
    in_front = _in_front(pixel, points.depth, layers)
    through = with_channels(found.transparency, points.flux.shape[1], 1.0) * in_front
    return through, found.error[:, 1:2] * in_front


def _in_front(pixel: np.ndarray, depth: np.ndarray, layers: Layers) -> np.ndarray:
    """Return the transparency of the layers in front of each point, in its pixel, shape (n, 1)."""
    if not len(layers.pixel):
        return np.ones((len(pixel), 1))
    order = np.lexsort((layers.depth, layers.pixel))
    sorted_pixel, sorted_depth = layers.pixel[order], layers.depth[order]
    theta = np.append(1.0 - layers.opacity[order], 1.0)
    first = np.searchsorted(sorted_pixel, pixel)
    # Points and layers in one order: how many layers of all pixels precede each point.
    everything = np.lexsort(
        (np.concatenate([sorted_depth, depth]), np.concatenate([sorted_pixel, pixel]))
    )
    before = np.cumsum(everything < len(order))
    place = np.empty(len(everything), np.int64)
    place[everything] = before
    last = place[len(order) :]
    product = np.multiply.reduceat(theta, np.stack([first, last], axis=1).reshape(-1))[::2]
    return np.where(last > first, product, 1.0)[:, None]


def shine(
    planes: RenderResult, points: PointLights, through: np.ndarray, unsure: np.ndarray
) -> None:
    """Add the spread light of points, and its errors, to a picture."""
    ny, nx, _ = planes.emission.shape
    light, first = spread(points, points.flux * through, (nx, ny))
    rows = slice(first, first + light.shape[1])
    for channel, total in enumerate(light):
        planes.emission[rows, :, channel] += total
    if planes.error is not None and unsure.size:
        brightest = np.abs(points.flux).max(axis=1, keepdims=True)
        wrong, _ = spread(points, brightest * unsure, (nx, ny))
        planes.error[rows] += wrong[0]


def check_objects(objects: Any, bounds: Any) -> list[SceneObject]:
    """Return objects as a list."""
    listed = [objects] if isinstance(objects, SceneObject) else objects
    if not isinstance(listed, Sequence) or isinstance(listed, str):
        raise InputError(f"objects must be a list of vm.Stars, vm.Lines, …, got {objects!r}")
    for number, one in enumerate(listed):
        if not isinstance(one, SceneObject):
            raise InputError(
                f"objects must be vm.Stars, vm.Spheres, vm.Lines, vm.Boxes, vm.Axes, "
                f"…; number {number} is of type {type(one).__name__}"
            )
    if len(listed) and bounds is not False:
        raise InputError("guaranteed bounds are of the medium alone: leave out objects, or bounds")
    return list(listed)


def wide_background(background: np.ndarray, channels: int, total: int) -> np.ndarray:
    """Return a background with all channels of a picture: zero in those of objects."""
    if total == channels:
        return background
    own = np.broadcast_to(background, (*background.shape[:-1], channels))
    return np.concatenate([own, np.zeros((*own.shape[:-1], total - channels))], axis=-1)


def channel_count(objects: list[SceneObject], job: RenderJob) -> int:
    """Return the number of channels of a picture: the medium's, and those of objects."""
    own = int(job.medium.channels)
    beyond = {one.channel for one in objects if one.channel is not None and one.channel >= own}
    if beyond and max(beyond) >= own + len(beyond):
        raise InputError(
            f"channel {max(beyond)}: the medium has {own}, and nothing would be in channel "
            f"{min(set(range(own, own + len(beyond))) - beyond)}; number those of objects from "
            f"{own} on"
        )
    for one in objects:
        if one.channel in beyond and not job.medium.grey and one.depth == "true":
            raise InputError(
                f"channel {one.channel} is beyond the medium's {own}, whose extinction differs "
                "from channel to channel: nothing dims it there; give depth='foreground'"
            )
    return max([own, *(one.channel + 1 for one in objects if one.channel is not None)])


@dataclass
class ObjectLayers:
    """The layers and points of objects at their true depth, and of those in the foreground."""

    layers: Layers
    points: list[PointLights]
    front_layers: Layers
    front_points: list[PointLights]

    @classmethod
    def of(cls, objects: list[SceneObject], view: View) -> ObjectLayers:
        """Return the layers and points in view."""
        parts: list[Any] = []
        for depth in ("true", "foreground"):
            some = [one for one in objects if one.depth == depth]
            layers = [one.layers(view) for one in some]
            parts.append(Layers.joined([a for a in layers if a is not None], view.all_channels))
            parts.append([found for one in some if (found := one.lights(view)) is not None])
        return cls(*parts)

    @property
    def brightest(self) -> float:
        """The maximum that an object at its true depth adds to a pixel."""
        shown = [self.layers.emission, *(points.flux for points in self.points)]
        return max(float(np.max(np.abs(values), initial=0.0)) for values in shown)


def with_objects(
    planes: RenderResult,
    job: RenderJob,
    objects: list[SceneObject],
    background: np.ndarray,
    total: int,
) -> RenderResult:
    """Return the planes of a picture with objects in it."""
    planes = _widened(planes, job.medium, total)

    def brightest_pixel() -> float:
        return float(np.max(np.abs(planes.emission + planes.transparency * background)))

    view = View(
        job.camera,
        job.volume.grid,
        job.frame,
        job.backend,
        int(job.medium.channels),
        total,
        job.medium.intensity_unit(RangeContext(job.volume.unit, job.volume.expression_unit)),
        brightest_pixel,
    )
    drawn = ObjectLayers.of(objects, view)
    brightest = max(float(np.max(np.abs(background))), drawn.brightest)
    tracer = Stretches(job, planes.tracer.source, brightest)
    lay(planes, drawn.layers, tracer)
    for points in drawn.points:
        shine(planes, points, *seen_through(points, drawn.layers, tracer))
    _lay_in_front(planes, drawn.front_layers)
    for points in drawn.front_points:
        shine(planes, points, np.ones(1), np.zeros(0))
    return planes


def _widened(planes: RenderResult, medium: Medium, total: int) -> RenderResult:
    more = total - int(medium.channels)
    if not more:
        return planes
    emission = np.pad(planes.emission, ((0, 0), (0, 0), (0, more)))
    return replace(
        planes,
        emission=emission,
        transparency=with_channels(planes.transparency, total, 1.0),
        depth=with_channels(planes.depth, total, 0.0),
    )


def _lay_in_front(planes: RenderResult, layers: Layers) -> None:
    if not len(layers.pixel):
        return
    layers = layers.some(np.lexsort((layers.depth, layers.pixel)))
    pixel, count = np.unique(layers.pixel, return_counts=True)
    theta = 1.0 - layers.opacity[:, None]
    front = fold(Pairs(layers.emission, theta, np.zeros((len(theta), 3))), count)
    row, column = np.divmod(pixel, planes.emission.shape[1])
    planes.emission[row, column] = (
        front.emission + front.transparency * planes.emission[row, column]
    )
    planes.transparency[row, column] *= front.transparency
    if planes.error is not None:
        planes.error[row, column] *= front.transparency[:, 0]
