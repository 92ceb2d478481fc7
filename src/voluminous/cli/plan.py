"""Tell what drawing a scene or data chunk by chunk will take: memory and reading."""

from __future__ import annotations

import argparse

from ..errors import InputError
from .render import add_scene_arguments, scene_from


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    add_scene_arguments(parser)
    help = "processes that draw side by side (1)"
    parser.add_argument("--workers", type=int, default=1, metavar="N", help=help)


def run(args: argparse.Namespace) -> int:
    """Print the plan."""
    from ..large.planning import plan

    if args.workers < 1:
        raise InputError(f"--workers is 1 or more, got {args.workers}")
    scene = scene_from(args)
    options = {**scene.render_options, "objects": scene.objects}
    print(plan(scene.volume(), scene.medium, scene.camera, workers=args.workers, **options))
    return 0
