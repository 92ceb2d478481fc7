"""Rays in stretches: between two depths each."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ...backend import dr, from_host
from ...grids.contract import Ray
from ...objects.contract import Layers
from ..rays.drawing import Drawing, Gathered
from ..rays.found import Found
from ..rays.paths import Paths
from .pairs import Pairs, with_channels

if TYPE_CHECKING:
    from ..job import Job


class Stretches(Drawing):
    """A job's rays, confined to parts of their way.

    Parameters
    ----------
    brightest_background : float
        The brightest thing that may be behind a stretch: rays must not stop before they know how
        much of it comes through.
    """

    def __init__(self, job: Job, source: Any, brightest_background: float) -> None:
        super().__init__(job, source, brightest_background)
        if job.reckoned:  # these begin outside of the domain, whatever they are told
            self.walk = job.volume.grid.walk(job.backend, "cells")

    def up_to(
        self,
        layers: Layers,
        order: np.ndarray,
        first: np.ndarray,
        offsets: list[tuple[float, float]],
    ) -> list[Pairs]:
        """Return the stretches in front of layers: from the observer, or from the layer before.

        Rays are followed in the order of `layers`, where neighbours cross the same cells.

        Parameters
        ----------
        order : array of int
            The order of the result: layers of one pixel after one another, the nearest first.
        first : array of int
            Where in that order a pixel's first one is.
        offsets : list of (float, float)
            Where in pixels rays go through, from their centres: each gives stretches of its own.
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
        """Return the stretches from the observer to depths."""
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
        """Return the pairs of rays between two depths each, in intensities of all channels."""
        gathered = Gathered(self, len(pixel))
        for first in range(0, len(pixel), self.batch):
            part = slice(first, first + self.batch)
            lanes = self._lanes(pixel[part], du[part], dv[part])
            ray = self._confined(self._ray(lanes), begin[part], end[part])
            state = self._followed(ray)
            found = Found(state.path, state.cursor.inside, lanes)
            found.write(gathered.rows, first)
        return self._pairs(gathered.paths(), channels)

    def _confined(self, ray: Ray, begin: np.ndarray, end: np.ndarray) -> Ray:
        """Return rays between depths, which count from the observer whichever way they run."""
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
