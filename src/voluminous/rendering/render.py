"""render(): from a volume, a medium and a camera to an image."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ..backend import dr
import numpy as np

from ..backend import get_backend
from ..errors import InputError
from ..image import Image
from ..media.contract import Medium
from ..schemes import get_scheme
from ..units import unit_name
from ..volume import Volume
from .march import Cutoff, march
from .options import DEFAULT_ERROR, background_array, check_cutoff, check_order, sample_count
from .path import Path, empty_path
from .pixels import BLOCK, PixelOrder, subpixel_offsets
from .source import get_source

# Cells crossed per kernel launch, at most: a fraction of a second, so that Ctrl-C is heard.
_STEPS_PER_BATCH = 5e7


def render(
    volume: Volume,
    medium: Medium,
    camera: Any,
    *,
    scheme: Any = "second-order",
    background: Any = 0.0,
    precision: str = "single",
    device: str = "auto",
    order: str = "front-to-back",
    cutoff: float | None = None,
    samples: Any = 1,
    progress: Callable[[int, int], None] | None = None,
) -> Image:
    """Solve the transfer equation along every ray of a camera.

    Parameters
    ----------
    volume : Volume
        Grid and fields.
    medium : Medium
        From field values to emissivity and extinction.
    camera : Orthographic or Perspective
        Which rays.
    scheme : {"second-order", "first-order", "olson-kunasz"}
        How one segment is solved; see the page on schemes.
    background : float, sequence of float, array (ny, nx[, channel]) or Image
        Intensity behind everything.
    precision : {"single", "double"}
        Floating-point precision. Where single cannot tell the grid's cells apart, double is taken.
    device : {"auto", "cpu", "cuda", "metal"}
        Where to compute.
    order : {"front-to-back", "back-to-front"}
        The direction in which rays are folded; the result is the same to rounding.
    cutoff : float, optional
        Transparency at which a ray stops; 0 turns it off. By default a ray stops where all that
        may still come is below 1e-4 of what it has gathered, so the error is below 1e-4 of the
        image's maximum.
    samples : int or "flux-conserving"
        n for n × n rays per pixel, at the centres of equal parts; or RADMC-3D's recursive sub-pixels.
    progress : callable, optional
        Called as ``progress(done, total)`` now and then; may raise to cancel.

    Returns
    -------
    Image
        Intensity (ny, nx, channel), transparency and optical depth.

    Raises
    ------
    InputError
        For anything that cannot be rendered; a ValueError.
    UnknownNameError
        For a field, scheme, order, … that does not exist; a KeyError.
    MemoryNeededError
        If it does not fit into memory, before any is taken.
    """
    _check_types(volume, medium, camera)
    if precision == "single" and volume.grid.needs_double():
        precision = "double"
    job = _Job(
        volume=volume,
        medium=medium,
        camera=camera,
        frame=camera.frame(volume.grid),
        scheme=get_scheme(scheme),
        backend=get_backend(device, precision),
        backward=check_order(order),
        cutoff=check_cutoff(cutoff),
        progress=progress or _silent,
    )
    job.samples = sample_count(samples, job.frame, volume.grid)
    behind = background_array(background, job.frame.pixels, medium.channels)
    planes = job.run(float(np.max(np.abs(behind))))
    return _image(job, planes, behind, {"samples": samples, "order": order})


@dataclass
class _Planes:
    """The pixels' paths as NumPy arrays (ny, nx, channel or 1), and whether rays stopped early."""

    emission: np.ndarray
    transparency: np.ndarray
    depth: np.ndarray
    stopped: bool


@dataclass
class _Job:
    """Everything one render is made of."""

    volume: Volume
    medium: Medium
    camera: Any
    frame: Any
    scheme: Any
    backend: Any
    backward: bool
    cutoff: float | None
    progress: Callable[[int, int], None]
    samples: int = 1

    def run(self, brightest_background: float) -> _Planes:
        """Render all batches of pixels."""
        backend, order = self.backend, PixelOrder(self.frame.pixels)
        lanes = order.lanes
        per_lane = float(sum(self.volume.grid.shape))
        steps = lanes * self.samples**2 * per_lane
        source = get_source(
            self.volume, self.medium, self.scheme, backend, steps, self._classifying
        )
        walk = self.volume.grid.walk(backend)
        ending = self._ending(source, brightest_background)
        nx, ny = self.frame.pixels
        planes = [dr.zeros(backend.Float, nx * ny) for _ in range(self._numbers(source))]
        batch = max(1, int(_STEPS_PER_BATCH / per_lane) // BLOCK**2) * BLOCK**2
        stopped = False
        for first in range(0, lanes, batch):
            lane = dr.arange(backend.UInt, min(batch, lanes - first))
            lane += dr.opaque(backend.UInt, first)
            x, y, there = order.pixel(lane, backend)
            path, early = self._pixels(walk, source, ending, x, y, there)
            numbers = path.emission + path.transparency + path.depth
            target = y * dr.opaque(backend.UInt, nx) + x
            for plane, number in zip(planes, numbers, strict=True):
                dr.scatter(plane, number, target, there)
            dr.eval(planes, early)
            stopped |= bool(dr.any(early)) if ending is not None else False
            self.progress(min(first + batch, lanes), lanes)
        return self._gathered(planes, source, stopped)

    def _pixels(
        self, walk: Any, source: Any, ending: Cutoff | None, x: Any, y: Any, there: Any
    ) -> tuple[Path, Any]:
        """Return the mean paths of some pixels, over their sub-pixels."""
        backend = self.backend
        total, early = None, backend.Bool(False)
        for offset in subpixel_offsets(self.samples):
            ray = self._ray(x, y, offset, there)
            path = empty_path(backend.Float, source.channels, source.extinctions)
            path, stopped = march(
                walk, source, self.scheme, ray, path, ending, self.backward
            )
            early |= stopped
            if self.samples == 1:
                return path, early
            total = path if total is None else _sum(total, path)
            dr.eval(total, early)  # one kernel per sub-pixel, the same one each time
        return _scaled(total, 1.0 / self.samples**2), early

    def _ray(self, x: Any, y: Any, offset: tuple[float, float], there: Any) -> Any:
        """Return the rays through sub-pixels; lanes that are no pixels get rays that miss."""
        wide = self.backend.wide
        (nx, ny), (dx, dy), shift = self.frame.pixels, self.frame.pixel, self.frame.shift
        u, v = (
            dr.fma(self.backend.Wide(i) + wide(o - 0.5 * (n - 1)), wide(step), wide(s))
            for i, o, n, step, s in zip((x, y), offset, (nx, ny), (dx, dy), shift, strict=True)
        )
        vectors = [[wide(c) for c in vector] for vector in self.frame.vectors]
        ray = self.camera.rays(vectors, u, v)
        if self.backward:
            ray = reverse(ray)
        return ray

    def _ending(self, source: Any, brightest_background: float) -> Cutoff | None:
        """Return the criterion at which rays stop; None if they never do."""
        if self.backward or self.cutoff == 0.0:
            return None
        opaque = self.backend.opaque
        if self.cutoff is not None:
            return Cutoff(opaque(1.0), opaque(0.0), opaque(self.cutoff))
        bounds = self.volume.grid.bounds
        diagonal = float(np.linalg.norm(bounds[:, 1] - bounds[:, 0])) / self.volume.grid.scale
        most = max(source.largest) * diagonal + brightest_background
        most = min(most, float(np.finfo(self.backend.dtype).max))
        # The sum over channels is at most so many times their maximum.
        return Cutoff(opaque(most), opaque(DEFAULT_ERROR / source.channels), opaque(0.0))

    def _classifying(self, done: int, total: int) -> None:
        """Progress of classification: reported as work not begun."""
        self.progress(0, 1)

    def _numbers(self, source: Any) -> int:
        return source.channels + 2 * source.extinctions

    def _gathered(self, planes: list[Any], source: Any, stopped: bool) -> _Planes:
        nx, ny = self.frame.pixels
        arrays = [np.asarray(plane).reshape(ny, nx) for plane in planes]
        c, e = source.channels, source.extinctions
        parts = (arrays[:c], arrays[c : c + e], arrays[c + e :])
        return _Planes(*(np.stack(part, axis=-1) for part in parts), stopped)


def reverse(ray: Any) -> Any:
    """Return rays that run the other way, towards the camera."""
    from ..grids.contract import Ray

    last = None if ray.first is None else -ray.first
    first = None if ray.last is None else -ray.last
    return Ray(ray.origin, [-d for d in ray.direction], first, last)


def _image(job: _Job, planes: _Planes, behind: np.ndarray, told: dict[str, Any]) -> Image:
    if not np.all(np.isfinite(planes.emission)) or not np.all(np.isfinite(planes.depth)):
        raise InputError(
            "the picture is not finite: the medium gives coefficients that are not, or a negative "
            "extinction, in cells that rays visit; look at the fields with `volume.evaluate(...)`"
        )
    kind = job.backend.dtype
    intensity = planes.emission
    if np.any(behind):
        intensity = (intensity + planes.transparency * behind).astype(kind)
    x, y = job.frame.coordinates()
    return Image(
        intensity,
        transparency=planes.transparency,
        optical_depth=_full_depth(job) if planes.stopped else planes.depth,
        x=x,
        y=y,
        unit=job.camera.plane_unit or unit_name(job.volume.unit),
        camera=job.camera.describe(),
        provenance=_provenance(job, told),
    )


def _full_depth(job: _Job) -> Callable[[], np.ndarray]:
    """Return what computes the optical depth through everything, for rays that stopped early."""

    def compute() -> np.ndarray:
        job.cutoff, job.progress = 0.0, _silent
        return job.run(0.0).depth

    return compute


def _provenance(job: _Job, told: dict[str, Any]) -> dict[str, Any]:
    from .. import __version__

    return {
        "software": f"voluminous {__version__}",
        "scheme": job.scheme.name,
        "precision": job.backend.precision,
        "device": job.backend.device,
        "medium": job.medium.describe(),
        "volume": job.volume.describe(),
        **told,
    }


def _check_types(volume: Any, medium: Any, camera: Any) -> None:
    if not isinstance(volume, Volume):
        raise InputError(f"render needs a vm.Volume first, got {type(volume).__name__}")
    if not isinstance(medium, Medium):
        raise InputError(
            f"render needs a medium (vm.Gaussian, vm.Table, …) second, got {type(medium).__name__}"
        )
    if not hasattr(camera, "frame") or not hasattr(camera, "rays"):
        raise InputError(
            f"render needs a camera (vm.Orthographic, vm.Perspective), got {type(camera).__name__}"
        )


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


def _silent(done: int, total: int) -> None:
    """Report nothing."""
