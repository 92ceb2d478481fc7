"""An image with axes, a colour bar and a scale bar, drawn by matplotlib."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, cast

from ..figures import add_color_bar, new_figure
from .lengths import labelled, pretty_unit, round_length, with_unit
from .sky import has_lengths, is_linear, is_sky_axes, label_axes, plain_axes
from .tone import (
    OPTIONS,
    check_options,
    display,
    is_projection,
    one_channel,
    plain_options,
    shows_one_channel,
    with_colormap,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from .image import Image

Extent = tuple[float, float, float, float]
_BAR_PART = 0.25  # maximum length of a scale bar, in widths of the picture
_MARGIN = 0.05
_LONG_NUMBERS = (1e4, 1e6)  # longer ones become powers of ten


def plot(
    image: Image, ax: Axes | None, *, scale_bar: bool, colorbar: bool = True, **options: Any
) -> Axes:
    """Draw `image` into `ax`, or into a new figure; see `Image.plot`."""
    check_options("display option", options, OPTIONS)
    options = plain_options(options, image.intensity_unit)
    axes = new_axes(image) if ax is None else ax
    extent, labels = _coordinates(image, axes)
    place: dict[str, Any] = {"origin": "lower", "extent": extent}
    place["aspect"] = _aspect(image, extent)
    if shows_one_channel(image, options):
        drawn = axes.imshow(**one_channel(image, **options), **place)
        if ax is None and is_sky_axes(axes):
            # The layout reserves space for labels before it applies the fixed aspect, so a centred
            # picture would leave too little space for the bar.
            axes.set_anchor("W")
    else:
        shown = with_colormap(image.intensity, options, is_projection(image))
        drawn = axes.imshow(display(image.intensity, image.transparency, **shown), **place)
    if colorbar:
        add_bars(axes, image, options, drawn, own=ax is None)
    if labels:
        axes.set(xlabel=labels[0], ylabel=labels[1])
        _thin_out(axes, extent)
    else:
        label_axes(axes, image.wcs)
    if scale_bar and (image.wcs is None or has_lengths(image.wcs)):
        _add_scale_bar(axes, image, extent)
    return axes


def _coordinates(image: Image, axes: Axes) -> tuple[Extent, list[str]]:
    """Return the outer edges in axes coordinates, and labels; no labels for WCSAxes."""
    if image.wcs is not None and is_sky_axes(axes):
        ny, nx, _ = image.shape
        return (-0.5, nx - 0.5, -0.5, ny - 0.5), []
    if image.wcs is not None and is_linear(image.wcs):
        return plain_axes(image.wcs)
    return image.extent, [labelled("x", image.unit), labelled("y", image.unit)]


def _thin_out(axes: Axes, extent: Extent) -> None:
    """Reduce the number of ticks along x where long tick labels would overlap."""
    from matplotlib.ticker import AutoLocator

    locator, (low, high) = axes.xaxis.get_major_locator(), _LONG_NUMBERS
    if isinstance(locator, AutoLocator) and low <= max(map(abs, extent[:2])) < high:
        locator.set_params(nbins=4)


def _aspect(image: Image, extent: Extent) -> float:
    if extent == image.extent:
        return 1.0
    left, right, bottom, top = extent
    x0, x1, y0, y1 = image.extent
    return abs((y1 - y0) / (x1 - x0) * (right - left) / (top - bottom))


def new_axes(image: Image, figure: Any = None, *place: int) -> Axes:
    """Return axes for an image, in a new figure or at a position in `figure`."""
    figure = new_figure() if figure is None else figure
    if image.wcs is None:
        return cast("Axes", figure.add_subplot(*place))
    from astropy.visualization.wcsaxes import WCSAxes

    return cast("Axes", figure.add_subplot(*place, axes_class=WCSAxes, wcs=image.wcs))


def intensity_label(image: Image) -> str:
    """Return the label of a colour bar: the quantity, with its unit."""
    name = str((image.provenance or {}).get("map", "intensity"))
    return labelled(name, pretty_unit(image.intensity_unit))


def add_bars(
    axes: Any, image: Image, options: dict[str, Any], drawn: Any, *, own: bool, **known: Any
) -> None:
    """Add a colour bar of the single channel drawn, or else of each scalar of the medium.

    Parameters
    ----------
    axes : matplotlib Axes or list of them
        Axes that give up space for the bars.
    image, options, **known
        As for `scales_of`.
    drawn : matplotlib AxesImage
    own : bool
        As for `add_color_bar`.
    """
    from .annotate.scales import scales_of

    if shows_one_channel(image, options):
        bars = [(drawn, intensity_label(image))]
    else:
        bars = [(scale.mappable, scale.label) for scale in scales_of(image, options, **known)]
    for number, (mappable, label) in enumerate(bars):
        bar = add_color_bar(axes, mappable, label, own=own, number=number)
        # Transparent parts of the bar look as dark as in the picture.
        bar.ax.set_facecolor(options.get("background") or "black")


def _add_scale_bar(axes: Axes, image: Image, extent: Extent) -> None:
    from matplotlib.patheffects import withStroke

    left, right, bottom, top = extent
    width, height = right - left, top - bottom
    shown = image.extent[1] - image.extent[0]
    length = round_length(_BAR_PART * abs(shown))
    start = left + _MARGIN * width
    level = bottom + _MARGIN * height
    # White with a dark outline is legible on any picture.
    rim: dict[str, Any] = {"path_effects": [withStroke(linewidth=4, foreground="black", alpha=0.6)]}
    end = start + width * length / abs(shown)
    axes.plot([start, end], [level, level], color="white", linewidth=2, gid="scale-bar", **rim)
    axes.annotate(
        with_unit(length, image.unit),
        ((start + end) / 2, level),
        xytext=(0, 4),
        textcoords="offset points",
        color="white",
        ha="center",
        va="bottom",
        **rim,
    )
