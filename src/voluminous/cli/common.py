"""Render options and messages shared by several commands."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import InputError

if TYPE_CHECKING:
    from ..image import Image
    from ..scene import Scene


def add_render_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that override ``[render]`` in a scene.

    They are not validated here, so that ``--help`` does not import the renderer.
    """
    parser.add_argument(
        "--scheme",
        help="post-classified (default), pre-integrated, first-order, second-order or olson-kunasz",
    )
    parser.add_argument("--precision", help="single (default) or double")
    parser.add_argument("--device", help="auto (default), cpu, cuda or metal")
    parser.add_argument("-q", "--quiet", action="store_true", help="say nothing but errors")


def given_options(args: argparse.Namespace) -> dict[str, Any]:
    """Return the changes to a scene that the options request."""
    from ..scene.sections import render_options

    names = ("scheme", "precision", "device")
    given = {n: getattr(args, n) for n in names if getattr(args, n) is not None}
    return {f"render.{name}": value for name, value in render_options(given).items()}


def render_scene(scene: Scene, label: str, quiet: bool) -> tuple[Image, float]:
    """Render with a progress bar on a terminal; return the image and the seconds it took."""
    from ..progress import progress_bar

    start = time.perf_counter()
    with progress_bar(False if quiet else None, label) as progress:
        image = scene.render(progress=progress)
    return image, time.perf_counter() - start


def check_output(path: Path) -> Path:
    """Raise before any work if the output file cannot be written."""
    from ..image.formats import format_of

    format_of(path)
    if path.is_dir():
        raise InputError(f"{path} is a directory; give the name of a file in it")
    if not path.resolve().parent.is_dir():
        raise InputError(f"the directory {path.parent} does not exist; create it first")
    return path


def told(image: Image, seconds: float) -> str:
    """Return a line with size, scheme, precision, device, time and automatic exposure."""
    ny, nx, channels = image.shape
    how = image.provenance or {}
    return (
        f"{nx} x {ny} pixels, {channels} channel{'s' * (channels > 1)}, {how.get('scheme')}, "
        f"{how.get('precision')} precision, {how.get('device')}, {seconds:.2f} s, "
        f"automatic exposure {image.exposure:.4g}"
    )


def say(quiet: bool, *lines: str) -> None:
    """Print lines unless `quiet`."""
    if not quiet:
        print(*lines, sep="\n", file=sys.stdout, flush=True)
