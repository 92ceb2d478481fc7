"""Functions of the fields that are read as formulas: known are their jumps, kinks and bounds.

The NumPy twin of such a function is the function itself, called with NumPy arrays.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import voluminous as vm
from voluminous.backend import dr
from voluminous.expressions import NumpyOps
from voluminous.media import Coefficients, Function

GRID = vm.CartesianGrid.uniform(16, (-1, 1))
CAMERA = vm.Orthographic(40, 30, width=3, resolution=32)


def volume():
    """Return a noisy field and a steep one."""
    rng = np.random.default_rng(5)
    return vm.Volume(GRID, n=np.exp(0.7 * rng.normal(size=GRID.shape)), t=rng.random(GRID.shape))


def values(function, *fields, **parameters):
    """Return what the formulas of a function of one channel give for NumPy arrays."""
    names = list("abc")[: len(fields)]
    medium = Function(lambda *x, **p: (function(*x, **p), 0.0), names, 1, parameters=parameters)
    formulas = medium.formulas()
    assert formulas is not None
    given = dict(zip(names, fields, strict=True))
    return formulas.emissivity[0].evaluate(NumpyOps(), given)


UNARY = {
    "exp": lambda a: np.exp(-abs(a)),
    "logarithms": lambda a: np.log(a * a + 1) + np.log10(a**2 + 2) - np.log2(abs(a) + 1),
    "roots": lambda a: np.sqrt(abs(a)) + (a * a) ** 0.5 + np.abs(a) ** 1.3,
    "waves": lambda a: np.sin(a) * np.cos(a) + np.tan(0.1 * a),
    "hyperbolic": lambda a: np.tanh(a) + 1e-3 * np.sinh(0.5 * a) - 1e-3 * np.cosh(0.5 * a),
    "steps": lambda a: np.floor(a) + np.ceil(a) + a // 3 + a % 3,
    "numbers on the left": lambda a: 2 - 3 / (a + 100) + 2**a + np.float64(3) * a + (7 % (a + 50)),
    "powers": lambda a: a**2 + a**-1 + np.square(a) + np.reciprocal(a) + a**9 + np.power(a, 3),
    "signs": lambda a: +a - -a,
    "choices": lambda a: np.where((a > 1) & (a <= 5) | ~(a != 2.5), a, -a) + np.clip(a, -1, 1),
    "logic": lambda a: np.where(np.logical_or(a < -1, np.logical_not(a >= -3)), 1.0, 0.0),
    "tables": lambda a: np.interp(a, [-5, 0.5, 2], [1, 3, -2]) * np.interp(-a, (0, 1), (0, 7)),
    "undefined": lambda a: np.where(np.isnan(np.sqrt(a)), -1.0, 1.0) + (a == a),
    "same shape": lambda a: np.zeros_like(a) + np.ones_like(a) * a,
}


@pytest.mark.parametrize("name", UNARY)
def test_formulas_compute_what_the_function_computes(name):
    a = np.random.default_rng(2).uniform(-9, 9, 500)
    with np.errstate(invalid="ignore"):
        expected = UNARY[name](a)
    # Some roundings each; compositions such as log2 round once more.
    np.testing.assert_allclose(values(UNARY[name], a), expected, rtol=1e-13, atol=1e-14)


STEPS = {
    "+": lambda x, y: x + y,
    "*": lambda x, y: 0.1 * x * y,
    "-": lambda x, y: x - y,
    "/": lambda x, y: x / (1.0 + y * y),
    "min": np.minimum,
    "max": np.maximum,
    "<": lambda x, y: np.where(x < y, 0.25, 0.75),
    "where": lambda x, y: np.where(x > y, x, 2 * y),
    "atan2": np.arctan2,
    "exp": lambda x, y: np.exp(-np.abs(x)) * y,
}
NUMBERS = st.integers(0, 30)


@given(st.lists(st.tuples(st.sampled_from(list(STEPS)), NUMBERS, NUMBERS), max_size=12))
@settings(max_examples=100)
def test_any_sequence_of_steps_is_read(program):
    def run(a, b, scale):
        known = [a, b, a * scale]
        for operation, i, j in program:
            known.append(STEPS[operation](known[i % len(known)], known[j % len(known)]))
        return sum(known)

    a, b = np.random.default_rng(1).normal(size=(2, 50))
    # The same operations in the same order, but for those that NumPy fuses.
    np.testing.assert_allclose(values(run, a, b, scale=1.5), run(a, b, 1.5), rtol=1e-12, atol=1e-12)


UNREADABLE = {
    "erf": lambda n, t: (vm.math.erf(n), t),
    "kernels' functions": lambda n, t: (dr.sqrt(n), t),
    "infinite": lambda n, t: (vm.math.where(n > 0, n, np.inf), t),
    "reduced": lambda n, t: (np.add.reduce(n), t),
}


@pytest.mark.parametrize("name", UNREADABLE)
def test_other_functions_are_left_alone(name):
    assert Function(UNREADABLE[name], ["n", "t"], 1).formulas() is None


def test_what_a_function_closes_over_may_change():
    height = {"value": 1.0}
    medium = vm.Medium.from_function(lambda n: (height["value"] * n, 0.0 * n), "n", 1)
    once = vm.render(volume(), medium, CAMERA).intensity
    height["value"] = 2.0
    twice = vm.render(volume(), medium, CAMERA).intensity
    np.testing.assert_allclose(twice, 2 * once, rtol=1e-5, atol=1e-6)


def test_numbers_with_units_are_left_to_the_volume():
    formulas = Function(lambda hot: (hot, hot), ["t > 5 K"], 1).formulas()
    with pytest.raises(vm.UnitsError, match="only a volume can convert"):
        formulas.emissivity[0].evaluate(NumpyOps(), {"t": np.array([4.0, 6.0])})


def jumping(n, t, edge):
    """Return a medium that jumps in two fields, in every cell many times."""
    cold = vm.math.where(t < 0.5, n, 0.0)
    dense = vm.math.where((n > edge) & (n < 3.0), 1.0, 0.2)
    return [cold * dense, 0.5 * dense], 0.3 * dense


def as_expressions(edge):
    dense = f"where((n > {edge}) and (n < 3), 1, 0.2)"
    return Coefficients([f"where(t < 0.5, n, 0) * {dense}", f"0.5 * {dense}"], f"0.3 * {dense}")


def function_medium(edge=1.0):
    return vm.Medium.from_function(jumping, ["n", "t"], 2, parameters={"edge": edge})


@pytest.mark.parametrize("precision", ["single", "double"])
def test_jumps_are_found_as_those_of_expressions_are(precision):
    scene = volume()
    read = vm.render(scene, function_medium(), CAMERA, precision=precision)
    written = vm.render(scene, as_expressions(1.0), CAMERA, precision=precision)
    # The same numbers; constants of expressions are data, so that products may be fused otherwise.
    brightest = written.intensity.max()
    assert np.abs(read.intensity - written.intensity).max() < 1e-5 * brightest


COOLING = np.array([[3.0, 4.0, 4.3, 5.2, 6.0], [0.1, 0.2, 3.0, 2.0, 0.5]])


def cooling(n, t):
    """Return the emission of a gas that cools, from a table."""
    return n**2 * vm.math.interp(3.0 + 3.0 * t, *COOLING), 0.1 * n


def test_tables_in_functions_are_those_of_expressions_and_of_kernels():
    scene = volume()
    table = f"interp(3 + 3*t, {COOLING[0].tolist()}, {COOLING[1].tolist()})"
    written = vm.render(scene, Coefficients(f"n**2 * {table}", "0.1*n"), CAMERA).intensity
    for function in (
        cooling,
        lambda n, t: (n**2 * np.interp(3.0 + 3.0 * t, *COOLING), 0.1 * n),
        lambda n, t: (cooling(n, t)[0] + 0.0 * vm.math.erf(n), 0.1 * n),  # a black box
    ):
        found = vm.render(scene, vm.Medium.from_function(function, ["n", "t"], 1), CAMERA)
        assert np.abs(found.intensity - written).max() < 2e-3 * written.max()  # both to 1e-3


def test_errors_are_honest_and_bounds_hold_where_tables_bend():
    scene, medium = volume(), vm.Medium.from_function(cooling, ["n", "t"], 1)
    image = vm.render(scene, medium, CAMERA)
    truth = vm.render(scene, medium, CAMERA, tolerance=1e-6, precision="double")
    off = np.abs(image.intensity - truth.intensity).max(axis=-1)
    assert np.mean(off > image.error) < 0.02  # as promised for every medium
    small = vm.Orthographic(40, 30, width=3, resolution=12)
    sure = vm.render(scene, medium, small, bounds=True)
    exact = vm.render(scene, medium, small, tolerance=1e-6, precision="double").intensity
    slack = 1e-5 * exact.max()  # what the "truth" may be off by
    assert np.all((sure.lower <= exact + slack) & (sure.upper >= exact - slack))
