"""The grid of a cube: where its cells are, and what its third axis measures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import FileFormatError, InputError
from ...geometry import is_uniform
from ...units import parse_unit, plain
from .axes import axis_name, converted, edges_along, third_axis
from .world import World

if TYPE_CHECKING:
    from ...grids import CartesianGrid

# Up to this width of the sky (degrees) lengths are in arcseconds.
_NARROW = 1.0


@dataclass(frozen=True)
class Axis:
    """A third axis that is no length of the grid: what its cells measure.

    Attributes
    ----------
    name : str
        Of the field that holds it.
    values : float64 array, shape (n,)
        At the centres of the cells.
    unit : astropy unit or None
        Theirs.
    """

    name: str
    values: np.ndarray
    unit: Any


@dataclass(frozen=True)
class Layout:
    """A grid, the meaning of its z, and the WCS behind (None if there is none)."""

    grid: CartesianGrid
    axis: Axis | None = None
    wcs: Any = None


def unit_cells(sides: tuple[int, ...], bounds: Any, unit: Any) -> Layout:
    """Return the layout of a cube of which no coordinates are known."""
    from ...grids import CartesianGrid

    bounds = [(0, n) for n in sides] if bounds is None else bounds
    return Layout(CartesianGrid.uniform(sides, bounds, unit=unit))


def layout(found: World, header: Any, unit: Any, depth: Any, spectral_scale: Any) -> Layout:
    """Return the grid for the world coordinates of a cube.

    Parameters
    ----------
    found : World
        The coordinates.
    header : astropy.io.fits.Header
        Of the file.
    unit : str or unit, optional
        Of the grid.
    depth, spectral_scale : float, Quantity or text, optional
        How deep the third axis is in the grid's unit, or how much of that stands for one unit of
        what it measures.

    Raises
    ------
    InputError
        If both are given, or one cannot be used.
    UnitsError
        If the axes cannot be in the unit.
    """
    from ...grids import CartesianGrid

    wcs = found.wcs
    (x, y), own = _plane(found, parse_unit(unit))
    third, centers, measure = third_axis(wcs, header)
    if is_place(wcs):
        if depth is not None or spectral_scale is not None:
            raise InputError("depth and spectral_scale are for cubes whose third axis is no length")
        return Layout(CartesianGrid(x, y, converted(third, measure, own), unit=own), wcs=wcs)
    scale = _scale(third, (x, y), own, depth, spectral_scale, measure)
    grid = CartesianGrid(x, y, _depths(third, scale), unit=own)
    axis = Axis(axis_name(wcs), centers, measure)
    return Layout(grid, axis, wcs)


def _plane(found: World, unit: Any) -> tuple[list[np.ndarray], Any]:
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
    # In the plane of projection, from the middle of the cube.
    linear = np.diag(wcs.wcs.get_cdelt()) @ wcs.wcs.get_pc()
    steps = np.linalg.norm(linear[:2, :2], axis=0)
    counts = wcs.pixel_shape[:2]
    if unit is None:
        unit = u.arcsec if max(steps * counts) < _NARROW else u.deg
    steps = [converted(step, u.deg, unit) for step in steps]
    return [(np.arange(n + 1) - 0.5 * n) * s for n, s in zip(counts, steps, strict=True)], unit


def _same_kind(one: Any, other: Any) -> bool:
    """Return True if units can be converted into each other, or neither is known."""
    if one is None or other is None:
        return one is other
    return bool(one.is_equivalent(other))


def is_place(wcs: Any) -> bool:
    """Return True if the third axis of a WCS is in space, as the others are."""
    if wcs.has_celestial or wcs.wcs.spec >= 0:
        return False
    return _same_kind(parse_unit(wcs.wcs.cunit[2]), parse_unit(wcs.wcs.cunit[0]))


def _scale(
    third: np.ndarray, first: Any, own: Any, depth: Any, spectral_scale: Any, measure: Any
) -> float:
    """Return how much of the grid's unit stands for one unit of the third axis."""
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
    if is_uniform(third):  # a difference of large numbers would not be
        return np.linspace(-half, half, len(third))
    return (third - 0.5 * (third[0] + third[-1])) * scale


def _positive(value: Any, unit: Any, what: str) -> float:
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
