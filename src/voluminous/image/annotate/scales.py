"""Colour bars: the colours of a medium, or of the intensities, over a range of values."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...errors import UnknownNameError
from ...expressions import Expression
from ...units import parse_unit
from ..lengths import labelled, pretty_unit
from ..tone import display, one_channel, shows_one_channel
from .sheet import LINE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Colormap, Normalize

    from ...volume import Volume
    from ..image import Image
    from .sheet import Sheet


# Display options that set the colour of each channel.
_COLORS = ("channels", "mix")
# Far beyond white: full brightness with the hue unchanged.
_BRIGHT = 1e6


@dataclass
class Scale:
    """A colour bar.

    Attributes
    ----------
    label : str
        Name of the quantity, with its unit.
    norm : matplotlib.colors.Normalize
        Maps values to positions along the bar, 0 to 1.
    colormap : matplotlib.colors.Colormap
        Maps positions to colours.
    expr : str or None
        Expression whose histogram is drawn beside the bar; None for the picture's intensities.
    unit : str
        Unit of the values.
    """

    label: str
    norm: Normalize
    colormap: Colormap
    expr: str | None = None
    unit: str = ""

    @property
    def mappable(self) -> Any:
        """Return the mappable for matplotlib's ``figure.colorbar``."""
        from matplotlib.cm import ScalarMappable

        return ScalarMappable(norm=self.norm, cmap=self.colormap)


def of_intensity(image: Image, options: dict[str, Any]) -> Scale:
    """Return the colour bar of a picture that shows one channel."""
    shown = one_channel(image, **options)
    label = labelled(quantity_name(image), pretty_unit(image.intensity_unit))
    return Scale(label, shown["norm"], shown["cmap"], unit=image.intensity_unit)


def quantity_name(image: Image) -> str:
    """Return the label of the values: kind and quantity of a map, else "intensity"."""
    how = image.provenance or {}
    quantity = how.get("quantity")
    if not isinstance(quantity, str):
        return "intensity"
    kind = how.get("map", how.get("kind"))
    if kind is None:
        kind = "mean" if "weight" in how else "column"
    says = str(kind).endswith(f" of {quantity}")
    return str(kind) if says else f"{kind}, {quantity}"


def field_units(image: Image) -> dict[str, str]:
    """Return the units of the fields in the picture's provenance; some may be missing."""
    told = ((image.provenance or {}).get("volume") or {}).get("fields", {})
    return {name: str(field.get("unit", "")) for name, field in told.items()}


def with_units(scale: Scale, units: Mapping[str, str]) -> str:
    """Return the label of an expression whose values are in the units of its fields.

    Examples
    --------
    >>> with_units(Scale("log10(density)", None, None, "log10(density)"), {"density": "g / cm3"})
    'log10(density), density in g cm⁻³'
    """
    if scale.unit or scale.expr is None:
        return scale.label
    if scale.expr in units:
        return labelled(scale.label, pretty_unit(units[scale.expr]))
    names = [name for name in Expression(scale.expr).names if units.get(name)]
    return ", ".join([scale.label, *(f"{name} in {pretty_unit(units[name])}" for name in names)])


def limits(low: float, high: float, logarithmic: bool) -> Normalize:
    """Return a norm over a range."""
    from matplotlib.colors import LogNorm, Normalize

    return LogNorm(low, high) if logarithmic else Normalize(low, high)


def table_colors(rows: NDArray[Any], options: dict[str, Any]) -> NDArray[Any]:
    """Return display colours of a colour table, exposed so that its brightest entry is white."""
    most = float(np.abs(rows).max()) or 1.0
    return displayed(rows / most, options, 1.0)


def full_colors(rows: NDArray[Any], options: dict[str, Any]) -> NDArray[Any]:
    """Return display colours, each at full brightness: only the hue distinguishes them."""
    most = np.abs(rows).max(axis=1, keepdims=True)
    return displayed(rows / np.where(most > 0, most, 1.0), options, _BRIGHT)


def displayed(rows: NDArray[Any], options: dict[str, Any], exposure: float) -> NDArray[Any]:
    """Return the display colours of n rows of channel intensities, shape (n, 3)."""
    chosen = {name: options[name] for name in _COLORS if options.get(name) is not None}
    seen: NDArray[Any] = display(np.asarray(rows, float)[None], exposure=exposure, **chosen)[0]
    return seen


def colormap_of(name: Any) -> Any:
    """Return a colormap by its name; None if this version of matplotlib lacks it."""
    from ...colormaps import get_colormap

    try:
        return get_colormap(name)
    except UnknownNameError:
        return None


# Kind of shell → key of its centre, key of its width, half width in units of that width.
_SHELLS = {
    "gaussian": ("center", "sigma", 1.0),
    "rectangle": ("center", "half_width", 1.0),
    "isosurface": ("level", "width", 0.5),
}
_ENTRIES = 512
# Minimum half width of a shell, as a fraction of the bar.
_THIN = 0.006
# Values that span more than this factor get a logarithmic scale.
_DECADES = 30.0
# Margins of a bar: widths beside each shell, and a fraction of the bar beside all shells.
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
    """Return the colour bar of the single channel shown, or else those of the medium.

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
    """Return the colour bars of a medium; none unless it is a function of a scalar.

    Parameters
    ----------
    told : dict
        ``medium.describe()``.
    options : dict
        Display options of `Image.to_rgb`; they set the colour of each channel.
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
    """Return a number and its unit from a medium's description: 3.5, or ``"3.5 g / cm3"``.

    If `expr` is a logarithm, a value of its argument is converted to its logarithm.
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
    """Return a bar with the shells of one expression at their centres, in their colours."""
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
    return Scale(labelled(expr, pretty_unit(unit)), norm, ListedColormap(bar), expr, unit)


def _shells(part: dict[str, Any]) -> Iterator[tuple[float, float, Any, str, str]]:
    """Yield centre, half width, colour, and units of centre and width, for each shell."""
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


def _norm(centers: NDArray[Any], widths: NDArray[Any], span: Span | None) -> Normalize:
    """Return a norm that covers all shells and the nearby part of the field's range."""
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
    """Extend the shells' range by the field's, so that the shells fill at least a third of it."""
    if logarithmic:
        room = high / low
        return max(min(low, span[0]), low / room), min(max(high, span[1]), high * room)
    room = high - low
    return max(min(low, span[0]), low - room), min(max(high, span[1]), high + room)


def _bands(
    norm: Normalize, centers: NDArray[Any], widths: NDArray[Any], colors: NDArray[Any]
) -> NDArray[Any]:
    """Return RGBA along a bar: bands around the centres, transparent between them."""
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
    """Return a colormap over its range; None if its norm or its name is unknown."""
    from matplotlib.colors import ListedColormap

    colormap, name = colormap_of(part["cmap"]), part.get("norm")
    if colormap is None or name not in (*_LINEAR, *_LOGARITHMIC):
        return None
    (low, unit), (high, other) = (number(part[v], part["expr"]) for v in ("vmin", "vmax"))
    norm = limits(low, _converted(high, other, unit), name in _LOGARITHMIC)
    rows = colormap(np.linspace(0.0, 1.0, _ENTRIES))[:, :3]
    bar = ListedColormap(displayed(rows, options, 1.0))
    return Scale(labelled(part["expr"], pretty_unit(unit)), norm, bar, part["expr"], unit)


_GAP, _BAR, _COUNTS = 1.0, 1.1, 2.8


def draw_color_bar(sheet: Sheet, scale: Scale, counts: Any, start: float) -> float:
    """Draw a bar of the picture's height; return the position of its right end in pixels.

    Parameters
    ----------
    sheet : Sheet
    scale : Scale
    counts : array or None
        Histogram; see `counts`.
    start : float
        Right end of the annotations to its left, in pixels.
    """
    x = start + _GAP * sheet.em
    if counts is not None:
        _draw_counts(sheet, counts, x)
        x += _COUNTS * sheet.em
    axes = sheet.axes(x, 0.0, _BAR * sheet.em, float(sheet.height), gid="color-bar")
    _draw_colors(sheet, axes, scale)
    return sheet.end(axes)


def _draw_counts(sheet: Sheet, counts: Any, x: float) -> None:
    axes = sheet.axes(x, 0.0, _COUNTS * sheet.em, float(sheet.height), gid="histogram")
    edges = np.linspace(0.0, 1.0, len(counts) + 1)
    axes.stairs(counts, edges, orientation="horizontal", fill=True, color=sheet.ink, alpha=0.45)
    axes.set(xlim=(1.05, 0.0), ylim=(0.0, 1.0))
    axes.set_axis_off()


def _draw_colors(sheet: Sheet, axes: Axes, scale: Scale) -> None:
    bar = sheet.figure.colorbar(scale.mappable, cax=axes)
    bar.outline.set(linewidth=LINE * sheet.em, edgecolor=sheet.ink)
    axes.tick_params(which="both", colors=sheet.ink, labelsize=0.85 * sheet.em)
    axes.tick_params(which="both", width=LINE * sheet.em, pad=0.25 * sheet.em)
    axes.tick_params(which="major", length=0.35 * sheet.em)
    axes.tick_params(which="minor", length=0.2 * sheet.em)
    offset = axes.yaxis.get_offset_text()
    offset.set(fontsize=0.85 * sheet.em, color=sheet.ink, ha="left")
    label = bar.ax.set_ylabel(
        scale.label, fontsize=sheet.em, color=sheet.ink, labelpad=0.5 * sheet.em
    )
    long = label.get_window_extent(sheet.canvas.get_renderer()).height
    if long > sheet.height:
        label.set_fontsize(sheet.em * sheet.height / long)


# A histogram samples at most _CELLS cells, in _PIECES evenly spaced pieces.
_CELLS, _PIECES = 1 << 20, 128
_BINS = 60
# Percentiles that limit the range: single outliers must not set it.
_LEAST, _GREATEST = 0.1, 99.9


class FieldValues:
    """Values of expressions in a volume, or in a representative sample of its cells."""

    def __init__(self, volume: Volume) -> None:
        self.volume = volume
        self._found: dict[str, NDArray[Any]] = {}

    def values(self, text: str, unit: str) -> NDArray[Any]:
        """Return finite values in a unit; in the fields' units if `unit` is empty."""
        if text not in self._found:
            self._found[text] = self._sampled(Expression(text))
        own, wanted = self.volume.expression_unit(Expression(text)), parse_unit(unit)
        same = own is None or wanted is None
        found = self._found[text]
        return found if same else np.asarray(own.to(wanted, found))  # dex are shifted, not scaled

    def span(self, text: str, unit: str) -> tuple[float, float] | None:
        """Return the 0.1 % and 99.9 % percentiles of the values; None if there are no values."""
        values = self.values(text, unit)
        if values.size == 0:
            return None
        low, high = np.percentile(values, (_LEAST, _GREATEST))
        return float(low), float(high)

    def _sampled(self, expression: Expression) -> NDArray[Any]:
        self.volume.check_names(expression)
        size = self.volume.grid.size
        count = _PIECES if size > _CELLS else 1
        length = min(size, _CELLS) // count
        starts = np.linspace(0, size - length, count).astype(int)
        found = [self.volume.evaluate_cells(expression, s, s + length) for s in starts.tolist()]
        values = np.concatenate(found).astype(float)
        return values[np.isfinite(values)]


def counts(scale: Scale, image: Image, fields: FieldValues | None, channel: int) -> Any:
    """Return counts in bins along a colour bar, from 0 to 1 on a logarithmic scale.

    Returns None without a volume.
    """
    if scale.expr is None:
        values = image.intensity[..., channel].ravel()
        values = values[np.isfinite(values)]
    elif fields is None:
        return None
    else:
        values = fields.values(scale.expr, scale.unit)
    places: NDArray[Any] = np.ma.filled(np.ma.asarray(scale.norm(values), dtype=float), np.nan)
    found, _ = np.histogram(places, _BINS, (0.0, 1.0))
    if not found.any():
        return None
    # Most cells fall into few bins, while the shells often lie in other bins.
    return np.log1p(found) / np.log1p(found.max())
