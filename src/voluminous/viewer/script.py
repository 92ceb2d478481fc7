"""Scenes as code to read and copy: six digits, lengths with units, lines of at most 88 letters."""

from __future__ import annotations

import math
import pprint
import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..image.lengths import readable
from ..measuring.projections import SHARED
from ..scene import Scene
from ..scene.sections import build_camera
from ..scene.settings import plain_value
from ..units import plain, unit_name

# The file that scene and script of a volume in memory speak of.
IN_MEMORY = "volume.npz"
_LONGEST, _INDENT = 88, 4
_LENGTHS = ("center", "shift", "position", "target", "path_length")
# Numbers of media that may have a unit, and the widths beside them.
_WIDTHS = ("sigma", "half_width", "width")
_QUANTITIES = ("center", "level", "values", "vmin", "vmax", *_WIDTHS)
_QUANTITY = re.compile(r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)(\s+\S.*|)")


def python_of(scene: Scene) -> str:
    """Return a script that makes the picture."""
    scene = shortened(scene)
    source = dict(scene.to_dict()["volume"])
    derived, units = source.pop("derived", {}), source.pop("units", {})
    model, path = source.pop("model", None), source.pop("path", IN_MEMORY)
    if model is None:
        lines = [_call("volume = vm.open", source, repr(path))]
    else:
        lines = [_call(f"volume = vm.models.{model}", source)]
    if model is None and path == IN_MEMORY:
        lines.insert(0, f"# The volume was in memory: volume.save({path!r}) writes this file.")
    lines += [f"volume.set_unit({name!r}, {unit!r})" for name, unit in units.items()]
    lines += [f"volume[{name!r}] = {str(text)!r}" for name, text in derived.items()]
    if scene.projection:
        given = plain_value(scene.projection) | {
            name: value for name, value in scene.render_options.items() if name in SHARED
        }
        picture = f"volume, {given.pop('quantity')!r}, camera"
        drawn = _call("image = vm.project", given, picture)
    else:
        for k, part in enumerate(scene.medium.components()):
            lines.append(_made(f"medium {'+=' if k else '='} ", part))
        drawn = _call("image = vm.render", scene.render_options, "volume, medium, camera")
    lines += [_made("camera = ", scene.camera), drawn]
    lines.append(_call("image.save", scene.image_options, repr("picture.png")))
    return "import voluminous as vm\n\n" + "\n".join(lines) + "\n"


def keyframes_of(scene: Scene, tables: Sequence[Any], frames: int) -> str:
    """Return the cameras of a film through some views, spread evenly, as `keyframes` makes them."""
    unit, step = scene.volume().unit, (frames - 1) / max(1, len(tables) - 1)
    lines = ["cameras = vm.movies.keyframes(["]
    for k, table in enumerate(tables):
        camera = build_camera(_camera(dict(table), unit))
        lines.append(" " * _INDENT + _made(f"({round(k * step)}, ", camera, _INDENT) + "),")
    return "\n".join([*lines, "])"]) + "\n"


def shortened(scene: Scene) -> Scene:
    """Return a scene of numbers with six digits, and lengths with a unit that suits them.

    Places have more digits where sizes beside them need that: the centre of a camera that sees a
    small part of the volume, or of a thin shell.
    """
    settings, volume = scene.to_dict(), scene.volume()
    described = {k: v for k, v in scene.camera.describe().items() if v is not None}
    settings["camera"] = _camera(described, volume.unit)
    settings["medium"] = [_medium(table, volume.unit) for table in settings.get("medium", [])]
    settings |= {name: _short(settings[name]) for name in ("render", "image") if name in settings}
    return Scene(settings, scene.directory, volume=volume)


def _camera(table: dict[str, Any], unit: Any) -> dict[str, Any]:
    lengths = {name: plain(table[name], unit, name) for name in _LENGTHS if name in table}
    width, size = table.get("width"), 0.0
    if table["type"] == "orthographic" and width is not None:
        lengths["width"] = size = float(np.max(plain(width, unit, "width")))
    elif width is not None:
        away = np.linalg.norm(np.subtract(lengths["position"], lengths["target"]))
        size = float(away * np.min(plain(width, "rad", "width")))
    short = {k: _length(value, unit, size) for k, value in lengths.items()}
    return {k: short[k] if k in short else _short(value) for k, value in table.items()}


def _medium(table: dict[str, Any], unit: Any) -> dict[str, Any]:
    """Return the table of a medium; expressions stay as they are."""
    short, widths = dict(table), [_QUANTITY.match(str(table.get(name))) for name in _WIDTHS]
    size = min((w for found in widths if found and (w := float(found[1]))), default=0.0)
    for name, value in table.items():
        if name == "path_length" and value != "auto":
            short[name] = _length(plain(value, unit, name), unit)
        elif name == "color" and isinstance(value, dict):  # by another expression
            short[name] = _medium(value, unit)
        else:
            short[name] = _short(value, 10.0 * size, name in _QUANTITIES)  # to 1e-4 of the width
    return short


def _length(value: Any, unit: Any, size: float = 0.0) -> Any:
    """Return lengths of the volume's unit as texts, in a unit that suits the largest."""
    values = np.asarray(value, dtype=np.float64)
    largest = max(float(np.abs(values).max(initial=0.0)), size)
    factor, name = readable(largest, unit_name(unit)) if unit is not None else (1.0, "")
    name = {r"R$_\odot$": "R_sun"}.get(name, name)
    numbers = [_round(float(v) * factor, size * factor) for v in values.ravel()]
    made = [f"{number!r} {name}" if name else number for number in numbers]
    return made if values.ndim else made[0]


def _short(value: Any, size: float = 0.0, quantity: bool = False) -> Any:
    if isinstance(value, dict):
        return {key: _short(one, size, quantity) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [_short(one, size, quantity) for one in value]
    if quantity and isinstance(value, str) and (found := _QUANTITY.fullmatch(value.strip())):
        return f"{_round(float(found[1]), size)!r}{found[2]}"
    return _round(value, size) if isinstance(value, float) else value


def _round(value: float, size: float = 0.0) -> float:
    """Return a number of six digits, or of as many as make it exact to 1e-5 of `size`."""
    needed = math.ceil(math.log10(abs(value) / size)) + 5 if value and size > 0.0 else 0
    return float(f"{value:.{min(max(6, needed), 17)}g}") + 0.0  # no -0.0


def _made(start: str, thing: Any, indent: int = 0) -> str:
    """Return the call that makes a medium or a camera, after `start`."""
    table = plain_value(thing.describe())
    table.pop("type", None)
    return _call(f"{start}vm.{type(thing).__name__}", table, indent=indent)


def _call(head: str, options: dict[str, Any], first: str = "", *, indent: int = 0) -> str:
    """Return a call; an argument on each line, if one line is not enough."""
    inner, pieces = indent + _INDENT, [first] if first else []
    for name, value in options.items():
        if name == "color" and isinstance(value, dict):
            pieces.append(_call(f"{name}=vm.ColorBy", value, indent=inner))
            continue
        margin = inner + len(name) + 1
        text = pprint.pformat(value, width=_LONGEST - margin - 1, compact=True, sort_dicts=False)
        text = text.replace(" AU'", " au'")  # astropy's name
        pieces.append(f"{name}=" + text.replace("\n", "\n" + " " * margin))
    line = f"{head}({', '.join(pieces)})"
    if len(line) + indent < _LONGEST - 1 and "\n" not in line:
        return line
    lines = "\n".join(" " * inner + piece + "," for piece in pieces)
    return f"{head}(\n{lines}\n{' ' * indent})"
