"""Draws a picture block by block in other processes; a block waits for those that may hide it.

The state of rays is handed from block to block, as in one process, so the picture is the same to
the bit; nothing is composited. Blocks that share no ray are drawn at the same time: of k × k × k up
to about k² · 3/4 (the sweep of transport codes: Koch, Baker & Alcouffe 1992, Trans. Am. Nucl. Soc.
65, 198).
"""

from __future__ import annotations

import os
import pickle
import shutil
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError, VoluminousError
from ..files import as_path, replacing

if TYPE_CHECKING:
    from .streaming import Rays, StreamingTracer
    from .tracer import RayTracer

# How often reading is tried again in another task.
_RETRIES = 3
# Seconds after which progress is reported, which may cancel.
_PATIENCE = 0.1


def as_executor(given: Any) -> Executor | None:
    """Return what runs tasks: an executor itself, or that of a Dask client.

    Raises
    ------
    InputError
        If it is neither.
    """
    if hasattr(given, "get_executor"):
        executor: Executor = given.get_executor(retries=_RETRIES, pure=False)
        return executor
    if given is None or isinstance(given, Executor):
        return given
    raise InputError(
        "executor must be a concurrent.futures.Executor (ProcessPoolExecutor, mpi4py's "
        f"MPIPoolExecutor, joblib's get_reusable_executor(), …) or a Dask client, got {given!r}"
    )


class Sweep:
    """Where blocks are drawn, and where they are kept.

    Parameters
    ----------
    executor : Executor or Dask client, optional
        By default blocks are drawn in this process.
    checkpoint : str or Path, optional
        A folder in which finished blocks are kept until the picture is finished.
    """

    def __init__(self, executor: Any, checkpoint: Any) -> None:
        self.executor = as_executor(executor)
        self.folder = None if checkpoint is None else as_path(checkpoint)
        self.passes, self.used = 0, set[Path]()

    def draw(self, tracer: StreamingTracer, number: int, part: RayTracer, rays: Rays) -> None:
        """Let rays go through all blocks.

        Parameters
        ----------
        number : int
            Of the block of channels that `part` draws.
        """
        blocks = tracer.pieces.blocks(list(tracer.pieces.boxes(*rays.origins())))
        met = [rays.meeting(block.extent) for block in blocks]
        before = _before(met, len(rays.u))
        self.passes += 1
        waiting, left = list(range(len(blocks))), set(range(len(blocks)))
        running: dict[Future[Any], int] = {}
        failed, chosen = dict.fromkeys(waiting, 0), {}

        def begin(k: int) -> bool:
            """Start to draw a block; return whether it is done already."""
            chosen[k] = rays.coming_to(blocks[k].boxes, met[k])
            if not len(chosen[k]):
                return True
            if not any(tracer.visible(part, box) for box in blocks[k].boxes):
                tracer.through(part, rays, blocks[k].boxes)
                return True
            state = self._kept(tracer, k)
            if state is None and self.executor is None:
                tracer.through(part, rays, blocks[k].boxes)
                self._keep(tracer, k, rays.taken(chosen[k]).state)
                return True
            if state is not None:
                rays.put(chosen[k], state)
                return True
            work, *given = tracer.task(number, rays.taken(chosen[k]), blocks[k].boxes)
            assert self.executor is not None
            running[self.executor.submit(work, *given)] = k
            return False

        def end(k: int) -> None:
            left.discard(k)
            tracer.drawn(blocks[k].boxes)

        try:
            while left:
                ready = [k for k in waiting if not before[k] & left]
                waiting = [k for k in waiting if k not in ready]
                for k in ready:
                    if begin(k):
                        end(k)
                if ready or not running:
                    continue
                done, _ = wait(running, _PATIENCE, FIRST_COMPLETED)
                for future in done:
                    k = running.pop(future)
                    state = self._result(future, failed, k)
                    if state is None:
                        waiting.append(k)
                        continue
                    self._keep(tracer, k, state)
                    rays.put(chosen[k], state)
                    end(k)
                tracer.drawn(())
        finally:
            for future in running:
                future.cancel()

    def _result(self, future: Future[Any], failed: dict[int, int], k: int) -> Any:
        """Return what a task made; None if it must be tried again."""
        try:
            return future.result()
        except BrokenExecutor as error:
            kept = "" if self.folder is None else "; finished blocks are kept: call again"
            raise VoluminousError(
                "a process that drew a block died, of too little memory or killed, and its "
                f"executor goes on no more ({error}). Take a new one, less memory= or fewer "
                f"processes{kept}. Dask replaces processes that die"
            ) from error
        except OSError:
            failed[k] += 1
            if failed[k] > _RETRIES:
                raise
            return None

    def _path(self, tracer: StreamingTracer, block: int) -> Path:
        assert self.folder is not None
        return self.folder / tracer.name / f"{self.passes:03d}-{block:04d}"

    def _kept(self, tracer: StreamingTracer, block: int) -> Any:
        """Return the state of rays behind a block that was finished before; None if it was not."""
        if self.folder is None:
            return None
        try:
            path = self._path(tracer, block)
            state = pickle.loads(path.read_bytes())
            self.used.add(path.parent)
            return state
        except (OSError, EOFError, pickle.UnpicklingError):
            return None

    def _keep(self, tracer: StreamingTracer, block: int, state: Any) -> None:
        if self.folder is None:
            return
        path = self._path(tracer, block)
        self.used.add(path.parent)
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as temporary, temporary.open("wb") as file:
            pickle.dump(state, file)
            file.flush()
            os.fsync(file.fileno())

    def finish(self) -> None:
        """Remove the blocks of a picture that is finished; draw further rays in this process."""
        for folder in self.used:
            shutil.rmtree(folder, ignore_errors=True)
        self.executor = self.folder = None


def _before(met: list[np.ndarray], count: int) -> list[set[int]]:
    """Return, for each block, those that its rays meet before it.

    Parameters
    ----------
    met : list of int arrays
        The rays that meet each block, front to back.
    count : int
        Number of rays.
    """
    last, before = np.full(count, -1), []
    for k, rays in enumerate(met):
        before.append(set(np.unique(last[rays]).tolist()) - {-1})
        last[rays] = k
    return before
