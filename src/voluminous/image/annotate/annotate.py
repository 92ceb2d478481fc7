"""`Image.annotate`: interprets the options and draws the annotations in order."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from numbers import Real
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...colormaps import opaque_color
from ...errors import InputError
from .. import tone
from ..plot import add_bars, plot
from ..tone import OPTIONS as DISPLAY
from ..tone import check_options
from .marks import (
    compass,
    draw_arrows,
    draw_scale_bar,
    draw_ticks,
    draw_time,
    draw_title,
    readable_axes,
    scale_bar,
    time_text,
    triad,
)
from .scales import FieldValues, counts, draw_color_bar, scales_of
from .sheet import Annotated, AxesSheet, Sheet, letter_height

if TYPE_CHECKING:
    from ...media import Medium
    from ...units import UnitLike
    from ...volume import Volume
    from ..image import Image

Draw = Callable[[Sheet], None]


@dataclass
class Wanted:
    """The parameters of `Image.annotate`."""

    scale_bar: Any = True
    triad: bool = True
    compass: bool = True
    ticks: bool = False
    color_bar: bool = True
    title: str | None = None
    time: Any = True
    volume: Volume | None = None
    medium: Medium | None = None
    paper: Any = None
    font_size: float | None = None
    transparent: bool = False
    unit: UnitLike = None
    ax: Any = None


OPTIONS = frozenset(inspect.signature(Wanted).parameters)


def annotate(image: Image, **options: Any) -> Any:
    """Return the annotated picture, or the axes it was drawn into; see `Image.annotate`."""
    check_options("annotation", options, OPTIONS | DISPLAY)
    wanted = Wanted(**{k: v for k, v in options.items() if k in OPTIONS})
    _check_kinds(wanted)
    image = image if wanted.unit is None else image.to(wanted.unit)
    shown = {k: v for k, v in options.items() if k in DISPLAY}
    pixels = _pixels(image, wanted.transparent, shown)
    if wanted.ax is not None:
        return _in_axes(image, wanted, shown, pixels)
    letters = _letters(wanted.font_size, pixels)
    paper = _paper(wanted, shown)
    parts = _parts(image, wanted, shown)

    def drawn(margins: tuple[int, int, int, int]) -> Sheet:
        sheet = Sheet(pixels, margins, letters, paper)
        for draw in parts:
            draw(sheet)
        return sheet

    # The first pass measures the extent of the annotations, the second one has the margins.
    return Annotated(image, drawn(drawn((0, 0, 0, 0)).overhang()))


def _in_axes(image: Image, wanted: Wanted, shown: dict[str, Any], pixels: NDArray[np.uint8]) -> Any:
    if wanted.paper is not None or wanted.transparent:
        raise InputError("paper and transparent are for pictures of their own; leave out ax=")
    axes = plot(image, wanted.ax, scale_bar=False, colorbar=False, **shown)
    if not wanted.ticks:
        axes.set(xticks=[], yticks=[], xlabel="", ylabel="")
    if wanted.title:
        axes.set_title(str(wanted.title))
    if wanted.color_bar:
        fields = None if wanted.volume is None else FieldValues(wanted.volume)
        told = None if wanted.medium is None else wanted.medium.describe()
        add_bars(axes, image, shown, axes.images[-1], own=False, told=told, fields=fields)
    sheet = AxesSheet(axes, pixels, wanted.font_size)
    for draw in _inside(image, wanted, (1.0, image.unit) if wanted.ticks or wanted.unit else None):
        draw(sheet)
    return axes


def _check_kinds(wanted: Wanted) -> None:
    for name, has in (("volume", "evaluate_cells"), ("medium", "describe")):
        given = getattr(wanted, name)
        if given is not None and not hasattr(given, has):
            raise InputError(f"{name} must be a {name}, got {type(given).__name__}")


def _pixels(image: Image, transparent: bool, shown: dict[str, Any]) -> NDArray[np.uint8]:
    from ..tone import display_values

    values: NDArray[np.uint8] = display_values(image, transparent, shown, 8)
    if values.shape[-1] == 4:
        return values
    return np.concatenate([values, np.full_like(values[..., :1], 255)], axis=-1)


def _letters(wanted: float | None, pixels: NDArray[np.uint8]) -> float:
    if wanted is None:
        return letter_height(pixels)
    if not isinstance(wanted, Real) or not 0 < wanted < np.inf:
        raise InputError(f"font_size must be a positive number of pixels, got {wanted!r}")
    return float(wanted)


def _paper(wanted: Wanted, shown: dict[str, Any]) -> tuple[float, ...] | None:
    """Return the colour of the margins; by default the background's, else black."""
    color = wanted.paper if wanted.paper is not None else shown.get("background")
    if color is None:
        color = "none" if wanted.transparent else "black"
    if isinstance(color, str) and color.lower() == "none":
        return None
    return opaque_color(color, "paper", "'none' or ")


def _parts(image: Image, wanted: Wanted, shown: dict[str, Any]) -> list[Draw]:
    """Return the drawing functions, ordered from the picture outwards; the title comes last."""
    # The axes and the scale bar share one unit.
    unit = (1.0, image.unit) if wanted.unit is not None else readable_axes(image)
    parts = _inside(image, wanted, unit if wanted.ticks or wanted.unit is not None else None)
    if wanted.ticks:
        parts.append(lambda sheet: draw_ticks(sheet, image, unit))
    if wanted.color_bar:
        parts.append(_bars(image, wanted, shown))
    if wanted.title:
        title = str(wanted.title)
        parts.append(lambda s: draw_title(s, title, s.overhang()[3]))
    return parts


def _inside(image: Image, wanted: Wanted, unit: tuple[float, str] | None) -> list[Draw]:
    parts: list[Draw] = []
    bar = scale_bar(image, wanted.scale_bar, unit)
    if bar is not None:
        parts.append(lambda sheet: draw_scale_bar(sheet, image, *bar))
    for gid, arrows, top in (
        ("triad", triad(image) if wanted.triad else [], False),
        ("compass", compass(image) if wanted.compass else [], True),
    ):
        if arrows:
            parts.append(partial(draw_arrows, arrows=arrows, top=top, gid=gid))
    stamp = time_text(wanted.time, wanted.volume)
    if stamp:
        parts.append(lambda sheet: draw_time(sheet, stamp))
    return parts


def _bars(image: Image, wanted: Wanted, shown: dict[str, Any]) -> Draw:
    fields = None if wanted.volume is None else FieldValues(wanted.volume)
    told = None if wanted.medium is None else wanted.medium.describe()
    scales = scales_of(image, shown, told, fields)
    channel = tone.chosen(shown.get("channels"), image.channels)[0]
    bars = [(scale, counts(scale, image, fields, channel)) for scale in scales]

    def draw(sheet: Sheet) -> None:
        start = float(sheet.width)
        for scale, found in bars:
            start = draw_color_bar(sheet, scale, found, start)

    return draw
