"""Derivatives in expressions: gradmag, laplacian and grad, and the vectors they make."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from astropy import units as u
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import voluminous as vm
from expression_trees import expressions
from voluminous.errors import ExpressionError, UnknownNameError
from voluminous.expressions import Expression, components, derived_field

# Three different irregular axes.
EDGES = [
    np.array([-1.0, -0.7, -0.2, 0.5, 0.6, 1.3]),
    np.array([0.0, 0.4, 1.0, 1.1]),
    np.array([2.0, 2.5, 2.6, 4.0, 4.1, 4.5, 6.0]),
]
GRID = vm.CartesianGrid(*EDGES)
X, Y, Z = np.meshgrid(*GRID.centers, indexing="ij")
OPERATORS = ["gradmag(f)", "laplacian(f)", "grad(f).x", "grad(f).y", "grad(f).z"]


def smooth(n):
    """Return a volume with a sine wave of length 4 along the diagonal, on stretched axes."""
    s = np.linspace(-1, 1, n + 1)
    volume = vm.Volume(vm.CartesianGrid(*(s + 0.1 * np.sin(3 * s) for _ in range(3))))
    volume["f"] = "sin(x + y + z)"
    return volume


def twin(operation, f, centers):
    """Return what an operation should give, by NumPy's gradient and by parabolas through points."""
    if operation == "laplacian(f)":
        return sum(curvature(f, x, axis) for axis, x in enumerate(centers))
    gradient = [
        np.gradient(f, x, axis=axis, edge_order=min(2, len(x) - 1)) if len(x) > 1 else 0 * f
        for axis, x in enumerate(centers)
    ]
    if operation == "gradmag(f)":
        return np.sqrt(gradient[0] ** 2 + gradient[1] ** 2 + gradient[2] ** 2)
    return gradient["xyz".index(operation[-1])]


def curvature(f, x, axis):
    if len(x) < 3:
        return 0 * f

    def along(line):
        middle = np.clip(np.arange(len(x)), 1, len(x) - 2)
        # Shifted and scaled, so that the fit is well conditioned.
        fits = [np.polyfit((x[i - 1 : i + 2] - x[i]), line[i - 1 : i + 2], 2) for i in middle]
        return 2 * np.array([fit[0] for fit in fits])

    return np.apply_along_axis(along, axis, f)


# --- the numbers ---------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_a_constant_has_derivatives_of_exactly_zero(dtype):
    volume = vm.Volume(GRID, f=np.full(GRID.shape, 0.1, dtype))
    for operation in OPERATORS:
        found = volume.evaluate(operation)
        assert found.dtype == dtype
        np.testing.assert_array_equal(found, 0)


def test_quadratic_fields_are_exact_at_the_faces_too():
    volume = vm.Volume(GRID, f=X**2 - 3 * Y**2 + 0.5 * Z**2 + X * Y - Y * Z)
    expected = np.stack([2 * X + Y, -6 * Y + X - Z, Z - Y])
    np.testing.assert_allclose(volume.evaluate("grad(f)"), expected, atol=1e-12)
    np.testing.assert_allclose(volume.evaluate("laplacian(f)"), 2 - 6 + 1, atol=1e-11)


@pytest.mark.parametrize("operation", OPERATORS)
@pytest.mark.parametrize(
    ("part", "order"), [("inside", 2), ("everywhere", {"laplacian(f)": 1})], ids=lambda p: str(p)
)
def test_order_of_convergence(operation, part, order):
    if isinstance(order, dict):
        order = order.get(operation, 2)
    exact = {"gradmag(f)": "sqrt(3)*abs(cos(x+y+z))", "laplacian(f)": "-3*sin(x+y+z)"}
    inside = (slice(2, -2),) * 3 if part == "inside" else ...
    errors = []
    for n in (16, 32, 64):
        volume = smooth(n)
        difference = volume.evaluate(f"{operation} - {exact.get(operation, 'cos(x+y+z)')}")
        errors.append(np.sqrt(np.mean(difference[inside] ** 2)))
    # The mean square over a surface layer of first order is of order 1.5.
    slope = np.log2(errors[1] / errors[2])
    assert slope > order - 0.15
    assert errors[0] < 0.2


@given(st.data())
@settings(max_examples=60)
def test_they_agree_with_an_independent_twin(data):
    counts = data.draw(st.tuples(*[st.integers(1, 5)] * 3))
    widths = [data.draw(hnp.arrays(float, n, elements=st.floats(0.25, 4))) for n in counts]
    grid = vm.CartesianGrid(*(np.concatenate([[-1.0], -1 + np.cumsum(w)]) for w in widths))
    values = st.floats(-10, 10, width=32)
    dtype = data.draw(st.sampled_from(["float32", "float64"]))
    f = data.draw(hnp.arrays(dtype, counts, elements=values))
    volume = vm.Volume(grid, f=f)
    for operation in OPERATORS:
        expected = twin(operation, f.astype(float), grid.centers)
        # Values of 10 over distances of 0.25, a fit by least squares; float32 rounds the result.
        np.testing.assert_allclose(
            volume.evaluate(operation), expected, atol=1e-10, rtol=1e-7 if dtype == "float32" else 0
        )


def test_pieces_do_not_show():
    """Four planes of a million cells are taken two at a time, a part of them at once."""
    edges = [
        np.cumsum(0.5 + np.random.default_rng(k).random(n + 1))
        for k, n in enumerate((4, 1024, 1024))
    ]
    f = np.random.default_rng(1).random((4, 1024, 1024))
    whole = vm.Volume(vm.CartesianGrid(*edges), f=f)
    part = vm.Volume(vm.CartesianGrid(edges[0], edges[1][:9], edges[2][:9]), f=f[:, :8, :8])
    for operation in OPERATORS:
        found, expected = (v.array(operation)[:, :7, :7] for v in (whole, part))
        np.testing.assert_array_equal(found, expected)


def test_single_precision_holds_any_system_of_units():
    # A density of 1e-20 g/cm³ over parsecs in cm: its gradient is below what float32 can hold.
    grid = vm.CartesianGrid.uniform(6, (-3e18, 3e18), unit="cm")
    volume = vm.Volume(grid, f=(1e-20 * (1 + X6 / 10)).astype("float32"))
    gradient = volume.array("gradmag(f)")
    assert gradient.dtype == np.float64
    np.testing.assert_allclose(gradient, 1e-39, rtol=1e-5)  # float32 differences of 1/10


X6 = np.arange(6.0)[:, None, None] + np.zeros((6, 6, 6))


# --- the language --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "same",
    [
        [
            "gradmag(density)",
            'gradmag("density")',
            " gradmag( 'density' ) ",
            'norm(grad("density"))',
        ],
        ["laplacian(log10(a)*2.0)", 'laplacian(" log10(a) * 2 ")'],
        ["grad(a**0.5).x", 'grad("sqrt(a)").x', "(grad((sqrt(a)))).x"],
        ["laplacian(gradmag(a))", "laplacian('gradmag(\"a\")')"],
    ],
)
def test_ways_to_write_the_same(same):
    first, *others = map(Expression, same)
    assert len(first.names) == 1
    for other in others:
        assert other == first
        assert hash(other) == hash(first)
        assert other.names == first.names
    assert pickle.loads(pickle.dumps(first)).names == first.names


@given(expressions())
def test_the_name_of_a_derivative_tells_what_it_is_made_of(argument):
    expression = Expression(f"gradmag({argument})")
    (name,) = expression.names
    derived = derived_field(name)
    assert derived.name == name
    assert derived.arguments == (Expression(argument),)
    assert Expression(name) == expression


def test_vectors():
    volume = vm.Volume(GRID, a=X * Y, b=Z - X, u=X, v=Y, w=Z)
    a, b = volume.evaluate("grad(a)"), volume.evaluate('grad("b")')
    assert a.shape == (3, *GRID.shape)
    close = {"rtol": 1e-12, "atol": 1e-13}
    np.testing.assert_allclose(volume.evaluate("dot(grad(a), grad(b))"), (a * b).sum(0), **close)
    np.testing.assert_allclose(volume.evaluate("norm(grad(a))"), np.sqrt((a * a).sum(0)), **close)
    vector = "vector(u, v, w)"
    np.testing.assert_array_equal(volume.evaluate(vector), np.stack([X, Y, Z]))
    np.testing.assert_array_equal(volume.evaluate(f"{vector}.z"), Z)
    np.testing.assert_allclose(volume.evaluate(f"norm({vector}) - r"), 0, atol=1e-15 * 8)
    along = volume.evaluate(f"dot({vector}, grad(a)) / norm({vector})")
    np.testing.assert_allclose(along, (X * a[0] + Y * a[1] + Z * a[2]) / volume.evaluate("r"))
    assert components("a + 1") == (Expression("a + 1"),)


REFUSED = [  # the text up to where the caret must be, the rest, and a part of the message
    ("", "grad(a)", "take a component with .x, .y or .z, or use norm(v) or dot(v, w)"),
    ("1 + ", "grad(a) * 2", "a vector, but a number is needed"),
    ("laplacian(", "grad(a))", "a vector, but a number is needed"),
    ("log10(", "vector(a, b, c))", "a vector, but a number is needed"),
    ("vector(a, b, ", "grad(a))", "a vector, but a number is needed"),
    ("", "grad(a).w", ".x, .y and .z, not .w"),
    ("", "gradmag(a).x", "only a vector has components"),
    ("", "a.x", "'.' after a name"),
    ("dot(grad(a), ", "2 * b)", "a vector is needed"),
    ("norm(", "x)", "a vector is needed"),
    ("", "grad(a, b)", "call grad(x)"),
    ("gradmag(", "b'a')", "without quotes"),
    ("norm(", "'a b')", "quotes hold the name of a vector"),
    ("2 * ", "gradmag", "gradmag is a function"),
]


@pytest.mark.parametrize(("before", "rest", "message"), REFUSED, ids=[b + r for b, r, _ in REFUSED])
def test_refused_with_a_caret(before, rest, message):
    with pytest.raises(ExpressionError) as caught:
        Expression(before + rest)
    shown = str(caught.value).splitlines()
    assert message in shown[0]
    assert shown[1:] == [f"    {before}{rest}", f"    {' ' * len(before)}^"]


def test_long_and_deep_derivatives_are_refused_and_not_tried():
    deep = "a"
    for _ in range(49):
        deep = f"gradmag({deep} + 1)"
    assert derived_field(Expression(deep).names[0]) is not None
    with pytest.raises(ExpressionError, match="nested too deeply"):
        Expression(f"gradmag({deep} + 1)")
    # Each level names the one before three times.
    wide = "a"
    for _ in range(12):
        wide = f"dot(grad({wide}), vector(1, 1, 1))"
    with pytest.raises(ExpressionError, match="too long"):
        Expression(wide)


# --- as fields of a volume -----------------------------------------------------------------------


def test_they_are_fields_that_are_not_listed():
    volume = vm.Volume(GRID, density=X * Y)
    name = 'gradmag("density")'
    assert name in volume
    assert "gradmag(density * r)" in volume
    assert "gradmag(densty)" not in volume
    assert "gradmag(" not in volume
    assert "log10(density)" not in volume
    np.testing.assert_array_equal(volume[name], volume.array("gradmag(density)"))
    with pytest.raises(ValueError, match="read-only"):
        volume.array(name)[0, 0, 0] = 1
    assert volume.fields == tuple(volume) == ("density",)
    assert len(volume) == len(volume.units) == len(volume.describe()["fields"]) == 1


@pytest.mark.parametrize("use", ["evaluate", "array", "index", "set", "render"])
def test_an_unknown_field_in_a_derivative_names_the_nearest(use):
    volume = vm.Volume(GRID, density=X)
    expression = "laplacian(gradmag('log10(densty)'))"
    uses = {
        "evaluate": volume.evaluate,
        "array": volume.array,
        "index": volume.__getitem__,
        "set": lambda text: volume.__setitem__("derived", text),
        "render": lambda text: vm.render(volume, vm.Coefficients(text, 0), vm.Orthographic(2, 2)),
    }
    with pytest.raises(UnknownNameError, match="unknown field 'densty'; did you mean 'density'"):
        uses[use](expression)


def test_arguments_may_be_expressions_coordinates_and_derivatives():
    volume = vm.Volume(GRID, density=np.exp(X))
    for argument in ("density * r", "log10(density)", "x * y", "gradmag(density)", "density > 1"):
        inner = vm.Volume(GRID, f=volume.evaluate(argument))
        for operation in OPERATORS:
            expected = inner.evaluate(operation)
            found = volume.evaluate(operation.replace("f)", f"{argument})"))
            np.testing.assert_array_equal(found, expected)
    assert np.all(volume.evaluate("gradmag(2)") == 0)


@pytest.mark.parametrize(
    ("expression", "unit"),
    [
        ("gradmag(density)", "g / (cm3 pc)"),
        ("grad(density).y", "g / (cm3 pc)"),
        ("laplacian(density)", "g / (cm3 pc2)"),
        ("laplacian(gradmag(density))", "g / (cm3 pc3)"),
        ("gradmag(density) / density", "1 / pc"),
        ("dot(grad(density), grad(density))", "g2 / (cm6 pc2)"),
        ("norm(vector(density, density, density))", "g / cm3"),
        ("gradmag(log10(density))", "1 / pc"),
        ("gradmag(plain)", "1 / pc"),
        ("gradmag(r)", None),
        ("laplacian(r)", "1 / pc"),
    ],
)
def test_units(expression, unit):
    volume = vm.Volume(
        vm.CartesianGrid(*EDGES, unit="pc"), density=np.exp(X) * u.g / u.cm**3, plain=X
    )
    found = volume.expression_unit(Expression(expression))
    assert found is None if unit is None else found == u.Unit(unit)
    volume["derived"] = expression
    assert volume.units["derived"] == ("" if unit is None else str(found))


def test_they_are_computed_once():
    volume = vm.Volume(GRID, f=X, g=Y)
    first = volume.array("gradmag(f)")
    volume["g"] = Z  # another one
    volume.evaluate("gradmag(f) + gradmag(g)")
    assert np.shares_memory(volume.array("gradmag('f')"), first)


@pytest.mark.parametrize("change", ["set", "in place", "unit", "delete"])
def test_they_follow_their_fields(change):
    own = X.copy()
    volume = vm.Volume(GRID, f=own, g=Y)
    expression = "laplacian(gradmag(f * g)) + gradmag(f)"
    before = volume.evaluate(expression)
    if change == "delete":
        del volume["f"]
        assert "gradmag(f)" not in volume
        with pytest.raises(UnknownNameError, match="'f'"):
            volume.array("gradmag(f)")
        return
    if change == "set":
        volume["f"] = X**2
    elif change == "in place":
        own **= 2
    else:
        volume.set_unit("f", "K")
        assert volume["gradmag(f)"].unit == u.K
        np.testing.assert_array_equal(volume.evaluate(expression), before)
        return
    fresh = vm.Volume(GRID, f=X**2, g=Y)
    np.testing.assert_array_equal(volume.evaluate(expression), fresh.evaluate(expression))
    assert not np.array_equal(before, volume.evaluate(expression))


LOOKS = {
    "auto": lambda volume: vm.suggest_medium(volume, "gradmag(f)").describe(),
    "calibrate": lambda volume: SHELL.calibrated(volume).path_length,
    "colours": lambda volume: vm.Colormap("laplacian(f)", "viridis").calibrated(volume).key(),
    "measure": lambda volume: vm.measure(volume, "gradmag(f)")["gradmag(f)"],
    "render": lambda volume: vm.render(volume, SHELL, FEW).intensity.tolist(),
    "column": lambda volume: vm.column(volume, "gradmag(f)", FEW).intensity.tolist(),
    "cells": lambda volume: volume.cells(["gradmag(f)"])["gradmag(f)"].tolist(),
    "slice": lambda volume: volume.slice("gradmag(f)").values.tolist(),
}
SHELL = vm.Gaussian("gradmag(f)", 3.0, 1.0, 1.0, 0.5)
FEW = vm.Orthographic(20, 30, resolution=4)


@pytest.mark.parametrize("name", LOOKS)
def test_derivatives_of_what_was_changed_in_place_are_those_of_now(name):
    own = smooth(8).array("f").copy()
    volume = vm.Volume(smooth(8).grid, f=own)
    before = LOOKS[name](volume)
    own *= np.linspace(1, 3, 8)
    after = LOOKS[name](volume)
    assert after == LOOKS[name](vm.Volume(volume.grid, f=own.copy()))
    assert after != before


# --- in pictures ---------------------------------------------------------------------------------


@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("scheme", ["first-order", "second-order"])
def test_a_picture_of_a_derivative_is_that_of_a_field_with_its_values(scheme, precision):
    volume = smooth(12)
    volume["m"] = volume.evaluate("gradmag(f)")
    camera = vm.Orthographic(width=1.5, resolution=8)

    def picture(name):
        medium = vm.Gaussian(name, 1.5, 0.2, color=(1, 0.5), opacity=0.3, path_length=1)
        return vm.render(volume, medium, camera, scheme=scheme, precision=precision).intensity

    np.testing.assert_array_equal(picture('gradmag("f")'), picture("m"))
    assert picture("m").max() > 0.1


def test_cellwise_expressions_are_one_field():
    """In cells they are what they say; between them they are interpolated, as a field is."""
    volume = vm.models.prestellar_core(8)
    square = volume.evaluate("density**2")
    name = "cellwise(density**2 * (2 cm3))"
    np.testing.assert_allclose(volume.evaluate(name), 2.0 * square)
    assert volume.field_unit("cellwise(density**2)") == u.cm**-6
    volume["square"] = "density**2"
    camera = vm.Orthographic(20, 30, resolution=16)
    light = " * (1 erg cm3 / (s sr))"
    pictures = [
        vm.render(volume, vm.Coefficients(text + light, 0), camera, **options).intensity
        for text in ("square", "cellwise(density**2)")
        for options in ({}, {"memory": "1 GiB"})
    ]
    for picture in pictures[1:]:
        np.testing.assert_allclose(picture, pictures[0], rtol=1e-5)
    product = vm.render(volume, vm.Coefficients("density**2" + light, 0), camera).intensity
    assert product.sum() < 0.9 * pictures[0].sum()


def test_derivatives_of_expressions_with_units():
    """The name of a field that is derived tells the units of numbers in it."""
    volume = vm.models.prestellar_core(8)
    found = volume.evaluate("gradmag(density * (2 cm3))")
    np.testing.assert_allclose(found, 2.0 * volume.evaluate("gradmag(density)"))
