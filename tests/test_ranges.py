"""Ranges on bricks hold all values, and what is derived from them all that a medium shows."""

from __future__ import annotations

import numpy as np
import pytest

import voluminous as vm
from voluminous.expressions.interval import Interval
from voluminous.media.bound import Binding
from voluminous.media.ranges import RangeContext, largest
from voluminous.ranges import BRICK, CELLS, DUAL, BrickRanges, field_ranges, most_in, sums_in

RANDOM = np.random.default_rng(5)


@pytest.mark.parametrize("window", [DUAL, CELLS])
@pytest.mark.parametrize("kind", [np.float32, np.uint8])
def test_a_brick_has_all_cells_that_affect_it(window, kind):
    field = (RANDOM.normal(120, 30, (9, 14, 6))).astype(kind)
    bricks = field_ranges(field, window)
    assert bricks.low.dtype == kind
    for place in np.ndindex(bricks.low.shape):
        first = [max(BRICK * k - window.before, 0) for k in place]
        last = [BRICK * (k + 1) + window.after for k in place]
        # The last dual cell lies behind the centre of the last cell.
        first = [min(a, n - 1) for a, n in zip(first, field.shape, strict=True)]
        cells = field[tuple(map(slice, first, last))]
        assert (bricks.low[place], bricks.high[place]) == (cells.min(), cells.max())
    wide = bricks.coarser(2, 1)
    assert wide.low[0, 0, 0] == bricks.low[:3, :3, :3].min()
    assert wide.high.max() == field.max()


@pytest.mark.parametrize("kind", [np.float32, np.float64, np.uint8, np.int16])
def test_many_bricks_have_the_limits_of_each(kind):
    """Of one field by pieces of its range: never below interval arithmetic, and seldom above."""
    low = RANDOM.gamma(2.0, 20.0, 70_000).astype(kind)
    high = np.maximum(low, RANDOM.gamma(2.0, 30.0, low.size).astype(kind))
    low[:100], high[:100] = 0, 0  # a background
    if low.dtype.kind == "f":
        low[-3:], high[-3:] = np.nan, np.nan
    volume = vm.Volume(vm.CartesianGrid.uniform(2, (0, 1)), a=np.ones((2, 2, 2)))
    medium = vm.Gaussian("a", 40.0, 0.5, (1, 2, 3), 0.5, 1.0)
    medium += vm.Rectangle("log10(a)", 1.0, 0.01, (1, 2, 3), 0.5, 1.0)
    bound = medium.bind(Binding.to(volume))

    def shown(part, fields):
        seen = part.may_show(fields, RangeContext(1e-6))
        return [seen, *largest(part, fields, 1e-6).listed()]

    bricks = BrickRanges(low, high)
    found = sums_in(medium, bound, {"a": bricks}, shown)
    with np.errstate(all="ignore"):
        exact = shown(bound, {"a": bricks.interval()})
    assert np.all(found[0] >= exact[0])
    for value, limit in zip(found, exact, strict=True):
        looser = value.astype(float) > limit + 0.02 * np.nanmax(limit[limit < np.inf])
        assert looser.mean() < 0.01
    a = np.array([0.0, 0.37, 1.0])[:, None]
    inside = low.astype(float) * (1 - a) + high.astype(float) * a
    with np.errstate(all="ignore"):
        there = shown(bound, {"a": Interval(inside)})
    for value, limit in zip(found, there, strict=True):
        assert np.all(value * (1 + 1e-9) >= limit.max(axis=0))


def test_functions_of_several_fields_are_those_of_each_brick():
    shape = (50, 40, 40)
    a, b = RANDOM.normal(size=(2, *shape))
    bricks = {"a": BrickRanges(a, a + 1), "b": BrickRanges(b, b + 1)}
    x = Interval(np.arange(50.0)[:, None, None], np.arange(50.0)[:, None, None] + 1)
    (found,) = most_in(bricks | {"x": x}, lambda f: [(f["a"] * f["b"] + f["x"]).hi])
    exact = (bricks["a"].interval() * bricks["b"].interval() + x).hi
    np.testing.assert_array_equal(found, exact)
