"""Annotations in the picture: axis triad, compass, scale bar, time, title and ticks."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import InputError, VoluminousError
from ...rotation import angles_towards, image_axes, position_angle
from ...units import as_quantity, is_quantity, parse_unit, plain
from ..arguments import known_unit
from ..beam import sky_matrix
from ..lengths import bar_length, labelled, number_text, readable, with_unit
from ..sky import is_linear, label_axes, plain_axes
from ..tone import finite
from .sheet import LINE

if TYPE_CHECKING:
    from ...volume import Volume
    from ..image import Image
    from .sheet import Sheet


_LENGTH = 2.6
# Arrows shorter than this count as parallel to the line of sight.
_SHORT = 0.12
_XYZ = {"x": ("#ff6a5a", "#c02010"), "y": ("#5ce05c", "#107810"), "z": ("#86b4ff", "#1040c0")}
_SKY = {"GLON": ("b", "l"), "ELON": ("β", "λ")}


@dataclass
class Arrow:
    """A direction in the picture: its name, and its projection to the right and up (≤ 1)."""

    name: str
    across: float
    up: float
    towards: bool = True
    colors: tuple[str, str] | None = None


def triad(image: Image) -> list[Arrow]:
    """Return the projected x, y and z axes; an empty list if the camera does not define them."""
    axes = _camera_axes(image.camera or {})
    if axes is None:
        return []
    signs = np.sign(image.pixel_size)
    return [
        Arrow(name, signs[0] * axes[0, k], signs[1] * axes[1, k], axes[2, k] > 0.0, _XYZ[name])
        for k, name in enumerate("xyz")
    ]


def _camera_axes(camera: dict[str, Any]) -> np.ndarray | None:
    """Return the directions right, up and towards the observer, shape (3, 3)."""
    try:
        if camera.get("type") == "orthographic":
            return image_axes(camera["incl"], camera["phi"], camera.get("posang", 0.0))
        if camera.get("type") == "perspective":
            position, target = _points(camera["position"], camera["target"])
            incl, phi = angles_towards(position - target)
            turned = camera.get("posang", 0.0)
            if "up" in camera:
                turned = position_angle(incl, phi, np.array(camera["up"]))
            return image_axes(incl, phi, turned)
    except (KeyError, TypeError, ValueError, VoluminousError):
        return None  # from another program, or an unknown unit
    return None


def _points(*told: Any) -> np.ndarray:
    """Return points in one unit: texts with units in centimetres, plain numbers unchanged."""
    coordinates = [c for point in told for c in point]
    if any(isinstance(c, str) for c in coordinates):
        coordinates = [_in_cm(c) for c in coordinates]
    return np.array(coordinates, dtype=np.float64).reshape(len(told), -1)


def _in_cm(told: Any) -> float:
    from astropy import units as u

    if isinstance(told, str):
        return float(u.Quantity(told).cgs.value)
    if told != 0:
        raise ValueError(f"the unit of {told} is not known")
    return 0.0


def compass(image: Image) -> list[Arrow]:
    """Return north and east at the centre of the picture; an empty list without a celestial WCS."""
    to_sky = sky_matrix(image)
    if to_sky is None or image.wcs is None:
        return []
    kind = image.wcs.celestial.wcs.ctype[0].split("-")[0]
    up, left = _SKY.get(kind, ("N", "E"))
    from_sky = np.linalg.inv(to_sky)
    directions = [from_sky @ np.array(d) for d in ((0.0, 1.0), (1.0, 0.0))]
    return [
        Arrow(name, *(d / np.linalg.norm(d)))
        for name, d in zip((up, left), directions, strict=True)
    ]


def draw_arrows(sheet: Sheet, arrows: list[Arrow], top: bool, gid: str) -> None:
    """Draw arrows from one point and their names, in a corner on the right of the picture."""
    reach = _LENGTH * sheet.em
    tips = np.array([(a.across, a.up) for a in arrows]) * reach
    names = _name_places(arrows, reach, sheet.em)
    around = np.concatenate([tips, names - 0.5 * sheet.em, names + 0.5 * sheet.em, [[0.0, 0.0]]])
    low, high = around.min(axis=0), around.max(axis=0)
    x = sheet.width - sheet.pad - high[0]
    y = sheet.height - sheet.pad - high[1] if top else sheet.pad - low[1]
    ink, rim = sheet.inks(x + low[0], y + low[1], *(high - low))
    # Arrows towards the observer are drawn over the others.
    for arrow, place in sorted(zip(arrows, names, strict=True), key=lambda pair: pair[0].towards):
        color = ink if arrow.colors is None else arrow.colors[rim > ink]
        _draw(sheet, arrow, (x, y), reach, color, rim, gid)
        at = x + place[0], y + place[1]
        sheet.rimmed(*at, arrow.name, (color, rim), ha="center", va="center")


def _name_places(arrows: list[Arrow], reach: float, em: float) -> np.ndarray:
    """Return the positions of the names: beyond the tips, moved aside to avoid other arrows."""
    ends = np.array([_beyond(a, reach, em) for a in arrows])
    for k, arrow in enumerate(arrows):
        others = np.delete(ends, k, axis=0)
        length = float(np.hypot(arrow.across, arrow.up))
        if length < _SHORT or _clearance(ends[k], others) > 0.6 * em:
            continue
        aside = np.array([arrow.up, -arrow.across]) * 0.75 * em / length
        tip = np.array([arrow.across, arrow.up]) * reach
        ends[k] = max(tip + aside, tip - aside, key=lambda place: _clearance(place, others))
    return ends


def _beyond(arrow: Arrow, reach: float, em: float) -> np.ndarray:
    """Return a position beyond the tip; beside the point, for an arrow seen end-on."""
    direction = np.array([arrow.across, arrow.up])
    length = float(np.linalg.norm(direction))
    if length < _SHORT:
        return np.array([-0.7, -0.7]) * em
    return direction * (reach + 0.75 * em / length)


def _clearance(place: np.ndarray, ends: np.ndarray) -> float:
    """Return the distance of a point to the nearest of the lines from the origin to `ends`."""
    along = np.clip(ends @ place / np.maximum((ends**2).sum(axis=1), 1e-9), 0.0, 1.0)
    return float(np.linalg.norm(place - along[:, None] * ends, axis=1).min())


def _draw(
    sheet: Sheet,
    arrow: Arrow,
    at: tuple[float, float],
    reach: float,
    color: str,
    rim: str,
    gid: str,
) -> None:
    from matplotlib.patches import Circle, FancyArrowPatch

    thick, effects = 0.12 * sheet.em, sheet.rim(rim)
    x, y = at
    tip = (x + reach * arrow.across, y + reach * arrow.up)
    if np.hypot(arrow.across, arrow.up) < _SHORT:
        # A dot for an arrow towards the observer, an open ring for one away from them.
        look = {"facecolor": color if arrow.towards else "none", "edgecolor": color}
        sheet.patch(
            Circle(at, 0.3 * sheet.em, linewidth=thick, path_effects=effects, gid=gid, **look)
        )
        return
    length = float(np.hypot(arrow.across, arrow.up))
    head = 0.7 * sheet.em * min(1.0, 2.0 * length)
    part = 1.0 - 0.8 * head / (reach * length)  # the line ends inside the head
    xs, ys = [x, x + part * (tip[0] - x)], [y, y + part * (tip[1] - y)]
    sheet.line(xs, ys, color=color, linewidth=thick, path_effects=effects, gid=gid)
    style = f"-|>,head_length={head:.3f},head_width={0.45 * head:.3f}"
    drawn = FancyArrowPatch(
        at,
        tip,
        arrowstyle=style,
        mutation_scale=1.0,
        shrinkA=0,
        shrinkB=0,
        linewidth=0,
        color=color,
    )
    drawn.set_zorder(2.5)  # over the line, under the names
    sheet.patch(drawn)


# Maximum automatic length of the scale bar, in widths of the picture.
_PART = 0.25
# Wider angles (radians) have no uniform scale: it varies by 0.3 % between centre and edge.
_WIDE = 0.2


def scale_bar(
    image: Image, wanted: Any, shown: tuple[float, str] | None = None
) -> tuple[float, str] | None:
    """Return the bar's length in the image's unit, and its text; None if no bar would be correct.

    Parameters
    ----------
    image : Image
    wanted : bool, Quantity, str or float
        True: a round length that fits. Otherwise the length itself, such as ``"100 au"``.
    shown : (float, str), optional
        The unit of a round length; see `bar_length`.
    """
    left, right, _, _ = image.extent
    across = abs(right - left)
    if wanted is False or wanted is None:
        return None
    if wanted is True:
        return None if is_wide(image) else bar_length(_PART * across, image.unit, shown)
    length, text = _given(image, wanted)
    if not 0 < length <= across:
        most = f"{across:g} {image.unit}".strip()
        raise InputError(f"scale_bar must be a length up to {most}, got {wanted!r}")
    return length, text


def is_wide(image: Image) -> bool:
    """Return True for a picture whose field of view is too wide for a uniform scale."""
    left, right, _, _ = image.extent
    unit = known_unit(image.unit)
    if unit is None or not unit.is_equivalent("rad"):
        return False
    return bool(abs(right - left) * unit.to("rad") > _WIDE)


def _given(image: Image, wanted: Any) -> tuple[float, str]:
    from astropy import units as u

    if isinstance(wanted, str):
        try:
            wanted = u.Quantity(wanted)
        except (ValueError, TypeError) as error:
            raise InputError(
                f"scale_bar must be a length such as '100 au', got {wanted!r}"
            ) from error
    wanted = as_quantity(wanted)
    if is_quantity(wanted):
        length = finite(plain(wanted, parse_unit(image.unit), "scale_bar"), "scale_bar")
        # Keep the unit that the user chose.
        _, name = readable(1.0, str(wanted.unit))
        return length, with_unit(float(wanted.value), name)
    length = finite(wanted, "scale_bar")
    factor, name = readable(length, image.unit)
    return length, with_unit(length * factor, name)


def draw_scale_bar(sheet: Sheet, image: Image, length: float, text: str) -> None:
    """Draw the bar at the lower left."""
    from matplotlib.patches import Rectangle

    long = sheet.per_pixel * length / abs(image.pixel_size[0])
    thick = max(1.0, round(0.16 * sheet.em))
    x = y = float(round(sheet.pad))
    ink, rim = sheet.inks(x, y, long, 2 * sheet.em)
    look: dict[str, Any] = {
        "facecolor": ink,
        "path_effects": sheet.rim(rim),
        "linewidth": 0.0,
        "gid": "scale-bar",
    }
    sheet.patch(Rectangle((x, y), long, thick, **look))
    place = {"ha": "center", "va": "bottom"}
    up = y + thick + 0.3 * sheet.em
    draft = sheet.text(0.0, up, text, **place)
    wide = sheet.wide(draft)
    draft.remove()
    # Centre the text on its bar, unless it is longer than the bar.
    sheet.rimmed(x + 0.5 * max(long, wide), up, text, (ink, rim), **place)


_TITLE = 1.25


def time_text(time: Any, volume: Volume | None) -> str:
    """Return the time stamp; the empty string if there is no time.

    Parameters
    ----------
    time : bool, str, float or Quantity
        True: the time in ``volume.meta``.
    volume : Volume or None
    """
    if time is True:
        return _of_meta({} if volume is None else volume.meta)
    if time is None or time is False:
        return ""
    if isinstance(time, str):
        return time
    time = as_quantity(time)
    if is_quantity(time):
        return _stamp(float(time.value), str(time.unit))
    try:
        return _stamp(float(time), "")
    except (TypeError, ValueError) as error:
        raise InputError(f"time must be a text, a number or a quantity, got {time!r}") from error


def _of_meta(meta: dict[str, Any]) -> str:
    time: Any = meta.get("time")
    redshift: Any = meta.get("redshift")
    words = []
    if is_quantity(time):
        words.append(_stamp(float(time.value), str(time.unit)))
    elif _is_number(time):
        words.append(_stamp(float(time), str(meta.get("time_unit", ""))))
    if _is_number(redshift):
        words.append(f"z = {float(redshift):.4g}")
    return ", ".join(words)


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def _stamp(number: float, unit: str) -> str:
    try:
        factor, name = readable(number, unit)
    except ValueError:  # a unit of a code
        factor, name = 1.0, unit
    return f"t = {with_unit(number * factor, name)}" if name else f"t = {number_text(number)}"


def draw_time(sheet: Sheet, words: str) -> None:
    """Write the time at the upper left."""
    x, y = sheet.pad, sheet.height - sheet.pad
    inks = sheet.inks(x, y - sheet.em, 0.5 * sheet.em * len(words), sheet.em)
    sheet.rimmed(x, y, words, inks, ha="left", va="top", gid="time")


def draw_title(sheet: Sheet, words: str, above: float) -> None:
    """Write the title above the picture, shrunk to the width of the picture if necessary."""
    text = sheet.text(
        0.5 * sheet.width,
        sheet.height + above + 0.5 * sheet.em,
        words,
        fontsize=_TITLE * sheet.em,
        ha="center",
        va="bottom",
        gid="title",
    )
    renderer = sheet.canvas.get_renderer()
    try:
        wide = text.get_window_extent(renderer).width
    except ValueError:  # dollar signs that are not a valid formula
        text.set_parse_math(False)
        wide = text.get_window_extent(renderer).width
    if wide > sheet.width:
        text.set_fontsize(_TITLE * sheet.em * sheet.width / wide)


# Space for one tick with its number, in letter heights.
_ROOM = 6.0


def draw_ticks(sheet: Sheet, image: Image, shown: tuple[float, str]) -> None:
    """Draw a frame with outward ticks and axis labels around the picture."""
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
    edges, labels = tuple(factor * v for v in image.extent), [labelled(axis, name) for axis in "xy"]
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
    """Return the factor to, and the name of, a unit that suits the size of the picture."""
    left, right, bottom, top = image.extent
    size = 0.5 * max(abs(right - left), abs(top - bottom))
    return (1.0, image.unit) if _is_screen(image) else readable(size, image.unit)


def readable_unit(image: Image) -> str | None:
    """Return the unit of the scale bar that suits a picture, if it has one that can be typed."""
    left, right, _, _ = image.extent
    name = readable(_PART * abs(right - left), image.unit)[1]
    return None if is_wide(image) or known_unit(name) is None else name


def _is_screen(image: Image) -> bool:
    """Return True for a wide flat screen: its coordinates are tangents, not angles."""
    return is_wide(image) and (image.camera or {}).get("projection") == "flat"


def _count(room: int, em: float) -> int:
    return max(2, min(8, int(room / (_ROOM * em))))
