"""Means over panels and their halves, beside brute force and numbers of thirty digits."""

from __future__ import annotations

from itertools import pairwise

import mpmath
import numpy as np
import pytest
from drjit.llvm import Float64
from hypothesis import given, settings
from hypothesis import strategies as st

import voluminous as vm
from voluminous.backend import dr, from_host, get_backend
from voluminous.media.gaussian import gaussian_mean
from voluminous.media.panel import PLACES, third_differences
from voluminous.media.piecewise_linear import PiecewiseLinear
from voluminous.media.quadrature import boole, midway
from voluminous.media.rectangle import box_mean

# --- Means over both halves of a panel, and their errors, beside brute force.

FINE = np.linspace(0.0, 1.0, 20001)


def arrays(rows):
    return [Float64(np.ascontiguousarray(row)) for row in rows]


def halves(function):
    """Return the means over both halves of functions given at `FINE` places, by Simpson's rule."""
    weights = np.where(np.arange(10001) % 2, 4.0, 2.0)
    weights[[0, -1]] = 1.0
    return [part @ weights / 30000.0 for part in (function[:, :10001], function[:, 10000:])]


@pytest.mark.parametrize("degree", range(6))
def test_rules_are_exact_for_polynomials(degree):
    """Boole's up to degree five, the quartic between its places up to four."""
    values = [Float64(s**degree) for s in PLACES]
    assert boole(values).numpy() == pytest.approx(1 / (degree + 1), rel=1e-14)
    if degree < 5:
        between = [v.numpy()[0] for v in midway(values)]
        np.testing.assert_allclose(between, np.linspace(0, 1, 9) ** degree, atol=1e-15)
    if degree < 4:
        differences = [v.numpy()[0] for v in third_differences(values)]
        np.testing.assert_allclose(differences, 6 / 64 * (degree == 3), atol=1e-15)


@pytest.mark.parametrize("sigma", [0.001, 0.01, 0.1, 1.0])
def test_shells_on_cubics_are_right_in_one_panel(sigma):
    """Where a cubic rises steadily, whatever the width: to a thousandth, and the error told holds.

    But for a hundred-thousandth: an error that is no more than that is told too small.
    """
    rng = np.random.default_rng(7)
    a, b, c = rng.uniform(-0.35, 0.35, (3, 400))
    x = FINE + a[:, None] * FINE * (1 - FINE) + b[:, None] * FINE * (1 - FINE) * (2 * FINE - 1)
    z = (x - np.clip(c + 0.5, 0.05, 0.95)[:, None]) / sigma
    exact = halves(np.exp(-0.5 * z * z))
    shell = vm.Gaussian("x", 0.0, 1.0, 1.0, 0.1, 0.1)
    first, last, told = (
        v.numpy() for v in shell.halves(arrays(z[:, :: (len(FINE) - 1) // 4].T), 1e-6)
    )
    wrong = np.abs(0.5 * (first + last) - 0.5 * (exact[0] + exact[1]))
    assert np.mean(wrong <= told + 1e-5) >= 0.95
    size = 0.5 * (exact[0] + exact[1])
    assert np.median(wrong / size) < 1e-3
    assert np.median(told / size) < 1e-2


def test_tables_are_exact_where_they_are_linear():
    """The mean of a linear column over a parabola is that of the parabola; kinks are told."""
    table = PiecewiseLinear(Float64, np.array([0.0, 1.0, 2.0]), np.array([[0.0], [3.0], [1.0]]))
    rng = np.random.default_rng(8)
    for low, high in ((0.05, 0.95), (0.1, 1.9)):
        ends, bow = rng.uniform(low + 0.2, high - 0.2, (2, 300)), rng.uniform(-0.2, 0.2, 300)
        x = ends[0, :, None] + (ends[1] - ends[0])[:, None] * FINE
        x += bow[:, None] * FINE * (FINE - 1)
        exact = 0.5 * sum(halves(np.interp(x, [0, 1, 2], [0, 3, 1])))
        places = [table.at(v) for v in arrays(ends)]
        ((mean, told),) = table.bent_means(*places, Float64(bow) * table.unit, None)
        wrong = np.abs(mean.numpy() - exact)
        if high < 1.0:
            np.testing.assert_allclose(mean.numpy(), exact, rtol=1e-6)
        assert np.mean(wrong <= told.numpy() + 1e-6) >= 0.95


# --- Tables along a ray: exact means where their scalar is linear, whatever their nodes.

PRECISIONS = ["single", "double"]


def kernel_means(nodes, columns, first, last, precision):
    """Return the means of a table's columns between places, shape (place, column)."""
    real = get_backend("cpu", precision).Float
    table = PiecewiseLinear(real, np.asarray(nodes, float), np.asarray(columns, float))
    ends = [table.at(from_host(real, x)) for x in (first, last)]
    return np.stack([np.asarray(v) for v in table.means(*ends)], axis=-1)


def exact_mean(nodes, column, first, last):
    """Return ∫ c dx / (x₁ - x₀): between any two neighbours among nodes and ends c is linear."""
    low, high = min(first, last), max(first, last)
    total = np.longdouble(0)
    inner = [x for x in nodes if low < x < high]
    places = [low, *inner, high]
    for a, b in pairwise(places):
        if a < b:
            middle = np.longdouble(a) + (np.longdouble(b) - np.longdouble(a)) / 2
            total += (np.longdouble(b) - a) * value_at(nodes, column, middle)
    return float(total / (np.longdouble(high) - low))


def value_at(nodes, column, x):
    """Return the table at a place that is no node."""
    k = int(np.searchsorted(nodes, float(x), "right"))
    if k == 0 or k == len(nodes):
        return np.longdouble(column[min(k, len(nodes) - 1)])
    f = (x - nodes[k - 1]) / (np.longdouble(nodes[k]) - nodes[k - 1])
    return column[k - 1] + f * (np.longdouble(column[k]) - column[k - 1])


def tolerance(nodes, first, last, precision):
    """Return what x, rounded, makes uncertain: a mean over a short way most of all."""
    eps = np.finfo(np.float32 if precision == "single" else np.float64).eps
    size = max(abs(first), abs(last), *np.abs(nodes))
    steps = np.diff(nodes)
    steep = 1.0 / min(abs(last - first), np.min(steps[steps > 0], initial=np.inf))
    return float(8 * eps * (1 + size * steep))


@pytest.mark.parametrize("precision", PRECISIONS)
@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_means_are_integrals_over_the_way(precision, data):
    # On a lattice of 1/64 nodes and ends are numbers of both precisions; equal nodes are jumps.
    grid = st.integers(-256, 256)
    nodes = np.sort(data.draw(st.lists(grid, min_size=2, max_size=12))) / 64
    heights = st.floats(-1, 1, width=32)
    column = np.array(data.draw(st.lists(heights, min_size=len(nodes), max_size=len(nodes))))
    first, last = data.draw(st.tuples(grid, grid).filter(lambda p: p[0] != p[1]))
    first, last = first / 64, last / 64
    found = kernel_means(nodes, column[:, None], [first], [last], precision)[0, 0]
    expected = exact_mean(nodes, column, first, last)
    assert found == pytest.approx(expected, abs=tolerance(nodes, first, last, precision))


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("count", [2, 3, 256, 5000])
@pytest.mark.parametrize("spacing", ["even", "geometric"])
def test_many_nodes_lose_no_digits(precision, count, spacing):
    # The cumulative table of 5000 entries is 4e3 times its steps: its plain differences in single
    # precision would have lost 3 of 7 digits. What is left is the rounding of x over its way.
    rng = np.random.default_rng(5)
    nodes = np.linspace(1, 2, count) if spacing == "even" else np.geomspace(1, 2, count)
    column = rng.uniform(0.5, 1, count)
    first = rng.uniform(0.9, 2.1, 40)
    last = first + rng.choice([-1, 1], 40) * 3.0 / count
    if precision == "single":
        first, last = (np.float32(x).astype(float) for x in (first, last))
    found = kernel_means(nodes, column[:, None], first, last, precision)[:, 0]
    expected = [exact_mean(nodes, column, a, b) for a, b in zip(first, last, strict=True)]
    eps = np.finfo(np.float32 if precision == "single" else np.float64).eps
    np.testing.assert_allclose(found, expected, rtol=0, atol=4 * eps * count)


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("place", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("width", [1e-3, 1e-6])
def test_a_thin_spike_keeps_its_area(precision, place, width):
    # Its ends are the same number in single precision, or nearly; its area is not.
    nodes = [-2.0, place - width, place, place + width, 5.0]
    found = kernel_means(
        nodes, [[0.0], [0.0], [1.0], [0.0], [0.0]], [-1.5, 2.5], [2.5, -1.5], precision
    )
    np.testing.assert_allclose(found[:, 0], width / 4, rtol=1e-6 if precision == "single" else 1e-9)


@pytest.mark.parametrize("precision", PRECISIONS)
def test_infinite_ends_and_nan(precision):
    nodes, column = [0.0, 1.0], [[0.25], [0.75]]
    found = kernel_means(
        nodes,
        column,
        [-np.inf, np.inf, -np.inf, np.nan, 0.5],
        [-np.inf, 0.5, np.inf, 0.5, np.nan],
        precision,
    )[:, 0]
    np.testing.assert_allclose(found[:3], [0.25, 0.75, 0.5], rtol=1e-6)
    assert np.isnan(found[3:]).all()


# --- Means of shapes over a panel, and logarithms by their bits: against numbers of thirty digits.

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
