"""One render: its rays in batches of pixels, marched and gathered into planes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..backend import dr
from ..backend.functions import flush_subnormal
from ..volume import Volume
from .march import Cutoff, march
from .options import DEFAULT_ERROR
from .path import Path, empty_path
from .pixels import BLOCK, PixelOrder, subpixel_offsets
from .source import get_source

# Cells crossed per kernel launch, at most: a fraction of a second, so that Ctrl-C is heard.
_STEPS_PER_BATCH = 5e7


@dataclass
class Planes:
    """The pixels' paths as NumPy arrays (ny, nx, channel or 1), and whether rays stopped early."""

    emission: np.ndarray
    transparency: np.ndarray
    depth: np.ndarray
    stopped: bool


@dataclass
class Job:
    """Everything one render is made of."""

    volume: Volume
    medium: Any
    camera: Any
    frame: Any
    scheme: Any
    backend: Any
    backward: bool
    cutoff: float | None
    progress: Callable[[int, int], None]
    samples: int = 1
    done: int = 0

    def __post_init__(self) -> None:
        """Turn the loop where positions are reckoned: RADMC-3D's rays run towards the observer."""
        self.backward |= self.reckoned

    @property
    def reckoned(self) -> bool:
        """True if the last bits of positions matter, and there are bits to spare."""
        double = self.backend.precision == "double"
        return bool(self.scheme.reckoned and double and self.camera.parallel)

    def run(self, brightest_background: float) -> Planes:
        """Render all batches of pixels."""
        backend, order = self.backend, PixelOrder(self.frame.pixels)
        lanes = order.lanes
        per_lane = float(sum(self.volume.grid.shape))
        steps = lanes * self.samples**2 * per_lane
        source = get_source(
            self.volume, self.medium, self.scheme, backend, steps, self._classifying
        )
        walk = self.volume.grid.walk(backend, reckoned=self.reckoned)
        ending = self._ending(source, brightest_background)
        nx, ny = self.frame.pixels
        planes = [dr.zeros(backend.Float, nx * ny) for _ in range(self._numbers(source))]
        batch = max(1, int(_STEPS_PER_BATCH / per_lane) // BLOCK**2) * BLOCK**2
        stopped = False
        for first in range(0, lanes, batch):
            lane = dr.arange(backend.UInt, min(batch, lanes - first))
            lane += dr.opaque(backend.UInt, first)
            x, y, there = order.pixel(lane, backend)
            path, early = self._pixels(walk, source, ending, (x, y, there), lanes)
            numbers = path.emission + path.transparency + path.depth
            target = y * dr.opaque(backend.UInt, nx) + x
            for plane, number in zip(planes, numbers, strict=True):
                # Sums so small may have lost subnormal terms: with how many threads, decides.
                dr.scatter(plane, flush_subnormal(number, margin=2.0**36), target, there)
            dr.eval(planes, early)
            stopped |= bool(dr.any(early)) if ending is not None else False
            if self.samples == 1:
                self._advance(batch, lanes)
        return self._gathered(planes, source, stopped)

    def _pixels(
        self,
        walk: Any,
        source: Any,
        ending: Cutoff | None,
        pixels: tuple[Any, Any, Any],
        lanes: int,
    ) -> tuple[Path, Any]:
        """Return the mean paths of some pixels, over their sub-pixels."""
        backend, (x, y, there) = self.backend, pixels
        total, early = None, backend.Bool(False)
        for offset in subpixel_offsets(self.samples):
            ray = self._ray(x, y, offset, there)
            path = empty_path(backend.Float, source.numbers.emissions, source.numbers.extinctions)
            path, stopped = march(walk, source, self.scheme, ray, path, ending, self.backward)
            early |= stopped
            if self.samples == 1:
                return path, early
            total = path if total is None else _sum(total, path)
            dr.eval(total, early)  # one kernel per sub-pixel, the same one each time
            self._advance(len(x), lanes)
        return _scaled(total, 1.0 / self.samples**2), early

    def _ray(self, x: Any, y: Any, offset: tuple[float, float], there: Any) -> Any:
        """Return the rays through sub-pixels; lanes that are no pixels have none."""
        wide = self.backend.wide
        (nx, ny), (dx, dy), shift = self.frame.pixels, self.frame.pixel, self.frame.shift
        u, v = (
            dr.fma(self.backend.Wide(i) + wide(o - 0.5 * (n - 1)), wide(step), wide(s))
            for i, o, n, step, s in zip((x, y), offset, (nx, ny), (dx, dy), shift, strict=True)
        )
        vectors = [[wide(c) for c in vector] for vector in self.frame.vectors]
        ray = self.camera.rays(vectors, u, v)
        ray.active = there
        return reverse(ray) if self.backward else ray

    def _ending(self, source: Any, brightest_background: float) -> Cutoff | None:
        """Return the criterion at which rays stop; None if they never do."""
        if self.backward or self.cutoff == 0.0:
            return None
        opaque = self.backend.opaque
        if self.cutoff is not None:
            return Cutoff(opaque(1.0), [], opaque(self.cutoff))
        bounds = self.volume.grid.bounds
        diagonal = float(np.linalg.norm(bounds[:, 1] - bounds[:, 0])) / self.volume.grid.scale
        most = source.numbers.brightest(source.largest) * diagonal
        most += brightest_background / source.numbers.unit
        most = min(most, float(np.finfo(self.backend.dtype).max))  # no bound: rays hardly stop
        weights = [opaque(DEFAULT_ERROR * float(w)) for w in source.numbers.weights()]
        return Cutoff(opaque(most), weights, opaque(0.0))

    def _advance(self, rays: int, lanes: int) -> None:
        """Wait for rays and report them; an interrupt is heard here."""
        dr.sync_thread()
        total = lanes * self.samples**2
        self.done = min(self.done + rays, total)
        self.progress(self.done, total)

    def _classifying(self, done: int, total: int) -> None:
        """Progress of classification: reported as work not begun."""
        self.progress(0, 1)

    def _numbers(self, source: Any) -> int:
        return int(source.numbers.emissions + 2 * source.numbers.extinctions)

    def _gathered(self, planes: list[Any], source: Any, stopped: bool) -> Planes:
        nx, ny = self.frame.pixels
        arrays = [np.asarray(plane).reshape(ny, nx) for plane in planes]
        c, e = source.numbers.emissions, source.numbers.extinctions
        return Planes(
            source.numbers.mix(arrays[:c]),
            np.stack(arrays[c : c + e], axis=-1),
            np.stack(arrays[c + e :], axis=-1),
            stopped,
        )


def reverse(ray: Any) -> Any:
    """Return rays that run the other way, towards the camera."""
    last = None if ray.first is None else -ray.first
    first = None if ray.last is None else -ray.last
    away = [-d for d in ray.direction]
    return replace(ray, direction=away, first=first, last=last)


def _sum(a: Path, b: Path) -> Path:
    return Path(
        [p + q for p, q in zip(a.emission, b.emission, strict=True)],
        [p + q for p, q in zip(a.transparency, b.transparency, strict=True)],
        [p + q for p, q in zip(a.depth, b.depth, strict=True)],
    )


def _scaled(path: Any, factor: float) -> Path:
    return Path(
        [v * factor for v in path.emission],
        [v * factor for v in path.transparency],
        [v * factor for v in path.depth],
    )
