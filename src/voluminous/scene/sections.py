"""The sections of a scene that need no data file: medium, object, camera, render and image."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..errors import InputError, unknown_name
from ..io.guard import placed
from . import kinds
from .kinds import Kind, arguments, check_keys
from .settings import plain_value

_MEDIUM: dict[str, Kind] = {
    **dict.fromkeys(("expr", "emissivity", "extinction"), kinds.EXPRESSIONS),
    **dict.fromkeys(("cmap", "norm"), kinds.TEXT),
    **dict.fromkeys(("color", "colors"), kinds.or_table(kinds.COLORS, lambda t: _color_by(t))),
    **dict.fromkeys(("opacity", "opacities"), kinds.NUMBERS),
    "where": kinds.EXPRESSION,
    **dict.fromkeys(("center", "sigma", "half_width"), kinds.QUANTITY),
    "path_length": kinds.QUANTITY_OR_AUTO,
    **dict.fromkeys(("vmin", "vmax"), kinds.QUANTITY),
    "values": kinds.QUANTITIES,
    "samples": kinds.WHOLE,
    **dict.fromkeys(("level", "width"), kinds.QUANTITIES),
    "density": kinds.TEXT,
    "shading": kinds.NUMBER,
    "lights": kinds.ANYTHING,
}
_CAMERA: dict[str, Kind] = {
    **dict.fromkeys(("incl", "phi", "posang", "zenith", "fov"), kinds.QUANTITY),
    **dict.fromkeys(("width", "position", "target", "center", "shift"), kinds.QUANTITIES),
    **dict.fromkeys(("up", "view_direction"), kinds.NUMBERS),
    "resolution": kinds.WHOLES,
    "projection": kinds.TEXT,
}
_OBJECT: dict[str, Kind] = {
    **dict.fromkeys(("colors",), kinds.COLORS),
    **dict.fromkeys(("positions", "points", "origin", "length"), kinds.QUANTITIES),
    **dict.fromkeys(("radii", "luminosities"), kinds.QUANTITIES),
    **dict.fromkeys(("width", "psf"), kinds.QUANTITIES),
    **dict.fromkeys(("opacity", "limb_darkening"), kinds.NUMBERS),
    "channel": kinds.WHOLE,
}
_RENDER: dict[str, Kind] = {
    **dict.fromkeys(("scheme", "precision", "device", "order"), kinds.TEXT),
    "background": kinds.NUMBERS_OR_TEXT,
    "cutoff": kinds.NUMBER,
    "tolerance": kinds.NUMBER_OR_NONE,
    "samples": kinds.WHOLE,
    "antialias": kinds.TEXT,
    "bounds": kinds.BOOLEAN,
    "max_panels": kinds.WHOLE,
}
_IMAGE: dict[str, Kind] = {
    **dict.fromkeys(("vmin", "vmax", "softening"), kinds.NUMBER),
    **dict.fromkeys(("gamut", "colormap", "norm"), kinds.TEXT),
    **dict.fromkeys(("transparent", "half"), kinds.BOOLEAN),
    "background": kinds.NUMBERS_OR_TEXT,
    "bits": kinds.WHOLE,
    "channels": kinds.WHOLES,
    "mix": kinds.NUMBERS,
    **dict.fromkeys(("exposure", "stretch"), kinds.NUMBER_OR_TEXT),
}


def build_medium(sections: list[Mapping[str, Any]]) -> Any:
    """Return the sum of the media in ``[[medium]]``."""
    from ..media import MEDIA

    parts = _listed("medium", sections, MEDIA, _MEDIUM)
    with placed("[[medium]]"):
        return sum(parts[1:], parts[0])


def build_objects(sections: list[Mapping[str, Any]]) -> list[Any]:
    """Return the stars, lines, … in ``[[object]]``."""
    from ..objects import OBJECTS

    return _listed("object", sections, OBJECTS, _OBJECT)


def _listed(
    name: str,
    sections: list[Mapping[str, Any]],
    types: Mapping[str, Any],
    known: Mapping[str, Kind],
) -> list[Any]:
    found = []
    for number, section in enumerate(sections, start=1):
        with placed(f"[[{name}]] {number}"):
            make, rest = _typed(section, types)
            found.append(make(**arguments(make, rest, known)))
    return found


def _color_by(section: Mapping[str, Any]) -> Any:
    """Return the colouring by another expression, from the table ``color`` of a medium."""
    from ..media import ColorBy

    with placed("color"):
        return ColorBy(**arguments(ColorBy, section, _MEDIUM))


def build_camera(section: Mapping[str, Any]) -> Any:
    """Return the camera of ``[camera]``; its `looking` constructs it from a ``view_direction``."""
    from ..cameras import CAMERAS

    with placed("[camera]"):
        make, rest = _typed({"type": "orthographic", **section}, CAMERAS)
        if "view_direction" not in section:
            return make(**arguments(make, rest, _CAMERA))
        own = {k: v for k, v in rest.items() if k in inspect.signature(make.looking).parameters}
        others = {k: v for k, v in rest.items() if k not in own}
        check_keys(others, inspect.signature(make).parameters)
        given = {k: _CAMERA.get(k, kinds.ANYTHING)(k, v) for k, v in others.items()}
        if taken := {"incl", "phi", "target"} & set(others):
            raise InputError(
                "view_direction takes the place of angles and target; leave those out, got also "
                + ", ".join(sorted(taken))
            )
        return make.looking(**arguments(make.looking, own, _CAMERA), **given)


def plain_render(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return keyword arguments of `render` in the form of ``[render]``.

    None is omitted if it is the default, and written as a word otherwise.
    """
    known = _render_parameters()
    told = {}
    for key, value in options.items():
        if value is not None:
            told[key] = plain_value(value)
        elif key not in known or known[key].default is not None:
            told[key] = kinds.NONE
    return told


def render_options(section: Mapping[str, Any]) -> dict[str, Any]:
    """Return ``[render]`` as keyword arguments of `render`."""
    from ..backend.device import DEVICES, PRECISIONS
    from ..rendering.options import ORDERS, check_cutoff, check_tolerance
    from ..schemes import SCHEMES

    choices = {
        "scheme": SCHEMES,
        "precision": PRECISIONS,
        "device": ("auto", *DEVICES),
        "order": ORDERS,
    }
    with placed("[render]"):
        check_keys(section, _render_parameters())
        options = {key: _RENDER.get(key, kinds.ANYTHING)(key, v) for key, v in section.items()}
        for key, names in choices.items():
            if key in options and options[key] not in names:
                raise unknown_name(key, options[key], names)
        check_cutoff(options.get("cutoff"))
        check_tolerance(options.get("tolerance"))
    return options


def _render_parameters() -> dict[str, inspect.Parameter]:
    """Return the parameters of `render` that ``[render]`` may contain."""
    from ..rendering import render

    return {
        name: parameter
        for name, parameter in inspect.signature(render).parameters.items()
        if parameter.kind is parameter.KEYWORD_ONLY and name not in ("objects", "progress")
    }


def image_options(section: Mapping[str, Any], channels: int) -> dict[str, Any]:
    """Return the options of `Image.save` in ``[image]``, validated on a picture of one pixel."""
    import numpy as np

    from ..image import Image
    from ..image.formats import FORMATS, format_of, png

    with placed("[image]"):
        check_keys(section, frozenset().union(*(form.options for form in FORMATS)))
        options = {key: _IMAGE.get(key, kinds.ANYTHING)(key, v) for key, v in section.items()}
        known = format_of(Path("a.png")).options
        pixel = Image(np.ones((1, 1, channels)), transparency=np.ones((1, 1)))
        png.encode(pixel, **{k: v for k, v in options.items() if k in known})
    return options


def _typed(section: Mapping[str, Any], types: Mapping[str, Any]) -> tuple[Any, dict[str, Any]]:
    if "type" not in section:
        raise InputError(f"type is missing; there are: {', '.join(sorted(types))}")
    name = kinds.TEXT("type", section["type"])
    if name not in types:
        raise unknown_name("type", name, types)
    return types[name], {key: value for key, value in section.items() if key != "type"}
