"""Images side by side with a common unit, exposure or colour scale, and colour bar."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError, check_flag
from ..figures import new_figure
from ..units import is_listed
from .cube import Cube
from .image import Image
from .plot import add_bars, new_axes
from .scales import scales_of
from .tone import (
    OPTIONS,
    automatic_exposure,
    check_options,
    mixed_channels,
    one_channel,
    plain_options,
    shows_one_channel,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ..units import UnitLike
    from .scales import Scale

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
