"""What one ray saw, drawn in four panels over one another."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import InputError, unknown_name
from ...figures import divided, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from .result import Probe

_SIZE = (8.0, 9.0)
# Letters are smaller in panels that are less high than this, in inches.
_HEIGHT = 1.4
# Lines of three channels are red, green and blue; others, and fields, follow matplotlib's cycle.
_RGB = ("#d1342f", "#2c9c3f", "#2f62d1")
_FIRST, _SECOND = "#1f5fa8", "#b3541e"
# A quantity that varies by more than this is drawn logarithmically.
_WIDE = 30.0


def plot(probe: Probe, figure: Figure | None, ax: Any, show: Sequence[str] | None) -> Figure:
    """Draw a probe; see `Probe.plot`."""
    import matplotlib

    panels = _panels(figure, ax)
    chosen = _chosen(probe, show)
    low = panels[0].get_position().height * panels[0].get_figure().get_size_inches()[1]
    size = matplotlib.rcParams["font.size"] * min(1.0, max(0.7, low / _HEIGHT))
    with matplotlib.rc_context({"font.size": size}):
        _draw(panels, probe, chosen)
    drawn: Figure = panels[0].get_figure()
    return drawn


def _draw(panels: Any, probe: Probe, chosen: dict[str, np.ndarray]) -> None:
    if len(probe):
        _fields(panels[0], probe, chosen)
        _coefficients(panels[1], probe)
        _depth(panels[2], probe)
        _light(panels[3], probe)
    for panel, title in zip(panels, _TITLES, strict=True):
        panel.set_title(title, loc="left", fontsize="medium")
        panel.grid(alpha=0.25)
        _shade_hidden(panel, probe)
    panels[-1].set_xlabel(_distance(probe), fontsize="medium")
    panels[-1].xaxis.get_offset_text().set_fontsize("medium")
    panels[-1].margins(x=0.01)
    panels[-1].tick_params(axis="x", labelsize="medium")


def _panels(figure: Figure | None, ax: Any) -> Any:
    if ax is None:
        if figure is None:
            figure = new_figure()
            figure.set_size_inches(_SIZE)
        return figure.subplots(4, 1, sharex=True)
    if figure is not None:
        raise InputError("give ax or figure, not both")
    return divided(ax, 4)


_TITLES = (
    "what is there",
    "what it emits, and what it takes away",
    "how much is in front",
    "what the observer gathers, and what arrives from behind",
)


def _chosen(probe: Probe, show: Sequence[str] | None) -> dict[str, np.ndarray]:
    """Return the fields and scalars to draw.

    By default the medium's expressions; else its fields, without coordinates if there are others.
    """
    known = {**probe.fields, **probe.scalars}
    if show is not None:
        for name in show:
            if name not in known:
                raise unknown_name("field", name, known)
        return {name: known[name] for name in show}
    places = ("x", "y", "z", "r", *probe.axes)
    fields = {name: v for name, v in probe.fields.items() if name not in places}
    return probe.scalars or fields or probe.fields


def _fields(panel: Axes, probe: Probe, chosen: dict[str, np.ndarray]) -> None:
    """Draw one or two fields with an axis each; more of them by parts of their largest value."""
    if len(chosen) > 2:
        for name, values in chosen.items():
            largest = float(np.nanmax(np.abs(values), initial=0.0)) or 1.0
            panel.plot(*_steps(probe, values / largest), label=f"{name}  (max {largest:.3g})")
        panel.set_ylabel("part of the largest")
        panel.legend(fontsize="small")
        return
    colors = (_FIRST, _SECOND)
    axes = [panel, panel.twinx()] if len(chosen) > 1 else [panel]
    for axis, (name, values), color in zip(axes, chosen.items(), colors, strict=False):
        _labelled(axis, _named(name, probe.units[name]), color)
        axis.plot(*_steps(probe, values), color=color)
        _set_scale(axis, values)


def _coefficients(panel: Axes, probe: Probe) -> None:
    length = probe.units["length"]
    light = probe.units["intensity"]
    unit = f"{light or '1'} / {length}" if length else light
    _labelled(panel, _named("emissivity j", unit), None)
    for values, style in _lines(probe.j):
        panel.plot(*_steps(probe, values), **style)
    other = panel.twinx()
    grey = probe.alpha.shape[1] == 1
    how = "grey" if grey else "dashed"
    _labelled(other, _named(f"extinction α ({how})", f"1 / {length}" if length else ""), None)
    for values, style in _lines(probe.alpha):
        if grey:
            other.fill_between(*_steps(probe, values), color="0.5", alpha=0.25, linewidth=0)
        else:
            other.plot(*_steps(probe, values), **{**style, "linestyle": "--"})
    for axis in (panel, other):
        axis.set_ylim(bottom=min(0.0, axis.get_ylim()[0]))


def _depth(panel: Axes, probe: Probe) -> None:
    """Draw optical depth and transparency between the observer and each place."""
    x = _walls(probe)
    _labelled(panel, "optical depth τ", _FIRST if probe.depth.shape[1] == 1 else None)
    other: Any = panel.twinx()
    _labelled(other, "transparency (dashed)", _SECOND if probe.depth.shape[1] == 1 else None)
    for values, style in _lines(probe.depth, _FIRST):
        panel.plot(x, np.append(0.0, values), **style)
    through = np.cumprod(probe.theta, axis=0)
    for values, style in _lines(through, _SECOND):
        other.plot(x, np.append(1.0, values), **{**style, "linestyle": "--"})
    panel.set_ylim(bottom=0.0)
    other.set_ylim(-0.03, 1.05)
    if probe.depth[-1].max() > 1.0:
        panel.axhline(1.0, color="0.6", linewidth=0.8, linestyle=":")
        panel.annotate("τ = 1", (x[-1], 1.0), color="0.4", fontsize="small", va="top", ha="right")


def _light(panel: Axes, probe: Probe) -> None:
    """Draw what is gathered from the observer on, and what arrives from behind."""
    x = _walls(probe)
    lines = zip(_lines(probe.gathered), probe.arriving.T, probe.background, strict=True)
    for (gathered, style), arriving, behind in lines:
        panel.plot(x, np.append(0.0, gathered), **style)
        panel.plot(x, np.append(arriving, behind), **{**style, "linestyle": "--"})
        panel.plot(x[:1], arriving[:1], "o", color=style["color"], clip_on=False, zorder=5)
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], color="0.3", label="gathered up to here"),
        Line2D([], [], color="0.3", linestyle="--", label="arriving from behind"),
        Line2D([], [], color="0.3", linestyle="", marker="o", label="the pixel"),
    ]
    low, high = panel.get_ylim()
    panel.set_ylim(low, high + 0.22 * (high - low))  # room for the legend
    panel.legend(handles=handles, fontsize="small", loc="upper center", ncols=3)
    _labelled(panel, _named("intensity", probe.units["intensity"]), None)


def _steps(probe: Probe, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a line that is level in each segment, and broken where nothing was visited."""
    x = np.stack([probe.begin, probe.end, probe.end], axis=1)
    y = np.repeat(values[:, None], 3, axis=1).astype(float)
    gap = probe.begin[1:] - probe.end[:-1] > 1e-3 * (probe.end[:-1] - probe.begin[:-1])
    y[:-1, 2][gap] = np.nan
    return x.ravel(), y.ravel()


def _walls(probe: Probe) -> np.ndarray:
    return np.append(probe.begin[0], probe.end)


def _lines(columns: np.ndarray, alone: str = "0.15") -> list[tuple[np.ndarray, dict[str, Any]]]:
    count = columns.shape[1]
    colors: Sequence[str] = [f"C{c}" for c in range(count)]
    if count in (1, 3):
        colors = (alone,) if count == 1 else _RGB
    return [(v, {"color": c}) for v, c in zip(columns.T, colors, strict=True)]


def _set_scale(axis: Axes, values: np.ndarray) -> None:
    known = values[np.isfinite(values)]
    if known.size and known.min() > 0 and known.max() > _WIDE * known.min():
        axis.set_yscale("log")


def _labelled(axis: Axes, label: str, color: str | None) -> None:
    label = label.replace(" [" if " [" in label else " (", "\n[" if " [" in label else "\n(")
    axis.set_ylabel(label, color=color or "black", fontsize="medium")
    axis.yaxis.get_offset_text().set_fontsize("medium")
    axis.tick_params(axis="y", colors=color or "black", labelsize="medium")


def _shade_hidden(panel: Axes, probe: Probe) -> None:
    for k in np.flatnonzero(probe.hidden):
        panel.axvspan(float(probe.begin[k]), float(probe.end[k]), color="0.9", zorder=0, lw=0)


def _named(name: str, unit: str) -> str:
    return f"{name} [{unit}]" if unit else name


def _distance(probe: Probe) -> str:
    observer = probe.provenance["camera"].get("type") == "perspective"
    origin = "from the observer" if observer else "behind the image plane (the observer is left)"
    return _named(f"distance {origin}", probe.units["length"])
