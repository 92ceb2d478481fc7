"""Answers the messages of pages. Knows neither sockets nor notebooks: see `page` and `widget`."""

from __future__ import annotations

import contextlib
import json
import threading
import time
import warnings
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from ..calibration import presets
from ..cameras import Camera
from ..cameras.contract import pixel_counts
from ..cameras.views import VIEWS, view_angles
from ..drawing.api import first_medium
from ..errors import InputError, VoluminousError
from ..image.metadata import oriented
from ..io import open as open_volume
from ..media import Medium
from ..rendering import framed
from ..scene import Scene
from ..scene.sections import build_camera, build_medium, projection, render_options
from ..scene.settings import SECTIONS, plain_value
from ..units import unit_name
from ..volume import Volume
from .document import Document, Patch, shown
from .painter import (
    Painter,
    Shot,
    at_hand,
    caught_warnings,
    is_drawn_in_blocks,
    measured,
    small,
    window_of,
)
from .questions import QUESTIONS, number
from .script import IN_MEMORY
from .session import Session
from .share import tables_of, text_of

PROTOCOL = 1
# Seconds after a change of a medium in which another is expected.
_EDITED = 1.0
# Changes a second; more are a fault or an attack.
_MOST_INPUTS = 240
# Warnings of one answer: each picture of a film may have its own.
_MOST_WARNINGS = 3
# What a picture may take of a volume that need not be in memory.
_MEMORY = "1 GiB"
_MAPS = ("viridis", "inferno", "magma", "cividis", "gray", "coolwarm", "turbo")

Send = Callable[[dict[str, Any], bytes], None]


class Explorer:
    """A scene, the pages that show it, and the painter.

    Parameters
    ----------
    volume : Volume, path, or sequence of them
        A sequence is a series in time.
    medium : Medium, optional
        By default `suggest_medium` finds one.
    camera : Camera, optional
        By default the visible part is seen from obliquely above.
    settings : dict, optional
        Other sections of a scene file: ``volume``, ``render``, ``image``.
    opener : callable, optional
        Returns the volume at a path, by default as `voluminous.open`.
    """

    def __init__(
        self,
        volume: Any,
        medium: Medium | None = None,
        camera: Camera | None = None,
        settings: dict[str, Any] | None = None,
        opener: Callable[[Any], Volume] = open_volume,
    ) -> None:
        self._opener = opener
        self.series = list(volume) if isinstance(volume, (list, tuple)) else [volume]
        self.index = 0
        self.volume = self._opened(0)
        medium = first_medium(measured(self.volume)) if medium is None else medium
        # The first page's shape decides what a camera sees that nobody has given.
        self._framed = camera is not None
        camera = framed(small(self.volume), medium) if camera is None else camera
        others = settings or {}
        rest = dict(others.get("render", {}))
        if is_drawn_in_blocks(self.volume):
            rest = {"level": "auto", "memory": _MEMORY, **rest}
        if isinstance(rest.get("background"), str):
            rest.pop("background")
            warnings.warn("the explorer shows no picture as background", stacklevel=2)
        parts: list[Any] = [part for part in medium.components() if part.discrete]
        labels = {"labels": parts[0].expr.text} if parts else {}
        self.document = Document(
            {
                "volume": others.get("volume") or self._source(),
                "medium": tables_of(medium),
                "project": dict(others.get("project", {})),
                "camera": _view(camera),
                "render": rest,
                "image": dict(others.get("image", {})),
                "bookmarks": list(others.get("bookmarks", [])),
                "measures": list(others.get("measures", [])),
                "slices": {**labels, **others.get("slices", {})},
            },
            check_medium=self._check,
        )
        self._lock = threading.RLock()
        self._clients: list[Client] = []
        self.active_at, self.edited_at = time.monotonic(), -1e9
        self.painter = Painter(lambda: list(self._clients), self.shot)
        self.desk = ThreadPoolExecutor(1, thread_name_prefix="desk")
        self._teller = ThreadPoolExecutor(1, thread_name_prefix="teller")
        self.counter = ThreadPoolExecutor(1, thread_name_prefix="counter")
        self._untold: set[Client] = set()
        self.filming = threading.Lock()
        # The volume of which pages know the ranges of a sample.
        self.sampled: Volume | None = None

    def _opened(self, index: int) -> Volume:
        one = self.series[index]
        return one if isinstance(one, Volume) else self._opener(one)

    def _check(self, medium: Medium) -> None:
        for feature in medium.known_features():
            self.volume.check_names(feature.expr)
            self.volume.expression_unit(feature.expr)

    def frame_for(self, size: tuple[int, int]) -> None:
        """Fit the first camera to a page's picture, if none was given and it has a size."""
        if not self._framed and min(size) > 1:
            self._framed = True
            view = _view(framed(small(self.volume), self.medium, resolution=size))
            with self._lock:
                self.document.look(view)

    def _source(self) -> dict[str, Any]:
        one = self.series[self.index]
        return {"path": IN_MEMORY if isinstance(one, Volume) else str(one)}

    @property
    def medium(self) -> Medium | None:
        """What is drawn; None if all media are hidden."""
        tables = shown(self.document.settings)
        made: Medium | None = build_medium(tables) if tables else None
        return made

    @property
    def channels(self) -> int:
        """How many numbers a pixel has."""
        return 1 if self.document.settings.get("project") else getattr(self.medium, "channels", 3)

    @property
    def camera(self) -> Camera:
        """From where the page that moved last looks."""
        made: Camera = build_camera(self.document.settings["camera"])
        return made

    def scene(
        self, resolution: int | tuple[int, int] | None = None, page: Client | None = None
    ) -> Scene:
        """Return what is on the screen as a scene: of a page, or of that which moved last."""
        with self._lock:
            settings, volume = self.document.settings, self.volume
            camera = dict(settings["camera"] if page is None else page.session.camera)
        if resolution is not None:
            fitted = build_camera(camera).within(pixel_counts(resolution))
            camera["resolution"] = plain_value(fitted.arguments()["resolution"])
        settings = {k: v for k, v in settings.items() if k in SECTIONS}
        return Scene({**settings, "medium": shown(settings), "camera": camera}, volume=volume)

    def close(self) -> None:
        """End the painter."""
        self.painter.close()
        self.desk.shutdown(wait=False, cancel_futures=True)
        self._teller.shutdown(wait=False, cancel_futures=True)
        self.counter.shutdown(wait=False, cancel_futures=True)

    # --- pages --------------------------------------------------------------------------------

    def connect(self, send: Send) -> Client:
        """Return the client of a new page; `send` may be called in any thread."""
        client = Client(self, send)
        with self._lock:
            self._clients.append(client)
        return client

    def leave(self, client: Client) -> None:
        with self._lock:
            if client in self._clients:
                self._clients.remove(client)
        self.active_at = time.monotonic()

    @property
    def pages(self) -> int:
        """Number of pages."""
        return len(self._clients)

    def shot(self, page: Any, size: tuple[int, int]) -> Shot:
        with self._lock:
            settings, revision = self.document.settings, self.document.revision
            wish, number = page.session.wanted, page.session.input
            table = page.session.camera
            volume, medium = self.volume, self.medium
        camera = build_camera(table).within(size)
        options = render_options(settings.get("render", {}))
        editing = time.monotonic() - self.edited_at < _EDITED
        how = projection(settings.get("project", {}))
        window = window_of(settings.get("image", {}))
        made = volume, medium, camera, options, wish, number, revision, table
        return Shot(*made, editing, how, window)

    def changed(self, by: Client | None, *, moving: bool = False) -> None:
        """Tell all pages of the new document, and paint it."""
        now = time.monotonic()
        self.tell(*self._clients)
        for client in list(self._clients):
            if client is not by:
                client.session.want(now, moving=moving)
        self.painter.wake()

    def tell(self, *clients: Client) -> None:
        """Send the document to pages: once for all changes until it is sent."""
        with self._lock, contextlib.suppress(RuntimeError):  # the explorer is closed
            if not self._untold:
                self._teller.submit(self._tell)
            self._untold.update(clients)

    def _tell(self) -> None:
        with self._lock:
            newest = {client: client.session.input for client in self._untold}
            self._untold.clear()
            settings, volume, index = self.document.settings, self.volume, self.index
            revision, painted = self.document.revision, self.document.painted
            undo, redo = self.document.labels
        message = {
            "kind": "document",
            "document": settings,
            "revision": revision,
            "painted": painted,
            "time": index,
            "undo": undo,
            "redo": redo,
            "channels": self.channels,
            "open": _open_numbers(settings["medium"], measured(volume)),
        }
        for client, newest_input in newest.items():
            client.send({**message, "n": newest_input})

    def answer_next(self) -> None:
        """Answer a question, of the page that has waited for the longest time."""
        if waiting := [client for client in list(self._clients) if client.questions]:
            client = min(waiting, key=lambda one: one.answered_at)
            client.answered_at = time.monotonic()
            client.answer(client.questions.popleft())

    def show_volume(self) -> None:
        """Tell the pages which volume it is now."""
        message = {"kind": "volume", "volume": self.describe()}
        for client in list(self._clients):
            client.send(message)

    def describe(self) -> dict[str, Any]:
        """Return what a page needs to know of the volume."""
        volume, quick, fields = self.volume, at_hand(self.volume), []
        self.sampled = volume if "every" in quick.meta and volume.waiting else None
        for name in volume.fields:
            looked = quick if name in volume.waiting else volume
            ranges = volume.store.extremes(name) if looked is not volume else None
            if ranges is not None:
                low, high = number(ranges[..., 0].min()), number(ranges[..., 1].max())
            elif name in looked.waiting:
                low = high = None
            else:
                array = looked.array(name)
                low, high = (number(f(array)) for f in (np.nanmin, np.nanmax))
            unit = unit_name(volume.field_unit(name))
            fields.append({"name": name, "unit": unit, "min": low, "max": high})
        source = self.document.settings["volume"]
        return {
            "name": " + ".join(Path(str(one)).name for one in _listed(source)),
            "unit": unit_name(volume.unit),
            "bounds": volume.grid.bounds.tolist(),
            "shape": list(getattr(volume.grid, "shape", ())),
            "cells": volume.grid.size,
            "grid": type(volume.grid).__name__,
            "fields": fields,
            "coordinates": list(volume.coordinates),
            **oriented(volume.meta),
            "views": _named_views(volume.meta),
            "y_down": bool(volume.meta.get("y_down")),
        }


class Client:
    """One page: its session, and what it asks."""

    def __init__(self, explorer: Explorer, send: Send) -> None:
        self.explorer, self._send = explorer, send
        self.session = Session(dict(explorer.document.settings["camera"]), visible=False)
        self._inputs: list[float] = []
        self.questions: deque[dict[str, Any]] = deque()
        self.answered_at = -1e9
        self._cancelled: set[Any] = set()
        self._closed = False

    def send(self, message: dict[str, Any], payload: bytes = b"") -> None:
        self._send(message, payload)

    def drew(self, volume: Volume) -> None:
        """Tell pages the ranges of all cells, once."""
        if self.explorer.sampled is volume:
            self.explorer.show_volume()

    def close(self) -> None:
        """The page is gone."""
        self._closed = True
        self.explorer.leave(self)

    def receive(self, message: Any) -> None:
        """Answer a message; errors are sent as a notice, or as the reply to a question."""
        self.explorer.active_at = time.monotonic()
        if not isinstance(message, dict) or not isinstance(message.get("kind"), str):
            self.notice("error", "a message must be a text: an object, as JSON, with a kind")
            return
        kind = message["kind"]
        question = kind in QUESTIONS
        known = ("id", *QUESTIONS[kind][1]) if question else _KINDS.get(kind)
        if known is None or not set(message) <= {"kind", *known}:
            self.notice("error", f"unknown message {kind!r:.200}, or unknown keys in it")
            return
        try:  # pages are sent what is in the document, and their JSON has no infinity
            json.dumps(message, allow_nan=False)
        except (TypeError, ValueError, RecursionError):
            self._refuse(f"{kind}: numbers must be finite, and lists not so deep", message)
            return
        try:
            if "n" in known:
                message = {**message, "n": int(message["n"])}
            if kind == "measure":  # of all cells: beside other questions, and it can be cancelled
                self.explorer.counter.submit(self.answer, message)
            elif question and kind != "film":
                # A preset that was clicked does not wait for the pictures of others.
                (self.questions.appendleft if kind == "suggest" else self.questions.append)(message)
                self.explorer.desk.submit(self.explorer.answer_next)
            else:
                getattr(self, f"_{kind}")(message)
        except Exception as error:  # an answer must come, or the page waits
            text = str(error) if isinstance(error, VoluminousError) else f"{kind}: {error}"
            if question:
                self.send({"kind": "reply", "id": message.get("id"), "error": text})
            else:
                self._refuse(text, message)

    def _refuse(self, text: str, message: dict[str, Any]) -> None:
        refused = {"n": message["n"]} if isinstance(message.get("n"), int) else {}
        self.session.input = max([self.session.input, *refused.values()])
        self.notice("error", text, **refused)
        self.explorer.tell(self)

    def notice(self, level: str, text: str, **rest: Any) -> None:
        """Tell the user something; `n` is the number of the input that was refused."""
        self.send({"kind": "notice", "level": level, "text": text, **rest})

    # --- inputs -------------------------------------------------------------------------------

    def _hello(self, message: dict[str, Any]) -> None:
        if message.get("protocol") != PROTOCOL:
            self.notice("error", "this page is of another version; load it again")
            return
        explorer, session = self.explorer, self.session
        session.resize(message.get("size", (400, 400)), message.get("scale", 1.0))
        session.leader = message.get("leader") is not False
        session.visible = True
        explorer.frame_for(session.size)
        session.camera = dict(explorer.document.settings["camera"])
        volume = explorer.volume
        suited, notes = presets.recognised(measured(volume))
        self.send(
            {
                "kind": "welcome",
                "protocol": PROTOCOL,
                "document": explorer.document.settings,
                "revision": explorer.document.revision,
                "painted": explorer.document.painted,
                "volume": explorer.describe(),
                "series": {"count": len(explorer.series), "index": explorer.index},
                "time": explorer.index,
                "presets": [*suited, *(n for n in presets.__all__ if n not in suited)],
                "suited": len(suited),
                "notes": [*volume.meta.get("notes", ()), *notes],
                "channels": explorer.channels,
                "colormaps": _colormaps(),
            }
        )
        explorer.tell(self)
        session.want(time.monotonic())
        explorer.painter.wake()

    def _look(self, message: dict[str, Any]) -> None:
        explorer, moving = self.explorer, message.get("moving") is True
        self._check_change()
        camera = {key: v for key, v in dict(message["camera"]).items() if key != "resolution"}
        now = time.monotonic()
        with explorer._lock:
            explorer.document.look(camera)
            self.session.camera = camera
            self.session.want(now, moving=moving, number=message["n"])
            for other in explorer._clients:
                if not other.session.leader:
                    other.session.camera = camera
                    other.session.want(now, moving=moving)
        explorer.painter.wake()

    def _size(self, message: dict[str, Any]) -> None:
        self.session.resize(message["size"], message.get("scale", 1.0))
        if not self.explorer._framed:
            self.explorer.frame_for(self.session.size)
            self.session.camera = dict(self.explorer.document.settings["camera"])
        self.session.want(time.monotonic(), number=message["n"])
        self.explorer.painter.wake()

    def _set(self, message: dict[str, Any]) -> None:
        patch = [(str(path), value) for path, value in message["patch"]]
        with self.explorer._lock:  # a document says which input is the newest in it
            self.change(patch, str(message.get("label", "")), moving=message.get("moving") is True)
            self.session.input = message["n"]

    def change(self, patch: Patch, label: str, *, moving: bool = False) -> None:
        """Change the document, and paint it for all pages."""
        explorer = self.explorer
        self._check_change()
        with explorer._lock:
            painted = explorer.document.painted
            explorer.document.apply(patch, label, moving=moving)
            if any(path.startswith("camera") for path, _ in patch):
                for client in explorer._clients:
                    client.session.camera = dict(explorer.document.settings["camera"])
            if explorer.document.painted == painted:
                explorer.tell(*explorer._clients)
                return
            self.session.want(time.monotonic(), moving=moving)
            explorer.edited_at = time.monotonic()
            explorer.changed(self, moving=moving)

    def _undo(self, message: dict[str, Any]) -> None:
        self._step(message, self.explorer.document.undo)

    def _redo(self, message: dict[str, Any]) -> None:
        self._step(message, self.explorer.document.redo)

    def _step(self, message: dict[str, Any], step: Callable[[], bool]) -> None:
        self._check_change()
        with self.explorer._lock:
            stepped, self.session.input = step(), message["n"]
            if stepped:
                self.session.want(time.monotonic())
                self.explorer.changed(self)
            else:
                self.explorer.tell(self)

    def _seen(self, message: dict[str, Any]) -> None:
        self.session.seen(int(message["frame"]), time.monotonic())
        self.explorer.painter.wake()

    def _visible(self, message: dict[str, Any]) -> None:
        self.session.visible = message["on"] is True
        self.explorer.painter.wake()

    def _time(self, message: dict[str, Any]) -> None:
        explorer, index = self.explorer, int(message["index"])
        self._check_change()
        if not 0 <= index < len(explorer.series):
            raise InputError(f"there is no file {index}; there are {len(explorer.series)}")
        volume = explorer._opened(index)
        with explorer._lock:
            explorer.index, explorer.volume, self.session.input = index, volume, message["n"]
            explorer.document.settings["volume"] |= explorer._source()
            explorer.document.grow()
            explorer.changed(None)
        explorer.show_volume()

    def _check_change(self) -> None:
        if not self.session.leader:
            raise InputError("this page follows another one, and changes nothing")
        now = time.monotonic()
        self._inputs = [at for at in self._inputs if now - at < 1.0]
        if len(self._inputs) >= _MOST_INPUTS:
            raise InputError(f"more than {_MOST_INPUTS} changes in a second: one was not made")
        self._inputs.append(now)

    # --- questions ----------------------------------------------------------------------------

    def answer(self, message: dict[str, Any]) -> None:
        answer, _ = QUESTIONS[message["kind"]]
        identity = message.get("id")
        reply = {"kind": "reply", "id": identity}

        def progress(done: int, total: int) -> None:
            if self._closed or identity in self._cancelled:
                raise InputError("cancelled")
            self.send({"kind": "progress", "id": identity, "done": done / max(total, 1)})

        with caught_warnings() as caught:
            try:
                reply |= answer(self, message, progress)
            except VoluminousError as error:
                reply["error"] = str(error)
            except Exception as error:  # an answer must come, or the page waits
                reply["error"] = f"{type(error).__name__}: {error}"
        for text in list(dict.fromkeys(caught))[:_MOST_WARNINGS]:
            self.notice("warning", text)
        self.send(reply)

    def _film(self, message: dict[str, Any]) -> None:
        explorer = self.explorer
        self._check_change()
        if not explorer.filming.acquire(blocking=False):
            raise InputError("one film at a time: wait for the other, or cancel it")

        def make() -> None:
            try:
                self.answer(message)
            finally:
                explorer.filming.release()

        threading.Thread(target=make, name="film", daemon=True).start()

    def _cancel(self, message: dict[str, Any]) -> None:
        self._cancelled.add(message["of"])


# Keys of all other messages of a page.
_KINDS: dict[str, tuple[str, ...]] = {
    "hello": ("protocol", "size", "scale", "leader"),
    "look": ("n", "camera", "moving"),
    "size": ("n", "size", "scale"),
    "set": ("n", "patch", "moving", "label"),
    "undo": ("n",),
    "redo": ("n",),
    "seen": ("frame",),
    "visible": ("on",),
    "time": ("n", "index"),
    "cancel": ("of",),
}


def _open_numbers(tables: list[dict[str, Any]], volume: Volume) -> dict[str, float]:
    """Return the numbers that stand for "auto", as measured in the volume."""
    found = {}
    for k, table in enumerate(tables):
        if table.get("path_length", "auto") != "auto" or table.get("hidden"):
            continue
        medium = build_medium([table])
        if medium.path_length == "auto":
            with contextlib.suppress(Exception):  # the painter tells it
                found[f"medium.{k}.path_length"] = float(medium.calibrated(volume).path_length)
    return found


def _named_views(meta: dict[str, Any]) -> dict[str, dict[str, float]]:
    """Return the angles of those views that a volume knows by name."""
    views = {}
    for name in VIEWS:
        with contextlib.suppress(InputError):  # it does not say how it lies
            views[name] = view_angles(meta, name)
    return views


def _view(camera: Camera) -> dict[str, Any]:
    """Return a camera's table without its pixels: each page has its own."""
    return {key: value for key, value in camera.describe().items() if key != "resolution"}


def _listed(source: dict[str, Any]) -> list[Any]:
    path = source.get("path") or source.get("model")
    return path if isinstance(path, list) else [path]


def _colormaps() -> dict[str, str]:
    import matplotlib

    places = np.linspace(0.0, 1.0, 256)
    return {
        name: text_of(
            (matplotlib.colormaps[name](places)[:, :3] * 255 + 0.5).astype(np.uint8).tobytes()
        )
        for name in _MAPS
    }
