"""Second order is exact for linear coefficients: against quadrature with twenty digits."""

from __future__ import annotations

import functools

import mpmath
import numpy as np
import pytest

import voluminous as vm
from voluminous.backend import from_host, get_backend
from voluminous.schemes.second_order import visibility

KINDS = {"single": np.float32, "double": np.float64}
# On both sides of where one formula gives way to the next.
DEPTHS = [
    *(1e-12, 1e-7, 1e-4, 0.0029, 0.0031, 0.02, 0.1, 0.299, 0.301, 0.399, 0.401),
    *(0.7, 3.0, 10.0, 19.9, 20.1, 39.9, 40.1, 100.0, 1e4),
]
# The front's share of the optical depth: gradients of both signs, and zero at either end.
SHARES = [0.0, 1e-9, 0.1, 0.5, 0.7, 0.999, 1.0]


@functools.cache
def moments(front, back):
    """Return ∫ exp(-τ(x)) dx and ∫ x exp(-τ(x)) dx over 0 < x < 1, τ' from `front` to `back`."""
    with mpmath.workdps(20):
        front, back = mpmath.mpf(front), mpmath.mpf(back)
        depth, slope = (front + back) / 2, back - front
        # Panels end where the optical depth is 1/4, and 1.6 times more each.
        ends, reached = [mpmath.mpf(0)], mpmath.mpf(1) / 4
        while reached < min(depth, 120):
            ends.append(2 * reached / (front + mpmath.sqrt(front**2 + 2 * slope * reached)))
            reached *= mpmath.mpf("1.6")
        if depth <= 120:  # behind it nothing is seen
            ends.append(mpmath.mpf(1))

        def seen(x):
            return mpmath.exp(-(x * front + slope * x * x / 2))

        return tuple(float(mpmath.quad(lambda x, k=k: x**k * seen(x), ends)) for k in (0, 1))


@pytest.mark.parametrize("precision", sorted(KINDS))
def test_what_is_seen_of_both_ends_is_exact(precision):
    kind = KINDS[precision]
    tau, share = (a.ravel() for a in np.meshgrid(DEPTHS, SHARES, indexing="ij"))
    # Numbers that both precisions can tell.
    front, back = (2 * tau * share).astype("f4"), (2 * tau * (1 - share)).astype("f4")
    Float = get_backend("cpu", precision).Float
    given = [from_host(Float, depth) for depth in (front, back)]
    found = visibility(*([depth] for depth in given), [0.5 * (given[0] + given[1])])
    ((w_front, w_back),), (theta,) = found
    exact = np.array([moments(float(f), float(b)) for f, b in zip(front, back, strict=True)])
    # A sum of a few dozen positive terms; exponentials of some tens lose as many last places.
    rounding = {"single": 1e-6, "double": 1e-13}[precision]
    np.testing.assert_allclose(np.asarray(w_back), exact[:, 1], rtol=rounding)
    np.testing.assert_allclose(np.asarray(w_front), exact[:, 0] - exact[:, 1], rtol=rounding)
    transparency = np.exp(-0.5 * (front.astype(float) + back))
    rounding = 4 * np.finfo(kind).eps * np.maximum(tau, 1)
    assert (np.abs(np.asarray(theta) - transparency) <= rounding * transparency + 1e-30).all()


@pytest.mark.parametrize("precision", sorted(KINDS))
def test_several_extinctions_are_solved_as_one(precision):
    # Branches are taken by the deepest: another channel may change the last places only.
    kind, Float = KINDS[precision], get_backend("cpu", precision).Float
    pairs = np.array([(0.001, 0.01), (0.3, 0.1), (3.0, 30.0), (50.0, 1.0)], dtype=kind)
    front, back = ([Float(p) for p in column] for column in pairs.T)
    together, _ = visibility(front, back, [0.5 * (f + b) for f, b in zip(front, back, strict=True)])
    for weights, (f, b) in zip(together, pairs, strict=True):
        alone, _ = visibility([Float(f)], [Float(b)], [Float(0.5 * (f + b))])
        tolerance = 1e-6 if precision == "single" else 1e-13
        np.testing.assert_allclose(np.ravel(weights), np.ravel(alone[0]), rtol=tolerance)


def column(values, thickness=2.0):
    """Return the values of equal cells along z as an array of one column."""
    return np.reshape(values, (1, 1, -1)), np.linspace(0, thickness, len(values) + 1)


def look(j, alpha, precision, **options):
    """Return intensity and transparency of a column seen from the side of its last cell."""
    (j, edges), (alpha, _) = column(j), column(alpha)
    volume = vm.Volume(vm.CartesianGrid([-1, 1], [-1, 1], edges), j=j, a=alpha)
    camera = vm.Orthographic(width=1, resolution=1)
    medium = vm.Coefficients("j", "a")
    image = vm.render(
        volume, medium, camera, scheme="second-order", precision=precision, cutoff=0, **options
    )
    return image.intensity.item(), image.transparency.item()


@pytest.mark.each_value_once
@pytest.mark.parametrize("precision", sorted(KINDS))
@pytest.mark.parametrize("share", [0.0, 0.2, 0.5, 0.9, 1.0])
def test_linear_coefficients_across_two_cells(precision, share):
    # The plain means at the three walls of two equal cells lie on a straight line.
    rounding = {"single": 3e-6, "double": 1e-13}[precision]
    for tau in DEPTHS[::2]:
        front, back = 2 * tau * share, 2 * tau * (1 - share)
        whole, behind = moments(front, back)
        for j_front, j_back in ((1.0, 0.0), (0.0, 1.0), (0.3, 2.0)):
            # Length 2: α is depth / 2. The last cell is at the front.
            found, theta = look([j_back, j_front], [back / 2, front / 2], precision)
            exact = 2 * (j_front * (whole - behind) + j_back * behind)
            # Where the light comes through the whole depth, its rounding is that of exp(-τ).
            tolerance = rounding * max(1, min(tau, 40))
            assert found == pytest.approx(exact, rel=tolerance)
            assert theta == pytest.approx(np.exp(-tau), rel=rounding * max(1, tau), abs=1e-30)
