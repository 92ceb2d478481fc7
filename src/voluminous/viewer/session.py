"""One page: what it wants, what it was sent, and how large a picture it can take in time.

Nothing waits in a queue: a new wish takes the place of the old one. Time is passed in.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Any

# Seconds for a preview, kernel and way; and of quiet after which the full picture is made.
BUDGET, QUIET = 0.045, 0.15
# Sides of a preview as parts of the full ones.
SIZES = (1.0, 0.5, 1 / 3, 0.25, 1 / 6)
# A larger preview is tried after so many that were in time.
_PATIENCE = 3
# A kernel that takes longer even for the smallest preview is replaced by that of first order, which
# shows cells.
_HOPELESS = 0.25
_MOST_IN_FLIGHT = 4
# Pixels of a picture.
MOST_PIXELS = 16_000_000


@dataclass
class Session:
    """The state of one page.

    Attributes
    ----------
    camera : dict
        Where it looks from.
    size : (int, int)
        Pixels of the full picture.
    wanted, shown, rested : int
        The newest wish, the newest that a frame has shown, and the newest with a full picture.
    input : int
        The page's number of its newest input.
    moving : bool
        A gesture goes on.
    level : int
        Which of `SIZES` a preview has.
    first_order : bool
        Even the smallest preview takes too long with the usual scheme.
    changed_at : float
        When the last input came.
    ahead : bool
        What a full picture needs of a large file was read, or tried.
    """

    camera: dict[str, Any]
    size: tuple[int, int] = (400, 400)
    wanted: int = 0
    shown: int = 0
    rested: int = 0
    input: int = 0
    moving: bool = False
    visible: bool = True
    leader: bool = True
    changed_at: float = -1e9
    revision: int = -1
    level: int = 1
    first_order: bool = False
    ahead: bool = False
    _good: int = 0
    _in_flight: deque[tuple[int, float]] = field(default_factory=deque)
    _way: float = 0.0
    _kernel: float = 0.02

    def want(self, now: float, *, moving: bool = False, number: int | None = None) -> None:
        """Take a wish; the next frame shows it, and no older one is made.

        `number` is that of the page's input; wishes may come from other pages, too.
        """
        self.wanted += 1
        self.input = self.input if number is None else max(self.input, number)
        self.moving, self.changed_at = moving, now

    @property
    def is_exact(self) -> bool:
        """Whether the newest wish has its full picture."""
        return self.rested == self.wanted

    @property
    def is_near(self) -> bool:
        """Whether large frames are no trouble."""
        return self._way < BUDGET

    def wants_preview(self, now: float) -> bool:
        """Return whether a quick picture of the newest input is due."""
        return self._is_seen and self.shown < self.wanted and self.may_send(now)

    def wants_rest(self, now: float) -> bool:
        """Return whether the full picture is due: nothing has moved for a while."""
        still = not self.moving and now - self.changed_at >= QUIET
        return self._is_seen and not self.is_exact and still and self.shown >= self.wanted

    @property
    def _is_seen(self) -> bool:
        """Whether there is somebody to look, and room: a notebook's cell has none at first."""
        return self.visible and min(self.size) > 1

    @property
    def window(self) -> int:
        """Frames that may be on their way: one where the kernel is slower than the way."""
        travel = self._way / max(self._kernel, 1e-3)
        return max(1, min(_MOST_IN_FLIGHT, 1 + int(travel)))

    def may_send(self, now: float) -> bool:
        while self._in_flight and now - self._in_flight[0][1] > 2.0:  # lost, or a page that sleeps
            self._in_flight.popleft()
        return len(self._in_flight) < self.window

    def sent(
        self, frame: int, wish: int, now: float, kernel: float, preview: bool, full: bool = False
    ) -> None:
        """Note a frame: the wish that it shows, how long its kernel took, and which kind it is."""
        self.shown = max(self.shown, wish)
        self.rested = max(self.rested, wish) if full else self.rested
        self._in_flight.append((frame, now))
        if preview:
            self._kernel += 0.3 * (kernel - self._kernel)
            self._adapt(kernel)

    def seen(self, frame: int, now: float) -> None:
        """Take the page's word that it has drawn a frame."""
        for number, at in list(self._in_flight):
            if number <= frame:
                self._in_flight.popleft()
            if number == frame:
                travel = now - at
                # Up slowly, down at once: what waits for the kernel is no part of the way.
                self._way = min(travel, self._way + 0.3 * (travel - self._way))

    def _adapt(self, kernel: float) -> None:
        took = kernel + self._way
        if took > BUDGET:
            self._good = 0
            self.first_order |= self.level == len(SIZES) - 1 and kernel > _HOPELESS
            # A kernel takes about as long as it has pixels: at once to the size that is in time.
            last, here = len(SIZES) - 1, SIZES[self.level]
            smaller = range(min(self.level + 1, last), last)
            part = max(BUDGET - self._way, 0.0) / kernel
            self.level = next((k for k in smaller if (SIZES[k] / here) ** 2 <= part), last)
            return
        # The next size costs about as much more as it has pixels, at most.
        up = max(self.level - 1, 0)
        growth = (SIZES[up] / SIZES[self.level]) ** 2
        self._good = self._good + 1 if kernel * growth + self._way < BUDGET else 0
        if self._good >= _PATIENCE and up < self.level:
            self.level, self._good = up, 0

    @property
    def preview_size(self) -> tuple[int, int]:
        """Pixels of a preview."""
        return scaled(self.size, SIZES[self.level])

    def resize(self, size: Any, scale: Any) -> None:
        """Take the size of the page's picture in CSS pixels, and the screen's pixels per one."""
        w, h = (max(1.0, min(float(n), 8192.0)) for n in size)
        factor = max(0.25, min(float(scale), 2.0))
        factor = min(factor, (MOST_PIXELS / (w * h)) ** 0.5)
        self.size = scaled((round(w), round(h)), factor)


def scaled(size: tuple[int, int], factor: float) -> tuple[int, int]:
    """Return a size in pixels, at least one."""
    return max(1, round(size[0] * factor)), max(1, round(size[1] * factor))
