"""Scenes as code to read and copy: six digits, lengths with units, lines of at most 88 letters."""

from __future__ import annotations

import ast
import math
import re
import textwrap
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from ..image.lengths import readable
from ..scene import Scene
from ..scene.sections import build_camera
from ..scene.settings import plain_value
from ..units import plain, unit_name

# The file that scene and script of a volume in memory speak of.
IN_MEMORY = "volume.npz"
_DIGITS, _LONGEST, _INDENT = 6, 88, 4
_LENGTHS = ("center", "shift", "position", "target", "path_length")
# Numbers of media that may carry a unit, and the sizes beside them that say how exact they must be.
_BESIDE = {"center": ("sigma", "half_width"), "level": ("width",), "values": ()}
_BESIDE |= {"vmin": ("vmax",), "vmax": ("vmin",), "sigma": (), "half_width": (), "width": ()}
_QUANTITY = re.compile(r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)(\s+\S.*)")
_OPENING = dict(zip("([{", ")]}", strict=True))


def python_of(scene: Scene) -> str:
    """Return a script that makes the picture."""
    scene = shortened(scene)
    source = dict(scene.to_dict()["volume"])
    derived, units = source.pop("derived", {}), source.pop("units", {})
    model, path = source.pop("model", None), source.pop("path", IN_MEMORY)
    given = "".join(f", {key}={value!r}" for key, value in source.items())
    made = f"vm.open({path!r}{given})" if model is None else f"vm.models.{model}({given[2:]})"
    lines = [f"volume = {made}"]
    if model is None and path == IN_MEMORY:
        lines.insert(0, f"# The volume was in memory: volume.save({path!r}) writes this file.")
    lines += [f"volume.set_unit({name!r}, {unit!r})" for name, unit in units.items()]
    lines += [f"volume[{name!r}] = {str(text)!r}" for name, text in derived.items()]
    if scene.projection:
        given = plain_value(scene.projection)
        picture = f"vm.project(volume, {given.pop('quantity')!r}"
    else:
        given, picture = scene.render_options, "vm.render(volume, medium"
        for k, part in enumerate(scene.medium.components()):
            lines.append(f"medium {'+=' if k else '='} {_made(part)}")
    options = "".join(f", {key}={value!r}" for key, value in given.items())
    shown = "".join(f", {key}={value!r}" for key, value in scene.image_options.items())
    lines += [f"camera = {_made(scene.camera)}"]
    lines += [f"image = {picture}, camera{options})"]
    lines += [f"image.save('picture.png'{shown})"]
    return "import voluminous as vm\n\n" + "".join(f"{wrapped(line)}\n" for line in lines)


def keyframes_of(scene: Scene, tables: Sequence[Any], frames: int) -> str:
    """Return the cameras of a film through some views, spread evenly, as `keyframes` makes them."""
    unit = scene.volume().unit
    step = (frames - 1) / max(1, len(tables) - 1)
    cameras = [build_camera(_camera(dict(table), unit)) for table in tables]
    pairs = [f"({round(k * step)}, {_made(camera)})" for k, camera in enumerate(cameras)]
    return f"{wrapped('cameras = vm.movies.keyframes([' + ', '.join(pairs) + '])', always=True)}\n"


def _made(thing: Any) -> str:
    code = f"vm.{thing!r}".replace("=ColorBy(", "=vm.ColorBy(")
    return code.replace(" AU'", " au'")  # astropy's name


def shortened(scene: Scene) -> Scene:
    """Return a scene of numbers with six digits, and lengths with a unit that suits them.

    Places have more digits where sizes beside them need that: the centre of a camera that sees a
    small part of the volume, or the value of a thin shell.
    """
    settings, volume = scene.to_dict(), scene.volume()
    described = {k: v for k, v in scene.camera.describe().items() if v is not None}
    settings["camera"] = _camera(described, volume.unit)
    settings["medium"] = [_medium(table, volume.unit) for table in settings.get("medium", [])]
    settings |= {name: _short(settings[name]) for name in ("render", "image") if name in settings}
    return Scene(settings, scene.directory, volume=volume)


def _camera(table: dict[str, Any], unit: Any) -> dict[str, Any]:
    lengths = {name: plain(table[name], unit, name) for name in _LENGTHS if name in table}
    if table["type"] == "orthographic":
        if table.get("width") is None:
            return {name: _short(value) for name, value in table.items()}
        lengths["width"] = size = float(np.max(plain(table["width"], unit, "width")))
    elif "position" in lengths and "target" in lengths:
        away = np.subtract(lengths["position"], lengths["target"])
        size = float(np.linalg.norm(away) * np.min(plain(table.get("width", 1.0), "rad", "width")))
    else:
        size = 0.0
    return {
        k: _length(lengths[k], unit, size) if k in lengths else _short(v) for k, v in table.items()
    }


def _medium(table: dict[str, Any], unit: Any) -> dict[str, Any]:
    """Return the table of a medium; expressions stay as they are."""
    short = {}
    for name, value in table.items():
        if name in _BESIDE:
            sizes = [_number(table[other]) for other in _BESIDE[name] if other in table]
            if name.startswith("v") and sizes:  # the width of a range
                sizes = [abs(sizes[0] - _number(value))]
            if name == "values" and isinstance(value, list):
                sizes = np.abs(np.diff([_number(v) for v in value])).tolist()
            size = min((s for s in sizes if s > 0), default=0.0)
            short[name] = _short(value, 10.0 * size, texts=True)  # to 1e-4 of it
        elif name == "path_length" and value != "auto":
            short[name] = _length(plain(value, unit, name), unit)
        elif name == "color" and isinstance(value, dict):  # by another expression
            short[name] = _medium(value, unit)
        else:
            short[name] = _short(value)
    return short


def _number(value: Any) -> float:
    """Return the number of a quantity; 0 if there is none."""
    found = _QUANTITY.fullmatch(value.strip()) if isinstance(value, str) else None
    number = found[1] if found else value
    return float(number) if isinstance(number, (str, int, float)) and number != "auto" else 0.0


def _length(value: Any, unit: Any, size: float = 0.0) -> Any:
    """Return lengths of the volume's unit as texts, in a unit that suits the largest."""
    values = np.asarray(value, dtype=np.float64)
    largest = max(float(np.abs(values).max(initial=0.0)), size)
    factor, name = readable(largest, unit_name(unit)) if unit is not None else (1.0, "")
    name = {r"R$_\odot$": "R_sun"}.get(name, name)
    texts = [_round(float(v) * factor, size * factor) for v in values.ravel()]
    made = [f"{text!r} {name}" if name else text for text in texts]
    return made if values.ndim else made[0]


def _short(value: Any, size: float = 0.0, *, texts: bool = False) -> Any:
    if isinstance(value, dict):
        return {key: _short(one, size, texts=texts) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [_short(one, size, texts=texts) for one in value]
    if texts and isinstance(value, str) and (found := _QUANTITY.fullmatch(value.strip())):
        return f"{_round(float(found[1]), size)!r}{found[2]}"
    return _round(value, size) if isinstance(value, float) else value


def _round(value: float, size: float = 0.0) -> float:
    """Return a number of six digits, or of as many as make it exact to 1e-5 of `size`."""
    needed = math.ceil(math.log10(abs(value) / size)) + 5 if value and size > 0.0 else 0
    return float(f"{value:.{min(max(_DIGITS, needed), 17)}g}") + 0.0  # no -0.0


def wrapped(code: str, indent: int = 0, *, always: bool = False) -> str:
    """Return a statement in lines of at most 88 letters, broken between arguments."""
    room = _LONGEST - indent - 1
    if len(code) <= room and not always:
        return code
    inner = indent + _INDENT
    head, pieces, tail = _taken_apart(code)
    if not pieces:
        return _in_parts(code, inner)
    lines, margin = [head], " " * inner
    for piece in pieces:
        piece = wrapped(piece, inner) + ","
        fits = len(lines[-1]) + len(piece) + 1 <= _LONGEST
        if len(lines) > 1 and "\n" not in lines[-1] + piece and fits and not always:
            lines[-1] += f" {piece}"
        else:
            lines.append(margin + piece)
    return "\n".join([*lines, " " * indent + tail])


def _taken_apart(code: str) -> tuple[str, list[str], str]:
    """Return what is before the first bracket, with it; its arguments; and the rest."""
    head, pieces, ends, last = "", [], "", 0
    for kind, k in _marks(code):
        if kind in _OPENING:
            if not ends:
                head, last = code[: k + 1], k + 1
            ends += _OPENING[kind]
        elif kind == "," and len(ends) == 1:
            pieces.append(code[last:k].strip())
            last = k + 1
        elif ends and kind == ends[-1]:
            ends = ends[:-1]
            if not ends:
                last_piece = code[last:k].strip()
                return head, [*pieces, *([last_piece] if last_piece else [])], code[k:]
    return code, [], ""


def _marks(code: str) -> Iterator[tuple[str, int]]:
    """Yield brackets and commas that are in no text, and where they are."""
    quote, k = "", 0
    while k < len(code):
        letter = code[k]
        if quote:
            k += letter == "\\"
            quote = "" if letter == quote else quote
        elif letter in "'\"":
            quote = letter
        elif letter in "([{}]),":
            yield letter, k
        k += 1


def _in_parts(code: str, indent: int) -> str:
    """Return a long text as several ones, which Python joins; other code stays."""
    found = re.fullmatch(r"(\w+(?:=|: )|'\w+': )?(['\"].*['\"])", code, re.DOTALL)
    if found is None:
        return code
    text, room = ast.literal_eval(found[2]), _LONGEST - indent - 12
    how: dict[str, Any] = {
        "drop_whitespace": False,
        "replace_whitespace": False,
        "expand_tabs": False,
    }
    parts = textwrap.wrap(text, room, break_on_hyphens=False, **how)
    lines = "\n".join(" " * indent + repr(part) for part in parts)
    return f"{found[1] or ''}(\n{lines}\n{' ' * (indent - _INDENT)})"
