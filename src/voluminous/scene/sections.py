"""The sections of a scene that need no data file: medium, object, camera, render and image."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import InputError, check_name
from ..expressions import Expression
from ..files import seen_from
from ..io.contract import FieldChoice
from ..io.guard import placed
from ..units import parse_unit
from ..volume import Volume
from . import kinds
from .kinds import Kind, arguments, check_keys, converted
from .settings import plain_value

if TYPE_CHECKING:
    from ..cameras import Camera
    from ..media import Medium
    from ..objects import SceneObject

# Kinds of keys, and where those of a section differ.
_OF_ALL: dict[Kind, str] = {
    kinds.EXPRESSIONS: "expr emissivity extinction",
    kinds.EXPRESSION: "where quantity",
    kinds.TEXT: "cmap norm density projection stereo scheme precision device antialias gamut "
    "colormap clip how unit",
    kinds.NUMBERS: "opacity opacities up view_direction limb_darkening mix",
    kinds.NUMBER: "shading cutoff softening",
    kinds.NUMBER_OR_NONE: "tolerance",
    kinds.NUMBER_OR_TEXT: "exposure stretch memory",
    kinds.NUMBERS_OR_TEXT: "background",
    kinds.QUANTITY: "center sigma half_width vmin vmax incl phi posang zenith fov eye_distance",
    kinds.QUANTITY_OR_AUTO: "path_length",
    kinds.QUANTITIES: "values level width position target shift positions points origin length "
    "radii luminosities psf slab",
    kinds.COLORS: "colors",
    kinds.WHOLE: "samples max_panels channel bits",
    kinds.WHOLES: "resolution channels numbers",
    kinds.TEXTS: "labels",
    kinds.BOOLEANS: "visible",
    kinds.BOOLEAN: "bounds transparent half",
}
_KINDS = {key: kind for kind, keys in _OF_ALL.items() for key in keys.split()}
_COLOR = replace(kinds.COLORS, expected=f"{kinds.COLORS.expected}, or a table")
_MEDIUM = _KINDS | dict.fromkeys(("color", "colors"), replace(_COLOR, make=lambda t: _color_by(t)))
_CAMERA = _KINDS | {"center": kinds.QUANTITIES}
_IMAGE = _KINDS | dict.fromkeys(("vmin", "vmax"), kinds.NUMBER)
_RENDER = _KINDS | {"level": kinds.WHOLE_OR_AUTO}


def build_medium(sections: Sequence[Mapping[str, Any]]) -> Medium:
    """Return the sum of the media in ``[[medium]]``."""
    from ..calibration.labels import Labels
    from ..media import MEDIA

    parts = _listed("medium", sections, {**MEDIA, "labels": Labels}, _MEDIUM)
    with placed("[[medium]]"):
        medium: Medium = sum(parts[1:], parts[0])
    return medium


def build_objects(sections: list[Mapping[str, Any]]) -> list[SceneObject]:
    """Return the stars, lines, … in ``[[object]]``."""
    from ..objects import OBJECTS

    return _listed("object", sections, OBJECTS, _KINDS)


def _listed(
    name: str,
    sections: Sequence[Mapping[str, Any]],
    types: Mapping[str, Any],
    kinds: dict[str, Kind],
) -> list[Any]:
    made = []
    for number, section in enumerate(sections, start=1):
        with placed(f"[[{name}]] {number}"):
            make, rest = _typed(section, types)
            made.append(make(**arguments(make, rest, kinds)))
    return made


def _typed(section: Mapping[str, Any], types: Mapping[str, Any]) -> tuple[Any, dict[str, Any]]:
    if "type" not in section:
        raise InputError(f"type is missing; there are: {', '.join(sorted(types))}")
    name = kinds.TEXT("type", section["type"])
    check_name("type", name, types)
    return types[name], {key: value for key, value in section.items() if key != "type"}


def _color_by(section: Mapping[str, Any]) -> Any:
    """Return the colouring by another expression, from the table ``color`` of a medium."""
    from ..media import ColorBy

    with placed("color"):
        return ColorBy(**arguments(ColorBy, section, _MEDIUM))


def build_camera(section: Mapping[str, Any]) -> Camera:
    """Return the camera of ``[camera]``; its `looking` constructs it from a ``view_direction``."""
    from ..cameras import CAMERAS

    with placed("[camera]"):
        make, rest = _typed({"type": "orthographic", **section}, CAMERAS)
        others: dict[str, Any] = {}
        if "view_direction" in section:
            accepted = inspect.signature(make.looking).parameters
            others = {k: v for k, v in rest.items() if k not in accepted}
            check_keys(others, inspect.signature(make).parameters)
            if taken := {"incl", "phi", "target"} & set(others):
                raise InputError(
                    "view_direction takes the place of angles and target; leave those out, got "
                    f"also {', '.join(sorted(taken))}"
                )
            rest = {k: v for k, v in rest.items() if k in accepted}
            make = make.looking
        camera: Camera = make(**arguments(make, rest, _CAMERA), **converted(others, _CAMERA))
        return camera


def plain_render(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return keyword arguments of `render` in the form of ``[render]``.

    None is omitted if it is the default, and written as a word otherwise.
    """
    default, plain = _render_defaults(), {}
    for key, value in options.items():
        if value is not None:
            plain[key] = plain_value(value)
        elif default.get(key, 0) is not None:
            plain[key] = kinds.NONE
    return plain


def render_options(section: Mapping[str, Any]) -> dict[str, Any]:
    """Return ``[render]`` as keyword arguments of `render`."""
    from ..backend.device import DEVICES, PRECISIONS
    from ..memory import byte_count
    from ..regions import region_of
    from ..rendering.options import check_cutoff, check_tolerance
    from ..schemes import SCHEMES

    with placed("[render]"):
        check_keys(section, _render_defaults())
        options = converted(section, _RENDER)
        for key, names in (
            ("scheme", SCHEMES),
            ("precision", PRECISIONS),
            ("device", ("auto", *DEVICES)),
        ):
            if key in options:
                check_name(key, options[key], names)
        check_cutoff(options.get("cutoff"))
        check_tolerance(options.get("tolerance"))
        if "clip" in options:
            region_of(options["clip"])
        if "memory" in options:
            byte_count(options["memory"])
    return options


# Arguments of `render` that are no plain values, or of one machine.
_OF_PYTHON = ("objects", "progress", "executor", "checkpoint")


def _render_defaults() -> dict[str, Any]:
    """Return the options of `render` that ``[render]`` may contain, with their defaults."""
    from ..rendering.options import RenderOptions

    return {f.name: f.default for f in fields(RenderOptions) if f.name not in _OF_PYTHON}


def projection(section: Mapping[str, Any]) -> dict[str, Any]:
    """Return ``[project]`` as keyword arguments of `project`; {} if a scene has none."""
    from ..measuring.projections import HOW

    with placed("[project]"):
        check_keys(section, ("quantity", "how", "slab", "unit"))
        if section and "quantity" not in section:
            raise InputError("quantity is missing: a field or an expression, such as 'density'")
        options = converted(section, _KINDS)
        if "how" in options:
            check_name("how", options["how"], HOW)
    return options


def image_options(section: Mapping[str, Any], channels: int) -> dict[str, Any]:
    """Return the options of `Image.save` in ``[image]``, validated on a picture of one pixel."""
    import numpy as np

    from ..image import Image
    from ..image.formats import FORMATS, format_of, png

    with placed("[image]"):
        check_keys(section, frozenset().union(*(form.options for form in FORMATS)))
        options = converted(section, _IMAGE)
        of_png = format_of(Path("a.png")).options
        pixel = Image(np.ones((1, 1, channels)), transparency=np.ones((1, 1)))
        png.encode(pixel, **{k: v for k, v in options.items() if k in of_png})
    return options


_FILE: dict[str, Kind] = {
    **dict.fromkeys(("unit", "axes", "name"), kinds.TEXT),
    **dict.fromkeys(("x", "y", "z"), kinds.NUMBERS_OR_TEXT),
    **dict.fromkeys(("bounds", "spacing"), kinds.QUANTITIES),
}
_OWN: dict[str, Kind] = {
    **dict.fromkeys(("model", "format"), kinds.TEXT),
    "path": kinds.TEXTS,
    "fields": kinds.FIELDS,
    "derived": kinds.EXPRESSION_TABLE,
    "units": kinds.TEXT_TABLE,
}


@dataclass
class VolumeSource:
    """Source of a volume: a file (as in `io.open`) or the name of a function of `models`.

    `derived` are fields to add (name → expression), `units` those of plain fields, `options` those
    of the reader, or the arguments of the model.
    """

    path: str | list[str] | None = None
    model: str | None = None
    format: str | None = None
    fields: FieldChoice = None
    derived: dict[str, Any] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    options: dict[str, Any] = field(default_factory=dict)

    def build(self, directory: Path) -> Volume:
        """Return the volume; a relative path is relative to `directory`."""
        from ..io import find_reader
        from ..io import open as open_volume

        with placed("[volume]"):
            units, options = self.units, self.options
            if self.path is not None:
                several = isinstance(self.path, list)
                paths = self.path if isinstance(self.path, list) else [self.path]
                path: Any = [seen_from(directory, one) for one in paths]
                path = path if several else path[0]
                if not several and units and "units" in find_reader(path, self.format).options:
                    # Such a reader has units and converts the values itself.
                    units, options = {}, {**options, "units": units}
                volume = open_volume(path, self.fields, format=self.format, **options)
            else:
                volume = models()[str(self.model)](**options)
            for name, unit in units.items():
                volume.set_unit(name, unit)
            for name, expression in self.derived.items():
                volume[name] = Expression(expression)
        return volume

    def of_file(self, path: Path) -> Volume:
        """Return the volume in another file, read in the same way, with the same derived fields."""
        options = {} if self.path is None else self.options  # not those of a model
        return replace(self, path=str(path), model=None, options=options).build(Path())


def read_source(section: Mapping[str, Any]) -> VolumeSource:
    """Parse ``[volume]``; it is validated as far as possible without opening the file."""
    from ..io.registry import readers

    with placed("[volume]"):
        if ("path" in section) == ("model" in section):
            raise InputError("give path = a file, or model = one of " + ", ".join(sorted(models())))
        chosen = kinds.converted({k: v for k, v in section.items() if k in _OWN}, _OWN)
        source = VolumeSource(**chosen)
        options = {key: value for key, value in section.items() if key not in _OWN}
        if source.path is not None:
            known = {reader.name: reader for reader in readers()}
            if source.format is not None:
                check_name("format", source.format, known)
                asked = [known[source.format]]
            else:  # by name, compressed or not
                paths = source.path if isinstance(source.path, list) else [source.path]
                endings = {suffix.lower() for path in paths for suffix in Path(path).suffixes}
                asked = [reader for reader in known.values() if endings & set(reader.suffixes)]
            if asked:  # otherwise the file's content determines the reader on opening
                kinds.check_keys(options, {*_OWN}.union(*(reader.options for reader in asked)))
            source.options = typed_options(options)
        else:
            if wrong := {"format", "fields"} & section.keys():
                raise InputError(f"{min(wrong)} belongs to a file (path = …), not to a model")
            check_name("model", source.model, models())
            source.options = kinds.arguments(models()[str(source.model)], options, {})
    with placed("[volume.units]"):
        for unit in source.units.values():
            parse_unit(unit)
    for name, text in source.derived.items():
        with placed(f"[volume.derived] {name}"):
            Expression(text)
    return source


def models() -> dict[str, Callable[..., Volume]]:
    """Return the functions of `voluminous.models` by name."""
    from .. import models as module

    return {
        name: function
        for name, function in vars(module).items()
        if inspect.isfunction(function)
        and function.__module__ == module.__name__
        and not name.startswith("_")
    }


def typed_options(options: Mapping[str, Any]) -> dict[str, Any]:
    """Convert plain values to the types that a reader expects."""
    return kinds.converted(options, _FILE)
