"""Stars and lines in a picture: more pairs (b, θ), each at its depth among those of the medium.

Rays of pixels that objects cover are followed again up to them, see `layered`. Points of light hide
nothing: a ray to each tells how much of it comes through, and it is added.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import InputError
from ...media.ranges import RangeContext
from ...objects import SceneObject
from ...objects.contract import Layers, Points, View
from .layered import lay
from .light import seen_through, shine
from .pairs import Pairs, fold, with_channels
from .stretches import Stretches

if TYPE_CHECKING:
    from ..job import Job, Planes


def check_objects(objects: Any, bounds: Any) -> list[SceneObject]:
    """Return objects as a list.

    Raises
    ------
    InputError
        If one is something else, or bounds are asked for.
    """
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
    """Return a background for all channels of a picture: those of objects have none."""
    if total == channels:
        return background
    own = np.broadcast_to(background, (*background.shape[:-1], channels))
    return np.concatenate([own, np.zeros((*own.shape[:-1], total - channels))], axis=-1)


def channel_count(objects: list[SceneObject], job: Job) -> int:
    """Return how many channels a picture has: the medium's, and those of objects.

    Raises
    ------
    InputError
        If nothing is known of the extinction in an object's channel, or channels without anything
        would be left between the medium's and an object's.
    """
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
class Drawn:
    """What objects show: layers and points at their true depth, and those in the foreground."""

    layers: Layers
    points: list[Points]
    front_layers: Layers
    front_points: list[Points]

    @classmethod
    def of(cls, objects: list[SceneObject], view: View) -> Drawn:
        """Return what is in view."""
        parts: list[Any] = []
        for depth in ("true", "foreground"):
            some = [one for one in objects if one.depth == depth]
            layers = [one.layers(view) for one in some]
            parts.append(Layers.joined([a for a in layers if a is not None], view.all_channels))
            parts.append([found for one in some if (found := one.lights(view)) is not None])
        return cls(*parts)

    @property
    def brightest(self) -> float:
        """The most that something at its true depth adds to a pixel."""
        shown = [self.layers.emission, *(points.flux for points in self.points)]
        return max(float(np.max(np.abs(values), initial=0.0)) for values in shown)


def with_objects(
    planes: Planes, job: Job, objects: list[SceneObject], background: np.ndarray, total: int
) -> Planes:
    """Return the planes of a picture with objects in it.

    Parameters
    ----------
    planes : Planes
        Of the medium alone.
    background : array
        Intensities behind everything.
    total : int
        Channels of the picture, see `channel_count`.
    """
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
    drawn = Drawn.of(objects, view)
    brightest = max(float(np.max(np.abs(background))), drawn.brightest)
    drawing = Stretches(job, planes.drawing.source, brightest)
    lay(planes, drawn.layers, drawing)
    for points in drawn.points:
        shine(planes, points, *seen_through(points, drawn.layers, drawing))
    _lay_in_front(planes, drawn.front_layers)
    for points in drawn.front_points:
        shine(planes, points, np.ones(1), np.zeros(0))
    return planes


def _widened(planes: Planes, medium: Any, total: int) -> Planes:
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


def _lay_in_front(planes: Planes, layers: Layers) -> None:
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
