"""Colormaps by name, from matplotlib, which is imported only when one is asked for."""

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
        raise unknown_name("colormap", colormap, matplotlib.colormaps)
    return matplotlib.colormaps[colormap]
