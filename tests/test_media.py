"""What media are: their coefficients against plain NumPy formulas, and what they refuse."""

from __future__ import annotations

import functools
import json
import math

import matplotlib
import numpy as np
import pytest
from astropy import units as u
from matplotlib import colors

import voluminous.math as vmath
from voluminous.backend import dr, from_host, get_backend
from voluminous.errors import ExpressionError, InputError, UnitsError, UnknownNameError
from voluminous.media import (
    Coefficients,
    Colormap,
    Context,
    Function,
    Gaussian,
    Medium,
    Rectangle,
    Table,
)
from voluminous.media.bound import Binding

X = np.array([-math.inf, -1e4, -2.5, -1.0, 0.0, 0.3, 1.0, 1.7, 2.0, 3.0, 8.25, 1e5, math.inf])


PLAIN = Binding()


def context(precision="double"):
    """What `render` evaluates media with."""
    backend = get_backend("cpu", precision)
    return Context(backend.Wide, backend.wide)


def solve(medium, ctx, binding=PLAIN, **fields):
    """Return j and α as arrays (channel, value)."""
    given = {name: from_host(ctx.real, value) for name, value in fields.items()}
    found = medium.bind(binding).coefficients(given, ctx)
    count = max((np.size(value) for value in fields.values()), default=1)

    def stacked(values):
        return np.array([np.broadcast_to(v.numpy(), count) for v in values])

    return stacked(found.emissivity), stacked(found.extinction)


@pytest.fixture(params=["single", "double"])
def ctx(request):
    return context(request.param)


def field_in(unit):
    """A volume in cm whose expressions all have one unit."""
    return context("single"), Binding(u.cm, lambda expression: unit)


# --- shapes ---------------------------------------------------------------------------------------


def test_a_gaussian_is_the_formula(ctx):
    j, a = solve(Gaussian("2*x", 1.2, 3.3, (0.4, -0.8, 0), 0.25, 7.0), ctx, x=X)
    shape = np.exp(-0.5 * ((2 * X - 1.2) / 3.3) ** 2)
    expected = np.multiply.outer([0.4, -0.8, 0], shape) / 7
    # The exponent is at most 18 where x is 8.25: its rounding of 2 ε becomes 36 ε.
    np.testing.assert_allclose(j, expected, rtol=1e-14, atol=1e-300)
    np.testing.assert_allclose(a, [0.25 / 7 * shape], rtol=1e-14, atol=1e-300)


def test_a_rectangle_is_exact(ctx):
    j, a = solve(Rectangle("x", 1, 2, (1, 5), (2, 3), 0.1), ctx, x=X)
    inside = (X >= -1) & (X <= 3)  # both ends belong to it
    np.testing.assert_array_equal(j, np.multiply.outer([10.0, 50.0], inside))
    np.testing.assert_array_equal(a, np.multiply.outer([20.0, 30.0], inside))


MEDIA_OF_X = [
    Gaussian("x", 1, 2, 1, 1, 1),
    Rectangle("x", 1, 2, 1, 1, 1),
    Table("x", [0, 1, 3], [1, 2, 3], [1, 2, 3], 1),
    Coefficients("x", "x**2"),
    Function(lambda x: (x, x * x), ["x"], 1),
]


@pytest.mark.parametrize("medium", MEDIA_OF_X, ids=lambda medium: type(medium).__name__)
def test_bad_data_stay_bad(medium, ctx):
    # They must not look like emptiness: `render` refuses them.
    j, a = solve(medium, ctx, x=[math.nan, 1.0])
    assert np.isnan(j[0, 0])
    assert np.isnan(a[0, 0])
    assert np.isfinite([j[0, 1], a[0, 1]]).all()


def test_shapes_take_units():
    medium = Gaussian("T", 20 * u.K, 5000 * u.mK, 1, 2, 1 * u.pc)
    j, a = solve(medium, *field_in(u.K), T=[20.0, 25.0])
    expected = np.array([1, math.exp(-0.5)]) / (1 * u.pc).to_value(u.cm)
    np.testing.assert_allclose(j, [expected], rtol=1e-15)
    np.testing.assert_allclose(a, [2 * expected], rtol=1e-15)


@pytest.mark.parametrize(
    ("medium", "message"),
    [
        (Gaussian("T", 20 * u.m, 5, 1, 1, 1), "center is in m, expected K"),
        (Gaussian("T", 20, 5 * u.m, 1, 1, 1), "sigma is in m, expected K"),
        (Rectangle("T", 20, 5 * u.m, 1, 1, 1), "half_width is in m, expected K"),
        (Gaussian("T", 20, 5, 1, 1, 1 * u.s), "path_length is in s, expected cm"),
        (Table("T", [1, 2] * u.m, [1, 2], 1, 1), "values is in m, expected K"),
        (Table("T", [1, 2], [1, 2], 1, 1 * u.s), "path_length is in s, expected cm"),
    ],
)
def test_units_that_do_not_fit_are_refused(medium, message):
    with pytest.raises(UnitsError, match=message):
        solve(medium, *field_in(u.K), T=[1.0])


# --- tables ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("entries", [2, 3, 4, 5, 1000])
def test_a_table_is_linear_between_its_entries(entries, ctx):
    rng = np.random.default_rng(entries)
    nodes = np.sort(rng.normal(size=entries))
    h, opacity = rng.normal(size=(entries, 2)), rng.random(entries)
    x = np.concatenate([X, nodes, np.linspace(nodes[0] - 1, nodes[-1] + 1, 3001)])
    j, a = solve(Table("x", nodes, h, opacity, 0.5), ctx, x=x)
    # The position within a segment loses some ε of x, divided by the width of the segment.
    tolerance = 8 * np.finfo(float).eps * (1 + 4 / np.diff(nodes).min())
    for c in range(2):
        expected = np.interp(x, nodes, h[:, c]) / 0.5
        np.testing.assert_allclose(j[c], expected, rtol=0, atol=10 * tolerance)
    np.testing.assert_allclose(a[0], np.interp(x, nodes, opacity) / 0.5, rtol=0, atol=2 * tolerance)


@pytest.mark.parametrize(
    ("nodes", "entries", "x", "expected"),
    [
        ([0, 1, 1, 2], [0, 1, 5, 7], [0.5, 1, 1.5], [0.5, 5, 6]),
        ([0, 1, 1], [0, 1, 5], [0.5, 1, 1.5, 9], [0.5, 5, 5, 5]),
        ([1, 1, 2], [3, 5, 7], [-9, 0.5, 1, 1.5], [3, 3, 5, 6]),
        ([1, 1], [3, 5], [0, 0.5, 1, 1.5], [3, 3, 5, 5]),
        ([0, 1, 1, 1, 2], [0, 1, 8, 5, 7], [0.5, 1, 1.5], [0.5, 5, 6]),
    ],
)
def test_two_equal_values_are_a_jump(nodes, entries, x, expected, ctx):
    j, a = solve(Table("x", nodes, entries, entries, 1), ctx, x=x)
    np.testing.assert_array_equal(j[0], expected)
    np.testing.assert_array_equal(a[0], expected)
    just_before, _ = solve(Table("x", nodes, entries, 1, 1), ctx, x=np.nextafter([1.0], 0))
    assert just_before[0, 0] == pytest.approx(entries[nodes.index(1)], rel=1e-15)


# --- colormaps ------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["inferno", "tab20"])
@pytest.mark.parametrize(
    ("norm", "own"),
    [
        (None, colors.Normalize(0.5, 200)),
        ("log", colors.LogNorm(0.5, 200)),
        ("symlog", colors.SymLogNorm(0.2, vmin=0.5, vmax=200)),
        ("asinh", colors.AsinhNorm(0.2, vmin=0.5, vmax=200)),
        (colors.PowerNorm(0.5), colors.PowerNorm(0.5, 0.5, 200)),
    ],
)
def test_colours_are_matplotlib_s(name, norm, own, ctx):
    x = np.concatenate([np.linspace(-3, 300, 500), np.geomspace(0.5, 200, 500)])
    j, a = solve(Colormap("x", name, 0.5, 200, 0.25, 2.0, norm=norm), ctx, x=x)
    cmap = matplotlib.colormaps[name]
    # matplotlib rounds the position to one of 256, between which we are linear: the difference is
    # at most that between two neighbours.
    step = np.abs(np.diff(cmap(np.linspace(0, 1, 256))[:, :3], axis=0)).max()
    expected = cmap(own(np.clip(x, 0.5, 200)))[:, :3].T
    np.testing.assert_allclose(j / (0.25 / 2), expected, rtol=0, atol=step + 1e-12)
    np.testing.assert_array_equal(a, 0.25 * (1 / 2.0))


# --- coefficients and functions -------------------------------------------------------------------


def test_coefficients_are_their_expressions(ctx):
    x, y = np.random.default_rng(1).uniform(0.1, 3, (2, 20))
    medium = Coefficients(["x", "x*y**2", 2], ["x + y", "where(x > 1, y, 0)", "exp(-x)"])
    j, a = solve(medium, ctx, x=x, y=y)
    np.testing.assert_allclose(j, [x, x * y**2, np.full(20, 2.0)], rtol=1e-15)
    np.testing.assert_allclose(a, [x + y, np.where(x > 1, y, 0), np.exp(-x)], rtol=1e-15)


@pytest.mark.parametrize(
    ("volume", "extinction", "factor"),
    [(u.cm, u.pc**-1, 1 / 3.0856775814913673e18), (u.cm, u.cm**2 / u.cm**3, 1), (u.au, None, 1)],
)
def test_extinction_with_a_unit_is_converted(volume, extinction, factor):
    binding = Binding(volume, lambda e: extinction if e.text == "k" else u.erg)
    j, a = solve(Coefficients(["k", 1], "k"), context("single"), binding, k=[2.0])
    np.testing.assert_array_equal(j, [[2], [1]])
    np.testing.assert_allclose(a, [[2 * factor]], rtol=1e-15)


@pytest.mark.parametrize(
    ("volume", "extinction", "message"),
    [
        (u.cm, u.g / u.cm**3, "'rho' is in g / cm3, expected an inverse length such as 1 / cm"),
        (u.cm, u.cm, "'rho' is in cm, expected an inverse length such as 1 / cm"),
        (None, u.cm**-1, "'rho' is in 1 / cm, expected a plain number, since the grid"),
    ],
)
def test_an_extinction_that_is_no_inverse_length_is_refused(volume, extinction, message):
    with pytest.raises(UnitsError, match=message):
        solve(Coefficients("1", "rho"), context(), Binding(volume, lambda e: extinction), rho=[1.0])


def swirl(density, speed, *, opacity, shift):
    glow = vmath.where(speed > 1, vmath.exp(-speed), 0.0)
    return (density * glow, density, shift), opacity * density


def test_a_function_is_what_it_returns(ctx):
    x, v = np.random.default_rng(2).uniform(0, 3, (2, 30))
    medium = Medium.from_function(
        swirl, ["x", "sqrt(v*v)"], channels=3, parameters={"opacity": 0.5, "shift": 0.25}
    )
    j, a = solve(medium, ctx, x=x, v=v)
    glow = np.where(v > 1, np.exp(-v), 0)
    np.testing.assert_allclose(j, [x * glow, x, np.full(30, 0.25)], rtol=1e-14)
    np.testing.assert_allclose(a, [0.5 * x], rtol=1e-15)
    assert medium.names == ("x", "v")


@pytest.mark.parametrize(
    ("function", "grey", "message"),
    [
        (lambda x: x, True, r"must return \(emissivity, extinction\), got Float64"),
        (lambda x: (x, x, x), True, r"must return \(emissivity, extinction\), got tuple"),
        (lambda x: (x, x), True, "returned 1 values of emissivity, expected 2"),
        (lambda x: ([x, x], [x, x]), True, "returned 2 values of extinction, expected 1"),
        (lambda x: ([x, x], x), False, "returned 1 values of extinction, expected 2"),
    ],
)
def test_a_function_that_returns_something_else_is_refused(function, grey, message, ctx):
    with pytest.raises(InputError, match=message):
        solve(Medium.from_function(function, "x", 2, grey=grey), ctx, x=[1.0])


# --- sums -----------------------------------------------------------------------------------------

GREY = Gaussian("x", 0, 1, (1, 2), 3, 1)
COLOURED = Rectangle("y", 0, 1, (10, 20), (30, 40), 1)
FIELDS = Coefficients(["x", "y"], "x*y")


def test_emissivities_and_extinctions_add(ctx):
    fields = {"x": [0.0, 1.0, 2.0], "y": [0.5, 3.0, 1.0]}
    j, a = solve(GREY + COLOURED + FIELDS, ctx, **fields)
    parts = [solve(m, ctx, **fields) for m in (GREY, COLOURED, FIELDS)]
    np.testing.assert_array_equal(j, sum(part[0] for part in parts))
    np.testing.assert_array_equal(a, sum(part[1] for part in parts))  # a grey one counts in all
    assert a.shape == (2, 3)


# --- what is refused ------------------------------------------------------------------------------

G = functools.partial(Gaussian, "x")
T = functools.partial(Table, "x")
C = functools.partial(Colormap, "x")
REFUSED = {
    ExpressionError: [
        (lambda: Gaussian("log10(", 0, 1, 1, 1, 1), "never closed"),
        (lambda: Coefficients("x +", "y"), "ends too early"),
        (lambda: Function(abs, ["x +"], 1), "ends too early"),
    ],
    UnknownNameError: [
        (lambda: T([1, 2], ["red", "gren"], 1, 1), "'gren'; did you mean"),
        (lambda: C("infernal", 0, 1, 1, 1), "'infernal'; did you mean 'inferno'"),
        (lambda: C("gray", 0, 1, 1, 1, norm="lgo"), "did you mean 'log'"),
        (lambda: solve(G(0, 1, 1, 1, 1), context(), xx=[1.0]), "unknown field 'x'"),
    ],
    UnitsError: [(lambda: C("gray", 1 * u.K, 2 * u.m, 1, 1), "vmax is in m, expected K")],
    InputError: [
        (lambda: G("a", 1, 1, 1, 1), "center must be a number, a quantity, or a text such as"),
        (lambda: G([0, 1], 1, 1, 1, 1), "center must be one number or quantity"),
        (lambda: G(math.nan, 1, 1, 1, 1), "center must be finite, got nan"),
        (lambda: G(0, -1 * u.K, 1, 1, 1), r"sigma must be positive, got -1.0 K"),
        (lambda: Rectangle("x", 0, -1, 1, 1, 1), "half_width must be positive, got -1"),
        (lambda: G(0, 1, 1, 1, 0), "path_length must be positive, got 0"),
        (lambda: G(0, 1, {"r": 1}, 1, 1), "color must be a number or one number per channel"),
        (lambda: G(0, 1, [], 1, 1), r"color must be finite, one number per channel, got \["),
        (lambda: G(0, 1, (1, math.inf), 1, 1), "color must be finite"),
        (lambda: G(0, 1, (1, 2) * u.K, 1, 1), "color must be plain numbers, got .* K"),
        (lambda: G(0, 1, 1, -0.1, 1), "opacity must not be negative, got -0.1"),
        (lambda: G(0, 1, 1, 1 * u.m, 1), "opacity must be plain numbers, got 1.0 m"),
        (lambda: G(0, 1, (1, 2, 3), (1, 2), 1), r"one number \(grey\) or 3 .* got 2"),
        (lambda: T([1], [1], 1, 1), r"values must be at least two numbers, got shape \(1,\)"),
        (lambda: T([1, 3, 2], [1, 1, 1], 1, 1), "must increase; 3 is followed by 2"),
        (lambda: T([1, math.nan], [1, 1], 1, 1), "values must be finite"),
        (lambda: T(["a", "b"], [1, 1], 1, 1), "values must be a number, a quantity, or a text"),
        (lambda: T([1, 2], [1, 2] * u.K, 1, 1), "colors must be plain numbers, got .* K"),
        (lambda: T([1, 2], [1, 2, 3], 1, 1), r"colors must have 2 rows .* got shape \(3, 1\)"),
        (lambda: T([1, 2], "red", 1, 1), "colors must be numbers, got"),
        (lambda: T([1, 2], ["red", 0.5], 1, 1), "red, green and blue only"),
        (lambda: T([1, 2], [1, math.nan], 1, 1), "colors must be finite"),
        (lambda: T([1, 2], [1, 2], [1, -2], 1), "opacities must not be negative, got -2"),
        (lambda: T([1, 2], np.ones((2, 3)), np.ones((2, 2)), 1), "one column .* or 3, got 2"),
        (lambda: C(3, 0, 1, 1, 1), "a colormap must be a name"),
        (lambda: C("gray", 1, 1, 1, 1), "vmin must be below vmax, got 1.0 and 1.0"),
        (lambda: C("gray", 0, math.inf, 1, 1), "vmax must be finite, got inf"),
        (lambda: C("gray", 0, 1, 1, 1, norm="log"), "needs a positive vmin, got 0"),
        (lambda: C("gray", 0, 1, 1, 1, norm=3), "norm must be the name of a norm"),
        (lambda: C("gray", 1, 9, 1, 1, norm=colors.LogNorm(1, 10)), "vmax is 9, but the norm has"),
        (
            lambda: C("gray", 0, 2, 1, 1, norm=colors.BoundaryNorm([0, 1, 2], 9)),
            "BoundaryNorm cannot be used from 0 to 2: BoundaryNorm is not invertible; use",
        ),
        (lambda: C("gray", 0, 1, "much", 1), "opacity must be a number or a function"),
        (lambda: C("gray", 0, 1, [1, 2], 1), "opacity must be one number, or a function"),
        (lambda: C("gray", 0, 1, lambda p: p - 1, 1), "must not be negative, got -1"),
        (lambda: C("gray", 0, 1, 1, 1, samples=2.5), "samples must be a whole number"),
        (lambda: Coefficients([], "x"), "emissivity must be an expression or a list"),
        (lambda: Coefficients("x", ["y", "y"]), "give two emissivities, one per channel"),
        (lambda: Function("f", ["x"], 1), "from_function needs a function, got 'f'"),
        (lambda: Function(abs, ["x"], 0), "channels must be a whole number from 1 .*, got 0"),
        (lambda: Function(abs, "x", 1, parameters={"a": "b"}), "'a' must be a number"),
    ],
}


@pytest.mark.parametrize("error", REFUSED)
def test_what_cannot_be_a_medium_is_refused(error):
    for make, message in REFUSED[error]:
        with pytest.raises(error, match=message):
            make()


# --- identity and description ---------------------------------------------------------------------


def variants():
    """Media that all differ from each other."""
    yield from (G(c, s, 1, 1, 1) for c, s in ((0, 1), (1, 1), (1, 2), (1 * u.K, 2), (1, 2 * u.K)))
    yield from (Gaussian("y", 0, 1, 1, 1, 1), Rectangle("x", 0, 1, 1, 1, 1))
    yield from (G(0, 1, (1, 2), 1, 1), G(0, 1, (1, 2), (1, 3), 1), G(0, 1, 1, 2, 1))
    yield from (G(0, 1, 1, 1, 2), G(0, 1, 1, 1, 2 * u.cm), G(0, 1, 1, 1, 2 * u.pc))
    yield from (T([0, 1], [1, 2], 1, 1), T([0, 2], [1, 2], 1, 1), T([0, 1] * u.K, [1, 2], 1, 1))
    yield from (T([0, 1], [1, 3], 1, 1), T([0, 1], [1, 2], 2, 1), T([0, 1], [1, 2], 1, 2))
    yield from (Table("y", [0, 1], [1, 2], 1, 1), T([0, 1], np.ones((2, 2)), 1, 1))
    yield T([0, 1], np.ones((2, 2)), np.ones((2, 2)), 1)
    yield from (C("gray", 0, 1, 1, 1), C("hot", 0, 1, 1, 1), C("gray", 0, 1, lambda p: p, 1))
    yield from (C("gray", 1, 2, 1, 1), C("gray", 1, 2, 1, 1, norm="log"))
    yield from (Coefficients("x", "y"), Coefficients("y", "x"), Coefficients(["x", "x"], "y"))
    yield from (Coefficients(["x", "x"], ["y", "y"]), GREY + COLOURED, COLOURED + GREY)


def test_media_have_the_same_key_only_if_they_are_the_same():
    keys = [medium.key() for medium in variants()]
    assert len(set(keys)) == len(keys)  # which also hashes them
    assert keys == [medium.key() for medium in variants()]
    assert G(0, 1, 1, 1, 1).key() == Gaussian("x", 0.0, 1, (1.0,), [1], np.float32(1)).key()


def test_media_are_described_by_plain_values():
    made = [*variants(), Function(swirl, ["x", "v"], 3, parameters={"opacity": np.float32(1)})]
    made += [C("gray", 0, np.float32(1), np.float32(0.5), np.int64(2))]
    described = [json.loads(json.dumps(medium.describe())) for medium in made]
    kinds = {"gaussian", "rectangle", "table", "colormap", "coefficients", "sum", "function"}
    assert {d["type"] for d in described} == kinds


def test_a_description_makes_the_medium_again():
    for medium in (GREY, COLOURED):
        described = medium.describe()
        described.pop("type")
        assert type(medium)(**described).key() == medium.key()
    described = Gaussian("T", 20 * u.K, 3, (1, 2), 0.5, 2.5e16 * u.cm).describe()
    assert described == {
        "type": "gaussian",
        "expr": "T",
        "center": "20.0 K",
        "sigma": 3.0,
        "color": [1.0, 2.0],
        "opacity": 0.5,
        "path_length": "2.5e+16 cm",
    }


# --- turning numbers ------------------------------------------------------------------------------


def kernels(medium):
    """Return what identifies the machine code made for a medium."""
    ctx = context("single")
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        solved = medium.bind(Binding()).coefficients({"x": dr.opaque(ctx.real, 2, shape=8)}, ctx)
        dr.eval(solved.emissivity, solved.extinction)
        history = dr.kernel_history()
    return [entry["hash"] for entry in history if entry["type"] == dr.KernelType.JIT]


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (G(0, 1, (1, 2), 3, 4), G(1, 2, (3, 4), 5, 6)),
        (Rectangle("x", 0, 1, 1, 1, 1), Rectangle("x", 1, 2, 3, 4, 5)),
        (T([0, 1, 2, 3, 4], range(5), 1, 1), T([0, 3, 5, 6, 7, 8], range(6), 2, 3)),
        (C("gray", 0, 1, 1, 1), C("viridis", 1, 2, 2, 3, norm="log")),
        (Coefficients("2*x + 1", "3"), Coefficients("5*x + 6", "4")),
        (
            Function(lambda x, *, a: (a * x, x), "x", 1, parameters={"a": 1.0}),
            Function(lambda x, *, a: (a * x, x), "x", 1, parameters={"a": 2.0}),
        ),
    ],
)
def test_turning_a_number_does_not_compile_again(one, other):
    assert kernels(one) == kernels(other) != []
