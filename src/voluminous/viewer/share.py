"""What can be taken away from the explorer: pictures, films, the scene as file and script."""

from __future__ import annotations

import base64
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..cameras import Camera
from ..errors import InputError, check_name
from ..image.annotate import OPTIONS as ANNOTATIONS
from ..media import Medium
from ..movies import dolly, keyframes, movie, orbit, zoom
from ..scene import Scene
from ..scene.sections import build_camera
from ..scene.settings import plain_value
from .script import python_of, shortened

# What may be drawn over and beside a picture; of each ground, the options of a picture.
MARKS = ("scale_bar", "color_bar", "letters", "triad")
MEASURES = "measures"  # one more, which each picture draws at other places
_GROUNDS: dict[str, dict[str, Any]] = {
    "black": {},
    "white": {"background": "white"},
    "transparent": {"transparent": True},
}
_PICTURES = {"png": "image/png", "exr": "image/x-exr", "fits": "application/fits"}
_FILMS = {"mp4": "video/mp4", "gif": "image/gif", "webp": "image/webp", "png": "application/zip"}


def dressed(scene: Scene, marks: Any, ground: Any) -> Scene:
    """Let pictures of a scene have some of `MARKS`, and a ground: black, white or transparent."""
    check_name("ground", ground, _GROUNDS)
    if scene.projection and _GROUNDS[ground]:
        raise InputError("a projection is nowhere transparent: save it on black")
    marks = list(marks)
    for name in marks:
        check_name("mark", name, (*MARKS, MEASURES))
    options = {**scene.image_options, **_GROUNDS[ground]}
    if marks:
        chosen = {name: name in marks for name in ANNOTATIONS & {*MARKS, "compass", "time"}}
        # The bar of a projection is that of its values.
        options["annotate"] = chosen if scene.projection else {**chosen, "medium": scene.medium}
    scene.image_options = options
    return scene


def exported(scene: Scene, what: str) -> dict[str, Any]:
    """Return name, kind and content of a file: text, or bytes in base64."""
    check_name("export", what, (*_PICTURES, "toml", "python"))
    if what == "toml":
        text = shortened(scene).dumps()
        return {"name": "scene.toml", "mime": "application/toml", "text": text}
    if what == "python":
        return {"name": "scene.py", "mime": "text/x-python", "text": python_of(scene)}
    image = scene.render(progress=False)
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory) / f"picture.{what}"
        scene.save_image(image, path)
        data = text_of(path.read_bytes())
    return {"name": path.name, "mime": _PICTURES[what], "data": data}


def filmed(
    scene: Scene,
    volumes: Any,
    path: dict[str, Any],
    frames: int,
    *,
    what: str,
    fps: float,
    progress: Callable[[int, int], None],
    few: int | None = None,
) -> dict[str, Any]:
    """Return name, kind and content of a film; pictures come in a zip file.

    Parameters
    ----------
    scene : Scene
        With the first camera.
    volumes : Volume or sequence
        A sequence is a series in time.
    path : dict
        ``kind`` "orbit" (with ``turns``), "zoom" or "dolly" (``factor``), "keyframes" (``cameras``
        as tables, ``ease``) or "still".
    few : int, optional
        Make so many of the frames, the first ones.
    """
    check_name("film", what, _FILMS)
    cameras = _path(scene, path, frames)[:few]
    with tempfile.TemporaryDirectory() as directory:
        target = Path(directory) / f"film.{what}"
        files = movie(
            volumes,
            scene.medium,
            cameras,
            target,
            fps=fps,
            picture=scene.image_options,
            project=scene.projection,
            progress=progress,
            **scene.drawing(),
        )
        if what == "png":
            target = target.with_suffix(".zip")
            with zipfile.ZipFile(target, "w") as bundle:
                for file in files:
                    bundle.write(file, file.name)
        data = text_of(target.read_bytes())
    return {"name": target.name, "mime": _FILMS[what], "data": data}


def _path(scene: Scene, path: dict[str, Any], frames: int) -> list[Camera]:
    camera, kind = scene.camera, path.get("kind")
    check_name("path", kind, ("orbit", "zoom", "dolly", "keyframes", "still"))
    if kind == "orbit":
        return orbit(camera, float(path.get("turns", 1.0)), frames)
    if kind in ("zoom", "dolly"):
        return (zoom if kind == "zoom" else dolly)(camera, float(path["factor"]), frames)
    if kind == "still":
        return [camera] * frames
    tables = path["cameras"]
    if not 2 <= len(tables) <= frames:
        raise InputError(
            f"{frames} frames go through 2 to {frames} views, got {len(tables)}: keep views first"
        )
    size = camera.frame(scene.volume().grid).pixels
    cameras = [build_camera(table).within(size) for table in tables]
    steps = [round(k * (frames - 1) / (len(cameras) - 1)) for k in range(len(cameras))]
    return keyframes(list(zip(steps, cameras, strict=True)), str(path.get("ease", "smooth")))


def text_of(data: bytes) -> str:
    """Return bytes as base64."""
    return base64.b64encode(data).decode()


def tables_of(medium: Medium) -> list[dict[str, Any]]:
    """Return a medium's parts as tables of a scene file."""
    return [plain_value(part.describe()) for part in medium.components()]
