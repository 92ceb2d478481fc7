"""What the default scheme knows of smooth media: its expressions, and how exact it is."""

from __future__ import annotations

import numpy as np
import pytest

import voluminous as vm
from voluminous.backend import from_host, get_backend
from voluminous.backend.functions import decay
from voluminous.expressions import Expression

BOTH = pytest.mark.parametrize("precision", ["single", "double"])
# Relative: the fit of the polynomial and a few roundings; Dr.Jit's own exponential in double. The
# rounding of the exponent counts in proportion to it.
DECAY = {"single": 2e-7, "double": 1e-15}


def backend_of(precision):
    return get_backend("cpu", precision)


@BOTH
def test_decay(precision):
    Float = backend_of(precision).Float
    x = np.concatenate([[0.0], np.geomspace(1e-6, 80.0, 5000)]).astype(
        "f4" if precision == "single" else "f8"
    )
    found, x = decay(from_host(Float, x)).numpy().astype("f8"), x.astype("f8")
    assert np.all(np.abs(found / np.exp(-x) - 1) < DECAY[precision] * (1 + x))


@pytest.mark.parametrize(
    ("text", "smooth"),
    [
        ("a", True),
        ("log10(a) + 2 * b**3 / exp(-c)", True),
        ("gradmag(a) + sqrt(b) ** 0.3", True),
        ("tanh(a)", True),
        ("abs(a)", False),
        ("a if b > 0 else c", False),
        ("max(a, b)", False),
        ("clip(a, 0, 1)", False),
        ("sin(100 * a)", False),
        ("a % 2", False),
        ("a > 1 km", False),
    ],
)
def test_which_expressions_are_smooth(text, smooth):
    assert Expression(text).smooth is smooth


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_what_is_behind_opaque_panels_is_no_better_known(seed):
    """Extrapolated transparencies were below zero, and whatever was behind counted as exact."""
    rng = np.random.default_rng(seed)
    fields = {"a": 10 ** rng.uniform(-5, 5, (8, 8, 8)), "b": rng.random((8, 8, 8))}
    data = vm.Volume(vm.CartesianGrid.uniform(8, (0, 8)), **fields)
    medium = vm.Gaussian("log10(a)", 1.4, 1.0, (1, 0.5), 10.0, 1.0, where="b > 0.5")
    image = vm.render(data, medium, vm.Orthographic(70, 200, resolution=40), cutoff=0)
    assert np.isfinite(image.error).all()
    assert (image.transparency >= 0).all()
