"""The scene for a data file: automatic shells, and a camera that frames the visible part."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import InputError
from ..first_view import FIRST_INCL, FIRST_PHI
from .data import DataFile, opened

if TYPE_CHECKING:
    from ..media import Medium
    from ..scene import Scene
    from ..volume import Volume


LEVELS = 4
PIXELS, _TYPE = 800, "orthographic"
# Options for data files only; a scene file contains these settings.
_OPTIONS = ("field", "levels", "incl", "phi", "view", "format")
# Keys of [volume] that are not reader options.
_NO_OPTIONS = ("path", "model", "fields", "derived", "units")
_SHOWN = 8
_VIEWS = "instead: anterior, posterior, left, right, superior, inferior; stack (of pictures)"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options for data files; all are None unless given."""
    group = parser.add_argument_group("data files", "what is chosen by itself for these")
    group.add_argument("--field", metavar="EXPR", help="field or expression to show")
    group.add_argument("-n", "--levels", type=int, metavar="N", help=f"number of shells ({LEVELS})")
    group.add_argument("--incl", type=float, metavar="DEG", help=f"inclination ({FIRST_INCL:g})")
    group.add_argument("--phi", type=float, metavar="DEG", help=f"azimuth ({FIRST_PHI:g})")
    group.add_argument("--view", metavar="NAME", help=_VIEWS)
    group.add_argument("--format", metavar="NAME", help="format, if the file does not tell")


def refuse_options(args: argparse.Namespace) -> None:
    """Raise if options for data files are combined with a scene."""
    given = [f"--{name}" for name in _OPTIONS if getattr(args, name) is not None]
    if given:
        raise InputError(
            f"{' and '.join(given)}: for data files only; change this scene with --set, such as "
            "--set camera.incl=40"
        )


def reader_option(place: str) -> str | None:
    """Return the reader option that a key of ``--set`` names; None for a key of the scene."""
    from ..scene.settings import SECTIONS

    section, dot, key = place.partition(".")
    if not dot:
        return None if place in SECTIONS else place
    own = key.partition(".")[0] in _NO_OPTIONS  # also volume.derived.name
    return key if section == "volume" and not own else None


def scene_of(
    args: argparse.Namespace, options: dict[str, Any], given: Mapping[str, Any]
) -> tuple[Scene, str]:
    """Return the scene for a data file, and a text that describes the choices.

    The medium is automatic shells of one field, or all channels of a microscope. The camera frames
    everything visible, seen obliquely, or in the direction that the metadata of a medical volume or
    an image stack defines.

    Parameters
    ----------
    args : Namespace
    options : dict
        Reader options.
    given : mapping
        Settings applied to the scene afterwards; no direction is chosen if they set another camera.
    """
    from ..calibration import presets, suggest_medium
    from ..rendering import framed
    from ..rendering.framing import has_channels
    from ..scene import Scene
    from .data import first_field

    data = DataFile.given(args.scene, args.format, options)
    found = opened(data, args.field)
    volume, there = found.volume, found.volume.fields
    if args.levels is not None and args.levels < 1:
        raise InputError(f"--levels is the number of shells, at least 1, got {args.levels}")
    if args.field is None and args.levels is None and has_channels(volume):
        medium = presets.fluorescence(volume)
    else:
        shown = args.field or first_field(volume)
        medium = suggest_medium(volume, shown, LEVELS if args.levels is None else args.levels)
    fields = found.keep(volume.given(medium.names))
    camera, view = {**_angles(args, given), "resolution": PIXELS}, getattr(args, "view", None)
    if not _is_other(given):
        angles = {name: camera.get(name) for name in ("incl", "phi")}
        seen = framed(volume, medium, **angles, view=view)
        camera |= {"incl": seen.incl, "phi": seen.phi}
        if seen.posang:
            camera["posang"] = seen.posang
        if seen.width is not None:
            camera |= {"width": seen.width, "shift": list(seen.shift)}
    elif view is not None:
        raise InputError("--view chooses the camera's angles; leave out the --set of a camera")
    path: Path = args.scene
    source = data.section(fields, path.name or str(path.resolve()))
    settings = {"volume": source, "medium": medium, "camera": camera}
    if medium.discrete:  # labels must not be interpolated
        settings["render"] = {"scheme": "first-order"}
    told = _told(volume, medium, camera, [name for name in there if name not in volume])
    return Scene(settings, path.parent, volume=volume), told


def _is_other(given: Mapping[str, Any]) -> bool:
    """Return True if the user sets a view direction or another type of camera."""
    return "camera.view_direction" in given or given.get("camera.type", _TYPE) != _TYPE


def _angles(args: argparse.Namespace, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the user's viewing angles; the camera is framed for these."""
    angles = {}
    for name in ("incl", "phi"):
        if getattr(args, name) is not None:
            angles[name] = getattr(args, name)
        elif type(given.get(f"camera.{name}")) in (int, float):
            angles[name] = given[f"camera.{name}"]
    return angles


def _told(volume: Volume, medium: Medium, camera: dict[str, Any], others: Iterable[str]) -> str:
    parts: list[Any] = list(medium.components())
    if hasattr(parts[0], "center"):
        levels = _listed(f"{p.center:.4g}" for p in parts)
        text = f"{parts[0].expr.text}: {_count(medium)} {levels}"
    else:
        text = f"channels {_listed(p.expr.text for p in parts)}"
    units = [f"{name} in {unit}" for name, unit in volume.units.items() if unit]
    text += f" ({', '.join(units)})" if units else ""
    if "incl" in camera and "phi" in camera:
        text += f", seen from incl {camera['incl']:g}, phi {camera['phi']:g}"
    if "width" in camera:
        text += f", {camera['width']:g} {volume.unit or ''}".rstrip() + " wide"
    rest = list(others)
    return f"{text}\nother fields (--field): {_listed(rest)}" if rest else text


def _count(medium: Medium) -> str:
    count = len(list(medium.components()))
    if medium.discrete:
        return "label" if count == 1 else f"{count} labels, cell by cell:"
    return "shell at" if count == 1 else f"{count} shells at"


def _listed(texts: Iterable[str]) -> str:
    known = list(texts)
    return ", ".join([*known[:_SHOWN], *["…"][: len(known) > _SHOWN]])
