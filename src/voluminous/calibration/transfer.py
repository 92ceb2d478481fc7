"""A medium drawn as a transfer function, over the histogram of what it looks at in a volume."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import InputError
from ..expressions import Expression
from ..figures import new_figure
from ..media import Isosurface, Medium, Sum
from ..media.at_values import coefficients_at
from ..media.modulation import Modulation
from ..units import plain, unit_name
from ..volume import Volume
from .calibrate import calibrate
from .checks import check_medium, check_volume, nothing_to_show
from .histogram import histogram, is_constant, sampled_values

_RGB = ("#d62728", "#2ca02c", "#1f77b4")
_POINTS, _CELLS, _BINS, _WIDE = 2001, 1 << 16, 128, 100.0


def plot(medium: Medium, volume: Volume, ax: Any = None) -> Any:
    """Draw a medium; see `Medium.plot`."""
    check_medium("plot", medium)
    check_volume("plot", "first", volume)
    groups: dict[str, list[Any]] = {}
    for part in calibrate(medium, volume).components():
        groups.setdefault(_scalar(part).text, []).append(part)
    if ax is not None and len(groups) > 1:
        raise InputError(
            f"the medium looks at {len(groups)} expressions, one panel for each: leave out ax"
        )
    if ax is None:
        figure = new_figure()
        figure.set_size_inches(6.4, 2.4 + 2.2 * len(groups))
        panels = figure.subplots(len(groups), squeeze=False)[:, 0]
    else:
        panels = np.array([ax])
    for axes, (text, parts) in zip(panels, groups.items(), strict=True):
        _panel(axes, Expression(text), parts, volume)
    return panels[0] if len(panels) == 1 else panels


def _scalar(part: Medium) -> Expression:
    """Return what a part is a function of; of several fields, its first."""
    found = part.scalars() or tuple(Expression(name) for name in part.names)
    if not found:
        raise InputError(f"{part!r} looks at no field: there is nothing to draw it over")
    return found[0]


def _panel(axes: Any, expr: Expression, parts: list[Any], volume: Volume) -> None:
    values = sampled_values(volume, expr)
    if not len(values):
        raise InputError(f"{expr.text} has no finite value in this volume")
    if is_constant(values[0], values[-1]):
        raise nothing_to_show(expr, float(values[0]))
    amount = histogram(volume, expr, values)
    step = len(amount.volume) // _BINS
    bars = amount.volume.reshape(-1, step).sum(axis=1)
    counts = axes.twinx()
    counts.stairs(bars, amount.edges[::step], fill=True, color="0.87")
    counts.set(yscale="log", ylabel="part of the volume")
    counts.yaxis.label.set_color("0.5")
    counts.tick_params(axis="y", colors="0.5")
    axes.set_zorder(counts.get_zorder() + 1)
    axes.patch.set_visible(False)
    unit = volume.expression_unit(expr)
    surfaces = [part for part in parts if isinstance(part, Isosurface)]
    others = [part for part in parts if not isinstance(part, Isosurface)]
    if others:
        _curves(axes, expr, others, volume, amount.edges)
    for part in surfaces:
        rows = zip(part.levels, part.colors, part.opacities, strict=True)
        for level, color, opacity in rows:
            x = plain(level, unit, "level")
            shown = np.clip(color, 0, 1) if len(color) == 3 else "black"
            axes.axvline(x, color=shown, lw=2, label=f"surface, opacity {max(opacity):.2g}")
    gates = {p.modulation.where.text for p in parts if _modulation(p) and p.modulation.where}
    paints = {p.modulation.color.expr.text for p in parts if _modulation(p) and p.modulation.color}
    told = [f"where {gate}" for gate in sorted(gates)]
    told += [f"coloured by {paint}" for paint in sorted(paints)]
    axes.set_title("; ".join(told), fontsize="medium")
    axes.set_xlabel(
        " ".join([expr.text, f"[{unit_name(unit)}]" if unit_name(unit) else ""]).strip()
    )
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="best", fontsize="small")


def _curves(axes: Any, expr: Expression, parts: list[Any], volume: Volume, edges: Any) -> None:
    """Draw j and α as functions of an expression."""
    medium = Sum(tuple(map(_ungated, parts))) if len(parts) > 1 else _ungated(parts[0])
    options = (volume.unit, volume.expression_unit)
    if all(part.scalars() for part in parts) or medium.names == (expr.text,):
        x = np.linspace(edges[0], edges[-1], _POINTS)
        if volume.expression_unit(expr) is None and edges[0] > 0 and edges[-1] > _WIDE * edges[0]:
            x = np.geomspace(edges[0], edges[-1], _POINTS)
        j, alpha = coefficients_at(medium, {expr.text: x, **_unused(medium, expr)}, *options)
    else:
        x, j, alpha = _means(expr, medium, volume, edges)
    if edges[0] > 0 and edges[-1] > _WIDE * edges[0] and not expr.text.startswith("log"):
        axes.set_xscale("log")
    colors = _RGB if j.shape[-1] == 3 else [f"C{k}" for k in range(j.shape[-1])]
    for k, color in enumerate(colors):
        name = "j, " + (["red", "green", "blue"][k] if len(colors) == 3 else f"channel {k}")
        axes.plot(x, j[..., k], color=color, label=name if len(colors) > 1 else "j")
    columns = alpha.reshape(len(x), -1)
    for k, column in enumerate(columns.T):
        color = "black" if columns.shape[1] == 1 else colors[k]
        axes.plot(x, column, "--", color=color, lw=1.2, label="α" if k == 0 else None)
    length = unit_name(volume.unit)
    axes.set_ylabel(f"j, α per {length}" if length else "j, α per unit length")
    axes.set_ylim(min(0.0, 1.05 * float(np.nanmin(j, initial=0.0))))


def _unused(medium: Medium, expr: Expression) -> dict[str, Any]:
    """Return values for the fields in the expression, which is given itself."""
    return {name: 0.0 for name in medium.names if name != expr.text}


def _means(expr: Expression, medium: Medium, volume: Volume, edges: Any) -> tuple[Any, Any, Any]:
    """Return the means of j and α of cells, in bins of an expression."""
    every = max(1, volume.grid.size // _CELLS)
    fields = {n: volume.evaluate(n).ravel()[::every] for n in (*medium.names, expr.text)}
    j, alpha = coefficients_at(medium, fields, volume.unit, volume.expression_unit)
    bins = np.linspace(edges[0], edges[-1], _BINS + 1)
    columns = [*j.T, *alpha.reshape(len(j), -1).T]
    x, good = fields[expr.text], np.all(np.isfinite(columns), axis=0)
    count = np.histogram(x[good], bins)[0]
    with np.errstate(invalid="ignore"):
        found = [np.histogram(x[good], bins, weights=c[good])[0] / count for c in columns]
    some, k = count > 0, j.shape[-1]
    middles = 0.5 * (bins[1:] + bins[:-1])[some]
    rows = np.stack(found, axis=-1)[some]
    return middles, rows[:, :k], rows[:, k:]


def _modulation(part: Any) -> Any:
    return getattr(part, "modulation", None)


def _ungated(part: Any) -> Any:
    """Return a medium without what other fields vary."""
    if not _modulation(part):
        return part
    names = tuple(part.expr.names)
    return part.changed(modulation=Modulation(None, None, part.channels), names=names)
