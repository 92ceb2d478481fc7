"""Render three pictures of a prestellar core, and one of them side by side."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .common import add_render_options, check_output, given_options, render_scene, say, told

if TYPE_CHECKING:
    from ..image import Image
    from ..scene import Scene

# Peters, The physics of volume rendering (2014), section 5: colours and places of the two shells.
_OUTER = {"center": 3.5, "color": [0.4, 0.4, 0.8]}
_INNER = {"center": 4.0, "color": [0.89, 0.47, 0.06]}
_PATH_LENGTH = "2.5e16 cm"


def _shells(kind: str, opacity: float, width: str, outer: float, inner: float) -> list[Any]:
    common = {"type": kind, "expr": "log10(density)", "path_length": _PATH_LENGTH}
    return [
        {**common, **shell, width: value, "opacity": opacity}
        for shell, value in ((_OUTER, outer), (_INNER, inner))
    ]


PANELS: dict[str, list[Any]] = {
    "transparent: emission adds up": _shells("gaussian", 0.001, "sigma", 0.05, 0.10),
    "opaque: the outer shell absorbs": _shells("gaussian", 2.0, "sigma", 0.05, 0.10),
    "rectangles: shells with sharp edges": _shells("rectangle", 0.3, "half_width", 0.05, 0.10),
}
"""Title and media of each panel."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        default=Path("core.png"),
        metavar="FILE",
        help="the labelled picture (default core.png); the panels are core-1.png, …",
    )
    parser.add_argument("--resolution", type=int, default=400, help="pixels per side (400)")
    parser.add_argument("--cells", type=int, default=100, help="cells per side (100)")
    add_render_options(parser)


def run(args: argparse.Namespace) -> int:
    """Render the panels, save them, and draw them side by side."""
    from ..scene import Scene

    start = time.perf_counter()
    output = check_output(args.output)
    first, *_ = PANELS.values()
    scene = Scene(_settings(args, first)).replaced(given_options(args))
    say(args.quiet, f"A prestellar core, {args.cells}^3 cells, density ~ 1/r^2, seen face-on:")
    images = []
    for number, (title, media) in enumerate(PANELS.items(), start=1):
        path = output.with_name(f"{output.stem}-{number}{output.suffix}")
        images.append(_panel(scene.replaced_media(media), path, title, args.quiet))
    _draw(images, output)
    say(args.quiet, f"  {output}: all three side by side", "", _outlook(output, start))
    return 0


def _settings(args: argparse.Namespace, media: list[Any]) -> dict[str, Any]:
    return {
        "volume": {"model": "prestellar_core", "resolution": args.cells},
        "medium": media,
        "camera": {"incl": 0.0, "phi": 0.0, "width": "0.25 pc", "resolution": args.resolution},
    }
