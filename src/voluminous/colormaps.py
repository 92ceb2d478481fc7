"""Colormaps and colours by name, from matplotlib, imported only when one is asked for."""

from __future__ import annotations

from typing import Any

from .errors import InputError, unknown_name


def get_colormap(colormap: Any) -> Any:
    """Return a matplotlib colormap by its name, or as it was given.

    Raises
    ------
    UnknownNameError
        If there is no such name.
    InputError
        If it is neither a name nor a colormap.
    """
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
    """Return the name of a colormap, marked if that of another one is registered under it.

    ``matplotlib.colormaps["viridis"].resampled(8)`` is called viridis, and is another map: nothing
    shall be drawn with the one where the other was meant.
    """
    import matplotlib

    name = str(colormap.name)
    known = matplotlib.colormaps.get(name)
    return name if known is None or known == colormap else f"{name} (changed)"


def get_color(name: str) -> tuple[float, float, float]:
    """Return red, green and blue of a colour: ``"orange"``, ``"#ffa500"``, ``"C1"``.

    Raises
    ------
    UnknownNameError
        If there is none of this name; names the nearest.
    """
    import matplotlib.colors

    try:
        red, green, blue = matplotlib.colors.to_rgb(name)
    except ValueError:
        raise unknown_name("color", name, matplotlib.colors.CSS4_COLORS) from None
    return float(red), float(green), float(blue)


def is_color(name: str) -> bool:
    """Return whether there is a colour of this name."""
    import matplotlib.colors

    return bool(matplotlib.colors.is_color_like(name))
