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
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..executors import as_executor, run_tasks
from ..files import as_path, replacing

if TYPE_CHECKING:
    from .streaming import Rays, StreamingTracer


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
        self.executor = None if executor is None else as_executor(executor)
        self.folder = None if checkpoint is None else as_path(checkpoint)
        self.passes, self.used = 0, set[Path]()

    def draw(self, tracer: StreamingTracer, rays: Rays) -> None:
        """Let rays go through all blocks."""
        blocks = tracer.pieces.blocks(list(tracer.pieces.boxes(*rays.origins())))
        met = [rays.meeting(block.extent) for block in blocks]
        self.passes += 1
        chosen: dict[int, np.ndarray] = {}

        def begin(k: int) -> tuple[Any, ...] | None:
            """Return the task that draws a block; None if it is done already."""
            own = chosen[k] = rays.coming_to(blocks[k].boxes, met[k])
            if not len(own):
                return None
            seen = any(tracer.visible(box) for box in blocks[k].boxes)
            state = self._kept(tracer, k) if seen else None
            if state is not None:
                rays.put_all(own, state)
            elif seen and self.executor is not None:
                return tracer.task(rays.taken(own), blocks[k].boxes)
            else:
                tracer.through(rays, blocks[k].boxes)
                if seen:
                    self._keep(tracer, k, rays.taken(own).states)
            return None

        def end(k: int, state: Any) -> None:
            if state is not None:
                self._keep(tracer, k, state)
                rays.put_all(chosen[k], state)
            tracer.drawn(blocks[k].boxes)

        names = [f"block {k + 1} of {len(blocks)}" for k in range(len(blocks))]
        before = _before(met, len(rays.u))
        run_tasks(self.executor, begin, end, names, lambda: tracer.drawn(()), before)

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
