"""Colormaps and colours by name, from matplotlib, imported only when one is asked for."""

from __future__ import annotations

from numbers import Real
from typing import Any

import numpy as np

from .errors import InputError, unknown_name


def get_colormap(colormap: Any) -> Any:
    """Return a matplotlib colormap by its name, or as it was given."""
    import matplotlib

    if isinstance(colormap, matplotlib.colors.Colormap):
        return colormap
    if not isinstance(colormap, str):
        raise InputError(f"a colormap must be a name or a matplotlib colormap, got {colormap!r}")
    if colormap not in matplotlib.colormaps:
        colors = () if is_color(colormap) else matplotlib.colors.CSS4_COLORS
        raise unknown_name("colormap", colormap, matplotlib.colormaps, other=("color", colors))
    return matplotlib.colormaps[colormap]


def colormap_name(colormap: Any) -> str:
    """Return the name of a colormap, marked if another one is registered under it.

    ``matplotlib.colormaps["viridis"].resampled(8)``, for example, is called viridis.
    """
    import matplotlib

    name = str(colormap.name)
    known = matplotlib.colormaps.get(name)
    return name if known is None or known == colormap else f"{name} (changed)"


def get_color(name: str) -> tuple[float, float, float]:
    """Return red, green and blue of a colour: ``"orange"``, ``"#ffa500"``, ``"C1"``."""
    import matplotlib.colors

    if not is_color(name):
        raise unknown_name("color", name, matplotlib.colors.CSS4_COLORS)
    return opaque_color(name, repr(name))


def opaque_color(color: Any, what: str, other: str = "") -> tuple[float, float, float]:
    """Return red, green and blue of any color that matplotlib knows."""
    import matplotlib.colors

    try:
        rgba = matplotlib.colors.to_rgba(color)
    except ValueError:
        raise InputError(
            f"{what} must be {other}a color such as 'white', '#203040' or (r, g, b) from 0 to 1; "
            f"got {color!r}"
        ) from None
    red, green, blue = without_alpha(rgba, what)
    return float(red), float(green), float(blue)


def is_name_and_alpha(color: Any) -> bool:
    """Return whether it is what matplotlib writes as ``("red", 0.5)``."""
    pair = isinstance(color, tuple) and len(color) == 2
    return pair and isinstance(color[0], str) and isinstance(color[1], Real)


def without_alpha(colors: Any, what: str) -> Any:
    """Return colours without matplotlib's alpha; what are no such colours as they are.

    Four numbers from 0 to 1, in a tuple or an array, are red, green, blue and alpha, as matplotlib
    writes them. In a list they are that if the last is 1, or that of each of several; else they are
    four channels.
    """
    if is_name_and_alpha(colors):
        return without_alpha((*get_color(colors[0]), colors[1]), what)
    if isinstance(colors, list):
        if _is_opaque(colors):
            return colors[:3]
        if all(map(_is_opaque, colors)):
            return [color[:3] for color in colors]
        return [c if isinstance(c, list) else without_alpha(c, what) for c in colors]
    if not isinstance(colors, (tuple, np.ndarray)) or hasattr(colors, "unit"):
        return colors
    try:
        array = np.asarray(colors, dtype=np.float64)
    except (TypeError, ValueError):  # of different lengths, or with names or units in it
        return colors
    if array.ndim == 0 or array.shape[-1] != 4 or not np.all((array >= 0.0) & (array <= 1.0)):
        return colors
    if not np.all(array[..., 3] == 1.0):
        raise InputError(
            f"{what}: a colour has no opacity here, got alpha {array[..., 3].min():g}; give red, "
            "green and blue, and how opaque it is with opacity=…. Four channels are given as a list"
        )
    return array[..., :3]


def _is_opaque(color: Any) -> bool:
    if not isinstance(color, (list, tuple, np.ndarray)) or len(color) != 4:
        return False
    return all(isinstance(c, Real) and 0.0 <= float(c) <= 1.0 for c in color) and color[3] == 1.0


def mapped_colors(colormap: Any, positions: Any) -> np.ndarray:
    """Return red, green and blue at places from 0 to 1 in a matplotlib colormap, shape (n, 3)."""
    found = np.asarray(colormap(positions), dtype=np.float64)
    return np.asarray(without_alpha(found, f"colormap {colormap.name!r}"))


def is_color(name: str) -> bool:
    """Return whether there is a colour of this name."""
    import matplotlib.colors

    return bool(matplotlib.colors.is_color_like(name))
