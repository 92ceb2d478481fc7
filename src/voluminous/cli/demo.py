"""Render three pictures of a prestellar core, and one of them side by side."""

from __future__ import annotations

import argparse
import shlex
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import InputError
from .common import add_render_options, check_output, given_options, render_scene, say, told

if TYPE_CHECKING:
    from ..image import Image
    from ..scene import Scene

# The two shells of Peters, The physics of volume rendering (2014), section 5.
_OUTER = {"center": 3.5, "width": 0.05, "color": [0.4, 0.4, 0.8]}
_INNER = {"center": 4.0, "width": 0.10, "color": [0.89, 0.47, 0.06]}
_PATH_LENGTH = "2.5e16 cm"
_LENGTH_UNIT = "pc"


def _shells(kind: str, width: str, opacity: float) -> list[dict[str, Any]]:
    """Return both shells as media of one kind; `width` is what that kind calls its width."""
    return [
        {
            "type": kind,
            "expr": "log10(density)",
            "center": shell["center"],
            width: shell["width"],
            "color": shell["color"],
            "opacity": opacity,
            "path_length": _PATH_LENGTH,
        }
        for shell in (_OUTER, _INNER)
    ]


PANELS: dict[str, list[dict[str, Any]]] = {
    "Gaussian shells, opacity 0.001: light adds up": _shells("gaussian", "sigma", 0.001),
    "the same, opacity 0.3: the outer shell absorbs": _shells("gaussian", "sigma", 0.3),
    "rectangle functions: shells with sharp edges": _shells("rectangle", "half_width", 0.001),
}
"""Title and media of each panel."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        default=Path("core.png"),
        metavar="FILE.png",
        help="the labelled picture (default core.png); its panels become core-1.png, …",
    )
    parser.add_argument("--resolution", type=int, default=400, help="pixels per side (400)")
    parser.add_argument("--cells", type=int, default=100, help="cells per side (100)")
    add_render_options(parser)


def run(args: argparse.Namespace) -> int:
    """Render the panels, save them, and draw them side by side."""
    from ..scene import Scene

    start = time.perf_counter()
    output = check_output(args.output)
    if output.suffix.lower() != ".png":
        raise InputError(f"the labelled picture is a PNG; give a name like core.png, got {output}")
    scene = Scene(_settings(args)).replaced(given_options(args))
    say(
        args.quiet, f"A prestellar core of {args.cells}^3 cells, density ~ 1/r^2, seen face-on:", ""
    )
    images, paths = [], []
    for number, (title, media) in enumerate(PANELS.items(), start=1):
        paths.append(output.with_name(f"{output.stem}-{number}.png"))
        scene = scene.replaced({"medium": media})
        images.append(_panel(scene, paths[-1], title, args.quiet))
    _draw(images, output)
    say(args.quiet, f"  {output}: all three side by side", "")
    say(args.quiet, *_outlook(paths[0], time.perf_counter() - start))
    return 0


def _settings(args: argparse.Namespace) -> dict[str, Any]:
    return {
        "volume": {"model": "prestellar_core", "resolution": args.cells},
        "medium": next(iter(PANELS.values())),
        "camera": {"incl": 0.0, "phi": 0.0, "width": "0.25 pc", "resolution": args.resolution},
    }


def _panel(scene: Scene, path: Path, title: str, quiet: bool) -> Image:
    image, seconds = render_scene(scene, path.name, quiet)
    scene.save_image(image, path)
    say(quiet, f"  {path}: {title}", f"    {told(image, seconds)}")
    return image


def _draw(images: list[Image], output: Path) -> None:
    """Draw the panels side by side with axes; matplotlib without windows."""
    from matplotlib.figure import Figure

    from ..files import replacing

    figure = Figure(figsize=(4 * len(images), 4.4), layout="constrained")
    for axes, title, image in zip(figure.subplots(1, len(images)), PANELS, images, strict=True):
        _in_parsec(image).plot(axes, scale_bar=True)
        axes.set_title(title, fontsize=9)
        axes.label_outer()
    with replacing(output) as temporary:
        figure.savefig(temporary, dpi=120)


def _in_parsec(image: Image) -> Image:
    from astropy import units as u

    from ..image import Image

    unit = u.Unit(image.unit)
    return Image(image.intensity, x=image.x * unit, y=image.y * unit, unit=_LENGTH_UNIT)


def _outlook(panel: Path, seconds: float) -> tuple[str, ...]:
    return (
        f"{seconds:.1f} s in all; the first picture includes compiling, which is kept.",
        "Each panel carries its scene. Look at it from elsewhere:",
        f"  voluminous render {shlex.quote(str(panel))} -o oblique.png "
        "--set camera.incl=60 --set camera.phi=30",
    )
