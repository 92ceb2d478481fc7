"""Render a scene, or a file with data, to an image."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import InputError
from . import render_volume
from .common import (
    add_render_options,
    check_output,
    given_options,
    render_scene,
    say,
    told,
)

if TYPE_CHECKING:
    from ..scene import Scene

# Values that are paths: on the command line they are relative to the working directory.
_PATHS = ("volume.path", "render.background")


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
        help="change a value of the scene, such as camera.incl=40 or medium.2.opacity=0.3",
    )
    render_volume.add_arguments(parser)
    add_render_options(parser)


def run(args: argparse.Namespace) -> int:
    """Render and save."""
    scene = _scene(args)
    changes = dict(_assignment(text, scene) for text in args.set) | given_options(args)
    if changes:
        scene = scene.replaced(changes)
    outputs = [check_output(path) for path in args.output or [_default_output(args.scene)]]
    image, seconds = render_scene(scene, args.scene.name, args.quiet)
    for path in outputs:
        image.provenance = {
            **(image.provenance or {}),
            "scene": scene.to_dict(path.resolve().parent),
        }
        scene.save_image(image, path)
        say(args.quiet, f"{path}: {told(image, seconds)}")
    return 0


def _scene(args: argparse.Namespace) -> Scene:
    """Return the scene in a file, or one made for the data in it."""
    from ..scene import Scene

    if render_volume.is_volume(args.scene):
        return render_volume.scene_of(args)
    render_volume.refuse_options(args)
    return Scene.load(args.scene)


def _assignment(text: str, scene: Scene) -> tuple[str, Any]:
    """Return place and value of ``camera.incl=40``."""
    from ..scene.toml import value

    place, equals, given = text.partition("=")
    if not equals or not place.strip():
        raise InputError(f"--set expects KEY=VALUE such as camera.incl=40, got {text!r}")
    place, parsed = place.strip(), value(given.strip())
    if place in _PATHS and isinstance(parsed, str):
        parsed = os.path.relpath(os.path.expanduser(parsed), scene.directory)
    return place, parsed


def _default_output(scene: Path) -> Path:
    if scene.suffix.lower() != ".toml" and not render_volume.is_volume(scene):
        raise InputError(f"say with -o what to write: the scene comes from the image {scene}")
    return Path(scene.stem + ".png")
