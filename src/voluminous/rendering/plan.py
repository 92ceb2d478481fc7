"""What drawing a picture chunk by chunk will take, before anything is read."""

from __future__ import annotations

import heapq
import inspect
import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..calibration import calibrated
from ..calibration.plain import in_plain_numbers
from ..cameras.contract import Camera, check_camera
from ..errors import InputError, check_name
from ..expressions.interval import Interval
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
from .options import check_scheme_in_pieces, check_tolerance
from .pieces import Pieces
from .sources.channel_layout import blocks_of

# Seconds of one core for: a byte of a field, unpacked; a box; a ray through a box, with its state;
# a cell on a ray. Measured on 512³ and 1024³ cells (`benchmarks/plan.py`); other machines are
# faster or slower by two.
_BYTE, _BOX, _RAY = 1.4e-9, 0.03, 2e-7
_STEP = {"first-order": 1.5e-8, "pre-integrated": 4e-8, "post-classified": 1e-7}
# A program and its compiler: to begin with, and bytes.
_START, _PROCESS = 0.5, 150 << 20
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
        Bytes that a process takes that draws, and the one that waits for others (with workers).
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
            lines[-1] = ("memory", f"{_bytes(self.memory)} a process, {_bytes(self.memory_here)} here")
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
    volume, medium, drawn = at_level(volume, medium, camera, 0 if level is None else level)
    choices = {"order": "front-to-back", "antialias": None, "bounds": False, "objects": ()}
    choices |= {name: options[name] for name in choices if name in options}
    pieces = Pieces(volume, medium, memory, measure=False, **choices)
    if scheme is None:
        scheme = "first-order" if medium.discrete else "post-classified"
    check_tolerance(tolerance)
    solver = get_scheme(scheme, controlled=tolerance is not None)
    check_scheme_in_pieces(solver)
    medium = _plain(medium, volume)
    frame = camera.frame(volume.grid)
    pieces.plan(medium, solver, frame.pixels)
    return _planned(pieces, medium, solver, camera, drawn, workers, samples)


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
    names = [name for name in medium.names if name in volume]
    chunks = _boxes(grid.shape, volume.store.chunks)
    seen = _visible(pieces, medium, scheme, volume.store.chunks).ravel()
    visible = seen & (_Met.by_rays(camera, frame, pieces, *chunks).rays > 0)
    boxes = list(pieces.boxes(*_origins(camera, pieces)))
    low, high = (np.array([getattr(box, end) for box in boxes]) for end in ("low", "high"))
    met = _Met.by_rays(camera, frame, pieces, low, high)
    places = tuple((low // pieces.side).T)
    drawn = _visible(pieces, medium, scheme, pieces.side)[places] & (met.rays > 0)
    cells = np.prod(high - low, axis=1)
    turns = samples**2 * len(blocks_of(medium.channels, scheme))
    least, most, read, rounds = _PASSES if scheme.controlled else (1, 1, 1.0, 1.0)
    per_cell = sum(volume.dtype(name).itemsize for name in names)
    steps = _STEP[scheme.name] / _processors() * met.steps
    cost = read * (_BOX + _BYTE * per_cell * cells) + rounds * (_RAY * met.rays + steps)
    cost *= drawn * turns
    tasks, shells, along = _side_by_side(pieces, boxes, cost, workers)
    stored = _stored(volume, names) if level == 0 else None
    share = float(np.sum(cells[drawn])) / grid.size
    return Plan(
        shape=grid.shape,
        level=level,
        pixels=frame.pixels,
        scheme=scheme.name,
        chunks=len(seen),
        visible=int(np.sum(visible)),
        known=all(volume.knows(name) for name in names),
        side=pieces.side,
        boxes=int(np.sum(drawn)),
        tasks=tasks,
        shells=shells,
        passes=(least * turns, most * turns),
        bytes_read=int(per_cell * np.sum(cells[drawn])),
        bytes_stored=None if stored is None else int(stored * share),
        bytes_whole=pieces.needed(grid.shape) + _PROCESS,
        memory=pieces.needed(pieces.side) + _PROCESS,
        memory_here=pieces.needed((0, 0, 0)) + _PROCESS,
        workers=workers,
        seconds=_START + (float(np.sum(cost)) if workers == 1 else along),
    )


def _processors() -> int:
    """Return the number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _boxes(shape: Sequence[int], side: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """Return the first cells of all boxes of so many cells, and those after the last, (n, 3)."""
    counts = [-(-n // s) for n, s in zip(shape, side, strict=True)]
    low = np.indices(counts).reshape(3, -1).T * np.asarray(side)
    return low, np.minimum(low + side, shape)


def _origins(camera: Camera, pieces: Pieces) -> tuple[bool, np.ndarray, np.ndarray]:
    """Return whether rays are parallel, the extent of their origins, and their direction."""
    center = pieces.grid.bounds.mean(axis=1)[:, None]
    direction = camera.lines_of_sight(center, pieces.grid)[:, 0]
    if camera.parallel:
        return True, np.zeros((3, 2)), direction
    depth = np.nan_to_num(camera.project(center, pieces.grid)[2][0])
    return False, np.repeat(center - depth * direction[:, None], 2, axis=1), direction


@dataclass
class _Met:
    """How many rays meet each of some boxes, and how many cells they cross there."""

    rays: np.ndarray
    steps: np.ndarray

    @classmethod
    def by_rays(
        cls, camera: Camera, frame: Any, pieces: Pieces, low: np.ndarray, high: np.ndarray
    ) -> _Met:
        """Project the six faces of each box: half of their areas is that of the box's picture.

        The rays through the faces across an axis cross all its cells between them.
        """
        ends = np.stack(
            [
                np.stack([w[k] for k in (a, b)], -1)
                for w, a, b in zip(pieces.walls, low.T, high.T, strict=True)
            ]
        )  # (3, n, 2)
        corners = np.stack(
            [ends[axis][:, [k >> (2 - axis) & 1 for k in range(8)]] for axis in range(3)]
        )  # (3, n, 8)
        u, v, _ = camera.project(corners.reshape(3, -1), pieces.grid)
        x, y = (
            (np.reshape(seen, corners.shape[1:]) - shift) / step
            for seen, shift, step in zip((u, v), frame.shift, frame.pixel, strict=True)
        )
        nx, ny = frame.pixels
        rays, steps = np.zeros(len(low)), np.zeros(len(low))
        for axis in range(3):
            far = 4 >> axis
            near = [k for k in range(8) if not k & far]
            near = [near[0], near[1], near[3], near[2]]  # around the face
            area = sum(_area(x[:, face], y[:, face]) for face in (near, [k + far for k in near]))
            rays += 0.5 * area
            steps += 0.5 * area * (high - low)[:, axis]
        inside = _overlap(x, nx) * _overlap(y, ny)
        # What is behind the observer, or around him, is on any ray at most once.
        known = np.isfinite(x).all(axis=1)
        behind = ~np.isfinite(x).any(axis=1)
        share = np.where(known, inside, 1.0)
        everything = np.where(behind, 0.0, float(nx * ny))
        cells = (high - low).sum(axis=1) / 2
        rays = np.where(known, np.minimum(rays * share, nx * ny), everything)
        return cls(rays, np.where(known, steps * share, everything * cells))


def _area(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the areas of polygons, shape (n, corners)."""
    twice = np.sum(x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1), axis=1)
    return 0.5 * np.abs(twice)


def _overlap(x: np.ndarray, count: int) -> np.ndarray:
    """Return which part of each range of places is in a picture that reaches to ± count / 2."""
    low, high = x.min(axis=1), x.max(axis=1)
    within = np.minimum(high, 0.5 * count) - np.maximum(low, -0.5 * count)
    return np.clip(within / np.maximum(high - low, 1e-30), 0.0, 1.0)


def _visible(
    pieces: Pieces, medium: Medium, scheme: Scheme, side: Sequence[int]
) -> np.ndarray:
    """Return where the medium may be visible, for each of the boxes of some chunks."""
    volume, chunks, shape = pieces.outline, pieces.outline.store.chunks, pieces.grid.shape
    ghosts = scheme.coefficients_at == "field"
    context = RangeContext(volume.unit, volume.expression_unit, _FAINTEST[scheme.name])
    lows = [np.arange(0, n, s) for n, s in zip(shape, side, strict=True)]
    ranges = {}
    for name in medium.names:
        if name in volume:
            table = volume.extremes(name)
            for axis, (low, chunk) in enumerate(zip(lows, chunks, strict=True)):
                first = np.maximum(low - ghosts, 0) // chunk
                last = -(-np.append(low[1:], shape[axis]) // chunk)
                parts = [table.take(range(a, b), axis) for a, b in zip(first, last, strict=True)]
                table = np.stack(
                    [
                        np.stack([part[..., 0].min(axis), part[..., 1].max(axis)], -1)
                        for part in parts
                    ],
                    axis,
                )
            ranges[name] = Interval(*np.moveaxis(table.astype(np.float64), -1, 0))
        else:
            ranges[name] = Interval(*_coordinates(pieces, name, side, ghosts))
    with np.errstate(all="ignore"):
        seen = np.asarray(medium.visible_in(ranges, context))
    return np.broadcast_to(seen, [len(low) for low in lows])


def _coordinates(
    pieces: Pieces, name: str, side: Sequence[int], ghosts: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Return the least and largest values of a coordinate in boxes."""
    low, high = _boxes(pieces.grid.shape, side)
    boxes = (CellBox(*ends) for ends in zip(map(tuple, low), map(tuple, high), strict=True))
    ranges = [pieces.ranges(box, [name], ghosts)[name] for box in boxes]
    counts = [-(-n // s) for n, s in zip(pieces.grid.shape, side, strict=True)]
    ends = np.array([(float(r.lo), float(r.hi)) for r in ranges]).T.reshape(2, *counts)
    return ends[0], ends[1]


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
