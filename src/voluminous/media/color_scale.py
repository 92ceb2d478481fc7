"""A colormap over a range of values: what a colour bar shows."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..colormaps import colormap_name, get_colormap, mapped_colors
from ..errors import InputError
from ..units import plain, unit_of
from .given import named, scalar, whole_number
from .norms import get_norm, values_at

# Entries that are taken from a map unless told otherwise.
SAMPLES = 256
_MOST_SAMPLES = 1 << 16


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
        self.position = np.linspace(0.0, 1.0, _entries(samples))
        self.values = values_at(self.position, norm, low, high)
        self.rgb = mapped_colors(get_colormap(cmap), self.position)
        self._described = _described(cmap, vmin, vmax, norm, samples)

    def describe(self) -> dict[str, Any]:
        """Return colormap, range and norm as plain values."""
        return dict(self._described)


class OpenRange:
    """What makes a `ColorScale`, of which an end of the range may be left to what is measured.

    Parameters
    ----------
    cmap, norm, samples
        As for `ColorScale`.
    vmin, vmax : float, Quantity or None
        Range of the values; that of a matplotlib norm, by default, if it has one.

    Raises
    ------
    UnknownNameError, InputError
        As `ColorScale`, as far as can be told.
    """

    def __init__(self, cmap: Any, vmin: Any, vmax: Any, norm: Any, samples: int) -> None:
        ends = (
            getattr(norm, what, None) if given is None else scalar(given, what)
            for what, given in (("vmin", vmin), ("vmax", vmax))
        )
        self.cmap, (self.vmin, self.vmax), self.norm, self.samples = cmap, ends, norm, samples
        self._scale: ColorScale | None = None
        if self.is_open:
            get_colormap(cmap)
            named_only = norm is None or isinstance(norm, str)
            get_norm(norm, *((1.0, 2.0) if named_only else (self.vmin, self.vmax)))
            _entries(samples)
        else:
            self._scale = ColorScale(cmap, self.vmin, self.vmax, norm, samples)

    @property
    def is_open(self) -> bool:
        """Whether something is to be measured."""
        return self.vmin is None or self.vmax is None

    @property
    def positive(self) -> bool:
        """Whether there are colours of positive values only."""
        return self.norm == "log" or type(self.norm).__name__ == "LogNorm"

    @property
    def scale(self) -> ColorScale:
        """The colours.

        Raises
        ------
        InputError
            If an end is not known.
        """
        if self._scale is None:
            raise InputError(
                "the range of these colours is measured in a volume: give vmin and vmax, or take "
                "medium.calibrated(volume)"
            )
        return self._scale

    def closed(self, low: float, high: float, unit: Any) -> OpenRange:
        """Return it with numbers in a unit for the ends that are not given."""
        first, last = (value if unit is None else value * unit for value in (low, high))
        vmin = first if self.vmin is None else self.vmin
        vmax = last if self.vmax is None else self.vmax
        return OpenRange(self.cmap, vmin, vmax, self.norm, self.samples)

    def describe(self) -> dict[str, Any]:
        """Return colormap, range and norm as plain values."""
        return _described(self.cmap, self.vmin, self.vmax, self.norm, self.samples)


def _entries(samples: Any) -> int:
    return whole_number(samples, "samples", 2, _MOST_SAMPLES)


def _described(cmap: Any, vmin: Any, vmax: Any, norm: Any, samples: int) -> dict[str, Any]:
    told = {
        "cmap": colormap_name(get_colormap(cmap)),
        "vmin": named(vmin),
        "vmax": named(vmax),
        "norm": norm if isinstance(norm, str) or norm is None else type(norm).__name__,
    }
    return told if samples == SAMPLES else {**told, "samples": int(samples)}
