"""Print what one ray of a picture passes through, cell by cell."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .common import add_several, check_directory, say
from .render import add_scene_arguments, scene_from

if TYPE_CHECKING:
    from ..scene import Scene

# Options in a scene's [render] that apply to a single ray.
_OPTIONS = ("scheme", "tolerance", "background", "precision", "device", "cutoff", "memory")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    where = parser.add_mutually_exclusive_group(required=True)
    help = "the ray through this pixel, counted from 0 at the lower left"
    where.add_argument("--pixel", type=int, nargs=2, metavar=("X", "Y"), help=help)
    where.add_argument(
        "--at",
        metavar="U,V",
        help="the ray through this point of the image plane, in the unit of its coordinates or "
        "with one, such as 0.1pc,0.2pc (--at=-1,0 for one that begins with a minus)",
    )
    help = "another field or expression to tell, as it is in the cells; may be given often"
    add_several(parser, "--also", "EXPR", help)
    parser.add_argument("--all", action="store_true", help="print all segments, however many")
    help = (
        "write all columns (.csv, .ecsv, .fits) or a plot (.png, .pdf, .svg); may be given "
        "several times"
    )
    add_several(parser, "-o --output", "FILE", help, type=Path)
    add_scene_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Trace the ray and print its cells."""
    from ..measuring import probe
    from ..measuring.probe_result import check_suffix
    from ..progress import progress_bar
    from ..scene.kinds import QUANTITIES

    for path in args.output:
        check_suffix(check_directory(path))
    scene = scene_from(args)
    options: dict[str, Any] = {k: v for k, v in scene.render_options.items() if k in _OPTIONS}
    if isinstance(options.get("background"), str):
        options["background"] = scene.background(options["background"])
    options |= {"pixel": args.pixel, "also": args.also}
    if args.at is not None:
        options["at"] = QUANTITIES("--at", [part.strip() for part in args.at.split(",")])
    with progress_bar(False if args.quiet else None, args.scene.name) as progress:
        result = probe(scene.volume(), scene.medium, scene.camera, **options, progress=progress)
    say(args.quiet, result.text(None if args.all else 20))
    say(args.quiet, *(f"not in it, but in the picture: {what}" for what in _left_out(scene)))
    for path in args.output:
        result.save(path)
        say(args.quiet, f"{path}: {len(result)} segments")
    return 0


def _left_out(scene: Scene) -> Iterator[str]:
    options = scene.render_options
    samples = options.get("antialias") or options.get("samples", 1)
    if samples != 1:
        yield f"the mean over a pixel's rays (samples = {samples!r}); this is the one at its centre"
    if scene.objects:
        kinds = sorted({type(one).__name__.lower() for one in scene.objects})
        yield f"objects ({', '.join(kinds)})"
