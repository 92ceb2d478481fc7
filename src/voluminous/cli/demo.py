"""Draw the first figure of Peters, The physics of volume rendering (2014); more with --all."""

from __future__ import annotations

import argparse
import shlex
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from ..errors import InputError
from .common import add_render_options, check_output, given_options, render_scene, say, told

if TYPE_CHECKING:
    from ..image import Image

# The two shells of section 5.
_OUTER = {"center": 3.5, "width": 0.05, "color": [0.4, 0.4, 0.8]}
_INNER = {"center": 4.0, "width": 0.10, "color": [0.89, 0.47, 0.06]}
_PATH_LENGTH = "2.5e16 cm"
_IN_A_ROW = 3


def _shells(kind: str, width: str, inside: float) -> list[dict[str, Any]]:
    """Return both shells; `width` is the name of the width key, `inside` the inner opacity."""
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
        for shell, opacity in ((_OUTER, 0.001), (_INNER, inside))
    ]


def _surfaces(**changes: Any) -> dict[str, Any]:
    return {"type": "isosurface", "expr": "log10(density)", "shading": 0.8, **changes}


class DemoPanel(NamedTuple):
    """A picture of the core: its title, scheme and media."""

    scheme: str
    title: str
    media: list[dict[str, Any]]


PANELS = (
    DemoPanel("first-order", "{scheme}", _shells("gaussian", "sigma", 0.001)),
    DemoPanel("second-order", "{scheme}", _shells("gaussian", "sigma", 0.001)),
    DemoPanel("second-order", "{scheme}, α = 0.1 inside", _shells("gaussian", "sigma", 0.1)),
)
"""The first figure of the note."""

MORE_PANELS = (
    DemoPanel("post-classified", "rectangle functions", _shells("rectangle", "half_width", 0.001)),
    DemoPanel(
        "post-classified",
        "isosurfaces without thickness",
        [
            _surfaces(level=shell["center"], color=shell["color"], opacity=0.4)
            for shell in (_OUTER, _INNER)
        ],
    ),
    DemoPanel(
        "post-classified",
        "seven isosurfaces, cut open",
        [
            _surfaces(
                level=[3.4, 3.6, 3.8, 4.0, 4.2, 4.4, 4.6],
                color={"expr": "log10(density)", "cmap": "plasma", "vmin": 3.2, "vmax": 4.6},
                opacity=1.0,
                where="z < 0",
            )
        ],
    ),
)
"""Other ways to see the same core."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        default=Path("core.png"),
        metavar="FILE.png",
        help="the figure (default core.png); its panels become core-1.png, …",
    )
    parser.add_argument(
        "--all", action="store_true", help="six panels: the same core in other ways, too"
    )
    parser.add_argument("--resolution", type=int, default=400, help="pixels per side (400)")
    parser.add_argument("--cells", type=int, default=100, help="cells per side (100)")
    add_render_options(parser)


def run(args: argparse.Namespace) -> int:
    """Render the panels, save them, and draw them side by side."""
    start = time.perf_counter()
    output = _output(args.output)
    options = {k.removeprefix("render."): v for k, v in given_options(args).items()}
    _check_scheme(options.get("scheme"), args.all)
    say(
        args.quiet, f"A prestellar core of {args.cells}^3 cells, density ~ 1/r^2, seen face-on:", ""
    )

    def report(path: str, title: str, image: Image, seconds: float) -> None:
        say(args.quiet, f"  {path}: {title}", f"    {told(image, seconds)}")

    size = {"resolution": args.resolution, "cells": args.cells, "quiet": args.quiet}
    _draw(output, args.all, options, report, **size)
    say(args.quiet, f"  {output}: all of them side by side", "")
    first = output.with_name(f"{output.stem}-1.png")
    say(args.quiet, *_outlook(first, time.perf_counter() - start))
    return 0


def demo(
    path: str | Path | None = "core.png",
    all: bool = False,
    *,
    resolution: int = 400,
    cells: int = 100,
) -> list[Image]:
    """Draw the first figure of Peters (2014), *The physics of volume rendering*.

    A prestellar core seen face-on, with one exposure: in first order, in second order, and in
    second order with an opacity of 0.1 inside.

    Parameters
    ----------
    path : str, Path or None
        Where the figure is written (a PNG); its panels beside it: ``core-1.png``, …. None writes
        nothing.
    all : bool
        Six panels: the same core in other ways, too.
    resolution, cells : int
        Pixels and cells per side.

    Returns
    -------
    list of Image
        The panels.

    Raises
    ------
    InputError
        If `path` is no PNG or its directory does not exist.
    """
    output = None if path is None else _output(Path(path))
    return _draw(output, all, {}, None, resolution=resolution, cells=cells, quiet=False)


def _output(path: Path) -> Path:
    output = check_output(path)
    if output.suffix.lower() != ".png":
        raise InputError(f"the figure is a PNG; give a name like core.png, got {output}")
    return output


def _check_scheme(scheme: str | None, all: bool) -> None:
    """Raise before any work if a panel does not support the scheme."""
    from ..schemes import SCHEMES

    if all and scheme is not None and SCHEMES[scheme].coefficients_at != "field":
        raise InputError(
            f"--all shows surfaces without thickness, which {scheme} cannot draw; leave out "
            "--scheme or --all"
        )


def _draw(
    output: Path | None,
    all: bool,
    options: dict[str, Any],
    report: Callable[[str, str, Image, float], None] | None,
    *,
    resolution: int,
    cells: int,
    quiet: bool,
) -> list[Image]:
    from ..scene import Scene

    panels = (*PANELS, *MORE_PANELS) if all else PANELS
    camera = {"incl": 0.0, "phi": 0.0, "width": "0.25 pc", "resolution": resolution}
    volume = {"model": "prestellar_core", "resolution": cells}
    scene = Scene({"volume": volume, "medium": PANELS[0].media, "camera": camera})
    images: list[Image] = []
    titles = []
    for number, panel in enumerate(panels, start=1):
        own = {"scheme": panel.scheme, **options}
        scene = scene.replaced(
            {"medium": panel.media, **{f"render.{k}": v for k, v in own.items()}}
        )
        titles.append(panel.title.format(scheme=own["scheme"].replace("-", " ")))
        name = f"{output.stem if output else 'core'}-{number}.png"
        image, seconds = render_scene(scene, name, quiet)
        images.append(image)
        if output is not None:
            # All panels of the paper's figure share the exposure of the first.
            like = images[0] if number <= len(PANELS) else image
            image.save(output.with_name(name), exposure=like.exposure)
            if report is not None:
                report(str(output.with_name(name)), titles[-1], image, seconds)
    if output is not None:
        _save_figure(images, titles, output)
    return images


def _save_figure(images: list[Image], titles: list[str], output: Path) -> None:
    from matplotlib.figure import Figure

    from ..files import replacing
    from ..image.row import plot_row

    rows = len(images) // _IN_A_ROW
    figure = Figure(figsize=(4 * _IN_A_ROW + 0.8, 4.1 * rows), layout="constrained")
    places = figure.subplots(rows, _IN_A_ROW, squeeze=False)
    look: dict[str, Any] = {"unit": "pc", "scale_bar": True}
    exposure = images[0].exposure
    plot_row(images[:_IN_A_ROW], places[0], titles=titles[:_IN_A_ROW], exposure=exposure, **look)
    for image, title, place in zip(images[3:], titles[3:], places[1:].ravel(), strict=True):
        plot_row([image], [place], titles=[title], **look)
    with replacing(output) as temporary:
        figure.savefig(temporary, dpi=120)


def _outlook(panel: Path, seconds: float) -> tuple[str, ...]:
    return (
        f"{seconds:.1f} s in all; the first picture includes compiling, which is kept.",
        "Each panel carries its scene. Look at it from elsewhere:",
        f"  voluminous render {shlex.quote(str(panel))} -o oblique.png "
        "--set camera.incl=60 --set camera.phi=30",
    )
