"""Directions as arrows: the axes of the volume as the camera sees them; north and east."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import VoluminousError
from ...rotation import angles_towards, image_axes, position_angle
from ..beam import sky_matrix

if TYPE_CHECKING:
    from ..image import Image
    from .sheet import Sheet

_LENGTH = 2.6
# Arrows shorter than this point along the line of sight.
_SHORT = 0.12
_XYZ = {"x": ("#ff6a5a", "#c02010"), "y": ("#5ce05c", "#107810"), "z": ("#86b4ff", "#1040c0")}
_SKY = {"GLON": ("b", "l"), "ELON": ("β", "λ")}


@dataclass
class Arrow:
    """A direction in the picture: its name, its part of the full length to the right and up."""

    name: str
    across: float
    up: float
    towards: bool = True
    colors: tuple[str, str] | None = None


def triad(image: Image) -> list[Arrow]:
    """Return the directions of x, y and z in the picture; none if the camera does not tell them."""
    axes = _camera_axes(image.camera or {})
    if axes is None:
        return []
    signs = np.sign(image.pixel_size)
    return [
        Arrow(name, signs[0] * axes[0, k], signs[1] * axes[1, k], axes[2, k] > 0.0, _XYZ[name])
        for k, name in enumerate("xyz")
    ]


def _camera_axes(camera: dict[str, Any]) -> np.ndarray | None:
    """Return what is to the right, up and towards the observer, shape (3, 3)."""
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
        return None  # from another program, or a unit that is not known here
    return None


def _points(*told: Any) -> np.ndarray:
    """Return points in one unit: centimetres where they are texts with units, else as they are.

    Raises
    ------
    ValueError
        If there are both: which unit plain numbers are in only the volume knows. Zeros are in any.
    """
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
    """Return north and east in the middle of the picture; none without celestial coordinates."""
    to_sky = sky_matrix(image)
    if to_sky is None:
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
    """Draw arrows from one point, with their names in a corner on the right of the picture."""
    reach = _LENGTH * sheet.em
    tips = np.array([(a.across, a.up) for a in arrows]) * reach
    names = _name_places(arrows, reach, sheet.em)
    around = np.concatenate([tips, names - 0.5 * sheet.em, names + 0.5 * sheet.em, [[0.0, 0.0]]])
    low, high = around.min(axis=0), around.max(axis=0)
    x = sheet.width - sheet.pad - high[0]
    y = sheet.height - sheet.pad - high[1] if top else sheet.pad - low[1]
    ink, rim = sheet.inks(x + low[0], y + low[1], *(high - low))
    # What comes towards the observer lies over the rest.
    for arrow, place in sorted(zip(arrows, names, strict=True), key=lambda pair: pair[0].towards):
        color = ink if arrow.colors is None else arrow.colors[rim > ink]
        _draw(sheet, arrow, (x, y), reach, color, rim, gid)
        at = x + place[0], y + place[1]
        sheet.rimmed(*at, arrow.name, (color, rim), ha="center", va="center")


def _name_places(arrows: list[Arrow], reach: float, em: float) -> np.ndarray:
    """Return where names stand: beyond the tips, or beside those that lie on another arrow."""
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
    """Return a place beyond the tip; beside a point, for what is seen end-on."""
    direction = np.array([arrow.across, arrow.up])
    length = float(np.linalg.norm(direction))
    if length < _SHORT:
        return np.array([-0.7, -0.7]) * em
    return direction * (reach + 0.75 * em / length)


def _clearance(place: np.ndarray, ends: np.ndarray) -> float:
    """Return how far a place is from the nearest of some lines from the origin to their ends."""
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
        # A dot for the tip of an arrow, an open ring for its end.
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
