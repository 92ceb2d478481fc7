"""Transfer functions: j and α drawn over the values of a medium's expressions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError
from ..expressions import Expression
from ..figures import divided, new_figure
from ..image.lengths import pretty_unit
from ..media import ColorBy, Colormap, Isosurface, Medium, Table
from ..media.modulation import Modulation
from ..media.profiles import Shaped
from ..media.sum import with_each
from ..notebook import png
from ..units import Unit, is_quantity, parse_unit, plain, unit_name
from ..volume import Volume
from .at_values import coefficients, one_path_length, scalar_of, units_of
from .histogram import is_constant, sampled_values
from .open_numbers import calibrate, check_volume
from .samples import measurable, pieces

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
    """The range of an expression in which some parts of a medium are drawn."""

    def __init__(self, expr: Expression, parts: list[Medium], volume: Volume | None) -> None:
        self.expr, self.parts, self.volume = expr, parts, volume
        if volume is not None:
            self.unit: Unit = volume.expression_unit(expr)
        else:
            units = (_unit_of(part) for part in parts)
            self.unit = next((unit for unit in units if unit is not None), None)
        self.values = np.empty(0) if volume is None else sampled_values(volume, expr)
        spans = [span for part in parts for span in _spans(part, self.unit)]
        if len(self.values):
            first, last = self.values[[0, -1]]
            # The tail of a shell below all values must not prevent a logarithmic axis.
            spans = [(max(a, min(first, b)) if a <= 0 < first else a, b) for a, b in spans]
            spans.append((first, last))
        if not spans:
            raise InputError(f"{expr.text} has no finite value in this volume")
        low, high = (float(end) for end in (min(s[0] for s in spans), max(s[1] for s in spans)))
        self.log = not expr.text.startswith("log") and low > 0.0 and high > _WIDE * low
        if any(isinstance(part, Colormap) and part.range.positive for part in parts):
            positive = [*(s[0] for s in spans if s[0] > 0), *self.values[self.values > 0][:1]]
            low = float(min(positive, default=low))
            self.log = low > 0
        elif volume is None and not self.log and any(isinstance(p, Isosurface) for p in parts):
            aside = 0.05 * (high - low)  # no line on the edge
            low, high = low - aside, high + aside
        if is_constant(low, high):
            aside = 0.5 * abs(low) or 1.0
            low, high = low - aside, high + aside
        self.low, self.high = low, high

    @property
    def surfaces(self) -> Iterator[tuple[float, Any, float, float]]:
        """Level, colour, opacity and width of each surface."""
        for part in self.parts:
            if isinstance(part, Isosurface):
                width = float(plain(part.width, self.unit, "width"))
                rows = zip(part.levels, part.colors, part.opacities, strict=True)
                for level, color, opacity in rows:
                    shown = np.clip(color, 0.0, 1.0) if len(color) == 3 else None
                    yield float(plain(level, self.unit, "level")), shown, max(opacity), width

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
        """Return values, with all at which a part has a corner or a jump, j and α there.

        Gates and colours by other expressions are left out. None for surfaces alone.
        """
        parts = [part for part in self.parts if not isinstance(part, Isosurface)]
        if not parts:
            return None
        places = [self.spread(_POINTS)]
        for part in parts:
            if isinstance(part, (Shaped, Table)):
                nodes, _ = part.profile(self.unit, lambda: (self.low, self.high))
                places += [nodes, np.nextafter(nodes, -np.inf), np.nextafter(nodes, np.inf)]
        x = np.unique(np.concatenate(places))
        x = x[(x >= self.low) & (x <= self.high)]
        unit = None if self.volume is None else self.volume.unit
        j, alpha = np.zeros((1, 1)), np.zeros((1, 1))
        for part in parts:
            if isinstance(part, (Shaped, Table)) and not part.modulation.fixed:
                none = Modulation(None, None, part.channels)
                part = part.changed(modulation=none, names=part.expr.names)
            own = coefficients(part, {self.expr.text: x}, unit, self.unit_of)
            j, alpha = j + own[0], alpha + own[1]
        return x, j, alpha

    def draw(self, axes: Axes, medium: Medium) -> None:
        gates = {
            f"where {part.modulation.where.text}": None
            for part in self.parts
            if part.modulation and part.modulation.where
        }
        paints = [paint for part in self.parts if (paint := _paint(part))]
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
    for panel, own in zip(panels, axes, strict=False):
        panel.draw(own, medium)
    for (part, name), own in zip(several, axes[len(panels) :], strict=True):
        assert volume is not None  # else `_panels` refuses
        _draw_medians(own, part, name, volume)
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
    rows = [part for strip in strips for part in (strip, gap)][:-1]
    return png(np.concatenate(rows[::-1]))


def swatch_title(medium: Medium) -> str:
    """Return the expressions and ranges of the strips of a swatch."""
    panels, _ = _panels(with_each(medium, _closed), None)
    titles = []
    for panel in panels:
        span = f"{panel.low:.4g} … {panel.high:.4g}{' (logarithmic)' * panel.log}"
        is_open = any(
            isinstance(part, Colormap) and part.range.is_open and part.expr == panel.expr
            for part in medium.components()
        )
        titles.append(f"{panel.label}: {'as in a volume' if is_open else span}")
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


def _closed(part: Medium) -> Medium:
    if isinstance(part, Colormap) and part.range.is_open:
        part = part.within(*((1.0, 10.0) if part.range.positive else (0.0, 1.0)), None)
    return one_path_length(part)


def _unit_of(part: Medium) -> Unit:
    if isinstance(part, Table):
        return part.unit
    given: Any = part.levels[0] if isinstance(part, Isosurface) else None
    given = part.center if isinstance(part, Shaped) else given
    return parse_unit(given.unit) if is_quantity(given) else None


def _spans(part: Medium, unit: Unit) -> list[tuple[float, float]]:
    if isinstance(part, Shaped):
        center, width = (float(plain(value, unit, "center")) for value in (part.center, part.width))
        aside = width * min(_AROUND, 1.2 * float(part.profile_places[-1]))
        return [(center - aside, center + aside)]
    if isinstance(part, Table):
        values = part.values if part.unit is None else plain(part.values * part.unit, unit, "x")
        return [(float(values[0]), float(values[-1]))]
    if isinstance(part, Isosurface):
        levels = [float(plain(level, unit, "level")) for level in part.levels]
        aside = float(plain(part.width, unit, "width")) or 0.05 * float(np.ptp(levels))
        return [(min(levels) - aside, max(levels) + aside)]
    return []


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


def _draw_medians(axes: Axes, part: Medium, name: str, volume: Volume) -> None:
    """Draw medians of j and α in bins of a field, for a medium that depends on others, too."""
    names = list(dict.fromkeys((*part.names, name)))
    step = max(1, volume.grid.size // _CELLS)
    table = np.array(
        [
            np.concatenate([piece.x.ravel()[::step] for piece in pieces(volume, Expression(own))])
            for own in names
        ]
    )
    fields = dict(zip(names, table[:, np.all(np.isfinite(table), axis=0)], strict=True))
    panel = _Panel(Expression(name), [], volume)
    j, alpha = coefficients(part, fields, volume.unit, volume.expression_unit)
    rows = np.concatenate([fields[name][None], j, np.atleast_2d(alpha)])
    place = np.digitize(fields[name], panel.spread(_COARSE + 1)[1:-1])
    bins = [rows[:, place == k] for k in range(_COARSE)]
    medians = np.stack([np.median(own, axis=1) for own in bins if own.size], axis=1)
    others = ", ".join(own for own in names if own != name)
    panel.draw_axis(axes, f"median of cells, which differ in {others}")
    labels = [*map(_labelled, ("emissivity j", "extinction α"), units_of(part, volume))]
    split = part.channels + 1
    _draw_lines(axes, medians[0], medians[1:split], medians[split:], labels)
    axes.legend(fontsize="small", framealpha=0.7)


def _paint(part: Medium) -> ColorBy | None:
    return part.modulation.color if part.modulation else None


def _labelled(name: str, unit: Unit) -> str:
    text = unit_name(unit)
    return f"{name} [{pretty_unit(text)}]" if text else name
