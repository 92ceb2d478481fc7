"""Rays that go from block to block of a volume, and their states."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..backend import Backend, dr, from_host
from ..grids.contract import CellBox
from ..grids.structured import is_structured
from ..rendering.march import RayState, arrays_in, mapped
from ..rendering.pixels import Lanes, between_walls
from ..rendering.tracer import RayBatch
from ..schemes.path import Path

if TYPE_CHECKING:
    from .tracer import BlockTracer

# Lanes whose places in the picture are bounded together: a tile of pixels.
TILE = 256
# In pixels: rounding of where the corners of a block are seen.
_MARGIN = 1e-3


class Rays:
    """Some rays, and their states: in NumPy's memory, of which blocks take some.

    Attributes
    ----------
    offset : (float, float)
        Additional offset within the pixels.
    u, v : double arrays
        Positions, in pixels from the middle of the picture; near ones follow each other.
    there : bool array
        Lanes that are rays.
    states : list of RayState
        One for each group of channels.
    depths : pair of arrays, optional
        Where each begins and ends, measured from the observer.
    stretch : int
        In which of several stretches rays are.
    """

    def __init__(
        self,
        tracer: BlockTracer,
        offset: tuple[float, float],
        places: tuple[np.ndarray, np.ndarray, np.ndarray],
        states: list[RayState],
        depths: tuple[np.ndarray, np.ndarray] | None = None,
        stretch: int = 0,
    ) -> None:
        self.tracer, self.offset, self.states, self.depths = tracer, offset, states, depths
        self.stretch = stretch
        self.u, self.v, self.there = places
        # The least and the largest places of rays that are together.
        starts = np.arange(0, len(self.u), TILE)
        self.low, self.high = (
            np.array([end.reduceat(values, starts) for values in (self.u, self.v)])
            for end in (np.minimum, np.maximum)
        )

    @classmethod
    def starting(cls, tracer: BlockTracer, batch: RayBatch) -> Rays:
        """Return the rays of a batch, which have not met anything yet."""
        lanes, count, states = batch.lanes, len(batch.lanes.target), []
        for _, part in tracer.parts():
            path = mapped(lambda a: np.full(count, a.numpy()[0]), part.nothing())
            states.append(RayState(path, None, np.zeros(count, bool), np.zeros(count, bool)))
        places = np.asarray(lanes.u), np.asarray(lanes.v), np.asarray(lanes.there)
        rays = cls(tracer, batch.offset, places, states)
        if batch.depths is not None:
            rays.depths = np.resize(batch.depths[0], count), np.resize(batch.depths[1], count)
        rays._enter()
        return rays

    def _enter(self) -> None:
        if not is_structured(grid := self.tracer.partition.grid):
            walk, count = self.tracer.walk_in(CellBox((0,), (grid.size,))), len(self.u)
            _, cursor = walk.enter(self.ray(np.arange(count)))
            dr.eval(cursor)
            for state in self.states:
                state.cursor = mapped(lambda a: np.resize(a.numpy(), count), cursor)

    def further(self) -> bool:
        """Go on to the next stretch; return whether there is one."""
        if self.stretch + 1 >= len(self._whole(np.arange(2)).stretches or ()):
            return False
        self.stretch += 1
        for state in self.states:
            state.moved = state.begun.copy()
        self._enter()
        return True

    @property
    def over(self) -> np.ndarray:
        """Which rays are at their end, in all channels."""
        return np.asarray(np.logical_and.reduce([state.over for state in self.states]))

    @property
    def wait(self) -> bool:
        """Whether some rays wait in cells of a tree."""
        size = self.tracer.partition.grid.size
        return self.states[0].cursor is not None and bool(np.any(self._waiting(0, size)))

    def _waiting(self, first: int, last: int) -> np.ndarray:
        here = np.zeros(len(self.u), bool)
        for state in self.states:
            number = state.cursor.cell.number
            here |= (number >= first) & (number < last) & ~state.over & self.there
        return here

    def taken(self, chosen: np.ndarray) -> Rays:
        """Return some of the rays by themselves."""
        places = self.u[chosen], self.v[chosen], self.there[chosen]
        states = mapped(lambda a: a[chosen], self.states)
        return Rays(self.tracer, self.offset, places, states, self._depths(chosen), self.stretch)

    def plain(self) -> tuple[Any, ...]:
        """Return the arguments besides the tracer, which other processes take."""
        return self.offset, (self.u, self.v, self.there), self.states, self.depths, self.stretch

    def _depths(self, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        return self.depths and (self.depths[0][chosen], self.depths[1][chosen])

    def found(self, state: RayState) -> Path:
        """Return the paths of all rays, or the results of those that look for something else.

        Rays that have met no block carry nothing.
        """
        if not (results := self.tracer.results):
            return state.path
        dtype, carried = self.tracer.backend.dtype, state.carried or results
        pairs = zip(results, carried, strict=False)
        return Path([np.where(state.begun, c, f).astype(dtype) for f, c in pairs], [], [])

    def origins(self) -> tuple[bool, np.ndarray, np.ndarray]:
        """Return whether rays are parallel, the extent of their origins, and their direction."""
        ray, origin = self.ray(np.arange(len(self.u))), np.zeros((3, 2))
        if parallel := self.tracer.job.camera.parallel:
            direction = np.array([np.asarray(d).ravel()[0] for d in ray.direction])
        else:
            origin = np.array([(np.min(o), np.max(o)) for o in map(np.asarray, ray.origin)])
            direction = np.zeros(3)
        return parallel, origin, direction

    def coming_to(self, boxes: Sequence[CellBox], met: np.ndarray | None = None) -> np.ndarray:
        """Return the numbers of rays that may meet boxes next, or wait in these cells of a tree.

        Those that may go through the boxes were `met`, if that is known.
        """
        if self.states[0].cursor is None:
            if met is None:
                return self.meeting(self.tracer.partition.around(boxes))
            return self.unfinished(met)
        here = [self._waiting(box.low[0], box.high[0]) for box in boxes]
        return many(np.flatnonzero(np.logical_or.reduce(here)))

    def meeting(self, extent: np.ndarray) -> np.ndarray:
        """Return the numbers of rays that may meet a box and are not at their end.

        Parameters
        ----------
        extent : array, shape (3, 2)
            Coordinates of the box.
        """
        job = self.tracer.job
        low, high = np.full(2, -np.inf), np.full(2, np.inf)
        if job.camera.straight:
            corners = np.reshape(np.meshgrid(*extent), (3, -1))
            seen = job.camera.project(corners, job.volume.grid)[:2]
            places = [
                (s - shift) / step
                for s, shift, step in zip(seen, job.frame.shift, job.frame.pixel, strict=True)
            ]
            if np.all(np.isfinite(places)):
                places = np.asarray(places) - np.array(self.offset)[:, None]
                low, high = places.min(axis=1) - _MARGIN, places.max(axis=1) + _MARGIN
        beyond = (low[:, None] > self.high) | (high[:, None] < self.low)
        near = ~np.any(beyond, axis=0)
        chosen = (np.flatnonzero(near)[:, None] * TILE + np.arange(TILE)).ravel()
        chosen = chosen[chosen < len(self.u)]
        u, v = self.u[chosen], self.v[chosen]
        inside = (u >= low[0]) & (u <= high[0]) & (v >= low[1]) & (v <= high[1])
        chosen = chosen[inside & self.there[chosen] & ~self.over[chosen]]
        return np.asarray(chosen[self._through_box(chosen, extent)] if len(chosen) else chosen)

    def unfinished(self, chosen: np.ndarray, state: RayState | None = None) -> np.ndarray:
        """Return those of some rays that are not at their end, on at least two lanes.

        In all channels, or in those of a state.
        """
        over = self.over if state is None else state.over
        return many(chosen[~over[chosen]])

    def _through_box(self, chosen: np.ndarray, extent: np.ndarray) -> np.ndarray:
        ray, bounds = self.ray(chosen), self.tracer.job.volume.grid.bounds
        double = np.dtype(self.tracer.backend.Wide.__name__.lower()) == np.float64
        margin = (1e-9 if double else 1e-4) * np.max(np.abs(bounds))
        enters, leaves = between_walls(ray, extent + np.array([-margin, margin]))
        first = -np.inf if ray.first is None else np.asarray(ray.first) - margin
        last = np.inf if ray.last is None else np.asarray(ray.last) + margin
        inside = np.maximum(enters, first) <= np.minimum(leaves, last)
        return np.broadcast_to(inside, chosen.shape)

    def ray(self, chosen: np.ndarray) -> Any:
        """Return some rays as kernels have them, in their stretch."""
        ray = self._whole(chosen)
        return ray.confined(*ray.stretches[self.stretch]) if ray.stretches else ray

    def _whole(self, chosen: np.ndarray) -> Any:
        backend = self.tracer.backend
        u, v = (from_host(backend.Wide, a[chosen]) for a in (self.u, self.v))
        lanes = Lanes(u, v, dr.arange(backend.UInt, len(chosen)))
        offset = [backend.wide(o) for o in self.offset]
        return self.tracer.ray(lanes, offset, self._depths(chosen))

    def some(self, chosen: np.ndarray, state: RayState) -> tuple[Any, RayState]:
        """Return some rays, and their state on the device."""
        backend = self.tracer.backend
        own = mapped(lambda a: on_device(backend, a[chosen]), state)
        return replace(self.ray(chosen), waiting=own.cursor), own

    def put(self, chosen: np.ndarray, state: RayState, new: RayState) -> None:
        """Remember the state of some rays; of the others nothing is carried yet."""
        if state.carried is None:
            count = len(self.u)
            state.carried = mapped(lambda a: np.zeros(count, a.dtype), new.carried)
        for own, values in zip(arrays_in(state), arrays_in(new), strict=True):
            own[chosen] = values

    def put_all(self, chosen: np.ndarray, states: Sequence[RayState]) -> None:
        """Remember the states of some rays, of all channels."""
        for state, new in zip(self.states, states, strict=True):
            self.put(chosen, state, new)


def many(chosen: np.ndarray) -> np.ndarray:
    """Return numbers of rays, at least two: kernels of one lane differ from those of many."""
    return np.resize(chosen, 2) if len(chosen) == 1 else chosen


def on_device(backend: Backend, values: np.ndarray) -> Any:
    """Return an array in the memory of a device."""
    kinds = {"float32": "Float32", "float64": "Float64", "bool": "Bool", "uint32": "UInt32"}
    return from_host(getattr(backend.module, kinds[values.dtype.name]), values)
