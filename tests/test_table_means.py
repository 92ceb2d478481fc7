"""Tables along a ray: exact means where their scalar is linear, whatever their nodes."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from voluminous.backend import from_host, get_backend
from voluminous.media.piecewise_linear import PiecewiseLinear

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
