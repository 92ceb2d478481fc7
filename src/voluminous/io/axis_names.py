"""Which axis the name of a dimension, or what is said of its coordinate, stands for."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

AXES = "xyz"
# Whole names of dimensions, as models and instruments write them.
_NAMES = {
    "x": r"n?x[a-z]{0,2}([_\d].*)?|n?[rg]?lon(g|s|gitudes?)?([_\d].*)?|n?i|east.*|west_east.*|"
    r"xi_.*",
    "y": r"n?y[a-z]{0,2}([_\d].*)?|n?[rg]?lat(s|itudes?)?([_\d].*)?|n?j|north.*|south_north.*|"
    r"eta_.*",
    "z": r"n?z[a-z]{0,2}([_\d].*)?|n?[pmi]?lev(s|els?)?([_\d].*)?|n?k|alt(itude)?s?|heights?.*|"
    r"depths?.*|pres(sure)?s?.*|isobaric.*|bottom_top.*|sigma.*|hybrid.*|s_(rho|w)|layers?",
    "t": r"n?t|times?([_\d].*)?|dates?|steps?|forecast.*|realization|ensembles?|members?|numbers?",
}
# CF standard names (https://cfconventions.org), by what they end or begin with.
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


def axis_of(dim: str, attributes: Mapping[str, Any]) -> str:
    """Return what a dimension is: ``"x"``, ``"y"``, ``"z"``, ``"t"``, or nothing if unknown.

    The CF attributes of its coordinate (`axis`, `standard_name`, `positive`, `units`) go before its
    name.
    """
    told = str(attributes.get("axis", "")).strip().lower()
    if told in (*AXES, "t"):
        return told
    found = _matching(_STANDARD, attributes.get("standard_name"))
    if not found and str(attributes.get("positive", "")).lower() in ("up", "down"):
        found = "z"
    return found or _matching(_UNITS, attributes.get("units")) or _matching(_NAMES, dim)


def _matching(patterns: Mapping[str, str], text: Any) -> str:
    if not isinstance(text, str):
        return ""
    lower = text.strip().lower()
    return next((axis for axis, found in patterns.items() if re.fullmatch(found, lower)), "")
