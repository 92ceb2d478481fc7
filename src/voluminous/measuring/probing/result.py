"""What one ray saw."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...notebook import page
from ...notebook import table as html_table
from ...regrid.table import table
from ...units import parse_unit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Column = tuple[np.ndarray, Any]


@dataclass(frozen=True, repr=False)
class Probe:
    """What one ray saw, segment by segment, from the observer on.

    There are n segments, c channels, and e extinctions: one if the medium is grey, else one per
    channel. Distances are counted from the observer, or, for an orthographic camera, from the plane
    through the centre of the image, away from the observer.

    Attributes
    ----------
    begin, end : float64 array (n,)
        Distances at which each segment begins and ends, in the volume's unit.
    position : float64 array (n, 3)
        The segments' middles.
    cell : int array (n,)
        Flat number of the cell; of schemes that interpolate fields, of that in which the middle is.
    index : int array (n, 3) or None
        The cell's number along each axis, if the grid has three.
    level : int array (n,)
        How often the base cell was refined.
    hidden : bool array (n,)
        Cells that lack a value are transparent.
    fields : dict of str to array (n,)
        Fields that the medium looks at, and what was asked for: in the cell, or, of schemes that
        interpolate, in the middle of the segment.
    scalars : dict of str to array (n,)
        The medium's expressions.
    j : float64 array (n, c)
        Emissivity per length: in the cell, or its mean over the segment. Where fields are
        interpolated, the mean of two halves.
    alpha : float64 array (n, e)
        Extinction per length, in the same way.
    tau : float64 array (n, e)
        Optical depth of the segment.
    theta : float64 array (n, e)
        Its transparency θ.
    b : float64 array (n, c)
        What it emits at its front.
    depth : float64 array (n, e)
        Optical depth from the observer to the end of the segment.
    gathered : float64 array (n, c)
        What the observer sees of all up to the end of the segment.
    arriving : float64 array (n, c)
        Intensity that comes out of the front of the segment: of it, of all behind it, and of the
        background.
    background : float64 array (c,)
    intensity : array (c,)
        The pixel: what `render` gives.
    transparency, optical_depth : array (e,)
        Of all that the ray met.
    stopped : bool
        The ray stopped before it had crossed everything: nothing behind matters.
    pixel, at : (int, int), (float, float)
        The pixel (ix, iy), and the point of the image plane.
    units : dict of str to str
        Units of "length", "intensity", and of all fields and scalars.
    provenance : dict
        How it was made.
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

    def __len__(self) -> int:
        """Return the number of segments."""
        return len(self.begin)

    def columns(self) -> dict[str, Column]:
        """Return everything that there is per segment: arrays of shape (n,), and their units.

        Channels and extinctions are counted from 0 where there are several: ``j_0``, ``j_1``, …
        """
        length, light = parse_unit(self.units["length"]), parse_unit(self.units["intensity"])
        found: dict[str, Column] = {"begin": (self.begin, length), "end": (self.end, length)}
        found |= {f"{a}_mid": (p, length) for a, p in zip("xyz", self.position.T, strict=True)}
        found["cell"] = (self.cell, None)
        if self.index is not None:
            names = [f"i{axis}" for axis in self.axes]
            found |= {n: (i, None) for n, i in zip(names, self.index.T, strict=True)}
        found |= {"level": (self.level, None), "hidden": (self.hidden, None)}
        for name, values in {**self.fields, **self.scalars}.items():
            found[name] = (values, parse_unit(self.units[name]))
        per = None if length is None else length**-1
        bright = per if light is None else light if per is None else light * per
        for name, unit in (("j", bright), ("alpha", per)):
            found |= _numbered(name, getattr(self, name), unit)
        for name in ("tau", "theta", "depth"):
            found |= _numbered(name, getattr(self, name), None)
        for name in ("b", "gathered", "arriving"):
            found |= _numbered(name, getattr(self, name), light)
        return found

    def table(self) -> Any:
        """Return an astropy `QTable`, one row per segment, with units.

        Its ``meta`` tells the pixel, the background and how it was made.
        """
        made = table(self.columns(), "astropy")
        made.meta = {"pixelx": self.pixel[0], "pixely": self.pixel[1], "u": self.at[0]}
        made.meta |= {"v": self.at[1], "stopped": self.stopped}
        made.meta |= {k: str(self.provenance[k]) for k in ("software", "scheme")}
        made.meta["precis"] = self.provenance["precision"]
        made.meta |= {f"backgr{c}": float(v) for c, v in enumerate(self.background)}
        made.meta |= {f"intens{c}": float(v) for c, v in enumerate(self.intensity)}
        return made

    def to_pandas(self) -> Any:
        """Return a pandas `DataFrame`, one row per segment; it knows no units.

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
        from .saving import save

        save(self, Path(path))

    def plot(
        self, figure: Figure | None = None, *, ax: Any = None, show: Sequence[str] | None = None
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
        from .plot import plot

        return plot(self, figure, ax, show)

    def text(self, rows: int | None = 20) -> str:
        """Return a table to read.

        Parameters
        ----------
        rows : int or None
            The most lines; None for all.
        """
        from .text import text

        return text(self, rows)

    def __str__(self) -> str:
        return self.text()

    def _repr_html_(self) -> str:
        light, length = self.units["intensity"], self.units["length"]
        rows = [
            ("pixel (ix, iy)", f"{self.pixel}"),
            ("on the image plane", " ".join([*(f"{v:.6g}" for v in self.at), length]).strip()),
            ("segments", f"{len(self)}"),
            ("intensity", f"{_listed(self.intensity)} {light}".strip()),
            ("transparency", _listed(self.transparency)),
            ("optical depth", _listed(self.optical_depth)),
            ("to see more", "probe.plot(), print(probe), probe.table()"),
        ]
        return page("Probe", html_table(rows))

    def __repr__(self) -> str:
        return f"<Probe of pixel {self.pixel}: {len(self)} segments>"


def _listed(values: Any) -> str:
    return ", ".join(f"{value:.6g}" for value in np.ravel(values))


def _numbered(name: str, values: np.ndarray, unit: Any) -> dict[str, Column]:
    if values.shape[1] == 1:
        return {name: (values[:, 0], unit)}
    return {f"{name}_{c}": (column, unit) for c, column in enumerate(values.T)}
