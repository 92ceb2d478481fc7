"""`Image.annotate`: interprets the options and draws the annotations in order."""

from __future__ import annotations

import inspect
from numbers import Real
from typing import TYPE_CHECKING, Any

import numpy as np

from ...colormaps import opaque_color
from ...errors import InputError
from ..plot import add_bars, plot
from ..scales import FieldValues, Scale, counts, scales_of
from ..tone import OPTIONS as DISPLAY
from ..tone import check_options, chosen, display_values
from .marks import (
    compass_arrows,
    draw_arrows,
    draw_letters,
    draw_measures,
    draw_scale_bar,
    draw_ticks,
    draw_time,
    draw_title,
    readable_axes,
    scale_bar_of,
    side_letters,
    time_text,
    triad_arrows,
)
from .sheet import LINE, NUMBERS, Annotated, AxesSheet, Sheet, letter_height

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ...media import Medium
    from ...units import UnitLike
    from ...volume import Volume
    from ..image import Image


def annotate(
    image: Image,
    *,
    scale_bar: Any = True,
    triad: bool = True,
    compass: bool = True,
    letters: bool = True,
    measures: Any = (),
    ticks: bool = False,
    color_bar: bool = True,
    title: str | None = None,
    time: Any = True,
    volume: Volume | None = None,
    medium: Medium | None = None,
    paper: Any = None,
    font_size: float | None = None,
    transparent: bool = False,
    unit: UnitLike = None,
    ax: Axes | None = None,
    **display: Any,
) -> Annotated | Axes:
    """Return the annotated picture, or the axes it was drawn into; see `Image.annotate`."""
    check_options("annotation", display, OPTIONS | DISPLAY)
    for name, given, has in (
        ("volume", volume, "evaluate_cells"),
        ("medium", medium, "known_features"),
    ):
        if given is not None and not hasattr(given, has):
            raise InputError(f"{name} must be a {name}, got {type(given).__name__}")
    if font_size is not None and not (isinstance(font_size, Real) and 0 < font_size < np.inf):
        raise InputError(f"font_size must be a positive number of pixels, got {font_size!r}")
    extent = image.extent
    image = image if unit is None else image.to(unit)
    pixels = display_values(image, transparent, display, 8)
    if pixels.shape[-1] == 3:
        pixels = np.concatenate([pixels, np.full_like(pixels[..., :1], 255)], axis=-1)
    fields = None if volume is None else FieldValues(volume)
    colors = None
    if medium is not None:
        colors = [bar for feature in medium.known_features() for bar in feature.color_bars()]
    # The axes and the scale bar share one unit.
    shown_in = (1.0, image.unit)
    if ax is None and unit is None:
        shown_in = readable_axes(image)
    bar = scale_bar_of(image, scale_bar, shown_in if ticks or unit is not None else None)
    pointers = (
        ("triad", triad_arrows(image) if triad else [], False),
        ("compass", compass_arrows(image) if compass else [], True),
    )
    stamp = time_text(time, volume)
    sides = side_letters(image) if letters else []

    def draw_inside(sheet: Sheet) -> None:
        if bar is not None:
            draw_scale_bar(sheet, image, *bar)
        for gid, arrows, top in pointers:
            if arrows:
                draw_arrows(sheet, arrows, top, gid)
        if stamp:
            draw_time(sheet, stamp)
        if sides:
            draw_letters(sheet, sides)
        draw_measures(sheet, measures, extent)

    if ax is not None:
        if paper is not None or transparent:
            raise InputError("paper and transparent are for pictures of their own; leave out ax=")
        axes = plot(image, ax, scale_bar=False, colorbar=False, **display)
        if not ticks:
            axes.set(xticks=[], yticks=[], xlabel="", ylabel="")
        if title:
            axes.set_title(str(title))
        if color_bar:
            known = {"colors": colors, "fields": fields}
            add_bars(axes, image, display, axes.images[-1], own=False, **known)
        draw_inside(AxesSheet(axes, pixels, font_size))
        return axes
    scales = scales_of(image, display, colors, fields) if color_bar else []
    channel = chosen(display.get("channels"), image.channels)[0]
    bars = [(scale, counts(scale, image, fields, channel)) for scale in scales]
    size = letter_height(pixels) if font_size is None else float(font_size)
    color = paper if paper is not None else display.get("background")
    if color is None:
        color = "none" if transparent else "black"
    is_none = isinstance(color, str) and color.lower() == "none"
    margin_color = None if is_none else opaque_color(color, "paper", "'none' or ")

    def drawn(margins: tuple[int, ...]) -> Sheet:
        """Draw from the picture outwards; the title comes last."""
        sheet = Sheet(pixels, margins, size, margin_color)
        draw_inside(sheet)
        if ticks:
            draw_ticks(sheet, image, shown_in)
        start = float(sheet.width)
        for scale, histogram in bars:
            start = draw_color_bar(sheet, scale, histogram, start)
        if title:
            draw_title(sheet, str(title))
        return sheet

    # The first pass measures the extent of the annotations, the second one has the margins.
    return Annotated(image, drawn(drawn((0, 0, 0, 0)).overhang()))


OPTIONS = frozenset(
    name
    for name, parameter in inspect.signature(annotate).parameters.items()
    if parameter.kind is parameter.KEYWORD_ONLY
)


# Widths in letter heights.
_GAP, _BAR, _COUNTS = 1.0, 1.1, 2.8


def draw_color_bar(sheet: Sheet, scale: Scale, histogram: np.ndarray | None, start: float) -> float:
    """Draw a bar as high as the picture, with a histogram, from x = `start`; return its end."""
    em, ink, height = sheet.em, sheet.ink, float(sheet.height)
    x = start + _GAP * em
    if histogram is not None:
        beside = sheet.axes(x, 0.0, _COUNTS * em, height, gid="histogram")
        edges = np.linspace(0.0, 1.0, len(histogram) + 1)
        look: dict[str, Any] = {"color": ink, "alpha": 0.45}
        beside.stairs(histogram, edges, orientation="horizontal", fill=True, **look)
        beside.set(xlim=(1.05, 0.0), ylim=(0.0, 1.0))
        beside.set_axis_off()
        x += _COUNTS * em
    axes = sheet.axes(x, 0.0, _BAR * em, height, gid="color-bar")
    bar: Any = sheet.figure.colorbar(scale.mappable, cax=axes)
    bar.outline.set(linewidth=LINE * em, edgecolor=ink)
    sheet.style_ticks(axes)
    axes.yaxis.get_offset_text().set(fontsize=NUMBERS * em, color=ink, ha="left")
    label = axes.set_ylabel(scale.label, fontsize=em, color=ink, labelpad=0.5 * em)
    long = label.get_window_extent(sheet.canvas.get_renderer()).height
    if long > height:
        label.set_fontsize(em * height / long)
    return sheet.end(axes)
