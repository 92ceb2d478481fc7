"""What drawing a picture chunk by chunk will take, before anything is read."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..calibration import calibrated
from ..calibration.open_numbers import in_plain_numbers
from ..cameras.contract import Camera, check_camera
from ..errors import InputError
from ..files import url_of
from ..grids.cartesian.grid import CartesianGrid
from ..media.bound import Binding
from ..media.contract import Medium
from ..media.ranges import RangeContext
from ..media.sum import with_each
from ..rendering.cache import Cache
from ..rendering.options import check_antialias, check_options, check_tolerance
from ..schemes import get_scheme
from ..schemes.base import Scheme, is_controlled
from ..units import is_count
from ..volume import Volume
from .chunks import CartesianChunks
from .levels import at_level
from .partition import check_drawn
from .sweep import Sweep
from .view import VolumeView

# Bytes of a program and its compiler.
_PROCESS = 150 << 20
# Part of the room that is left for chunks (`Chunks`).
_KEPT = 0.75
# Peaks below this part are not read: the schemes leave out more, or a little less.
_FAINTEST = {"first-order": 1e-37, "pre-integrated": 1e-8, "post-classified": 1e-8}


@dataclass(frozen=True)
class Plan:
    """What drawing a picture chunk by chunk will take; ``print(plan)`` tells it.

    Attributes
    ----------
    shape : tuple of int
        Cells of the level that is drawn.
    level : int
        0: all cells.
    pixels : (int, int)
    scheme : str
    chunks, visible : int
        Number of chunks, and of those that hold something visible and are in the picture.
    known : bool
        Whether the file tells the ranges of its chunks. If not, all count as visible.
    bytes_read, bytes_stored : int or None
        Of the fields in one pass through the chunks: unpacked, and in the file; None if unknown.
    bytes_whole : int
        Memory that the picture would take if it were not drawn in chunks, about.
    memory, memory_here : int
        Bytes that a process takes that draws, at most, and the one that waits (with workers).
    workers : int
    """

    shape: tuple[int, ...]
    level: int
    pixels: tuple[int, int]
    scheme: str
    chunks: int
    visible: int
    known: bool
    bytes_read: int
    bytes_stored: int | None
    bytes_whole: int
    memory: int
    memory_here: int
    workers: int

    def __str__(self) -> str:
        seen = "may be visible" if self.known else "(ranges are unknown: convert --stats)"
        stored = "" if self.bytes_stored is None else f", {_bytes(self.bytes_stored)} in the file"
        lines = [
            ("cells", f"{_by(self.shape)}, level {self.level}"),
            ("chunks", f"{self.chunks}, of which {self.visible} {seen}"),
            ("picture", f"{_by(self.pixels)} pixels, {self.scheme}"),
            ("bytes", f"{_bytes(self.bytes_read)} a pass{stored}"),
            ("memory", f"{_bytes(self.memory)} ({_bytes(self.bytes_whole)} without memory=)"),
        ]
        if self.workers > 1:
            lines[-1] = (
                "memory",
                f"{_bytes(self.memory)} in each of {self.workers} processes, "
                f"{_bytes(self.memory_here)} here",
            )
        return "\n".join(f"{name:8} {text}" for name, text in lines)


def plan(
    volume: Volume,
    medium: Medium,
    camera: Camera,
    *,
    workers: int = 1,
    memory: Any = None,
    scheme: Any = None,
    tolerance: float | None = 1e-3,
    samples: int = 1,
    level: Any = None,
    **options: Any,
) -> Plan:
    """Tell what drawing a picture chunk by chunk will take; nothing is read, nothing is drawn.

    Parameters
    ----------
    volume, medium, camera
        As in `render`.
    workers : int
        Processes of the executor; 1: drawn by this one.
    memory : str or int, optional
        As in `render`, by default ``"2 GiB"``: of each process.
    scheme, tolerance, samples, level
        As in `render`.
    **options
        Others of `render`, which do not matter here.

    Returns
    -------
    Plan

    Raises
    ------
    InputError
        For what cannot be drawn chunk by chunk.
    MemoryNeededError
        If the memory is too little for one chunk.

    Examples
    --------
    >>> import voluminous as vm
    >>> sphere = vm.models.sphere(64)
    >>> medium = vm.Gaussian("inside", 1, 0.1, "orange", opacity=0.5)
    >>> plan = vm.plan(sphere, medium, vm.Orthographic(60, 30, resolution=200), memory="500 MB")
    >>> plan.chunks, plan.bytes_read
    (1, 1048576)
    """
    check_options(options)
    if not is_count(workers, 1 << 31):
        raise InputError(f"workers is the number of processes, 1 or more, got {workers!r}")
    check_camera(camera, "plan")
    if not isinstance(getattr(volume, "grid", None), CartesianGrid):
        raise InputError(
            "plan counts the chunks of a vm.Volume on a Cartesian grid, got "
            f"{getattr(volume, 'grid', volume)!r}: draw it without a plan"
        )
    volume, medium, drawn = at_level(volume, medium, camera, 0 if level is None else level)
    check_drawn(volume, medium, options.get("bounds"))
    partition = CartesianChunks(_Sketch.of(volume), memory)
    if scheme is None:
        scheme = CartesianChunks.labels if medium.discrete else "post-classified"
    check_tolerance(tolerance)
    check_antialias(samples, None, camera)
    solver = get_scheme(scheme, controlled=tolerance is not None)
    partition.seen_by(camera, medium, solver)
    medium = _plain(medium, volume)
    frame = camera.frame(volume.grid)
    if workers > 1:
        partition.sweep = Sweep(None, None)  # smaller blocks
    partition.plan(medium, solver, frame.pixels)
    return _planned(partition, medium, solver, camera, drawn, workers, samples)


class _Sketch(VolumeView):
    """A view for which no file is read: ranges that are not stored are infinite."""

    def knows(self, name: str) -> bool:
        """Return whether the ranges of a field are known."""
        return bool(np.all(np.isfinite(self.extremes(name))))

    def _key(self, name: str) -> Any:
        return None

    def _measured(self, name: str, found: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        if name in self._whole.fields and self.in_memory(name) is not None:
            return super()._measured(name, found)
        return np.where(np.isfinite(found), found, (-np.inf, np.inf)), None


def _plain(medium: Medium, volume: Volume) -> Medium:
    """Return the medium in plain numbers; path lengths that are open do not matter here."""
    plain = with_each(
        in_plain_numbers(medium, volume),
        lambda p: p.changed(path_length=1.0) if isinstance(p.path_length, str) else p,
    )
    return calibrated(plain, volume, Cache(volume).measurements)


def _planned(
    partition: CartesianChunks,
    medium: Medium,
    scheme: Scheme,
    camera: Camera,
    level: int,
    workers: int,
    samples: int,
) -> Plan:
    volume, grid, frame = partition.volume, partition.grid, camera.frame(partition.grid)
    assert isinstance(volume, _Sketch)
    names = [name for name in medium.names if name in volume]
    bound, context = medium.bind(Binding.to(volume)), RangeContext(_FAINTEST[scheme.name])
    with np.errstate(all="ignore"):
        shown = bound.may_show(partition.ranges_of_chunks(medium.names), context)
    side = np.array(volume.store.chunks)
    low = np.indices(volume.chunk_counts).reshape(3, -1).T * side
    high = np.minimum(low + side, grid.shape)
    seen = np.broadcast_to(shown, volume.chunk_counts).reshape(-1)
    seen = seen & in_picture(camera, partition, low, high)
    cells = float(np.sum(np.prod(high - low, axis=1)[seen]))
    total = cells * sum(volume.dtype(name).itemsize for name in names)
    again = is_controlled(scheme) or samples > 1 or partition.dual
    held = min(_KEPT * partition.room, total) if again else 0.0
    stored = _stored(volume, names) if level == 0 else None
    block = partition.per_cell * math.prod(partition.side)
    return Plan(
        shape=grid.shape,
        level=level,
        pixels=frame.pixels,
        scheme=scheme.name,
        chunks=seen.size,
        visible=int(seen.sum()),
        known=all(volume.knows(name) for name in names),
        bytes_read=int(total),
        bytes_stored=None if stored is None else int(stored * seen.mean()),
        bytes_whole=int(partition.others + partition.per_cell * grid.size) + _PROCESS,
        memory=int(partition.others + block + held) + _PROCESS,
        memory_here=partition.others + _PROCESS,
        workers=workers,
    )


def in_picture(
    camera: Camera, partition: CartesianChunks, low: np.ndarray, high: np.ndarray
) -> np.ndarray:
    """Return which of some boxes are in the picture, or may be, since they are beside the observer.

    The corners of a box are projected, and the picture of the box is between them.
    """
    if not camera.straight:
        return np.ones(len(low), bool)
    frame = camera.frame(partition.grid)
    ends = np.stack(
        [w[np.stack([a, b])] for w, a, b in zip(partition.walls, low.T, high.T, strict=True)]
    )  # (axis, end, box)
    pick = np.arange(8) >> np.array([[2], [1], [0]]) & 1
    corners = np.stack([wall[which].T for wall, which in zip(ends, pick, strict=True)])
    seen = camera.project(corners.reshape(3, -1), partition.grid)[:2]
    within, known = np.ones(len(low), bool), np.ones(len(low), bool)
    for places, shift, step, count in zip(
        seen, frame.shift, frame.pixel, frame.pixels, strict=True
    ):
        at = (places.reshape(-1, 8) - shift) / step
        within &= (at.min(axis=1) < 0.5 * count) & (at.max(axis=1) > -0.5 * count)
        known &= np.isfinite(at).all(axis=1)
    return np.where(known, within, np.isfinite(seen[0]).reshape(-1, 8).any(axis=1))


def _stored(volume: Volume, names: Sequence[str]) -> int | None:
    """Return the bytes that fields take in a file of `Volume.save`; None of others."""
    total = 0
    for name in names:
        origin = volume._fields.origin(name)
        place = origin and origin[0] / "fields" / name
        if not place or url_of(place) or not place.is_dir():
            return None
        total += sum(file.stat().st_size for file in place.rglob("*") if file.is_file())
    return total


def _by(counts: Sequence[int]) -> str:
    return " x ".join(map(str, counts))


def _bytes(count: float) -> str:
    for unit in ("B", "KiB", "MiB", "GiB", "TiB"):
        if count < 1000 or unit == "TiB":
            break
        count /= 1024
    return f"{count:.3g} {unit}"
