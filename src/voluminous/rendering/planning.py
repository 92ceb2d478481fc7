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
from ..schemes import get_scheme
from ..schemes.base import Scheme, is_controlled
from ..units import is_count
from ..volume import Volume
from .cache import Cache
from .levels import at_level
from .options import check_antialias, check_options, check_scheme_in_pieces, check_tolerance
from .outline import Outline
from .pieces import Pieces
from .sweep import Sweep

# Bytes of a program and its compiler.
_PROCESS = 150 << 20
# Part of the room that is left for chunks (`Chunks`).
_KEPT = 0.75
# Passes of a picture drawn to a tolerance: at least, and at most.
_PASSES = 2, 4
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
    passes : (int, int)
        How often chunks are read, at least and at most.
    bytes_read, bytes_stored : int or None
        Of the fields in a pass: unpacked, and in the file; None if that is not known.
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
    side: tuple[int, int, int]
    boxes: int
    passes: tuple[int, int]
    bytes_read: int
    bytes_stored: int | None
    bytes_whole: int
    memory: int
    memory_here: int
    workers: int

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
    >>> plan.chunks, plan.passes
    (1, (2, 4))
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
    bound, context = medium.bind(Binding.to(volume)), RangeContext(_FAINTEST[scheme.name])
    with np.errstate(all="ignore"):
        shown = bound.may_show(pieces.ranges_of_chunks(medium.names), context)
    seen = np.array(np.broadcast_to(shown, volume.chunk_counts))
    seen &= in_picture(camera, pieces, *_chunks(pieces)).reshape(seen.shape)
    boxes = list(pieces.boxes(*_origins(camera, pieces)))
    low, high = (np.array([getattr(box, end) for box in boxes]) for end in ("low", "high"))
    share = np.array([seen[volume.chunks_of(box)].mean() for box in boxes])
    share *= in_picture(camera, pieces, low, high)
    cells = share * np.prod(high - low, axis=1)
    turns = samples**2
    least, most = _PASSES if is_controlled(scheme) else (1, 1)
    total = float(np.sum(cells)) * sum(volume.dtype(name).itemsize for name in names)
    held = min(_KEPT * pieces.room, total) if most * turns > 1 or pieces.dual else 0.0
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
        passes=(least * turns, most * turns),
        bytes_read=int(total),
        bytes_stored=None if stored is None else int(stored * seen.mean()),
        bytes_whole=int(pieces.others + pieces.per_cell * grid.size) + _PROCESS,
        memory=int(pieces.others + pieces.per_cell * math.prod(pieces.side) + held) + _PROCESS,
        memory_here=pieces.others + _PROCESS,
        workers=workers,
    )


def _chunks(pieces: Pieces) -> tuple[np.ndarray, np.ndarray]:
    """Return the first cells of all chunks, and those after the last, shape (n, 3)."""
    side = np.array(pieces.outline.store.chunks)
    low = np.indices(pieces.outline.chunk_counts).reshape(3, -1).T * side
    return low, np.minimum(low + side, pieces.grid.shape)


def _origins(camera: Camera, pieces: Pieces) -> tuple[bool, np.ndarray, np.ndarray]:
    center = pieces.grid.bounds.mean(axis=1)[:, None]
    direction = camera.lines_of_sight(center, pieces.grid)[:, 0]
    if camera.parallel:
        return True, np.zeros((3, 2)), direction
    depth = np.nan_to_num(camera.project(center, pieces.grid)[2][0])
    return False, np.repeat(center - depth * direction[:, None], 2, axis=1), direction


def in_picture(camera: Camera, pieces: Pieces, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return which of some boxes are in the picture, or may be, since they are beside the observer.

    The corners of a box are projected, and the picture of the box is between them.
    """
    if not camera.straight:
        return np.ones(len(low), bool)
    frame = camera.frame(pieces.grid)
    ends = np.stack(
        [w[np.stack([a, b])] for w, a, b in zip(pieces.walls, low.T, high.T, strict=True)]
    )  # (axis, end, box)
    pick = np.arange(8) >> np.array([[2], [1], [0]]) & 1
    corners = np.stack([own[way].T for own, way in zip(ends, pick, strict=True)])
    seen = camera.project(corners.reshape(3, -1), pieces.grid)[:2]
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
