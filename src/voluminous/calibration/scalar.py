"""What to look at: which field of a volume, and whether itself or its logarithm."""

from __future__ import annotations

import re

import numpy as np

from ..errors import InputError
from ..expressions import Expression
from ..volume import Volume
from .histogram import is_constant, sampled_values

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

    Raises
    ------
    InputError
        If the volume has no fields.
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
