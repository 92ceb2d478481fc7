"""How one segment is solved: emission b that leaves it, and its transparency theta.

Arguments are arrays of any one shape: ``ds`` the length, index 0 the far end and index 1 the end
nearer to the observer; ``j`` emissivity, ``a`` extinction. Each returns ``(b, theta, tau)``.
"""

from __future__ import annotations

import numpy as np

# Gauss-Legendre rules: up to this optical depth, so many points in each of so many panels. The
# integrand is entire, so errors fall faster than geometrically with the number of points; the worst
# case is an extinction that falls to 0 at the far end. Panels halve in size towards the near end:
# rules of many points have weights that are wrong in the 14th digit where they are small.
# Behind an optical depth of DEPTH_SEEN less than exp(-40) = 4e-18 remains to be seen.
DEPTH_SEEN = 40.0
POINTS_AND_PANELS = ((0.1, 8, 1), (1.0, 14, 1), (8.0, 16, 3), (np.inf, 20, 6))

SMALLEST_FLOAT32_1E_9 = float(np.float32(1e-9))  # RADMC-3D writes 1e-9 in single precision


def solve_first_order(j, a, ds):
    """Solve exactly for constant j and a."""
    tau = a * ds
    mean = np.divide(-np.expm1(-tau), tau, out=np.ones_like(tau), where=tau > 0)
    return j * ds * mean, np.exp(-tau), tau


def solve_first_order_radmc(j, a, ds):
    """Solve for constant j and a as RADMC-3D does: with a cruder form for tau <= 1e-4."""
    tau = a * ds
    source = j / (a + 1e-199)
    theta = np.exp(-tau)
    return np.where(tau > 1e-4, 1 - theta, tau) * source, theta, tau


def solve_olson_kunasz(j0, j1, a0, a1, ds):
    """Solve by RADMC-3D's second order: S linear in optical depth, capped (Olson & Kunasz 1987).

    Operation by operation what RADMC-3D does, its loss of digits at small tau included.
    """
    s0, s1 = j0 / (a0 + 1e-99), j1 / (a1 + 1e-99)
    tau = 0.5 * (a0 + a1) * ds
    cap = 0.5 * (j0 + j1) * ds
    thick = tau > 1e-6
    e = _exp_rounded_correctly(-tau)
    e0 = 1 - e
    weight1 = np.where(thick, (tau - e0) / np.where(thick, tau, 1.0), 0.5 * tau)
    weight0 = np.where(thick, e0 - weight1, 0.5 * tau)
    q = np.where(tau > SMALLEST_FLOAT32_1E_9, weight0 * s0 + weight1 * s1, cap)
    return np.minimum(q, cap), np.where(thick, e, 1 - tau), tau


def _exp_rounded_correctly(x):
    """Return exp(x), correctly rounded (nearly always) where x is just below 0.

    NumPy's vectorised exp is wrong in the last bit of every 20th result there. The Fortran
    library's is not; and tau - (1 - e), which is about tau^2 / 2, shows it.
    """
    return np.where(x > -0.1, 1 + np.expm1(x), np.exp(x))


def solve_second_order(j0, j1, a0, a1, ds):
    """Solve exactly for j and a linear in distance, to a relative error of some 1e-15.

    With u the distance from the near end, b is the integral of j(u) exp(-tau(u)) over 0 < u < ds,
    tau(u) = a1 u + (a0 - a1) u^2 / (2 ds): done by Gauss-Legendre over the part that is seen.
    For j, a >= 0 all terms are positive, so nothing cancels at any optical depth.
    """
    j0, j1, a0, a1, ds = np.broadcast_arrays(j0, j1, a0, a1, ds)
    tau = 0.5 * (a0 + a1) * ds
    b = np.zeros(tau.shape)
    below = -1.0
    for depth, points, panels in POINTS_AND_PANELS:
        use = (tau > below) & (tau <= depth)
        if use.any():
            rule = _rule(points, panels)
            b[use] = _quadrature(rule, *(v[use] for v in (j0, j1, a0, a1, ds, tau)))
        below = depth
    return b, np.exp(-tau), tau


def _rule(points, panels):
    """Nodes and weights on (0, 1), in panels that end at 1, 1/2, 1/4 ..."""
    node, weight = np.polynomial.legendre.leggauss(points)
    ends = np.append(0.0, 0.5 ** np.arange(panels)[::-1])
    low, size = ends[:-1, None], np.diff(ends)[:, None]
    return (low + 0.5 * (1 + node) * size).ravel(), (0.5 * weight * size).ravel()


def _quadrature(rule, j0, j1, a0, a1, ds, tau):
    seen = _distance_seen(a0, a1, ds, tau)
    total = np.zeros_like(tau)
    for node, weight in zip(*rule, strict=True):
        x = node * (seen / ds)  # u / ds
        depth = x * (a1 * (1 - 0.5 * x) + a0 * (0.5 * x)) * ds
        total += weight * (j1 * (1 - x) + j0 * x) * np.exp(-depth)
    return total * seen


def _distance_seen(a0, a1, ds, tau):
    """Distance u from the near end with tau(u) = DEPTH_SEEN, at most ds."""
    root = np.sqrt(np.maximum(a1**2 + 2 * (a0 - a1) * DEPTH_SEEN / ds, 0.0))
    deep = tau > DEPTH_SEEN
    return np.where(deep, 2 * DEPTH_SEEN / np.where(deep, a1 + root, 1.0), ds)
