"""The place of a cube: its grid, the quantity along its third axis, and its position on the sky."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import FileFormatError, InputError
from ...geometry import is_uniform
from ...image.fits_header import card, lenient_unit
from ...units import parse_unit, plain
from ..contract import UnitLike
from ..names import field_name
from .cubes import Cube
from .wcs import HINT, has_world, linear_part, world

if TYPE_CHECKING:
    from astropy.io.fits import Header
    from astropy.wcs import WCS

    from ...grids import CartesianGrid

# The grid's unit, and the depth of the third axis in it if this axis is not a length.
UNIT, DEPTH = "VOLUNIT", "VOLDEPTH"
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
# Fields of view up to this width (degrees) are in arcseconds.
_NARROW = 1.0
# Cells offset by less than this fraction of their width are identical.
_SAME = 1e-3
# Rounding error of a cosine and a sine, in degrees.
_TURNED = 1e-9


@dataclass(frozen=True)
class ThirdAxis:
    """A third axis that is not a length: the quantity that it measures."""

    name: str  # name of the field that holds it
    values: np.ndarray  # at the centres of the cells
    unit: UnitLike  # their unit


@dataclass(frozen=True)
class CubePlace:
    """The grid of a cube, and how its array is brought to it."""

    grid: CartesianGrid
    axes: tuple[int, ...] = (0, 1, 2)  # axis of the cube (0 is the fastest) for x, y, z
    flipped: tuple[bool, ...] = (False,) * 3  # whether each of x, y, z is reversed
    wcs: WCS = None  # of the grid's pixels; None if there is none
    third: ThirdAxis | None = None

    def arrange(self, stored: np.ndarray) -> np.ndarray:
        """Return a view of a NumPy-ordered array in the grid's axis order."""
        senses = tuple(slice(None, None, -1 if flip else 1) for flip in self.flipped)
        return np.asarray(stored.transpose([2 - axis for axis in self.axes])[senses])

    def agrees(self, other: CubePlace) -> bool:
        """Return True if another cube has the same cells in the same order."""
        same = (self.grid.shape, self.axes, self.flipped)
        if same != (other.grid.shape, other.axes, other.flipped):
            return False
        if self.wcs is None or other.wcs is None:
            return True
        corners = np.vstack([np.zeros(3), np.diag(self.grid.shape) - np.eye(3)])
        try:
            result = other.wcs.wcs_world2pix(self.wcs.wcs_pix2world(corners, 0), 0)
        except ValueError:  # outside the other cube's projection
            return False
        kinds = [list(w.wcs.ctype) for w in (self.wcs, other.wcs)]
        return kinds[0] == kinds[1] and bool(np.all(np.abs(result - corners) < _SAME))

    def pointing(self) -> dict[str, Any]:
        """Return the sky position of the cube's centre and its orientation, in degrees.

        ``posang`` is the position angle of the y axis, from north to east; a camera with the same
        ``posang`` shows north at the top.
        """
        if self.wcs is None or not self.wcs.has_celestial:
            return {}
        middle = 0.5 * (np.array(self.grid.shape) - 1)
        lon, lat, _ = self.wcs.wcs_pix2world(middle[None], 0)[0]
        angle = float(np.rad2deg(np.arctan2(*linear_part(self.wcs)[:2, 1])))
        described: dict[str, Any] = {"center": [float(lon), float(lat)]}
        return described | ({"posang": angle} if abs(angle) > _TURNED else {})


def place_of(cube: Cube, options: Mapping[str, Any]) -> CubePlace:
    """Return the place of a cube, by its header or, if it has none or it is not wanted, unit cells.

    See the reader for the options.
    """
    from ...grids import CartesianGrid

    header, bounds, unit = cube.image.header, options.get("bounds"), options.get("unit")
    if bounds is not None or options.get("wcs") is False or not has_world(header):
        bounds = [(0, n) for n in cube.sides] if bounds is None else bounds
        return CubePlace(CartesianGrid.uniform(cube.sides, bounds, unit=unit))
    depth, per_value = options.get("depth"), options.get("spectral_scale")
    if unit is None and card(header, UNIT):  # we wrote it
        unit = card(header, UNIT)
        depth = card(header, DEPTH) if depth is None and per_value is None else depth
    velocity, rest = options.get("velocity"), options.get("rest")
    wcs, header, axes, flipped = world(cube.image, cube.axes, velocity, rest)
    (x, y), plane_unit = _plane(wcs, parse_unit(unit))
    edges, centers, measure = _third_axis(wcs, header)
    if is_place(wcs):
        if depth is not None or per_value is not None:
            raise InputError("depth and spectral_scale are for cubes whose third axis is no length")
        grid = CartesianGrid(x, y, _converted(edges, measure, plane_unit), unit=plane_unit)
        return CubePlace(grid, axes, flipped, wcs)
    scale = _scale(edges, (x, y), plane_unit, depth, per_value, measure)
    half = 0.5 * scale * float(np.ptp(edges))
    z = (edges - 0.5 * (edges[0] + edges[-1])) * scale
    if is_uniform(edges):  # a difference of large numbers would not be uniform
        z = np.linspace(-half, half, len(edges))
    third = ThirdAxis(axis_name(wcs), centers, measure)
    return CubePlace(CartesianGrid(x, y, z, unit=plane_unit), axes, flipped, wcs, third)


def _third_axis(wcs: WCS, header: Header) -> tuple[np.ndarray, np.ndarray, Any]:
    """Return edges and centres along the third axis in a customary unit, and this unit.

    Centres are at mid-channel in the coordinate in which channels are evenly spaced.
    """
    edges, unit = _edges_along(wcs, 2)
    centers = 0.5 * (edges[1:] + edges[:-1])
    if not _is_linear(wcs, 2):
        centers = _along(wcs, 2, np.arange(len(centers)))
    shown = None if unit is None else _shown(wcs, unit, header)
    return _converted(edges, unit, shown), _converted(centers, unit, shown), shown


def _edges_along(wcs: WCS, axis: int) -> tuple[np.ndarray, Any]:
    count = wcs.pixel_shape[axis]
    edges = _along(wcs, axis, np.arange(count + 1) - 0.5)
    if _is_linear(wcs, axis):  # make them exactly even
        edges = np.linspace(edges[0], edges[-1], count + 1)
    if not np.all(np.isfinite(edges)) or not np.all(np.diff(edges) > 0):
        raise FileFormatError(
            f"the coordinates along axis {wcs.wcs.ctype[axis]!r} of the WCS do not increase{HINT}"
        )
    return edges, parse_unit(wcs.wcs.cunit[axis])


def _along(wcs: WCS, axis: int, places: np.ndarray) -> np.ndarray:
    return np.asarray(wcs.sub([axis + 1]).wcs_pix2world(places[:, None], 0)[:, 0])


def _is_linear(wcs: WCS, axis: int) -> bool:
    return "-" not in wcs.wcs.ctype[axis]


def _shown(wcs: WCS, unit: Any, header: Header) -> Any:
    from astropy import units as u

    for usual in (u.km / u.s, u.GHz):
        if unit.is_equivalent(usual):
            return usual
    if wcs.wcs.spec != 2:
        return unit
    spectral = (k for k in range(1, 10) if str(card(header, f"CTYPE{k}", ""))[:4] in _NAMES)
    cards = (lenient_unit(str(card(header, f"CUNIT{k}", ""))) for k in spectral)
    shown = next((c for c in cards if c is not None and c.is_equivalent(unit)), unit)
    return u.um if shown == u.m else shown


def _converted(value: Any, unit: UnitLike, other: Any) -> Any:
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


def _plane(wcs: WCS, unit: UnitLike) -> tuple[list[np.ndarray], Any]:
    from astropy import units as u

    if not wcs.has_celestial:
        edges, units = zip(*(_edges_along(wcs, k) for k in (0, 1)), strict=True)
        plane_unit = units[0] if unit is None else unit
        if not _same_kind(*units):
            raise FileFormatError(f"x is in {units[0]} and y in {units[1]}{HINT}")
        return [_converted(e, k, plane_unit) for e, k in zip(edges, units, strict=True)], plane_unit
    # In the projection plane, relative to the centre of the cube.
    steps = np.linalg.norm(linear_part(wcs)[:2, :2], axis=0)
    counts = wcs.pixel_shape[:2]
    if unit is None:
        unit = u.arcsec if max(steps * counts) < _NARROW else u.deg
    steps = [_converted(step, u.deg, unit) for step in steps]
    return [(np.arange(n + 1) - 0.5 * n) * s for n, s in zip(counts, steps, strict=True)], unit


def _same_kind(one: Any, other: Any) -> bool:
    if one is None or other is None:
        return one is other
    return bool(one.is_equivalent(other))


def is_place(wcs: WCS) -> bool:
    """Return True if the third axis of a WCS is a spatial one."""
    if wcs.has_celestial or wcs.wcs.spec >= 0:
        return False
    return _same_kind(parse_unit(wcs.wcs.cunit[2]), parse_unit(wcs.wcs.cunit[0]))


def _scale(
    third: np.ndarray, first: Any, plane_unit: Any, depth: Any, spectral_scale: Any, measure: Any
) -> float:
    if depth is not None and spectral_scale is not None:
        raise InputError("give depth or spectral_scale, not both")
    if spectral_scale is not None:
        per = None if plane_unit is None or measure is None else plane_unit / measure
        return _positive(spectral_scale, per, "spectral_scale")
    widest = max(float(np.ptp(edges)) for edges in first)
    return (widest if depth is None else _positive(depth, plane_unit, "depth")) / float(
        np.ptp(third)
    )


def _positive(value: Any, unit: UnitLike, what: str) -> float:
    from astropy import units as u

    try:
        number = plain(u.Quantity(value) if isinstance(value, str) else value, unit, what)
    except TypeError:
        number = None
    if not isinstance(number, float) or not 0 < number < np.inf:
        raise InputError(f"{what} must be a positive, finite number, got {value!r}")
    return number
