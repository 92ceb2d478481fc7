"""Render a scene, or a file with data, to an image."""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import InputError
from ..files import url_of
from .common import (
    add_render_options,
    add_several,
    check_output,
    given_options,
    render_scene,
    say,
    settings,
    summary,
)
from .data import data_file, first_field, is_volume, opened

if TYPE_CHECKING:
    from ..media import Medium
    from ..scene import Scene
    from ..volume import Volume

LEVELS, PIXELS = 4, 800
# Values that are paths; on the command line they are relative to the working directory.
_PATHS = ("volume.path", "render.background")
_PACKED = (".gz", ".bz2", ".xz")
# Options for data files only; a scene file contains these settings.
_OF_DATA = ("field", "levels", "incl", "phi", "view", "format")
# Keys of [volume] that are not reader options.
_NO_OPTIONS = ("path", "model", "fields", "derived", "units")
# Maximum number of names in a message.
_SHOWN = 8


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    help = (
        "image to write (.png, .tif, .exr, .fits, .npz); may be given several times; "
        "by default the file's name with .png, in the working directory"
    )
    add_several(parser, "-o --output", "FILE", help, type=Path)
    help = "add a scale bar, axes, colour bars with histograms and the time (.png, .jpg, .pdf)"
    parser.add_argument("--annotate", action="store_true", help=help)
    add_scene_arguments(parser)


def add_scene_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the file of a scene and the options that change it, or make it for a data file."""
    parser.add_argument(
        "scene",
        type=Path,
        metavar="FILE",
        help="scene file (TOML), an image that was rendered from one, or a file with data, of "
        "which a first picture is made",
    )
    help = "more files with data, and tables of labels: one volume with the fields of all"
    parser.add_argument("more", type=Path, nargs="*", metavar="FILE", help=help)
    help = (
        "change a value of the scene, such as camera.incl=40 or medium.2.opacity=0.3; for a "
        "file with data also an option of its format, such as unit=pc"
    )
    add_several(parser, "--set", "KEY=VALUE", help)
    add_render_options(parser)
    # All are None unless given.
    group = parser.add_argument_group("data files", "what is chosen by itself for these")
    group.add_argument("--field", metavar="EXPR", help="field or expression to show")
    group.add_argument("-n", "--levels", type=int, metavar="N", help=f"number of shells ({LEVELS})")
    group.add_argument("--incl", type=float, metavar="DEG", help="inclination (60)")
    group.add_argument("--phi", type=float, metavar="DEG", help="azimuth (30)")
    help = "instead: anterior, posterior, left, right, superior, inferior; stack (of pictures)"
    group.add_argument("--view", metavar="NAME", help=help)
    group.add_argument("--format", metavar="NAME", help="format, if the file does not tell")


def run(args: argparse.Namespace) -> int:
    """Render and save."""
    of_data = is_volume(args.scene, args.format)
    outputs = [check_output(path) for path in args.output or [_default_output(args.scene, of_data)]]
    scene = scene_from(args, of_data)
    if args.annotate:
        _annotate(scene, outputs)
    image, seconds = render_scene(scene, args.scene.name, args.quiet)
    for path in outputs:
        carried = {"scene": scene.to_dict(path.resolve().parent)}
        image = image.replace(provenance={**(image.provenance or {}), **carried})
        scene.save_image(image, path)
        say(args.quiet, f"{path}: {summary(image, seconds)}")
    return 0


def _default_output(path: Path, of_data: bool) -> Path:
    from ..image.formats import FORMATS

    pictures = [suffix for form in FORMATS for suffix in form.suffixes]
    if path.is_file() and not of_data and path.suffix.lower() in pictures:
        raise InputError(f"say with -o what to write: the scene comes from the image {path}")
    name = Path(os.path.abspath(path)).name
    for suffix in _PACKED:
        name = name.removesuffix(suffix)
    return Path(Path(name).stem + ".png")


def _annotate(scene: Scene, outputs: list[Path]) -> None:
    from ..image.formats import format_of

    if not any("annotate" in format_of(path).options for path in outputs):
        raise InputError("--annotate is for pictures to look at: give a .png or .pdf with -o")
    given = scene.image_options.get("annotate")
    annotations: dict[str, Any] = {"volume": scene.volume().seen_by(scene.camera)}
    annotations |= {} if scene.projection else {"medium": scene.medium}
    annotations |= given if isinstance(given, dict) else {}
    scene.image_options = {**scene.image_options, "annotate": annotations}


def scene_from(
    args: argparse.Namespace, of_data: bool | None = None, *, all_fields: bool = False
) -> Scene:
    """Return the scene in a file, or one made for a data file, with all options applied.

    Of a data file it has the fields that its medium uses, or `all_fields`, unread.
    """
    from ..scene import Scene

    changes = settings(args.set, "camera.incl=40")
    options = given_options(args)
    if is_volume(args.scene, args.format) if of_data is None else of_data:
        of_reader = {place: value for place, value in changes.items() if _is_of_reader(place)}
        changes = {place: value for place, value in changes.items() if place not in of_reader}
        scene = _scene_of_data(args, of_reader, changes, all_fields)
    else:
        given = [f"--{name}" for name in _OF_DATA if getattr(args, name) is not None]
        given += [str(path) for path in args.more]
        if given:
            raise InputError(
                f"{' and '.join(given)}: for data files only; change this scene with --set, such "
                "as --set camera.incl=40"
            )
        scene = Scene.load(args.scene)
    for place in _PATHS:
        path = changes.get(place)
        if isinstance(path, str) and not url_of(Path(path)):
            changes[place] = os.path.relpath(os.path.expanduser(path), scene.directory)
    changes |= {f"render.{name}": value for name, value in options.items()}
    return scene.replaced(changes) if changes else scene


def _is_of_reader(place: str) -> bool:
    """Return True if a key of ``--set`` is an option of the reader, not a place in the scene."""
    from ..scene.settings import SECTIONS

    section, dot, key = place.partition(".")
    if not dot:
        return place not in SECTIONS
    return section == "volume" and key.partition(".")[0] not in _NO_OPTIONS


def _scene_of_data(
    args: argparse.Namespace, options: dict[str, Any], changes: dict[str, Any], all_fields: bool
) -> Scene:
    """Return the scene for a data file; say what was chosen.

    The medium is automatic shells of one field, or all channels of a microscope. The camera frames
    everything visible, seen obliquely, or in the direction that the metadata of a medical volume or
    an image stack defines; it chooses no direction if `changes` set another camera.
    """
    from ..calibration import presets, suggest_medium
    from ..drawing.api import first_medium
    from ..rendering import framed
    from ..scene import Scene

    data = data_file(args.scene, args, options)
    volume, places = opened(data, args.field)
    known, looked, framing = volume.fields, volume, volume
    if all_fields:  # for the explorer, which is open at once
        from ..viewer.painter import measured, small

        looked, framing = measured(volume), small(volume)
    if args.levels is not None and args.levels < 1:
        raise InputError(f"--levels is the number of shells, at least 1, got {args.levels}")
    suited, notes = presets.recognised(looked)
    if args.field is None and args.levels is None and suited:
        medium = first_medium(looked)
    else:
        medium = suggest_medium(looked, args.field or first_field(looked), args.levels or LEVELS)
    fields: Any = places
    if not all_fields:
        used = volume.given(medium.names)
        for name in known:
            if name not in used:
                del volume[name]
        fields = list(volume.fields)
        fields = fields if places is None else {name: places[name] for name in fields}
    # The user's viewing angles; the camera is framed for these.
    camera: dict[str, Any] = {}
    for name in ("incl", "phi"):
        given = changes.get(f"camera.{name}")
        if getattr(args, name) is not None:
            camera[name] = getattr(args, name)
        elif type(given) in (int, float):
            camera[name] = given
    other_type = changes.get("camera.type", "orthographic") != "orthographic"
    if "camera.view_direction" not in changes and not other_type:
        view = framed(framing, medium, camera.get("incl"), camera.get("phi"), view=args.view)
        camera |= {"incl": view.incl, "phi": view.phi}
        camera |= {"posang": view.posang} if view.posang else {}
        if view.width is not None:
            camera |= {"width": view.width, "shift": list(view.shift)}
    elif args.view is not None:
        raise InputError("--view chooses the camera's angles; leave out the --set of a camera")
    path: Path = args.scene
    source = data.section(fields, path.name or str(path.resolve()))
    parts = {"volume": source, "medium": medium, "camera": {**camera, "resolution": PIXELS}}
    say(args.quiet, *volume.meta.get("notes", ()), *notes)
    say(args.quiet, _choice(volume, medium, camera))
    if others := [name for name in known if name not in volume]:
        say(args.quiet, f"other fields (--field): {_listed(others)}")
    return Scene(parts, path.parent, volume=volume)


def _choice(volume: Volume, medium: Medium, camera: dict[str, Any]) -> str:
    parts: list[Any] = list(medium.components())
    if hasattr(parts[0], "center"):
        kind = "shell at" if len(parts) == 1 else f"{len(parts)} shells at"
        text = f"{parts[0].expr.text}: {kind} {_listed(f'{p.center:.4g}' for p in parts)}"
    elif medium.discrete:
        text = f"{parts[0].expr.text}: {len(parts[0].labels)} labels: {_listed(parts[0].labels)}"
    else:
        kind = "channels" if len(parts) > 1 else "CT, skin and bone:"
        text = f"{kind} {_listed(p.expr.text for p in parts)}"
    units = [f"{name} in {unit}" for name, unit in volume.units.items() if unit]
    text += f" ({', '.join(units)})" if units else ""
    if {"incl", "phi"} <= camera.keys():
        text += f", seen from incl {camera['incl']:g}, phi {camera['phi']:g}"
    if "width" in camera:
        text += f", {camera['width']:g} {volume.unit or ''}".rstrip() + " wide"
    return text


def _listed(texts: Iterable[str]) -> str:
    names = list(texts)
    return ", ".join([*names[:_SHOWN], *["…"][: len(names) > _SHOWN]])
