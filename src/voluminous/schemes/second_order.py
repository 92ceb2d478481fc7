"""Second order: j and α linear along the segment, integrated exactly at any optical depth.

With x running from the front (0) to the back (1) of a segment of length s,

    τ(x) = s (α_f x + (α_b - α_f) x²/2),    θ = e^{-τ(1)},
    b = s ∫ (j_f (1 - x) + j_b x) e^{-τ(x)} dx = s (j_f W_f + j_b W_b).

The two weights have closed forms in error functions and Dawson's integral, which lose all digits as
α_f → α_b or τ → 0. The integrand is entire, though: where τ is small they are a short double power
series in both extinctions, elsewhere Gauss-Legendre quadrature is exact to rounding with few nodes.
Most segments of most pictures take the first of the three branches, which needs no exponential; the
last integrates over the part of the segment that is visible from its front.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable

import numpy as np

from ..backend import dr
from ..backend.functions import branch, horner, loop, precision_of
from ..backend.types import Float, Int, Mask
from .base import JAlpha, Solution, VertexScheme

# (order of the series, optical depth up to which it suffices): the truncation error of θ is
# τ^(n+1)/(n+1)!, 5e-9 and 1e-18.
_FAINT = {"single": (2, 0.003), "double": (5, 0.003)}
# (nodes, optical depth up to which they suffice), measured over all slopes of the extinction: 8e-8
# and 2e-15 relative (and 7e-7 at 0.5 with 4 nodes, 3e-12 at 0.7 with 7).
_THIN = {"single": (4, 0.3), "double": (8, 0.4)}
# (nodes, optical depth beyond which nothing is visible): 2e-8 and 5e-13 relative.
_THICK = {"single": (18, 20.0), "double": (32, 40.0)}


class SecondOrder(VertexScheme):
    """Solve a segment whose emissivity and extinction are linear in distance."""

    name = "second-order"
    order = 2

    def between(self, front: JAlpha, back: JAlpha, length: Float, scale: Float) -> Solution:
        (j_front, alpha_front), (j_back, alpha_back) = front, back
        a_front, a_back = ([a * length for a in alpha] for alpha in (alpha_front, alpha_back))
        depth = [0.5 * (f + b) for f, b in zip(a_front, a_back, strict=True)]
        weights, transparency = visibility(a_front, a_back, depth)
        emission = []
        for c, (jf, jb) in enumerate(zip(j_front, j_back, strict=True)):
            w_front, w_back = weights[c if len(weights) > 1 else 0]
            emission.append(length * dr.fma(jf, w_front, jb * w_back))
        return Solution(emission, transparency, depth)


def visibility(
    a_front: list[Float], a_back: list[Float], depth: list[Float]
) -> tuple[list[tuple[Float, Float]], list[Float]]:
    """Return the weights (W_f, W_b) of the ends' emissivities, and θ, for each extinction."""
    precision = precision_of(type(depth[0]))
    deepest = functools.reduce(lambda a, b: dr.select(a > b, a, b), depth)
    flat: list[Float] = branch(
        args=(a_front, a_back, depth, deepest),
        cond=deepest <= _FAINT[precision][1],
        true_fn=_faint,
        false_fn=_not_faint,
    )
    n = len(depth)
    return [(flat[3 * k], flat[3 * k + 1]) for k in range(n)], [flat[3 * k + 2] for k in range(n)]


def _faint(
    a_front: list[Float], a_back: list[Float], depth: list[Float], deepest: Float
) -> list[Float]:
    order, _ = _FAINT[precision_of(type(deepest))]
    exponential = [(-1.0) ** k / math.factorial(k) for k in range(order + 1)]
    flat = []
    for af, ab, tau in zip(a_front, a_back, depth, strict=True):
        for moments in _series(order):
            inner = [horner(ab, row) for row in moments]
            flat.append(horner(af, inner))
        flat.append(horner(tau, exponential))
    return flat


@functools.cache
def _series(order: int) -> tuple[list[list[float]], list[list[float]]]:
    """Return the coefficients of a_front^i a_back^m in W_f and W_b, as rows i of entries m.

    With τ(x) = a_front (x - x²/2) + a_back x²/2, the term of order i + m = n of the exponential is
    ``(-1)^n / (i! m!) ∫ w(x) (x - x²/2)^i (x²/2)^m dx``, with w = 1 - x or x.
    """
    nodes, weights = (np.array(v) for v in gauss_legendre(order + 2))  # exact: degree 2n + 1

    def coefficient(w: np.ndarray, i: int, m: int) -> float:
        moment = np.sum(weights * w * (nodes - nodes**2 / 2) ** i * (nodes**2 / 2) ** m)
        return float((-1.0) ** (i + m) * moment / (math.factorial(i) * math.factorial(m)))

    def rows(w: np.ndarray) -> list[list[float]]:
        return [[coefficient(w, i, m) for m in range(order + 1 - i)] for i in range(order + 1)]

    return rows(1.0 - nodes), rows(nodes)


def _not_faint(
    a_front: list[Float], a_back: list[Float], depth: list[Float], deepest: Float
) -> list[Float]:
    precision = precision_of(type(deepest))
    nodes, limit = _THIN[precision]
    return branch(
        args=(a_front, a_back, depth),
        cond=deepest <= limit,
        true_fn=functools.partial(_weights, count=nodes, exp=dr.exp),
        false_fn=_thick,
    )


def _weights(
    a_front: list[Float],
    a_back: list[Float],
    depth: list[Float],
    *,
    count: int,
    exp: Callable[[Float], Float],
) -> list[Float]:
    nodes, weights = gauss_legendre(count)
    flat = []
    for af, ab, tau in zip(a_front, a_back, depth, strict=True):
        half = 0.5 * (ab - af)
        front = back = type(af)(0)
        for x, w in zip(nodes, weights, strict=True):
            seen = exp(-x * dr.fma(half, x, af))
            front, back = dr.fma(w * (1.0 - x), seen, front), dr.fma(w * x, seen, back)
        flat += [front, back, exp(-tau)]
    return flat


def _thick(a_front: list[Float], a_back: list[Float], depth: list[Float]) -> list[Float]:
    real = type(a_front[0])
    count, deepest = _THICK[precision_of(real)]
    reach = [_visible_fraction(f, b, deepest) for f, b in zip(a_front, a_back, strict=True)]

    def add(node: Float, weight: Float, sums: list[Float]) -> list[Float]:
        added = []
        for i, (af, ab) in enumerate(zip(a_front, a_back, strict=True)):
            x = node * reach[i]
            seen = weight * reach[i] * dr.exp(-x * dr.fma(0.5 * (ab - af), x, af))
            added += [dr.fma(1.0 - x, seen, sums[2 * i]), dr.fma(x, seen, sums[2 * i + 1])]
        return added

    sums = [real(0) for _ in range(2 * len(a_front))]
    if dr.is_diff_v(real):  # Dr.Jit 1.5 loses the forward derivative of a loop in a branch
        for node, weight in zip(*gauss_legendre(count), strict=True):
            sums = add(node, weight, sums)
    else:
        nodes, weights = (real(values) for values in gauss_legendre(count))
        index: Float = dr.uint32_array_t(real)

        def body(k: Int, sums: list[Float]) -> tuple[Int, list[Float]]:
            return k + 1, add(dr.gather(real, nodes, k), dr.gather(real, weights, k), sums)

        def more(k: Int, sums: list[Float]) -> Mask:
            return k < count

        _, sums = loop((index(0), sums), more, body)
    return [v for k, tau in enumerate(depth) for v in (*sums[2 * k : 2 * k + 2], dr.exp(-tau))]


def _visible_fraction(a_front: Float, a_back: Float, deepest: float) -> Float:
    """Return the x in [0, 1] up to which τ(x) stays below `deepest` (root without cancellation)."""
    discriminant = dr.fma(a_front, a_front, 2.0 * deepest * (a_back - a_front))
    root = a_front + dr.sqrt(dr.maximum(discriminant, 0.0))
    tiny = 1e-30
    return dr.select(
        discriminant < 0.0, 1.0, dr.minimum(1.0, 2.0 * deepest / dr.maximum(root, tiny))
    )


@functools.cache
def gauss_legendre(count: int) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return nodes and weights of Gauss-Legendre quadrature on [0, 1]."""
    x, w = np.polynomial.legendre.leggauss(count)
    # Python floats: a NumPy scalar on the left of an operator would take a traced array apart.
    return tuple((0.5 * (x + 1.0)).tolist()), tuple((0.5 * w).tolist())
