"""An image with axes, a colour bar and a scale bar, drawn by matplotlib."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, cast

from ..errors import check_flag
from ..figures import add_color_bar, new_figure
from ..units import pretty_unit
from .lengths import labelled, round_length, with_unit
from .sky import has_lengths, is_linear, is_sky_axes, label_axes, plain_axes
from .tone import OPTIONS, check_options, one_channel, shows_one_channel

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.image import AxesImage

    from .image import Image

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
