"""Means of shapes over a panel, and logarithms by their bits: against numbers of thirty digits."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest

from voluminous.backend import dr, from_host, get_backend
from voluminous.media.gaussian import gaussian_mean
from voluminous.media.rectangle import box_mean

KINDS = {"single": np.float32, "double": np.float64}
# In single the rational function is good to 3e-7, which its difference divides by 0.3; in double
# what remains is rounding, of error functions near one and of a sum of some terms.
GAUSSIAN = {"single": 3.5e-6, "double": 3e-15}
# On both sides of where the series gives way to the difference of error functions.
HALVES = [0.0, 1e-30, 1e-8, 1e-3, 0.2499, 0.2501, 0.2999, 0.3001, 1.0, 3.0, 30.0, 1e4, 1e8]
MIDDLES = [0.0, 1e-12, 0.3, 1.0, 2.0, 3.7, 5.0, 6.5, 9.0, 37.0, 1e3, 1e9]


@pytest.fixture(params=sorted(KINDS))
def precision(request):
    return request.param


def panels(precision):
    """Return both ends of panels of many widths at many places, in both directions."""
    half, middle = (a.ravel() for a in np.meshgrid([*HALVES, *(-h for h in HALVES)], MIDDLES))
    kind = KINDS[precision]
    return (middle - half).astype(kind), (middle + half).astype(kind)


def computed(function, precision, *columns):
    """Return a function's values for arrays of a precision."""
    real = get_backend("cpu", precision).Float
    found = function(*(from_host(real, c) for c in columns))
    dr.eval(found)
    return np.asarray(found, float)


def exact_gaussian(first, last):
    """Return the mean of exp(-z²/2), where digits cancel with as many more."""
    with mpmath.workdps(60):
        a, b = mpmath.mpf(float(first)), mpmath.mpf(float(last))
        if a == b:
            return float(mpmath.exp(-a * a / 2))
        root = mpmath.sqrt(mpmath.mpf(1) / 2)
        # Of tails erfc: 1 - 1e-200 has no digits left.
        if a > 0 and b > 0:
            area = mpmath.erfc(a * root) - mpmath.erfc(b * root)
        elif a < 0 and b < 0:
            area = mpmath.erfc(-b * root) - mpmath.erfc(-a * root)
        else:
            area = mpmath.erf(b * root) - mpmath.erf(a * root)
        return float(mpmath.sqrt(mpmath.pi / 2) * area / (b - a))


def test_mean_of_a_gaussian(precision):
    first, last = panels(precision)
    found = computed(gaussian_mean, precision, first, last)
    exact = np.array([exact_gaussian(a, b) for a, b in zip(first, last, strict=True)])
    # Of wide panels the area counts, which is the mean times the width.
    wide = np.maximum(1.0, 0.5 * np.abs(last.astype(float) - first))
    assert (np.abs(found - exact) * wide).max() < GAUSSIAN[precision]
    assert (found >= 0).all()


def test_tails_of_a_gaussian_have_all_digits(precision):
    first, last = panels(precision)
    exact = np.array([exact_gaussian(a, b) for a, b in zip(first, last, strict=True)])
    known = exact > {"single": 1e-33, "double": 1e-290}[precision]
    found = computed(gaussian_mean, precision, first, last)
    np.testing.assert_allclose(found[known], exact[known], rtol=GAUSSIAN[precision])


def test_mean_of_a_gaussian_in_two_halves_is_that_of_the_whole(precision):
    first, last = panels(precision)
    middle = (0.5 * (first.astype(float) + last)).astype(first.dtype)
    whole, a, b = (
        computed(gaussian_mean, precision, *ends)
        for ends in ((first, last), (first, middle), (middle, last))
    )
    share = np.divide(
        middle.astype(float) - first,
        last.astype(float) - first,
        out=np.full(len(first), 0.5),
        where=last != first,
    )
    wide = np.maximum(1.0, 0.5 * np.abs(last.astype(float) - first))
    parts = share * a + (1 - share) * b
    assert (np.abs(whole - parts) * wide).max() < 2 * GAUSSIAN[precision]


def exact_box(first, last):
    """Return the part of the way within -1 … 1, in exact arithmetic."""
    with mpmath.workdps(60):
        low, high = sorted((mpmath.mpf(float(first)), mpmath.mpf(float(last))))
        if low == high:
            return float(abs(low) <= 1)
        return float(max(min(high, 1) - max(low, -1), 0) / (high - low))


def test_mean_of_a_rectangle(precision):
    first, last = panels(precision)
    kind = KINDS[precision]
    edge = np.array([1.0, -1.0, 1.0, -1.0, 1.0, np.nextafter(kind(1), kind(2)), 0.0], kind)
    other = np.array([1.0, -1.0, -1.0, 3.0, np.nextafter(kind(1), kind(0)), 1e20, -1e30], kind)
    first, last = np.concatenate([first, edge]), np.concatenate([last, other])
    found = computed(box_mean, precision, first, last)
    exact = np.array([exact_box(a, b) for a, b in zip(first, last, strict=True)])
    # Two differences and a quotient, each rounded once.
    np.testing.assert_allclose(found, exact, rtol=3 * np.finfo(kind).eps, atol=1e-37)
