"""Annotations in the picture: axis triad, compass, scale bar, time, title and ticks."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import InputError, VoluminousError
from ...geometry import angles_towards, image_axes, position_angle
from ...units import as_given, as_quantity, is_quantity, parse_unit, plain
from ..arguments import known_unit
from ..conversion import sky_matrix
from ..lengths import bar_length, labelled, number_text, readable, with_unit
from ..sky import is_linear, label_axes, plain_axes, plane_factor
from ..tone import finite
from .sheet import LINE, NUMBERS

if TYPE_CHECKING:
    from ...volume import Volume
    from ..image import Image
    from .sheet import Sheet

# Length of arrows in letter heights.
_LENGTH = 2.6
# Arrows shorter than this count as parallel to the line of sight.
_SHORT = 0.12
_XYZ = {"x": ("#ff6a5a", "#c02010"), "y": ("#5ce05c", "#107810"), "z": ("#86b4ff", "#1040c0")}
_OPPOSITE = dict(zip("LRPASI", "RLAPIS", strict=True))
# An axis of the patient that is within 66° of a direction gives it a letter.
_NEAR = 0.4
_MEASURED = ("#ffd75e", "#0b0e12")
_SKY = {"GLON": ("b", "l"), "ELON": ("β", "λ")}
# Maximum automatic length of the scale bar, in widths of the picture.
_PART = 0.25
# Wider angles (radians) have no uniform scale: it varies by 0.3 % between centre and edge.
_WIDE = 0.2
_TITLE = 1.25
# Space for one tick with its number, in letter heights.
_ROOM = 6.0


@dataclass
class Arrow:
    """A direction in the picture: its name, and its projection to the right and up (≤ 1)."""

    name: str
    across: float
    up: float
    towards: bool = True
    colors: tuple[str, str] | None = None

    @property
    def way(self) -> np.ndarray:
        """The projection as a vector."""
        return np.array([self.across, self.up])

    @property
    def length(self) -> float:
        """Length of the projection."""
        return float(np.hypot(self.across, self.up))


def triad_arrows(image: Image) -> list[Arrow]:
    """Return the projected x, y and z axes; an empty list if the camera does not define them."""
    camera = image.camera or {}
    try:
        if camera.get("type") == "orthographic":
            axes = image_axes(camera["incl"], camera["phi"], camera.get("posang", 0.0))
        elif camera.get("type") == "perspective":
            position, target = (plain(camera[k], "cm", k) for k in ("position", "target"))
            incl, phi = angles_towards(position - target)
            posang = camera.get("posang", 0.0)
            if "up" in camera:
                posang = position_angle(incl, phi, np.array(camera["up"]))
            axes = image_axes(incl, phi, posang)
        else:
            return []
    except (KeyError, TypeError, ValueError, VoluminousError):
        return []  # from another program, or an unknown unit
    right, up = np.sign(image.pixel_size)
    return [
        Arrow(name, right * axes[0, k], up * axes[1, k], axes[2, k] > 0.0, _XYZ[name])
        for k, name in enumerate("xyz")
    ]


def side_letters(image: Image) -> list[str]:
    """Return the patient's sides at the right, left, upper and lower border; none if unknown."""
    told, arrows = image.provenance or {}, triad_arrows(image)
    code, turn = str(told.get("orientation", "")).upper(), told.get("direction", np.eye(3))
    pairs = {frozenset((letter, _OPPOSITE.get(letter))) for letter in code}
    if not (len(code) == len(pairs) == 3 and {*code} <= {*_OPPOSITE} and arrows):
        return []
    right, up = np.array([arrow.way for arrow in arrows]).T @ np.transpose(turn)
    return [_letters(code, side) for side in (right, -right, up, -up)]


def _letters(code: str, direction: np.ndarray) -> str:
    """Return the letters of a direction, that of the nearest axis first."""
    order = np.argsort(-np.abs(direction), kind="stable")
    near = [k for k in order if abs(direction[k]) > _NEAR]
    return "".join(code[k] if direction[k] > 0 else _OPPOSITE[code[k]] for k in near)


def draw_letters(sheet: Sheet, letters: list[str]) -> None:
    """Write letters in the middle of the right, left, upper and lower border."""
    w, h, pad, size = sheet.width, sheet.height, sheet.pad, 1.2 * sheet.em
    places = [(w - pad, h / 2, "right", "center"), (pad, h / 2, "left", "center")]
    places += [(w / 2, h - pad, "center", "top"), (w / 2, pad, "center", "bottom")]
    for words, (x, y, ha, va) in zip(letters, places, strict=True):
        inks = sheet.inks(x - size, y - size, 2 * size, 2 * size)
        sheet.rimmed(x, y, words, inks, ha=ha, va=va, fontsize=size, gid="letters")


def compass_arrows(image: Image) -> list[Arrow]:
    """Return north and east at the centre of the picture; an empty list without a celestial WCS."""
    to_sky = sky_matrix(image)
    if to_sky is None or image.wcs is None:
        return []
    kind = image.wcs.celestial.wcs.ctype[0].split("-")[0]
    east, north = np.linalg.inv(to_sky).T
    pairs = zip(_SKY.get(kind, ("N", "E")), (north, east), strict=True)
    return [Arrow(name, *(direction / np.linalg.norm(direction))) for name, direction in pairs]


def draw_arrows(sheet: Sheet, arrows: list[Arrow], top: bool, gid: str) -> None:
    """Draw arrows from one point and their names, in a corner on the right of the picture."""
    reach, half = _LENGTH * sheet.em, 0.5 * sheet.em
    names = _name_places(arrows, reach, sheet.em)
    tips = np.array([arrow.way for arrow in arrows]) * reach
    around = np.concatenate([tips, names - half, names + half, [[0.0, 0.0]]])
    low, high = around.min(axis=0), around.max(axis=0)
    x = sheet.width - sheet.pad - high[0]
    y = sheet.height - sheet.pad - high[1] if top else sheet.pad - low[1]
    ink, rim = sheet.inks(x + low[0], y + low[1], *(high - low))
    # Arrows towards the observer are drawn over the others.
    for arrow, place in sorted(zip(arrows, names, strict=True), key=lambda pair: pair[0].towards):
        color = ink if arrow.colors is None else arrow.colors[rim > ink]
        _draw_arrow(sheet, arrow, np.array([x, y]), color, rim, gid)
        at = x + place[0], y + place[1]
        sheet.rimmed(*at, arrow.name, (color, rim), ha="center", va="center")


def _name_places(arrows: list[Arrow], reach: float, em: float) -> np.ndarray:
    """Return the positions of the names: beyond the tips, moved aside to avoid other arrows.

    The name of an arrow seen end-on is beside the point.
    """
    ends = np.full((len(arrows), 2), -0.7 * em)
    long = [k for k, arrow in enumerate(arrows) if arrow.length >= _SHORT]
    for k in long:
        ends[k] = arrows[k].way * (reach + 0.75 * em / arrows[k].length)

    def clearance(place: np.ndarray, others: np.ndarray) -> float:
        """Return the distance to the nearest of the lines from the origin to `others`."""
        square = np.maximum((others**2).sum(axis=1), 1e-9)
        along = np.clip(others @ place / square, 0.0, 1.0)
        return float(np.linalg.norm(place - along[:, None] * others, axis=1).min())

    for k in long:
        others, arrow = np.delete(ends, k, axis=0), arrows[k]
        if clearance(ends[k], others) <= 0.6 * em:
            aside = np.array([arrow.up, -arrow.across]) * 0.75 * em / arrow.length
            places = (arrow.way * reach + aside, arrow.way * reach - aside)
            ends[k] = max(places, key=lambda place: clearance(place, others))
    return ends


def _draw_arrow(sheet: Sheet, arrow: Arrow, at: np.ndarray, color: str, rim: str, gid: str) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Circle, FancyArrowPatch

    look: dict[str, Any] = {"linewidth": 0.12 * sheet.em, "path_effects": sheet.rim(rim)}
    look["gid"] = gid
    if arrow.length < _SHORT:
        # A dot for an arrow towards the observer, an open ring for one away from them.
        face = color if arrow.towards else "none"
        sheet.add(Circle(tuple(at), 0.3 * sheet.em, facecolor=face, edgecolor=color, **look))
        return
    reach = _LENGTH * sheet.em
    tip = at + reach * arrow.way
    head = 0.7 * sheet.em * min(1.0, 2.0 * arrow.length)
    part = 1.0 - 0.8 * head / (reach * arrow.length)  # the line ends inside the head
    xs, ys = zip(at, at + part * (tip - at), strict=True)
    sheet.add(Line2D(xs, ys, color=color, **look))
    style = f"-|>,head_length={head:.3f},head_width={0.45 * head:.3f}"
    options: dict[str, Any] = {"mutation_scale": 1.0, "shrinkA": 0, "shrinkB": 0, "linewidth": 0}
    drawn = FancyArrowPatch(tuple(at), tuple(tip), arrowstyle=style, color=color, **options)
    drawn.set_zorder(2.5)  # over the line, under the names
    sheet.add(drawn)


def scale_bar_of(
    image: Image, wanted: Any, shown: tuple[float, str] | None = None
) -> tuple[float, str] | None:
    """Return the bar's length in the image's unit, and its text; None if no bar would be correct.

    `wanted` is True for a round length, in the unit `shown` (see `bar_length`), or the length.
    """
    left, right, _, _ = image.extent
    across = abs(right - left)
    if wanted is False or wanted is None:
        return None
    if wanted is True:
        return None if is_wide(image) else bar_length(_PART * across, image.unit, shown)
    given = as_given(wanted, "scale_bar", "100 au")
    if is_quantity(given):
        image_unit = parse_unit(image.unit)
        factor = (
            None if image_unit is None else plane_factor(image, given.unit, image_unit)
        )  # of angles, too
        length = plain(given, image_unit, "scale_bar") if factor is None else factor * given.value
        length = finite(length, "scale_bar")
        # Keep the unit that the user chose.
        text = with_unit(float(given.value), readable(1.0, str(given.unit))[1])
    else:
        length = finite(given, "scale_bar")
        factor, name = readable(length, image.unit)
        text = with_unit(length * factor, name)
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


def draw_measures(sheet: Sheet, measures: Any, extent: tuple[float, ...]) -> None:
    """Draw lines, (n, 2) on the image plane, each with its text above its highest point."""
    from matplotlib.lines import Line2D

    left, right, bottom, top = extent
    scale = np.array([sheet.width / (right - left), sheet.height / (top - bottom)])
    look: dict[str, Any] = {"color": _MEASURED[0], "path_effects": sheet.rim(_MEASURED[1])}
    look |= {"linewidth": 0.1 * sheet.em, "gid": "measures", "solid_joinstyle": "round"}
    for points, words in measures:
        xy = (np.asarray(points, float) - (left, bottom)) * scale
        sheet.add(
            Line2D(*xy.T, marker="o" if len(xy) < 4 else "", markersize=0.4 * sheet.em, **look)
        )
        x, y = xy[np.argmax(xy[:, 1])]
        if 0 <= x <= sheet.width and 0 <= y <= sheet.height:
            place = {"ha": "center", "va": "bottom", "gid": "measures"}
            sheet.rimmed(x, y + 0.4 * sheet.em, str(words), _MEASURED, **place)


def draw_scale_bar(sheet: Sheet, image: Image, length: float, text: str) -> None:
    """Draw the bar at the lower left."""
    from matplotlib.patches import Rectangle

    long = sheet.per_pixel * length / abs(image.pixel_size[0])
    thick = max(1.0, round(0.16 * sheet.em))
    x = y = float(round(sheet.pad))
    inks = sheet.inks(x, y, long, 2 * sheet.em)
    look: dict[str, Any] = {"path_effects": sheet.rim(inks[1]), "gid": "scale-bar"}
    sheet.add(Rectangle((x, y), long, thick, facecolor=inks[0], linewidth=0.0, **look))
    place = {"ha": "center", "va": "bottom"}
    up = y + thick + 0.3 * sheet.em
    draft = sheet.text(0.0, up, text, **place)
    wide = float(draft.get_window_extent().width) * 72 / sheet.figure.dpi
    draft.remove()
    # Centre the text on its bar, unless it is longer than the bar.
    sheet.rimmed(x + 0.5 * max(long, wide), up, text, inks, **place)


def time_text(time: Any, volume: Volume | None) -> str:
    """Return the time stamp; the empty string if there is none. True: that in ``volume.meta``."""
    if isinstance(time, str):
        return time
    if time is None or time is False:
        return ""
    words: list[str] = []
    unit: Any = ""
    if time is True:
        meta = {} if volume is None else volume.meta
        redshift: Any = meta.get("redshift")
        time, unit = meta.get("time"), meta.get("time_unit")
        if _is_number(redshift):
            words.append(f"z = {float(redshift):.4g}")
        if not is_quantity(time) and not _is_number(time):
            return ", ".join(words)
    time = as_quantity(time)
    if is_quantity(time):
        time, unit = time.value, time.unit
    try:
        number, unit = float(time), str(unit or "")
    except (TypeError, ValueError) as error:
        raise InputError(f"time must be a text, a number or a quantity, got {time!r}") from error
    factor, name = readable(number, unit)
    stamp = with_unit(number * factor, name) if name else number_text(number)
    return ", ".join([f"t = {stamp}", *words])


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def draw_time(sheet: Sheet, words: str) -> None:
    """Write the time at the upper left."""
    x, y = sheet.pad, sheet.height - sheet.pad
    inks = sheet.inks(x, y - sheet.em, 0.5 * sheet.em * len(words), sheet.em)
    sheet.rimmed(x, y, words, inks, ha="left", va="top", gid="time")


def draw_title(sheet: Sheet, words: str) -> None:
    """Write the title above everything, shrunk to the width of the picture if necessary."""
    look = {"fontsize": _TITLE * sheet.em, "ha": "center", "va": "bottom", "gid": "title"}
    up = sheet.height + sheet.overhang()[3] + 0.5 * sheet.em
    text = sheet.text(0.5 * sheet.width, up, words, **look)
    wide = text.get_window_extent(sheet.canvas.get_renderer()).width
    if wide > sheet.width:
        text.set_fontsize(_TITLE * sheet.em * sheet.width / wide)


def draw_ticks(sheet: Sheet, image: Image, shown: tuple[float, str]) -> None:
    """Draw a frame with outward ticks and axis labels around the picture."""
    from matplotlib.ticker import MaxNLocator

    beside = max(1.0, LINE * sheet.em)  # so that the frame covers none of its pixels
    place = (-beside, -beside, sheet.width + 2 * beside, sheet.height + 2 * beside)
    sides = (sheet.width, sheet.height)
    counts = [max(2, min(8, int(side / (_ROOM * sheet.em)))) for side in sides]
    text: dict[str, Any] = {"fontsize": sheet.em, "color": sheet.ink}
    if image.wcs is not None and not is_linear(image.wcs):
        from astropy.visualization.wcsaxes import WCSAxes

        sky: Any = sheet.axes(*place, axes_class=WCSAxes, wcs=image.wcs)
        limits = [(-0.5 - beside, side - 0.5 + beside) for side in sides]
        sky.set(xlim=limits[0], ylim=limits[1])
        label_axes(sky, image.wcs)
        for coordinate, count in zip(sky.coords, counts, strict=True):
            coordinate.set_ticks(number=count, size=0.35 * sheet.em, color=sheet.ink)
            coordinate.set_ticklabel(size=NUMBERS * sheet.em, color=sheet.ink)
            coordinate.set_axislabel(coordinate.get_axislabel(), **text)
            coordinate.tick_params(direction="out")
        sky.coords.frame.set_color(sheet.ink)
        sky.coords.frame.set_linewidth(LINE * sheet.em)
        return
    axes, (factor, name) = sheet.axes(*place), shown
    edges, labels = [factor * v for v in image.extent], [labelled(axis, name) for axis in "xy"]
    if image.wcs is not None:
        edges[:], labels = plain_axes(image.wcs)
    ranges = (edges[:2], edges[2:])
    for k, axis in enumerate((axes.xaxis, axes.yaxis)):
        low, high = ranges[k]
        step = beside * (high - low) / sides[k]
        axes.set(**{f"{'xy'[k]}lim": (low - step, high + step)})
        axis.set_major_locator(MaxNLocator(counts[k], steps=[1, 2, 5, 10]))
        axis.set_label_text(labels[k], **text)
        axis.get_offset_text().set(fontsize=NUMBERS * sheet.em, color=sheet.ink)


def readable_axes(image: Image) -> tuple[float, str]:
    """Return the factor to, and the name of, a unit that suits the size of the picture."""
    # The coordinates of a wide flat screen are tangents, not angles.
    if is_wide(image) and (image.camera or {}).get("projection") == "flat":
        return 1.0, image.unit
    left, right, bottom, top = image.extent
    return readable(0.5 * max(abs(right - left), abs(top - bottom)), image.unit)


def readable_unit(image: Image) -> str | None:
    """Return the unit of the scale bar that suits a picture, if it has one that can be typed."""
    left, right, _, _ = image.extent
    name = readable(_PART * abs(right - left), image.unit)[1]
    return None if is_wide(image) or known_unit(name) is None else name
