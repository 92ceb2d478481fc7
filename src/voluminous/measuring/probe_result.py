"""`Probe`, the segments of one ray: as a table, a text and a plot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from ..errors import InputError, unknown_name
from ..figures import divided, new_figure
from ..files import replacing
from ..notebook import page
from ..notebook import table as html_table
from ..regrid.table import table
from ..units import Unit, parse_unit

if TYPE_CHECKING:
    import pandas
    from astropy.table import QTable
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Column: TypeAlias = tuple[np.ndarray, Unit]
# astropy's names of the formats of tables.
_TABLES = {".csv": "ascii.csv", ".ecsv": "ascii.ecsv", ".fits": "fits"}
_PLOTS = (".png", ".pdf", ".svg")
_DPI = 150


@dataclass(frozen=True)
class Points:
    """Values at m points of a ray, dense enough to draw lines through them; NaN in hidden cells.

    Attributes
    ----------
    distance : float64 array (m,)
        As those of a `Probe`.
    fields, scalars : dict of str to array (m,)
        The medium's fields and expressions.
    j, alpha : float64 arrays (m, c), (m, e)
        Emissivity and extinction per length.
    """

    distance: np.ndarray
    fields: dict[str, np.ndarray]
    scalars: dict[str, np.ndarray]
    j: np.ndarray
    alpha: np.ndarray


@dataclass(frozen=True, repr=False)
class Probe:
    """The segments of one ray, from the observer on.

    There are n segments, c channels, and e extinctions: one if the medium is grey, else one per
    channel. Distances are counted from the observer, or, for an orthographic camera, from the plane
    through the centre of the image, away from the observer.

    Attributes
    ----------
    begin, end : float64 array (n,)
        Distances at which each segment begins and ends, in the volume's unit.
    position : float64 array (n, 3)
        The midpoints of the segments.
    cell, index, level : int arrays (n,), (n, 3) or None, (n,)
        Flat number of the cell (for schemes that interpolate fields, of that of the midpoint), its
        number along each axis, if the grid has three, and how often the base cell was refined.
    hidden : bool array (n,)
        Whether the cell lacks a value; such cells are transparent.
    fields : dict of str to array (n,)
        The medium's fields, and those asked for: in the cell, or, for schemes that interpolate, at
        the midpoint of the segment.
    scalars : dict of str to array (n,)
        The medium's expressions.
    j, alpha : float64 arrays (n, c), (n, e)
        Emissivity and extinction per length: in the cell, or the mean over the segment; where
        fields are interpolated, the mean of two halves.
    tau, theta, b : float64 arrays (n, e), (n, e), (n, c)
        Optical depth and transparency θ of the segment, and the intensity that it emits.
    depth : float64 array (n, e)
        Optical depth from the observer to the end of the segment.
    gathered : float64 array (n, c)
        The intensity that the observer receives from all up to the end of the segment.
    arriving : float64 array (n, c)
        Intensity at the front of the segment: from it, from all behind it, and from the background.
    background, intensity : array (c,)
        The background, and the pixel as `render` gives it.
    transparency, optical_depth : array (e,)
        Of the whole ray.
    stopped : bool
        Whether the ray stopped early: nothing behind matters.
    pixel, at : (int, int), (float, float)
        The pixel (ix, iy), and the point of the image plane.
    units : dict of str to str
        Units of "length", "intensity", and of all fields and scalars.
    provenance : dict
        The settings.
    points : Points
        Fields, expressions and coefficients at points of the ray, also where rays of the picture
        leap over what is empty: what is plotted.
    """

    begin: np.ndarray
    end: np.ndarray
    position: np.ndarray
    cell: np.ndarray
    index: np.ndarray | None
    level: np.ndarray
    hidden: np.ndarray
    fields: dict[str, np.ndarray]
    scalars: dict[str, np.ndarray]
    j: np.ndarray
    alpha: np.ndarray
    tau: np.ndarray
    theta: np.ndarray
    b: np.ndarray
    depth: np.ndarray
    gathered: np.ndarray
    arriving: np.ndarray
    background: np.ndarray
    intensity: np.ndarray
    transparency: np.ndarray
    optical_depth: np.ndarray
    stopped: bool
    pixel: tuple[int, int]
    at: tuple[float, float]
    axes: tuple[str, ...]
    units: dict[str, str]
    provenance: dict[str, Any]
    points: Points | None = None

    def __len__(self) -> int:
        """Return the number of segments."""
        return len(self.begin)

    def columns(self) -> dict[str, Column]:
        """Return all values per segment: arrays of shape (n,), and their units.

        Channels and extinctions are counted from 0 where there are several: ``j_0``, ``j_1``, …
        """
        length, light = parse_unit(self.units["length"]), parse_unit(self.units["intensity"])
        per = None if length is None else length**-1
        bright = per if light is None else light if per is None else light * per
        columns: dict[str, Column] = {"begin": (self.begin, length), "end": (self.end, length)}
        columns |= {f"{a}_mid": (p, length) for a, p in zip("xyz", self.position.T, strict=True)}
        columns["cell"] = (self.cell, None)
        if self.index is not None:
            names = [f"i{axis}" for axis in self.axes]
            columns |= {n: (i, None) for n, i in zip(names, self.index.T, strict=True)}
        columns |= {"level": (self.level, None), "hidden": (self.hidden, None)}
        for name, values in {**self.fields, **self.scalars}.items():
            columns[name] = (values, parse_unit(self.units[name]))
        units = {"j": bright, "alpha": per, "tau": None, "theta": None, "depth": None}
        units |= {"b": light, "gathered": light, "arriving": light}
        for name, unit in units.items():
            several = getattr(self, name).T
            for c, values in enumerate(several):
                columns[name if len(several) == 1 else f"{name}_{c}"] = (values, unit)
        return columns

    def table(self) -> QTable:
        """Return an astropy `QTable`, one row per segment, with units.

        Its ``meta`` holds the pixel, the background and the settings.
        """
        made: QTable = table(self.columns(), "astropy")
        made.meta = {"pixelx": self.pixel[0], "pixely": self.pixel[1], "u": self.at[0]}
        made.meta |= {"v": self.at[1], "stopped": self.stopped}
        made.meta |= {k: str(self.provenance[k]) for k in ("software", "scheme")}
        made.meta["precis"] = self.provenance["precision"]
        made.meta |= {f"backgr{c}": float(v) for c, v in enumerate(self.background)}
        made.meta |= {f"intens{c}": float(v) for c, v in enumerate(self.intensity)}
        return made

    def to_pandas(self) -> pandas.DataFrame:
        """Return a pandas `DataFrame`, one row per segment, without units.

        Raises
        ------
        MissingPackageError
            If pandas is not installed.
        """
        return table(self.columns(), "pandas")

    def save(self, path: str | Path) -> None:
        """Write the table (.csv, .ecsv, .fits) or the plot (.png, .pdf, .svg).

        Units are kept in .ecsv and .fits.

        Raises
        ------
        UnknownNameError
            If the suffix is none of these.
        InputError
            If there is no such directory.
        """
        suffix = check_suffix(Path(path))
        with replacing(Path(path)) as temporary:
            if suffix in _TABLES:
                self.table().write(temporary, format=_TABLES[suffix], overwrite=True)
            else:
                self.plot().savefig(temporary, dpi=_DPI, format=suffix[1:])

    def plot(
        self,
        figure: Figure | None = None,
        *,
        ax: Axes | Sequence[Axes] | None = None,
        show: Sequence[str] | None = None,
    ) -> Figure:
        """Draw fields, coefficients, optical depth and intensity along the ray.

        Parameters
        ----------
        figure : matplotlib Figure, optional
            To draw into; by default a new one.
        ax : matplotlib Axes or sequence of four, optional
            To draw into instead: one is divided into four panels.
        show : sequence of str, optional
            Which fields and scalars; by default the medium's expressions, or its fields.

        Returns
        -------
        Figure
            Of four panels that share the distance.

        Raises
        ------
        UnknownNameError
            If there is no such field.
        """
        return _plot(self, figure, ax, show)

    def text(self, rows: int | None = 20) -> str:
        """Return a table to read.

        Parameters
        ----------
        rows : int or None
            The most lines; None for all.
        """
        return _text(self, rows)

    def __str__(self) -> str:
        return self.text()

    def _repr_html_(self) -> str:
        light, length = self.units["intensity"], self.units["length"]
        rows = [
            ("pixel (ix, iy)", f"{self.pixel}"),
            ("on the image plane", " ".join([*(f"{v:.6g}" for v in self.at), length]).strip()),
            ("segments", f"{len(self)}"),
            ("intensity", f"{', '.join(_numbers(self.intensity, 6))} {light}".strip()),
            ("transparency", ", ".join(_numbers(self.transparency, 6))),
            ("optical depth", ", ".join(_numbers(self.optical_depth, 6))),
            ("to see more", "probe.plot(), print(probe), probe.table()"),
        ]
        return page("Probe", html_table(rows))

    def __repr__(self) -> str:
        return f"<Probe of pixel {self.pixel}: {len(self)} segments>"


def check_suffix(path: Path) -> str:
    """Return the suffix of a file of a table or a plot; refuse others."""
    suffix = path.suffix.lower()
    if suffix not in (*_TABLES, *_PLOTS):
        raise unknown_name("suffix of a table or plot", suffix, (*_TABLES, *_PLOTS))
    return suffix


# The most fields and scalars that fit beside the other columns.
_FIELDS = 3


def _text(probe: Probe, rows: int | None) -> str:
    channel = int(np.argmax(np.abs(probe.intensity)))
    extinction = min(channel, probe.tau.shape[1] - 1)
    length, light, how = probe.units["length"], probe.units["intensity"], probe.provenance
    lines = [
        f"Pixel {probe.pixel}: {len(probe)} segments, {how['scheme']}, "
        f"{how['precision']} precision",
        f"intensity {_vector(probe.intensity)}{light and ' ' + light}"
        f" = {_vector(probe.gathered[-1:].ravel()) or '0'} gathered + "
        f"{_vector(probe.transparency)} x {_vector(probe.background)} behind; "
        f"optical depth {_vector(probe.optical_depth)}",
    ]
    if len(probe.intensity) > 1:
        lines.append(f"below: channel {channel} of {len(probe.intensity)}")
    if probe.stopped:
        lines.append("stopped early: nothing behind can be seen (cutoff=0 goes on)")
    if not len(probe):
        return "\n".join([*lines, "The ray meets nothing."])
    where = probe.cell[:, None] if probe.index is None else probe.index
    cells = [",".join(map(str, index)) for index in where]
    cells = ["hidden" if h else name for h, name in zip(probe.hidden, cells, strict=True)]
    columns = [
        ["distance", length, *_numbers(0.5 * (probe.begin + probe.end), 6)],
        ["length", length, *_numbers(probe.end - probe.begin, 3)],
        ["cell", "", *cells],
    ]
    if probe.level.any():
        columns.append(["level", "", *map(str, probe.level)])
    shown = {**probe.fields, **probe.scalars}
    columns += [[name, probe.units[name], *_numbers(shown[name])] for name in list(shown)[:_FIELDS]]
    columns += [
        ["j", _per(light, length), *_numbers(probe.j[:, channel])],
        ["alpha", _per("", length), *_numbers(probe.alpha[:, extinction])],
        ["tau", "", *_numbers(probe.tau[:, extinction])],
        ["depth", "", *_numbers(probe.depth[:, extinction])],
        ["b", light, *_numbers(probe.b[:, channel])],
        ["gathered", light, *_numbers(probe.gathered[:, channel])],
        ["arriving", light, *_numbers(probe.arriving[:, channel])],
    ]
    aligned = [[cell.rjust(max(map(len, column))) for cell in column] for column in columns]
    head, units, *body = ("  ".join(row) for row in zip(*aligned, strict=True))
    if rows is not None and len(body) > rows:
        half = max(1, rows // 2)
        omitted = f"… {len(body) - 2 * half} segments …".center(len(head)).rstrip()
        body = [*body[:half], omitted, *body[-half:]]
    return "\n".join([*lines, "", head, units, *body])


def _per(unit: str, length: str) -> str:
    return f"{unit or '1'} / {length}" if length else unit


def _numbers(values: np.ndarray, digits: int = 4) -> list[str]:
    return [f"{value:.{digits}g}" for value in np.ravel(values)]


def _vector(values: np.ndarray) -> str:
    texts = _numbers(values, 6)
    return f"({', '.join(texts)})" if len(texts) > 1 else "".join(texts)


_SIZE = (8.0, 9.0)
# Letters are smaller in panels that are less high than this, in inches.
_HEIGHT = 1.4
# Lines of three channels are red, green and blue; others, and fields, follow matplotlib's cycle.
_RGB = ("#d1342f", "#2c9c3f", "#2f62d1")
_FIRST, _SECOND = "#1f5fa8", "#b3541e"
# A quantity that varies by more than this is drawn logarithmically.
_WIDE = 30.0
_TITLES = (
    "what is there",
    "what it emits, and what it takes away",
    "how much is in front",
    "what the observer gathers, and what arrives from behind",
)


def _plot(
    probe: Probe,
    figure: Figure | None,
    ax: Axes | Sequence[Axes] | None,
    show: Sequence[str] | None,
) -> Figure:
    import matplotlib

    if ax is not None and figure is not None:
        raise InputError("give ax or figure, not both")
    chosen = _chosen(probe, show)
    if ax is None and figure is None:
        figure = new_figure()
        figure.set_size_inches(_SIZE)
    panels = divided(ax, 4) if figure is None else figure.subplots(4, 1, sharex=True)
    drawn: Figure = panels[0].get_figure()
    low = panels[0].get_position().height * drawn.get_size_inches()[1]
    size = matplotlib.rcParams["font.size"] * min(1.0, max(0.7, low / _HEIGHT))
    observer = probe.provenance["camera"].get("type") == "perspective"
    origin = "from the observer" if observer else "behind the image plane (the observer is left)"
    with matplotlib.rc_context({"font.size": size}):
        if len(probe):
            _draw_fields(panels[0], probe, chosen)
            _draw_coefficients(panels[1], probe)
            _draw_depth(panels[2], probe)
            _draw_light(panels[3], probe)
        for panel, title in zip(panels, _TITLES, strict=True):
            panel.set_title(title, loc="left", fontsize="medium")
            panel.grid(alpha=0.25)
            for k in np.flatnonzero(probe.hidden):
                panel.axvspan(probe.begin[k], probe.end[k], color="0.9", zorder=0, lw=0)
        label = _named(f"distance {origin}", probe.units["length"])
        panels[-1].set_xlabel(label, fontsize="medium")
        panels[-1].xaxis.get_offset_text().set_fontsize("medium")
        panels[-1].margins(x=0.01)
        panels[-1].tick_params(axis="x", labelsize="medium")
    return drawn


def _chosen(probe: Probe, show: Sequence[str] | None) -> dict[str, np.ndarray]:
    """Return the fields and scalars to draw.

    By default the medium's expressions; else its fields, without coordinates if there are others.
    """
    known = {**probe.fields, **probe.scalars}
    if probe.points is not None:  # what was asked for besides is known in cells alone
        known |= {**probe.points.fields, **probe.points.scalars}
    if show is not None:
        for name in show:
            if name not in known:
                raise unknown_name("field", name, known)
        return {name: known[name] for name in show}
    places = ("x", "y", "z", "r", *probe.axes)
    fields = [name for name in probe.fields if name not in places]
    return {name: known[name] for name in probe.scalars or fields or probe.fields}


def _draw_fields(panel: Axes, probe: Probe, chosen: dict[str, np.ndarray]) -> None:
    """Draw one or two fields with an axis each; more as fractions of their largest value."""
    if len(chosen) > 2:
        for name, values in chosen.items():
            largest = float(np.nanmax(np.abs(values), initial=0.0)) or 1.0
            panel.plot(*_line(probe, values / largest), label=f"{name}  (max {largest:.3g})")
        panel.set_ylabel("part of the largest")
        panel.legend(fontsize="small")
        return
    axes = [panel, panel.twinx()] if len(chosen) > 1 else [panel]
    for axis, (name, values), color in zip(axes, chosen.items(), (_FIRST, _SECOND), strict=False):
        _label(axis, _named(name, probe.units[name]), color)
        axis.plot(*_line(probe, values), color=color)
        finite = values[np.isfinite(values)]
        if finite.size and finite.min() > 0 and finite.max() > _WIDE * finite.min():
            axis.set_yscale("log")


def _draw_coefficients(panel: Axes, probe: Probe) -> None:
    length, light = probe.units["length"], probe.units["intensity"]
    other, grey = panel.twinx(), probe.alpha.shape[1] == 1
    _label(panel, _named("emissivity j", _per(light, length)))
    how = "grey" if grey else "dashed"
    _label(other, _named(f"extinction α ({how})", f"1 / {length}" if length else ""))
    points = probe.points or probe
    for values, color in _lines(points.j):
        panel.plot(*_line(probe, values), color=color)
    for values, color in _lines(points.alpha):
        if grey:
            other.fill_between(*_line(probe, values), color="0.5", alpha=0.25, linewidth=0)
        else:
            other.plot(*_line(probe, values), color=color, linestyle="--")
    for axis in (panel, other):
        axis.set_ylim(bottom=min(0.0, axis.get_ylim()[0]))


def _draw_depth(panel: Axes, probe: Probe) -> None:
    x, other, grey = _walls(probe), panel.twinx(), probe.depth.shape[1] == 1
    _label(panel, "optical depth τ", _FIRST if grey else None)
    _label(other, "transparency (dashed)", _SECOND if grey else None)
    for values, color in _lines(probe.depth, _FIRST):
        panel.plot(x, np.r_[0.0, 0.0, values, values[-1]], color=color)
    for values, color in _lines(np.cumprod(probe.theta, axis=0), _SECOND):
        other.plot(x, np.r_[1.0, 1.0, values, values[-1]], color=color, linestyle="--")
    panel.set_ylim(bottom=0.0)
    other.set_ylim(-0.03, 1.05)
    if probe.depth[-1].max() > 1.0:
        panel.axhline(1.0, color="0.6", linewidth=0.8, linestyle=":")
        panel.annotate("τ = 1", (x[-1], 1.0), color="0.4", fontsize="small", va="top", ha="right")


def _draw_light(panel: Axes, probe: Probe) -> None:
    x = _walls(probe)
    lines = zip(_lines(probe.gathered), probe.arriving.T, probe.background, strict=True)
    for (gathered, color), arriving, behind in lines:
        panel.plot(x, np.r_[0.0, 0.0, gathered, gathered[-1]], color=color)
        panel.plot(x, np.r_[arriving[0], arriving, behind, behind], color=color, linestyle="--")
        panel.plot(x[:1], arriving[:1], "o", color=color, clip_on=False, zorder=5)
    low, high = panel.get_ylim()
    panel.set_ylim(low, high + 0.22 * (high - low))  # room for the legend
    for name, style in (
        ("gathered up to here", "-"),
        ("arriving from behind", "--"),
        ("the pixel", "o"),
    ):
        panel.plot([], [], style, color="0.3", label=name)
    panel.legend(fontsize="small", loc="upper center", ncols=3)
    _label(panel, _named("intensity", probe.units["intensity"]))


def _line(probe: Probe, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return x and y of values at points; of values in cells as steps."""
    if probe.points is not None and len(values) == len(probe.points.distance):
        return probe.points.distance, values
    x = np.stack([probe.begin, probe.end, probe.end], axis=1)
    y = np.repeat(values[:, None], 3, axis=1).astype(float)
    gap = probe.begin[1:] - probe.end[:-1] > 1e-3 * (probe.end[:-1] - probe.begin[:-1])
    y[:-1, 2][gap] = np.nan
    return x.ravel(), y.ravel()


def _walls(probe: Probe) -> np.ndarray:
    """Return the walls of segments, between the ends of the ray: pictures begin where they see."""
    ends = probe.points.distance[[0, -1]] if probe.points else (probe.begin[0], probe.end[-1])
    return np.concatenate([ends[:1], probe.begin[:1], probe.end, ends[1:]])


def _lines(columns: np.ndarray, alone: str = "0.15") -> list[tuple[np.ndarray, str]]:
    count = columns.shape[1]
    colors = {1: (alone,), 3: _RGB}.get(count) or tuple(f"C{c}" for c in range(count))
    return list(zip(columns.T, colors, strict=True))


def _label(axis: Axes, label: str, color: str | None = None) -> None:
    bracket = " [" if " [" in label else " ("
    label = label.replace(bracket, "\n" + bracket[1:])
    axis.set_ylabel(label, color=color or "black", fontsize="medium")
    axis.yaxis.get_offset_text().set_fontsize("medium")
    axis.tick_params(axis="y", colors=color or "black", labelsize="medium")


def _named(name: str, unit: str) -> str:
    return f"{name} [{unit}]" if unit else name
