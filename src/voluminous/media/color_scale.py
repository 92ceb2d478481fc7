"""A colormap over a range of values: what a colour bar shows."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..colormaps import colormap_name, get_colormap
from ..errors import InputError
from ..units import plain, unit_of
from .given import named, scalar
from .norms import values_at

# Entries that are taken from a map unless told otherwise.
SAMPLES = 256


class ColorScale:
    """Colours of a matplotlib colormap at increasing values; those of the ends go on beyond.

    Parameters
    ----------
    cmap : str or matplotlib.colors.Colormap
        Name or object; its RGB become three channels.
    vmin, vmax : float or Quantity
        Range of the values.
    norm : str or matplotlib.colors.Normalize, optional
        How values map to positions in the colormap.
    samples : int
        Number of entries taken from the map.

    Attributes
    ----------
    position, values : array, shape (samples,)
        Places in the map from 0 to 1, and the values that map there, in `unit`.
    unit : astropy unit or None
        The unit of the values.
    rgb : array, shape (samples, 3)
        Red, green and blue there, from 0 to 1.

    Raises
    ------
    UnknownNameError
        If there is no such colormap or norm.
    InputError
        If the range is empty, or the norm cannot be applied to it.
    """

    def __init__(self, cmap: Any, vmin: Any, vmax: Any, norm: Any, samples: int) -> None:
        vmin, vmax = scalar(vmin, "vmin"), scalar(vmax, "vmax")
        self.unit = unit_of(vmin) or unit_of(vmax)
        low, high = plain(vmin, self.unit, "vmin"), plain(vmax, self.unit, "vmax")
        if not low < high:
            raise InputError(f"vmin must be below vmax, got {vmin} and {vmax}")
        if int(samples) != samples or samples < 2:
            raise InputError(f"samples must be a whole number of at least 2, got {samples!r}")
        colormap = get_colormap(cmap)
        self.position = np.linspace(0.0, 1.0, int(samples))
        self.values = values_at(self.position, norm, low, high)
        self.rgb = np.asarray(colormap(self.position), dtype=np.float64)[:, :3]
        self._described = {
            "cmap": colormap_name(colormap),
            "vmin": named(vmin),
            "vmax": named(vmax),
            "norm": norm if isinstance(norm, str) or norm is None else type(norm).__name__,
        }
        if samples != SAMPLES:
            self._described["samples"] = int(samples)

    def describe(self) -> dict[str, Any]:
        """Return colormap, range and norm as plain values."""
        return dict(self._described)
