"""Composites layers (objects) into pixels: rays are traced again, but only up to the layers.

Let a ray gather E and dim by θ up to a layer (b, t), and let E∞ be the emission along the whole
ray. Then the pixel is ``E + θ b + t (E∞ - E)``: a mean of the ray that ends at the layer and the
one that does not. The part behind the layer needs no second solution, and an invisible layer
changes nothing.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from ..objects.contract import Layers
from .antialias import error_at_edges
from .pixels import subpixel_offsets
from .run import RenderResult
from .tolerance import fixed_relative_error
from .tracer import RayTracer

# Rays per side of a pixel where the picture itself is sampled adaptively.
_SAMPLES = 4
# Stretches traced at once, of several rays per pixel.
_TOGETHER = 1 << 20


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
        error = self.error
        if error.size:
            wrong, dim, bright = self.error.T
            wrong_back, dim_back, bright_back = back.error.T
            through = self.transparency.max(axis=1)
            error = np.stack(
                [
                    wrong + through * wrong_back + dim * bright_back,
                    dim * back.transparency.max(axis=1) + through * dim_back,
                    bright + through * bright_back,
                ],
                axis=1,
            )
        emission = self.emission + self.transparency * back.emission
        return Pairs(emission, self.transparency * back.transparency, error)

    @property
    def parts(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return self.emission, self.transparency, self.error

    def some(self, index: np.ndarray) -> Pairs:
        return Pairs(*(part.take(index, axis=0) for part in self.parts))

    @classmethod
    def mean(cls, pairs: tuple[Pairs, ...]) -> Pairs:
        if len(pairs) == 1:
            return pairs[0]
        parts = zip(*(one.parts for one in pairs), strict=True)
        return cls(*(np.mean(part, axis=0) for part in parts))


def fold(pairs: Pairs, count: np.ndarray) -> Pairs:
    """Return one pair per group: its composition, the first pair in front.

    Composition is associative: each round joins neighbours, in place, so there are few rounds even
    with many pairs per pixel.
    """
    start = np.cumsum(count) - count
    place = np.arange(len(pairs.emission)) - np.repeat(start, count)
    left, stride = np.repeat(count, count) - place, 1
    while len(front := np.flatnonzero((left > stride) & (place % (2 * stride) == 0))):
        joined = pairs.some(front).over(pairs.some(front + stride))
        for part, values in zip(pairs.parts, joined.parts, strict=True):
            part[front] = values
        stride *= 2
    return pairs.some(start)


def with_channels(values: np.ndarray, channels: int, fill: float) -> np.ndarray:
    """Return values (…, n) with one entry per channel, or one entry for all channels."""
    count = values.shape[-1]
    if count in (1, channels):
        return values
    more = np.full((*values.shape[:-1], channels - count), fill, values.dtype)
    return np.concatenate([values, more], axis=-1)


def between(
    tracer: RayTracer,
    pixel: np.ndarray,
    du: np.ndarray,
    dv: np.ndarray,
    depths: tuple[np.ndarray, np.ndarray],
    channels: int,
) -> Pairs:
    """Return the pairs of rays between two depths each, as intensities of all channels."""
    paths, source = tracer.rays(pixel, du, dv, depths), tracer.source
    emission = source.channels.intensity(paths.emission).astype(np.float64)
    if emission.shape[1] < channels:
        emission = np.pad(emission, ((0, 0), (0, channels - emission.shape[1])))
    through = with_channels(_columns(paths.transparency), channels, 1.0)
    error = np.empty((len(emission), 0))
    if paths.error:
        error = _columns(paths.error)
        error[:, ::2] *= source.channels.error_unit
    return Pairs(emission, through, error)


def _columns(rows: list[np.ndarray]) -> np.ndarray:
    return np.stack(rows, axis=-1).astype(np.float64)


def lay(planes: RenderResult, layers: Layers, tracer: RayTracer) -> None:
    """Composite layers at their depths into the pixels that they cover.

    The error of the attenuation of layers' light is added. Every stretch in front of a layer has a
    weight of at most the layers' opacity, and so do its errors.
    """
    if not len(layers.pixel):
        return
    job, (ny, nx, channels) = tracer.job, planes.emission.shape
    order, pixel, count = _groups(layers, nx * ny)
    first, placed = np.cumsum(count) - count, layers.some(order)
    # Stretches begin at the observer, or at the previous layer. They are traced in the order of
    # `layers`, where neighbours cross the same cells.
    begin, before = np.empty_like(layers.depth), np.roll(placed.depth, 1)
    before[first] = -np.inf
    begin[order] = before
    offsets = subpixel_offsets(_SAMPLES if job.adaptive or job.recursive else job.samples)
    together, folded = max(1, _TOGETHER // len(order)), []
    for start in range(0, len(offsets), together):
        some = offsets[start : start + together]
        du, dv = (np.repeat(d, len(order)) for d in np.transpose(some))
        rays, low, high = (np.tile(a, len(some)) for a in (layers.pixel, begin, layers.depth))
        stretches = between(tracer, rays, du, dv, (low, high), channels)
        folded += [
            _folded(placed, count, stretches.some(order + k * len(order))) for k in range(len(some))
        ]
    shown, bare = (Pairs.mean(parts) for parts in zip(*folded, strict=True))
    through = np.multiply.reduceat(1.0 - placed.opacity, first)
    whole, clear = (p.reshape(nx * ny, -1) for p in (planes.emission, planes.transparency))
    light = whole.take(pixel, axis=0) - bare.emission
    light *= through[:, None]
    light += shown.emission
    for plane, values in zip(whole.T, light.T, strict=True):  # NumPy puts triples half as fast
        plane[pixel] = values
    for plane in clear.T:
        plane[pixel] *= through
    planes.emission = whole.reshape(ny, nx, -1)
    planes.transparency = clear.reshape(ny, nx, -1)
    if planes.error is None:
        return
    wrong, _, bright = bare.error.T
    lost = wrong + fixed_relative_error(tracer) * bright
    if job.controlled:
        channels, skipping = tracer.source.channels, tracer.source.skipping
        lost += skipping.neglected_emission * channels.heaviest * channels.error_unit
    error = planes.error.reshape(-1)
    error[pixel] = (1.0 - through) * lost + through * error.take(pixel) + shown.error[:, 0]
    if job.adaptive:  # edges of layers
        rays_light = [s.emission - through[:, None] * b.emission for s, b in folded]
        low, high = (functools.reduce(end, rays_light) for end in (np.minimum, np.maximum))
        error[pixel] += error_at_edges((high - low).max(axis=1), len(folded))
    planes.error = error.reshape(ny, nx)


def _groups(layers: Layers, pixels: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Group layers by pixel, the nearest first: their order, and pixel and size of each group."""
    occurs = np.bincount(layers.pixel, minlength=pixels)
    alone = occurs.take(layers.pixel) == 1  # most are: only the others need to be sorted
    single, several = np.flatnonzero(alone), np.flatnonzero(~alone)
    several = several[np.lexsort((layers.depth[several], layers.pixel[several]))]
    pixel, count = np.unique(layers.pixel[several], return_counts=True)
    return (
        np.concatenate([single, several]),
        np.concatenate([layers.pixel[single], pixel]),
        np.concatenate([np.ones(len(single), count.dtype), count]),
    )


def _folded(placed: Layers, count: np.ndarray, stretches: Pairs) -> tuple[Pairs, Pairs]:
    """Return each pixel's path up to its last layer, with layers and without.

    The errors of the first contain only the light of layers, due to its uncertain attenuation.
    """
    dim, bright = np.zeros_like(stretches.error), np.zeros_like(stretches.error)
    dim[:, 1:2] = stretches.error[:, 1:2]
    bright[:, 2:] = np.abs(placed.emission).max(axis=1, keepdims=True)
    pairs = Pairs(placed.emission, (1.0 - placed.opacity)[:, None], bright)
    lit = Pairs(stretches.emission, stretches.transparency, dim).over(pairs)
    return fold(lit, count), fold(stretches, count)
