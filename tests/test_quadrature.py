"""Means over both halves of a panel, and their errors, beside brute force."""

import numpy as np
import pytest
from drjit.llvm import Float64

import voluminous as vm
from voluminous.media.panel import PLACES, third_differences
from voluminous.media.piecewise_linear import PiecewiseLinear
from voluminous.media.quadrature import boole, midway

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
        ((mean, told),) = table.bent_means(*places, Float64(bow) * table.unit)
        wrong = np.abs(mean.numpy() - exact)
        if high < 1.0:
            np.testing.assert_allclose(mean.numpy(), exact, rtol=1e-6)
        assert np.mean(wrong <= told.numpy() + 1e-6) >= 0.95
