"""Layers put into pixels: rays are followed anew up to them; what is behind is known already.

Let a ray gather E and dim by θ up to a layer (b, t), and let E∞ be what the whole ray gathers. Then
it shows ``E + θ b + t (E∞ - E)``: a mean of the ray that ends at the layer and the one that does
not. Nothing needs to be solved behind, and a layer that shows nothing changes nothing.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ...objects.contract import Layers
from ..rays.adaptive import left_of_edges
from ..rays.control import lost_share
from ..rays.pixels import subpixel_offsets
from .pairs import Pairs, fold
from .stretches import Stretches

if TYPE_CHECKING:
    from ..job import Planes

# Rays per side of a pixel where the picture itself takes as many as it needs.
_SAMPLES = 4
# Stretches followed together, of several rays per pixel.
_TOGETHER = 1 << 20


@dataclass
class Groups:
    """Layers of each pixel together, the nearest first.

    Attributes
    ----------
    order : int array, shape (n,)
        Numbers of layers, group after group.
    pixel : int array, shape (groups,)
        Flat numbers of pixels, each once.
    count : int array, shape (groups,)
        How many layers each has.
    """

    order: np.ndarray
    pixel: np.ndarray
    count: np.ndarray

    @classmethod
    def of(cls, layers: Layers, pixels: int) -> Groups:
        """Return the groups of layers in a picture of so many pixels."""
        occurs = np.bincount(layers.pixel, minlength=pixels)
        alone = occurs.take(layers.pixel) == 1  # most are: only the others need to be sorted
        single, several = np.flatnonzero(alone), np.flatnonzero(~alone)
        several = several[np.lexsort((layers.depth[several], layers.pixel[several]))]
        pixel, count = np.unique(layers.pixel[several], return_counts=True)
        return cls(
            np.concatenate([single, several]),
            np.concatenate([layers.pixel[single], pixel]),
            np.concatenate([np.ones(len(single), count.dtype), count]),
        )

    @property
    def first(self) -> np.ndarray:
        """Where in `order` each group begins."""
        return np.asarray(np.cumsum(self.count) - self.count)


def lay(planes: Planes, layers: Layers, drawing: Stretches) -> None:
    """Put layers at their depths into the pixels that they cover."""
    if not len(layers.pixel):
        return
    groups, job = Groups.of(layers, planes.emission[..., 0].size), drawing.job
    placed = layers.some(groups.order)
    offsets = subpixel_offsets(_SAMPLES if job.adaptive or job.recursive else job.samples)
    together = max(1, _TOGETHER // len(layers.pixel))
    found = [
        _folded(placed, groups.count, ways)
        for first in range(0, len(offsets), together)
        for ways in drawing.up_to(layers, groups.order, groups.first, offsets[first:][:together])
    ]
    shown, bare = (Pairs.mean(list(parts)) for parts in zip(*found, strict=True))
    through = np.multiply.reduceat(1.0 - placed.opacity, groups.first)
    _put(planes, groups.pixel, shown, bare, through, drawing)
    if job.adaptive and planes.error is not None:
        planes.error.reshape(-1)[groups.pixel] += _scatter(found, through)


def _scatter(found: list[tuple[Pairs, Pairs]], through: np.ndarray) -> np.ndarray:
    """Return by how much means over the rays of a pixel may be off: what is in front has edges."""
    seen = [shown.emission - through[:, None] * bare.emission for shown, bare in found]
    low, high = (functools.reduce(extreme, seen) for extreme in (np.minimum, np.maximum))
    return left_of_edges((high - low).max(axis=1), len(found))


def _folded(placed: Layers, count: np.ndarray, ways: Pairs) -> tuple[Pairs, Pairs]:
    """Return what is seen up to the last layer of each pixel, with layers, and without any.

    Errors of the first are those of the light of layers alone: of how much of it comes through.
    """
    dim, bright = np.zeros_like(ways.error), np.zeros_like(ways.error)
    dim[:, 1:2] = ways.error[:, 1:2]
    bright[:, 2:] = np.abs(placed.emission).max(axis=1, keepdims=True)
    pairs = Pairs(placed.emission, (1.0 - placed.opacity)[:, None], bright)
    lit = Pairs(ways.emission, ways.transparency, dim).over(pairs)
    return fold(lit, count), fold(ways, count)


def _put(
    planes: Planes,
    pixel: np.ndarray,
    shown: Pairs,
    bare: Pairs,
    through: np.ndarray,
    drawing: Stretches,
) -> None:
    """Put what layers show into pixels, in front of what they let through of the rest.

    Every way to a layer counts by at most 1 - `through`, and so do its errors. To them comes how
    far the light of layers may be off, since it is dimmed on its way.
    """
    (ny, nx, channels), (*_, dims) = planes.emission.shape, planes.transparency.shape
    whole, clear = planes.emission.reshape(-1, channels), planes.transparency.reshape(-1, dims)
    seen = whole.take(pixel, axis=0) - bare.emission
    seen *= through[:, None]
    seen += shown.emission
    for plane, values in zip(whole.T, seen.T, strict=True):  # NumPy puts triples half as fast
        plane[pixel] = values
    for plane in clear.T:
        plane[pixel] *= through
    planes.emission = whole.reshape(ny, nx, channels)
    planes.transparency = clear.reshape(ny, nx, dims)
    if planes.error is not None:
        wrong, _, bright = bare.error.T
        lost = wrong + lost_share(drawing) * bright
        if drawing.job.scheme.controlled:
            lost += drawing.source.neglected * drawing.source.numbers.unit
        error = planes.error.reshape(-1)
        error[pixel] = (1.0 - through) * lost + through * error.take(pixel) + shown.error[:, 0]
        planes.error = error.reshape(ny, nx)
