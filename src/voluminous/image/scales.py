"""Colour bars: the colours of a medium, or of the intensities, over a range of values."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..colormaps import get_colormap
from ..errors import UnknownNameError
from ..expressions import Expression
from ..units import parse_unit, pretty_unit
from .lengths import labelled
from .tone import display, one_channel, shows_one_channel

if TYPE_CHECKING:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Colormap, Normalize

    from ..volume import Volume
    from .image import Image

Span = tuple[float, float]
Spans = Callable[[str, str], "Span | None"]

# Far beyond white: full brightness with the hue unchanged.
_BRIGHT = 1e6
_ENTRIES = 512
# Minimum half width of a shell, as a fraction of the bar.
_THIN = 0.006
# Values that span more than this factor get a logarithmic scale.
_DECADES = 30.0
# Margins of a bar: widths beside each shell, and a fraction of the bar beside all shells.
_BESIDE, _AROUND = 3.0, 0.08
# Norms of colormaps that have a bar: whether they are logarithmic.
_NORMS = {None: False, "linear": False, "Normalize": False, "log": True, "LogNorm": True}
# A histogram samples at most _CELLS cells, in _RUNS evenly spaced runs.
_CELLS, _RUNS, _BINS = 1 << 20, 128, 60
# Percentiles that limit the range: single outliers must not set it.
_PERCENTILES = (0.1, 99.9)


@dataclass
class Scale:
    """A colour bar: values → positions (`norm`) → colours (`colormap`).

    `expr` is the expression whose histogram is drawn beside the bar, None for the picture's
    intensities; `unit` is that of the values.
    """

    label: str
    norm: Normalize
    colormap: Colormap
    expr: str | None = None
    unit: str = ""

    @property
    def mappable(self) -> ScalarMappable:
        """Return the mappable for matplotlib's ``figure.colorbar``."""
        from matplotlib.cm import ScalarMappable

        return ScalarMappable(norm=self.norm, cmap=self.colormap)


def scales_of(
    image: Image,
    options: dict[str, Any],
    colors: Sequence[dict[str, Any]] | None = None,
    fields: FieldValues | None = None,
) -> list[Scale]:
    """Return the colour bar of the single channel shown, or else those of the medium.

    `colors` are the bars of a medium's features, by default those in the image's provenance.
    """
    how = image.provenance or {}
    if shows_one_channel(image, options):
        shown = one_channel(image, **options)
        label = labelled(quantity_name(image), pretty_unit(image.intensity_unit))
        return [Scale(label, shown["norm"], shown["cmap"], unit=image.intensity_unit)]
    colors = how.get("color_bars", ()) if colors is None else colors
    if fields is None:
        known = (how.get("volume") or {}).get("fields", {})
        units: Mapping[str, str] = {n: str(field.get("unit", "")) for n, field in known.items()}
    else:
        units = fields.volume.units
    scales = of_medium(colors, options, None if fields is None else fields.span)
    for scale in scales:
        scale.label = _with_units(scale, units)
    return scales


def quantity_name(image: Image) -> str:
    """Return the label of the values: kind and quantity of a map, else "intensity"."""
    how = image.provenance or {}
    quantity = how.get("quantity")
    if not isinstance(quantity, str):
        return "intensity"
    kind = str(how.get("map", how.get("kind", "mean" if "weight" in how else "column")))
    return kind if kind.endswith(f" of {quantity}") else f"{kind}, {quantity}"


def _with_units(scale: Scale, units: Mapping[str, str]) -> str:
    """Return the label of an expression whose values are in the units of its fields.

    Examples
    --------
    >>> _with_units(Scale("log10(rho)", None, None, "log10(rho)"), {"rho": "g / cm3"})
    'log10(rho), rho in g cm⁻³'
    """
    if scale.unit or scale.expr is None:
        return scale.label
    if scale.expr in units:
        return labelled(scale.label, pretty_unit(units[scale.expr]))
    names = [name for name in Expression(scale.expr).names if units.get(name)]
    return ", ".join([scale.label, *(f"{name} in {pretty_unit(units[name])}" for name in names)])


def of_medium(
    colors: Sequence[dict[str, Any]], options: dict[str, Any], spans: Spans | None = None
) -> list[Scale]:
    """Return the colour bars of a medium, from the bars of its features: shells first.

    ``spans(expr, unit)`` gives the range of an expression's values, or None.
    """
    shells: dict[str, list[dict[str, Any]]] = {}
    for bar in colors:
        if "half_width" in bar:
            shells.setdefault(bar["expr"], []).append(bar)
    scales: list[Scale | None] = [
        _of_shells(expr, bars, options, spans) for expr, bars in shells.items()
    ]
    scales += [
        (_of_colormap if "cmap" in bar else _of_table)(bar, options)
        for bar in colors
        if "half_width" not in bar
    ]
    return list({scale.label: scale for scale in scales if scale is not None}.values())


def _number(given: float | str, expr: str = "") -> tuple[float, str]:
    """Return a number and its unit from a medium's description: 3.5, or ``"3.5 g / cm3"``.

    If `expr` is a logarithm, a value of its argument is converted to its logarithm.
    """
    if not isinstance(given, str):
        return float(given), ""
    value, _, unit = given.partition(" ")
    is_log = bool(expr) and getattr(Expression(expr).tree, "operation", "") == "log10"
    if unit and "dex" not in unit and is_log:
        return float(np.log10(float(value))), f"dex({unit})"
    return float(value), unit


def _converted(value: float, unit: str, target: str) -> float:
    if unit == target or not unit or not target:
        return value
    return float(parse_unit(unit).to(parse_unit(target), value))


def _norm_of(low: float, high: float, logarithmic: bool) -> Normalize:
    from matplotlib.colors import LogNorm, Normalize

    return LogNorm(low, high) if logarithmic else Normalize(low, high)


def _displayed(rows: Any, options: dict[str, Any], exposure: float) -> np.ndarray:
    """Return the display colours of n rows of channel intensities, shape (n, 3)."""
    look = {"channels": options.get("channels"), "mix": options.get("mix"), "exposure": exposure}
    shown: np.ndarray = display(np.asarray(rows, float)[None], None, look)[0]
    return shown


def _of_shells(
    expr: str, bars: list[dict[str, Any]], options: dict[str, Any], spans: Spans | None
) -> Scale:
    from matplotlib.colors import ListedColormap

    shells: list[tuple[float, float, Any]] = []
    unit = None
    for bar in bars:
        width, width_unit = _number(bar["half_width"])
        width_unit = "" if "dex" in width_unit else width_unit  # a difference of logarithms
        for given, color in zip(bar["values"], bar["colors"], strict=True):
            center, given_unit = _number(given, expr)
            unit = given_unit if unit is None else unit
            half_width = _converted(width, width_unit, unit)
            shells.append((_converted(center, given_unit, unit), half_width, color))
    center, width = np.array([shell[:2] for shell in shells]).T
    # Each colour at full brightness: only the hue distinguishes them.
    rows = np.array([shell[2] for shell in shells], dtype=float)
    most = np.abs(rows).max(axis=1, keepdims=True)
    shown = _displayed(rows / np.where(most > 0, most, 1.0), options, _BRIGHT)
    norm = _shell_norm(center, width, None if spans is None else spans(expr, unit or ""))
    # Bands around the centres, transparent between them.
    along = (np.arange(_ENTRIES) + 0.5) / _ENTRIES
    middle = np.asarray(norm(center), dtype=float)
    reach = np.maximum(np.abs(np.asarray(norm(center + width), dtype=float) - middle), _THIN)
    offset = (along[:, None] - middle) / reach
    strength = np.exp(-0.5 * np.ma.filled(offset, np.inf) ** 2)
    total = strength.sum(axis=1, keepdims=True)
    mixed = strength @ shown / np.maximum(total, np.finfo(float).tiny)
    bands = ListedColormap(np.concatenate([mixed, np.minimum(total, 1.0)], axis=1))
    return Scale(labelled(expr, pretty_unit(unit or "")), norm, bands, expr, unit or "")


def _shell_norm(center: np.ndarray, width: np.ndarray, span: Span | None) -> Normalize:
    """Return a norm that covers all shells and the nearby part of the field's range.

    The shells fill at least a third of it.
    """
    values = [*center, *(span or ())]
    logarithmic = bool(min(values) > 0 and max(values) > _DECADES * min(values))
    if logarithmic:
        low, high = center.min() / 2, center.max() * 2
        lowest, highest = low * low / high, high * high / low
    else:
        low, high = (center - _BESIDE * width).min(), (center + _BESIDE * width).max()
        around = _AROUND * (high - low) or 0.5 * abs(low) or 1.0
        low, high = low - around, high + around
        lowest, highest = low - (high - low), high + (high - low)
    if span is not None:
        low, high = max(min(low, span[0]), lowest), min(max(high, span[1]), highest)
    return _norm_of(float(low), float(high), logarithmic)


def _of_table(bar: dict[str, Any], options: dict[str, Any]) -> Scale:
    from matplotlib.colors import ListedColormap

    expr, rows = bar["expr"], np.array(bar["colors"], dtype=float)
    numbers, units = zip(*(_number(value, expr) for value in bar["values"]), strict=True)
    values = np.array(numbers)
    logarithmic = bool(values[0] > 0 and values[-1] > _DECADES**2 * values[0])
    norm = _norm_of(values[0], values[-1], logarithmic)
    # Exposed so that the brightest entry is white.
    colors = _displayed(rows / (float(np.abs(rows).max()) or 1.0), options, 1.0)
    places, grid = np.asarray(norm(values), dtype=float), np.linspace(0.0, 1.0, _ENTRIES)
    table = np.stack([np.interp(grid, places, channel) for channel in colors.T], axis=1)
    label = labelled(expr, pretty_unit(units[0]))
    return Scale(label, norm, ListedColormap(table), expr, units[0])


def _of_colormap(bar: dict[str, Any], options: dict[str, Any]) -> Scale | None:
    """Return a colormap over its range; None if its norm, name or range is unknown."""
    from matplotlib.colors import ListedColormap

    try:
        colormap, logarithmic = get_colormap(bar["cmap"]), _NORMS[bar.get("norm")]
        (low, unit), (high, other) = (_number(bar[end], bar["expr"]) for end in ("vmin", "vmax"))
    except (KeyError, UnknownNameError):
        return None
    norm = _norm_of(low, _converted(high, other, unit), logarithmic)
    rows = colormap(np.linspace(0.0, 1.0, _ENTRIES))[:, :3]
    table = ListedColormap(_displayed(rows, options, 1.0))
    return Scale(labelled(bar["expr"], pretty_unit(unit)), norm, table, bar["expr"], unit)


class FieldValues:
    """Values of expressions in a volume, or in a representative sample of its cells."""

    def __init__(self, volume: Volume) -> None:
        self.volume = volume
        self._cached: dict[str, np.ndarray] = {}

    def values(self, text: str, unit: str) -> np.ndarray:
        """Return finite values in a unit; in the fields' units if `unit` is empty."""
        expression, volume = Expression(text), self.volume
        if text not in self._cached:
            volume.check_names(expression)
            size = volume.grid.size
            count = _RUNS if size > _CELLS else 1
            length = min(size, _CELLS) // count
            starts = np.linspace(0, size - length, count).astype(int).tolist()
            runs = [volume.evaluate_cells(expression, s, s + length) for s in starts]
            sample = np.concatenate(runs).astype(float)
            self._cached[text] = sample[np.isfinite(sample)]
        given, wanted = volume.expression_unit(expression), parse_unit(unit)
        if given is None or wanted is None:
            return self._cached[text]
        return np.asarray(given.to(wanted, self._cached[text]))  # dex are shifted, not scaled

    def span(self, text: str, unit: str) -> Span | None:
        """Return the 0.1 % and 99.9 % percentiles of the values; None if there are no values."""
        values = self.values(text, unit)
        if values.size == 0:
            return None
        low, high = np.percentile(values, _PERCENTILES)
        return float(low), float(high)


def counts(
    scale: Scale, image: Image, fields: FieldValues | None, channel: int
) -> np.ndarray | None:
    """Return counts in bins along a colour bar, from 0 to 1 on a logarithmic scale.

    Returns None for an expression without a volume, and if there is nothing to count.
    """
    if scale.expr is None:
        values = image.intensity[..., channel].ravel()
        values = values[np.isfinite(values)]
    elif fields is None:
        return None
    else:
        values = fields.values(scale.expr, scale.unit)
    places: np.ndarray = np.ma.filled(np.ma.asarray(scale.norm(values), dtype=float), np.nan)
    histogram, _ = np.histogram(places, _BINS, (0.0, 1.0))
    # Most cells fall into few bins, while the shells often lie in other bins.
    return np.log1p(histogram) / np.log1p(histogram.max()) if histogram.any() else None
