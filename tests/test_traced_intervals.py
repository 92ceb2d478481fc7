"""Intervals inside kernels: nothing lies outside them, and they are as tight as those of the host.

What is true of intervals in general is tested with the host's in `test_bounds`.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from expression_trees import expressions
from test_bounds import MEDIA, MONOTONE, ONE, SPECIAL, TWO, assert_inside, points_in
from voluminous.backend import dr, from_host, get_backend
from voluminous.bounds.enclosure import EnclosureContext
from voluminous.expressions import DrjitOps, Expression, IntervalOps, NumpyOps
from voluminous.expressions.interval import Interval
from voluminous.expressions.traced_interval import TracedInterval, TracedIntervalOps, traced
from voluminous.media import Context, Table
from voluminous.media.bound import Binding, no_unit

INF, NAN = math.inf, math.nan


@pytest.fixture(params=["single", "double"], scope="module")
def backend(request):
    return get_backend("cpu", request.param)


def random_boxes(names, seed, dtype, count=100):
    """Return ends of many boxes: wide and narrow ones, points, and such with whole numbers."""
    rng = np.random.default_rng(seed)

    def ends():
        lo = np.where(
            rng.random(count) < 0.5, rng.uniform(-8, 40, count), rng.integers(-4, 5, count)
        )
        widths = [rng.uniform(0, 10, count), rng.uniform(0, 1e-3, count), rng.integers(0, 4, count)]
        return tuple(end.astype(dtype) for end in (lo, lo + rng.choice(widths)))

    return {name: ends() for name in names}


def intervals(backend, box):
    return {
        name: TracedInterval(*(from_host(backend.Float, end) for end in ends))
        for name, ends in box.items()
    }


def arrays(found, shape):
    """Return, for each interval, both ends and where nothing is defined, as NumPy arrays."""
    dr.eval([(i.lo, i.hi, i.nan) for i in found])  # one kernel for all

    def parts(i):
        lo, hi = (np.asarray(end.numpy(), np.float64) for end in (i.lo, i.hi))
        return tuple(np.broadcast_to(part, shape) for part in (lo, hi, i.nan.numpy()))

    return [parts(i) for i in found]


def enclose(backend, text, box):
    ops = TracedIntervalOps(backend.Float, constant=backend.opaque)
    found = Expression(text).evaluate(ops, intervals(backend, box))
    return arrays([found], len(next(iter(box.values()))[0]))[0]


def points_of(backend, box, seed):
    """Return points in boxes whose ends are numbers of this precision, as such numbers."""
    points = points_in(box, np.random.default_rng(seed), count=20)
    return {name: values.astype(backend.dtype) for name, values in points.items()}


def on_device(backend, points):
    return {name: from_host(backend.Float, values.ravel()) for name, values in points.items()}


# --- expressions ----------------------------------------------------------------------------------


@given(text=expressions(), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=40)
def test_random_expressions_stay_inside(backend, text, seed):
    expr = Expression(text)
    box = random_boxes("xyz", seed, backend.dtype)
    lo, hi, nan = enclose(backend, text, box)
    points = points_of(backend, box, seed)
    # Real numbers: double precision is as good, and of the host.
    wide = {name: values.astype(np.float64) for name, values in points.items()}
    shape = wide["x"].shape
    exact = np.broadcast_to(expr.evaluate(NumpyOps(), wide), shape)
    ops = DrjitOps(backend.Float, constant=backend.opaque)
    device = expr.evaluate(ops, on_device(backend, points)).numpy()
    device = device.reshape(shape) if device.size > 1 else np.broadcast_to(device, shape)
    assert_inside(exact, lo, hi, nan)
    # Where a value may not exist, a compiler may find another: 0 for 0 · inf.
    assert_inside(np.where(nan, NAN, device), lo, hi, nan)


@pytest.mark.parametrize("text", ONE + TWO)
def test_special_values_stay_inside(backend, text):
    # Every pair of special values as the ends of x and of y, and every special value in it.
    with np.errstate(over="ignore"):
        special = np.array(SPECIAL, backend.dtype)
    ends = np.array([(a, b) for a in special for b in special if not a > b])
    nx, ny = np.indices((len(ends), len(ends))).reshape(2, -1)
    x, y = ends[nx].T, ends[ny].T
    lo, hi, nan = enclose(backend, text, {"x": x, "y": y})
    a, b = special.astype(np.float64)[np.indices((len(special),) * 2).reshape(2, -1, 1)]
    values = Expression(text).evaluate(NumpyOps(), {"x": a, "y": b})
    there = contains(x, a) & contains(y, b)
    values = np.where(there, values, lo)
    assert_inside(values, lo, hi, nan)


def contains(ends, value):
    lo, hi = ends
    return np.isnan(lo) | np.isnan(hi) | ((lo <= value) & (value <= hi))


@pytest.mark.parametrize("text", MONOTONE)
def test_monotonic_expressions_are_as_tight_as_on_the_host(backend, text):
    rng, eps = np.random.default_rng(1), np.finfo(backend.dtype).eps
    ends = np.sort(rng.uniform(0.125, 60, (2, 200)).astype(backend.dtype), axis=0)
    lo, hi, nan = enclose(backend, text, {"x": ends})
    host = Expression(text).evaluate(IntervalOps(), {"x": Interval(*ends)})
    # 16 ε for a function, 4 ε for an operation, twice: rounded and moved; and 2 ε for each of up to
    # 35 doublings of a power. In double precision that is 4e-14.
    np.testing.assert_allclose([lo, hi], [host.lo, host.hi], rtol=200 * eps, atol=100 * eps)
    assert not nan.any()


def test_an_interval_of_the_host_keeps_all_its_numbers():
    host = Interval([0.1, -0.1, 1e300, 0.0], [0.1, -0.1, 1e300, INF], [False, False, False, True])
    found = traced(get_backend("cpu", "single").Float, host)
    [(lo, hi, nan)] = arrays([found], 4)
    assert (lo[:3] < host.lo[:3]).all()
    assert (hi[:3] > host.hi[:3]).all()
    assert nan.tolist() == [False, False, False, True]
    assert traced(dr.llvm.Float, found) is found


# --- media ----------------------------------------------------------------------------------------


def ranges(backend, medium, box, unit=None, unit_of=no_unit):
    context = EnclosureContext(backend.Float, backend.opaque)
    bound = medium.bind(Binding(unit, unit_of))
    found = [context.real(v) for v in bound.coefficients(intervals(backend, box), context).listed()]
    listed = arrays(found, len(next(iter(box.values()))[0]))
    return listed[: medium.channels], listed[medium.channels :]


def solve(backend, medium, points, unit=None, unit_of=no_unit):
    context, bound = Context(backend.Float, backend.opaque), medium.bind(Binding(unit, unit_of))
    found = bound.coefficients(on_device(backend, points), context)
    dr.eval(found.emissivity, found.extinction)
    shape = next(iter(points.values())).shape
    return tuple(
        [np.broadcast_to(v.numpy(), math.prod(shape)).reshape(shape) for v in values]
        for values in (found.emissivity, found.extinction)
    )


def assert_bounded(backend, medium, box, seed, **units):
    found = ranges(backend, medium, box, **units)
    values = solve(backend, medium, points_of(backend, box, seed), **units)
    for enclosures, those in zip(found, values, strict=True):
        for (lo, hi, nan), inside in zip(enclosures, those, strict=True):
            assert_inside(inside, lo, hi, nan)


@pytest.mark.exhaustive
@given(medium=MEDIA, seed=st.integers(0, 2**32 - 1))
@settings(max_examples=25)
def test_random_media_stay_inside(backend, medium, seed):
    assert_bounded(backend, medium, random_boxes("xy", seed, backend.dtype), seed)


@given(
    numbers=st.lists(st.floats(-1, 1, width=32), min_size=3, max_size=40),
    seed=st.integers(0, 2**32 - 1),
)
@settings(max_examples=30)
def test_tables_have_the_bounds_of_the_host(backend, numbers, seed):
    rng, n = np.random.default_rng(seed), len(numbers)
    nodes = np.sort(rng.integers(-5, 12, n)).astype(float)  # with jumps, also of several nodes
    table = Table("x", nodes, numbers, np.abs(numbers), 1)
    box = random_boxes("x", seed, backend.dtype)
    host = table.bounds({"x": box["x"][0]}, {"x": box["x"][1]})
    [(j_lo, j_hi, _)], [(a_lo, a_hi, _)] = ranges(backend, table, box)
    # Twice 8 ε of the largest entry, once the host's.
    near = {"rtol": 0, "atol": 20 * np.finfo(backend.dtype).eps}
    np.testing.assert_allclose([j_lo, j_hi], [host.j_lo[0], host.j_hi[0]], **near)
    np.testing.assert_allclose([a_lo, a_hi], [host.a_lo[0], host.a_hi[0]], **near)
