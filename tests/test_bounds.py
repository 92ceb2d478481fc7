"""Bounds of expressions and media over boxes of field values: never too small, and tight."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from expression_trees import expressions
from voluminous.backend import from_host, get_backend
from voluminous.errors import InputError, UnknownNameError
from voluminous.expressions import DrjitOps, Expression, IntervalOps, NumpyOps
from voluminous.expressions.interval import Interval
from voluminous.media import (
    Coefficients,
    Context,
    Gaussian,
    Medium,
    Rectangle,
    Table,
)
from voluminous.media.bound import Binding

EPS = np.finfo(float).eps
INF, NAN = math.inf, math.nan


def enclose(text, **boxes):
    """Evaluate on boxes given as (lo, hi)."""
    fields = {name: Interval(*box) for name, box in boxes.items()}
    return Expression(text).evaluate(IntervalOps(), fields)


def points_in(boxes, rng, count=40):
    """Return arrays (count, block) of points: the corners' diagonal first, then random ones."""
    points = {}
    for name, (lo, hi) in boxes.items():
        f = rng.random((count, len(lo)))
        f[0], f[1] = 0, 1
        f[2:6] = rng.integers(0, 2, f[2:6].shape)
        # Clipped, because lo + (hi - lo) may round to more than hi.
        points[name] = np.clip(lo + f * (hi - lo), lo, hi)
    return points


def assert_inside(values, lo, hi, undefined=False):
    outside = np.where(np.isnan(values), ~np.asarray(undefined), (values < lo) | (values > hi))
    assert not outside.any(), (values[outside][0], np.argwhere(outside)[0], lo, hi)


def reals(least, most):
    # Denormal numbers may be zero to a device.
    return st.floats(least, most, allow_subnormal=False)


@st.composite
def boxes(draw, blocks=5):
    """Strategy: the lower and upper ends of one field in some blocks."""
    numbers = st.one_of(reals(-8, 100), st.integers(-4, 4).map(float))
    widths = st.one_of(reals(0, 10), st.just(0.0), reals(0, 1e-3))
    lo = np.array(draw(st.lists(numbers, min_size=blocks, max_size=blocks)))
    return lo, lo + np.array(draw(st.lists(widths, min_size=blocks, max_size=blocks)))


# --- expressions: nothing lies outside ------------------------------------------------------------


@given(
    text=expressions(),
    box=st.fixed_dictionaries({name: boxes() for name in "xyz"}),
    seed=st.integers(0, 2**32 - 1),
)
@settings(max_examples=150, deadline=None)
def test_random_expressions_stay_inside(text, box, seed):
    expr = Expression(text)
    found = enclose(text, **{name: box[name] for name in expr.names})
    points = points_in(box, np.random.default_rng(seed))
    shape = points["x"].shape
    backend = get_backend("cpu", "double")
    on_device = expr.evaluate(
        DrjitOps(backend.Float, constant=backend.wide),
        {name: from_host(backend.Float, values.ravel()) for name, values in points.items()},
    )
    with_numpy = expr.evaluate(NumpyOps(), points)
    device = on_device.numpy()
    device = device.reshape(shape) if device.size > 1 else np.broadcast_to(device, shape)
    assert_inside(np.broadcast_to(with_numpy, shape), found.lo, found.hi, found.nan)
    # Where a value may not exist, a compiler may find another: 0 for 0 · inf.
    assert_inside(np.where(found.nan, NAN, device), found.lo, found.hi, found.nan)


SPECIAL = [0.0, -0.0, 1.0, -1.0, 2.0, -2.5, 0.5, math.pi, 1e-5, 1e30, -1e-30, 1e300, INF, -INF, NAN]
TWO = ["x + y", "x - y", "x * y", "x / y", "x // y", "x % y", "x**y", "atan2(x, y)", "min(x, y)"]
TWO += ["x < y", "x <= y", "x == y", "x != y", "x and y", "x or not y", "where(x, y, 3)"]
ONE = ["log(x)", "log10(x)", "sqrt(x)", "exp(x)", "sin(x)", "cos(x)", "tan(x)", "tanh(x)", "abs(x)"]
ONE += ["x**2", "x**3", "x**-1", "x**-2", "x**0", "x**0.5", "x**11", "x**-10", "-x"]


@pytest.mark.parametrize("text", ONE + TWO)
def test_special_values_stay_inside(text):
    # Every pair of special values as the ends of x and of y, and every special value in it.
    ends = np.array([(a, b) for a in SPECIAL for b in SPECIAL if not a > b])
    nx, ny = np.indices((len(ends), len(ends))).reshape(2, -1)
    x, y = ends[nx].T, ends[ny].T
    names = Expression(text).names
    found = enclose(text, **{n: box for n, box in (("x", x), ("y", y)) if n in names})
    for a in SPECIAL:
        for b in SPECIAL:
            there = np.ones(len(nx), bool)
            for value, (lo, hi) in ((a, x), (b, y)):
                anything = np.isnan(lo) | np.isnan(hi)
                there &= anything | ((lo <= value) & (value <= hi))
            value = Expression(text).evaluate(NumpyOps(), {"x": np.array(a), "y": np.array(b)})
            value = np.full(there.sum(), float(value))
            assert_inside(value, found.lo[there], found.hi[there], found.nan[there])


# --- expressions: nothing is wider than it must be ------------------------------------------------

MONOTONE = {
    "2*x + 1": lambda x: 2 * x + 1,
    "x*x": np.square,
    "x**5": lambda x: x**5,
    "x**2.5": lambda x: x**2.5,
    "1/x": np.reciprocal,
    "log(x + 1) + exp(x/10)": lambda x: np.log(x + 1) + np.exp(x / 10),
    "sqrt(x)": np.sqrt,
    "tanh(x)": np.tanh,
    "cos(x/20)": lambda x: np.cos(x / 20),
    "tan(x/60)": lambda x: np.tan(x / 60),
    "atan2(x, 2)": lambda x: np.arctan2(x, 2),
    "max(x, 3)": lambda x: np.maximum(x, 3),
    "abs(-x)": np.abs,
}


@pytest.mark.parametrize("text", MONOTONE)
@given(a=st.floats(0.125, 60), b=st.floats(0.125, 60))
@settings(max_examples=30, deadline=None)
def test_monotonic_expressions_are_bounded_by_their_ends(text, a, b):
    lo, hi = sorted(MONOTONE[text](np.array([a, b])))
    found = enclose(text, x=(min(a, b), max(a, b)))
    # 16 ε for a library function, and 2 ε for each of a power's at most 35 doublings.
    np.testing.assert_allclose([found.lo, found.hi], [lo, hi], rtol=100 * EPS, atol=20 * EPS)
    assert not found.nan


EXACT = [  # text, box of x, ends, whether NaN is possible
    ("-x", (1, 2), (-2, -1), False),
    ("x + 1", (1, 2), (2, 3), False),
    ("x**2", (-1, 1), (0, 1), False),
    ("x**3", (-1, 0), (-1, 0), False),
    ("x**-1", (-1, 1), (-INF, INF), False),
    ("1/x", (0, 2), (-INF, INF), False),  # of -0, too
    ("x/x", (-1, 2), (-INF, INF), True),
    ("0*x", (-1, INF), (0, 0), True),
    ("x - x", (-INF, INF), (-INF, INF), True),
    ("abs(x)", (-3, 2), (0, 3), False),
    ("exp(x)", (-INF, 0), (0, 1), False),
    ("log(x)", (0, 1), (-INF, 0), False),
    ("log(x)", (-1, 1), (-INF, 0), True),
    ("sqrt(x)", (0, INF), (0, INF), False),
    ("sqrt(x)", (-1, 0), (0, 0), True),
    ("tanh(x)", (-INF, INF), (-1, 1), False),
    ("sin(x)", (0, 3), None, False),
    ("sin(x)", (-2, 2), (-1, 1), False),
    ("tan(x)", (1, 2), (-INF, INF), False),
    ("x // 2", (-1, 5), (-1, 2), False),
    ("x // 0", (1, 2), (-INF, INF), False),
    ("x % 3", (0.5, 2.5), (0.5, 2.5), False),
    ("x % 3", (0.5, 3.5), (0, 3), False),
    ("x % 0", (1, 2), (-INF, INF), True),
    ("min(x, 2)", (1, 3), (1, 2), False),
    ("where(x > 0, 1, 2)", (1, 3), (1, 1), False),
    ("where(x > 0, 1, 2)", (-1, 1), (1, 2), False),
    ("where(x > 3, log(x), x)", (-1, 1), (-1, 1), False),
    ("x < 2", (0, 1), (1, 1), False),
    ("x < 2", (1, 2), (0, 1), False),
    ("1 < x <= 2", (1, 2), (0, 1), False),
    ("x == 2", (2, 2), (1, 1), False),
    ("x == 2", (1, 4), (0, 1), False),
    ("x > 1 and x > 2.5", (2, 3), (0, 1), False),
    ("x > 1 or x > 2.5", (2, 3), (1, 1), False),
    ("not x", (-1, 2), (0, 1), False),
    ("sqrt(x) >= 0", (-1, 1), (0, 1), False),  # NaN compares as false
    ("clip(sqrt(x), 0, 1) <= 1", (-1, 1), (0, 1), False),
    ("x + 1", (NAN, 2), (-INF, INF), True),
]


@pytest.mark.parametrize(("text", "box", "ends", "undefined"), EXACT)
def test_ends_are_exact_where_they_can_be(text, box, ends, undefined):
    found = enclose(text, x=box)
    if ends is not None:
        assert (found.lo, found.hi) == ends
    assert found.nan == undefined


def test_rounding_goes_outward():
    third = enclose("1/x", x=(3, 3))
    assert third.lo < third.hi
    # 0.1 + 0.2 is not a number of the computer; the ends are its two neighbours.
    total = enclose("x + 0.2", x=(0.1, 0.1))
    assert np.nextafter(total.lo, 1) == total.hi
    assert Fraction(float(total.lo)) < Fraction(0.1) + Fraction(0.2) < Fraction(float(total.hi))


# --- media ----------------------------------------------------------------------------------------


PLAIN = Binding()


def solve(medium, points, binding):
    """Return j and α at points, evaluated by Dr.Jit in double precision."""
    backend = get_backend("cpu", "double")
    ctx = Context(backend.Wide, backend.wide)
    shape = np.broadcast_shapes(*(values.shape for values in points.values()))
    fields = {
        name: from_host(ctx.real, np.broadcast_to(values, shape).ravel())
        for name, values in points.items()
    }
    found = medium.bind(binding).coefficients(fields, ctx)

    def arrays(values):
        return [np.broadcast_to(v.numpy(), math.prod(shape)).reshape(shape) for v in values]

    return arrays(found.emissivity), arrays(found.extinction)


def assert_bounded(medium, box, seed, binding=PLAIN):
    lo, hi = ({name: ends[k] for name, ends in box.items()} for k in (0, 1))
    found = medium.bounds(lo, hi, binding.unit, binding.unit_of)
    j, a = solve(medium, points_in(box, np.random.default_rng(seed)), binding)
    assert len(found.j_lo) == len(found.j_hi) == len(j) == medium.channels
    assert len(found.a_lo) == len(found.a_hi) == len(a)
    for values, low, high in zip(
        j + a, found.j_lo + found.a_lo, found.j_hi + found.a_hi, strict=True
    ):
        assert_inside(values, low, high, low == -INF)


HEIGHTS = st.floats(-3, 3)
OPACITIES = st.floats(0, 3)
POSITIVE = st.floats(0.01, 30)
TEXTS = st.sampled_from(["x", "x*y", "log10(x)", "sqrt(abs(y)) - x", "where(y > 1, x, 3)"])


def per_channel(numbers, channels=2):
    return st.lists(numbers, min_size=channels, max_size=channels)


def extinctions():
    return st.one_of(OPACITIES, per_channel(OPACITIES))


@st.composite
def tables(draw):
    """Strategy: tables, often with jumps and with parts that are constant."""
    n = draw(st.integers(2, 9))
    nodes = sorted(draw(st.lists(st.integers(-4, 20).map(float), min_size=n, max_size=n)))
    colors = draw(st.lists(per_channel(HEIGHTS | st.just(0.0)), min_size=n, max_size=n))
    opacities = draw(st.lists(OPACITIES | st.just(0.0), min_size=n, max_size=n))
    return Table(draw(TEXTS), nodes, colors, opacities, draw(POSITIVE))


SHAPED = st.builds(
    lambda kind, *arguments: kind(*arguments),
    st.sampled_from([Gaussian, Rectangle]),
    TEXTS,
    st.floats(-5, 10),
    POSITIVE,
    per_channel(HEIGHTS),
    extinctions(),
    POSITIVE,
)
SIMPLE = st.one_of(
    SHAPED,
    tables(),
    st.builds(Coefficients, st.tuples(TEXTS, TEXTS), TEXTS),
    st.builds(Coefficients, st.tuples(TEXTS, TEXTS), st.tuples(TEXTS, TEXTS)),
)
MEDIA = st.lists(SIMPLE, min_size=1, max_size=3).map(sum)


@pytest.mark.exhaustive
@given(medium=MEDIA, x=boxes(), y=boxes(), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=150, deadline=None)
def test_random_media_stay_inside(medium, x, y, seed):
    assert_bounded(medium, {"x": x, "y": y}, seed)


@given(table=tables(), box=boxes())
@settings(deadline=None)
def test_a_table_is_bounded_by_its_ends_and_the_entries_between(table, box):
    medium = Table("x", table.values, table.colors, table.opacities, table.path_length)
    found = medium.bounds({"x": box[0]}, {"x": box[1]})
    ends = [solve(medium, {"x": end}, Binding())[0][0] for end in box]
    within = (box[0] < table.values[:, None]) & (table.values[:, None] <= box[1])
    entries = np.where(within, table.colors[:, :1] / table.path_length, NAN)
    # 8 ε of the largest entry around.
    near = 10 * EPS * 3 / table.path_length
    expected = np.fmin.reduce([*ends, *entries]), np.fmax.reduce([*ends, *entries])
    np.testing.assert_allclose((found.j_lo[0], found.j_hi[0]), expected, rtol=0, atol=near)


def test_sums_add_their_bounds():
    grey = Rectangle("x", 0, 1, (1, 2), 3, 1)
    coloured = Rectangle("y", 0, 1, (10, 20), (30, 40), 1)
    found = (grey + coloured).bounds({"x": [0], "y": [0.5]}, {"x": [2], "y": [0.5]})
    assert [float(v[0]) for v in found.j_lo] == [10, 20]
    assert [float(v[0]) for v in found.j_hi] == [11, 22]
    assert [float(v[0]) for v in found.a_lo] == [30, 40]
    assert [float(v[0]) for v in found.a_hi] == [33, 43]


def test_nothing_is_known_of_a_function_that_cannot_be_read():
    function = Medium.from_function(lambda x: ([math.sqrt(x), x], x), ["x"], 2)
    found = (function + Rectangle("x", 0, 1, (1, 2), 3, 1)).bounds({"x": [0, 5]}, {"x": [1, 6]})
    for low, high in zip(found.j_lo, found.j_hi, strict=True):
        np.testing.assert_array_equal(low, -INF)
        np.testing.assert_array_equal(high, INF)
    np.testing.assert_array_equal(found.a_lo[0], [3, 0])
    np.testing.assert_array_equal(found.a_hi[0], INF)


def test_units_are_those_of_the_coefficients():
    from astropy import units as u

    kelvin = {"T": u.K, "n": u.cm**-3}

    def unit_of(expression):
        return kelvin[expression.text] if expression.text in kelvin else u.m**-1

    media = [
        Gaussian("T", 20 * u.K, 3 * u.K, 1, 2, 1 * u.pc),
        Rectangle("n", 1e6 / u.m**3, 1e5 / u.m**3, 1, 2, 3e18 * u.cm),
        Table("T", [0, 30] * u.K, [0, 1], [0, 2], 1 * u.pc),
        Coefficients("T", "n*T"),
    ]
    lo, rng = np.linspace(0, 30, 8), np.random.default_rng(1)
    box = {"T": (lo, lo + rng.random(8) * 9), "n": (lo / 20, lo / 20 + rng.random(8))}
    for medium in media:
        assert_bounded(medium, box, 2, Binding(u.pc, unit_of))


@pytest.mark.parametrize(
    ("lo", "hi", "error", "message"),
    [
        ({"x": [1, 5]}, {"x": [2, 4]}, InputError, "'x' is above the largest one: 5 and 4"),
        ({"x": 1}, {}, InputError, "one is missing for x"),
        ({"y": 1}, {"y": 2}, UnknownNameError, "unknown field 'x'"),
        ({"x": [1, 2]}, {"x": [1, 2, 3]}, InputError, r"shapes \(2,\) and \(3,\)"),
    ],
)
def test_ranges_that_are_none_are_refused(lo, hi, error, message):
    with pytest.raises(error, match=message):
        Gaussian("x", 0, 1, 1, 1, 1).bounds(lo, hi)
