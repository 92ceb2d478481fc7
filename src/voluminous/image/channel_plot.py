"""A page of channel maps: one panel for each channel, with one colour scale."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError, check_flag
from ..figures import new_figure
from ..units import UnitLike, pretty_unit
from .beam import SIGMA, beam_in_pixels, sky_matrix
from .image import Image
from .lengths import labelled, readable
from .plot import add_scale_bar
from .sky import radians_per_unit
from .tone import OPTIONS, check_options, one_channel, signed_exposure

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .cube import Cube

Extent = tuple[float, float, float, float]  # left, right, bottom, top

_PANEL, _MARGIN = 1.9, 1.0  # inches
# From a corner to the middle of the beam, in its width.
_BESIDE = 0.7
# North is up if a pixel to the right is so many pixels north, at most.
_UPRIGHT = 1e-6
# More columns than rows, by this factor; so many panels are in one row.
_FLAT, _IN_A_ROW = 1.3, 4
_COLORMAP = "inferno"
_DIGITS = {"velocity": (1.0, "km/s"), "frequency": (1e-9, "GHz"), "wavelength": (1.0, "µm")}


def plot_maps(
    cube: Cube,
    ax: Any,
    *,
    unit: UnitLike,
    scale_bar: Any,
    colorbar: bool,
    **options: Any,
) -> NDArray[Any]:
    """Draw all channels; see `Cube.plot`."""
    from matplotlib.patheffects import withStroke
    from matplotlib.ticker import MaxNLocator

    check_options("display option", options, OPTIONS)
    shown = cube if unit is None else cube.to(unit)
    if not any(options.get(o) is not None for o in ("colormap", "norm", "background")):
        options["colormap"] = None if signed_exposure(shown.intensity) else _COLORMAP
    together = Image(shown.intensity.reshape(-1, 1), intensity_unit=shown.intensity_unit)
    look = one_channel(together, **options)
    panels = _panels(shown, ax)
    extent, names = _frame(shown, own=shown.unit != cube.unit)
    drawn = None
    for k, (panel, text) in enumerate(zip(panels, labels(shown), strict=True)):
        drawn = panel.imshow(
            shown.intensity[..., k],
            norm=look["norm"],
            cmap=look["cmap"],
            origin="lower",
            extent=extent,
        )
        # White with a dark outline is legible on any picture.
        outline = [withStroke(linewidth=2, foreground="k", alpha=0.7)]
        panel.text(
            0.05, 0.94, text, transform=panel.transAxes, va="top", color="white", fontsize="small"
        ).set_path_effects(outline)
        panel.tick_params(direction="in", color="0.7", labelleft=False, labelbottom=False)
    corner = next((panel for panel in panels if _is_corner(panel)), panels[0])
    corner.tick_params(labelleft=True, labelbottom=True, labelsize="small")
    for axis in (corner.xaxis, corner.yaxis):  # numbers at an edge would reach into neighbours
        axis.set_major_locator(MaxNLocator(4, prune="both"))
    corner.set(xlabel=names[0], ylabel=names[1])
    _draw_beam(corner, shown, extent)
    add_scale_bar(panels[-1], shown, extent, scale_bar)
    check_flag("colorbar", colorbar)
    if colorbar and drawn is not None:
        unit_text = labelled("intensity", pretty_unit(shown.intensity_unit))
        figure = panels[0].get_figure()
        figure.colorbar(drawn, ax=list(panels), label=unit_text, shrink=0.9, pad=0.01)
    return panels


def labels(cube: Cube) -> list[str]:
    """Return what is written into each panel: velocity, frequency or wavelength."""
    kind = cube.spectral.kind if cube.spectral.rest is None else "velocity"
    factor, unit = _DIGITS[kind]
    values = factor * cube.spectral.places(kind)
    step = np.abs(np.diff(values)).min() if len(values) > 1 else abs(values[0])
    digits = max(0, 1 - math.floor(math.log10(step))) if step > 0 else 2
    sign = "+" if kind == "velocity" else ""
    zero = 0.5 * 10.0**-digits
    texts = (f"{0.0 if abs(v) < zero else v:{sign}.{digits}f} {unit}" for v in values)
    return [text.replace("-", "−") for text in texts]


def _frame(cube: Cube, *, own: bool) -> tuple[Extent, list[str]]:
    """Return the edges and the labels of the axes: angles if they are known, in readable units.

    On the sky they are offsets from the middle; `own` keeps the unit of the image plane.
    """
    edges, names, unit = np.array(cube.extent), ["x", "y"], cube.unit
    to_sky, scale = sky_matrix(cube), radians_per_unit(cube)
    if not own and to_sky is not None and cube.wcs is not None:
        east, north = np.diag(to_sky) * (cube.shape[1], cube.shape[0]) * 0.5
        if np.abs(to_sky[[0, 1], [1, 0]]).max() < _UPRIGHT * np.abs(to_sky).max():
            edges, unit = 3600.0 * np.array([-east, east, -north, north]), "arcsec"
            kinds = (str(kind).split("-")[0] for kind in cube.wcs.celestial.wcs.ctype)
            names = [f"{kind} offset" for kind in kinds]
    if not own and unit == cube.unit and scale is not None:
        edges, unit = np.rad2deg(scale * edges) * 3600.0, "arcsec"
    size = max(np.ptp(edges[:2]), np.ptp(edges[2:]))
    factor, known = (1.0, unit) if own else readable(float(size), unit)
    left, right, bottom, top = (factor * edges).tolist()
    return (left, right, bottom, top), [labelled(name, known) for name in names]


def _panels(cube: Cube, ax: Any) -> NDArray[Any]:
    count = cube.channels
    if ax is not None:
        given = np.ravel(np.array(ax, dtype=object))
        if len(given) != count:
            raise InputError(f"ax must be one axes for each of {count} channels, got {len(given)}")
        return given
    columns = count if count <= _IN_A_ROW else math.ceil(math.sqrt(_FLAT * count))
    rows = -(-count // columns)
    left, right, bottom, top = cube.extent
    height = _PANEL * min(3.0, max(1.0 / 3.0, abs((top - bottom) / (right - left))))
    figure = new_figure()
    figure.set_size_inches(_PANEL * columns + 2 * _MARGIN, height * rows + _MARGIN)
    figure.get_layout_engine().set(wspace=0.0, hspace=0.0, w_pad=0.01, h_pad=0.01)
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    for spare in grid[count:]:
        spare.remove()
    return np.array(grid[:count], dtype=object)


def _is_corner(panel: Any) -> bool:
    spec = panel.get_subplotspec()
    return spec is not None and bool(spec.is_first_col() and spec.is_last_row())


def _draw_beam(panel: Any, cube: Cube, extent: Extent) -> None:
    from matplotlib.patches import Ellipse

    covariance = beam_in_pixels(cube)
    if covariance is None:
        return
    left, right, bottom, top = extent
    pixel = np.array([(right - left) / cube.shape[1], (top - bottom) / cube.shape[0]])
    squares, axes = np.linalg.eigh(pixel * covariance * pixel[:, None])
    minor, major = np.sqrt(squares) / SIGMA
    place = np.array([left, bottom]) + _BESIDE * major * np.sign(pixel)
    angle = np.rad2deg(np.arctan2(axes[1, 1], axes[0, 1]))
    look = {"facecolor": "0.8", "edgecolor": "black", "gid": "beam"}
    panel.add_patch(Ellipse(place, major, minor, angle=angle, **look))
