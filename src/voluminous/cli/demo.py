"""Render three pictures of a prestellar core (--all: six), and one of them side by side."""

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
_IN_A_ROW = 3


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
"""Title and media of each panel: the first figure of the note."""

MORE_PANELS: dict[str, list[dict[str, Any]]] = {
    "Gaussian shells, opacity 3: the outer shell hides": _shells("gaussian", "sigma", 3.0),
    "isosurfaces without thickness": [
        {
            "type": "isosurface",
            "expr": "log10(density)",
            "level": shell["center"],
            "color": shell["color"],
            "opacity": 0.4,
            "shading": 0.8,
        }
        for shell in (_OUTER, _INNER)
    ],
    "seven isosurfaces, cut open": [
        {
            "type": "isosurface",
            "expr": "log10(density)",
            "levels": [3.4, 3.6, 3.8, 4.0, 4.2, 4.4, 4.6],
            "color": {"expr": "log10(density)", "cmap": "plasma", "vmin": 3.2, "vmax": 4.6},
            "opacity": 1.0,
            "shading": 0.8,
            "where": "z < 0",
        }
    ],
}
"""Other ways to see the same core, for ``--all``."""


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
    parser.add_argument(
        "--all", action="store_true", help="six panels: the same core in other ways, too"
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
    scene = Scene(_settings(args)).replaced(_options(args))
    say(
        args.quiet, f"A prestellar core of {args.cells}^3 cells, density ~ 1/r^2, seen face-on:", ""
    )
    panels = {**PANELS, **MORE_PANELS} if args.all else PANELS
    images, paths = [], []
    for number, (title, media) in enumerate(panels.items(), start=1):
        paths.append(output.with_name(f"{output.stem}-{number}.png"))
        scene = scene.replaced({"medium": media})
        images.append(_panel(scene, paths[-1], title, args.quiet))
    _draw(dict(zip(panels, images, strict=True)), output)
    say(args.quiet, f"  {output}: all of them side by side", "")
    say(args.quiet, *_outlook(paths[0], time.perf_counter() - start))
    return 0


def _options(args: argparse.Namespace) -> dict[str, Any]:
    """Return the changes that options ask for.

    Raises
    ------
    InputError
        If a panel cannot be drawn so: before any is.
    """
    from ..schemes import SCHEMES

    options = given_options(args)
    if args.all and args.scheme is not None and SCHEMES[args.scheme].place != "field":
        raise InputError(
            f"--all shows surfaces without thickness, which {args.scheme} cannot draw; leave out "
            "--scheme or --all"
        )
    return options


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


def _draw(images: dict[str, Image], output: Path) -> None:
    """Draw the panels with axes, three in a row; matplotlib without windows."""
    from matplotlib.figure import Figure

    from ..files import replacing

    rows = len(images) // _IN_A_ROW
    figure = Figure(figsize=(4 * _IN_A_ROW, 4.4 * rows), layout="constrained")
    places = figure.subplots(rows, _IN_A_ROW, squeeze=False).ravel()
    for axes, (title, image) in zip(places, images.items(), strict=True):
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
