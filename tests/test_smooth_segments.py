"""Segments on which a medium is smooth: four nodes, and a bound of what they are off by."""

from __future__ import annotations

import numpy as np
import pytest

import voluminous as vm
from voluminous.backend import get_backend
from voluminous.backend.functions import decay
from voluminous.expressions import Expression
from voluminous.media.at_nodes import PLACES, WEIGHTS, gaussian_at_nodes, mean
from voluminous.media.context import Context
from voluminous.media.stretch import Stretch

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
    found, x = decay(Float(x)).numpy().astype("f8"), x.astype("f8")
    assert np.all(np.abs(found / np.exp(-x) - 1) < DECAY[precision] * (1 + x))


@BOTH
def test_decay_far_out_and_of_nothing(precision):
    Float = backend_of(precision).Float
    far = decay(Float([90.0, 1e4, np.inf])).numpy()
    assert np.all((far >= 0) & (far < 1e-36))
    assert np.isnan(decay(Float([np.nan])).numpy()).all()


def cubics(count, seed):
    """Return Bézier control points of cubics through a Gaussian: flat, steep, bent, turning."""
    rng = np.random.default_rng(seed)
    start = rng.uniform(-6, 6, (1, count))
    rises = rng.normal(size=(3, count)) * 10 ** rng.uniform(-3, 0.2, (1, count))
    straight = rng.random(count) < 0.5
    rises[:, straight] = rises[:1, straight] * (1 + 0.05 * rng.normal(size=(3, straight.sum())))
    return np.concatenate([start, start + np.cumsum(rises, axis=0)])


def bezier(points, s):
    return (
        points[0] * (1 - s) ** 3
        + 3 * points[1] * s * (1 - s) ** 2
        + 3 * points[2] * s**2 * (1 - s)
        + points[3] * s**3
    )


def stretches(points, backend):
    """Return stretches on which the field `a` runs along cubics."""
    a, b, c, d = points
    power = [a, 3 * (b - a), 3 * (a - 2 * b + c), d - 3 * c + 3 * b - a]
    cubic = [backend.Float(p) for p in power]
    context = Context(backend.Float, backend.opaque, None, lambda expr: None)
    return Stretch({"a": cubic}, context, backend.Float(1.0))


def solved(points, backend):
    """Return the mean of the Gaussian of every cubic by four nodes, and the bound of its error."""
    stretch, expr = stretches(points, backend), Expression("a")
    found = gaussian_at_nodes([stretch.scalar(expr, s) for s in PLACES], stretch.derivatives(expr))
    return mean(found.nodes).numpy(), found.off.numpy()


def exact(points):
    """Return the means with 64 points of Gauss and Legendre: exact to rounding below 3 σ."""
    x, w = np.polynomial.legendre.leggauss(64)
    return sum(
        0.5 * weight * np.exp(-0.5 * bezier(points, 0.5 + 0.5 * place) ** 2)
        for place, weight in zip(x, w, strict=True)
    )


def test_the_rule_is_exact_for_polynomials_of_degree_five():
    for degree in range(6):
        found = sum(w * s**degree for s, w in zip(PLACES, WEIGHTS, strict=True))
        assert found == pytest.approx(1 / (degree + 1), rel=1e-14)
    assert sum(w * s**6 for s, w in zip(PLACES, WEIGHTS, strict=True)) != pytest.approx(1 / 7)


def test_errors_are_within_their_bound():
    points = cubics(100_000, 1)
    found, off = solved(points, backend_of("double"))
    known = np.isfinite(off)
    assert 0.3 < known.mean() < 0.95
    wrong = np.abs(found - exact(points))
    assert np.all(wrong[known] <= off[known] + 1e-15)


def test_bounds_are_not_far_too_large():
    # Straight through the middle of a shell, where the sixth derivative is the greatest.
    width = np.linspace(0.3, 2.5, 200)
    points = np.linspace(-0.5, 0.5, 4)[:, None] * width
    found, off = solved(points, backend_of("double"))
    assert np.all(off < 5 * np.abs(found - exact(points)) + 1e-15)


def test_bounds_are_of_sixth_order():
    points = np.linspace(0.2, 1.2, 4)[:, None] * 0.5 ** np.arange(4)
    _, off = solved(points, backend_of("double"))
    np.testing.assert_allclose(off[:-1] / off[1:], 64, rtol=0.1)


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


def volume():
    rng = np.random.default_rng(5)
    x = np.linspace(-1, 1, 10)
    x, y, z = np.meshgrid(x, x, x, indexing="ij")
    grid = vm.CartesianGrid.uniform(10, (-1, 1))
    return vm.Volume(grid, a=x * x + y * y + 0.5 * z, b=np.exp(x - y) + 0.1 * rng.random(x.shape))


MEDIA = {
    "one": lambda: vm.Gaussian("a", 0.6, 0.2, (1, 0.5, 0.2), 2.0, 0.3),
    "two": lambda: (
        vm.Gaussian("a", 0.6, 0.2, (1, 0.5, 0.2), 2.0, 0.3)
        + vm.Gaussian("log10(b)", 0.1, 0.1, (0.1, 0.5, 1), 0.5, 0.3)
    ),
    "coloured": lambda: vm.Gaussian("a", 0.6, 0.3, (1, 0.5, 0.2), (0.5, 1.0, 3.0), 0.3),
    "rectangle": lambda: vm.Rectangle("a", 0.6, 0.3, (1, 0.5, 0.2), 2.0, 0.3),
    "beside a surface": lambda: (
        vm.Gaussian("a", 0.6, 0.2, (1, 0.5, 0.2), 2.0, 0.3)
        + vm.Isosurface("b", 1.2, (0.1, 0.5, 1), 0.5)
    ),
    "beside a gate": lambda: (
        vm.Gaussian("a", 0.6, 0.2, (1, 0.5, 0.2), 2.0, 0.3)
        + vm.Gaussian("b", 1.2, 0.2, (0.1, 0.5, 1), 0.5, 0.3, where="a > 0.5")
    ),
}


@pytest.mark.parametrize("kind", MEDIA)
@pytest.mark.parametrize("order", ["front-to-back", "back-to-front"])
def test_pictures_are_those_of_panels(kind, order, monkeypatch):
    data, medium = volume(), MEDIA[kind]()
    camera = vm.Orthographic(60, 30, resolution=24)
    options = {"precision": "single", "order": order, "cutoff": 0}
    image = vm.render(data, medium, camera, **options)
    monkeypatch.setattr(type(medium), "smooth", False)
    for part in medium.components():
        monkeypatch.setattr(type(part), "smooth", False)
    panels = vm.render(data, medium, camera, **options)
    off = np.abs(image.intensity - panels.intensity).max(-1)
    assert np.all(off <= image.error + panels.error)
    assert not np.array_equal(image.error, panels.error)  # it was another way


def test_double_precision_keeps_to_closed_forms(monkeypatch):
    data, medium = volume(), MEDIA["two"]()
    camera = vm.Orthographic(60, 30, resolution=8)
    image = vm.render(data, medium, camera, precision="double")
    for part in (medium, *medium.components()):
        monkeypatch.setattr(type(part), "smooth", False)
    panels = vm.render(data, medium, camera, precision="double")
    np.testing.assert_array_equal(image.intensity, panels.intensity)
