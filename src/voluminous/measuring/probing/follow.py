"""One ray of a picture, followed once more with a recorder."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...backend import dr
from ...rendering.job import Job
from ...rendering.rays.drawing import Drawing
from ...rendering.rays.paths import Paths
from ...schemes.path import Path
from .recorder import Recorder, Tape

# Room for so many times the cells that a straight line through the middle crosses.
_ROOM = 2


class Watched(Drawing):
    """Rays of a picture; remembers to which tolerance one pixel was drawn last."""

    watched = -1
    allowed: Any = ()

    def frame(self) -> Paths:
        self.allowed = getattr(self.source, "tolerance", ())
        return super().frame()

    def pixels(self, pixel: np.ndarray) -> Paths:
        if self.watched in pixel:
            self.allowed = self.source.tolerance
        return super().pixels(pixel)


@dataclass
class ProbeJob(Job):
    """A job of which one pixel is looked at closely."""

    watched: int = 0

    def _drawing(self, brightest_background: float, *, faintest: bool = False) -> Watched:
        drawing = Watched(self, self._source(faintest), brightest_background)
        drawing.watched = self.watched
        return drawing

    def source(self, brightest_background: float) -> Any:
        """Return the source that this pixel is drawn with in the end.

        If errors are kept to a tolerance, the whole picture tells which; it is drawn.
        """
        if not self.scheme.controlled:
            return _everywhere(self._source())
        drawing: Any = self.run(brightest_background).drawing
        source = _everywhere(drawing.source)
        source.tolerance = drawing.allowed
        return source


def _everywhere(source: Any) -> Any:
    """Return a source with which rays visit empty cells too, where steps are single cells."""
    source = copy.copy(source)
    if source.blocks is None or not getattr(source.blocks, "coarse", False):
        source.blocks = source.walk = None
    return source


@dataclass(frozen=True)
class Followed:
    """A ray, and what was written down of it, from the observer on.

    Attributes
    ----------
    origin, direction : float64 array, shape (3,)
        Of the ray; it runs away from the observer.
    rows : dict of str to array, shape (segment, numbers)
    path : Path
        What the march itself gathered, as numbers.
    stopped : bool
        It stopped early.
    """

    origin: np.ndarray
    direction: np.ndarray
    rows: dict[str, np.ndarray]
    path: Path
    stopped: bool
    numbers: Any


class _Recording(Drawing):
    """Rays that are recorded."""

    def follow(self, place: Any, names: tuple[str, ...], capacity: int) -> Followed:
        scheme, tape = self.scheme, Tape(self.backend, capacity)
        self.scheme = Recorder(scheme, tape, names)
        ray = self.ray_through(*(np.array([part]) for part in place))
        state = self._followed(ray)
        dr.eval(state, tape.columns)
        self.scheme = scheme
        count = int(state.carried[0][0])
        if count > capacity:
            return self.follow(place, names, count)
        rows = _outwards(tape.read(count)) if self.job.backward else tape.read(count)
        parts = (state.path.emission, state.path.transparency, state.path.depth)
        path = Path(*([np.asarray(v)[0] for v in part] for part in parts))
        origin, direction = (_vector(v) for v in (ray.origin, ray.direction))
        direction = -direction if self.job.backward else direction
        stopped = bool(np.asarray(state.cursor.inside)[0])
        return Followed(origin, direction, rows, path, stopped, self.source.numbers)


def follow(
    job: ProbeJob, place: tuple[int, float, float], names: tuple[str, ...], brightest: float
) -> Followed:
    """Follow one ray, and return all segments that it met.

    Parameters
    ----------
    place : (int, float, float)
        Flat number of the pixel, and where in it the ray goes through, from its centre.
    names : tuple of str
        Fields to write down, of schemes that interpolate them.
    brightest : float
        The brightest background.
    """
    drawing = _Recording(job, job.source(brightest), brightest)
    room = _ROOM * int(job.volume.grid.cells_across) + 64
    return drawing.follow(place, names, room)


def _outwards(rows: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    turned = {name: values[::-1] for name, values in rows.items()}
    return {**turned, "begin": -turned["end"], "end": -turned["begin"]}


def _vector(parts: Any) -> np.ndarray:
    return np.array([float(np.asarray(part).reshape(-1)[0]) for part in parts])
