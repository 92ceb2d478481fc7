"""Draw the first figure of Peters, The physics of volume rendering (2014); more with --all."""

from __future__ import annotations

import argparse
import shlex
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from ..errors import InputError
from .common import (
    add_render_options,
    check_output,
    given_options,
    render_scene,
    say,
    summary,
)

if TYPE_CHECKING:
    from ..image import Image

# The two shells of section 5: centre, width and colour.
_SHELLS = ((3.5, 0.05, [0.4, 0.4, 0.8]), (4.0, 0.10, [0.89, 0.47, 0.06]))
_EXPR = "log10(density)"
_IN_A_ROW = 3


class DemoPanel(NamedTuple):
    """A picture of the core: its title, scheme and media."""

    scheme: str
    title: str
    media: list[dict[str, Any]]


def _shells(kind: str, width_name: str, inside: float) -> list[dict[str, Any]]:
    """Return both shells; `inside` is the opacity of the inner one."""
    shared = {"type": kind, "expr": _EXPR, "path_length": "2.5e16 cm"}
    return [
        {**shared, "center": center, width_name: width, "color": color, "opacity": opacity}
        for (center, width, color), opacity in zip(_SHELLS, (0.001, inside), strict=True)
    ]


def _surface(**options: Any) -> dict[str, Any]:
    return {"type": "isosurface", "expr": _EXPR, "shading": 0.8, **options}


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
        [_surface(level=level, color=color, opacity=0.4) for level, _, color in _SHELLS],
    ),
    DemoPanel(
        "post-classified",
        "seven isosurfaces, cut open",
        [
            _surface(
                level=[3.4, 3.6, 3.8, 4.0, 4.2, 4.4, 4.6],
                color={"expr": _EXPR, "cmap": "plasma", "vmin": 3.2, "vmax": 4.6},
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
    from ..schemes import get_scheme

    start = time.perf_counter()
    output = _output(args.output)
    options = given_options(args)
    scheme = options.get("scheme")
    if args.all and scheme is not None and get_scheme(scheme).coefficients_at != "field":
        raise InputError(
            f"--all shows surfaces without thickness, which {scheme} cannot draw; leave out "
            "--scheme or --all"
        )
    quiet = args.quiet
    say(quiet, f"A prestellar core of {args.cells}^3 cells, density ~ 1/r^2, seen face-on:", "")
    _draw(output, args.all, args.resolution, args.cells, options, quiet=quiet, tell=not quiet)
    say(quiet, f"  {output}: all of them side by side", "")
    first = output.with_name(f"{output.stem}-1.png")
    say(
        quiet,
        f"{time.perf_counter() - start:.1f} s in all; the first picture includes compiling, which "
        "is kept.",
        "Each panel carries its scene. Look at it from elsewhere:",
        f"  voluminous render {shlex.quote(str(first))} -o oblique.png "
        "--set camera.incl=60 --set camera.phi=30",
    )
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
    return _draw(None if path is None else _output(Path(path)), all, resolution, cells, {})


def _output(path: Path) -> Path:
    output = check_output(path)
    if output.suffix.lower() != ".png":
        raise InputError(f"the figure is a PNG; give a name like core.png, got {output}")
    return output


def _draw(
    output: Path | None,
    all: bool,
    resolution: int,
    cells: int,
    options: dict[str, Any],
    *,
    quiet: bool = False,
    tell: bool = False,
) -> list[Image]:
    from ..scene import Scene

    camera = {"incl": 0.0, "phi": 0.0, "width": "0.25 pc", "resolution": resolution}
    volume = {"model": "prestellar_core", "resolution": cells}
    scene = Scene({"volume": volume, "medium": PANELS[0].media, "camera": camera})
    images: list[Image] = []
    titles = []
    for number, panel in enumerate((*PANELS, *MORE_PANELS) if all else PANELS, start=1):
        chosen = {"scheme": panel.scheme, **options}
        changes = {f"render.{name}": value for name, value in chosen.items()}
        scene = scene.replaced({"medium": panel.media, **changes})
        titles.append(panel.title.format(scheme=chosen["scheme"].replace("-", " ")))
        path = output or Path("core.png")
        path = path.with_name(f"{path.stem}-{number}.png")
        image, seconds = render_scene(scene, path.name, quiet)
        images.append(image)
        if output is not None:
            # All panels of the paper's figure share the exposure of the first.
            like = images[0] if number <= len(PANELS) else image
            image.save(path, exposure=like.exposure)
            say(not tell, f"  {path}: {titles[-1]}", f"    {summary(image, seconds)}")
    if output is not None:
        _save_figure(images, titles, output)
    return images


def _save_figure(images: list[Image], titles: list[str], output: Path) -> None:
    from matplotlib.figure import Figure

    from ..files import replacing
    from ..image.plot import plot_row

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
