"""Answers the messages of pages. Knows neither sockets nor notebooks: see `page` and `widget`."""

from __future__ import annotations

import base64
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from ..calibration import presets, suggest_medium
from ..cameras import Camera
from ..errors import InputError, VoluminousError
from ..expressions import Expression
from ..io import open as open_volume
from ..measuring import probe
from ..media import Medium
from ..rendering import framed
from ..rendering.framing import first_medium
from ..scene import Scene
from ..scene.sections import build_camera, build_medium, render_options
from ..scene.settings import plain_value
from ..units import unit_name
from ..volume import Volume
from .document import Document, shown
from .painter import Painter, Shot
from .session import Session
from .share import IN_MEMORY, exported

PROTOCOL = 1
_MOST_BINS, _MOST_SIDE = 4096, 8192
# Cells of a histogram; of more, every second, third …
_MOST_CELLS = 1 << 24
# Seconds after a change of a medium in which another is expected.
_EDITED = 1.0
# Inputs a second; more are a fault or an attack.
_MOST_INPUTS = 240
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
    """

    def __init__(
        self,
        volume: Any,
        medium: Medium | None = None,
        camera: Camera | None = None,
        settings: dict[str, Any] | None = None,
    ) -> None:
        self.series = list(volume) if isinstance(volume, (list, tuple)) else [volume]
        self.index = 0
        self.volume = self._opened(0)
        medium = first_medium(self.volume) if medium is None else medium
        # The first page's shape decides what a camera sees that nobody has given.
        self._framed = camera is not None
        camera = framed(self.volume, medium) if camera is None else camera
        others = settings or {}
        self.document = Document(
            {
                "volume": others.get("volume") or self._source(),
                "medium": tables_of(medium),
                "camera": _view(camera),
                "render": dict(others.get("render", {})),
                "image": dict(others.get("image", {})),
                "bookmarks": list(others.get("bookmarks", [])),
            },
            check_medium=self._check,
        )
        self._lock = threading.RLock()
        self._clients: list[Client] = []
        self.active_at, self.edited_at = time.monotonic(), -1e9
        self.painter = Painter(lambda: list(self._clients), self._shot)
        self.desk = ThreadPoolExecutor(1, thread_name_prefix="desk")

    def _opened(self, index: int) -> Volume:
        one = self.series[index]
        return one if isinstance(one, Volume) else open_volume(one)

    def _check(self, medium: Medium) -> None:
        """Refuse a medium with fields or units that the volume does not have."""
        for feature in medium.known_features():
            self.volume.check_names(feature.expr)
            self.volume.expression_unit(feature.expr)

    def frame_for(self, size: tuple[int, int]) -> None:
        """Fit the first camera to a page's picture, if none was given."""
        if not self._framed:
            self._framed = True
            self.document.look(_view(framed(self.volume, self.medium, resolution=size)))

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
    def camera(self) -> Camera:
        """From where the page that moved last looks."""
        made: Camera = build_camera(self.document.settings["camera"])
        return made

    def scene(self, resolution: int | tuple[int, int] | None = None) -> Scene:
        """Return what is on the screen as a scene."""
        settings = {k: v for k, v in self.document.settings.items() if k != "bookmarks"}
        camera = dict(settings["camera"])
        if resolution is not None:
            camera["resolution"] = plain_value(resolution)
        settings |= {"medium": shown(settings), "camera": camera}
        return Scene(settings, volume=self.volume)

    def close(self) -> None:
        """End the painter."""
        self.painter.close()
        self.desk.shutdown(wait=False, cancel_futures=True)

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

    def _shot(self, page: Any, size: tuple[int, int]) -> Shot:
        with self._lock:
            settings, revision = self.document.settings, self.document.revision
            wish, number = page.session.wanted, page.session.input
            table = page.session.camera
            volume, medium = self.volume, self.medium
        camera = build_camera({**table, "resolution": list(size)})
        options = render_options(settings.get("render", {}))
        editing = time.monotonic() - self.edited_at < _EDITED
        return Shot(volume, medium, camera, options, wish, number, revision, table, editing)

    def changed(self, by: Client | None, *, moving: bool = False) -> None:
        """Tell all pages of the new document, and paint it."""
        now = time.monotonic()
        for client in list(self._clients):
            client.tell_document()
            if client is not by:
                client.session.want(now, moving=moving)
        self.painter.wake()

    def describe(self) -> dict[str, Any]:
        """Return what a page needs to know of the volume."""
        volume = self.volume
        fields = []
        for name in volume.fields:
            if name in volume.waiting:
                low = high = None
            else:
                array = volume.array(name)
                low, high = (_number(f(array)) for f in (np.nanmin, np.nanmax))
            unit = unit_name(volume.field_unit(name))
            fields.append({"name": name, "unit": unit, "min": low, "max": high})
        source = self.document.settings["volume"]
        return {
            "name": Path(str(source.get("path") or source.get("model"))).name,
            "unit": unit_name(volume.unit),
            "bounds": volume.grid.bounds.tolist(),
            "shape": list(getattr(volume.grid, "shape", ())),
            "cells": int(np.prod(volume.array(volume.fields[0]).shape)) if volume.fields else 0,
            "grid": type(volume.grid).__name__,
            "fields": fields,
            "coordinates": list(volume.coordinates),
        }


class Client:
    """One page: its session, and what it asks."""

    def __init__(self, explorer: Explorer, send: Send) -> None:
        self.explorer, self._send = explorer, send
        self.session = Session(dict(explorer.document.settings["camera"]), visible=False)
        self._inputs: list[float] = []

    def send(self, message: dict[str, Any], payload: bytes = b"") -> None:
        self._send(message, payload)

    def close(self) -> None:
        """The page is gone."""
        self.explorer.leave(self)

    def receive(self, message: Any) -> None:
        """Answer a message; errors are sent as a notice, or as the reply to a question."""
        self.explorer.active_at = time.monotonic()
        if not isinstance(message, dict) or not isinstance(message.get("kind"), str):
            self.notice("error", "a message must be an object with a kind")
            return
        kind = message["kind"]
        known = _KINDS.get(kind)
        if known is None or not set(message) <= {"kind", *known}:
            self.notice("error", f"unknown message {kind!r}, or unknown keys in it")
            return
        try:
            if "id" in known:
                self.explorer.desk.submit(self._answer, message)
            else:
                getattr(self, f"_{kind}")(message)
        except VoluminousError as error:
            self.notice("error", str(error))
            self.tell_document()
        except (TypeError, ValueError, KeyError, IndexError) as error:
            self.notice("error", f"{kind}: {error}")

    def notice(self, level: str, text: str) -> None:
        self.send({"kind": "notice", "level": level, "text": text})

    def tell_document(self) -> None:
        """Send the document."""
        document = self.explorer.document
        undo, redo = document.labels
        medium = self.explorer.medium
        self.send(
            {
                "kind": "document",
                "document": document.settings,
                "revision": document.revision,
                "n": self.session.input,
                "undo": undo,
                "redo": redo,
                "channels": 3 if medium is None else medium.channels,
                "open": self._open_numbers(),
            }
        )

    def _open_numbers(self) -> dict[str, float]:
        """Return the numbers that stand for "auto", as measured in the volume."""
        found = {}
        for k, table in enumerate(self.explorer.document.settings["medium"]):
            if table.get("path_length", "auto") != "auto" or table.get("hidden"):
                continue
            medium = build_medium([table])
            if medium.path_length == "auto":
                length = medium.calibrated(self.explorer.volume).path_length
                found[f"medium.{k}.path_length"] = float(length)
        return found

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
        self.send(
            {
                "kind": "welcome",
                "protocol": PROTOCOL,
                "document": explorer.document.settings,
                "revision": explorer.document.revision,
                "volume": explorer.describe(),
                "series": {"count": len(explorer.series), "index": explorer.index},
                "presets": [name for name in dir(presets) if not name.startswith("_")],
                "channels": 3 if explorer.medium is None else explorer.medium.channels,
                "colormaps": _colormaps(),
            }
        )
        self.tell_document()
        session.want(time.monotonic())
        explorer.painter.wake()

    def _look(self, message: dict[str, Any]) -> None:
        if not self._may_change():
            return
        camera = dict(message["camera"])
        camera.pop("resolution", None)
        build_camera(camera)
        with self.explorer._lock:
            self.session.camera = camera
            self.explorer.document.look(camera)
        moving = message.get("moving") is True
        now = time.monotonic()
        self.session.want(now, moving=moving, number=int(message["n"]))
        for other in list(self.explorer._clients):
            if not other.session.leader:
                other.session.camera = camera
                other.session.want(now, moving=moving)
        self.explorer.painter.wake()

    def _size(self, message: dict[str, Any]) -> None:
        self.session.resize(message["size"], message.get("scale", 1.0))
        self.session.want(time.monotonic(), number=int(message["n"]))
        self.explorer.painter.wake()

    def _set(self, message: dict[str, Any]) -> None:
        if not self._may_change():
            return
        moving = message.get("moving") is True
        patch = [(str(path), value) for path, value in message["patch"]]
        number = self.session.input = int(message["n"])
        with self.explorer._lock:
            document = self.explorer.document
            document.apply(patch, str(message.get("label", "")), moving=moving)
        if all(path.startswith(("image.", "bookmarks")) for path, _ in patch):
            for client in list(self.explorer._clients):  # the pages do it: nothing is painted
                client.tell_document()
            return
        self.session.want(time.monotonic(), moving=moving, number=number)
        self.explorer.edited_at = time.monotonic()
        self.explorer.changed(self, moving=moving)

    def _undo(self, message: dict[str, Any]) -> None:
        self._step(message, self.explorer.document.undo)

    def _redo(self, message: dict[str, Any]) -> None:
        self._step(message, self.explorer.document.redo)

    def _step(self, message: dict[str, Any], step: Callable[[], bool]) -> None:
        if self._may_change():
            with self.explorer._lock:
                stepped = step()
            self.session.input = int(message["n"])
            if stepped:
                self.session.want(time.monotonic())
                self.explorer.changed(self)
            else:
                self.tell_document()

    def _seen(self, message: dict[str, Any]) -> None:
        self.session.seen(int(message["frame"]), time.monotonic())
        self.explorer.painter.wake()

    def _visible(self, message: dict[str, Any]) -> None:
        self.session.visible = message["on"] is True
        self.explorer.painter.wake()

    def _time(self, message: dict[str, Any]) -> None:
        explorer, index = self.explorer, int(message["index"])
        if not self._may_change():
            return
        if not 0 <= index < len(explorer.series):
            raise InputError(f"there is no file {index}; there are {len(explorer.series)}")
        volume = explorer._opened(index)
        with explorer._lock:
            explorer.index, explorer.volume = index, volume
            explorer.document.settings["volume"] = explorer._source()
            explorer.document.revision += 1
        explorer.changed(None)

    def _may_change(self) -> bool:
        """Return whether the page leads; and whether it does not send too much."""
        now = time.monotonic()
        self._inputs = [at for at in self._inputs if now - at < 1.0] + [now]
        return self.session.leader and len(self._inputs) <= _MOST_INPUTS

    # --- questions ----------------------------------------------------------------------------

    def _answer(self, message: dict[str, Any]) -> None:
        reply = {"kind": "reply", "id": message.get("id")}
        try:
            reply |= getattr(self, f"_{message['kind']}")(message)
        except VoluminousError as error:
            reply["error"] = str(error)
        except Exception as error:  # an answer must come, or the page waits
            reply["error"] = f"{type(error).__name__}: {error}"
        self.send(reply)

    def _probe(self, message: dict[str, Any]) -> dict[str, Any]:
        size = self.session.size
        shot = self.explorer._shot(self, size)
        if shot.medium is None:
            raise InputError("nothing is drawn; show a medium first")
        x, y = (
            min(int(_part(message, name) * n), n - 1) for name, n in zip("xy", size, strict=True)
        )
        pixel = (x, y)
        known = ("scheme", "tolerance", "precision", "device", "order", "cutoff")
        options = {k: v for k, v in shot.options.items() if k in known}
        ray = probe(shot.volume, shot.medium, shot.camera, pixel, progress=False, **options)
        reply: dict[str, Any] = {
            "x": message["x"],
            "y": message["y"],
            "pixel": list(pixel),
            "intensity": _listed(ray.intensity),
            "tau": _listed(ray.optical_depth),
            "unit": ray.units.get("length", ""),
            "units": {k: str(v) for k, v in ray.units.items()},
            "distance": _listed(0.5 * (ray.begin + ray.end)),
            "fields": {name: _listed(values) for name, values in ray.fields.items()},
            "scalars": {name: _listed(values) for name, values in ray.scalars.items()},
            "emissivity": [_listed(row) for row in ray.j.T],
            "extinction": [_listed(row) for row in ray.alpha.T],
            "optical_depth": [_listed(row) for row in ray.depth.T],
            "accumulated": [_listed(row) for row in ray.gathered.T],
            "depth": None,
            "point": None,
            "values": {},
        }
        light = ray.gathered.sum(axis=1)
        if len(light) and light[-1] > 0.0:
            k = int(np.searchsorted(light, 0.5 * light[-1]))
            before = light[k - 1] if k else 0.0
            part = (0.5 * light[-1] - before) / max(light[k] - before, 1e-300)
            reply["depth"] = float(ray.begin[k] + part * (ray.end[k] - ray.begin[k]))
            reply["point"] = _listed(ray.position[k])
            reply["values"] = {name: _number(v[k]) for name, v in ray.scalars.items()}
            reply["contribution"] = _listed(np.diff(light, prepend=0.0))
        return reply

    def _histogram(self, message: dict[str, Any]) -> dict[str, Any]:
        bins = int(message.get("bins", 256))
        if not 1 <= bins <= _MOST_BINS:
            raise InputError(f"bins must be from 1 to {_MOST_BINS}, got {bins}")
        volume = self.explorer.volume
        expression = Expression(str(message["expr"]))
        values = np.asarray(volume.evaluate(expression)).ravel()
        values = values[:: max(1, len(values) // _MOST_CELLS)]
        values = values[np.isfinite(values)]
        logarithmic = message.get("log") is True
        if logarithmic:
            values = np.log10(values[values > 0])
        if not len(values):
            raise InputError(f"{expression.text} has no {'positive ' * logarithmic}finite values")
        counts, edges = np.histogram(values, bins)
        low, high = np.quantile(values[:: max(1, len(values) // 100_000)], [5e-4, 1 - 5e-4])

        def back(value: Any) -> Any:
            return 10.0**value if logarithmic else value

        return {
            "counts": counts.tolist(),
            "edges": _listed(back(edges)),
            "low": _number(back(low)),
            "high": _number(back(high)),
            "unit": unit_name(volume.expression_unit(expression)),
            "log": logarithmic,
        }

    def _slice(self, message: dict[str, Any]) -> dict[str, Any]:
        volume, axis = self.explorer.volume, int(message["axis"])
        size = min(int(message.get("size", 256)), 1024)
        low, high = volume.grid.bounds[axis]
        place = low + _part(message, "at") * (high - low) * (1.0 - 1e-9)
        cut = volume.slice(str(message["expr"]), "xyz"[axis], float(place), resolution=max(size, 1))
        values = np.asarray(cut.values, dtype="<f4")
        finite = values[np.isfinite(values)]
        ends = (finite.min(), finite.max()) if len(finite) else (0.0, 1.0)
        return {
            "width": values.shape[1],
            "height": values.shape[0],
            "data": base64.b64encode(np.nan_to_num(values, nan=float(ends[0])).tobytes()).decode(),
            "low": _number(ends[0]),
            "high": _number(ends[1]),
            "unit": unit_name(volume.expression_unit(Expression(str(message["expr"])))),
            "extent": _listed(cut.extent),
        }

    def _suggest(self, message: dict[str, Any]) -> dict[str, Any]:
        name = message.get("name")
        known = [n for n in dir(presets) if not n.startswith("_")]
        if name is not None and name not in known:
            raise InputError(f"there is no preset {name!r}; there are {', '.join(known)}")
        volume = self.explorer.volume
        medium = suggest_medium(volume) if name is None else getattr(presets, name)(volume)
        tables = tables_of(medium)
        if self._may_change():
            with self.explorer._lock:
                self.explorer.document.apply([("medium", tables)], name or "suggested media")
            self.explorer.changed(None)
        return {}

    def _export(self, message: dict[str, Any]) -> dict[str, Any]:
        what = message["what"]
        nx, ny = self.session.size
        width = int(message.get("width", nx))
        if not 1 <= width <= _MOST_SIDE:
            raise InputError(f"width must be from 1 to {_MOST_SIDE} pixels, got {width}")
        size = width, max(1, round(width * ny / nx))
        return exported(self.explorer.scene(size), str(what))


# Keys of the messages of a page.
_KINDS: dict[str, Sequence[str]] = {
    "hello": ("protocol", "size", "scale", "leader"),
    "look": ("n", "camera", "moving"),
    "size": ("n", "size", "scale"),
    "set": ("n", "patch", "moving", "label"),
    "undo": ("n",),
    "redo": ("n",),
    "seen": ("frame",),
    "visible": ("on",),
    "time": ("n", "index"),
    "probe": ("id", "x", "y"),
    "histogram": ("id", "expr", "bins", "log"),
    "slice": ("id", "expr", "axis", "at", "size"),
    "suggest": ("id", "name"),
    "export": ("id", "what", "width"),
}


def tables_of(medium: Medium) -> list[dict[str, Any]]:
    """Return a medium's parts as tables of a scene file."""
    return [plain_value(part.describe()) for part in medium.components()]


def _view(camera: Camera) -> dict[str, Any]:
    """Return a camera's table without its pixels: each page has its own."""
    return {key: value for key, value in camera.describe().items() if key != "resolution"}


def _colormaps() -> dict[str, str]:
    import matplotlib

    places = np.linspace(0.0, 1.0, 256)
    return {
        name: base64.b64encode(
            (matplotlib.colormaps[name](places)[:, :3] * 255 + 0.5).astype(np.uint8).tobytes()
        ).decode()
        for name in _MAPS
    }


def _part(message: dict[str, Any], name: str) -> float:
    value = float(message[name])
    if not 0.0 <= value <= 1.0:
        raise InputError(f"{name} must be from 0 to 1, got {value}")
    return value


def _number(value: Any) -> float | None:
    number = float(value)
    return number if np.isfinite(number) else None


def _listed(values: Any) -> list[float | None]:
    """Return numbers as JSON has them: what is not finite is null."""
    return [_number(value) for value in np.asarray(values, dtype=np.float64).ravel()]
