"""auto(): a good first medium for data of which nothing is known."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ..colormaps import get_colormap, mapped_colors
from ..errors import InputError
from ..expressions import Expression
from ..media import Gaussian, Medium, Rectangle, Sum
from ..media.shaped import Shaped
from ..volume import Volume
from .checks import check_volume, nothing_to_see, positive_opacity, shell_count
from .histogram import histogram, is_constant, sampled_values
from .labels import labels_of
from .levels import levels
from .noise import noise_of
from .profile import Profile
from .scalar import is_wide, main_scalar
from .thickness import Thickness, thicknesses

# σ of a shell as a part of the distance of levels: thin enough to look between them.
_SIGMA = 0.12
# The part of a colormap that is bright enough on black.
_COOL, _WARM = 0.12, 0.88
# Opacity of the largest shell as a part of that of the smallest.
_VEIL = 0.08
# Of data with noise around zero, what is below so many σ is not looked at: all of a volume's cells
# together hold a few tens of such peaks.
_NOISE = 4.0
# A closed shell is crossed twice.
_TWICE = 2.0
_GOLDEN = 0.5 * (5**0.5 - 1)


def auto(
    volume: Volume,
    expr: Any = None,
    n: int = 4,
    *,
    opacity: float = 1.0,
    cmap: Any = "turbo",
) -> Medium:
    """Return a medium that shows what there is in a volume: shells at the boundaries of materials.

    Parameters
    ----------
    volume : Volume
        The data.
    expr : str, optional
        Field or expression to look at. By default the field called density, rho, …; else the one
        with the most structure.
    n : int
        Number of shells, at most 100.
    opacity : float
        Optical depth of one crossing of the smallest shell; larger ones are more transparent, so
        that the inside is seen.
    cmap : str or matplotlib.colors.Colormap
        Where the colours are from, cool for low and warm for high values.

    Returns
    -------
    Medium
        A sum of `Gaussian` shells whose path lengths fit this volume, in ``expr`` or, where that is
        not negative and spans more than two decades, in ``log10(expr)``. For labels (few whole
        numbers without gaps) one `Rectangle` for each but the background, which `render` draws cell
        by cell (``scheme="first-order"``). The same data gives the same medium.

    Raises
    ------
    InputError
        If there is no field, or no finite value, or one value everywhere, or `expr` is neither text
        nor an expression, or `n` or `opacity` is not positive, or `volume` is no volume.
    UnknownNameError
        If there is no such field or colormap; names the nearest.

    Notes
    -----
    Levels are where the mean gradient as a function of the value is greatest (Kindlmann & Durkin
    1998, "Semi-automatic generation of transfer functions for direct volume rendering"), one in
    each of n equal parts of the range of values whose isosurfaces are large enough to be seen.
    Where negative values are noise around zero, as in cubes of telescopes, levels are above four σ.
    Of more than 4 million cells, evenly spread parts are looked at.

    Examples
    --------
    >>> import voluminous as vm
    >>> core = vm.models.prestellar_core(32)
    >>> [shell.expr.text for shell in vm.auto(core, n=2).components()]
    ['log10(density)', 'log10(density)']
    """
    check_volume("auto", "first", volume)
    volume.refresh()  # derivatives of fields that were changed in place
    count, depth = shell_count(n), positive_opacity(opacity)
    scalar = main_scalar(volume) if expr is None else _expression(expr)
    values = sampled_values(volume, scalar)
    if not len(values):
        raise InputError(f"{scalar.text} has no finite value in this volume; look at another field")
    color = get_colormap(cmap)
    shells, positions = _shells(volume, scalar, values, count)
    colors = mapped_colors(color, positions)
    return _lit(volume, shells, colors, depth)


def _expression(expr: Any) -> Expression:
    """Return the expression in a text; a number is more likely that of the shells."""
    if isinstance(expr, (str, Expression)):
        return Expression(expr)
    shells = isinstance(expr, (int, np.integer)) and not isinstance(expr, bool) and expr > 0
    raise InputError(
        f"expr must be a field or an expression such as 'log10(density)', got {expr!r}"
        + (f"; for {expr} shells write n={expr}" if shells else "")
    )


def _shells(
    volume: Volume, expr: Expression, values: np.ndarray, n: int
) -> tuple[list[Callable[..., Shaped]], np.ndarray]:
    """Return what makes each shell of color, opacity and path length, and places in a colormap."""
    labels = labels_of(volume, expr, values)
    if labels is not None:
        # The golden ratio keeps the colours of neighbouring numbers apart.
        positions = _WARM - (_WARM - _COOL) * (np.arange(len(labels)) * _GOLDEN % 1.0)
        return [_label(expr, label) for label in labels], positions
    wide = is_wide(values)
    floor = _NOISE * noise_of(values)
    signed = bool(values[0] < 0) and not wide and not floor
    if wide:
        expr = Expression(f"log10({expr.text})")
        values = sampled_values(volume, expr)  # rounded as they are in cells: ends of the range
    if is_constant(values[0], values[-1]):
        raise nothing_to_see(expr, float(values[0]))
    centers, distance = levels(histogram(volume, expr, values), n, signed=signed, floor=floor)
    positions = np.linspace(_WARM, _COOL, n)[::-1]  # a single one is warm
    return [_shell(Gaussian, expr, center, _SIGMA * distance) for center in centers], positions


def _shell(kind: Any, expr: Expression, center: float, width: float) -> Callable[..., Shaped]:
    return lambda color, opacity, length: kind(expr, float(center), width, color, opacity, length)


def _label(expr: Expression, label: float) -> Callable[..., Shaped]:
    def make(color: Any, opacity: Any, length: Any) -> Shaped:
        return _Label(expr, float(label), 0.5, color, opacity, length)

    return make


class _Label(Rectangle):
    """One label: between two there are no others."""

    discrete = True

    def describe(self) -> dict[str, Any]:
        return {**super().describe(), "type": "rectangle"}


def _lit(
    volume: Volume, shells: list[Callable[..., Shaped]], colors: np.ndarray, opacity: float
) -> Medium:
    """Return the sum of shells, each as opaque as its size and its crossings allow."""
    drafts = [make(1.0, 1.0, "auto") for make in shells]
    unit = volume.expression_unit(drafts[0].expr)
    profiles = [Profile(*draft.profile(unit, None)) for draft in drafts]
    found = thicknesses(volume, drafts[0].expr, profiles)
    depths = opacity * _depths(found)
    parts = tuple(
        make((depth * color).tolist(), float(depth), shell.length)
        for make, color, depth, shell in zip(shells, colors, depths, found, strict=True)
    )
    return Sum(parts) if len(parts) > 1 else parts[0]


def _depths(found: list[Thickness]) -> np.ndarray:
    """Return the optical depth of a crossing of each shell.

    It rises geometrically from the largest shell to the smallest. One that lines of sight cross
    many times, because it is noisy or fills the volume, becomes so much fainter.
    """
    order = np.argsort([-shell.area for shell in found], kind="stable")
    rank = np.empty(len(found))
    rank[order] = np.arange(1, len(found) + 1) / len(found)
    crossings = np.array([shell.crossings for shell in found])
    return _VEIL ** (1 - rank) * np.minimum(1.0, _TWICE / np.maximum(crossings, _TWICE))
