"""Data that names instead of measuring: whole numbers, each of which stands for a thing."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np

from ..colormaps import get_colormap, mapped_colors
from ..errors import InputError
from ..expressions import Expression
from ..media import Gaussian, Medium, Rectangle, Sum
from ..media.profiles import Shaped
from ..volume import Volume
from .open_numbers import check_volume, nothing_to_see, positive_opacity, shell_count
from .samples import pieces
from .thickness import (
    Histogram,
    Profile,
    Thickness,
    histogram,
    is_constant,
    sampled_values,
    thicknesses,
)

_MOST = 64
# Labels are counted through: values with wider gaps are coarsely measured numbers.
_SPAN = 2


def labels_of(volume: Volume, expr: Expression, values: np.ndarray) -> np.ndarray | None:
    """Return the labels in a volume, without the one around them; None if it holds no labels.

    Labels are at least two and at most 64 whole numbers that fill more than half of their range.
    What the outermost cells hold most is the background.

    Parameters
    ----------
    volume : Volume
        All of it is looked at if its samples look like labels: some things are small.
    expr : Expression
        The scalar.
    values : array
        Samples of it, sorted.
    """
    if not _may_be_labels(np.unique(values)):
        return None
    found: set[float] = set()
    around: dict[float, int] = {}
    for piece in pieces(volume, expr, np.inf):
        found.update(np.unique(piece.x[~np.isnan(piece.x)]).tolist())
        if not _may_be_labels(np.array(sorted(found))):
            return None
        outermost = piece.outermost()
        _count(around, outermost[~np.isnan(outermost)])
    background = max(around, key=lambda label: (around[label], -label), default=None)
    if len(found) < 2 or max(found) - min(found) >= _SPAN * len(found):
        return None
    return np.array(sorted(found - {background}))


def _may_be_labels(values: np.ndarray) -> bool:
    """Return False if these sorted, distinct numbers, or more of them, cannot be labels."""
    whole = bool(np.all(values == np.round(values)))
    return whole and len(values) <= _MOST and bool(np.ptp(values) < _SPAN * _MOST)


def _count(counts: dict[float, int], values: np.ndarray) -> None:
    for value, number in zip(*np.unique(values, return_counts=True), strict=True):
        counts[float(value)] = counts.get(float(value), 0) + int(number)


# An isosurface is worth showing if its area is this part of the diagonal squared: a sphere a
# fiftieth of the diagonal across.
_SEEN = 1e-3
# Of data with one sign, what is lower than in nearly all of the volume surrounds nothing.
_LOWEST = 0.01
# The steepness is smoothed over this part of the distance of levels.
_SMOOTHING = 0.12


def levels(
    found: Histogram, n: int, *, signed: bool = False, floor: float = 0.0
) -> tuple[np.ndarray, float]:
    """Return n increasing levels and their typical distance.

    The range of values whose isosurfaces are large enough to be seen is cut into n equal slots,
    and each gets one level: where x is steepest, for that is where materials meet, with a
    preference for the middle of the slot (a factor 1 - u², u = ±1 at its ends), which keeps levels
    apart. Of data without materials, whose steepness is a power law, all slots look alike, and
    the levels are equally spaced.
    """
    low, high = _worth_showing(found, signed)
    if floor > 0:
        low = min(max(low, floor), 0.5 * (low + high))
    slot = (high - low) / n
    steep, x = found.steepness(_SMOOTHING * slot), found.centers
    chosen = []
    for k in range(n):
        u = (x - low - (k + 0.5) * slot) / (0.5 * slot)
        score = np.where(np.abs(u) < 1, steep * (1 - u * u), 0.0)
        best = int(np.argmax(score))
        chosen.append(float(x[best]) if score[best] > 0 else low + (k + 0.5) * slot)
    return np.array(chosen), slot


def _worth_showing(found: Histogram, signed: bool) -> tuple[float, float]:
    """Return the range of values with isosurfaces that are large enough to be seen."""
    large = np.flatnonzero(found.area >= min(_SEEN, 0.1 * found.area.max()))
    first, last = int(large[0]), int(large[-1])
    if not signed:
        below = np.cumsum(found.volume)
        first = min(max(first, int(np.searchsorted(below, _LOWEST * below[-1]))), last)
    return float(found.edges[first]), float(found.edges[last + 1])


# Fewer negative values say nothing.
_ENOUGH = 100
# Median over root mean square of the negative values: 0.67 for Gaussian noise, less where the noise
# is not the same everywhere; 0.87 if all values are alike often, 1 for a second material.
_MEDIAN = (0.45, 0.75)
# Noise has no values so far out (in its σ); data rises above it so many times.
_FARTHEST, _ABOVE = 10.0, 2.0
# Noise is symmetric: near zero there are no fewer positive values than negative ones (but for
# chance, where all is noise).
_SYMMETRIC = 0.9


def noise_of(values: np.ndarray) -> float:
    """Return the σ of the noise around zero in sorted values; zero if negative values mean more.

    The negative values are taken for half of the noise, of which the other half is among the
    positive ones: σ² is their mean square.
    """
    zero = int(np.searchsorted(values, 0.0, "left"))
    if zero < _ENOUGH:
        return 0.0
    below = -values[:zero].astype(np.float64)
    farthest, median = float(below[0]), float(np.median(below))
    # Squares of parts of the farthest are numbers, whatever the unit.
    sigma = farthest * float(np.sqrt(np.mean((below / farthest) ** 2)))
    beside = np.searchsorted(values, [-sigma, sigma])
    looks_like_noise = (
        _MEDIAN[0] * sigma < median < _MEDIAN[1] * sigma
        and farthest < _FARTHEST * sigma
        and float(values[-1]) > _ABOVE * farthest
        and beside[1] - zero > _SYMMETRIC * (zero - beside[0])
    )
    return sigma if looks_like_noise else 0.0


# What simulations call the first thing one looks at, in order of preference.
_FIRST = ("density", "gas_density", "rho", "dens", "number_density", "n", "nh", "n_h")
_COMPONENT = re.compile(
    r"[xyz]_.*|.*_([xyzr]|theta|phi)|(v|vel|velocity|u|b|bcc|mag|mom|e|acc)_?[xyz123]", re.I
)
# Coordinates that cubes of telescopes bring along.
_COORDINATE = re.compile(r"velocity|frequency|wavelength|wavenumber|redshift", re.I)
# Data that spans more than this factor is looked at logarithmically …
_DECADES = 2.0
# … from this quantile of its positive values to that (compact cores are what one looks for).
_LEAST, _GREATEST = 0.05, 1 - 1e-4
# … unless the top decade has more than its share of the cells, 1 / (number of decades): then its
# materials are what there is to see, and the rest are the faint outskirts of their boundaries.
_SHARE = 1.2
# Where so many cells have the least value, to this precision, nothing is there.
_FLOOR, _SAME = 0.05, 1e-3
# A few negative values are noise around zero: more of them mean something.
_NEGATIVE = 1e-3
_BINS = 64


def main_scalar(volume: Volume) -> Expression:
    """Return the field to look at first.

    It is the one called density, rho, … if there is one; else that with the most structure (the
    entropy of its histogram, linear or logarithmic as it will be shown). Components of vectors, and
    velocity or frequency in a cube of spectra, are left out where there are other fields.
    """
    if not volume.fields:
        raise InputError("the volume has no fields; add one: volume['density'] = array")
    lower = {name.lower(): name for name in reversed(volume.fields)}
    for name in _FIRST:
        if name in lower:
            return Expression(lower[name])
    scalars = [f for f in volume.fields if not _COMPONENT.fullmatch(f)]
    scalars = [f for f in scalars if not _COORDINATE.fullmatch(f)] or scalars
    candidates = scalars or list(volume.fields)
    if len(candidates) == 1:
        return Expression(candidates[0])
    return max((Expression(name) for name in candidates), key=lambda e: _structure(volume, e))


def _structure(volume: Volume, expr: Expression) -> float:
    """Return the entropy of a field's histogram in bits; negative if there is no finite value."""
    values = sampled_values(volume, expr)
    if is_wide(values):
        values = np.log10(values[values > 0])
    if not len(values):
        return -1.0
    if is_constant(values[0], values[-1]):
        return 0.0
    counts = np.histogram(values, _BINS, (float(values[0]), float(values[-1])))[0]
    part = counts[counts > 0] / counts.sum()
    return float(-(part * np.log2(part)).sum())


def is_wide(values: np.ndarray) -> bool:
    """Return True if sorted values want a logarithm.

    None is negative, they span two decades, and they are spread over these: the top decade does not
    hold most of the cells. Zeros, and other values where nothing is, are not looked at.
    """
    below = int(np.searchsorted(values, 0.0, "left"))
    positive = _above_floor(values[int(np.searchsorted(values, 0.0, "right")) :])
    if not len(positive) or below > _NEGATIVE * len(values):
        return False
    low, high = (float(positive[int(q * (len(positive) - 1))]) for q in (_LEAST, _GREATEST))
    decades = float(np.log10(high) - np.log10(low))
    top = 1.0 - float(np.searchsorted(positive, 0.1 * high)) / len(positive)
    return decades > _DECADES and top * decades < _SHARE


def _above_floor(positive: np.ndarray) -> np.ndarray:
    """Return the values without those that equal the least one, if these are many."""
    if not len(positive):
        return positive
    floor = int(np.searchsorted(positive, positive[0] * (1 + _SAME), "right"))
    return positive[floor:] if floor > _FLOOR * len(positive) else positive


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


def suggest_medium(
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
    >>> [shell.expr.text for shell in vm.suggest_medium(core, n=2).components()]
    ['log10(density)', 'log10(density)']
    """
    check_volume("suggest_medium", "first", volume)
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
