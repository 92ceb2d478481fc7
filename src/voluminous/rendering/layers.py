"""Composites layers (objects) into pixels: rays are traced again, but only up to the layers.

Let a ray gather E and dim by θ up to a layer (b, t), and let E∞ be the emission along the whole
ray. Then the pixel is ``E + θ b + t (E∞ - E)``: a mean of the ray that ends at the layer and the
one that does not. The part behind the layer needs no second solution, and an invisible layer
changes nothing.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..backend import dr, from_host
from ..backend.types import Int
from ..grids.contract import Ray
from ..objects.contract import Layers
from .antialias import left_of_edges
from .pixels import subpixel_offsets
from .tolerance import fixed_relative_error
from .tracer import BatchResult, OutputBuffers, Paths, RayTracer

if TYPE_CHECKING:
    from .job import RenderJob, RenderResult


@dataclass
class Pairs:
    """Paths of stretches of rays, in double precision.

    Attributes
    ----------
    emission : array, shape (n, channel)
    transparency : array, shape (n, channel or 1)
    error : array, shape (n, 3) or (n, 0)
        Error of b, error of θ, and brightness of b; empty without error control.
    """

    emission: np.ndarray
    transparency: np.ndarray
    error: np.ndarray

    def over(self, back: Pairs) -> Pairs:
        """Return each pair in front of one of the others, as `schemes.path.over` does."""
        return Pairs(
            self.emission + self.transparency * back.emission,
            self.transparency * back.transparency,
            self._errors(back) if self.error.size else self.error,
        )

    def _errors(self, back: Pairs) -> np.ndarray:
        wrong, dim, bright = self.error.T
        wrong_back, dim_back, bright_back = back.error.T
        through = self.transparency.max(axis=1)
        error = [
            wrong + through * wrong_back + dim * bright_back,
            dim * back.transparency.max(axis=1) + through * dim_back,
            bright + through * bright_back,
        ]
        return np.stack(error, axis=1)

    def some(self, index: Int) -> Pairs:
        return Pairs(*(part.take(index, axis=0) for part in self.parts))

    @property
    def parts(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return self.emission, self.transparency, self.error

    @classmethod
    def mean(cls, found: list[Pairs]) -> Pairs:
        if len(found) == 1:
            return found[0]
        return cls(
            *(np.mean(parts, axis=0) for parts in zip(*(one.parts for one in found), strict=True))
        )


def fold(pairs: Pairs, count: np.ndarray) -> Pairs:
    """Return one pair per group: its composition, the first pair in front.

    Composition is associative: each round joins neighbours, so there are few rounds even with many
    pairs per pixel.
    """
    count = np.asarray(count)
    several = np.flatnonzero(count > 1)
    if not len(several):
        return pairs
    start = np.cumsum(count) - count
    found = pairs.some(start)
    more = np.repeat(count > 1, count)
    joined = _joined(pairs.some(np.flatnonzero(more)), count[several])
    for part, whole in zip(found.parts, joined.parts, strict=True):
        part[several] = whole
    return found


def _joined(pairs: Pairs, count: np.ndarray) -> Pairs:
    while np.any(count > 1):
        start = np.cumsum(count) - count
        place = np.arange(int(count.sum())) - np.repeat(start, count)
        front = place % 2 == 0
        alone = front & (place == np.repeat(count, count) - 1)
        joined = pairs.some(np.flatnonzero(front))
        partner = np.flatnonzero(front & ~alone)
        where = np.flatnonzero(~alone[front])
        both = pairs.some(partner).over(pairs.some(partner + 1))
        for part, whole in zip(joined.parts, both.parts, strict=True):
            part[where] = whole
        pairs, count = joined, (count + 1) // 2
    return pairs


def with_channels(values: np.ndarray, channels: int, fill: float) -> np.ndarray:
    """Return values (…, own) with one entry per channel, or one entry for all channels."""
    own = values.shape[-1]
    if own == 1 or own == channels:
        return values
    more = np.full((*values.shape[:-1], channels - own), fill, values.dtype)
    return np.concatenate([values, more], axis=-1)


class Stretches(RayTracer):
    """Traces a job's rays between given depths.

    Parameters
    ----------
    brightest_background : float
        Upper bound of the intensity behind a stretch; rays must not stop before its attenuation is
        determined.
    """

    def __init__(self, job: RenderJob, source: Any, brightest_background: float) -> None:
        super().__init__(job, source, brightest_background)
        if job.radmc3d_steps:
            self.walk = job.volume.grid.walk(job.backend, "cells")

    def up_to(
        self,
        layers: Layers,
        order: np.ndarray,
        first: np.ndarray,
        offsets: list[tuple[float, float]],
    ) -> list[Pairs]:
        """Return the stretches in front of layers: from the observer, or from the previous layer.

        Rays are traced in the order of `layers`, where neighbours cross the same cells.
        """
        before = np.roll(layers.depth.take(order), 1)
        before[first] = -np.inf
        begin = np.empty_like(before)
        begin[order] = before
        du, dv = (np.repeat(d, len(order)) for d in np.transpose(offsets))
        rays, begin, end = (np.tile(a, len(offsets)) for a in (layers.pixel, begin, layers.depth))
        found = self.between(rays, du, dv, begin, end, layers.emission.shape[1])
        return [found.some(order + k * len(order)) for k in range(len(offsets))]

    def to(self, pixel: np.ndarray, du: np.ndarray, dv: np.ndarray, depth: np.ndarray) -> Pairs:
        """Return the stretches from the observer to given depths."""
        begin = np.full(len(pixel), -np.inf)
        return self.between(pixel, du, dv, begin, depth, self.job.medium.channels)

    def between(
        self,
        pixel: np.ndarray,
        du: np.ndarray,
        dv: np.ndarray,
        begin: np.ndarray,
        end: np.ndarray,
        channels: int,
    ) -> Pairs:
        """Return the pairs of rays between two depths each, as intensities of all channels."""
        gathered = OutputBuffers(self, len(pixel))
        for first in range(0, len(pixel), self.batch):
            part = slice(first, first + self.batch)
            lanes = self._lanes(pixel[part], du[part], dv[part])
            ray = self._confined(self._ray(lanes), begin[part], end[part])
            state = self._followed(ray)
            found = BatchResult(state.path, state.cursor.inside, lanes)
            found.write(gathered.rows, first)
        return self._pairs(gathered.paths(), channels)

    def _confined(self, ray: Ray, begin: np.ndarray, end: np.ndarray) -> Ray:
        """Return rays limited to depths, which count from the observer in either ray direction."""
        lanes = dr.width(ray.active)
        first, last = (from_host(self.backend.Wide, np.resize(d, lanes)) for d in (begin, end))
        if self.job.backward:
            first, last = -last, -first
        if ray.first is not None:
            first = dr.select(ray.first > first, ray.first, first)
        if ray.last is not None:
            last = dr.select(ray.last < last, ray.last, last)
        return replace(ray, first=first, last=last)

    def _pairs(self, paths: Paths, channels: int) -> Pairs:
        numbers = self.source.numbers
        emission = numbers.mix(paths.emission).astype(np.float64)
        transparency = with_channels(_columns(paths.transparency), channels, 1.0)
        error = np.empty((len(emission), 0))
        if paths.error:
            error = _columns(paths.error)
            error[:, ::2] *= numbers.unit
        if emission.shape[1] < channels:
            emission = np.pad(emission, ((0, 0), (0, channels - emission.shape[1])))
        return Pairs(emission, transparency, error)


def _columns(rows: list[np.ndarray]) -> np.ndarray:
    return np.stack(rows, axis=-1).astype(np.float64)


# Rays per side of a pixel where the picture itself is sampled adaptively.
_SAMPLES = 4
# Stretches traced at once, of several rays per pixel.
_TOGETHER = 1 << 20


@dataclass
class Groups:
    """Layers grouped by pixel, the nearest first.

    Attributes
    ----------
    order : int array, shape (n,)
        Indices of layers, group after group.
    pixel : int array, shape (groups,)
        Flat indices of pixels, each once.
    count : int array, shape (groups,)
        Number of layers per group.
    """

    order: np.ndarray
    pixel: np.ndarray
    count: np.ndarray

    @classmethod
    def of(cls, layers: Layers, pixels: int) -> Groups:
        """Return the groups of layers in a picture with a number of pixels."""
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


def lay(planes: RenderResult, layers: Layers, tracer: Stretches) -> None:
    """Composite layers at their depths into the pixels that they cover."""
    if not len(layers.pixel):
        return
    groups, job = Groups.of(layers, planes.emission[..., 0].size), tracer.job
    placed = layers.some(groups.order)
    offsets = subpixel_offsets(_SAMPLES if job.adaptive or job.recursive else job.samples)
    together = max(1, _TOGETHER // len(layers.pixel))
    found = [
        _folded(placed, groups.count, ways)
        for first in range(0, len(offsets), together)
        for ways in tracer.up_to(layers, groups.order, groups.first, offsets[first:][:together])
    ]
    shown, bare = (Pairs.mean(list(parts)) for parts in zip(*found, strict=True))
    through = np.multiply.reduceat(1.0 - placed.opacity, groups.first)
    _put(planes, groups.pixel, shown, bare, through, tracer)
    if job.adaptive and planes.error is not None:
        planes.error.reshape(-1)[groups.pixel] += _scatter(found, through)


def _scatter(found: list[tuple[Pairs, Pairs]], through: np.ndarray) -> np.ndarray:
    """Return the error of means over the rays of a pixel, due to edges of layers."""
    seen = [shown.emission - through[:, None] * bare.emission for shown, bare in found]
    low, high = (functools.reduce(extreme, seen) for extreme in (np.minimum, np.maximum))
    return left_of_edges((high - low).max(axis=1), len(found))


def _folded(placed: Layers, count: np.ndarray, ways: Pairs) -> tuple[Pairs, Pairs]:
    """Return each pixel's path up to its last layer, with layers and without.

    The errors of the first contain only the light of layers, due to its uncertain attenuation.
    """
    dim, bright = np.zeros_like(ways.error), np.zeros_like(ways.error)
    dim[:, 1:2] = ways.error[:, 1:2]
    bright[:, 2:] = np.abs(placed.emission).max(axis=1, keepdims=True)
    pairs = Pairs(placed.emission, (1.0 - placed.opacity)[:, None], bright)
    lit = Pairs(ways.emission, ways.transparency, dim).over(pairs)
    return fold(lit, count), fold(ways, count)


def _put(
    planes: RenderResult,
    pixel: np.ndarray,
    shown: Pairs,
    bare: Pairs,
    through: np.ndarray,
    tracer: Stretches,
) -> None:
    """Composite layers in front of the attenuated rest of the pixels.

    Every stretch in front of a layer has a weight of at most 1 - `through`, and so do its errors.
    The error of the attenuation of layers' light is added.
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
        lost = wrong + fixed_relative_error(tracer) * bright
        if tracer.job.scheme.controlled:
            lost += tracer.source.neglected * tracer.source.numbers.unit
        error = planes.error.reshape(-1)
        error[pixel] = (1.0 - through) * lost + through * error.take(pixel) + shown.error[:, 0]
        planes.error = error.reshape(ny, nx)
