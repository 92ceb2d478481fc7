"""Expressions that turn within a cell: nothing thin of them is missed, and errors are honest."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import voluminous as vm
from panels import panel_of
from voluminous.backend import get_backend
from voluminous.expressions import Expression, NumpyOps
from voluminous.expressions.expression import Monotonicity

# Rays along z through one column of cells: all of a picture is one integral along a line.
COLUMN = vm.CartesianGrid([-1, 1], [-1, 1], np.arange(9.0))
DOWN = vm.Orthographic(width=0.5, resolution=1)
RISING = 1.3 * np.arange(8.0).reshape(1, 1, 8) - 1.05


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("2 * a - b / 3 + 1", Monotonicity.SUM),
        ("log10(a)", Monotonicity.MONOTONIC),
        ("10**(a - 2*b) + 3", Monotonicity.MONOTONIC),
        ("clip(tanh(a), 0, 1)", Monotonicity.MONOTONIC),
        ("a**3", Monotonicity.MONOTONIC),
        ("a**0.3", Monotonicity.MONOTONIC),
        ("2**3 * a", Monotonicity.SUM),
        ("a**10", Monotonicity.ANY),
        ("a**-9", Monotonicity.ANY),
        ("3 + 2**4", Monotonicity.CONSTANT),
        ("a**2", Monotonicity.ANY),
        ("a * b", Monotonicity.ANY),
        ("1 / a", Monotonicity.ANY),
        ("abs(a)", Monotonicity.ANY),
        ("max(a, b)", Monotonicity.ANY),
        ("r - 1", Monotonicity.ANY),
        ("a if b > 1 else 0", Monotonicity.ANY),
    ],
)
def test_what_is_known_of_expressions(text, kind):
    assert Expression(text).kind(("r",)) == kind


EXPRESSIONS = [
    "a * b",
    "abs(a)",
    "max(a, b)",
    "a * a - b",
    "cos(3 * a)",
    "exp(-a * a)",
    "a / (1 + b * b)",
    "sqrt(a * a + b * b)",
    "a if b > 0 else -a",
    "a % 1.5",
    "log10(3 + a)",
    "a - 2 * b",
]


@pytest.mark.parametrize("precision", ["single", "double"])
@given(data=st.data())
@settings(max_examples=20, deadline=None)
def test_hulls_hold_all_values(precision, data):
    """Of random parabolas: values at 400 places are within the hull, up to rounding."""
    text = data.draw(st.sampled_from(EXPRESSIONS))
    numbers = st.lists(st.integers(-16, 16), min_size=4, max_size=4)
    cubics = {name: np.array(data.draw(numbers)) / 8 for name in "ab"}
    panel = panel_of(get_backend("cpu", precision), **{n: c[:3] for n, c in cubics.items()})
    low, high = (float(np.asarray(end).item()) for end in panel.hull(Expression(text)))
    s = np.linspace(0, 1, 400)
    fields = {n: np.polynomial.polynomial.polyval(s, c[:3]) for n, c in cubics.items()}
    values = Expression(text).evaluate(NumpyOps(), fields)
    slack = 1e-4 if precision == "single" else 1e-10  # of cos(3 a) with a up to 8
    if np.all(np.isfinite(values)):
        assert low - slack <= values.min()
        assert values.max() <= high + slack


def along(function):
    """Return the integral along the column, from a million places."""
    z = (np.arange(10**6) + 0.5) / 10**6 * 8
    a = np.interp(z, np.arange(8) + 0.5, RISING.ravel())
    with np.errstate(all="ignore"):
        return 8 * np.nansum(function(a)) / a.size  # where there is no value is nothing


def shell(x, center, sigma):
    return np.exp(-0.5 * ((x - center) / sigma) ** 2)


THIN = {
    "kink": ("abs(a - 3)", 0.05, 0.002, lambda a: abs(a - 3)),
    "wave": ("cos(6*a)", 0.99, 0.01, lambda a: np.cos(6 * a)),
    "pole": ("1/(a - 3)", 5, 0.1, lambda a: 1 / (a - 3)),
    "root": ("sqrt(a - 3)", 0.2, 0.01, lambda a: np.sqrt(a - 3)),
    "logarithm": ("log10(a - 3)", -1, 0.01, lambda a: np.log10(a - 3)),
    "square": ("(a - 3)**2", 0.01, 0.001, lambda a: (a - 3) ** 2),
    "table": (
        "interp(a, [0, 3, 5, 9], [1, 2, 0, 4])",
        1.5,
        0.005,
        lambda a: np.interp(a, [0, 3, 5, 9], [1, 2, 0, 4]),
    ),
    "rising table": (
        "interp(a, [0, 3, 5, 9], [1, 2, 2, 4])",
        3.0,
        0.005,
        lambda a: np.interp(a, [0, 3, 5, 9], [1, 2, 2, 4]),
    ),
    "larger": ("max(a, 7 - a)", 3.51, 0.002, lambda a: np.maximum(a, 7 - a)),
}


@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("name", THIN)
def test_thin_shells_of_what_turns_are_seen(name, precision):
    text, center, sigma, function = THIN[name]
    volume = vm.Volume(COLUMN, a=RISING)
    image = vm.render(
        volume, vm.Gaussian(text, center, sigma, 1, 0, 1.0), DOWN, precision=precision
    )
    exact = along(lambda a: shell(function(a), center, sigma))
    assert image.intensity.item() == pytest.approx(exact, rel=2e-3)  # twice the tolerance
    assert abs(image.intensity.item() - exact) <= image.error.item() + 1e-4 * exact  # the sum's


@pytest.mark.parametrize("precision", ["single", "double"])
def test_thin_coefficients_are_seen(precision):
    volume = vm.Volume(COLUMN, a=RISING)
    for text, function in (
        ("exp(-0.5 * ((a - 5) / 0.01)**2)", lambda a: shell(a, 5, 0.01)),
        (
            "interp(a, [4.99, 5, 5.01], [0, 1, 0])",
            lambda a: np.interp(a, [4.99, 5, 5.01], [0, 1, 0]),
        ),
        ("where(abs(a - 5) < 0.01, 1, 0)", lambda a: abs(a - 5) < 0.01),
    ):
        image = vm.render(volume, vm.Coefficients(text, 0), DOWN, precision=precision)
        exact = along(function)
        assert abs(image.intensity.item() - exact) <= image.error.item() + 1e-3 * exact


@pytest.mark.exhaustive
def test_shells_beside_a_vacuum_are_seen():
    """A ratio that rises to nearly infinite at the end of a cell: its shell is in the last part.

    A panel and its halves did not meet it, and agreed about nothing: all of it was missing in 39 %
    of these pixels, and no error told.
    """
    low = np.array([0.1, -0.3, -0.9])
    grid = vm.CartesianGrid(*([a - 0.1, a + 0.1, a + 0.3] for a in low))
    t = np.reshape([0, 3.463, 0, 4.699, 0, 0, 0, 7.622], (2, 2, 2))
    n = np.reshape([0, 0, 0, 0.389, 0, 0, 0, 0], (2, 2, 2))
    volume = vm.Volume(grid, t=t, n=n)
    shell = vm.Gaussian("(x + n)/tanh(t)", 1.0, 0.2, 1, 0.3, 1.0)
    towards, place = (0.3214, 0.5567, -0.766), (0.1165, -0.2696, -0.8913)
    camera = vm.Orthographic.looking(towards, center=place, width=0.02, resolution=10)
    image = vm.render(volume, shell, camera, tolerance=0.15)  # as beside something far brighter
    truth = vm.render(volume, shell, camera, tolerance=1e-6, precision="double").intensity
    off = np.abs(image.intensity - truth)[..., 0]
    assert off.max() < 0.15 * truth.max()
    assert np.mean(off > image.error + 1e-5 * truth.max()) <= 0.01
