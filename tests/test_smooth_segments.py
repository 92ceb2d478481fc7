"""Segments on which a medium is smooth: four nodes, and a bound of what they are off by."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import voluminous as vm
from voluminous.backend import from_host, get_backend
from voluminous.backend.functions import decay
from voluminous.expressions import Expression
from voluminous.media.context import Context
from voluminous.media.gaussian import finely_sampled_gaussian, sampled_gaussian
from voluminous.media.sampled import (
    EIGHT,
    FIVE,
    PAIR,
    PLACES,
    WEIGHTS,
    WEIGHTS_OF_EIGHT,
    compared,
    products,
)
from voluminous.media.stretch import Stretch
from voluminous.media.table_bends import BEND

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
    cubic = [from_host(backend.Float, p) for p in power]
    context = Context(backend.Float, backend.opaque, None, lambda expr: None)
    return Stretch({"a": cubic}, context, backend.Float(1.0))


def solved(points, backend, rule=sampled_gaussian, places=PLACES):
    """Return the mean of the Gaussian of every cubic by a few nodes, and the bound of its error."""
    stretch, expr = stretches(points, backend), Expression("a")
    found = rule([stretch.scalar(expr, s) for s in places], stretch.derivatives(expr))
    return found.mean.numpy(), found.off.numpy()


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


def test_errors_of_eight_samples_are_within_their_bound():
    points = cubics(100_000, 2)
    known = []
    for rule, places in ((sampled_gaussian, PLACES), (finely_sampled_gaussian, EIGHT)):
        found, off = solved(points, backend_of("double"), rule, places)
        assert np.all(np.abs(found - exact(points)) <= off + 1e-15)
        known.append(np.mean(off < 1e-3))
    assert 1 - known[1] < 0.5 * (1 - known[0])
    # Where they change by less than a tenth of a σ the larger ellipse tells of ten digits.
    slow = np.abs(np.diff(points, axis=0)).sum(axis=0) < 0.1
    assert slow.mean() > 0.2
    assert np.all(off[slow] < 1e-10)


def test_eight_samples_tell_the_line_through_them():
    """Mean and ends of a cubic are those of the straight line nearest to it."""
    for degree in range(16):
        found = sum(w * s**degree for s, w in zip(EIGHT, WEIGHTS_OF_EIGHT, strict=True))
        assert found == pytest.approx(1 / (degree + 1), rel=1e-14)
    real = backend_of("double").Float
    values = [real(2.0 - s + 3.0 * s**2) for s in EIGHT]
    (found,) = products(values, real(0.0), [[real(1.0)] * 5])
    ends = [float(v.numpy().item()) for v in (found.first, found.last, found.mean, found.off)]
    # Legendre: s² is 1/3 + (2s - 1)/2 + (what has neither mean nor slope).
    assert ends == pytest.approx([1.5, 3.5, 2.5, 0.0], abs=1e-14)


FACTORS = {
    "quartic": lambda s: 1 - 2 * s + s**2 - 3 * s**3 + 2 * s**4,
    "wave": lambda s: 0.6 + 0.4 * np.sin(4 * s),
    "kink": lambda s: np.abs(s - 0.37),
    "soft step": lambda s: 1 / (1 + np.exp((0.6 - s) / 0.08)),
}


@pytest.mark.parametrize("name", FACTORS)
def test_products_of_shapes_and_factors(name):
    factor, backend = FACTORS[name], backend_of("double")
    points = cubics(3000, 5)
    stretch, expr = stretches(points, backend), Expression("a")
    nodes = [stretch.scalar(expr, s) for s in EIGHT]
    off = finely_sampled_gaussian(nodes, stretch.derivatives(expr)).off
    real = backend.Float
    values = [real(float(factor(s))) for s in FIVE]
    (found,) = products([decay(0.5 * z * z) for z in nodes], off, [values])
    s = (np.arange(4000) + 0.5) / 4000  # the middles of as many parts: off by 1e-7
    exact = sum(factor(p) * np.exp(-0.5 * bezier(points, p) ** 2) for p in s) / len(s)
    known = off.numpy() < 1e-2
    wrong = np.abs(found.mean.numpy() - exact)[known]
    assert np.mean(wrong <= found.off.numpy()[known] + 1e-6) > 0.99
    if name == "quartic":  # but for what the shape is off by
        assert np.median(wrong) < 1e-6


def test_bounds_are_not_far_too_large():
    # Straight through the middle of a shell, where the sixth derivative is the greatest.
    width = np.linspace(0.3, 2.5, 200)
    points = np.linspace(-0.5, 0.5, 4)[:, None] * width
    found, off = solved(points, backend_of("double"))
    assert np.all(off < 5 * np.abs(found - exact(points)) + 1e-15)


def test_two_samples_are_exact_for_cubics_and_off_by_at_most_their_kernel():
    a, b = PAIR
    for degree in range(4):
        assert 0.5 * (a**degree + b**degree) == pytest.approx(1 / (degree + 1), rel=1e-14)
    bend = np.linspace(0, 1, 2001)  # of (s - bend)+ the mean is (1 - bend)²/2
    off = 0.5 * (np.maximum(a - bend, 0) + np.maximum(b - bend, 0)) - 0.5 * (1 - bend) ** 2
    assert 0.99 * BEND < np.abs(off).max() <= BEND


TABLES = {
    "regular": np.linspace(-4, 4, 17),
    "irregular": np.cumsum(np.random.default_rng(2).uniform(0.05, 1, 17)) - 4,
    "two nodes": np.array([-1.0, 1.5]),
}


@pytest.mark.parametrize("kind", TABLES)
def test_means_of_tables_are_within_their_bound(kind):
    nodes, backend = TABLES[kind], backend_of("double")
    column = np.random.default_rng(3).random(len(nodes))
    medium = vm.Table("a", nodes, column, column, 1.0)
    points = cubics(2000, 4)
    stretch = stretches(points, backend)
    found = medium.sampled(stretch, stretch.context)
    s = (np.arange(2000) + 0.5) / 2000  # the middles of as many parts: off by 1e-7
    exact = np.mean([np.interp(bezier(points, place), nodes, column) for place in s], axis=0)
    wrong = np.abs(found.mean.extinction[0].numpy() - exact)
    off = found.off.extinction[0].numpy()
    assert np.all(wrong <= off + 1e-6)
    assert (off == 0).mean() > 0.05  # within an interval: exact


def test_compared_samples():
    a = np.array(FIVE)
    for degree in range(9):
        mean, first, last, off = compared(list(a**degree))
        assert (mean == pytest.approx(1 / (degree + 1), rel=1e-14)) == (degree < 8)
        assert (off < 1e-15) == (degree < 2)
        assert off < 0.02 or degree > 3  # little more than nothing where both rules are exact
        assert (first, last) == (a[0] ** degree, 1.0)


def test_compared_samples_tell_of_a_step_wherever_it_is():
    """Two rules agree about a step at some places; what is told is not far below the truth."""
    for place in np.linspace(0.001, 0.999, 400):
        mean, _, _, off = compared([float(s > place) for s in FIVE])
        assert abs(mean - (1 - place)) < 1.5 * off


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


SHELL = vm.Gaussian("a", 0.6, 0.2, (1, 0.5, 0.2), 2.0, 0.3)
BY = vm.ColorBy("b", "viridis", 0, 3)
MEDIA = {
    "one": SHELL,
    "two": SHELL + vm.Gaussian("log10(b)", 0.1, 0.1, (0.1, 0.5, 1), 0.5, 0.3),
    "per channel": vm.Gaussian("a", 0.6, 0.3, (1, -0.5, 0.2), (0.5, 1.0, 3.0), 0.3),
    "table": vm.Colormap("a", "viridis", 0, 2, 0.7, 0.3),
    "soft gate": SHELL.replace(where="1 / (1 + exp(-(b - 1) / 0.2))"),
    "coloured": vm.Rectangle("a", 0.6, 0.3, BY, 2.0, 0.3, where="b > 1"),
    "beside a kink": SHELL + vm.Gaussian("abs(b - 1.2)", 0.1, 0.3, (0.1, 0.5, 1), 0.5, 0.3),
    "coefficients": vm.Coefficients(["a**2", "exp(-b)"], ["b", "2 * a**2"]),
    "beside a surface": SHELL + vm.Isosurface("b", 1.2, (0.1, 0.5, 1), 0.5),
}


def test_tables_with_jumps_are_not_smooth():
    assert vm.Table("a", [0, 1, 2], [0, 1, 0], [0, 1, 0], 1.0).sampling.smooth
    assert not vm.Table("a", [0, 1, 1, 2], [0, 0, 1, 0], [0, 0, 1, 0], 1.0).sampling.smooth
    assert vm.Table("a", [0, 1, 2], [0, 1, 0], [0, 1, 0], 1.0, where="b > 1").sampling.smooth
    assert not vm.Table("a", [0, 1, 2], [0, 1, 0], [0, 1, 0], 1.0, where="b").sampling.smooth


def never_smooth(monkeypatch, kind):
    """Let media of a class never be sampled over whole segments."""
    rule = kind.sampling.fget
    monkeypatch.setattr(kind, "sampling", property(lambda self: replace(rule(self), smooth=False)))


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    ("kind", "order"),
    [*((kind, "front-to-back") for kind in MEDIA), ("two", "back-to-front")],
)
def test_pictures_are_those_of_panels(kind, order, monkeypatch):
    data, medium = volume(), MEDIA[kind]
    camera = vm.Orthographic(60, 30, resolution=24)
    options = {"precision": "single", "order": order, "cutoff": 0}
    image = vm.render(data, medium, camera, **options)
    never_smooth(monkeypatch, type(medium))
    for part in medium.components():
        never_smooth(monkeypatch, type(part))
    panels = vm.render(data, medium, camera, **options)
    off = np.abs(image.intensity - panels.intensity).max(-1)
    assert np.all(off <= image.error + panels.error)
    assert not np.array_equal(image.error, panels.error)  # it was another way


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


def test_double_precision_has_the_digits_of_linear_fields():
    """Closed forms are exact there, however coarse the tolerance, but for what is beyond 6 σ."""
    data = vm.Volume(vm.CartesianGrid.uniform(9, (-1, 1)))
    data["a"] = "x + 0.3*y - 0.2*z"
    medium = vm.Gaussian("a", 0.1, 0.02, (3.0,), 0.4, 0.1)
    camera = vm.Orthographic(60, 30, width=1.2, resolution=8)
    found, truth = (
        vm.render(data, medium, camera, precision="double", tolerance=t).intensity
        for t in (1e-3, 1e-9)
    )
    np.testing.assert_allclose(found, truth, rtol=1e-7)
