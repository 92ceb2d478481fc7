"""A small server that speaks the protocol, for the checks of the page: real renders, no tricks."""

from __future__ import annotations

import asyncio
import base64
import io
import json
import struct
import zlib
from http import HTTPStatus
from pathlib import Path

import numpy as np
from PIL import Image as Picture
from websockets.asyncio.server import serve
from websockets.datastructures import Headers
from websockets.http11 import Response

import voluminous as vm

STATIC = Path(__file__).parents[2] / "src/voluminous/viewer/static"
TYPES = {
    ".js": "text/javascript",
    ".css": "text/css",
    ".html": "text/html",
    ".svg": "image/svg+xml",
}
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; "
    "connect-src 'self'; frame-ancestors 'none'"
)
MAPS = ("gray", "viridis", "inferno", "RdBu_r")


def colormaps() -> dict[str, str]:
    import matplotlib

    table = np.linspace(0, 1, 256)
    return {
        name: base64.b64encode(
            (matplotlib.colormaps[name](table)[:, :3] * 255).round().astype(np.uint8).tobytes()
        ).decode()
        for name in MAPS
    }


def log_jpeg(intensity: np.ndarray, low: float, high: float, quality: int = 92) -> bytes:
    with np.errstate(divide="ignore"):
        power = np.log2(intensity)
    codes = np.where(power >= low, np.clip(1 + (power - low) / (high - low) * 254, 1, 255), 0)
    codes = codes.round().astype(np.uint8)[::-1]
    if codes.shape[-1] != 3:
        codes = np.concatenate(list(np.moveaxis(codes, -1, 0)))
    out = io.BytesIO()
    Picture.fromarray(codes).save(out, "JPEG", quality=quality, subsampling=0)
    return out.getvalue()


def float16(intensity: np.ndarray, low: float) -> bytes:
    planes = np.moveaxis(intensity[::-1] * 2.0**-low, -1, 0).astype("<f2").view("<u2")
    steps = planes.copy()
    steps[..., 1:] -= planes[..., :-1]
    flat = steps.ravel()
    both = np.concatenate([(flat & 255).astype(np.uint8), (flat >> 8).astype(np.uint8)])
    return zlib.compress(both.tobytes(), 1)


class Fake:
    """The scene, its history, and everything the page has sent."""

    def __init__(self, volume: vm.Volume, count: int = 1) -> None:
        self.volume, self.count = volume, count
        self.received: list[dict] = []
        self.slow = 0.0
        self.painting = False
        self.refines = True
        self.numbers = 0
        self.revision = 0
        self.last = None
        medium = vm.suggest_medium(volume)
        self.document = {
            "volume": {"path": "core.h5"},
            "medium": medium.describe()["parts"],
            "camera": {"type": "orthographic", "incl": 60, "phi": 30, "posang": 0},
            "render": {"tolerance": 0.001},
            "image": {},
            "bookmarks": [],
        }
        self.past: list[tuple[str, str]] = []
        self.future: list[tuple[str, str]] = []

    def medium(self) -> vm.Medium | None:
        total = None
        for table in self.document["medium"]:
            given = {k: v for k, v in table.items() if k not in ("type", "hidden")}
            if table.get("hidden"):
                continue
            made = {
                "gaussian": vm.Gaussian,
                "rectangle": vm.Rectangle,
                "isosurface": vm.Isosurface,
                "colormap": vm.Colormap,
                "table": vm.Table,
            }[table["type"]](**given)
            total = made if total is None else total + made
        return total

    def camera(self, size: tuple[int, int]) -> vm.Camera:
        given = {
            k: v for k, v in self.document["camera"].items() if k not in ("type", "resolution")
        }
        kind = (
            vm.Perspective if self.document["camera"]["type"] == "perspective" else vm.Orthographic
        )
        return kind(**given, resolution=size)

    def render(self, size: tuple[int, int]) -> tuple[vm.Camera, vm.Image]:
        camera = self.camera(size)
        self.last = vm.render(self.volume, self.medium(), camera)
        return camera, self.last

    def frame(self, n: int, size: tuple[int, int], scale: float, exact: bool) -> tuple[dict, bytes]:
        small = (max(1, round(size[0] * scale)), max(1, round(size[1] * scale)))
        camera, image = self.render(small)
        plane = camera.frame(self.volume.grid)
        first, right, up, ahead = (np.asarray(v, float) for v in plane.vectors[:4])
        position = None
        if self.document["camera"]["type"] == "perspective":
            position, ahead = first.tolist(), -ahead
            first = np.asarray(self.document["camera"]["target"], float)
        values = np.nan_to_num(image.intensity).astype(np.float64)
        most = float(values.max()) or 1.0
        high, low = float(np.log2(most)), float(np.log2(most) - 16)
        self.numbers += 1
        head = {
            "kind": "frame", "number": self.numbers, "n": n, "revision": self.revision,
            "camera": self.document["camera"],
            "frame": {"center": first.tolist(), "right": right.tolist(), "up": up.tolist(), "ahead": ahead.tolist(),
                      "width": plane.width[0], "height": plane.width[1], "shift": list(plane.shift), "position": position},
            "width": small[0], "height": small[1], "channels": values.shape[-1], "scale": scale, "done": 1.0,
            "exact": exact, "error": 0.003 if exact else None, "ms": 20, "exposure": image.exposure,
        }  # fmt: skip
        if exact:
            low = high - 14
            return {**head, "codec": "float16", "low": low, "high": high}, float16(values, low)
        return {**head, "codec": "log-jpeg", "low": low, "high": high}, log_jpeg(values, low, high)

    def change(self, patch: list, label: str) -> None:
        if not self.past or self.past[-1][0] != label or label == "":
            self.past.append((label, json.dumps(self.document)))
        self.future.clear()
        for path, value in patch:
            at = self.document
            *keys, last = [int(k) if k.isdigit() else k for k in path.split(".")]
            for key in keys:
                at = at[key]
            if value is None:
                at.pop(last, None)
            else:
                at[last] = value
        self.revision += 1

    def step(self, undo: bool) -> None:
        source, target = (self.past, self.future) if undo else (self.future, self.past)
        if source:
            label, kept = source.pop()
            target.append((label, json.dumps(self.document)))
            self.document = json.loads(kept)

    def told(self, n: int) -> dict:
        return {"kind": "document", "document": self.document, "revision": self.revision, "n": n, "channels": 3, "open": {},
                "undo": [p[0] for p in self.past], "redo": [p[0] for p in self.future]}  # fmt: skip

    def welcome(self) -> dict:
        volume = self.volume
        values = volume["density"].value
        return {
            **self.told(0), "kind": "welcome", "protocol": 1, "token": None, "colormaps": colormaps(),
            "series": {"count": self.count, "index": 0}, "presets": ["core", "shells", "surface"],
            "volume": {
                "name": "Prestellar core", "unit": "cm", "bounds": volume.grid.bounds.tolist(), "shape": list(np.shape(values)),
                "cells": int(np.size(values)), "grid": "Cartesian", "coordinates": ["x", "y", "z", "r"],
                "fields": [{"name": "density", "unit": "cm-3", "min": float(np.min(values)), "max": float(np.max(values))}],
            },
        }  # fmt: skip

    def answer(self, m: dict) -> dict:
        density = self.volume["density"].value.astype(float)
        values = np.log10(density) if m.get("expr", "").startswith("log10") else density
        if m["kind"] == "histogram":
            low, high = float(values.min()), float(values.max())
            edges = (
                np.geomspace(low, high, m["bins"] + 1)
                if m["log"]
                else np.linspace(low, high, m["bins"] + 1)
            )
            counts, _ = np.histogram(values, edges)
            return {
                "edges": edges.tolist(),
                "counts": counts.tolist(),
                "unit": "" if values is not density else "cm-3",
                "low": low,
                "high": high,
                "log": m["log"],
            }
        if m["kind"] == "slice":
            index = min(int(m["at"] * density.shape[m["axis"]]), density.shape[m["axis"]] - 1)
            cut = np.take(values, index, axis=m["axis"]).T.astype("<f4")
            return {
                "width": cut.shape[1],
                "height": cut.shape[0],
                "type": "<f4",
                "data": base64.b64encode(zlib.compress(cut.tobytes())).decode(),
                "low": float(cut.min()),
                "high": float(cut.max()),
                "unit": "cm-3",
            }
        if m["kind"] == "thumbnail":
            out = io.BytesIO()
            tint = sum(map(ord, m["name"] or "")) % 200 + 40
            Picture.new("RGB", (96, 72), (tint, 60, 240 - tint)).save(out, "JPEG")
            return {"mime": "image/jpeg", "data": base64.b64encode(out.getvalue()).decode()}
        if m["kind"] == "highlight":
            light = self.last.intensity.mean(axis=-1)[::-1]
            part = (255 * light / light.max()).astype(np.uint8)
            return {
                "width": part.shape[1],
                "height": part.shape[0],
                "data": base64.b64encode(part.tobytes()).decode(),
            }
        if m["kind"] == "load":
            if "[[medium]]" not in m["text"]:
                raise ValueError("there is no [[medium]]")
            self.change([("image.exposure", 3.0)], "load")
            return {}
        if m["kind"] == "export":
            return {
                "name": "core.toml",
                "mime": "text/plain",
                "text": "[camera]\nincl = 60\n"
                if m["what"] == "toml"
                else "import voluminous as vm\n",
            }
        return self.probe(m)

    def probe(self, m: dict) -> dict:
        ny, nx = self.last.intensity.shape[:2]
        i, j = min(int(m["x"] * nx), nx - 1), min(int(m["y"] * ny), ny - 1)
        ray = vm.probe(self.volume, self.medium(), self.camera((nx, ny)), (i, j))
        total = ray.arriving.sum(axis=-1).cumsum()
        k = int(np.searchsorted(total, 0.5 * total[-1]))
        rows = lambda a: np.atleast_2d(np.asarray(a, float).T).tolist()  # noqa: E731
        return {
            "x": m["x"], "y": m["y"], "depth": float(ray.begin[k]), "point": ray.position[k].tolist(),
            "distance": (0.5 * (ray.begin + ray.end)).tolist(), "intensity": ray.intensity.tolist(),
            "tau": ray.optical_depth.tolist(), "unit": "", "fields": {"density": ray.fields["density"].tolist()},
            "units": ray.units, "emissivity": rows(ray.j), "extinction": rows(ray.alpha),
            "optical_depth": rows(ray.depth), "accumulated": rows(ray.gathered), "walls": ray.end.tolist(),
            "values": {name: float(line[k]) for name, line in ray.scalars.items()},
        }  # fmt: skip


def pack(head: dict, data: bytes) -> bytes:
    text = json.dumps(head).encode()
    return b"VLM1" + struct.pack("<I", len(text)) + text + data


def static(connection, request):
    if request.path == "/ws":
        return None
    path = STATIC / (request.path.split("?")[0].lstrip("/") or "index.html")
    if path.parent != STATIC or not path.is_file():
        return connection.respond(HTTPStatus.NOT_FOUND, "no such file\n")
    headers = Headers(
        {
            "Content-Type": TYPES[path.suffix],
            "Content-Security-Policy": POLICY,
            "Connection": "close",
        }
    )
    return Response(200, "OK", headers, path.read_bytes())


async def talk(fake: Fake, socket) -> None:
    """One page: the newest input is drawn small while things move, then whole."""
    size, n, wake, moving = [400, 400], 0, asyncio.Event(), False
    window = asyncio.Semaphore(1)

    async def paint() -> None:
        while True:
            await wake.wait()
            wake.clear()
            fake.painting = True
            for exact in (False, True) if fake.refines else (False,):
                if fake.slow:
                    await asyncio.sleep(fake.slow)
                scale = 0.5 if moving else 1.0
                head, data = await asyncio.to_thread(fake.frame, n, tuple(size), scale, exact)
                await asyncio.wait_for(window.acquire(), 10)
                await socket.send(pack(head, data))
                if moving or wake.is_set():
                    break
                await asyncio.sleep(0.15)
                if wake.is_set():
                    break
            fake.painting = wake.is_set()

    async def film(m: dict) -> None:
        reply = {"name": "film.gif", "mime": "image/gif", "data": base64.b64encode(b"GIF").decode()}
        try:
            for k in range(30):
                await asyncio.sleep(0.1)
                await socket.send(json.dumps({"kind": "progress", "id": m["id"], "done": k / 30}))
        except asyncio.CancelledError:
            reply = {"error": "cancelled"}
        await socket.send(json.dumps({"kind": "reply", "id": m["id"], **reply}))

    films: dict[int, asyncio.Task] = {}
    painter = asyncio.create_task(paint())
    try:
        async for text in socket:
            m = json.loads(text)
            fake.received.append(m)
            kind = m["kind"]
            n = max(n, m.get("n", 0))
            if kind == "seen":
                window.release() if window.locked() else None
                continue
            if kind == "hello":
                size = [round(v * m["scale"]) for v in m["size"]]
                await socket.send(json.dumps(fake.welcome()))
            elif kind == "size":
                size = [round(v * m["scale"]) for v in m["size"]]
            elif kind == "look":
                fake.document["camera"] = m["camera"]
                moving = m["moving"]
            elif kind == "set":
                fake.change(m["patch"], m["label"])
                await socket.send(json.dumps(fake.told(n)))
            elif kind in ("undo", "redo"):
                fake.step(kind == "undo")
                await socket.send(json.dumps(fake.told(n)))
            elif kind == "film":
                films[m["id"]] = asyncio.create_task(film(m))
                continue
            elif kind == "cancel":
                films[m["of"]].cancel()
                continue
            elif kind in (
                "probe", "histogram", "slice", "export", "load", "thumbnail", "highlight",
            ):  # fmt: skip
                try:
                    reply = await asyncio.to_thread(fake.answer, m)
                except Exception as error:  # the page shows it
                    reply = {"error": repr(error)}
                await socket.send(json.dumps({"kind": "reply", "id": m["id"], **reply}))
                if kind == "load" and "error" not in reply:
                    await socket.send(json.dumps(fake.told(n)))
                    wake.set()
                continue
            elif kind == "suggest":
                await socket.send(json.dumps({"kind": "reply", "id": m["id"]}))
            if kind not in ("visible", "suggest"):
                wake.set()
    finally:
        painter.cancel()


def start(fake: Fake, port: int = 0):
    """Return a context manager: the server, at ``sockets[0]``'s port."""
    return serve(
        lambda s: talk(fake, s),
        "127.0.0.1",
        port,
        process_request=static,
        subprotocols=["voluminous.v1"],
    )
