"""What was traced for one picture, and serves the next: a camera turns without tracing again."""

from __future__ import annotations

import threading
from collections import OrderedDict
from typing import TYPE_CHECKING, Any

from ...backend import dr, overwrite, twin
from .found import Batch, Found

if TYPE_CHECKING:
    from .drawing import Drawing

# Of more rays, if they are not a whole picture's, tracing is a small part; lanes take memory.
_MOST_RAYS = 1 << 16
# Different batches that are kept.
_KEPT = 8


class Kernels:
    """Traced batches of pictures that differ in their `Numbers` alone.

    Of 12.3 ms that the core (100³, 400², without error control) takes so, tracing took 2.4 more; of
    70 ms with error control, where some pixels are drawn first, 8.
    """

    def __init__(self) -> None:
        self._kept: OrderedDict[Any, _Traced | None] = OrderedDict()
        self._lock = threading.Lock()

    def draw(self, drawing: Drawing, batch: Batch, rows: list[Any]) -> bool:
        """Follow the rays of a batch, and write what they find, if that is known already.

        Returns False, and does nothing, where a batch is new, since most are drawn once, or large,
        and where another thread draws the same.
        """
        many = len(batch.lanes.target) > _MOST_RAYS and batch.whole is None
        if many or not self._lock.acquire(blocking=False):
            return False
        try:
            traced = self._traced(drawing, batch)
            if traced is not None:
                traced.draw(drawing, batch, rows)
            return traced is not None
        finally:
            self._lock.release()

    def _traced(self, drawing: Drawing, batch: Batch) -> _Traced | None:
        key = (len(batch.lanes.target), batch.whole)
        if key not in self._kept:
            self._kept[key] = None
            if len(self._kept) > _KEPT:
                self._kept.popitem(last=False)
            return None
        self._kept.move_to_end(key)
        traced = self._kept[key]
        if traced is None:
            traced = self._kept[key] = _Traced(drawing, batch)
        return traced


class _Traced:
    """A batch that was traced, and memory of its own that its kernel reads numbers from."""

    def __init__(self, drawing: Drawing, batch: Batch) -> None:
        self.read = twin(_read(drawing, batch))
        numbers, within, lanes = self.read
        self.found: Found = drawing.reading(numbers).found(lanes or batch.lanes, within)

    def draw(self, drawing: Drawing, batch: Batch, rows: list[Any]) -> None:
        dr.sync_thread()
        overwrite(self.read, _read(drawing, batch))
        self.found.write(rows, batch.first)


def _read(drawing: Drawing, batch: Batch) -> tuple[Any, ...]:
    lanes = batch.lanes if batch.whole is None else None
    return drawing.numbers, drawing.within(batch), lanes
