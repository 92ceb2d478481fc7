"""Colour bars of a medium, from what it says of itself: a saved picture knows as much."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...expressions import Expression
from ...units import parse_unit
from ..plot import shows_one_channel
from .scales import (
    Scale,
    colormap_of,
    displayed,
    field_units,
    full_colors,
    labelled,
    limits,
    of_intensity,
    table_colors,
    with_units,
)

if TYPE_CHECKING:
    from ..image import Image
    from .histogram import FieldValues

# Where a kind of shell has its centre, its width, and how wide one is either side in these.
_SHELLS = {
    "gaussian": ("center", "sigma", 1.0),
    "rectangle": ("center", "half_width", 1.0),
    "isosurface": ("level", "width", 0.5),
}
_ENTRIES = 512
# A shell is at least this wide on either side, as a part of the bar.
_THIN = 0.006
# Values that are this far from each other are told on a logarithmic scale.
_DECADES = 30.0
# A bar shows so many widths beside a shell, and this part of itself beside all.
_BESIDE, _AROUND = 3.0, 0.08
_LOGARITHMIC = ("log", "LogNorm")
_LINEAR = (None, "linear", "Normalize")

Span = tuple[float, float]


def scales_of(
    image: Image,
    options: dict[str, Any],
    told: dict[str, Any] | None = None,
    fields: FieldValues | None = None,
) -> list[Scale]:
    """Return the scale of the one channel that is shown, or else those of the medium.

    Parameters
    ----------
    image : Image
    options : dict
        Of `Image.to_rgb`.
    told : dict, optional
        ``medium.describe()``; by default from the image's provenance.
    fields : FieldValues, optional
        For ranges and units.
    """
    if shows_one_channel(image, options):
        return [of_intensity(image, options)]
    told = (image.provenance or {}).get("medium") if told is None else told
    if not isinstance(told, dict):
        return []
    scales = of_medium(told, options, None if fields is None else fields.span)
    units = field_units(image) if fields is None else fields.volume.units
    for scale in scales:
        scale.label = with_units(scale, units)
    return scales


def of_medium(told: dict[str, Any], options: dict[str, Any], spans: Any = None) -> list[Scale]:
    """Return the colour bars of a medium; none for one that is no function of a scalar.

    Parameters
    ----------
    told : dict
        ``medium.describe()``.
    options : dict
        How the picture is shown: which channel has which colour.
    spans : callable, optional
        ``spans(expr, unit)`` gives the range of an expression's values, or None.
    """
    parts = told.get("parts", [told])
    scales: list[Scale | None] = []
    for expr in dict.fromkeys(p["expr"] for p in parts if p.get("type") in _SHELLS):
        own = [p for p in parts if p.get("expr") == expr and p["type"] in _SHELLS]
        scales.append(_of_shells(expr, own, options, spans))
    for part in parts:
        if part.get("type") == "table" and "expr" in part and isinstance(part["colors"], list):
            scales.append(_of_table(part, options))
        if part.get("type") == "colormap":
            scales.append(_of_colormap(part, options))
        colors = part.get("color", part.get("colors"))
        if isinstance(colors, dict):
            scales.append(_of_colormap(colors, options))
    return list({s.label: s for s in scales if s is not None}.values())


def number(told: Any, expr: str = "") -> tuple[float, str]:
    """Return a number and its unit from what a medium says: 3.5, or ``"3.5 g / cm3"``.

    A value of what `expr` is the logarithm of becomes one of it.
    """
    if not isinstance(told, str):
        return float(told), ""
    value, _, unit = told.partition(" ")
    if unit and "dex" not in unit and _is_logarithm(expr):
        return float(np.log10(float(value))), f"dex({unit})"
    return float(value), unit


def _is_logarithm(expr: str) -> bool:
    return bool(expr) and getattr(Expression(expr).tree, "operation", "") == "log10"


def _of_shells(expr: str, parts: Any, options: dict[str, Any], spans: Any) -> Scale:
    """Return a bar with the shells of one expression at their places, in their colours."""
    from matplotlib.colors import ListedColormap

    shells = [shell for part in parts for shell in _shells(part)]
    unit = shells[0][3]
    centers, widths = (
        np.array([_converted(*pair, unit) for pair in pairs])
        for pairs in (
            [(c, u) for c, _, _, u, _ in shells],
            [(w, u) for _, w, _, _, u in shells],
        )
    )
    span = None if spans is None else spans(expr, unit)
    norm = _norm(centers, widths, span)
    colors = _shown_colors([color for _, _, color, _, _ in shells], options)
    bar = _bands(norm, centers, widths, colors)
    return Scale(labelled(expr, unit), norm, ListedColormap(bar), expr, unit)


def _shells(part: dict[str, Any]) -> Iterator[tuple[float, float, Any, str, str]]:
    """Give centre, half width, colour, and the units of both, of a shell or several surfaces."""
    place, extent, half = _SHELLS[part["type"]]
    width, width_unit = number(part[extent])
    width_unit = "" if "dex" in width_unit else width_unit  # a difference of logarithms
    several = isinstance(part[place], list)
    centers = part[place] if several else [part[place]]
    colors = part["color"]
    rows = colors if several and isinstance(colors, list) else [colors] * len(centers)
    for center, color in zip(centers, rows, strict=True):
        value, unit = number(center, part["expr"])
        yield value, half * width, color, unit, width_unit


def _converted(value: float, unit: str, target: str) -> float:
    if unit == target or not unit or not target:
        return value
    return float(parse_unit(unit).to(parse_unit(target), value))


def _shown_colors(colors: list[Any], options: dict[str, Any]) -> NDArray[Any]:
    rows = [np.atleast_1d(np.ones(3) if isinstance(c, dict) else c) for c in colors]
    return full_colors(np.array(rows, dtype=float), options)


def _norm(centers: NDArray[Any], widths: NDArray[Any], span: Span | None) -> Any:
    """Return a norm that shows all shells, and of the field's range what is not too far off."""
    spread = [centers.min(), centers.max()] if span is None else [*span, *centers]
    logarithmic = bool(min(spread) > 0 and max(spread) > _DECADES * min(spread))
    if logarithmic:
        low, high = centers.min() / 2, centers.max() * 2
    else:
        low = float((centers - _BESIDE * widths).min())
        high = float((centers + _BESIDE * widths).max())
        around = _AROUND * (high - low) or 0.5 * abs(low) or 1.0
        low, high = low - around, high + around
    if span is not None:
        low, high = _wider(low, high, span, logarithmic)
    return limits(low, high, logarithmic)


def _wider(low: float, high: float, span: Span, logarithmic: bool) -> Span:
    """Return a range with as much of the field's as leaves the shells a third of it at least."""
    if logarithmic:
        room = high / low
        return max(min(low, span[0]), low / room), min(max(high, span[1]), high * room)
    room = high - low
    return max(min(low, span[0]), low - room), min(max(high, span[1]), high + room)


def _bands(
    norm: Any, centers: NDArray[Any], widths: NDArray[Any], colors: NDArray[Any]
) -> NDArray[Any]:
    """Return colours and alpha along a bar: bands around the centres, the paper between them."""
    place = (np.arange(_ENTRIES) + 0.5) / _ENTRIES
    middle = np.asarray(norm(centers), dtype=float)
    half = np.maximum(np.abs(np.asarray(norm(centers + widths), dtype=float) - middle), _THIN)
    offset = (place[:, None] - middle) / half
    strength = np.exp(-0.5 * np.ma.filled(offset, np.inf) ** 2)
    total = strength.sum(axis=1, keepdims=True)
    mixed = strength @ colors / np.maximum(total, np.finfo(float).tiny)
    return np.concatenate([mixed, np.minimum(total, 1.0)], axis=1)


def _of_table(part: dict[str, Any], options: dict[str, Any]) -> Scale:
    from matplotlib.colors import ListedColormap

    values = np.array(part["values"], dtype=float)
    logarithmic = bool(values[0] > 0 and values[-1] > _DECADES**2 * values[0])
    norm = limits(values[0], values[-1], logarithmic)
    colors = table_colors(np.array(part["colors"], dtype=float), options)
    places = np.asarray(norm(values), dtype=float)
    grid = np.linspace(0.0, 1.0, _ENTRIES)
    bar = np.stack([np.interp(grid, places, channel) for channel in colors.T], axis=1)
    return Scale(part["expr"], norm, ListedColormap(bar), part["expr"])


def _of_colormap(part: dict[str, Any], options: dict[str, Any]) -> Scale | None:
    """Return a colormap over its range; None if its norm or its name tells too little."""
    from matplotlib.colors import ListedColormap

    colormap, name = colormap_of(part["cmap"]), part.get("norm")
    if colormap is None or name not in (*_LINEAR, *_LOGARITHMIC):
        return None
    (low, unit), (high, other) = (number(part[v], part["expr"]) for v in ("vmin", "vmax"))
    norm = limits(low, _converted(high, other, unit), name in _LOGARITHMIC)
    rows = colormap(np.linspace(0.0, 1.0, _ENTRIES))[:, :3]
    bar = ListedColormap(displayed(rows, options, 1.0))
    return Scale(labelled(part["expr"], unit), norm, bar, part["expr"], unit)
