"""Tell what one ray of a picture saw, cell by cell."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import InputError
from . import render_volume
from .common import add_render_options, say
from .data import assignment, is_volume
from .render import scene_from

if TYPE_CHECKING:
    from ..measuring import Probe
    from ..scene import Scene

# Options in a scene's [render] that apply to a single ray.
_OPTIONS = ("scheme", "tolerance", "background", "precision", "device", "order", "cutoff")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument(
        "scene",
        type=Path,
        metavar="FILE",
        help="scene file (TOML), an image that was rendered from one, or a file with data",
    )
    where = parser.add_mutually_exclusive_group(required=True)
    where.add_argument(
        "--pixel",
        type=int,
        nargs=2,
        metavar=("X", "Y"),
        help="the ray through this pixel, counted from 0 at the lower left",
    )
    where.add_argument(
        "--at",
        metavar="U,V",
        help="the ray through this point of the image plane, in the unit of its coordinates or "
        "with one, such as 0.1pc,0.2pc (--at=-1,0 for one that begins with a minus)",
    )
    parser.add_argument(
        "--also",
        action="append",
        default=[],
        metavar="EXPR",
        help="another field or expression to tell, as it is in the cells; may be given often",
    )
    parser.add_argument("--all", action="store_true", help="print all segments, however many")
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        action="append",
        default=[],
        metavar="FILE",
        help="write all columns (.csv, .ecsv, .fits) or a plot (.png, .pdf, .svg); may be given "
        "several times",
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="change a value of the scene, such as camera.incl=40; for a file with data also an "
        "option of its format, such as unit=pc",
    )
    render_volume.add_arguments(parser)
    add_render_options(parser)


def run(args: argparse.Namespace) -> int:
    """Trace the ray and print its cells."""
    for path in args.output:
        _check(path)
    given = dict(assignment(text, "camera.incl=40") for text in args.set)
    scene = scene_from(args, given, is_volume(args.scene, args.format, given))
    found = _probe(scene, args)
    say(args.quiet, found.text(None if args.all else 20))
    for what in _left_out(scene):
        say(args.quiet, f"not in it, but in the picture: {what}")
    for path in args.output:
        found.save(path)
        say(args.quiet, f"{path}: {len(found)} segments")
    return 0


def _left_out(scene: Scene) -> Iterator[str]:
    options = scene.render_options
    samples = options.get("antialias") or options.get("samples", 1)
    if samples != 1:
        yield f"the mean over a pixel's rays (samples = {samples!r}); this is the one at its centre"
    if scene.objects:
        kinds = sorted({type(one).__name__.lower() for one in scene.objects})
        yield f"objects ({', '.join(kinds)})"


def _check(path: Path) -> None:
    from ..measuring.probing.result import check_suffix

    check_suffix(path)
    if not path.resolve().parent.is_dir():
        raise InputError(f"the directory {path.parent} does not exist; create it first")


def _probe(scene: Scene, args: argparse.Namespace) -> Probe:
    from ..measuring import probe
    from ..progress import progress_bar

    options: dict[str, Any] = {k: v for k, v in scene.render_options.items() if k in _OPTIONS}
    if isinstance(options.get("background"), str):
        options["background"] = scene.background(options["background"])
    options |= {"pixel": args.pixel, "at": _point(args.at), "also": args.also}
    with progress_bar(False if args.quiet else None, args.scene.name) as progress:
        return probe(scene.volume(), scene.medium, scene.camera, **options, progress=progress)


def _point(text: str | None) -> Any:
    from ..scene.kinds import QUANTITIES

    return None if text is None else QUANTITIES("--at", [part.strip() for part in text.split(",")])
