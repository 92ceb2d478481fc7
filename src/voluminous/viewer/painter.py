"""Renders for all pages: quick pictures in one thread, full ones in another, which gives way.

What a full picture needs of a large volume takes seconds in calls that nothing interrupts: reading
it, ranges, tables. Pages turn meanwhile.
"""

from __future__ import annotations

import atexit
import contextlib
import json
import threading
import time
import warnings
import weakref
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Protocol

import numpy as np

from ..calibration.samples import BUDGET, measurable, side_by_side
from ..cameras import Camera, Panorama, Perspective
from ..cameras.contract import vector
from ..deferred import Deferred
from ..drawing.api import in_steps, render
from ..errors import VoluminousError
from ..grids.cartesian.grid import CartesianGrid
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
# Cells of a volume that is drawn while something moves: 256³. Of larger ones it is a level of the
# file, or every second, third … cell until the whole was drawn once: of 512³ after 0.3 s, not 20.
_AT_HAND = 1 << 24
# Of larger files a picture is drawn chunk by chunk: kernels take 4 bytes for each cell.
_IN_MEMORY = 1 << 28
# Sides of a chunk double from level to level.
_EIGHTH = 1 / 8
# Options without error control.
_ROUGH: dict[str, Any] = {"tolerance": None, "samples": 1, "antialias": None, "bounds": False}


class Page(Protocol):
    """A page that is painted for."""

    session: Session

    def send(self, message: dict[str, Any], payload: bytes = b"") -> None:
        """Send a message; called in the painter's threads."""
        ...

    def drew(self, volume: Volume) -> None:
        """All cells of a volume were drawn."""
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
        Arguments of `project`, if the picture is no rendering.
    window : (low, high), optional
        Of the values of a projection, which the page shows.
    whole : Volume, optional
        Of which `volume` is at hand.
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
    window: tuple[float, float] | None = None
    whole: Volume | None = None

    @property
    def look(self) -> str:
        """A key of what is seen, from wherever: its exposure stays while the camera moves."""
        return json.dumps([repr(self.projection or self.medium), id(self.whole or self.volume)])

    @property
    def drawn(self) -> Medium:
        """What `render` is given: a transparent medium, if none is drawn."""
        return _NOTHING if self.medium is None else self.medium

    @property
    def pixels(self) -> tuple[int, int]:
        """Pixels of the picture: no more than asked for, and fewer where its shape is fixed."""
        return self.camera.frame(self.volume.grid).pixels

    def projected(self, progress: Any) -> Image:
        """Return the projection."""
        options = {**self.options, "progress": progress}
        return drawn(self.volume, self.drawn, self.camera, self.projection, **options)


class _GivenUp(Exception):
    """Nobody wants the picture that is being drawn."""


def at_hand(volume: Volume, most: int = _AT_HAND) -> Volume:
    """Return the cells of quick answers: of a large volume a level of its file, or a sample."""
    if volume.grid.size <= most:
        return volume
    level = measurable(volume) if volume.waiting else volume
    return sampled(volume, most) if level is volume else level


def measured(volume: Volume) -> Volume:
    """Return in what numbers are measured: a volume that was read, else what is at hand."""
    return at_hand(volume) if volume.waiting else volume


def small(volume: Volume) -> Volume:
    """Return what a camera is framed for: 96 pixels need no more."""
    return sampled(measurable(volume), BUDGET)


def is_drawn_in_blocks(volume: Volume) -> bool:
    """Return whether pictures of a file are drawn chunk by chunk: it need not fit into memory."""
    large = bool(volume.waiting) and at_hand(volume) is not volume
    return large and (volume.grid.size > _IN_MEMORY or measurable(volume) is not volume)


_samples: weakref.WeakKeyDictionary[Volume, dict[int, Volume]] = weakref.WeakKeyDictionary()


def sampled(volume: Volume, most: int) -> Volume:
    """Return every second, third … cell of a Cartesian volume, so that there are no more than most.

    A sample has the histogram of all cells, and labels; means have neither. Fields are read when
    they are used.
    """
    grid = volume.grid
    if grid.size <= most or not isinstance(grid, CartesianGrid):
        return volume
    kept = _samples.setdefault(volume, {})
    if most not in kept:
        step = 2
        while np.prod([-(-n // step) for n in grid.shape]) > most:
            step += 1
        edges = [np.append(e[:-1:step], e[-1]) for e in grid.edges]
        sample = Volume(type(grid)(*edges, unit=grid.unit))
        for name in volume.fields:
            read = partial(_every, weakref.ref(volume), name, step)
            dtype = volume._fields.dtype(name)
            sample[name] = Deferred(read, dtype, volume.field_unit(name))
        sample.own()
        sample.meta.update({**volume.meta, "every": step})
        kept[most] = sample
    return kept[most]


def _every(volume: Callable[[], Volume | None], name: str, step: int) -> np.ndarray:
    """Return a sample of a field; one that is not read yet is read in slabs, and not kept."""
    whole = volume()
    assert whole is not None  # who looks at a sample holds its volume
    nx, *others = whole.grid.shape
    # The middle of a group, or what there is of the last one.
    first = [min((step - 1) // 2, (n - 1) % step) for n in (nx, *others)]
    slices = [slice(k, None, step) for k in first]
    if name not in whole.waiting:
        return np.ascontiguousarray(whole.array(name)[tuple(slices)])
    pieces = whole._fields.pieces(name)
    thick = ((pieces and pieces.chunks) or (16,))[0]
    thick = -(-thick // step) * step

    def some(low: int) -> np.ndarray:
        slab = whole.store.read(name, (low, 0, 0), (min(low + thick, nx), *others))
        return np.array(slab[tuple(slices)])

    return np.concatenate(list(side_by_side(some, range(0, nx, thick))))


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
    """The two threads that render.

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
        self.pages, self._shot = pages, shot
        self._woken, self._closed = threading.Condition(), False
        self._frame, self._sending = 0, threading.Lock()
        self._exposures: dict[str, float] = {}
        # What was drawn of all cells, so that it is quick now.
        self._whole: set[str] = set()
        works = (Session.wants_preview, self._preview), (Session.wants_rest, self._rest)
        self._threads = [
            threading.Thread(target=self._work, args=work, name="painter", daemon=True)
            for work in works
        ]
        for thread in self._threads:
            thread.start()
        # A kernel that runs while Python ends would abort the process.
        atexit.register(self.close)

    def wake(self) -> None:
        """Look for wishes: something has changed."""
        with self._woken:
            self._woken.notify_all()

    def close(self) -> None:
        """End after the batches that are being rendered."""
        self._closed = True
        self.wake()
        for thread in self._threads:
            thread.join(5.0)
        atexit.unregister(self.close)

    def _work(self, wants: Callable[[Session, float], bool], paint: Callable[[Page], None]) -> None:
        """Paint for the pages that want it, one after another."""
        turn = 0
        while not self._closed:
            now, pages = time.monotonic(), self.pages()
            turns = [(turn + k) % len(pages) for k in range(len(pages))]
            this = next((k for k in turns if wants(pages[k].session, now)), None)
            if paint == self._rest and any(now - p.session.changed_at < QUIET for p in pages):
                this = None
            if this is None:
                if paint == self._rest:
                    self._read_ahead(pages)
                with self._woken:
                    self._woken.wait(QUIET / 4)
                continue
            turn = this + 1
            try:
                paint(pages[this])
            except _GivenUp:
                continue
            except Exception as error:
                self._tell(pages[this], error)

    def _read_ahead(self, pages: list[Page]) -> None:
        """Read what full pictures need while a hand drags the first one."""
        for page in pages:
            if not page.session.shown or page.session.ahead:
                continue
            page.session.ahead = True
            with contextlib.suppress(Exception):  # the full picture tells of it
                shot = self._shot(page, page.session.size)
                if shot.options.get("memory") is None and self._quick(shot) is not shot:
                    for name in shot.volume.given(shot.drawn.names):
                        shot.volume.array(name)

    def _tell(self, page: Page, error: Exception) -> None:
        session = page.session
        session.shown = session.rested = session.wanted
        text = (
            str(error) if isinstance(error, VoluminousError) else f"{type(error).__name__}: {error}"
        )
        page.send({"kind": "notice", "level": "error", "text": text})

    def _preview(self, page: Page) -> None:
        session = page.session
        shot = self._quick(self._shot(page, session.preview_size))
        start = time.monotonic()
        intensity = _quietly(shot, first_order=session.first_order)
        took = time.monotonic() - start
        scale = session.preview_size[0] / session.size[0]
        self._send(page, shot, intensity, took, scale=scale, done=0.0, preview=True)

    def _quick(self, shot: Shot) -> Shot:
        """Return the shot of what is at hand; of all cells where they were drawn before."""
        quick = at_hand(shot.volume)
        if quick is shot.volume or shot.look in self._whole:
            return shot
        options = {**shot.options, "level": None, "memory": None}
        return replace(shot, volume=quick, options=options, whole=shot.volume)

    def _rest(self, page: Page) -> None:
        """Render the full picture: first without error control, which is as good to the eye.

        Then of large files from coarse levels to the one that suffices. It is given up where
        somebody else wants one.
        """
        shot = self._shot(page, page.session.size)
        start, last = time.monotonic(), shot
        image: Image | None = None
        in_memory, quick = shot.options.get("memory") is None, self._quick(shot)
        rough = [quick] if quick is not shot else []
        rough += [shot] if in_memory and _is_controlled(shot) else []
        levels = _levels(shot)
        work = np.cumsum([0.0] + [_EIGHTH**level for level in levels])
        parts = zip(levels, *(work[k:][: len(levels)] / work[-1] for k in (0, 1)), strict=True)
        steps: list[tuple[Shot, int, float, float]] = [
            (replace(one, options={**one.options, **_ROUGH, "scheme": _scheme(one)}), 0, 0.0, 0.0)
            for one in rough
        ] + [(shot, *part) for part in parts]
        for one, level, begun, ended in steps:
            with caught_warnings() as caught:  # of a picture without error control they come again
                try:
                    made = self.draw_level(page, one, level, image, start, (begun, ended))
                except VoluminousError as error:
                    if image is None:
                        raise
                    caught.append(f"{_cells_of(last, image)} is shown: {error}")
                    break
            image, last = made, one
            self._drew(one)
            if ended < 1.0 and (one is not shot or page.session.may_send(time.monotonic())):
                fine = one is not shot and page.session.is_near
                self._send_image(page, one, image, start, done=ended, fine=fine)
        assert image is not None
        self._exposures[shot.look] = image.exposure
        self._send_image(page, last, image, start, done=1.0, exact=True)
        for text in caught:
            page.send({"kind": "notice", "level": "warning", "text": text})
        if in_memory and last is shot:
            page.drew(shot.volume)

    def _drew(self, shot: Shot) -> None:
        """Note that all cells are quick to draw from now on."""
        if shot.whole is None and shot.options.get("memory") is None:
            self._whole.add(shot.look)

    def draw_level(
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
            options["level"], quick = level, at_hand(shot.volume)
            if "every" not in quick.meta and level == quick.meta.get("level", 0):
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
            return shot.projected(report)
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
            if picture is not None:
                picture[pixel] = intensity
            look_around(min(made / (nx * ny), 1.0))

    def _is_wanted_elsewhere(self, page: Page, shot: Shot, now: float) -> bool:
        if page.session.wanted != shot.wish:
            return True
        return any(other.session.wants_preview(now) for other in self.pages())

    def _send_image(
        self, page: Page, shot: Shot, image: Image, start: float, **options: Any
    ) -> None:
        top = float(np.max(np.abs(np.nan_to_num(image.intensity)), initial=0.0))
        if image.error is not None and top > 0:
            options["error"] = float(np.nanmax(image.error)) / top
        took, level = time.monotonic() - start, _level_of(shot, image)
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
        fine: bool = False,
        error: float | None = None,
        level: int = 0,
    ) -> None:
        session = page.session
        head, payload = _coded(shot, intensity, exact or fine)
        if (look := shot.look) not in self._exposures:
            self._exposures[look] = Image(intensity).exposure
        message = {
            "kind": "frame",
            "n": shot.number,
            "revision": shot.revision,
            "camera": shot.table,
            "frame": geometry(shot.camera, shot.volume),
            "scale": scale,
            "done": done,
            "error": error,
            "level": level,
            "every": shot.volume.meta.get("every", 1),
            "ms": 1000.0 * took,
            "exposure": self._exposures[look],
            **head,
        }
        with self._sending:  # what is sent later has the larger number, and shows no older input
            if shot.wish < session.shown:
                raise _GivenUp
            self._frame += 1
            session.sent(self._frame, shot.wish, time.monotonic(), took, preview, exact)
            message |= {"number": self._frame, "exact": exact and session.is_exact}
            page.send(message, payload)


def _is_controlled(shot: Shot) -> bool:
    """Return whether a picture without error control is another, quicker one."""
    post = shot.options.get("scheme") in (None, "post-classified")
    rays = shot.options.get("samples", 1), shot.options.get("antialias")
    return not shot.projection and (post or rays != (1, None))


def _scheme(shot: Shot) -> Any:
    """Return the scheme of a picture without error control."""
    scheme = shot.options.get("scheme")
    if scheme is None and not shot.drawn.discrete and (shot.editing or shot.whole is not None):
        # Where steps can be wide takes 30 ms to find out for 128³ cells, and saves 10.
        scheme = PreIntegrated(coarseness=0.0)
    return scheme


def _quietly(shot: Shot, *, first_order: bool = False) -> np.ndarray:
    """Return a quick picture's intensities; warnings are for the picture at rest."""
    if shot.projection:
        with caught_warnings():
            return shot.projected(False).intensity
    # No other scheme draws a surface without a width, or labels without their cells' edges.
    parts = shot.drawn.components()
    first_order &= not any(part.surface_only or part.discrete for part in parts)
    first_order |= not isinstance(shot.volume.grid, DualGrid)
    scheme = "first-order" if first_order else _scheme(shot)
    with caught_warnings():
        options = {**shot.options, **_ROUGH, "scheme": scheme, "progress": False}
        return render(shot.volume, shot.drawn, shot.camera, **options).intensity


def _level_of(shot: Shot, image: Image) -> int:
    level: int = (image.provenance or {}).get("level") or shot.volume.meta.get("level", 0)
    return level


def _cells_of(shot: Shot, image: Image) -> str:
    """Return which cells a picture shows."""
    every = shot.volume.meta.get("every", 1)
    return f"one of {every}³ cells" if every > 1 else f"level {_level_of(shot, image)} of the file"


def _levels(shot: Shot) -> list[int]:
    """Return the levels that are drawn one after another; of most volumes all cells at once."""
    level = shot.options.get("level")
    if shot.projection:
        return [0]
    if level != "auto":
        return [0 if level is None else level]
    last = sufficient_level(shot.volume, shot.drawn, shot.camera)
    quick = at_hand(shot.volume)
    first = quick.meta.get("level", last) if quick is not shot.volume else last
    return list(range(max(first, last), last - 1, -1))


_NOTHING = Coefficients(["0", "0", "0"], "0")


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
        more, payload = linear_jpeg(intensity, shot.window)
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
