"""A bar of a round length."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ...errors import InputError
from ...units import as_quantity, is_quantity, parse_unit, plain
from ..coordinates import known_unit
from ..stretch import finite
from .lengths import bar_length, readable, with_unit

if TYPE_CHECKING:
    from ..image import Image
    from .sheet import Sheet

# The longest that it is by itself, in widths of the picture.
_PART = 0.25
# Pictures of wider angles (radians) have no one scale: 0.3 % between middle and edge.
_WIDE = 0.2


def scale_bar(
    image: Image, wanted: Any, shown: tuple[float, str] | None = None
) -> tuple[float, str] | None:
    """Return length in the image's unit, and text; None where no bar says the truth.

    Parameters
    ----------
    image : Image
    wanted : bool, Quantity, str or float
        True: a round length that fits. A length: this one, such as ``"100 au"``.
    shown : (float, str), optional
        The unit in which a round length is told; see `bar_length`.

    Raises
    ------
    InputError
        If it is longer than the picture.
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
    """Return True for a picture of angles so wide that it has no one scale."""
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
        # The unit the user chose is the one to read.
        _, name = readable(1.0, str(wanted.unit))
        return length, with_unit(float(wanted.value), name)
    length = finite(wanted, "scale_bar")
    factor, name = readable(length, image.unit)
    return length, with_unit(length * factor, name)


def draw_scale_bar(sheet: Sheet, image: Image, length: float, text: str) -> None:
    """Draw the bar at the lower left, as long as it is in the picture."""
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
    # In the middle of its bar, unless it is longer than that.
    sheet.rimmed(x + 0.5 * max(long, wide), up, text, (ink, rim), **place)
