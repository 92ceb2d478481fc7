"""Colormaps and norms from matplotlib, which is imported only when one is asked for."""

from __future__ import annotations

from typing import Any

from ..errors import InputError, unknown_name


def get_colormap(cmap: Any) -> Any:
    """Return a matplotlib colormap from its name or itself.

    Raises
    ------
    UnknownNameError
        If there is none of that name.
    """
    import matplotlib

    if not isinstance(cmap, str):
        return cmap
    if cmap not in matplotlib.colormaps:
        raise unknown_name("colormap", cmap, matplotlib.colormaps)
    return matplotlib.colormaps[cmap]


def get_norm(norm: Any, vmin: float, vmax: float) -> Any:
    """Return an invertible matplotlib norm over a range, from its name (default linear) or itself.

    Raises
    ------
    UnknownNameError
        If there is no scale of that name.
    InputError
        If the range does not suit it (a logarithm of something not positive).
    """
    from matplotlib import colors

    named = {
        "linear": colors.Normalize,
        "log": colors.LogNorm,
        "symlog": lambda a, b: colors.SymLogNorm(1e-3 * max(abs(a), abs(b)), vmin=a, vmax=b),
        "asinh": lambda a, b: colors.AsinhNorm(1e-3 * max(abs(a), abs(b)), vmin=a, vmax=b),
    }
    if norm is None or isinstance(norm, str):
        name = norm or "linear"
        if name not in named:
            raise unknown_name("norm", name, named)
        if name == "log" and vmin <= 0:
            raise InputError(f"a logarithmic norm needs a positive vmin, got {vmin:g}")
        return named[name](vmin, vmax)
    norm.vmin = vmin if norm.vmin is None else norm.vmin
    norm.vmax = vmax if norm.vmax is None else norm.vmax
    return norm
