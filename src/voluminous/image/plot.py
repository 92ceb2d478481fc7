"""An image with axes, a colour bar and a scale bar, drawn by matplotlib."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from ..errors import InputError, check_flag
from ..figures import add_color_bar, new_figure
from ..units import UnitLike, is_listed, pretty_unit
from .conversion import SIGMA, beam_in_pixels, sky_matrix
from .cube import Cube
from .image import Image
from .lengths import labelled, readable, round_length, with_unit
from .scales import scales_of
from .sky import has_lengths, is_linear, is_sky_axes, label_axes, plain_axes, radians_per_unit
from .tone import (
    OPTIONS,
    automatic_exposure,
    check_options,
    mixed_channels,
    one_channel,
    plain_options,
    shows_one_channel,
    signed_exposure,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.image import AxesImage
    from numpy.typing import NDArray

    from ..units import UnitLike
    from .scales import Scale

_BAR_PART = 0.25  # maximum length of a scale bar, in widths of the picture
_MARGIN = 0.05
_LONG_NUMBERS = (1e4, 1e6)  # longer ones become powers of ten


def plot(
    image: Image, ax: Axes | None, *, scale_bar: Any, colorbar: bool = True, **options: Any
) -> Axes:
    """Draw `image` into `ax`, or into a new figure; see `Image.plot`."""
    from matplotlib.ticker import AutoLocator

    check_options("display option", options, OPTIONS)
    axes = new_axes(image) if ax is None else ax
    wcs, extent = image.wcs, image.extent
    labels = [labelled(name, image.unit) for name in "xy"]
    on_sky = wcs is not None and is_sky_axes(axes)
    if on_sky:
        ny, nx, _ = image.shape
        extent = (-0.5, nx - 0.5, -0.5, ny - 0.5)
    elif wcs is not None and is_linear(wcs):
        extent, labels = plain_axes(wcs)
    aspect = 1.0
    if extent != image.extent:  # a unit of the plane is as long along x as along y
        (left, right, bottom, top), (x0, x1, y0, y1) = extent, image.extent
        aspect = abs((y1 - y0) / (x1 - x0) * (right - left) / (top - bottom))
    place: dict[str, Any] = {"origin": "lower", "extent": extent, "aspect": aspect}
    if shows_one_channel(image, options):
        drawn = axes.imshow(**one_channel(image, **options), **place)
        if ax is None and is_sky_axes(axes):
            # The layout reserves space for labels before it applies the fixed aspect, so a centred
            # picture would leave too little space for the bar.
            axes.set_anchor("W")
    else:
        drawn = axes.imshow(image.to_rgb(**options), **place)
    check_flag("colorbar", colorbar)
    if colorbar:
        add_bars(axes, image, options, drawn, own=ax is None)
    if on_sky:
        label_axes(axes, image.wcs)
    else:
        axes.set(xlabel=labels[0], ylabel=labels[1])
        locator, (low, high) = axes.xaxis.get_major_locator(), _LONG_NUMBERS
        if isinstance(locator, AutoLocator) and low <= max(map(abs, extent[:2])) < high:
            locator.set_params(nbins=4)  # or long tick labels would overlap
    if wcs is None or has_lengths(wcs):
        add_scale_bar(axes, image, extent, scale_bar)
    return axes


def new_axes(image: Image, figure: Any = None, *place: int) -> Axes:
    """Return axes for an image, in a new figure or at a position in `figure`."""
    figure = new_figure() if figure is None else figure
    if image.wcs is None:
        return cast("Axes", figure.add_subplot(*place))
    from astropy.visualization.wcsaxes import WCSAxes

    return cast("Axes", figure.add_subplot(*place, axes_class=WCSAxes, wcs=image.wcs))


def add_bars(
    axes: Axes | list[Axes],
    image: Image,
    options: dict[str, Any],
    drawn: AxesImage,
    *,
    own: bool,
    **known: Any,
) -> None:
    """Add a colour bar of the single channel drawn, or else of each scalar of the medium.

    Axes give up space for the bars; `known` are further arguments of `scales_of`.
    """
    from .scales import scales_of

    bars: list[tuple[Any, str]]
    if shows_one_channel(image, options):
        name = str((image.provenance or {}).get("map", "intensity"))
        bars = [(drawn, labelled(name, pretty_unit(image.intensity_unit)))]
    else:
        bars = [(scale.mappable, scale.label) for scale in scales_of(image, options, **known)]
    for number, (mappable, label) in enumerate(bars):
        bar = add_color_bar(axes, mappable, label, own=own, number=number)
        # Transparent parts of the bar look as dark as in the picture.
        bar.ax.set_facecolor(options.get("background") or "black")


def add_scale_bar(
    axes: Axes, image: Image, extent: tuple[float, float, float, float], wanted: Any
) -> None:
    """Draw a bar into axes that show the image in `extent`: of a round length, or as wanted."""
    from matplotlib.patheffects import withStroke

    from .annotate.marks import scale_bar_of

    if wanted is None or wanted is False:
        return
    left, right, bottom, top = extent
    shown = abs(image.extent[1] - image.extent[0])
    length = round_length(_BAR_PART * shown)
    text = with_unit(length, image.unit)
    if wanted is not True and (given := scale_bar_of(image, wanted)) is not None:
        length, text = given
    start, level = left + _MARGIN * (right - left), bottom + _MARGIN * (top - bottom)
    end = start + (right - left) * length / shown
    # White with a dark outline is legible on any picture.
    look: dict[str, Any] = {"path_effects": [withStroke(linewidth=4, foreground="k", alpha=0.6)]}
    look["color"] = "white"
    axes.plot([start, end], [level, level], linewidth=2, gid="scale-bar", **look)
    axes.annotate(
        text,
        ((start + end) / 2, level),
        xytext=(0, 4),
        textcoords="offset points",
        ha="center",
        va="bottom",
        **look,
    )


Extent = tuple[float, float, float, float]  # left, right, bottom, top

_MAP, _AROUND = 1.9, 1.0  # inches
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
    height = _MAP * min(3.0, max(1.0 / 3.0, abs((top - bottom) / (right - left))))
    figure = new_figure()
    figure.set_size_inches(_MAP * columns + 2 * _AROUND, height * rows + _AROUND)
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


_PANEL = 4.0  # inches
# Options that define the norm of one channel.
_OF_NORM = ("exposure", "stretch", "softening", "vmin", "vmax", "channels")


def plot_row(
    images: Sequence[Image],
    ax: Any = None,
    *,
    titles: Sequence[str] = (),
    unit: UnitLike = None,
    scale_bar: Any = False,
    colorbar: bool = True,
    **options: Any,
) -> NDArray[Any]:
    """Draw images side by side, so that equal colours mean equal intensities.

    All images have the same unit, the same exposure (or, with one channel each, the same range of
    values), and one colour bar at the end of the row.

    Parameters
    ----------
    images : sequence of Image
        With equal numbers of channels.
    ax : sequence of matplotlib Axes, optional
        One for each image, in any arrangement. Default: a row in a new figure.
    titles : sequence of str, optional
        One for each image.
    unit : str or unit, optional
        As in `Image.plot`. Default: the units of the first image.
    scale_bar : bool, Quantity, str or float
        Add a bar to each, as in `Image.plot`.
    colorbar : bool
        Add a colour bar; if the media of the images differ, one for each image.
    **options
        Those of `Image.to_rgb`.

    Returns
    -------
    array of matplotlib Axes
        ``axes[0].figure.savefig(...)`` writes the figure.

    Raises
    ------
    InputError
        If the numbers of images, axes, titles or channels do not match.
    UnitsError
        If an image cannot be converted to the unit of the first.
    """
    if not is_listed(images):
        raise InputError(f"plot_row draws a list of images, got {images!r}")
    check_flag("colorbar", colorbar)
    shown = _in_one_unit(list(images), unit)
    check_options("display option", options, OPTIONS)
    if not any(options.get(name) is not None for name in ("channels", "mix", "colormap")):
        shown = [i.in_colors() if isinstance(i, Cube) and i.channels > 1 else i for i in shown]
    options = plain_options(options, shown[0].intensity_unit)
    pixels = [image.intensity.reshape(-1, 1, image.channels) for image in shown]
    together = Image(np.concatenate(pixels), intensity_unit=shown[0].intensity_unit)
    one = shows_one_channel(shown[0], options)
    common = dict(options)
    if one:
        drawn = one_channel(together, **options)
        common = {name: value for name, value in options.items() if name not in _OF_NORM}
        common |= {"channels": options.get("channels"), "norm": drawn["norm"]}
        common["colormap"] = drawn["cmap"]
    elif options.get("exposure") is None and options.get("vmax") is None:
        channels, mix = options.get("channels"), options.get("mix")
        _, brightest = mixed_channels(together.intensity, channels, mix)
        common["exposure"] = automatic_exposure(brightest)
    axes = _axes(shown, ax)
    if not is_listed(titles):
        raise InputError(f"titles are a list of texts, got {titles!r}")
    names = list(titles) or [""] * len(shown)
    if len(names) != len(shown):
        raise InputError(f"titles must be one for each of {len(shown)} images, got {len(names)}")
    scales = [scales_of(image, options) for image in shown] if colorbar and not one else [[]]
    separate = any(_differ(scales[0], others) for others in scales)
    alike = all(np.allclose(image.extent, shown[0].extent) for image in shown)
    for image, place, title in zip(shown, axes, names, strict=True):
        image.plot(place, scale_bar=scale_bar, colorbar=separate, **common)
        place.set_title(title)
        if alike:
            place.label_outer()
    if colorbar and not separate:
        rows = {round(float(a.get_position(original=True).y0), 6) for a in axes}
        beside = axes[-1] if len(rows) == 1 else list(axes)
        add_bars(beside, shown[0], common, axes[0].images[0], own=False)
    return axes


def _in_one_unit(images: list[Image], unit: UnitLike) -> list[Image]:
    if not images or not all(isinstance(image, Image) for image in images):
        raise InputError("plot_row needs a list of images, such as vm.plot_row([first, second])")
    shown = [image if unit is None else image.to(unit) for image in images]
    first = shown[0]
    for name in ("unit", "intensity_unit"):
        present = getattr(first, name)
        shown = [
            i.to(present) if present and getattr(i, name) not in (present, "") else i for i in shown
        ]
    if len({image.channels for image in shown}) > 1:
        counts = ", ".join(str(image.channels) for image in shown)
        raise InputError(f"images in a row must have as many channels each, got {counts}")
    return shown


def _axes(images: list[Image], given: Any) -> NDArray[Any]:
    count = len(images)
    if given is None:
        figure = new_figure()
        figure.set_size_inches(_PANEL * count + 0.8, _PANEL)
        given = [new_axes(image, figure, 1, count, k + 1) for k, image in enumerate(images)]
    axes = np.array(given, dtype=object).ravel()
    if len(axes) != count:
        raise InputError(f"ax must be one axes for each of {count} images, got {len(axes)}")
    return axes


def _differ(scales: list[Scale], others: list[Scale]) -> bool:
    if [s.label for s in scales] != [s.label for s in others]:
        return True
    places = np.linspace(0.0, 1.0, 64)
    return any(
        (a.norm.vmin, a.norm.vmax) != (b.norm.vmin, b.norm.vmax)
        or not np.array_equal(a.colormap(places), b.colormap(places))
        for a, b in zip(scales, others, strict=True)
    )
