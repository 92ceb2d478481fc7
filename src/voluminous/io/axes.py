"""Grid axes: their names in files, edges from centres, and units of length."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError
from ..grids.cartesian.grid import CartesianGrid

if TYPE_CHECKING:
    from ..grids import CartesianGrid
    from ..volume import Volume

AXES = "xyz"
# Full dimension names used by models and instruments.
_NAMES = {
    "x": r"n?x[a-z]{0,2}([_\d].*)?|n?[rg]?lon(g|s|gitudes?)?([_\d].*)?|n?i|east.*|west_east.*|"
    r"xi_.*",
    "y": r"n?y[a-z]{0,2}([_\d].*)?|n?[rg]?lat(s|itudes?)?([_\d].*)?|n?j|north.*|south_north.*|"
    r"eta_.*",
    "z": r"n?z[a-z]{0,2}([_\d].*)?|n?[pmi]?lev(s|els?)?([_\d].*)?|n?k|alt(itude)?s?|heights?.*|"
    r"depths?.*|pres(sure)?s?.*|isobaric.*|bottom_top.*|sigma.*|hybrid.*|s_(rho|w)|layers?",
    "t": r"n?t|times?([_\d].*)?|dates?|steps?|forecast.*|realization|ensembles?|members?|numbers?",
}
# CF standard names (https://cfconventions.org), by suffix or prefix.
_STANDARD = {
    "x": r".*longitude|projection_x.*|.*_x_coordinate",
    "y": r".*latitude|projection_y.*|.*_y_coordinate",
    "z": r"height.*|altitude.*|depth.*|air_pressure.*|model_level_number|atmosphere_.*|ocean_.*|"
    r".*_z_coordinate",
    "t": r"time|forecast_.*|realization",
}
_UNITS = {
    "x": r"degrees?_?e(ast)?",
    "y": r"degrees?_?n(orth)?",
    "z": r"[hk]?pa|mb(ar)?|millibars?|dbar",
    "t": r".* since .*",
}
# Centres that are equally spaced within single precision belong to equal cells.
_EVEN = 1e-4
# From small to large; a domain is between 1 and some hundred thousand units wide.
_ROUND = ("nm", "um", "mm", "cm", "m", "km", "solRad", "au", "pc", "kpc", "Mpc", "Gpc")


def axis_of(dim: str, attributes: Mapping[str, Any]) -> str:
    """Return the axis of a dimension: ``"x"``, ``"y"``, ``"z"``, ``"t"``, or "" if undetermined.

    The CF attributes of its coordinate (`axis`, `standard_name`, `positive`, `units`) take
    precedence over its name.
    """
    given = str(attributes.get("axis", "")).strip().lower()
    if given in (*AXES, "t"):
        return given
    axis = _matching(_STANDARD, attributes.get("standard_name"))
    if not axis and str(attributes.get("positive", "")).lower() in ("up", "down"):
        axis = "z"
    return axis or _matching(_UNITS, attributes.get("units")) or _matching(_NAMES, dim)


def _matching(patterns: Mapping[str, str], text: Any) -> str:
    if not isinstance(text, str):
        return ""
    lower = text.strip().lower()
    return next((axis for axis, names in patterns.items() if re.fullmatch(names, lower)), "")


def edges_of_centers(centers: np.ndarray) -> np.ndarray:
    """Return the midpoints between ascending centres, and an extrapolated edge at each end."""
    values = np.asarray(centers, np.float64)
    if len(values) == 1:
        return np.array([values[0] - 0.5, values[0] + 0.5])
    if is_even(values):
        half = 0.5 * (values[-1] - values[0]) / (len(values) - 1)
        return np.linspace(values[0] - half, values[-1] + half, len(values) + 1)
    middles = 0.5 * (values[1:] + values[:-1])
    ends = 2 * values[0] - middles[0], 2 * values[-1] - middles[-1]
    return np.concatenate([[ends[0]], middles, [ends[1]]])


def is_even(centers: np.ndarray) -> bool:
    """Return True if coordinates are equally spaced up to rounding."""
    even = np.linspace(centers[0], centers[-1], len(centers))
    step = abs(centers[-1] - centers[0]) / max(len(centers) - 1, 1)
    return bool(np.max(np.abs(centers - even)) <= _EVEN * step)


def round_unit(width: Any) -> Any:
    """Return the largest unit of length in which a domain is at least 1 wide.

    Examples
    --------
    >>> from astropy import units as u
    >>> str(round_unit(16 * 1.559e16 * u.cm)), str(round_unit(5e-6 * u.cm))
    ('AU', 'nm')
    """
    from astropy import units as u

    width = u.Quantity(1 * width)
    fitting = [name for name in _ROUND if width.to_value(name) >= 1 - 1e-9]
    return u.Unit(fitting[-1] if fitting else _ROUND[0])


def cartesian(volume: Volume) -> CartesianGrid:
    """Return the grid of a volume; raise an error if it is not Cartesian."""
    if not isinstance(volume.grid, CartesianGrid):
        raise InputError(
            f"this format holds Cartesian grids only, got {type(volume.grid).__name__}; save it as "
            ".h5, or resample it first (volume.resample, voluminous convert --resample)"
        )
    grid: CartesianGrid = volume.grid
    return grid
