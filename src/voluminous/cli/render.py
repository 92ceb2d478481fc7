"""Render a scene, or a file with data, to an image."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import InputError
from ..files import url_of
from . import render_volume
from .common import (
    add_render_options,
    check_output,
    given_options,
    render_scene,
    say,
    told,
)
from .data import assignment, is_volume

if TYPE_CHECKING:
    from ..scene import Scene

# Values that are paths; on the command line they are relative to the working directory.
_PATHS = ("volume.path", "render.background")
_PACKED = (".gz", ".bz2", ".xz")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument(
        "scene",
        type=Path,
        metavar="FILE",
        help="scene file (TOML), an image that was rendered from one, or a file with data, of "
        "which a first picture is made",
    )
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        action="append",
        metavar="FILE",
        help="image to write (.png, .tif, .exr, .fits, .npz); may be given several times; "
        "by default the file's name with .png, in the working directory",
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="change a value of the scene, such as camera.incl=40 or medium.2.opacity=0.3; for a "
        "file with data also an option of its format, such as unit=pc",
    )
    parser.add_argument(
        "--annotate",
        action="store_true",
        help="add a scale bar, axes, colour bars with histograms and the time (.png, .jpg, .pdf)",
    )
    render_volume.add_arguments(parser)
    add_render_options(parser)


def run(args: argparse.Namespace) -> int:
    """Render and save."""
    given = dict(assignment(text, "camera.incl=40") for text in args.set)
    of_data = is_volume(args.scene, args.format, given)
    chosen = args.output or [_default_output(args.scene, of_data)]
    outputs = [check_output(path) for path in chosen]
    scene = scene_from(args, given, of_data)
    if args.annotate:
        _annotate(scene, outputs)
    image, seconds = render_scene(scene, args.scene.name, args.quiet)
    for path in outputs:
        told_scene = {"scene": scene.to_dict(path.resolve().parent)}
        image = image.replace(provenance={**(image.provenance or {}), **told_scene})
        scene.save_image(image, path)
        say(args.quiet, f"{path}: {told(image, seconds)}")
    return 0


def scene_from(args: argparse.Namespace, given: dict[str, Any], of_data: bool) -> Scene:
    """Return the scene in a file, or one generated for a data file, with the arguments applied.

    Parameters
    ----------
    args : Namespace
    given : dict
        Keys and values of ``--set``; for data files also the reader's options.
    of_data : bool
        True for a data file.
    """
    from ..scene import Scene

    options = given_options(args)
    if of_data:
        scene, choice = render_volume.scene_of(args, _taken_options(given), given)
        say(args.quiet, choice)
    else:
        render_volume.refuse_options(args)
        scene = Scene.load(args.scene)
    changes = {place: changed_value(place, value, scene) for place, value in given.items()}
    changes |= options
    return scene.replaced(changes) if changes else scene


def _taken_options(given: dict[str, Any]) -> dict[str, Any]:
    """Remove the reader's options from `given` and return them."""
    return {
        option: given.pop(place)
        for place in list(given)
        if (option := render_volume.reader_option(place)) is not None
    }


def _annotate(scene: Scene, outputs: list[Path]) -> None:
    """Set the scene's image options so that pictures are annotated from volume and medium."""
    from ..image.formats import format_of

    if not any("annotate" in format_of(path).options for path in outputs):
        raise InputError("--annotate is for pictures to look at: give a .png or .pdf with -o")
    given = scene.image_options.get("annotate")
    known = {"volume": scene.volume().seen_by(scene.camera), "medium": scene.medium}
    annotations = {**known, **(given if isinstance(given, dict) else {})}
    scene.image_options = {**scene.image_options, "annotate": annotations}


def changed_value(place: str, value: Any, scene: Scene) -> Any:
    """Return a value for a key of a scene."""
    if place in _PATHS and isinstance(value, str) and not url_of(Path(value)):
        return os.path.relpath(os.path.expanduser(value), scene.directory)
    return value


def _default_output(path: Path, of_data: bool) -> Path:
    from ..image.formats import FORMATS

    pictures = [suffix for form in FORMATS for suffix in form.suffixes]
    if path.is_file() and not of_data and path.suffix.lower() in pictures:
        raise InputError(f"say with -o what to write: the scene comes from the image {path}")
    name = Path(os.path.abspath(path)).name
    for suffix in _PACKED:
        name = name.removesuffix(suffix)
    return Path(Path(name).stem + ".png")
