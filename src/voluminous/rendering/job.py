"""One render: from its scene to the planes of an image."""

from __future__ import annotations

import functools
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..backend import Backend, dr
from ..media.contract import Medium
from ..packages import VERSION
from ..schemes.base import Scheme
from ..volume import Volume
from .antialias import FluxConserving, refine
from .cache import Cache
from .missing import HiddenCells
from .options import DEFAULT_ERROR
from .precision import sums_need_double
from .sources import get_source
from .sources.channel_layout import channels_last, in_units_of
from .tolerance import add_rounding_error, in_kernel_unit, render_to_tolerance, total_error
from .tracer import KernelCache, Paths, RayTracer, Traced, exhausted


@dataclass
class RenderResult:
    """The pixels' paths as NumPy arrays (ny, nx, channel or 1), and whether rays stopped early.

    Attributes
    ----------
    error : array, shape (ny, nx), or None
        Error of an intensity in its worst channel.
    tracer : RayTracer
        The tracer of the picture, for further rays.
    """

    emission: np.ndarray
    transparency: np.ndarray
    depth: np.ndarray
    error: np.ndarray | None
    stopped: bool
    tracer: RayTracer

    @functools.cached_property
    def brightest(self) -> float:
        """The largest emission; NaN if one is."""
        return float(self.emission.max())

    @functools.cached_property
    def faintest(self) -> float:
        """The smallest emission, which may be negative; NaN if one is."""
        return float(self.emission.min())

    @functools.cached_property
    def finite(self) -> bool:
        """Whether all results are finite; testing only their extremes takes a fifth of the time."""
        ends = self.brightest, self.faintest, float(self.depth.max()), float(self.depth.min())
        return bool(np.all(np.isfinite(ends)))

    @property
    def nothing(self) -> bool:
        """Whether nothing emits or absorbs."""
        through = self.transparency
        return self.brightest == self.faintest == 0.0 and through.min() == 1.0 == through.max()


@dataclass
class RenderJob:
    """Everything that defines one render.

    Attributes
    ----------
    cache : Cache
        Cache of results for the volume.
    hidden : HiddenCells, optional
        Cells that hold no value.
    """

    volume: Volume
    medium: Medium
    camera: Any
    frame: Any
    scheme: Scheme
    backend: Backend
    backward: bool
    cutoff: float | None
    tolerance: float
    progress: Callable[[int, int], None]
    cache: Cache
    hidden: HiddenCells | None = None
    samples: int = 1
    adaptive: bool = False
    recursive: bool = False
    done: int = 0
    _numbers: Any = None

    def __post_init__(self) -> None:
        """Reverse the loop with RADMC-3D's steps: its rays run towards the observer."""
        self.backward |= self.radmc3d_steps

    @property
    def radmc3d_steps(self) -> bool:
        """Whether rays take the sub-steps of RADMC-3D, on grids that have them."""
        return bool(self.scheme.radmc3d_steps) and "substeps" in self.volume.grid.walk_kinds

    @property
    def walk_kind(self) -> str:
        """The kind of walk through the grid that the scheme needs."""
        if self.scheme.coefficients_at == "field":
            return "dual"
        return "substeps" if self.radmc3d_steps else "cells"

    @property
    def early_error(self) -> float:
        """Error allowed where a ray stops early, as a fraction of the intensity gathered."""
        return min(DEFAULT_ERROR, 0.1 * self.tolerance) if self.scheme.controlled else DEFAULT_ERROR

    def drawn(self, kind: type[RayTracer]) -> tuple[Paths, Any]:
        """Trace with a custom ray tracer class; return its paths and the channel layout."""
        source = self._source()
        return kind(self, source, 0.0).frame(), source.numbers

    @property
    def steps(self) -> float:
        """Estimate of the number of cells that all rays cross."""
        nx, ny = self.frame.pixels
        return float(nx * ny) * self.samples**2 * self.volume.grid.cells_across

    def run(self, brightest_background: float) -> RenderResult:
        """Render all pixels.

        Double precision is used where single is not enough: in a quotient of two fields that vanish
        at the same place, rounding makes the denominator zero first on one ray in some thousand.
        """
        return exhausted(self._batches(brightest_background))

    def batches(
        self, seconds: float = 0.04, focus: tuple[float, float] | None = None
    ) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Render in batches of a given duration; to cancel, stop iterating.

        Yields
        ------
        pixel : array of int, shape (n,)
            Flat indices of the pixels that were traced; some may be traced again later.
        intensity : array, shape (n, channel)
        transparency : array, shape (n, channel or 1)

        Parameters
        ----------
        seconds : float
        focus : (float, float), optional
            The pixel around which to begin, the middle of the picture by default.
        """
        for batch in self._batches(0.0, seconds, focus):
            paths = batch.paths.some(batch.pixel)
            intensity = self._numbers.mix(paths.emission)
            yield batch.pixel, intensity, np.stack(paths.transparency, axis=-1)

    def _batches(
        self,
        brightest_background: float,
        seconds: float | None = None,
        focus: tuple[float, float] | None = None,
    ) -> Generator[Traced, None, RenderResult]:
        result = yield from self._run(brightest_background, seconds, focus)
        if not result.finite and self.backend.precision == "single" and self._has_double:
            self._take_double()
            result = yield from self._run(brightest_background, seconds, focus)
        return result

    def _run(
        self,
        brightest_background: float,
        seconds: float | None,
        focus: tuple[float, float] | None,
    ) -> Generator[Traced, None, RenderResult]:
        tracer = self._drawing(brightest_background)
        self._numbers = tracer.source.numbers
        if self.scheme.controlled:
            limits = self.tolerance, brightest_background, seconds, focus
            paths, enough = yield from render_to_tolerance(tracer, *limits)
            if not enough:  # everything visible is as faint as the skipped places
                tracer = self._drawing(brightest_background, faintest=True)
                paths, _ = yield from render_to_tolerance(tracer, *limits)
        else:
            paths = yield from tracer.batches(seconds, focus)
        if self.adaptive:
            refine(tracer, paths, self.tolerance)
        if self.scheme.controlled:
            add_rounding_error(tracer, paths)
        return self._planes(paths, tracer, brightest_background)

    def _drawing(self, brightest_background: float, *, faintest: bool = False) -> RayTracer:
        kind = FluxConserving if self.recursive else RayTracer
        tracer = kind(self, self._source(faintest), brightest_background)
        tracer.kernels = self._kernels(tracer, faintest)
        return tracer

    def _kernels(self, tracer: RayTracer, faintest: bool) -> KernelCache | None:
        """Return the cache of traced batches: the volume's, if all its dependencies have keys."""
        if self.backend.device != "cpu" or self.backend.derivatives:
            return None
        parts = self.medium.key(), self.camera.key(), self.scheme.key()
        if None in parts or not self.cache.statistics.is_hashed(self.medium.names):
            return KernelCache()
        source, ending = tracer.source, tracer.ending
        key = (
            "kernels",
            *parts,
            self.cache.statistics.digests(self.medium.names),
            (self.backend, self.backward, self.tolerance, faintest, self.hidden is None),
            (type(source), type(tracer.walk), None if ending is None else len(ending.weights)),
        )
        kernels: KernelCache = self.cache.get_or_make(key, KernelCache)
        return kernels

    def _source(self, faintest: bool = False) -> Any:
        source = self._make_source(faintest)
        single = self.backend.precision == "single"
        if single and sums_need_double(source.numbers, source.bounds):
            self._take_double()
            source = self._make_source(faintest)
        return source

    @property
    def _has_double(self) -> bool:
        return self.backend.device != "metal"

    def _take_double(self) -> None:
        self.backend, self.done = self.backend.with_precision("double"), 0
        self.__post_init__()  # the way rays are followed may be another now

    def _make_source(self, faintest: bool) -> Any:
        return get_source(
            self.volume,
            self.medium,
            self.scheme,
            self.backend,
            self.steps,
            self._classifying,
            self.tolerance,
            faintest,
            cache=self.cache,
            whole=self.hidden is None,
        )

    def provenance(self) -> dict[str, Any]:
        """Return the settings of the render, as plain values."""
        return {
            "software": f"voluminous {VERSION}",
            "scheme": self.scheme.name,
            "precision": self.backend.precision,
            "device": self.backend.device,
            "medium": self.medium.describe(),
            "volume": self.volume.describe(),
        }

    def advance(self, rays: int, lanes: int) -> None:
        """Wait for rays and report them; interrupts take effect here."""
        dr.sync_thread()
        total = lanes * self.samples**2
        self.done = min(self.done + rays, total)
        self.progress(self.done, total)

    def _classifying(self, done: int, total: int) -> None:
        self.progress(0, 1)

    def _planes(self, paths: Paths, tracer: RayTracer, brightest_background: float) -> RenderResult:
        (nx, ny), source = self.frame.pixels, tracer.source

        def stacked(rows: list[np.ndarray]) -> np.ndarray:
            return channels_last([row.reshape(ny, nx) for row in rows])

        error = None
        if paths.error:
            unit = source.numbers.unit
            error = in_units_of(
                unit, total_error(paths, in_kernel_unit(brightest_background, unit))
            )
            error = error.reshape(ny, nx)
        emission = source.numbers.mix([row.reshape(ny, nx) for row in paths.emission])
        return RenderResult(
            emission,
            stacked(paths.transparency),
            stacked(paths.depth),
            error,
            paths.stopped,
            tracer,
        )
