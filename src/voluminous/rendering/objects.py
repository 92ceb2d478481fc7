"""Stars and lines in a picture: additional pairs (b, θ), placed at their depths in the medium.

Rays of pixels that objects cover are traced again up to them, see `layers`. Points of light
are added, each attenuated by the medium along a ray to it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..errors import InputError
from ..media.details import intensity_unit
from ..objects import SceneObject
from ..objects.contract import REACH, Layers, PointLights, View
from .job import RenderJob
from .layers import Pairs, between, fold, lay, with_channels
from .run import RenderResult
from .tracer import RayTracer


def check_objects(objects: Any, bounds: Any) -> list[SceneObject]:
    """Return objects as a list."""
    listed = [objects] if isinstance(objects, SceneObject) else objects
    if not isinstance(listed, Sequence) or isinstance(listed, str):
        raise InputError(f"objects must be a list of vm.Stars, vm.Curves, …, got {objects!r}")
    for number, one in enumerate(listed):
        if not isinstance(one, SceneObject):
            raise InputError(
                f"objects must be vm.Stars, vm.Spheres, vm.Curves, vm.Boxes, vm.Axes, "
                f"…; number {number} is of type {type(one).__name__}"
            )
    if len(listed) and bounds is not False:
        raise InputError("guaranteed bounds are of the medium alone: leave out objects, or bounds")
    return list(listed)


def channel_count(objects: list[SceneObject], job: RenderJob) -> int:
    """Return the number of channels of a picture: the medium's, and those of objects."""
    count = int(job.medium.channels)
    beyond = {one.channel for one in objects if one.channel is not None and one.channel >= count}
    if beyond and max(beyond) >= count + len(beyond):
        raise InputError(
            f"channel {max(beyond)}: the medium has {count}, and nothing would be in channel "
            f"{min(set(range(count, count + len(beyond))) - beyond)}; number those of objects from "
            f"{count} on"
        )
    for one in objects:
        if one.channel in beyond and not job.medium.grey and one.depth == "true":
            raise InputError(
                f"channel {one.channel} is beyond the medium's {count}, whose extinction differs "
                "from channel to channel: nothing dims it there; give depth='foreground'"
            )
    return count + len(beyond)


def wide_background(background: np.ndarray, channels: int, total: int) -> np.ndarray:
    """Return a background with all channels of a picture: zero in those of objects."""
    if total == channels:
        return background
    shown = np.broadcast_to(background, (*background.shape[:-1], channels))
    return np.concatenate([shown, np.zeros((*shown.shape[:-1], total - channels))], axis=-1)


def with_objects(
    planes: RenderResult,
    job: RenderJob,
    objects: list[SceneObject],
    background: np.ndarray,
    total: int,
) -> RenderResult:
    """Return the planes of a picture with objects in it."""
    channels = int(job.medium.channels)
    if total > channels:
        planes = replace(
            planes,
            emission=np.pad(planes.emission, ((0, 0), (0, 0), (0, total - channels))),
            transparency=with_channels(planes.transparency, total, 1.0),
            depth=with_channels(planes.depth, total, 0.0),
        )
    view = View(
        job.camera,
        job.volume.grid,
        job.frame,
        job.backend,
        channels,
        total,
        intensity_unit(job.medium, job.volume),
        lambda: float(np.max(np.abs(planes.emission + planes.transparency * background))),
    )
    # Those at their true depth, and those in the foreground.
    (layers, points), (front_layers, front_points) = (
        _in_view([one for one in objects if one.depth == depth], view)
        for depth in ("true", "foreground")
    )
    sizes = [background, layers.emission, *(light.flux for light in points)]
    brightest = max(float(np.max(np.abs(values), initial=0.0)) for values in sizes)
    tracer = planes.tracer.afresh(brightest)
    tracer.tolerance = planes.tracer.tolerance
    if job.walk_kind == "substeps":
        tracer.walk = job.volume.grid.walk(job.backend, "cells")
    lay(planes, layers, tracer)
    for light in points:
        _shine(planes, light, *_seen_through(light, layers, tracer))
    _lay_in_front(planes, front_layers)
    for light in front_points:
        _shine(planes, light, np.ones(1), np.zeros_like(light.flux), np.zeros(0))
    return planes


def _in_view(objects: list[SceneObject], view: View) -> tuple[Layers, list[PointLights]]:
    layers = [part for one in objects if (part := one.layers(view)) is not None]
    points = [light for one in objects if (light := one.lights(view)) is not None]
    return Layers.joined(layers, view.all_channels), points


def _lay_in_front(planes: RenderResult, layers: Layers) -> None:
    layers = layers.some(np.lexsort((layers.depth, layers.pixel)))
    pixel, count = np.unique(layers.pixel, return_counts=True)
    theta = 1.0 - layers.opacity[:, None]
    front = fold(Pairs(layers.emission, theta, np.zeros((len(theta), 3))), count)
    place = np.divmod(pixel, planes.emission.shape[1])
    planes.emission[place] = front.emission + front.transparency * planes.emission[place]
    planes.transparency[place] *= front.transparency
    if planes.error is not None:
        planes.error[place] *= front.transparency[:, 0]


# --- points of light ------------------------------------------------------------------------------


def _seen_through(
    points: PointLights, layers: Layers, tracer: RayTracer
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    nx, ny = tracer.job.frame.pixels
    x, y = (np.clip(np.floor(w + 0.5), 0, n - 1) for w, n in ((points.x, nx), (points.y, ny)))
    pixel = (y * nx + x).astype(np.int64)
    depths = np.full(len(pixel), -np.inf), points.depth
    channels = tracer.job.medium.channels
    medium = between(tracer, pixel, points.x - x, points.y - y, depths, channels)
    in_front = _layers_in_front(pixel, points.depth, layers)
    channels = points.flux.shape[1]
    through = with_channels(medium.transparency, channels, 1.0) * in_front
    emission = with_channels(medium.emission, channels, 0.0)
    return through, emission, medium.error[:, 1:2] * in_front


def _layers_in_front(pixel: np.ndarray, depth: np.ndarray, layers: Layers) -> np.ndarray:
    """Return the transparency of the layers in front of each point, in its pixel, shape (n, 1)."""
    order = np.lexsort((layers.depth, layers.pixel))
    layers = layers.some(order)
    # Points and layers in one order: how many layers of all pixels precede each point.
    everything = np.lexsort(
        (np.concatenate([layers.depth, depth]), np.concatenate([layers.pixel, pixel]))
    )
    last = np.empty(len(everything), np.int64)
    last[everything] = np.cumsum(everything < len(order))
    first, last = np.searchsorted(layers.pixel, pixel), last[len(order) :]
    theta = np.append(1.0 - layers.opacity, 1.0)
    product = np.multiply.reduceat(theta, np.stack([first, last], axis=1).reshape(-1))[::2]
    return np.where(last > first, product, 1.0)[:, None]


def _shine(
    planes: RenderResult,
    points: PointLights,
    through: np.ndarray,
    in_front: np.ndarray,
    unsure: np.ndarray,
) -> None:
    """Add the spread light of points, and its errors, to a picture; hide what is behind them."""
    ny, nx, _ = planes.emission.shape
    for k in np.flatnonzero(points.opacity):
        x, y = (int(np.floor(w[k] + 0.5)) for w in (points.x, points.y))
        if 0 <= x < nx and 0 <= y < ny:
            covered = points.opacity[k]
            planes.emission[y, x] += covered * (in_front[k] - planes.emission[y, x])
            planes.transparency[y, x] *= 1.0 - covered
    light, rows = _spread(points, points.flux * through, (nx, ny))
    for channel, total in enumerate(light):
        planes.emission[rows, :, channel] += total
    if planes.error is not None and unsure.size:
        brightest = np.abs(points.flux).max(axis=1, keepdims=True)
        wrong, rows = _spread(points, brightest * unsure, (nx, ny))
        planes.error[rows] += wrong[0]


def _spread(
    points: PointLights, flux: np.ndarray, pixels: tuple[int, int]
) -> tuple[np.ndarray, slice]:
    (nx, ny), (width, height) = pixels, points.sigma.tolist()
    x, share = _shares(points.x, width, nx)
    y, other = _shares(points.y, height, ny)
    first = int(y.min(initial=ny))
    count = max(int(y.max(initial=0)) + 1 - first, 0)
    # The many points are the fastest axis: with the PSF there NumPy is three times slower.
    place = ((y - first) * nx)[:, None] + x
    light = [
        np.bincount(place.ravel(), ((f * other)[:, None] * share).ravel(), count * nx)
        for f in np.ascontiguousarray(flux.T)
    ]
    return np.reshape(light, (len(light), count, nx)), slice(first, first + count)


def _shares(place: np.ndarray, sigma: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return pixels in one dimension, and each point's share of flux in them, shape (k, n) each.

    Pixels outside the picture are moved to its edge, with a share of zero.
    """
    nearest, reach = np.floor(place + 0.5), math.ceil(REACH * sigma)
    pixel = nearest.astype(np.int64) + np.arange(-reach, reach + 1)[:, None]
    share = np.ones(pixel.shape)
    if sigma > 0.0:
        from scipy.special import erf

        edges = np.arange(-reach, reach + 2)[:, None] - 0.5 + (nearest - place)
        below = erf(np.clip(edges / sigma, -REACH, REACH) / math.sqrt(2.0))
        share = np.diff(below, axis=0) * (0.5 / math.erf(REACH / math.sqrt(2.0)))
    inside = (pixel >= 0) & (pixel < count)
    return np.clip(pixel, 0, count - 1), np.where(inside, share, 0.0)
