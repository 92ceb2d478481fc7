"""A page of channel maps: one panel for each channel, with one colour scale."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError
from ..figures import new_figure
from ..units import UnitLike
from .beam import fits_beam
from .image import Image
from .lengths import labelled, pretty_unit, readable
from .plot import add_scale_bar
from .sky import radians_per_unit
from .tone import OPTIONS, check_options, one_channel, signed_exposure

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .cube import Cube

_PANEL, _MARGIN = 1.9, 1.0  # inches
# More columns than rows, by this factor; so many panels are in one row.
_FLAT, _IN_A_ROW = 1.3, 4
_COLORMAP = "inferno"
_DIGITS = {"velocity": (1.0, "km/s"), "frequency": (1e-9, "GHz"), "wavelength": (1.0, "µm")}


def plot_maps(
    cube: Cube,
    ax: Any,
    *,
    unit: UnitLike,
    scale_bar: bool,
    colorbar: bool,
    **options: Any,
) -> NDArray[Any]:
    """Draw all channels; see `Cube.plot`."""
    from matplotlib.patheffects import withStroke
    from matplotlib.ticker import MaxNLocator

    check_options("display option", options, OPTIONS)
    shown = cube if unit is None else cube.to(unit)
    shown, size, name = _in_readable_unit(shown)
    if not any(options.get(o) is not None for o in ("colormap", "norm", "background")):
        options["colormap"] = None if signed_exposure(shown.intensity) else _COLORMAP
    together = Image(shown.intensity.reshape(-1, 1), intensity_unit=shown.intensity_unit)
    look = one_channel(together, **options)
    panels = _panels(shown, ax)
    left, right, bottom, top = (size * edge for edge in shown.extent)
    extent, drawn = (left, right, bottom, top), None
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
    corner.set(xlabel=labelled("x", name), ylabel=labelled("y", name))
    _draw_beam(corner, shown, size)
    if scale_bar:
        add_scale_bar(panels[-1], shown, extent)
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


def _in_readable_unit(cube: Cube) -> tuple[Cube, float, str]:
    """Return the cube, in angles if they are known, and the factor and name of a readable unit."""
    shown = cube if radians_per_unit(cube) is None else cube.to("arcsec")
    width = max(abs(shown.extent[1] - shown.extent[0]), abs(shown.extent[3] - shown.extent[2]))
    return shown, *readable(width, shown.unit)


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


def _draw_beam(panel: Any, cube: Cube, size: float) -> None:
    """Draw the beam into the lower left corner."""
    from matplotlib.patches import Ellipse

    beam, scale = fits_beam(cube), radians_per_unit(cube)
    if beam is None or scale is None:
        return
    major, minor = (size * math.radians(width) / scale for width in beam[:2])
    left, _, bottom, _ = (size * edge for edge in cube.extent)
    side = 0.7 * major
    direction = np.sign(cube.extent[1] - cube.extent[0])
    panel.add_patch(
        Ellipse(
            (left + direction * side, bottom + side),
            minor,
            major,
            angle=beam[2],
            facecolor="0.8",
            edgecolor="black",
            gid="beam",
        )
    )
