"""What a page asks and is answered: rays, histograms, slices, pictures, films.

Each function takes the page and its message, and returns the content of the reply. They run in
threads of their own; ``progress`` tells how far a long one is.
"""

from __future__ import annotations

import functools
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from ..calibration import presets, suggest_medium
from ..drawing import render
from ..errors import InputError, check_name
from ..expressions import Expression
from ..measuring import probe, project
from ..measuring.columns import lines_of_sight
from ..media import Medium, Rectangle
from ..scene import Scene, settings
from ..scene.sections import build_medium
from ..units import is_count, unit_name
from ..volume import Volume
from .document import shown
from .measures import (
    check_measures,
    hidden_points,
    marks_of,
    script_of,
    shown_where,
    statistics,
)
from .painter import Shot, at_hand, caught_warnings, is_drawn_in_blocks, measured
from .script import IN_MEMORY, keyframes_of
from .session import scaled
from .share import MEASURES, dressed, exported, filmed, tables_of, text_of
from .slices import coded, of_planes

if TYPE_CHECKING:
    from .explorer import Client

Answer = dict[str, Any]
Progress = Callable[[int, int], None]

_MOST_BINS, _MOST_SIDE, _MOST_FRAMES = 4096, 8192, 10_000
# Cells of a histogram; of more, every second, third …
_MOST_CELLS = 1 << 24
# Pixels of a preset's picture, and of one that shows where values are.
_SMALL, _COARSE = 96, 300
# Pixels along a side of a slice.
_MOST_CUT = 2048
_QUICK: dict[str, Any] = {"tolerance": None, "progress": False}
# Widths of the pictures by which the time of a larger one is estimated.
_ESTIMATED = (64, 96, 192)
# Frames of a film by which it is estimated; seconds after which no larger one is made.
_FEW, _PATIENCE = 3, 3.0
_RAY_OPTIONS = ("scheme", "tolerance", "precision", "device", "cutoff", "clip")


def ask_probe(page: Client, message: Answer, progress: Progress) -> Answer:
    """Return the ray through a point of the picture."""
    shot = page.explorer.shot(page, page.session.size)
    if shot.medium is None:
        raise InputError("nothing is drawn; show a medium first")
    places = zip("xy", shot.pixels, strict=True)
    x, y = (min(int(_part(message, name) * n), n - 1) for name, n in places)
    options = {k: v for k, v in shot.options.items() if k in _RAY_OPTIONS}
    if at_hand(shot.volume) is not shot.volume:
        # All chunks would be drawn, to know the tolerance of one pixel.
        options |= {"tolerance": None, "memory": shot.options.get("memory")}
    ray = probe(shot.volume, shot.medium, shot.camera, (x, y), progress=False, **options)
    points = ray.points
    assert points is not None
    reply: Answer = {
        "x": message["x"],
        "y": message["y"],
        "pixel": [x, y],
        "intensity": listed(ray.intensity),
        "tau": listed(ray.optical_depth),
        "unit": ray.units.get("length", ""),
        "units": {k: str(v) for k, v in ray.units.items()},
        "distance": listed(points.distance),
        "fields": {name: listed(values) for name, values in points.fields.items()},
        "scalars": {name: listed(values) for name, values in points.scalars.items()},
        "emissivity": [listed(row) for row in points.j.T],
        "extinction": [listed(row) for row in points.alpha.T],
        "walls": listed([*points.distance[:1], *ray.begin[:1], *ray.end, *points.distance[-1:]]),
        "optical_depth": [listed([0.0, 0.0, *row, *row[-1:]]) for row in ray.depth.T],
        "accumulated": [listed([0.0, 0.0, *row, *row[-1:]]) for row in ray.gathered.T],
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
        point, middle = ray.position[k], 0.5 * (ray.begin[k] + ray.end[k])
        ahead = shot.camera.lines_of_sight(point[:, None], shot.volume.grid)[:, 0]
        reply["point"] = listed(point + (reply["depth"] - middle) * ahead)
        reply["values"] = {
            name: number(np.interp(reply["depth"], points.distance, values))
            for name, values in points.scalars.items()
        }
    if shot.projection and shot.projection.get("how", "max") in ("max", "min"):
        reply["point"] = _extreme(shot, x, y)
    return reply


def _extreme(shot: Shot, x: int, y: int) -> list[float | None] | None:
    """Return the place of the cell that a pixel of a maximum or minimum shows; None beside all."""
    volume = measured(shot.volume)
    how = {**shot.projection, "clip": shot.options.get("clip"), "progress": False}
    both: Any = project(volume, camera=shot.camera, **how, depth=True)
    _, depth = both
    away = depth.intensity[y, x, 0]
    origin, direction = (a[y, x] for a in lines_of_sight(shot.camera, volume.grid))
    return listed(origin + away * direction) if np.isfinite(away) else None


def ask_histogram(page: Client, message: Answer, progress: Progress) -> Answer:
    """Return how many cells have which values."""
    bins = int(message.get("bins", 256))
    if not 1 <= bins <= _MOST_BINS:
        raise InputError(f"bins must be from 1 to {_MOST_BINS}, got {bins}")
    volume = at_hand(page.explorer.volume)
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
        "edges": listed(back(edges)),
        "low": number(back(low)),
        "high": number(back(high)),
        "unit": unit_name(volume.expression_unit(expression)),
        "log": logarithmic,
        "level": _level_of(volume, page),
    }


def ask_slice(page: Client, message: Answer, progress: Progress) -> Answer:
    """Return the values in a plane across an axis."""
    volume, axis = of_planes(page.explorer.volume), int(message["axis"])
    if axis not in (0, 1, 2):
        raise InputError(f"axis must be 0, 1 or 2, got {axis}")
    low, high = volume.grid.bounds[axis]
    place = low + _part(message, "at") * (high - low) * (1.0 - 1e-9)
    size = message.get("size", 256)
    if np.max(size) > _MOST_CUT:
        raise InputError(f"a slice may have {_MOST_CUT} pixels along a side, got {size!r}")
    cut = volume.slice(str(message["expr"]), "xyz"[axis], float(place), resolution=size)
    finite = cut.values[np.isfinite(cut.values)]
    ends = (finite.min(), finite.max()) if len(finite) else (0.0, 1.0)
    kind, data = coded(cut.values)
    return {
        "width": cut.values.shape[1],
        "height": cut.values.shape[0],
        "type": kind,
        "data": text_of(data),
        "low": number(ends[0]),
        "high": number(ends[1]),
        "unit": unit_name(volume.expression_unit(Expression(str(message["expr"])))),
        "extent": listed(cut.extent),
        "level": _level_of(volume, page),
    }


def ask_highlight(page: Client, message: Answer, progress: Progress) -> Answer:
    """Return where in the picture values are: lengths of rays through them, hidden or not."""
    low, high = float(message["low"]), float(message["high"])
    if not low < high:
        raise InputError(f"low must be less than high, got {low} and {high}")
    factor = min(1.0, _COARSE / max(page.session.size))
    shot = page.explorer.shot(page, scaled(page.session.size, factor))
    # So thin that it hides nothing of itself.
    medium = Rectangle(
        str(message["expr"]),
        center=0.5 * (low + high),
        half_width=0.5 * (high - low),
        color=[1.0],
        opacity=1e-6,
    )
    with caught_warnings():  # that nothing shows
        clip = shot.options.get("clip")
        image = render(at_hand(shot.volume), medium, shot.camera, clip=clip, **_QUICK)
    seen = np.nan_to_num(image.intensity[::-1, :, 0])
    top = float(seen.max(initial=0.0))
    codes = np.sqrt(np.clip(seen / top, 0.0, 1.0)) * 255.0 if top > 0.0 else np.zeros_like(seen)
    ny, nx = codes.shape
    return {"width": nx, "height": ny, "data": text_of((codes + 0.5).astype(np.uint8).tobytes())}


def ask_thumbnail(page: Client, message: Answer, progress: Progress) -> Answer:
    """Return a small picture of a preset."""
    medium = _preset(measured(page.explorer.volume), message.get("name"))
    shot = page.explorer.shot(page, scaled(page.session.size, _SMALL / page.session.size[0]))
    with caught_warnings():
        image = render(at_hand(shot.volume), medium, shot.camera, **_QUICK)
    return {"mime": "image/png", "data": text_of(image._repr_png_())}


def ask_measure(page: Client, message: Answer, progress: Progress) -> Answer:
    """Return statistics of cells, as `measure` has them; first what a medium shows, if it is one.

    The cells are all of the file's: a volume larger than memory is read chunk by chunk.
    """
    explorer, one = page.explorer, message["measure"]
    check_measures([one])
    volume, medium = explorer.volume, message.get("medium")
    if medium is not None:
        table = {**explorer.document.settings["medium"][int(medium)], "hidden": False}
        one = {**one, "where": shown_where(build_medium(shown({"medium": [table]})), volume)}
    progress(0, 1)  # cancelled while it waited
    numbers = statistics(explorer.volume, one, _memory(page), progress)
    return {"where": one.get("where", ""), **numbers}


def ask_hidden(page: Client, message: Answer, progress: Progress) -> Answer:
    """Return which points of space are hidden by what is in front of them."""
    shot = page.explorer.shot(page, page.session.size)
    return {"hidden": hidden_points(shot, message["points"], _memory(page))}


def ask_suggest(page: Client, message: Answer, progress: Progress) -> Answer:
    """Set the media of a preset, or the suggested ones."""
    name = message.get("name")
    tables = tables_of(_preset(measured(page.explorer.volume), name))
    page.change([("medium", tables)], name or "suggested media")
    return {"revision": page.explorer.document.revision}


def ask_load(page: Client, message: Answer, progress: Progress) -> Answer:
    """Set what a scene file says, but for its volume."""
    sections = settings.plain_sections(
        {"volume": {"path": IN_MEMORY}, **settings.loads(str(message["text"]))}
    )
    sections["camera"].pop("resolution", None)
    given = [name for name in ("medium", "camera", "render", "image") if sections[name]]
    names = [*given, "project"]  # without one the media are shown
    page.change([(name, sections[name]) for name in names], "another scene")
    return {}


def ask_export(page: Client, message: Answer, progress: Progress) -> Answer:
    """Return a picture, or the scene as a text."""
    scene = _scene(page, message)
    if message["what"] == "keyframes":
        return {"text": keyframes_of(scene, message["cameras"], int(message["frames"]))}
    made = exported(scene, str(message["what"]))
    measures = page.explorer.document.settings["measures"]
    if message["what"] == "python" and measures:
        unit = unit_name(page.explorer.volume.unit)
        made["text"] += script_of(measures, unit, _memory(page))
    return made


def ask_estimate(page: Client, message: Answer, progress: Progress) -> Answer:
    """Return what a picture, or each frame of a film, takes: seconds and bytes per pixel.

    Small ones are made: the first since its kernel may have to be compiled, of the others the
    second has four times as many pixels. Of files larger than memory nothing is said.
    """
    volume = page.explorer.volume
    if is_drawn_in_blocks(volume):
        return {}
    few = min(int(message.get("frames", 1)), _FEW)
    seconds, sizes, pixels = [0.0], [0], [0]
    for width in _ESTIMATED:
        scene, began = _scene(page, {**message, "width": width}), time.perf_counter()
        what = str(message["what"])
        if "path" in message:
            made = _film(scene, volume, message, progress=lambda *_: None, few=few)
        else:
            made = exported(scene, what)
        seconds.append(time.perf_counter() - began)
        sizes.append(len(made.get("text") or made["data"]) * 3 // 4)
        nx, ny = scene.camera.frame(volume.grid).pixels
        pixels.append(nx * ny * few)
        if seconds[-1] > _PATIENCE:
            break
    before = -2 if len(pixels) > len(_ESTIMATED) else 0
    more = pixels[-1] - pixels[before]
    per = max(seconds[-1] - seconds[before], 0.1 * seconds[-1]) / more
    start = max(0.0, seconds[-1] - per * pixels[-1])
    return {"start": start, "seconds": per, "bytes": max(0, sizes[-1] - sizes[before]) / more}


def ask_film(page: Client, message: Answer, progress: Progress) -> Answer:
    """Return a film."""
    explorer = page.explorer
    volumes: Any = explorer.volume
    if message.get("series") is True:
        volumes = [functools.partial(explorer._opened, k) for k in range(len(explorer.series))]
    return _film(_scene(page, message), volumes, message, progress=progress)


def _film(scene: Scene, volumes: Any, message: Answer, **how: Any) -> Answer:
    frames: Any = message.get("frames")
    path = message["path"]
    if not is_count(frames, _MOST_FRAMES):
        raise InputError(f"frames must be a number from 1 to {_MOST_FRAMES}, got {frames!r}")
    if not isinstance(path, dict):
        raise InputError(f"path must be an object, got {path!r}")
    what, fps = str(message.get("what", "mp4")), float(message.get("fps", 30.0))
    return filmed(scene, volumes, path, int(frames), what=what, fps=fps, **how)


QUESTIONS: dict[str, tuple[Callable[[Client, Answer, Progress], Answer], tuple[str, ...]]] = {
    "probe": (ask_probe, ("x", "y")),
    "histogram": (ask_histogram, ("expr", "bins", "log")),
    "slice": (ask_slice, ("expr", "axis", "at", "size")),
    "highlight": (ask_highlight, ("expr", "low", "high")),
    "thumbnail": (ask_thumbnail, ("name",)),
    "measure": (ask_measure, ("measure", "medium")),
    "hidden": (ask_hidden, ("points",)),
    "suggest": (ask_suggest, ("name",)),
    "load": (ask_load, ("text",)),
    "export": (
        ask_export,
        ("what", "width", "marks", "ground", "measures", "cameras", "frames"),
    ),
    "estimate": (ask_estimate, ("what", "marks", "ground", "path", "frames", "fps")),
    "film": (ask_film, ("path", "frames", "fps", "width", "what", "series", "marks", "ground")),
}
"""Function and keys of each kind of question, besides ``id``."""


def _level_of(volume: Volume, page: Client) -> int:
    """Return the level of the file that a quick answer is from, 0 being all cells."""
    return 0 if volume is page.explorer.volume else int(volume.meta.get("level", 0))


def _memory(page: Client) -> Any:
    """Return what measures may take: of a volume in memory, all of it is there already."""
    explorer = page.explorer
    chunks = at_hand(explorer.volume) is not explorer.volume
    return explorer.document.settings["render"].get("memory") if chunks else None


def _preset(volume: Volume, name: Any) -> Medium:
    if name is None:
        return suggest_medium(volume)
    check_name("preset", name, presets.__all__)
    made: Medium = getattr(presets, name)(volume)
    return made


def _scene(page: Client, message: Answer) -> Scene:
    """Return what a page shows, in the size and dress that it asks for."""
    scene = page.explorer.scene(_pixels(page, message), page)
    marks = message.get("marks", ())
    scene = dressed(scene, marks, message.get("ground", "black"))
    if MEASURES in marks and "path" not in message:  # the camera of a film moves
        lines = marks_of(message.get("measures", []), scene.camera, scene.volume())
        scene.image_options["annotate"][MEASURES] = lines
    return scene


def _pixels(page: Client, message: Answer) -> tuple[int, int]:
    nx, ny = page.explorer.shot(page, page.session.size).pixels
    width = int(message.get("width", nx))
    if not 1 <= width <= _MOST_SIDE:
        raise InputError(f"width must be from 1 to {_MOST_SIDE} pixels, got {width}")
    return width, max(1, round(width * ny / nx))


def _part(message: Answer, name: str) -> float:
    value = float(message[name])
    if not 0.0 <= value <= 1.0:
        raise InputError(f"{name} must be from 0 to 1, got {value}")
    return value


def number(value: Any) -> float | None:
    """Return a number as JSON has it: what is not finite is null."""
    plain = float(value)
    return plain if np.isfinite(plain) else None


def listed(values: Any) -> list[float | None]:
    """Return numbers as JSON has them."""
    return [number(value) for value in np.asarray(values, dtype=np.float64).ravel()]
