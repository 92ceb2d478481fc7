"""Draws a picture block by block in other processes; a block waits for those that may hide it.

The state of rays is handed from block to block, as in one process, so the picture is the same to
the bit; nothing is composited. Blocks that share no ray are drawn at the same time: of k × k × k up
to about k² · 3/4 (the sweep of transport codes: Koch, Baker & Alcouffe 1992, Trans. Am. Nucl. Soc.
65, 198).
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..digest import content_key
from ..executors import as_executor, run_tasks
from ..files import as_path, make_directory, replacing
from ..rendering.march import RayState, arrays_in, mapped

if TYPE_CHECKING:
    from ..grids.contract import CellBox
    from .rays import Rays
    from .tracer import BlockTracer

# Bytes of a checksum.
_CHECK = 32


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

    def draw(self, tracer: BlockTracer, rays: Rays) -> None:
        """Let rays go through all blocks."""
        tasks = tracer.partition.tasks(list(tracer.partition.blocks(*rays.origins())))
        met = [rays.meeting(task.extent) for task in tasks]
        self.passes += 1
        chosen: dict[int, np.ndarray] = {}
        files: dict[int, Path | None] = {}

        def begin(k: int) -> tuple[Any, ...] | None:
            """Return the task that draws a block; None if it is done already."""
            own = chosen[k] = rays.coming_to(tasks[k].blocks, met[k])
            seen = len(own) > 0 and any(tracer.visible(box) for box in tasks[k].blocks)
            before = rays.taken(own)
            files[k] = self._file(tracer, k, before, tasks[k].blocks) if seen else None
            if (states := self._kept(files[k], before)) is not None:
                rays.put_all(own, states)
            elif seen and self.executor is not None:
                return tracer.task(before, tasks[k].blocks)
            elif len(own):
                tracer.through(rays, tasks[k].blocks)
                self._keep(files[k], rays.taken(own).states)
            return None

        def end(k: int, state: Any) -> None:
            if state is not None:
                self._keep(files[k], state)
                rays.put_all(chosen[k], state)
            tracer.drawn(tasks[k].blocks)

        names = [f"block {k + 1} of {len(tasks)}" for k in range(len(tasks))]
        before = _before(met, len(rays.u))
        run_tasks(self.executor, begin, end, names, lambda: tracer.drawn(()), before)

    def _file(
        self, tracer: BlockTracer, block: int, before: Rays, boxes: Sequence[CellBox]
    ) -> Path | None:
        """Return where the rays behind a block are kept: what goes in decides what comes out."""
        if self.folder is None:
            return None
        key = content_key(tracer.limits, before.plain(), boxes)
        return self.folder / tracer.name / f"{self.passes:03d}-{block:04d}-{key}"

    def _kept(self, file: Path | None, before: Rays) -> list[RayState] | None:
        """Return the states of rays behind a block that was finished before; None if it was not."""
        try:
            written = b"" if file is None else file.read_bytes()
        except OSError:
            return None
        check, data = written[:_CHECK], written[_CHECK:]
        if file is None or check != _checksum(file, data):
            return None  # damaged, or another program's
        self.used.add(file.parent)
        with np.load(io.BytesIO(data)) as arrays:
            carried, *rest = (arrays[f"arr_{k}"] for k in range(len(arrays.files)))
        made, lists = iter(rest), json.loads(str(carried))
        states = (replace(s, carried=own) for s, own in zip(before.states, lists, strict=True))
        return [mapped(lambda part: next(made), state) for state in states]

    def _keep(self, file: Path | None, states: list[RayState]) -> None:
        if file is None:
            return
        # What schemes carry are lists of lists; the rest is as it was before.
        lists = json.dumps(mapped(lambda part: 0, [state.carried for state in states]))
        data = io.BytesIO()
        np.savez(data, np.array(lists), *arrays_in(states))
        self.used.add(file.parent)
        make_directory(file.parent)
        with replacing(file) as temporary, temporary.open("wb") as opened:
            opened.write(_checksum(file, data.getvalue()) + data.getvalue())
            opened.flush()
            os.fsync(opened.fileno())

    def finish(self) -> None:
        """Remove the blocks of a picture that is finished; draw further rays in this process."""
        for folder in self.used:
            shutil.rmtree(folder, ignore_errors=True)
        self.executor = self.folder = None


def _checksum(file: Path, data: bytes) -> bytes:
    return hashlib.sha256(file.name.encode() + data).digest()


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
