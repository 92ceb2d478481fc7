"""The figure of ARCHITECTURE.md: from a file to a picture, with the ray loop in the middle."""

from __future__ import annotations

from pathlib import Path

from drawing import saved
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

# Centre, width and height of each box, its text, and its colour.
_GIVEN, _MADE, _LOOP, _FRAME = "#dbe7f3", "#f6e3c5", "#ffffff", "#eef3e6"
_BOXES = {
    "file": (0.9, 4.2, 1.4, 0.7, "file\nio", _GIVEN),
    "volume": (3.0, 4.2, 1.7, 0.7, "Volume\ngrid, fields", _GIVEN),
    "medium": (3.0, 2.9, 1.7, 0.7, "Medium\nfields → j, α", _GIVEN),
    "camera": (3.0, 1.6, 1.7, 0.7, "Camera\npixels → rays", _GIVEN),
    "prepare": (5.3, 2.9, 1.6, 1.5, "prepare\nunits, ranges,\nprecision", _MADE),
    "walk": (8.0, 4.0, 1.7, 0.75, "walk\nthe next segment", _LOOP),
    "scheme": (8.0, 2.9, 1.7, 0.75, "scheme\nsegment → (b, θ)", _LOOP),
    "path": (8.0, 1.8, 1.7, 0.75, "path\npath over (b, θ)", _LOOP),
    "source": (10.4, 2.9, 1.8, 0.95, "source\nthe medium\non the segment", _LOOP),
    "image": (13.0, 2.9, 1.6, 0.95, "Image\nintensity, error,\ndepth", _MADE),
    "results": (
        15.3,
        2.9,
        1.7,
        1.5,
        "results\nfiles, maps, cubes,\nmeasurements,\nexplorer, films",
        _GIVEN,
    ),
}
# Arrows from one side of a box to one of another: r(ight), l(eft), t(op), b(ottom).
_ARROWS = (
    ("file", "r", "volume", "l"),
    ("volume", "r", "prepare", "l"),
    ("medium", "r", "prepare", "l"),
    ("camera", "r", "prepare", "l"),
    ("walk", "b", "scheme", "t"),
    ("scheme", "b", "path", "t"),
    ("source", "l", "scheme", "r"),
    ("image", "r", "results", "l"),
)
_SIDES = {"r": (0.5, 0.0), "l": (-0.5, 0.0), "t": (0.0, 0.5), "b": (0.0, -0.5)}


def _side(name: str, side: str) -> tuple[float, float]:
    x, y, width, height, *_ = _BOXES[name]
    right, up = _SIDES[side]
    return x + right * width, y + up * height


def _box(axes: Axes, x: float, y: float, width: float, height: float, color: str) -> None:
    corner = x - 0.5 * width, y - 0.5 * height
    style = "round,pad=0,rounding_size=0.12"
    axes.add_patch(FancyBboxPatch(corner, width, height, style, fc=color, ec="#555555", lw=0.8))


def _arrow(axes: Axes, start: tuple[float, float], end: tuple[float, float], bend: float) -> None:
    style = {"arrowstyle": "-|>", "color": "#444444", "connectionstyle": f"arc3,rad={bend}"}
    axes.annotate("", end, start, arrowprops=style)


def architecture(target: Path, pixels: int = 0) -> None:
    """Boxes and arrows."""
    figure = Figure(figsize=(12, 3.55))
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(0, 16.4), ylim=(0.55, 5.4))
    axes.axis("off")
    _box(axes, 9.1, 2.92, 5.0, 3.9, _FRAME)
    axes.text(9.1, 5.05, "one kernel, for all pixels at once", ha="center", style="italic")
    for x, y, width, height, text, color in _BOXES.values():
        _box(axes, x, y, width, height, color)
        name, _, rest = text.partition("\n")
        lines = rest.count("\n") + 1
        axes.text(x, y + 0.13 * lines, name, ha="center", va="center", weight="bold", fontsize=10)
        axes.text(x, y - 0.14, rest, ha="center", va="center", fontsize=8, linespacing=1.2)
    for first, start, last, end in _ARROWS:
        _arrow(axes, _side(first, start), _side(last, end), 0.0)
    _arrow(axes, _side("prepare", "r"), (6.6, 2.9), 0.0)
    _arrow(axes, (11.6, 2.9), _side("image", "l"), 0.0)
    # Until the ray leaves the grid, or nothing more is visible.
    _arrow(axes, _side("path", "l"), _side("walk", "l"), -0.35)
    saved(figure, target, dpi=120, colors=128)


ARCHITECTURE_FIGURES = {"architecture": architecture}
