"""Suggest a medium for a volume: main scalar, levels, noise, and detection of labels."""

from __future__ import annotations

import math
import re
import sys
from numbers import Real
from typing import Any

import numpy as np

from ..colormaps import get_colormap, mapped_colors
from ..errors import InputError
from ..expressions import Expression
from ..media import Gaussian, Medium, Sum
from ..volume import Volume
from .histogram import Histogram, histogram, is_constant, sampled_values
from .labels import labelled, labels_of
from .open_numbers import check_volume, nothing_to_see
from .samples import measurable
from .thickness import Profile, Thickness, thicknesses

# --- the main scalar --------------------------------------------------------------------------

# Names of the main field in simulations, in order of preference.
_FIRST = ("density", "gas_density", "rho", "dens", "number_density", "n", "nh", "n_h")
_COMPONENT = re.compile(
    r"[xyz]_.*|.*_([xyzr]|theta|phi)|(v|vel|velocity|u|b|bcc|mag|mom|e|acc)_?[xyz123]", re.I
)
# Coordinates stored with telescope cubes.
_COORDINATE = re.compile(r"velocity|frequency|wavelength|wavenumber|redshift", re.I)
_BINS = 64


def main_scalar(volume: Volume) -> Expression:
    """Return the main field of a volume.

    It is the field called density, rho, … if there is one; else the field with the greatest entropy
    of its histogram (linear or logarithmic, as it will be shown). Vector components, and velocity
    or frequency in a spectral cube, are left out if there are other fields.
    """
    if not volume.fields:
        raise InputError("the volume has no fields; add one: volume['density'] = array")
    lower = {name.lower(): name for name in reversed(volume.fields)}
    names = [lower[name] for name in _FIRST if name in lower][:1] or list(volume.fields)
    for pattern in (_COMPONENT, _COORDINATE):
        names = [name for name in names if not pattern.fullmatch(name)] or names
    if len(names) == 1:
        return Expression(names[0])
    volume = measurable(volume)
    return max(map(Expression, names), key=lambda expr: _entropy(sampled_values(volume, expr)))


def _entropy(values: np.ndarray) -> float:
    """Return the entropy of a histogram in bits; negative if there is no value."""
    if is_wide(values):
        values = np.log10(values[values > 0])
    if not len(values):
        return -1.0
    if is_constant(values[0], values[-1]):
        return 0.0
    counts = np.histogram(values, _BINS, (float(values[0]), float(values[-1])))[0]
    part = counts[counts > 0] / counts.sum()
    return float(-(part * np.log2(part)).sum())


# Data that spans more than so many decades is shown logarithmically …
_DECADES = 2.0
# … between these quantiles of its positive values (the upper one keeps compact cores) …
_LEAST, _GREATEST = 0.05, 1 - 1e-4
# … unless the top decade holds more than _SHARE / (number of decades) of the cells: then the
# materials are in that decade, and lower values are the faint outskirts of their boundaries.
_SHARE = 1.2
# If more than _FLOOR of the cells have the least value (to a relative _SAME), they are empty.
_FLOOR, _SAME = 0.05, 1e-3
# Up to this fraction, negative values are noise around zero; more are significant.
_NEGATIVE = 1e-3


def is_wide(values: np.ndarray) -> bool:
    """Return True if sorted values should be shown logarithmically.

    This requires nearly no negative values, a span of more than two decades, and a top decade that
    does not dominate. Zeros and the value of empty cells are ignored.
    """
    positive = values[np.searchsorted(values, 0.0, "right") :]
    if not len(positive) or np.searchsorted(values, 0.0, "left") > _NEGATIVE * len(values):
        return False
    empty = int(np.searchsorted(positive, positive[0] * (1 + _SAME), "right"))
    positive = positive[empty if empty > _FLOOR * len(positive) else 0 :]
    if not len(positive):
        return False
    low, high = (float(positive[int(q * (len(positive) - 1))]) for q in (_LEAST, _GREATEST))
    decades = float(np.log10(high) - np.log10(low))
    top = 1.0 - float(np.searchsorted(positive, 0.1 * high)) / len(positive)
    return decades > _DECADES and top * decades < _SHARE


# --- noise ------------------------------------------------------------------------------------

# Least number of negative values for a noise estimate.
_ENOUGH = 100
# Accepted range of median / root mean square of the negative values: 0.67 for Gaussian noise, less
# for non-uniform noise; 0.87 for a uniform distribution, 1 for a second material.
_MEDIAN = (0.45, 0.75)
# Noise has no values beyond _FARTHEST σ; the greatest value of the data exceeds the most negative
# one by a factor _ABOVE.
_FARTHEST, _ABOVE = 10.0, 2.0
# Noise is symmetric: near zero, positive values are at least as many as negative ones (up to chance
# if all values are noise).
_SYMMETRIC = 0.9


def noise_of(values: np.ndarray) -> float:
    """Return the σ of the noise around zero in sorted values; zero if negative values mean more.

    The noise is assumed symmetric, and all negative values to be noise: σ² is their mean square.
    """
    zero = int(np.searchsorted(values, 0.0, "left"))
    if zero < _ENOUGH:
        return 0.0
    below = -values[:zero].astype(np.float64)
    farthest, median = float(below[0]), float(np.median(below))
    # Divide by the farthest value so that squares do not overflow or underflow in any unit.
    sigma = farthest * float(np.sqrt(np.mean((below / farthest) ** 2)))
    beside = np.searchsorted(values, [-sigma, sigma])
    is_noise = (
        _MEDIAN[0] * sigma < median < _MEDIAN[1] * sigma
        and farthest < _FARTHEST * sigma
        and float(values[-1]) > _ABOVE * farthest
        and beside[1] - zero > _SYMMETRIC * (zero - beside[0])
    )
    return sigma if is_noise else 0.0


# --- levels -----------------------------------------------------------------------------------

# Least area of an isosurface worth showing, as a fraction of the diagonal squared: that of a sphere
# with a diameter of a fiftieth of the diagonal.
_SEEN = 1e-3
# For data with one sign, levels below this quantile (by volume) are left out.
_LOWEST = 0.01
# Smoothing width of the steepness, as a fraction of the distance of levels.
_SMOOTHING = 0.12


def levels(
    found: Histogram, n: int, *, signed: bool = False, floor: float = 0.0
) -> tuple[np.ndarray, float]:
    """Return n increasing levels and their typical distance.

    The range of values whose isosurfaces are large enough to be seen is divided into n equal slots
    with one level each. The level maximizes the steepness of x, which is large where materials
    meet, times 1 - u² (u = ±1 at the ends of the slot), which keeps levels apart. If the steepness
    is a power law (no materials), all slots are alike and the levels are equally spaced.
    """
    large = np.flatnonzero(found.area >= min(_SEEN, 0.1 * found.area.max()))
    first, last = int(large[0]), int(large[-1])
    if not signed:
        below = np.cumsum(found.volume)
        first = min(max(first, int(np.searchsorted(below, _LOWEST * below[-1]))), last)
    low, high = float(found.edges[first]), float(found.edges[last + 1])
    if floor > 0:
        low = min(max(low, floor), 0.5 * (low + high))
    slot = (high - low) / n
    steep, x = found.steepness(_SMOOTHING * slot), found.centers
    middles = low + (np.arange(n) + 0.5) * slot
    u = (x - middles[:, None]) / (0.5 * slot)
    score = np.where(np.abs(u) < 1, steep * (1 - u * u), 0.0)
    return np.where(score.max(axis=1) > 0, x[score.argmax(axis=1)], middles), slot


# --- the medium -------------------------------------------------------------------------------

# More shells are indistinguishable and take minutes to compile.
_MOST_SHELLS = 100
# σ of a shell as a fraction of the distance of levels; thin enough to see between shells.
_SIGMA = 0.12
# The part of a colormap that is bright enough on black.
_COOL, _WARM = 0.12, 0.88
# Opacity of the largest shell as a fraction of that of the smallest.
_VEIL = 0.08
# Least level, in σ, for data with noise around zero: all cells of a volume together hold a few tens
# of noise peaks above it.
_NOISE = 4.0
# A closed shell is crossed twice.
_TWICE = 2.0


def suggest_medium(
    volume: Volume,
    expr: str | Expression | None = None,
    n: int = 4,
    *,
    opacity: float = 1.0,
    cmap: Any = "turbo",
) -> Medium:
    """Return a medium that shows a volume's structure: shells at the boundaries of materials.

    Parameters
    ----------
    volume : Volume
        The data.
    expr : str, optional
        Field or expression to show. By default the field called density, rho, …; else the one
        with the most structure.
    n : int
        Number of shells, at most 100.
    opacity : float
        Optical depth of one crossing of the smallest shell. Larger shells are more transparent,
        so that the inside is visible.
    cmap : str or matplotlib.colors.Colormap
        Colormap of the shells: cool colours for low values, warm ones for high values.

    Returns
    -------
    Medium
        A sum of `Gaussian` shells whose path lengths fit this volume, in ``expr`` or, where that is
        not negative and spans more than two decades, in ``log10(expr)``. For labels (up to
        256 whole numbers, each of many cells) `presets.labels`. The same data gives the same
        medium.

    Raises
    ------
    InputError
        If there is no field, or no finite value, or one value everywhere, or `expr` is neither text
        nor an expression, or `n` or `opacity` is not positive, or `volume` is no volume.
    UnknownNameError
        If there is no such field or colormap; names the nearest.

    Notes
    -----
    Levels are at maxima of the mean gradient as a function of the value (Kindlmann & Durkin 1998,
    "Semi-automatic generation of transfer functions for direct volume rendering"), one in each of
    n equal parts of the range of values whose isosurfaces are large enough to be seen. If negative
    values are noise around zero, as in telescope cubes, levels are above four σ. In volumes of more
    than 4 million cells, evenly spread cells are sampled; where a file has coarser levels, the
    finest of no more cells is measured instead, so that the rest need not be read: peaks and noise
    are smaller there.

    Examples
    --------
    >>> import voluminous as vm
    >>> core = vm.models.prestellar_core(32)
    >>> [shell.expr.text for shell in vm.suggest_medium(core, n=2).components()]
    ['log10(density)', 'log10(density)']
    """
    check_volume("suggest_medium", "first", volume)
    volume.refresh()  # derivatives of fields that were changed in place
    count: Any = n if isinstance(n, Real) else 0
    if not 1 <= count <= _MOST_SHELLS or int(count) != count:
        raise InputError(
            f"n must be a positive whole number of shells, {_MOST_SHELLS} at most, got {n!r}"
        )
    if not isinstance(opacity, Real) or not 0 < opacity <= sys.float_info.max:
        raise InputError(f"opacity must be positive and finite, one number, got {opacity!r}")
    whole, volume = volume, measurable(volume)
    scalar = main_scalar(volume) if expr is None else _expression(expr)
    values = sampled_values(volume, scalar)
    if not len(values):
        raise InputError(f"{scalar.text} has no finite value in this volume; look at another field")
    colormap = get_colormap(cmap)
    if (numbers := labels_of(whole, scalar, values)) is not None:
        changes = {} if opacity == 1.0 else {"opacities": 1.0 - math.exp(-opacity)}
        return labelled(whole, scalar, numbers, **changes)
    scalar, centers, sigma = _boundaries(volume, scalar, values, int(count))
    drafts = [Gaussian(scalar, float(center), sigma, 1.0, 1.0) for center in centers]
    positions = np.linspace(_WARM, _COOL, len(drafts))[::-1]  # a single one is warm
    unit = volume.expression_unit(scalar)
    profiles = [Profile(*draft.profile(unit, lambda: (0.0, 0.0))) for draft in drafts]
    shells = thicknesses(volume, scalar, profiles)
    depths = opacity * _depths(shells)
    components = tuple(
        draft.replace(
            color=(depth * color).tolist(), opacity=float(depth), path_length=shell.length
        )
        for draft, color, depth, shell in zip(
            drafts, mapped_colors(colormap, positions), depths, shells, strict=True
        )
    )
    return Sum(components) if len(components) > 1 else components[0]


def _expression(expr: Any) -> Expression:
    """Return the parsed expression; for an integer the error suggests ``n=``."""
    if isinstance(expr, (str, Expression)):
        return Expression(expr)
    shells = isinstance(expr, (int, np.integer)) and not isinstance(expr, bool) and expr > 0
    raise InputError(
        f"expr must be a field or an expression such as 'log10(density)', got {expr!r}"
        + (f"; for {expr} shells write n={expr}" if shells else "")
    )


def _boundaries(
    volume: Volume, expr: Expression, values: np.ndarray, n: int
) -> tuple[Expression, np.ndarray, float]:
    wide = is_wide(values)
    floor = _NOISE * noise_of(values)
    signed = bool(values[0] < 0) and not wide and not floor
    if wide:
        expr = Expression(f"log10({expr.text})")
        values = sampled_values(volume, expr)  # with the rounding of the cells, for the range
    if is_constant(values[0], values[-1]):
        raise nothing_to_see(expr, float(values[0]))
    centers, distance = levels(histogram(volume, expr, values), n, signed=signed, floor=floor)
    return expr, centers, _SIGMA * distance


def _depths(shells: list[Thickness]) -> np.ndarray:
    """Return the optical depth of a crossing of each shell.

    It rises geometrically from the largest shell to the smallest. It is divided by half the number
    of crossings if lines of sight cross a shell (noisy or volume-filling) more than twice.
    """
    order = np.argsort([-shell.area for shell in shells], kind="stable")
    rank = np.empty(len(shells))
    rank[order] = np.arange(1, len(shells) + 1) / len(shells)
    crossings = np.array([shell.crossings for shell in shells])
    return np.asarray(_VEIL ** (1 - rank) * np.minimum(1.0, _TWICE / np.maximum(crossings, _TWICE)))
