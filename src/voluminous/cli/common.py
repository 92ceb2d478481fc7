"""Options, checks and messages shared by several commands."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import InputError

if TYPE_CHECKING:
    from ..image import Image
    from ..scene import Scene

_RENDER = {
    "scheme": "post-classified (default), pre-integrated, first-order, second-order or "
    "olson-kunasz",
    "precision": "single (default) or double",
    "device": "auto (default), cpu, cuda or metal",
    "memory": "what drawing may take, such as 2GiB: the data are read and drawn chunk by chunk",
    "level": "a coarser level of a file that has some: 1, 2 …, or auto: as fine as the pixels",
}


def add_several(
    parser: argparse._ActionsContainer, name: str, metavar: str, help: str, **more: Any
) -> None:
    """Add an option that may be given several times."""
    options = {"action": "append", "default": [], "metavar": metavar, "help": help, **more}
    parser.add_argument(*name.split(), **options)


def add_quiet(parser: argparse._ActionsContainer) -> None:
    """Add the option that turns messages off."""
    parser.add_argument("-q", "--quiet", action="store_true", help="say nothing but errors")


def add_render_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that override ``[render]`` in a scene, and ``--quiet``.

    They are not validated here, so that ``--help`` does not import the renderer.
    """
    for name, help in _RENDER.items():
        parser.add_argument(f"--{name}", help=help)
    add_quiet(parser)


def given_options(args: argparse.Namespace) -> dict[str, Any]:
    """Return the keyword arguments of `render` that the options give."""
    from ..scene.sections import render_options
    from ..scene.settings import value

    given = {name: getattr(args, name) for name in _RENDER}
    return render_options({name: value(text) for name, text in given.items() if text is not None})


def assignment(text: str, option: str, example: str) -> tuple[str, str]:
    """Return both sides of ``unit=pc``."""
    key, _, value = (part.strip() for part in text.partition("="))
    if not key or not value:
        raise InputError(f"{option} expects {example}, got {text!r}")
    return key, value


def settings(texts: list[str], example: str) -> dict[str, Any]:
    """Return keys and values of ``--set``; values are written as in TOML, or texts."""
    from ..scene.settings import value

    pairs = (assignment(text, "--set", f"KEY=VALUE such as {example}") for text in texts)
    return {key: value(text) for key, text in pairs}


def render_scene(scene: Scene, label: str, quiet: bool) -> tuple[Image, float]:
    """Render with a progress bar on a terminal; return the image and the seconds it took."""
    from ..progress import progress_bar

    start = time.perf_counter()
    with progress_bar(False if quiet else None, label) as progress:
        image = scene.render(progress=progress)
    return image, time.perf_counter() - start


def check_directory(path: Path) -> Path:
    """Raise before any work if the directory of an output file does not exist."""
    if not path.resolve().parent.is_dir():
        raise InputError(f"the directory {path.parent} does not exist; create it first")
    return path


def check_output(path: Path) -> Path:
    """Raise before any work if an image cannot be written to a path."""
    from ..image.formats import format_of

    format_of(path)
    if path.is_dir():
        raise InputError(f"{path} is a directory; give the name of a file in it")
    return check_directory(path)


def summary(image: Image, seconds: float) -> str:
    """Return a line with size, scheme, precision, device, time and automatic exposure."""
    ny, nx, channels = image.shape
    how = image.provenance or {}
    scheme = f"{how.get('scheme')}, {how.get('precision')} precision, {how.get('device')}"
    drawn = how.get("map", scheme)
    return (
        f"{nx} x {ny} pixels, {channels} channel{'s' * (channels > 1)}, {drawn}, {seconds:.2f} s, "
        f"automatic exposure {image.exposure:.4g}"
    )


def say(quiet: bool, *lines: str) -> None:
    """Print lines unless `quiet`."""
    if lines and not quiet:
        print(*lines, sep="\n", flush=True)
