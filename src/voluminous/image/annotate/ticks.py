"""Axes with ticks around the picture: of its plane, or of the sky."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ..sky_axes import is_linear, label_axes, plain_axes
from .lengths import readable
from .scale_bar import is_wide
from .sheet import LINE

if TYPE_CHECKING:
    from ..image import Image
    from .sheet import Sheet

# Room for one tick with its number, in heights of letters.
_ROOM = 6.0


def draw_ticks(sheet: Sheet, image: Image, shown: tuple[float, str]) -> None:
    """Draw a frame with ticks around the picture, outwards, and what they count."""
    beside = max(1.0, LINE * sheet.em)  # so that the frame covers none of its pixels
    place = (-beside, -beside, sheet.width + 2 * beside, sheet.height + 2 * beside)
    if image.wcs is None or is_linear(image.wcs):
        _plane(sheet, image, sheet.axes(*place), beside, shown)
    else:
        _sky(sheet, image, place, beside)


def _sky(sheet: Sheet, image: Image, place: tuple[float, ...], beside: float) -> None:
    from astropy.visualization.wcsaxes import WCSAxes

    axes: Any = sheet.axes(*place, axes_class=WCSAxes, wcs=image.wcs)
    limits = [(-0.5 - beside, n - 0.5 + beside) for n in (sheet.width, sheet.height)]
    axes.set(xlim=limits[0], ylim=limits[1])
    label_axes(axes, image.wcs)
    for coordinate, room in zip(axes.coords, (sheet.width, sheet.height), strict=True):
        coordinate.set_ticks(number=_count(room, sheet.em), size=0.35 * sheet.em, color=sheet.ink)
        coordinate.set_ticklabel(size=0.85 * sheet.em, color=sheet.ink)
        words = coordinate.get_axislabel()
        coordinate.set_axislabel(words, fontsize=sheet.em, color=sheet.ink)
        coordinate.tick_params(direction="out")
    axes.coords.frame.set_color(sheet.ink)
    axes.coords.frame.set_linewidth(LINE * sheet.em)


def _plane(sheet: Sheet, image: Image, axes: Any, beside: float, shown: tuple[float, str]) -> None:
    from matplotlib.ticker import MaxNLocator

    factor, name = shown
    edges, labels = tuple(factor * v for v in image.extent), [_label(axis, name) for axis in "xy"]
    if image.wcs is not None:
        edges, labels = plain_axes(image.wcs)
    sides = (axes.xaxis, axes.yaxis), (sheet.width, sheet.height), (edges[:2], edges[2:]), labels
    for axis, room, (low, high), label in zip(*sides, strict=True):
        step = beside * (high - low) / room
        axis.axes.set(**{f"{axis.axis_name}lim": (low - step, high + step)})
        axis.set_major_locator(MaxNLocator(_count(room, sheet.em), steps=[1, 2, 5, 10]))
        axis.set_label_text(label, fontsize=sheet.em, color=sheet.ink)
        axis.get_offset_text().set(fontsize=0.85 * sheet.em, color=sheet.ink)


def readable_axes(image: Image) -> tuple[float, str]:
    """Return a unit that suits the size of the picture: how many are one of its own, and a name."""
    left, right, bottom, top = image.extent
    size = 0.5 * max(abs(right - left), abs(top - bottom))
    return (1.0, image.unit) if _is_screen(image) else readable(size, image.unit)


def _label(axis: str, name: str) -> str:
    return f"{axis} [{name}]" if name else axis


def _is_screen(image: Image) -> bool:
    """Return True for a wide flat screen: its coordinates are tangents, not angles to be told."""
    return is_wide(image) and (image.camera or {}).get("projection") == "flat"


def _count(room: int, em: float) -> int:
    return max(2, min(8, int(room / (_ROOM * em))))
