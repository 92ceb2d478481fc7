"""What drawing a picture chunk by chunk will take, before anything is read."""

from __future__ import annotations

import heapq
import inspect
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..backend import from_host, get_backend
from ..calibration import calibrated
from ..calibration.plain import in_plain_numbers
from ..cameras.contract import Camera, Frame, check_camera
from ..errors import InputError, check_name
from ..files import url_of
from ..grids.contract import CellBox
from ..media.contract import Medium
from ..media.ranges import RangeContext
from ..media.sum import with_each
from ..schemes import get_scheme
from ..schemes.base import Scheme
from ..units import is_count
from ..volume import Volume
from .api import render
from .cache import Cache
from .levels import at_level
from .options import check_antialias, check_scheme_in_pieces, check_tolerance
from .outline import Outline
from .pieces import Pieces
from .pixels import between_walls
from .sources.channel_layout import blocks_of
from .sweep import Sweep

# Seconds of one core for: a byte of a field, unpacked; a box; a ray through a box, with its state;
# a cell on a ray. Measured on 512³ and 1024³ cells (`benchmarks/plan.py`); other machines are
# faster or slower by two.
_BYTE, _BOX, _RAY = 1.1e-9, 0.006, 1.5e-7
_STEP = {"first-order": 1.5e-8, "pre-integrated": 3e-8, "post-classified": 4e-8}
# A program and its compiler: to begin with, and bytes.
_START, _PROCESS = 0.5, 150 << 20
# Rays along each side of a picture that are followed.
_SAMPLE = 16
# Part of the room that is left for chunks (`Chunks`).
_KEPT = 0.75
# A task of an executor, besides its rays, in seconds.
_TASK = 0.01
# Passes of a picture drawn to a tolerance: at least, at most, as a rule, and as many as all rays
# would take: some have few rays.
_PASSES = 2, 4, 3.0, 1.5
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
    side : tuple of int
        Cells that are read and drawn together: some chunks.
    boxes : int
        How many of them are read, in one pass.
    tasks, shells : int
        Blocks of boxes that an executor draws, and how many of them, at least, one after another.
    passes : (int, int)
        How often chunks are read, at least and at most.
    bytes_read, bytes_stored : int or None
        Of the fields in a pass: unpacked, and in the file; None if that is not known.
    bytes_whole : int
        Memory that the picture would take if it were not drawn in chunks, about.
    memory, memory_here : int
        Bytes that a process takes that draws, at most, and the one that waits (with workers).
    workers : int
    seconds : float
        Estimate, within a factor of three for a machine like that of the developers; each process
        has as many processors as this one.
    """

    shape: tuple[int, ...]
    level: int
    pixels: tuple[int, int]
    scheme: str
    chunks: int
    visible: int
    known: bool
    side: tuple[int, int, int]
    boxes: int
    tasks: int
    shells: int
    passes: tuple[int, int]
    bytes_read: int
    bytes_stored: int | None
    bytes_whole: int
    memory: int
    memory_here: int
    workers: int
    seconds: float

    def __str__(self) -> str:
        first, last = self.passes
        times = f"{first}" if first == last else f"{first} to {last}"
        seen = "may be visible" if self.known else "(ranges are unknown: convert --stats)"
        stored = "" if self.bytes_stored is None else f", {_bytes(self.bytes_stored)} in the file"
        lines = [
            ("cells", f"{_by(self.shape)}, level {self.level}"),
            ("chunks", f"{self.chunks}, of which {self.visible} {seen}"),
            ("picture", f"{_by(self.pixels)} pixels, {self.scheme}"),
            ("passes", times),
            ("reads", f"{self.boxes} boxes of {_by(self.side)} cells a pass"),
            ("bytes", f"{_bytes(self.bytes_read)} a pass{stored}"),
            ("memory", f"{_bytes(self.memory)} ({_bytes(self.bytes_whole)} without memory=)"),
        ]
        if self.workers > 1:
            lines[-1] = (
                "memory",
                f"{_bytes(self.memory)} a process, {_bytes(self.memory_here)} here",
            )
            lines += [("tasks", f"{self.tasks} in {self.shells} shells, {self.workers} processes")]
        lines += [("time", f"{_seconds(self.seconds)}, within a factor of three")]
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
    >>> plan.chunks, plan.passes
    (1, (2, 4))
    """
    for name in options:
        check_name("option", name, inspect.signature(render).parameters)
    if not is_count(workers, 1 << 31):
        raise InputError(f"workers is the number of processes, 1 or more, got {workers!r}")
    check_camera(camera, "plan")
    if not getattr(volume, "grid", None) or volume.grid.kind != "cartesian":
        raise InputError(
            "plan counts the chunks of a vm.Volume on a Cartesian grid, got "
            f"{getattr(volume, 'grid', volume)!r}: draw it without a plan"
        )
    volume, medium, drawn = at_level(volume, medium, camera, 0 if level is None else level)
    choices = {"antialias": None, "bounds": False, "objects": ()}
    choices |= {name: options[name] for name in choices if name in options}
    pieces = Pieces(_Sketch.of(volume), medium, memory, **choices)
    pieces.seen_by(camera, medium.names)
    if scheme is None:
        scheme = "first-order" if medium.discrete else "post-classified"
    check_tolerance(tolerance)
    check_antialias(samples, None, camera)
    solver = get_scheme(scheme, controlled=tolerance is not None)
    check_scheme_in_pieces(solver)
    medium = _plain(medium, volume)
    frame = camera.frame(volume.grid)
    if workers > 1:
        pieces.sweep = Sweep(None, None)  # smaller blocks
    pieces.plan(medium, solver, frame.pixels)
    return _planned(pieces, medium, solver, camera, drawn, workers, samples)


class _Sketch(Outline):
    """An outline for which no file is read: ranges that it does not tell are infinite."""

    def knows(self, name: str) -> bool:
        """Return whether the ranges of a field are known."""
        return bool(np.all(np.isfinite(self.extremes(name))))

    def _key(self, name: str) -> Any:
        return None

    def _measured(self, name: str, told: np.ndarray | None) -> tuple[np.ndarray, np.ndarray | None]:
        if name in self._whole.fields and self.in_memory(name) is not None:
            return super()._measured(name, told)
        found = (
            np.full((*self.chunk_counts, 2), np.nan) if told is None else told.astype(np.float64)
        )
        return np.where(np.isfinite(found), found, (-np.inf, np.inf)), None


def _plain(medium: Medium, volume: Volume) -> Medium:
    """Return the medium in plain numbers; path lengths that are open do not matter here."""
    plain = with_each(
        in_plain_numbers(medium, volume),
        lambda p: p.changed(path_length=1.0) if isinstance(p.path_length, str) else p,
    )
    return calibrated(plain, volume, Cache(volume).measurements)


def _planned(
    pieces: Pieces,
    medium: Medium,
    scheme: Scheme,
    camera: Camera,
    level: int,
    workers: int,
    samples: int,
) -> Plan:
    volume, grid, frame = pieces.outline, pieces.grid, camera.frame(pieces.grid)
    assert isinstance(volume, _Sketch)
    names = [name for name in medium.names if name in volume]
    context = RangeContext(volume.unit, volume.expression_unit, _FAINTEST[scheme.name])
    with np.errstate(all="ignore"):
        shown = medium.visible_in(pieces.ranges_of_chunks(medium.names), context)
    seen = np.array(np.broadcast_to(shown, volume.chunk_counts))
    seen &= (rays_through(camera, pieces, *_chunks(pieces))[0] > 0).reshape(seen.shape)
    boxes = list(pieces.boxes(*_origins(camera, pieces)))
    low, high = (np.array([getattr(box, end) for box in boxes]) for end in ("low", "high"))
    rays, crossed = rays_through(camera, pieces, low, high)
    share = np.array([seen[volume.chunks_of(box)].mean() for box in boxes]) * (rays > 0)
    cells = share * np.prod(high - low, axis=1)
    # Blocks of channels share what is read.
    turns, blocks = samples**2, len(blocks_of(medium.channels, scheme))
    least, most, usual, rounds = _PASSES if scheme.controlled else (1, 1, 1.0, 1.0)
    total = float(np.sum(cells)) * sum(volume.dtype(name).itemsize for name in names)
    # Chunks that are kept are unpacked once.
    kept = min(1.0, _KEPT * pieces.room / total) if total else 1.0
    unpacked = kept + (1.0 - kept) * usual * turns
    cost = unpacked * _BYTE * total / max(np.sum(cells), 1.0) * cells
    steps = _STEP[scheme.name] / _processors() * crossed
    cost += (share > 0) * turns * (usual * _BOX + rounds * blocks * (_RAY * rays + steps))
    held = min(pieces.room, total) if most * turns > 1 or pieces.dual else 0.0
    tasks, shells, along = _side_by_side(pieces, boxes, cost, workers)
    stored = _stored(volume, names) if level == 0 else None
    x, y, z = (int(n) for n in pieces.side)
    return Plan(
        shape=grid.shape,
        level=level,
        pixels=frame.pixels,
        scheme=scheme.name,
        chunks=seen.size,
        visible=int(seen.sum()),
        known=all(volume.knows(name) for name in names),
        side=(x, y, z),
        boxes=int(np.count_nonzero(share)),
        tasks=tasks,
        shells=shells,
        passes=(least * turns, most * turns),
        bytes_read=int(total),
        bytes_stored=None if stored is None else int(stored * seen.mean()),
        bytes_whole=int(pieces.others + pieces.per_cell * grid.size) + _PROCESS,
        memory=int(pieces.others + pieces.per_cell * math.prod(pieces.side) + held) + _PROCESS,
        memory_here=pieces.others + _PROCESS,
        workers=workers,
        seconds=_START + (float(np.sum(cost)) if workers == 1 else along),
    )


def _processors() -> int:
    """Return the number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _chunks(pieces: Pieces) -> tuple[np.ndarray, np.ndarray]:
    """Return the first cells of all chunks, and those after the last, shape (n, 3)."""
    side = np.array(pieces.outline.store.chunks)
    low = np.indices(pieces.outline.chunk_counts).reshape(3, -1).T * side
    return low, np.minimum(low + side, pieces.grid.shape)


def _origins(camera: Camera, pieces: Pieces) -> tuple[bool, np.ndarray, np.ndarray]:
    """Return whether rays are parallel, the extent of their origins, and their direction."""
    center = pieces.grid.bounds.mean(axis=1)[:, None]
    direction = camera.lines_of_sight(center, pieces.grid)[:, 0]
    if camera.parallel:
        return True, np.zeros((3, 2)), direction
    depth = np.nan_to_num(camera.project(center, pieces.grid)[2][0])
    return False, np.repeat(center - depth * direction[:, None], 2, axis=1), direction


def rays_through(
    camera: Camera, pieces: Pieces, low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return how many rays meet each of some boxes, and how many cells all of them cross there.

    The six faces of a box are projected: half of their areas is that of the box's picture, and the
    rays through the faces across an axis cross all cells between them. Where that cannot be told,
    beside the observer or in panoramas, some rays are followed.
    """
    frame = camera.frame(pieces.grid)
    ends = np.stack(
        [w[np.stack([a, b])] for w, a, b in zip(pieces.walls, low.T, high.T, strict=True)]
    )  # (axis, end, box)
    pick = np.arange(8) >> np.array([[2], [1], [0]]) & 1
    corners = np.stack([own[way].T for own, way in zip(ends, pick, strict=True)])
    seen = camera.project(corners.reshape(3, -1), pieces.grid)[:2]
    x, y = (
        (places.reshape(-1, 8) - shift) / step
        for places, shift, step in zip(seen, frame.shift, frame.pixel, strict=True)
    )
    rays, steps = np.zeros(len(low)), np.zeros(len(low))
    for axis, way in enumerate(pick):
        for face in (np.flatnonzero(way == end)[[0, 1, 3, 2]] for end in (0, 1)):
            area = 0.5 * _area(x[:, face], y[:, face])
            rays += area
            steps += area * (high - low)[:, axis]
    nx, ny = frame.pixels
    inside = _overlap(x, nx) * _overlap(y, ny)
    rays, steps = rays * inside, steps * inside
    known = np.isfinite(x)
    some = known.any(axis=1) & (not camera.straight or ~known.all(axis=1))
    rays[~known.any(axis=1)] = steps[~known.any(axis=1)] = 0.0
    if some.any():
        rays[some], steps[some] = _followed(camera, frame, ends[..., some], (high - low)[some])
    return rays, steps


def _followed(
    camera: Camera, frame: Frame, ends: np.ndarray, cells: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return how many rays meet boxes, and the cells they cross, from a sample of the rays."""
    backend = get_backend("cpu", "double")
    some = [
        axis[np.linspace(0, len(axis) - 1, _SAMPLE).astype(int)] for axis in frame.coordinates()
    ]
    u, v = (from_host(backend.Wide, places.ravel()) for places in np.meshgrid(*some))
    ray = camera.rays(frame.traced_vectors(backend), u, v)
    walls = ends[..., None]
    enters, leaves = between_walls(ray, walls)
    length = np.maximum(leaves - np.maximum(enters, 0.0), 0.0)
    across = sum(
        np.abs(np.asarray(direction)) * count / (far - near)
        for direction, (near, far), count in zip(
            ray.direction, walls, cells.T[..., None], strict=True
        )
    )
    each = np.prod(frame.pixels) / _SAMPLE**2
    # What is far away in a panorama may be between the rays of the sample.
    met = np.maximum((length > 0).sum(axis=1), not camera.straight)
    return met * each, (length * across).sum(axis=1) * each


def _area(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the areas of polygons, shape (n, corners)."""
    twice = np.sum(x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1), axis=1)
    return np.asarray(0.5 * np.abs(twice))


def _overlap(x: np.ndarray, count: int) -> np.ndarray:
    """Return which part of each range of places is in a picture that reaches to ± count / 2."""
    low, high = x.min(axis=1), x.max(axis=1)
    within = np.minimum(high, 0.5 * count) - np.maximum(low, -0.5 * count)
    return np.asarray(np.clip(within / np.maximum(high - low, 1e-30), 0.0, 1.0))


def _side_by_side(
    pieces: Pieces, boxes: list[CellBox], cost: np.ndarray, workers: int
) -> tuple[int, int, float]:
    """Return the number of tasks and of shells, and the seconds that several processes take.

    A block begins when its neighbours towards the first one are done, and a process is free.
    """
    blocks = pieces.blocks(boxes)
    seconds = dict(zip(boxes, cost.tolist(), strict=True))
    spent = [sum(seconds[box] for box in block.boxes) for block in blocks]
    corners = np.array([block.extent[:, 0] for block in blocks])
    places = np.stack([np.unique(c, return_inverse=True)[1] for c in corners.T], axis=-1)
    away = places - places[0]
    numbers = {tuple(place): k for k, place in enumerate(places.tolist())}
    ends: list[float] = [0.0] * len(blocks)
    free = [0.0] * workers
    for k in np.argsort(np.abs(away).sum(axis=1), kind="stable").tolist():
        begin = 0.0
        for axis in np.flatnonzero(away[k]).tolist():
            before = places[k].copy()
            before[axis] -= np.sign(away[k, axis])
            begin = max(begin, ends[numbers[tuple(before.tolist())]])
        ends[k] = begin
        if spent[k] > 0.0:
            ends[k] = max(begin, heapq.heappop(free)) + spent[k] + _TASK
            heapq.heappush(free, ends[k])
    drawn = np.array(spent) > 0.0
    shells = len(np.unique(np.abs(away[drawn]).sum(axis=1)))
    return int(drawn.sum()), shells, max(ends)


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


def _seconds(count: float) -> str:
    if count < 100:
        return f"{count:.2g} s"
    return f"{count / 60:.2g} min" if count < 6000 else f"{count / 3600:.2g} h"
