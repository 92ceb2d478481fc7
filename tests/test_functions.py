"""Functions of optical depth and of bits: every digit, in both precisions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from voluminous.backend import dr, from_host, get_backend
from voluminous.backend.functions import (
    attenuation,
    first_true,
    flush_subnormal,
    power_of_two,
    sharp_angle,
)

KINDS = {"single": np.float32, "double": np.float64}


@pytest.fixture(params=sorted(KINDS))
def precision(request):
    return request.param


def real(precision):
    """Return the Dr.Jit float type."""
    return get_backend("cpu", precision).Float


def attenuated(tau):
    """Return exp(-tau) and the mean transparency, in the precision of a NumPy array."""
    kind = "single" if tau.dtype == np.float32 else "double"
    found = attenuation(from_host(real(kind), tau))
    dr.eval(found)
    return tuple(np.asarray(part) for part in found)


def exact(tau):
    """Return the same in double precision."""
    tau = tau.astype(np.float64)
    safe = np.where(tau == 0, 1.0, tau)
    return np.exp(-tau), np.where(tau == 0, 1.0, -np.expm1(-safe) / safe)


def error(found, expected, kind):
    """Return the largest relative error in units of the last place."""
    return (np.abs(found - expected) / expected).max() / np.finfo(kind).eps


@pytest.mark.parametrize("negative", [False, True])
def test_attenuation_keeps_its_digits_at_every_depth(precision, negative):
    kind = KINDS[precision]
    tau = np.concatenate([[0.0], np.geomspace(1e-30, 70, 4000), np.linspace(0.3, 0.4, 1000)])
    tau = (-tau if negative else tau).astype(kind)
    theta, mean = attenuated(tau)
    expected_theta, expected_mean = exact(tau)
    # The reduction by ln 2 loses half a place per factor of two; the rest is a polynomial.
    assert error(theta, expected_theta, kind) < 4
    assert error(mean, expected_mean, kind) < 4
    assert theta[0] == mean[0] == 1


def test_attenuation_never_overflows(precision):
    largest = np.finfo(KINDS[precision]).max
    tau = np.array([1e2, 1e3, 1e10, 1e30, largest], dtype=KINDS[precision])
    theta, mean = attenuated(tau)
    # exp(-80) is nothing beside one in single precision, exp(-700) in double.
    assert (theta >= 0).all()
    assert (theta < 1e-34).all()
    # (1 - exp(-τ))/τ of the largest number is subnormal, and flushed on some threads.
    np.testing.assert_allclose(mean[:-1], 1 / tau[:-1].astype(float), rtol=1e-6)
    assert 0 <= mean[-1] < 1e-37


def test_attenuation_at_infinity_and_nan(precision):
    tau = np.array([np.inf, np.nan], dtype=KINDS[precision])
    theta, mean = attenuated(tau)
    assert 0 <= theta[0] < 1e-34
    assert mean[0] == 0
    assert np.isnan(mean[1])


@given(st.lists(st.integers(0, 20), min_size=1, max_size=40), st.integers(-1, 21))
def test_first_true_is_a_sorted_search(values, limit):
    values, UInt = np.sort(values).astype(np.uint32), get_backend("cpu").UInt
    data, limits = from_host(UInt, values), from_host(UInt, [max(limit, 0), 10])
    found = first_true(len(values), UInt, lambda k: dr.gather(UInt, data, k) > limits)
    expected = np.searchsorted(values, np.asarray(limits), side="right")
    np.testing.assert_array_equal(np.asarray(found), expected)


def test_powers_of_two_are_exact(precision):
    info = np.finfo(KINDS[precision])
    exponents = np.arange(info.minexp, info.maxexp)
    found = power_of_two(from_host(real(precision), exponents))
    np.testing.assert_array_equal(np.asarray(found), 2.0**exponents)


def test_subnormal_numbers_are_flushed_and_nothing_else(precision):
    info = np.finfo(KINDS[precision])
    small = np.array([info.smallest_subnormal, info.tiny, 1e3 * info.tiny], dtype=info.dtype)
    kept = np.array([0.0, 1e20 * info.tiny, 1.0, info.max, np.inf], dtype=info.dtype)
    for sign in (1, -1):
        flushed = flush_subnormal(from_host(real(precision), sign * small))
        np.testing.assert_array_equal(np.asarray(flushed), 0)
        same = flush_subnormal(from_host(real(precision), sign * kept))
        np.testing.assert_array_equal(np.asarray(same), sign * kept)
    assert np.isnan(np.asarray(flush_subnormal(real(precision)([np.nan])))).all()


def test_angles_of_vectors_of_known_length(precision):
    kind, eps = KINDS[precision], np.finfo(KINDS[precision]).eps
    angle = np.concatenate([np.linspace(-0.785, 0.785, 4001), np.geomspace(1e-30, 0.7, 500)])
    length = np.geomspace(1e-10, 1e10, len(angle))
    x, y = ((length * f(angle)).astype(kind) for f in (np.cos, np.sin))
    given = [from_host(real(precision), v) for v in (y, x, np.hypot(x, y).astype(kind))]
    found = np.asarray(sharp_angle(*given))
    expected = np.arctan2(y.astype(float), x.astype(float))
    # A quotient, a polynomial and a product, each rounded; the sum below the line has two.
    np.testing.assert_allclose(found, expected, rtol=4 * eps, atol=0)


def test_angles_of_vectors_that_are_wide_or_of_no_length(precision):
    y, x = np.array([1.0, -1.0, 0.0, 1e-5]), np.array([0.0, -1.0, 0.0, -1.0])
    found = sharp_angle(*[from_host(real(precision), v) for v in (y, x, np.hypot(x, y))])
    assert np.all(np.abs(np.asarray(found)[[0, 1]]) > np.pi / 4)
    assert np.asarray(found)[2] == 0
    assert np.isfinite(np.asarray(found)[3])
