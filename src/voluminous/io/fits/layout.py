"""The grid of a cube: positions of its cells, and the quantity along its third axis."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import FileFormatError, InputError
from ...geometry import is_uniform
from ...units import parse_unit, plain
from ..contract import UnitLike
from ..names import field_name
from .hdus import card
from .units import lenient_unit
from .wcs import World

if TYPE_CHECKING:
    from astropy.io.fits import Header
    from astropy.wcs import WCS

    from ...grids import CartesianGrid


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


def third_axis(wcs: WCS, header: Header) -> tuple[np.ndarray, np.ndarray, Any]:
    """Return edges and centres along the third axis in a customary unit, and this unit.

    Centres are at mid-channel in the coordinate in which channels are evenly spaced.
    """
    edges, unit = edges_along(wcs, 2)
    centers = 0.5 * (edges[1:] + edges[:-1])
    if not _is_linear(wcs, 2):
        centers = _along(wcs, 2, np.arange(len(centers)))
    shown = None if unit is None else _shown(wcs, unit, header)
    return converted(edges, unit, shown), converted(centers, unit, shown), shown


def edges_along(wcs: WCS, axis: int) -> tuple[np.ndarray, Any]:
    """Return the world coordinates of pixel edges along an independent axis, and their unit."""
    count = wcs.pixel_shape[axis]
    edges = _along(wcs, axis, np.arange(count + 1) - 0.5)
    if _is_linear(wcs, axis):  # make them exactly even
        edges = np.linspace(edges[0], edges[-1], count + 1)
    if not np.all(np.isfinite(edges)) or not np.all(np.diff(edges) > 0):
        raise FileFormatError(
            f"the coordinates along axis {wcs.wcs.ctype[axis]!r} of the WCS do not increase; open "
            "it with wcs=False for cells of unit length"
        )
    return edges, parse_unit(wcs.wcs.cunit[axis])


def _along(wcs: WCS, axis: int, places: np.ndarray) -> np.ndarray:
    """Return the pixel coordinates along an axis that is independent of the others."""
    return np.asarray(wcs.sub([axis + 1]).wcs_pix2world(places[:, None], 0)[:, 0])


def _is_linear(wcs: WCS, axis: int) -> bool:
    return "-" not in wcs.wcs.ctype[axis]


def _shown(wcs: WCS, unit: Any, header: Header) -> Any:
    """Return the customary unit: km/s, GHz, or the header's unit for wavelengths."""
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


def converted(value: Any, unit: UnitLike, other: Any) -> Any:
    """Convert numbers between units."""
    from astropy import units as u

    if unit is None or other is None:
        return value
    return plain(u.Quantity(value, unit), other, "an axis of the cube")


def axis_name(wcs: WCS) -> str:
    """Return the name of the field that holds the third coordinate of a WCS."""
    kind, measure = str(wcs.wcs.ctype[2]), parse_unit(wcs.wcs.cunit[2])
    if kind[:4] in _NAMES and wcs.wcs.spec == 2:
        return _NAMES[kind[:4]]
    for quantity, name in _KINDS.items():
        if measure is not None and measure.physical_type == quantity:
            return name
    return field_name(kind.lower().removesuffix("-tab") or "third")


# Fields of view up to this width (degrees) are in arcseconds.
_NARROW = 1.0


@dataclass(frozen=True)
class ThirdAxis:
    """A third axis that is not a length: the quantity that it measures."""

    name: str  # name of the field that holds it
    values: np.ndarray  # at the centres of the cells
    unit: UnitLike  # their unit


@dataclass(frozen=True)
class CubeLayout:
    """A grid, the meaning of its z axis, and the underlying WCS (None if there is none)."""

    grid: CartesianGrid
    axis: ThirdAxis | None = None
    wcs: WCS = None


def unit_cells(sides: tuple[int, ...], bounds: Any, unit: UnitLike) -> CubeLayout:
    """Return the layout of a cube without world coordinates."""
    from ...grids import CartesianGrid

    bounds = [(0, n) for n in sides] if bounds is None else bounds
    return CubeLayout(CartesianGrid.uniform(sides, bounds, unit=unit))


def layout(
    found: World, header: Header, unit: UnitLike, depth: Any, spectral_scale: Any
) -> CubeLayout:
    """Return the layout for the world coordinates of a cube."""
    from ...grids import CartesianGrid

    wcs = found.wcs
    (x, y), own = _plane(found, parse_unit(unit))
    third, centers, measure = third_axis(wcs, header)
    if is_place(wcs):
        if depth is not None or spectral_scale is not None:
            raise InputError("depth and spectral_scale are for cubes whose third axis is no length")
        return CubeLayout(CartesianGrid(x, y, converted(third, measure, own), unit=own), wcs=wcs)
    scale = _scale(third, (x, y), own, depth, spectral_scale, measure)
    grid = CartesianGrid(x, y, _depths(third, scale), unit=own)
    axis = ThirdAxis(axis_name(wcs), centers, measure)
    return CubeLayout(grid, axis, wcs)


def _plane(found: World, unit: UnitLike) -> tuple[list[np.ndarray], Any]:
    from astropy import units as u

    wcs = found.wcs
    if not found.on_sky:
        edges, units = zip(*(edges_along(wcs, k) for k in (0, 1)), strict=True)
        own = units[0] if unit is None else unit
        if not _same_kind(*units):
            raise FileFormatError(
                f"x is in {units[0]} and y in {units[1]}, which no grid can have; open it with "
                "wcs=False for cells of unit length, or with bounds=…"
            )
        return [converted(e, k, own) for e, k in zip(edges, units, strict=True)], own
    # In the projection plane, relative to the centre of the cube.
    linear = np.diag(wcs.wcs.get_cdelt()) @ wcs.wcs.get_pc()
    steps = np.linalg.norm(linear[:2, :2], axis=0)
    counts = wcs.pixel_shape[:2]
    if unit is None:
        unit = u.arcsec if max(steps * counts) < _NARROW else u.deg
    steps = [converted(step, u.deg, unit) for step in steps]
    return [(np.arange(n + 1) - 0.5 * n) * s for n, s in zip(counts, steps, strict=True)], unit


def _same_kind(one: Any, other: Any) -> bool:
    """Return True if the units are convertible into each other, or if both are None."""
    if one is None or other is None:
        return one is other
    return bool(one.is_equivalent(other))


def is_place(wcs: WCS) -> bool:
    """Return True if the third axis of a WCS is a spatial one."""
    if wcs.has_celestial or wcs.wcs.spec >= 0:
        return False
    return _same_kind(parse_unit(wcs.wcs.cunit[2]), parse_unit(wcs.wcs.cunit[0]))


def _scale(
    third: np.ndarray, first: Any, own: Any, depth: Any, spectral_scale: Any, measure: Any
) -> float:
    """Return the grid length that represents one unit of the third axis."""
    if depth is not None and spectral_scale is not None:
        raise InputError("give depth or spectral_scale, not both")
    if spectral_scale is not None:
        per = None if own is None or measure is None else own / measure
        return _positive(spectral_scale, per, "spectral_scale")
    widest = max(float(np.ptp(edges)) for edges in first)
    deep = widest if depth is None else _positive(depth, own, "depth")
    return deep / float(np.ptp(third))


def _depths(third: np.ndarray, scale: float) -> np.ndarray:
    half = 0.5 * scale * float(np.ptp(third))
    if is_uniform(third):  # a difference of large numbers would not be uniform
        return np.linspace(-half, half, len(third))
    return (third - 0.5 * (third[0] + third[-1])) * scale


def _positive(value: Any, unit: UnitLike, what: str) -> float:
    if isinstance(value, str):
        value = _parsed(value, what)
    number = plain(value, unit, what)
    if not isinstance(number, float) or not 0 < number < np.inf:
        raise InputError(f"{what} must be a positive, finite number, got {value!r}")
    return number


def _parsed(text: str, what: str) -> Any:
    from astropy import units as u

    try:
        return u.Quantity(text)
    except (TypeError, ValueError) as error:
        raise InputError(f"{what} must be a number with or without a unit, got {text!r}") from error
