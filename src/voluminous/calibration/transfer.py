"""Transfer functions: j and α drawn over the values of a medium's expressions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError
from ..expressions import Expression
from ..figures import divided, new_figure
from ..media import ColorBy, Medium
from ..media.details import Colors
from ..media.modulation import Modulation
from ..media.sum import with_each
from ..notebook import png
from ..units import Unit, plain, pretty_unit, unit_name
from ..volume import Volume
from .at_values import coefficients, is_surface, one_path_length, units_of
from .histogram import is_constant, sampled_values
from .open_numbers import calibrate, check_volume, closed, colors_of, scalar_of
from .samples import cell_runs, measurable

if TYPE_CHECKING:
    from matplotlib.axes import Axes

RGB = ("#d1342f", "#2c9c3f", "#2f62d1")
_POINTS, _BINS = 600, 120
# Positive values that differ by more than this factor are on a logarithmic axis.
_WIDE = 100.0
# A shell is drawn with so many widths on either side.
_AROUND = 3.5
# Cells and bins for a medium that is a function of several fields.
_CELLS, _COARSE = 1 << 17, 60
# Rows and columns of a strip of a swatch, and rows between two strips.
_STRIP, _GAP = (48, 360), 6


class _Panel:
    """The range of an expression in which some components of a medium are drawn."""

    def __init__(self, expr: Expression, components: list[Medium], volume: Volume | None) -> None:
        self.expr, self.components, self.volume = expr, components, volume
        shown = [(one, colors) for one in components if (colors := colors_of(one)) is not None]
        if volume is not None:
            self.unit: Unit = volume.expression_unit(expr)
        else:
            self.unit = next((c.unit for _, c in shown if c.unit is not None), None)
        self.values = np.empty(0) if volume is None else sampled_values(volume, expr)
        spans = [self._span(component, colors) for component, colors in shown]
        if len(self.values):
            first, last = self.values[[0, -1]]
            # The tail of a shell below all values must not prevent a logarithmic axis.
            spans = [(max(a, min(first, b)) if a <= 0 < first else a, b) for a, b in spans]
            spans.append((first, last))
        if not spans:
            raise InputError(f"{expr.text} has no finite value in this volume")
        low, high = (float(end) for end in (min(s[0] for s in spans), max(s[1] for s in spans)))
        self.log = not expr.text.startswith("log") and low > 0.0 and high > _WIDE * low
        if any(colors.positive for _, colors in shown):
            positive = [*(s[0] for s in spans if s[0] > 0), *self.values[self.values > 0][:1]]
            low = float(min(positive, default=low))
            self.log = low > 0
        elif volume is None and not self.log and any(map(is_surface, components)):
            aside = 0.05 * (high - low)  # no line on the edge
            low, high = low - aside, high + aside
        if is_constant(low, high):
            aside = 0.5 * abs(low) or 1.0
            low, high = low - aside, high + aside
        self.low, self.high = low, high

    def _span(self, component: Medium, colors: Colors) -> tuple[float, float]:
        values = colors.values_in(self.unit)
        low, high = float(values.min()), float(values.max())
        if colors.half_width is None:
            return low, high
        aside = float(plain(colors.half_width, self.unit, "width"))
        if is_surface(component):
            aside = 2.0 * aside or 0.05 * (high - low)
        else:
            profile = component.profile(self.unit, lambda: (low, high))
            end = float(profile[0][-1]) - high if profile else np.inf
            aside = min(_AROUND * aside, 1.2 * end)
        return low - aside, high + aside

    @property
    def surfaces(self) -> Iterator[tuple[float, Any, float, float]]:
        """Level, colour, opacity and width of each surface."""
        for component in filter(is_surface, self.components):
            colors: Any = colors_of(component)
            width = 2.0 * float(plain(colors.half_width, self.unit, "width"))
            levels = colors.values_in(self.unit).tolist()
            for level, row, opacity in zip(levels, colors.rows, colors.opacities, strict=True):
                yield level, np.clip(row, 0.0, 1.0) if len(row) == 3 else None, opacity, width

    @property
    def label(self) -> str:
        return _labelled(self.expr.text, self.unit)

    def spread(self, count: int) -> np.ndarray:
        spaced = np.geomspace if self.log else np.linspace
        return np.asarray(spaced(self.low, self.high, count))

    def unit_of(self, expr: Expression) -> Unit:
        if expr == self.expr:
            return self.unit
        return None if self.volume is None else self.volume.expression_unit(expr)

    def lines(self) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        """Return values, with all at which a component has a corner or a jump, j and α there.

        Gates and colours by other expressions are left out. None for surfaces alone.
        """
        components = [component for component in self.components if not is_surface(component)]
        if not components:
            return None
        places = [self.spread(_POINTS)]
        for component in components:
            profile = component.profile(self.unit, lambda: (self.low, self.high))
            if profile is not None:
                nodes, _ = profile
                places += [nodes, np.nextafter(nodes, -np.inf), np.nextafter(nodes, np.inf)]
        x = np.unique(np.concatenate(places))
        x = x[(x >= self.low) & (x <= self.high)]
        unit = None if self.volume is None else self.volume.unit
        j, alpha = np.zeros((1, 1)), np.zeros((1, 1))
        for component in components:
            if component.modulation is not None and not component.modulation.fixed:
                none = Modulation(None, None, component.channels)
                component = component.changed(modulation=none, names=self.expr.names)
            more = coefficients(component, {self.expr.text: x}, unit, self.unit_of)
            j, alpha = j + more[0], alpha + more[1]
        return x, j, alpha

    def draw(self, axes: Axes, medium: Medium) -> None:
        modulations = [c.modulation for c in self.components if c.modulation]
        gates = {f"where {one.where.text}": None for one in modulations if one.where}
        paints = [one.color for one in modulations if one.color]
        titles = (*gates, *dict.fromkeys(f"color by {paint.expr.text}" for paint in paints))
        self.draw_axis(axes, "; ".join(titles))
        names, units = ("emission of one path length", "its optical depth α"), (None, None)
        if self.volume is not None:
            names, units = ("emissivity j", "extinction α"), units_of(medium, self.volume)
        lines = self.lines()
        if lines is None:
            axes.set_ylabel("opacity of a crossing")
            axes.set_ylim(0.0, 1.0)
        else:
            _draw_lines(axes, *lines, [*map(_labelled, names, units)], paints)
        for x, color, opacity, width in self.surfaces:
            style = {"color": "0.3" if color is None else tuple(color)}
            style["label"] = f"surface at {x:.4g}, opacity {opacity:.2g}"
            if width:
                axes.axvspan(x - 0.5 * width, x + 0.5 * width, 0.0, opacity, lw=0, **style)
            else:
                axes.axvline(x, 0.0, opacity, lw=3, **style)
        if axes.get_legend_handles_labels()[0]:
            axes.legend(fontsize="small", framealpha=0.7)

    def draw_axis(self, axes: Axes, title: str) -> None:
        """Draw title, axis, and behind it a histogram with counts on a logarithmic axis."""
        if self.log:
            axes.set_xscale("log")
        axes.set_xlim(self.low, self.high)
        axes.set_xlabel(self.label)
        axes.set_title(title, fontsize="medium", loc="left")
        if self.volume is None:
            return
        values = self.values[(self.values >= self.low) & (self.values <= self.high)]
        steps = np.unique(values)
        edges = self.spread(_BINS + 1)
        if 1 < len(steps) <= 2 * _BINS:  # a bar for each of few values, such as whole numbers
            edges = np.concatenate([[self.low], 0.5 * (steps[1:] + steps[:-1]), [self.high]])
        counts, edges = np.histogram(values, edges)
        behind = axes.twinx()
        behind.stairs(counts, edges, baseline=0.5, fill=True, color="0.88")
        behind.set(yscale="log", ylim=(0.5, max(10.0, 1.5 * counts.max(initial=1.0))))
        behind.yaxis.set_visible(False)
        behind.set_zorder(axes.get_zorder() - 1)
        axes.patch.set_visible(False)
        axes.fill_between([], [], color="0.88", label="cells (logarithmic)")


def plot(medium: Medium, volume: Volume | None = None, ax: Any = None) -> Any:
    """Draw a medium; see `Medium.plot`."""
    if volume is None:
        medium = with_each(medium, one_path_length)
    else:
        check_volume("medium.plot", "first", volume)
        medium, volume = calibrate(medium, volume), measurable(volume)
    panels, several = _panels(medium, volume)
    count = len(panels) + len(several)
    if ax is None:
        figure = new_figure()
        figure.set_size_inches(7.0, 3.4 * count)
        axes = list(figure.subplots(count, 1, squeeze=False)[:, 0])
    else:
        axes = list(divided(ax, count, share=False))
    for panel, place in zip(panels, axes, strict=False):
        panel.draw(place, medium)
    for (component, name), place in zip(several, axes[len(panels) :], strict=True):
        assert volume is not None  # else `_panels` refuses
        _draw_medians(place, component, name, volume)
    return axes[0] if count == 1 else np.array(axes, dtype=object)


def swatch(medium: Medium) -> bytes | None:
    """Return the effect of one path length over the values, as a PNG file: a strip per expression.

    j in its colours, as high as it is bright, and α as a white line. None where that depends on
    a volume.
    """
    try:
        panels, _ = _panels(with_each(medium, _closed), None)
        strips = [_strip(panel) for panel in panels]
    except Exception:  # anybody's medium may raise anything
        return None
    gap = np.ones((_GAP, _STRIP[1], 3))
    rows = [row for strip in strips for row in (strip, gap)][:-1]
    return png(np.concatenate(rows[::-1]))


def swatch_title(medium: Medium) -> str:
    """Return the expressions and ranges of the strips of a swatch."""
    panels, _ = _panels(with_each(medium, _closed), None)
    is_open = {
        scalar_of(component)
        for component in medium.components()
        if (colors := colors_of(component)) and colors.is_open
    }
    titles = []
    for panel in panels:
        span = f"{panel.low:.4g} … {panel.high:.4g}{' (logarithmic)' * panel.log}"
        titles.append(f"{panel.label}: {'as in a volume' if panel.expr in is_open else span}")
    return "; ".join(titles)


def _strip(panel: _Panel) -> np.ndarray:
    ny, nx = _STRIP
    rows = np.arange(ny)[:, None]
    strip = np.zeros((ny, nx, 3))
    edges = panel.spread(nx + 1)
    lines = panel.lines()
    if lines is not None:
        x, j, alpha = lines
        place = np.clip(np.digitize(x, edges) - 1, 0, nx - 1)
        columns = np.zeros((len(j) + 1, nx))
        for row, values in zip(columns, [*j, alpha.max(axis=0)], strict=True):
            np.maximum.at(row, place, np.nan_to_num(values))
        bright, dense = columns[:-1] if len(j) == 3 else columns[:-1].max(axis=0)[None], columns[-1]
        top = bright.max(axis=0)
        colors = (bright / np.where(top > 0, top, 1.0)).T * np.ones(3)
        strip = np.where((rows < (ny - 1) * top / (top.max() or 1.0))[..., None], colors, strip)
        line = np.rint((ny - 2) * dense / dense.max()) if dense.any() else np.full(nx, -9)
        strip[rows == line] = 1.0
    for level, color, opacity, width in panel.surfaces:
        aside = 0.5 * width + (edges[1:] - edges[:-1])
        near = (edges[1:] >= level - aside) & (edges[:-1] <= level + aside)
        strip[(rows < ny * opacity) & near] = 0.7 if color is None else color
    return strip


def _panels(medium: Medium, volume: Volume | None) -> tuple[list[_Panel], list[tuple[Medium, str]]]:
    """Return a panel for each expression; components of several fields, with each of these."""
    groups: dict[str, list[Medium]] = {}
    several: list[tuple[Medium, str]] = []
    for component in medium.components():
        scalar, names = scalar_of(component), component.names
        if scalar is not None and (
            colors_of(component) is not None or (volume is not None and len(names) == 1)
        ):
            groups.setdefault(scalar.text, []).append(component)
        elif volume is None:
            raise InputError(f"how {component!r} looks depends on a volume: medium.plot(volume)")
        elif not names:
            raise InputError(f"{component!r} looks at no field: it is the same everywhere")
        else:
            fields = [name for name in names if name not in volume.coordinates]
            several += [(component, name) for name in fields or names]
    panels = [_Panel(Expression(text), group, volume) for text, group in groups.items()]
    return panels, several


def _closed(component: Medium) -> Medium:
    for colors in [f.colors for f in component.features() if f.colors and f.colors.is_open]:
        low, high = (1.0, 10.0) if colors.positive else (0.0, 1.0)
        component = closed(component, colors, low, high, None)
    return one_path_length(component)


def _draw_lines(
    axes: Axes,
    x: np.ndarray,
    j: np.ndarray,
    alpha: np.ndarray,
    labels: Sequence[str],
    paints: Sequence[ColorBy] = (),
) -> None:
    """Draw j per channel, the colours that they are together, and α on an axis to the right."""
    count = len(j)
    if count == 3 and not paints:
        _fill(axes, x, j)
    colors: Sequence[str] = RGB if count == 3 else [f"C{k % 10}" for k in range(count)]
    names = [f"j, {c}" for c in ("red", "green", "blue")]
    names = names if count == 3 else [f"j, channel {k}" for k in range(count)]
    rows = j
    if count == 1 or (count == 3 and np.all(j == j[0])):
        rows, colors, names = j[:1], ["0.45"], ["j" if count == 1 else "j, all channels"]
        if paints:
            names = [f"j, times the color of {paints[0].expr.text}"]
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


def _fill(axes: Axes, x: np.ndarray, j: np.ndarray) -> None:
    top = j.max(axis=0)
    good = np.isfinite(top) & (top > 0)
    if not good.any():
        return
    colors = np.clip(j / np.where(top > 0, top, 1.0), 0.0, 1.0).T
    area = axes.fill_between(x, 0.0, np.where(good, top, 0.0), color="none", lw=0)
    height, row = float(top[good].max()), colors[None, :-1]
    mesh = axes.pcolormesh(x, [0.0, height], row, shading="flat", alpha=0.8, rasterized=True)
    if area.get_paths():
        mesh.set_clip_path(area.get_paths()[0], axes.transData)


def _draw_medians(axes: Axes, component: Medium, name: str, volume: Volume) -> None:
    """Draw medians of j and α in bins of a field, for a medium that depends on others, too."""
    names = list(dict.fromkeys((*component.names, name)))
    step = max(1, volume.grid.size // _CELLS)
    columns = [
        np.concatenate([cells.x.ravel()[::step] for cells in cell_runs(volume, Expression(one))])
        for one in names
    ]
    table = np.array(columns)
    fields = dict(zip(names, table[:, np.all(np.isfinite(table), axis=0)], strict=True))
    panel = _Panel(Expression(name), [], volume)
    j, alpha = coefficients(component, fields, volume.unit, volume.expression_unit)
    rows = np.concatenate([fields[name][None], j, np.atleast_2d(alpha)])
    place = np.digitize(fields[name], panel.spread(_COARSE + 1)[1:-1])
    bins = [rows[:, place == k] for k in range(_COARSE)]
    medians = np.stack([np.median(values, axis=1) for values in bins if values.size], axis=1)
    others = ", ".join(other for other in names if other != name)
    panel.draw_axis(axes, f"median of cells, which differ in {others}")
    labels = [*map(_labelled, ("emissivity j", "extinction α"), units_of(component, volume))]
    split = component.channels + 1
    _draw_lines(axes, medians[0], medians[1:split], medians[split:], labels)
    axes.legend(fontsize="small", framealpha=0.7)


def _labelled(name: str, unit: Unit) -> str:
    text = unit_name(unit)
    return f"{name} [{pretty_unit(text)}]" if text else name
