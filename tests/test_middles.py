"""Where the mass of a shape is in a panel: there, gates and colours are taken."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from voluminous.backend.device import get_backend
from voluminous.media.gaussian import gaussian_mean, gaussian_middle
from voluminous.media.piecewise_linear import PiecewiseLinear, TableMiddles
from voluminous.media.rectangle import box_middle

PRECISIONS = ["single", "double"]


def moments(shape, first, last):
    """Return centre of mass and its variance, as fractions of a panel, by quadrature."""
    f = (np.arange(200000) + 0.5) / 200000
    weight = shape(first + f * (last - first))
    center = np.average(f, weights=weight)
    return center, np.average((f - center) ** 2, weights=weight)


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize(("first", "last"), [(-3, 2), (0.5, 8), (2, -0.3), (-0.2, 0.1), (-0.9, -4)])
def test_the_middle_of_a_box_is_exact(first, last, precision):
    real = get_backend("cpu", precision).Float
    found = box_middle(real(first), real(last))
    center, variance = moments(lambda z: (np.abs(z) <= 1) * 1.0, first, last)
    assert float(np.asarray(found.place).item()) == pytest.approx(center, abs=1e-5)
    spread = variance / (center * (1 - center))
    assert float(np.asarray(found.spread).item()) == pytest.approx(min(spread, 1 / 3), abs=1e-4)


@pytest.mark.parametrize(
    ("first", "last"),
    [(-30, 20), (-0.1, 0.2), (1.0, 1.2), (50, -60), (-3, -8), (2, 5), (-4, 0.5), (1, 2), (7, 6)],
)
def test_the_middle_of_a_gaussian_is_its_centre_of_mass(first, last):
    real = get_backend("cpu", "double").Float
    ends = real(first), real(last)
    found = gaussian_middle(*ends, gaussian_mean(*ends))
    center, _ = moments(lambda z: np.exp(-z * z / 2), first, last)
    assert float(np.asarray(found.place).item()) == pytest.approx(center, abs=1e-3)
    assert 0 <= float(np.asarray(found.spread).item()) <= 1 / 3


@pytest.mark.parametrize("precision", PRECISIONS)
@settings(max_examples=30, deadline=None)
@given(data=st.data())
def test_the_middle_of_a_table_is_its_centre_of_mass(precision, data):
    nodes = np.sort(data.draw(st.lists(st.integers(-64, 64), min_size=2, max_size=8))) / 16
    heights = st.lists(st.floats(0.1, 1), min_size=len(nodes), max_size=len(nodes))
    weight = np.array(data.draw(heights))
    ends = st.integers(-80, 80)
    first, last = data.draw(st.tuples(ends, ends).filter(lambda p: p[0] != p[1]))
    first, last = first / 16, last / 16
    real = get_backend("cpu", precision).Float
    table = PiecewiseLinear(real, nodes, weight[:, None])
    found = TableMiddles(real, nodes, weight).between(table.at(real(first)), table.at(real(last)))
    center, _ = moments(lambda x: np.interp(x, nodes, weight), first, last)
    assert float(np.asarray(found.place).item()) == pytest.approx(center, abs=2e-5)
    assert 0 < float(np.asarray(found.spread).item()) <= 0.33334
