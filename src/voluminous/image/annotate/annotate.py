"""From a picture to an annotated one: what is wanted, and in which order it is drawn."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from numbers import Real
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from .. import mixing
from ..options import check_options
from ..plot import shows_one_channel
from ..tone import OPTIONS as DISPLAY
from .arrows import compass, draw_arrows, triad
from .color_bar import draw_color_bar
from .histogram import FieldValues, counts
from .medium_scales import of_medium
from .picture import Annotated
from .scale_bar import draw_scale_bar, scale_bar
from .scales import Scale, field_units, of_intensity, with_units
from .sheet import Sheet, letter_height
from .texts import draw_time, draw_title, time_text
from .ticks import draw_ticks

if TYPE_CHECKING:
    from ..image import Image

Draw = Callable[[Sheet], None]


@dataclass
class Wanted:
    """What is drawn; the parameters of `Image.annotate`."""

    scale_bar: Any = True
    triad: bool = True
    compass: bool = True
    ticks: bool = False
    color_bar: bool = True
    title: str | None = None
    time: Any = True
    volume: Any = None
    medium: Any = None
    paper: Any = None
    font_size: float | None = None
    transparent: bool = False


OPTIONS = frozenset(inspect.signature(Wanted).parameters)


def annotate(image: Image, **options: Any) -> Annotated:
    """Return the picture with annotations; see `Image.annotate`."""
    check_options("annotation", options, OPTIONS | DISPLAY)
    wanted = Wanted(**{k: v for k, v in options.items() if k in OPTIONS})
    _check_kinds(wanted)
    shown = {k: v for k, v in options.items() if k in DISPLAY}
    pixels = _pixels(image, wanted.transparent, shown)
    letters = _letters(wanted.font_size, pixels)
    paper = _paper(wanted, shown)
    parts = _parts(image, wanted, shown)

    def drawn(margins: tuple[int, int, int, int]) -> Sheet:
        sheet = Sheet(pixels, margins, letters, paper)
        for draw in parts:
            draw(sheet)
        return sheet

    # How far letters reach is known when they are drawn.
    return Annotated(image, drawn(drawn((0, 0, 0, 0)).overhang()))


def _check_kinds(wanted: Wanted) -> None:
    """Refuse what is neither a volume nor a medium."""
    for name, has in (("volume", "evaluate_cells"), ("medium", "describe")):
        given = getattr(wanted, name)
        if given is not None and not hasattr(given, has):
            raise InputError(f"{name} must be a {name}, got {type(given).__name__}")


def _pixels(image: Image, transparent: bool, shown: dict[str, Any]) -> NDArray[np.uint8]:
    """Return the pixels that `Image.save` writes, row 0 at the bottom."""
    from ..formats.png import display_values

    values = np.rint(display_values(image, transparent, shown) * np.float32(255)).astype(np.uint8)
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
    """Return the colour of the margins: the background's, and black for space."""
    from matplotlib.colors import to_rgb

    color = wanted.paper if wanted.paper is not None else shown.get("background")
    if color is None:
        color = "none" if wanted.transparent else "black"
    if isinstance(color, str) and color.lower() == "none":
        return None
    try:
        return to_rgb(color)
    except ValueError:
        raise InputError(
            f"paper must be 'none' or a color such as 'white' or '#203040', got {color!r}"
        ) from None


def _parts(image: Image, wanted: Wanted, shown: dict[str, Any]) -> list[Draw]:
    """Return what draws the annotations, from the picture outwards: the title has the last word."""
    parts: list[Draw] = []
    bar = scale_bar(image, wanted.scale_bar)
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
    if wanted.ticks:
        parts.append(lambda sheet: draw_ticks(sheet, image))
    if wanted.color_bar:
        parts.append(_bars(image, wanted, shown))
    if wanted.title:
        title = str(wanted.title)
        parts.append(lambda s: draw_title(s, title, s.overhang()[3]))
    return parts


def _bars(image: Image, wanted: Wanted, shown: dict[str, Any]) -> Draw:
    """Return what draws the colour bars beside each other."""
    fields = None if wanted.volume is None else FieldValues(wanted.volume)
    scales = _scales(image, wanted, shown, fields)
    channel = mixing.chosen(shown.get("channels"), image.channels)[0]
    bars = [(scale, counts(scale, image, fields, channel)) for scale in scales]

    def draw(sheet: Sheet) -> None:
        start = float(sheet.width)
        for scale, found in bars:
            start = draw_color_bar(sheet, scale, found, start)

    return draw


def _scales(
    image: Image, wanted: Wanted, shown: dict[str, Any], fields: FieldValues | None
) -> list[Scale]:
    """Return the scale of the one channel that is shown, or else those of the medium."""
    if shows_one_channel(image, shown):
        return [of_intensity(image, shown)]
    told = (image.provenance or {}).get("medium")
    if wanted.medium is not None:
        told = wanted.medium.describe()
    if not isinstance(told, dict):
        return []
    scales = of_medium(told, shown, None if fields is None else fields.span)
    units = field_units(image) if wanted.volume is None else wanted.volume.units
    for scale in scales:
        scale.label = with_units(scale, units)
    return scales
