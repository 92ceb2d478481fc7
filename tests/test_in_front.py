"""What the stretches of a ray may be off by, with others in front of them."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from voluminous.backend import get_backend
from voluminous.schemes.path import Path
from voluminous.schemes.step_doubling import ErrorBudget

Float = get_backend("cpu", "double").Float
SHARE = 0.05
# A pixel may be off by 2 in emission, 1 in transparency.
SOURCE = SimpleNamespace(tolerance=(Float(2 * SHARE), Float(SHARE), Float(SHARE)))


def stretch(wrong, dim=0.0, transparency=1.0):
    error = [Float(wrong), Float(dim), Float(0.0)]
    return Path([Float(0.0)], [Float(transparency)], [Float(0.0)], error)


def most_allowed(budget):
    """Return the largest error of emission that is allowed, by bisection."""
    low, high = 0.0, 1.0
    for _ in range(50):
        middle = 0.5 * (low + high)
        good, _ = budget.accepts(SOURCE, Float(middle), Float(0.0))
        low, high = (middle, high) if good.numpy()[0] else (low, middle)
    return low


def test_every_stretch_may_have_its_share_of_what_is_left():
    budget, total = ErrorBudget(Float(1.0), Float(0.0)), 0.0
    for _ in range(30):
        own = most_allowed(budget)
        assert own == pytest.approx(SHARE * (2.0 - total), rel=1e-12)
        total += own
        budget = budget.behind(SOURCE, stretch(own), False)
    assert total < 2.0
    assert budget.used.numpy()[0] == pytest.approx(total / 2.0, rel=1e-12)


def test_something_is_always_allowed():
    budget = ErrorBudget(Float(1.0), Float(7.0))
    assert most_allowed(budget) == pytest.approx(0.2 * SHARE * 2.0, rel=1e-12)


def test_errors_of_transparency_count_as_well():
    budget = ErrorBudget(Float(1.0), Float(0.0)).behind(SOURCE, stretch(0.2, 0.3), False)
    assert budget.used.numpy()[0] == pytest.approx(0.1 + 0.3, rel=1e-12)


def test_what_is_dimmed_may_be_off_by_more():
    budget = ErrorBudget(Float(1.0), Float(0.0))
    forward = budget.behind(SOURCE, stretch(0.1, transparency=0.25), False)
    assert most_allowed(forward) == pytest.approx(4 * SHARE * (2.0 - 0.1), rel=1e-12)
    # Towards the observer nobody knows yet what will be in front.
    backward = budget.behind(SOURCE, stretch(0.1, transparency=0.25), True)
    assert most_allowed(backward) == pytest.approx(SHARE * (2.0 - 0.1), rel=1e-12)


def test_nothing_allowed_is_no_end_of_the_world():
    source = SimpleNamespace(tolerance=(Float(0.0), Float(SHARE), Float(SHARE)))
    budget = ErrorBudget(Float(1.0), Float(0.0)).behind(source, stretch(0.0), False)
    good, good_dim = budget.accepts(source, Float(0.0), Float(0.0))
    assert np.all(good.numpy() & good_dim.numpy())
