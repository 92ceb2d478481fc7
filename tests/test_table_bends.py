"""Two samples of a table along a ray: how far they are from its mean."""

from __future__ import annotations

import matplotlib
import numpy as np
import pytest

from voluminous.backend import from_host, get_backend
from voluminous.media.piecewise_linear import PiecewiseLinear
from voluminous.media.sampled import PAIR
from voluminous.media.table_bends import BEND, TableBends

RNG = np.random.default_rng(0)
EVEN = np.linspace(-1.0, 1.0, 256)
VIRIDIS = matplotlib.colormaps["viridis"](np.linspace(0, 1, 256))[:, :3]
UNEVEN = np.cumsum(RNG.uniform(0.05, 1.0, 60))
TABLES = {
    "colormap": (EVEN, VIRIDIS),
    "of 8 bits": (EVEN, np.round(255 * VIRIDIS) / 255),
    "rough": (np.linspace(-4.0, 4.0, 17), RNG.random((17, 2))),
    "uneven": (UNEVEN, RNG.random((60, 1))),
    "uneven, smooth": (UNEVEN, np.sin(UNEVEN / 3.0)[:, None] ** 2),
    "logarithmic": (np.geomspace(1.0, 1e3, 200), VIRIDIS[:200]),
    "one interval": (np.array([-1.0, 1.5]), np.array([[0.0], [1.0]])),
    "large": (np.linspace(0.0, 1.0, 3000), np.sin(np.linspace(0.0, 30.0, 3000))[:, None]),
    "small numbers": (1e-30 * EVEN, VIRIDIS),
}


def cubics(nodes, span, count=500):
    """Return Bézier control points of cubics in and beside a table's range, some of which turn."""
    extent = np.ptp(nodes)
    start = nodes[0] + extent * RNG.uniform(-0.05, 1.05, count)
    rise = span * extent * RNG.normal(size=count)
    bow = 0.3 * np.abs(rise) * RNG.normal(size=(4, count))
    return start + np.linspace(0, 1, 4)[:, None] * rise + bow


def at(points, s):
    b0, b1, b2, b3 = points
    t = 1.0 - s
    return t**3 * b0 + 3.0 * t * t * s * b1 + 3.0 * t * s * s * b2 + s**3 * b3


def slopes(points):
    """Return bounds of three derivatives, from differences of the control points."""
    rises = 3.0 * np.diff(points, axis=0)
    bends = 2.0 * np.diff(rises, axis=0)
    return [np.abs(own).max(axis=0) for own in (rises, bends, np.diff(bends, axis=0))]


def bound(nodes, columns, points, precision="double", bow=0.0):
    Float = get_backend("cpu", precision).Float
    dtype = "f8" if precision == "double" else "f4"
    table = PiecewiseLinear(Float, nodes, columns)
    low, high, *derivatives = (
        from_host(Float, np.ascontiguousarray(v, dtype=dtype))
        for v in (points.min(axis=0), points.max(axis=0), *slopes(points))
    )
    return TableBends(table, nodes, columns).off(low, high, derivatives, bow).numpy()


@pytest.mark.parametrize("span", [0.003, 0.03, 0.3])
@pytest.mark.parametrize("kind", TABLES)
def test_samples_are_within_the_bound(kind, span):
    nodes, columns = TABLES[kind]
    points = cubics(nodes, span)

    def table(x):
        return np.stack([np.interp(x, nodes, own) for own in columns.T], axis=-1)

    s = (np.arange(4000)[:, None] + 0.5) / 4000  # off by 1e-7 of what the columns are
    mean = sum(table(at(points, part)).mean(axis=0) / 40 for part in np.split(s, 40))
    off = np.abs(0.5 * (table(at(points, PAIR[0])) + table(at(points, PAIR[1]))) - mean)
    for precision in ("double", "single"):
        # Single precision: places in the table are rounded to 1e-7 of its range.
        assert np.all(off.max(axis=-1) <= bound(nodes, columns, points, precision) + 2e-6)


def test_even_bends_cancel():
    points = cubics(EVEN, 0.05)
    low, high = points.min(axis=0), points.max(axis=0)
    points = points[:, (low > -0.8) & (high < 0.8) & (high - low > 12 / 127.5)]
    first, last = (np.searchsorted(EVEN, x) for x in (points.min(axis=0), points.max(axis=0)))
    changes = np.abs(np.diff(VIRIDIS, n=2, axis=0)).max(axis=1) / (EVEN[1] - EVEN[0])
    sums = np.concatenate([[0.0, 0.0], np.cumsum(changes)])
    first_slope, second_slope, _ = slopes(points)
    alone = BEND * (sums[last] - sums[first]) * (first_slope + second_slope)
    assert points.shape[1] > 50
    assert np.median(bound(EVEN, VIRIDIS, points) / alone) < 0.7


def test_lines_and_single_intervals_are_exact():
    nodes = np.linspace(0.0, 1.0, 40)
    points = cubics(nodes, 0.05)
    inside = (points.min(axis=0) > 0.1) & (points.max(axis=0) < 0.9)
    assert bound(nodes, nodes[:, None], points)[inside].max() < 1e-14
    points = 0.5 + 0.01 * RNG.uniform(-1.0, 1.0, (4, 50))  # between two nodes
    assert np.all(bound(nodes, RNG.random((40, 3)), points) == 0.0)


def test_what_is_missed_of_x_counts_with_the_steepest_slope():
    nodes, columns = np.array([0.0, 1.0, 2.0, 3.0]), np.array([[0.0], [1.0], [1.0], [4.0]])
    places = np.linspace(0.2, 0.6, 4)[:, None] + np.arange(-1.0, 4.0)  # one in each interval
    plain, more = (bound(nodes, columns, places, bow=bow) for bow in (0.0, 0.125))
    np.testing.assert_allclose(plain, 0.0, atol=0)
    np.testing.assert_allclose(more, [0.0, 0.125, 0.0, 0.375, 0.0], rtol=1e-12)


def test_what_is_infinite_or_no_number_is_not_known():
    Float = get_backend("cpu", "double").Float
    bends = TableBends(PiecewiseLinear(Float, EVEN, VIRIDIS), EVEN, VIRIDIS)
    infinite = [Float(np.inf)] * 3
    assert bends.off(Float(-np.inf), Float(0.0), infinite, 0.0).numpy() == np.inf
    nan = Float(np.nan)
    assert not bends.off(nan, nan, [nan] * 3, 0.0).numpy() <= 1.0
