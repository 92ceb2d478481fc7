"""Axes of a plot that show world coordinates: astropy's WCSAxes, with names and units to read."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..units import parse_unit

_NAMES = {
    "RA": "right ascension",
    "DEC": "declination",
    "GLON": "galactic longitude",
    "GLAT": "galactic latitude",
    "ELON": "ecliptic longitude",
    "ELAT": "ecliptic latitude",
    "VRAD": "velocity (radio)",
    "VOPT": "velocity (optical)",
    "VELO": "velocity",
    "FREQ": "frequency",
    "WAVE": "wavelength",
    "AWAV": "wavelength (air)",
    "OFFSET": "offset",
}
# Units in which coordinates are read, where the WCS has those of the SI.
_READ = ("km/s", "GHz", "um")
# There are about so many ticks on an axis.
_TICKS = 8


def is_sky_axes(axes: Any) -> bool:
    """Return True for axes that know world coordinates."""
    return hasattr(axes, "coords") and hasattr(axes, "wcs")


def label_axes(axes: Any, wcs: Any) -> None:
    """Name both coordinates, and choose their units."""
    for number in (0, 1):
        coordinate = axes.coords[number]
        coordinate.set_axislabel(_label(wcs, number))
        unit = _unit(wcs, number)
        if coordinate.coord_type == "scalar" and unit is not None:
            coordinate.set_format_unit(unit)
            # Left alone, astropy takes the decimals from the unit of the WCS. With a minus of
            # matplotlib, as in its own kind of format, it knows numbers: of -1000 and -500, as
            # "%.0f" writes them, it shows -1000 and 500, leaving out what both begin with.
            coordinate.set_major_formatter(f"x.{'x' * _decimals(wcs, number)}".removesuffix("."))


def plain_axes(wcs: Any) -> tuple[tuple[float, float, float, float], list[str]]:
    """Return edges (left, right, bottom, top) and labels of linear coordinates."""
    (left, right), (bottom, top) = (_ends(wcs, number) for number in (0, 1))
    return (left, right, bottom, top), [_label(wcs, number) for number in (0, 1)]


def is_linear(wcs: Any) -> bool:
    """Return True for coordinates that do not depend on each other, and are linear."""
    straight = np.array_equal(wcs.wcs.get_pc(), np.eye(2))
    return bool(straight and not any("-" in kind for kind in wcs.wcs.ctype))


def has_lengths(wcs: Any) -> bool:
    """Return True if a bar along x can stand for a length: x is on the sky."""
    return bool(wcs.has_celestial or wcs.wcs.ctype[0] == "OFFSET")


def _label(wcs: Any, number: int) -> str:
    kind = str(wcs.wcs.ctype[number])
    name = _NAMES.get(kind.split("-")[0], kind.lower())
    unit = None if wcs.has_celestial else _unit(wcs, number)
    return name if unit is None else f"{name} [{unit}]"


def _ends(wcs: Any, number: int) -> tuple[float, float]:
    """Return a coordinate at the outer edges of the picture, in the unit that is shown."""
    corners = np.array([[-0.5, -0.5], np.array(wcs.pixel_shape) - 0.5])
    found = wcs.wcs_pix2world(corners, 0)[:, number]
    unit = _unit(wcs, number)
    factor = 1.0 if unit is None else float(wcs.wcs.cunit[number].to(unit))
    return float(found[0]) * factor, float(found[1]) * factor


def _decimals(wcs: Any, number: int) -> int:
    low, high = _ends(wcs, number)
    return max(0, -math.floor(math.log10(abs(high - low) / _TICKS)))


def _unit(wcs: Any, number: int) -> Any:
    unit = parse_unit(wcs.wcs.cunit[number])
    if unit is None:
        return None
    known = (parse_unit(name) for name in _READ)
    # What is not of the SI was chosen by somebody.
    return next((u for u in known if unit.is_equivalent(u) and unit.si.scale == 1), unit)
