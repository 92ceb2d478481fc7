"""The axes of a WCS that have nothing to do with others: edges of pixels, units, names."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...errors import FileFormatError
from ...units import parse_unit, plain
from ..names import field_name
from .blocks import card
from .units import lenient_unit

_NAMES = {
    **dict.fromkeys(("VRAD", "VOPT", "VELO"), "velocity"),
    **dict.fromkeys(("WAVE", "AWAV"), "wavelength"),
    "FREQ": "frequency",
    "ENER": "energy",
    "WAVN": "wavenumber",
    "ZOPT": "redshift",
    "BETA": "beta",
}
_KINDS = {"speed": "velocity", "frequency": "frequency", "energy": "energy"}


def third_axis(wcs: Any, header: Any) -> tuple[np.ndarray, np.ndarray, Any]:
    """Return edges and centres along the third axis in a unit that people read, and that unit.

    Centres are in the middle of channels, in whatever these are even.
    """
    edges, unit = edges_along(wcs, 2)
    centers = 0.5 * (edges[1:] + edges[:-1])
    if not _is_linear(wcs, 2):
        centers = _along(wcs, 2, np.arange(len(centers)))
    shown = None if unit is None else _shown(wcs, unit, header)
    return converted(edges, unit, shown), converted(centers, unit, shown), shown


def edges_along(wcs: Any, axis: int) -> tuple[np.ndarray, Any]:
    """Return the world coordinates of the edges of pixels along an axis of its own, and the unit.

    Raises
    ------
    FileFormatError
        If they do not increase.
    """
    count = wcs.pixel_shape[axis]
    edges = _along(wcs, axis, np.arange(count + 1) - 0.5)
    if _is_linear(wcs, axis):  # as even as can be
        edges = np.linspace(edges[0], edges[-1], count + 1)
    if not np.all(np.isfinite(edges)) or not np.all(np.diff(edges) > 0):
        raise FileFormatError(
            f"the coordinates along axis {wcs.wcs.ctype[axis]!r} of the WCS do not increase; open "
            "it with wcs=False for cells of unit length"
        )
    return edges, parse_unit(wcs.wcs.cunit[axis])


def _along(wcs: Any, axis: int, places: np.ndarray) -> np.ndarray:
    """Return the coordinates of pixels along an axis that no other has to do with."""
    return np.asarray(wcs.sub([axis + 1]).wcs_pix2world(places[:, None], 0)[:, 0])


def _is_linear(wcs: Any, axis: int) -> bool:
    return "-" not in wcs.wcs.ctype[axis]


def _shown(wcs: Any, unit: Any, header: Any) -> Any:
    """Return the unit that people read: km/s, GHz, and the header's own for wavelengths."""
    from astropy import units as u

    if unit.is_equivalent(u.m / u.s):
        return u.km / u.s
    if unit.is_equivalent(u.Hz):
        return u.GHz
    if wcs.wcs.spec != 2:
        return unit
    spectral = (k for k in range(1, 10) if str(card(header, f"CTYPE{k}", ""))[:4] in _NAMES)
    cards = [lenient_unit(str(card(header, f"CUNIT{k}", ""))) for k in spectral] or [unit]
    own = next((c for c in cards if c is not None and c.is_equivalent(unit)), unit)
    return u.um if own == u.m else own


def converted(value: Any, unit: Any, other: Any) -> Any:
    """Return numbers of a unit in another."""
    from astropy import units as u

    if unit is None or other is None:
        return value
    return plain(u.Quantity(value, unit), other, "an axis of the cube")


def axis_name(wcs: Any) -> str:
    """Return the name of the field that tells the third coordinate of a WCS."""
    kind, measure = str(wcs.wcs.ctype[2]), parse_unit(wcs.wcs.cunit[2])
    if kind[:4] in _NAMES and wcs.wcs.spec == 2:
        return _NAMES[kind[:4]]
    for quantity, name in _KINDS.items():
        if measure is not None and measure.physical_type == quantity:
            return name
    return field_name(kind.lower().removesuffix("-tab") or "third")
