"""Renders for all pages in one thread: the newest wish first; gives up what nobody wants now."""

from __future__ import annotations

import atexit
import contextlib
import json
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from ..calibration.samples import measurable
from ..cameras import Camera, Panorama, Perspective
from ..cameras.contract import vector
from ..drawing.api import in_steps, render
from ..errors import VoluminousError
from ..grids.contract import DualGrid
from ..image import Image
from ..large.levels import sufficient_level
from ..measuring.projections import drawn
from ..media import Coefficients, Medium
from ..progress import silent
from ..rendering.options import RenderOptions
from ..schemes.pre_integrated import PreIntegrated
from ..volume import Volume
from .frames import float16, linear_jpeg, log_jpeg
from .session import QUIET, Session

# Seconds of a batch: so long a new input may wait.
_BATCH = 0.03
# Seconds between two pictures of a refinement.
_UPDATE = 0.25
# Pixels that are fainter than this part of the brightest say nothing of the usual error.
_DARK = 0.01
# Cells of a volume that may be in memory as a whole: 256³. Files with levels that have more are
# drawn chunk by chunk, and from a level while something moves.
_AT_HAND = 1 << 24
# Sides of a chunk double from level to level.
_EIGHTH = 1 / 8


class Page(Protocol):
    """A page that is painted for."""

    session: Session

    def send(self, message: dict[str, Any], payload: bytes = b"") -> None:
        """Send a message; called in the painter's thread."""
        ...


@dataclass(frozen=True)
class Shot:
    """All that decides one picture.

    Attributes
    ----------
    options : dict
        Of `render`.
    wish, number, revision : int
        The wish and the page's input that it shows, and the document's revision.
    table : dict
        The camera, as the page gave it.
    editing : bool
        The medium is being changed: what is only computed once per medium does not pay.
    projection : dict
        Arguments of `project`, if the picture is no rendering, and the window that is shown.
    """

    volume: Volume
    medium: Medium | None
    camera: Camera
    options: dict[str, Any]
    wish: int
    number: int
    revision: int
    table: dict[str, Any]
    editing: bool = False
    projection: dict[str, Any] = field(default_factory=dict)

    @property
    def drawn(self) -> Medium:
        """What `render` is given: a transparent medium, if none is drawn."""
        return _NOTHING if self.medium is None else self.medium

    @property
    def pixels(self) -> tuple[int, int]:
        """Pixels of the picture: no more than asked for, and fewer where its shape is fixed."""
        return self.camera.frame(self.volume.grid).pixels

    def projected(self, volume: Volume, progress: Any) -> Image:
        """Return the projection, of the volume or of a level of its file."""
        how = {key: value for key, value in self.projection.items() if key != "window"}
        options = {**self.options, "progress": progress}
        if volume is not self.volume:
            options |= {"memory": None}
        return drawn(volume, self.drawn, self.camera, how, **options)


class _GivenUp(Exception):
    """Nobody wants the picture that is being drawn."""


def at_hand(volume: Volume) -> Volume:
    """Return what quick answers look at: a level of a large file, else the volume itself."""
    small = volume.grid.size <= _AT_HAND or not volume.waiting
    return volume if small else measurable(volume)


_collected: dict[int, list[str]] = {}
_collecting, _filters = threading.Lock(), contextlib.ExitStack()


@contextlib.contextmanager
def caught_warnings() -> Iterator[list[str]]:
    """Collect the texts of the warnings of this thread; those of others go where they went.

    What Python's `catch_warnings` sets holds for all threads: here the first thread that comes sets
    it, and the last one that goes takes it back.
    """
    thread, texts = threading.get_ident(), list[str]()
    with _collecting:
        if not _collected:
            _filters.enter_context(warnings.catch_warnings())
            warnings.simplefilter("always", UserWarning)
            before = warnings.showwarning

            def show(message: Any, *rest: Any) -> None:
                mine = _collected.get(threading.get_ident())
                before(message, *rest) if mine is None else mine.append(str(message))

            warnings.showwarning = show  # type: ignore[assignment]
        outer = _collected.get(thread)
        _collected[thread] = texts
    try:
        yield texts
    finally:
        with _collecting:
            if outer is not None:
                _collected[thread] = outer
            else:
                del _collected[thread]
            if not _collected:
                _filters.close()


class Painter:
    """The thread that renders.

    Parameters
    ----------
    pages : callable
        Returns the pages there are now.
    shot : callable
        Returns the `Shot` of a page for a size in pixels.
    """

    def __init__(
        self,
        pages: Callable[[], list[Page]],
        shot: Callable[[Page, tuple[int, int]], Shot],
    ) -> None:
        self._pages, self._shot = pages, shot
        self._woken, self._closed = threading.Condition(), False
        self._frame = 0
        self._turn = 0
        self._exposures: dict[str, float] = {}
        self._thread = threading.Thread(target=self._work, name="painter", daemon=True)
        self._thread.start()
        # A kernel that runs while Python ends would abort the process.
        atexit.register(self.close)

    def wake(self) -> None:
        """Look for wishes: something has changed."""
        with self._woken:
            self._woken.notify()

    def close(self) -> None:
        """End after the batch that is being rendered."""
        self._closed = True
        self.wake()
        self._thread.join(5.0)
        atexit.unregister(self.close)

    def _work(self) -> None:
        while not self._closed:
            page, paint = self._next()
            if page is None:
                with self._woken:
                    self._woken.wait(QUIET / 4)
                continue
            try:
                paint(page)
            except Exception as error:
                self._tell(page, error)

    def _next(self) -> tuple[Any, Any]:
        """Return the page whose turn it is, and what to do; previews come first."""
        now, pages = time.monotonic(), self._pages()
        kinds = ((Session.wants_preview, self._preview), (Session.wants_rest, self._rest))
        for wants, paint in kinds:
            for k in range(len(pages)):
                page = pages[(self._turn + k) % len(pages)]
                if wants(page.session, now):
                    self._turn = (self._turn + k + 1) % len(pages)
                    return page, paint
        return None, None

    def _tell(self, page: Page, error: Exception) -> None:
        session = page.session
        session.shown, session.exact = session.wanted, True
        text = (
            str(error) if isinstance(error, VoluminousError) else f"{type(error).__name__}: {error}"
        )
        page.send({"kind": "notice", "level": "error", "text": text})

    def _preview(self, page: Page) -> None:
        session = page.session
        shot = self._shot(page, session.preview_size)
        start = time.monotonic()
        intensity = self._quietly(shot, first_order=session.first_order)
        took = time.monotonic() - start
        scale = session.preview_size[0] / session.size[0]
        self._send(page, shot, intensity, took, scale=scale, done=0.0, preview=True)

    def _rest(self, page: Page) -> None:
        """Render the full picture, of large files from coarse levels to the one that suffices.

        It is given up where somebody else wants one.
        """
        shot = self._shot(page, page.session.size)
        start = time.monotonic()
        image: Image | None = None
        with caught_warnings() as caught:
            levels = _levels(shot)
            work = np.cumsum([0.0] + [_EIGHTH**level for level in levels])
            for k, level in enumerate(levels):
                begun, ended = work[k : k + 2] / work[-1]
                try:
                    image = self._level(page, shot, level, image, start, (begun, ended))
                except _GivenUp:
                    return
                except VoluminousError as error:
                    if image is None:
                        raise
                    caught.append(f"level {levels[k - 1]} of the file is shown: {error}")
                    break
                if ended < 1.0 and page.session.may_send(time.monotonic()):
                    self._send_image(page, shot, image, start, done=float(ended))
        assert image is not None
        page.session.exact = True
        self._exposures[_look(shot)] = image.exposure
        self._send_image(page, shot, image, start, done=1.0, exact=True)
        for text in caught:
            page.send({"kind": "notice", "level": "warning", "text": text})

    def _level(
        self,
        page: Page,
        shot: Shot,
        level: int,
        coarser: Image | None,
        start: float,
        parts: tuple[float, float],
    ) -> Image:
        """Render one level in short batches; tell what part of the work is done."""
        last = time.monotonic()
        nx, ny = shot.pixels
        made = 0
        picture: np.ndarray | None = None
        if coarser is not None:
            picture = coarser.intensity.reshape(nx * ny, -1).copy()
        options = dict(shot.options)
        if options.get("level") == "auto":
            options["level"] = level
            if level == at_hand(shot.volume).meta.get("level", 0):
                options["memory"] = None

        def look_around(done: float) -> None:
            nonlocal last
            now = time.monotonic()
            if self._closed or self._is_wanted_elsewhere(page, shot, now):
                raise _GivenUp
            if picture is not None and now - last > _UPDATE and page.session.may_send(now):
                last, done = now, min(parts[0] + done * (parts[1] - parts[0]), 0.99)
                shown = picture.reshape(ny, nx, -1)
                self._send(page, shot, shown, now - start, done=done, level=level)

        def report(done: int, total: int) -> None:
            look_around(done / max(total, 1))

        if shot.projection:
            return shot.projected(shot.volume, report)
        in_blocks = options.get("memory") is not None
        steps = in_steps(
            shot.volume,
            shot.drawn,
            shot.camera,
            RenderOptions(progress=report if in_blocks else silent, **options),
            seconds=_BATCH,
        )
        while True:
            try:
                pixel, intensity, _ = next(steps)
            except StopIteration as end:
                image: Image = end.value
                return image
            made += len(pixel)
            if len(pixel) == nx * ny:  # what is drawn in pieces comes at once
                continue
            if picture is None:
                look_around(0.0)
                picture = self._first(shot, intensity.shape[-1], nx, ny)
            picture[pixel] = intensity
            look_around(min(made / (nx * ny), 1.0))

    def _quietly(self, shot: Shot, *, first_order: bool = False) -> np.ndarray:
        """Return a quick picture's intensities; warnings are for the picture at rest."""
        if shot.projection:
            with caught_warnings():
                return shot.projected(at_hand(shot.volume), False).intensity
        scheme, parts = shot.options.get("scheme"), shot.drawn.components()
        # No other scheme draws a surface without a width, or labels without their cells' edges.
        first_order &= not any(part.surface_only or part.discrete for part in parts)
        if first_order or not isinstance(shot.volume.grid, DualGrid):
            scheme = "first-order"
        elif scheme is None and shot.editing and not shot.drawn.discrete:
            # Where steps can be wide takes 30 ms to find out for 128³ cells, and saves 10.
            scheme = PreIntegrated(coarseness=0.0)
        quick = {"scheme": scheme, "tolerance": None, "samples": 1, "antialias": None}
        volume, options = at_hand(shot.volume), dict(shot.options)
        if volume is not shot.volume:
            quick |= {"level": None, "memory": None}
        with caught_warnings():
            options |= {**quick, "bounds": False, "progress": False}
            return render(volume, shot.drawn, shot.camera, **options).intensity

    def _first(self, shot: Shot, channels: int, nx: int, ny: int) -> np.ndarray:
        """Return what is shown of pixels that are not done: the quick picture, made larger."""
        small = shot.camera.within((max(1, nx // 2), max(1, ny // 2)))
        intensity = self._quietly(replace(shot, camera=small))
        rows, columns = (
            np.minimum(np.arange(n) * have // n, have - 1)
            for n, have in zip((ny, nx), intensity.shape[:2], strict=True)
        )
        larger: np.ndarray = intensity[rows][:, columns].reshape(ny * nx, channels).copy()
        return larger

    def _is_wanted_elsewhere(self, page: Page, shot: Shot, now: float) -> bool:
        if page.session.wanted != shot.wish:
            return True
        return any(other.session.wants_preview(now) for other in self._pages())

    def _send_image(
        self, page: Page, shot: Shot, image: Image, start: float, **options: Any
    ) -> None:
        error, brightness = image.error, np.abs(np.nan_to_num(image.intensity)).max(axis=-1)
        top = float(np.max(brightness, initial=0.0))
        worst = usual = None
        if error is not None and top > 0:
            worst = float(np.nanmax(error)) / top
            usual = float(np.median(error[brightness > _DARK * top])) / top
        level = (image.provenance or {}).get("level", 0)
        took, options = time.monotonic() - start, {**options, "error": worst, "usual": usual}
        self._send(page, shot, image.intensity, took, level=level, **options)

    def _send(
        self,
        page: Page,
        shot: Shot,
        intensity: np.ndarray,
        took: float,
        *,
        done: float,
        scale: float = 1.0,
        preview: bool = False,
        exact: bool = False,
        error: float | None = None,
        usual: float | None = None,
        level: int = 0,
    ) -> None:
        self._frame += 1
        head, payload = _coded(shot, intensity, exact)
        look = _look(shot)
        if look not in self._exposures:
            self._exposures[look] = Image(intensity).exposure
        message = {
            "kind": "frame",
            "number": self._frame,
            "n": shot.number,
            "revision": shot.revision,
            "camera": shot.table,
            "frame": geometry(shot.camera, shot.volume),
            "scale": scale,
            "done": done,
            "exact": exact,
            "error": error,
            "usual": usual,
            "level": level,
            "ms": 1000.0 * took,
            "exposure": self._exposures[look],
            **head,
        }
        now = time.monotonic()
        page.session.sent(self._frame, shot.wish, now, took, preview=preview)
        page.send(message, payload)


def _levels(shot: Shot) -> list[int]:
    """Return the levels that are drawn one after another; of most volumes all cells at once."""
    level = shot.options.get("level")
    if shot.projection:
        return [0]
    if level != "auto":
        return [0 if level is None else level]
    last = sufficient_level(shot.volume, shot.drawn, shot.camera)
    quick = at_hand(shot.volume)
    first = quick.meta["level"] if quick is not shot.volume else last
    return list(range(max(first, last), last - 1, -1))


_NOTHING = Coefficients(["0", "0", "0"], "0")


def _look(shot: Shot) -> str:
    """Return a key of what is seen, from wherever: its exposure stays while the camera moves."""
    return json.dumps([repr(shot.projection or shot.medium), id(shot.volume)])


def window_of(image: dict[str, Any]) -> tuple[float, float] | None:
    """Return the least and the largest value that a linear scale shows, if both are given."""
    low, high = image.get("vmin"), image.get("vmax")
    if image.get("norm") == "log" or not isinstance(low, (int, float)):
        return None
    return (low, high) if isinstance(high, (int, float)) else None


def _coded(shot: Shot, intensity: np.ndarray, exact: bool) -> tuple[dict[str, Any], bytes]:
    """Return the head and the bytes of a frame; in projections pixels without a value stay so."""
    if not shot.projection:
        return (float16 if exact else log_jpeg)(intensity)
    head: dict[str, Any] = {"how": shot.projection.get("how", "max")}
    if exact:
        more, payload = float16(intensity, missing=-np.inf)
    else:
        more, payload = linear_jpeg(intensity, shot.projection["window"])
    return head | more, payload


def geometry(camera: Camera, volume: Volume) -> dict[str, Any]:
    """Return the camera's axes and image plane, for what a page draws over a picture."""
    frame = camera.frame(volume.grid)
    first, right, up, last = frame.vectors[:4]
    parallel, target = camera.parallel, first
    if isinstance(camera, (Perspective, Panorama)):
        target = vector(camera.target, "target", volume.grid.unit)
    return {
        "center": target.tolist(),
        "position": None if parallel else first.tolist(),
        "right": right.tolist(),
        "up": up.tolist(),
        "ahead": (last if parallel else -last).tolist(),
        "width": frame.width[0],
        "height": frame.width[1],
        "shift": list(frame.shift),
    }
