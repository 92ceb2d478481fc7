"""Transfer functions: j and α drawn over the values that a medium looks at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import InputError
from ..expressions import Expression
from ..figures import divided, new_figure
from ..image.lengths import pretty_unit
from ..media import Colormap, Isosurface, Medium, Table
from ..media.modulation import Modulation
from ..media.profiles import Shaped
from ..media.sum import with_each
from ..notebook import png
from ..units import is_quantity, parse_unit, plain, unit_name
from ..volume import Volume
from .at_values import coefficients, one_path_length, scalar_of, units_of
from .open_numbers import calibrate, check_volume
from .samples import pieces
from .thickness import is_constant, sampled_values

RGB = ("#d1342f", "#2c9c3f", "#2f62d1")
_POINTS, _BINS = 600, 120
# Positive values that differ by more than this factor are on a logarithmic axis.
_WIDE = 100.0
# A shell is drawn with so many widths on either side.
_AROUND = 3.5
# Where a medium is a function of several fields, so many cells are looked at, in so many bins.
_CELLS, _COARSE = 1 << 17, 60
# Of a swatch: rows and columns of a strip, and rows between two.
_STRIP, _GAP = (48, 360), 6


@dataclass
class _Panel:
    """Parts of a medium over one expression, or over one of the fields that they look at."""

    expr: Expression
    parts: list[Any]
    volume: Volume | None
    unit: Any = None
    values: Any = None
    low: float = 0.0
    high: float = 1.0
    log: bool = False

    def __post_init__(self) -> None:
        self.unit = self._own_unit()
        spans = [span for part in self.parts for span in _spans(part, self.unit)]
        if self.volume is not None:
            self.values = sampled_values(self.volume, self.expr)
            if len(self.values):
                first, last = self.values[[0, -1]]
                # No logarithmic axis is lost by the tail of a shell below all values.
                spans = [
                    (max(low, min(first, high)) if low <= 0 < first else low, high)
                    for low, high in spans
                ]
                spans.append((first, last))
        if not spans:
            raise InputError(f"{self.expr.text} has no finite value in this volume")
        self.low = float(min(low for low, _ in spans))
        self.high = float(max(high for _, high in spans))
        named = self.expr.text.startswith("log")
        self.log = not named and self.low > 0.0 and self.high > _WIDE * self.low
        if any(isinstance(part, Colormap) and part.range.positive for part in self.parts):
            known = () if self.values is None else self.values[self.values > 0]
            positive = [low for low, _ in spans if low > 0]
            self.low = min([*positive, *known[:1]], default=self.low)
            self.log = self.low > 0
        elif self.volume is None and any(isinstance(part, Isosurface) for part in self.parts):
            aside = 0.0 if self.log else 0.05 * (self.high - self.low)  # no line on the edge
            self.low, self.high = self.low - aside, self.high + aside
        if is_constant(self.low, self.high):
            aside = 0.5 * abs(self.low) or 1.0
            self.low, self.high = self.low - aside, self.high + aside

    def _own_unit(self) -> Any:
        if self.volume is not None:
            return self.volume.expression_unit(self.expr)
        told = (_unit_told(part) for part in self.parts)
        return next((unit for unit in told if unit is not None), None)

    def spread(self, count: int) -> np.ndarray:
        spaced = np.geomspace if self.log else np.linspace
        return np.asarray(spaced(self.low, self.high, count))

    @property
    def x(self) -> np.ndarray:
        """Values for smooth lines, and all at which a part has a corner or a jump."""
        found = [self.spread(_POINTS)]
        for part in self.parts:
            if isinstance(part, (Shaped, Table)):
                nodes, _ = part.profile(self.unit, lambda: (self.low, self.high))
                found += [nodes, np.nextafter(nodes, -np.inf), np.nextafter(nodes, np.inf)]
        x = np.unique(np.concatenate(found))
        return x[(x >= self.low) & (x <= self.high)]

    @property
    def label(self) -> str:
        return _labelled(self.expr.text, unit_name(self.unit))

    def unit_of(self, expr: Expression) -> Any:
        if expr == self.expr:
            return self.unit
        return None if self.volume is None else self.volume.expression_unit(expr)

    def lines(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        parts = [_ungated(p) for p in self.parts if not isinstance(p, Isosurface)]
        x = self.x
        unit = None if self.volume is None else self.volume.unit
        sums: list[Any] = [0.0, 0.0]
        for part in parts:
            found = coefficients(part, {self.expr.text: x}, unit, self.unit_of)
            sums = [total + np.atleast_2d(own) for total, own in zip(sums, found, strict=True)]
        return x, sums[0], sums[1]


def plot(medium: Medium, volume: Volume | None = None, ax: Any = None) -> Any:
    """Draw a medium; see `Medium.plot`."""
    if volume is None:
        medium = with_each(medium, one_path_length)
    else:
        check_volume("medium.plot", "first", volume)
        medium = calibrate(medium, volume)
    panels, several = _panels(medium, volume)
    count = len(panels) + len(several)
    if ax is None:
        figure = new_figure()
        figure.set_size_inches(7.0, 3.4 * count)
        axes = list(figure.subplots(count, 1, squeeze=False)[:, 0])
    else:
        axes = list(divided(ax, count, share=False))
    for panel, own in zip(panels, axes[: len(panels)], strict=True):
        _draw(own, panel, medium)
    for (part, name), own in zip(several, axes[len(panels) :], strict=True):
        assert volume is not None  # else `_panels` refuses
        _draw_means(own, part, name, volume)
    return axes[0] if count == 1 else np.array(axes, dtype=object)


def swatch(medium: Medium) -> bytes | None:
    """Return what one path length shows over the values, as a PNG file: a strip per expression.

    j in its colours, as high as it is bright, and α as a white line. None where that depends on
    a volume.
    """
    try:
        panels, _ = _panels(with_each(medium, _closed), None)
        strips = [_strip(panel) for panel in panels]
    except Exception:  # anybody's medium may raise anything
        return None
    gap = np.ones((_GAP, _STRIP[1], 3))
    rows = [part for strip in strips for part in (strip, gap)][:-1]
    return png(np.concatenate(rows[::-1]))


def swatch_title(medium: Medium) -> str:
    """Return over which values the strips of a swatch are."""
    panels, _ = _panels(with_each(medium, _closed), None)
    free = [scalar_of(part) for part in medium.components() if _is_open(part)]
    told = []
    for panel in panels:
        span = f"{panel.low:.4g} … {panel.high:.4g}{' (logarithmic)' * panel.log}"
        told.append(f"{panel.label}: {'as in a volume' if panel.expr in free else span}")
    return "; ".join(told)


def _strip(panel: _Panel) -> np.ndarray:
    ny, nx = _STRIP
    rows = np.arange(ny)[:, None]
    found = np.zeros((ny, nx, 3))
    edges = panel.spread(nx + 1)
    if any(not isinstance(part, Isosurface) for part in panel.parts):
        x, j, alpha = panel.lines()
        place = np.clip(np.digitize(x, edges) - 1, 0, nx - 1)
        columns = np.zeros((len(j) + 1, nx))
        for row, values in zip(columns, [*j, alpha.max(axis=0)], strict=True):
            np.maximum.at(row, place, np.nan_to_num(values))
        bright, dense = columns[:-1] if len(j) == 3 else columns[:-1].max(axis=0)[None], columns[-1]
        top = bright.max(axis=0)
        colors = (bright / np.where(top > 0, top, 1.0)).T * np.ones(3)
        found = np.where((rows < (ny - 1) * top / (top.max() or 1.0))[..., None], colors, found)
        line = np.rint((ny - 2) * dense / dense.max()) if dense.any() else np.full(nx, -9)
        found[abs(rows - line) <= 0] = 1.0
    for part in panel.parts:
        for level, color, opacity, width in _surfaces(part, panel.unit):
            aside = 0.5 * width + (edges[1:] - edges[:-1])
            near = (edges[1:] >= level - aside) & (edges[:-1] <= level + aside)
            shown = color if len(color) == 3 else (0.7, 0.7, 0.7)
            found[(rows < ny * opacity) & near] = np.clip(shown, 0.0, 1.0)
    return found


def _panels(medium: Medium, volume: Volume | None) -> tuple[list[_Panel], list[tuple[Medium, str]]]:
    """Return a panel for each expression; parts of several fields, with each of these."""
    groups: dict[str, list[Medium]] = {}
    several: list[tuple[Medium, str]] = []
    for part in medium.components():
        scalar = scalar_of(part)
        known = isinstance(part, (Shaped, Table, Isosurface))
        if scalar is not None and (known or (volume is not None and len(part.names) == 1)):
            groups.setdefault(scalar.text, []).append(part)
        elif volume is None:
            raise InputError(f"how {part!r} looks depends on a volume: medium.plot(volume)")
        elif not part.names:
            raise InputError(f"{part!r} looks at no field: it is the same everywhere")
        else:
            fields = [name for name in part.names if name not in volume.coordinates]
            several += [(part, name) for name in fields or part.names]
    return [_Panel(Expression(text), parts, volume) for text, parts in groups.items()], several


def _is_open(part: Any) -> bool:
    return isinstance(part, Colormap) and part.range.is_open


def _closed(part: Any) -> Any:
    """Return a part as one path length of it shows, over the places of an open colormap."""
    if _is_open(part):
        part = part.within(*((1.0, 10.0) if part.range.positive else (0.0, 1.0)), None)
    return one_path_length(part)


def _ungated(part: Any) -> Any:
    if not hasattr(part, "modulation") or part.modulation.fixed:
        return part
    return part.changed(modulation=Modulation(None, None, part.channels), names=part.expr.names)


def _unit_told(part: Any) -> Any:
    given: Any = part.levels[0] if isinstance(part, Isosurface) else getattr(part, "center", None)
    return parse_unit(given.unit) if is_quantity(given) else getattr(part, "unit", None)


def _spans(part: Any, unit: Any) -> list[tuple[float, float]]:
    if isinstance(part, Shaped):
        center, width = (float(plain(value, unit, "center")) for value in (part.center, part.width))
        aside = width * min(_AROUND, 1.2 * float(part.profile_places[-1]))
        return [(center - aside, center + aside)]
    if isinstance(part, Table):
        values = part.values if part.unit is None else plain(part.values * part.unit, unit, "x")
        return [(float(values[0]), float(values[-1]))]
    if isinstance(part, Isosurface):
        levels = [float(plain(level, unit, "level")) for level in part.levels]
        aside = float(plain(part.width, unit, "width")) or 0.05 * np.ptp(levels)
        return [(min(levels) - aside, max(levels) + aside)]
    return []


def _draw(axes: Any, panel: _Panel, medium: Medium) -> None:
    if panel.log:
        axes.set_xscale("log")
    axes.set_xlim(panel.low, panel.high)
    axes.set_xlabel(panel.label)
    axes.set_title("; ".join(_told(panel.parts)), fontsize="medium", loc="left")
    if panel.values is not None:
        _draw_cells(axes, panel)
    units = (None, None) if panel.volume is None else units_of(medium, panel.volume)
    if any(not isinstance(part, Isosurface) for part in panel.parts):
        names = ("emissivity j", "extinction α")
        if panel.volume is None:
            names = ("emission of one path length", "its optical depth α")
        x, j, alpha = panel.lines()
        painted = [p.modulation.color for p in panel.parts if _paint(p)]
        _draw_lines(axes, x, j, alpha, [*map(_labelled, names, map(unit_name, units))], painted)
    else:
        axes.set_ylabel("opacity of a crossing")
        axes.set_ylim(0.0, 1.0)
    for part in panel.parts:
        if isinstance(part, Isosurface):
            _draw_surfaces(axes, part, panel.unit)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(fontsize="small", framealpha=0.7)


def _draw_cells(axes: Any, panel: _Panel) -> None:
    """Draw the histogram behind, its counts on a logarithmic axis of its own."""
    known = panel.values[(panel.values >= panel.low) & (panel.values <= panel.high)]
    steps = np.unique(known)
    if 1 < len(steps) <= 2 * _BINS:  # a bar for each of few values, such as whole numbers
        middles = 0.5 * (steps[1:] + steps[:-1])
        places = np.concatenate([[panel.low], middles, [panel.high]])
    else:
        places = panel.spread(_BINS + 1)
    counts, edges = np.histogram(known, places)
    behind = axes.twinx()
    behind.stairs(counts, edges, baseline=0.5, fill=True, color="0.88")
    behind.set(yscale="log", ylim=(0.5, max(10.0, 1.5 * counts.max(initial=1.0))))
    behind.yaxis.set_visible(False)
    behind.set_zorder(axes.get_zorder() - 1)
    axes.patch.set_visible(False)
    axes.fill_between([], [], color="0.88", label="cells (logarithmic)")


def _draw_lines(
    axes: Any, x: Any, j: Any, alpha: Any, labels: Sequence[str], painted: Sequence[Any] = ()
) -> None:
    """Draw j per channel, the colours that they are together, and α on an axis to the right."""
    one = len(j) == 1 or (len(j) == 3 and np.all(j == j[0]))
    if len(j) == 3 and not painted:
        _fill(axes, x, j)
    if one:
        names = ["j"] if len(j) == 1 else ["j, all channels"]
        if painted:
            names = [f"j, times the color of {painted[0].expr.text}"]
        rows, colors = j[:1], ["0.45"]
    else:
        names = [f"j, {name}" for name in ("red", "green", "blue")]
        rows, colors = j, list(RGB)
        if len(j) != 3:
            names = [f"j, channel {k}" for k in range(len(j))]
            colors = [f"C{k % 10}" for k in range(len(j))]
    for k, (row, color, name) in enumerate(zip(rows, colors, names, strict=True)):
        axes.plot(x, row, color=color, lw=1.4, label=name if k < 8 else None)
    other = axes.twinx()
    for k, row in enumerate(alpha):
        color = "black" if len(alpha) == 1 else colors[k % len(colors)]
        other.plot(x, row, "--", color=color, lw=1.3)
    axes.plot([], [], "--", color="black", lw=1.3, label="α, to the right")
    for axis, label, values in ((axes, labels[0], j), (other, labels[1], alpha)):
        axis.set_ylabel(label)
        low, high = np.nanmin(values, initial=0.0), np.nanmax(values, initial=0.0)
        axis.set_ylim(1.06 * low, 1.06 * high if high > low else 1.0)


def _fill(axes: Any, x: np.ndarray, j: np.ndarray) -> None:
    top = j.max(axis=0)
    shown = np.clip(j / np.where(top > 0, top, 1.0), 0.0, 1.0).T
    good = np.isfinite(top) & (top > 0)
    if not good.any():
        return
    area = axes.fill_between(x, 0.0, np.where(good, top, 0.0), color="none", lw=0)
    paths = area.get_paths()
    mesh = axes.pcolormesh(
        x,
        [0.0, float(top[good].max())],
        np.stack([shown[:-1]]),
        shading="flat",
        alpha=0.8,
        rasterized=True,
    )
    if paths:
        mesh.set_clip_path(paths[0], axes.transData)


def _draw_surfaces(axes: Any, part: Isosurface, unit: Any) -> None:
    for x, color, opacity, width in _surfaces(part, unit):
        shown = tuple(np.clip(color, 0.0, 1.0)) if len(color) == 3 else "0.3"
        style = {"color": shown, "label": f"surface at {x:.4g}, opacity {opacity:.2g}"}
        if width:
            axes.axvspan(x - 0.5 * width, x + 0.5 * width, 0.0, opacity, lw=0, **style)
        else:
            axes.axvline(x, 0.0, opacity, lw=3, **style)


def _surfaces(part: Any, unit: Any) -> list[tuple[float, Any, float, float]]:
    """Return level, colour, opacity and width of each surface; nothing of other media."""
    if not isinstance(part, Isosurface):
        return []
    width = float(plain(part.width, unit, "width"))
    levels = [float(plain(level, unit, "level")) for level in part.levels]
    opacities = [max(row) for row in part.opacities]
    opacities = opacities * len(levels) if len(opacities) == 1 else opacities
    return [(*own, width) for own in zip(levels, part.colors, opacities, strict=True)]


def _draw_means(axes: Any, part: Medium, name: str, volume: Volume) -> None:
    """Draw the medians of j and α in bins of a field, for a medium that looks at others, too."""
    names = list(dict.fromkeys((*part.names, name)))
    step = max(1, volume.grid.size // _CELLS)
    streams = (pieces(volume, Expression(own)) for own in names)
    columns = [
        np.concatenate(own)
        for own in zip(
            *([piece.x.ravel()[::step] for piece in row] for row in zip(*streams, strict=True)),
            strict=True,
        )
    ]
    good = np.all(np.isfinite(columns), axis=0)
    fields = {own: values[good] for own, values in zip(names, columns, strict=True)}
    panel = _Panel(Expression(name), [], volume)
    j, alpha = coefficients(part, fields, volume.unit, volume.expression_unit)
    edges = panel.spread(_COARSE + 1)
    place = np.digitize(fields[name], edges[1:-1])
    rows = np.concatenate([j, np.atleast_2d(alpha)])
    there = [place == k for k in range(_COARSE)]
    x = np.array([np.median(fields[name][own]) for own in there if own.any()])
    middle = np.stack([np.median(rows[:, own], axis=1) for own in there if own.any()], axis=1)
    if panel.log:
        axes.set_xscale("log")
    axes.set_xlim(panel.low, panel.high)
    axes.set_xlabel(panel.label)
    others = ", ".join(own for own in names if own != name)
    axes.set_title(f"median of cells, which differ in {others}", fontsize="medium", loc="left")
    _draw_cells(axes, panel)
    units = (unit_name(u) for u in units_of(part, volume))
    labels = [*map(_labelled, ("emissivity j", "extinction α"), units)]
    _draw_lines(axes, x, middle[: part.channels], middle[part.channels :], labels)
    axes.legend(fontsize="small", framealpha=0.7)


def _paint(part: Any) -> Any:
    return getattr(getattr(part, "modulation", None), "color", None)


def _told(parts: list[Any]) -> list[str]:
    found: dict[str, None] = {}
    for part in parts:
        gate = getattr(getattr(part, "modulation", None), "where", None)
        if gate is not None:
            found[f"where {gate.text}"] = None
        if _paint(part):
            found[f"color by {_paint(part).expr.text}"] = None
    return list(found)


def _labelled(name: str, unit: str) -> str:
    return f"{name} [{pretty_unit(unit)}]" if unit else name
