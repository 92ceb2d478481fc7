"""RADMC-3D's second-order rule, including its branches and its cap, for comparison.

Olson & Kunasz (1987, JQSRT 38, 325) take the source function as linear in OPTICAL DEPTH, with the
optical depth by the trapezoidal rule; RADMC-3D 2.0 adds that the emission never exceeds the
optically thin trapezoid. This is not the exact solution for coefficients linear in distance
(scheme ``second-order``): it differs by 2e-4 (smooth) to 1e-1 (white noise) of the image maximum.

RADMC-3D computes ``τ - (1 - e^-τ)`` by subtraction: for τ just above 1e-6 the last bit of a path
length is 1e-9 of the image maximum. Pictures differ from RADMC-3D's by that amount.
"""

from __future__ import annotations

import math

import numpy as np

from ..backend import dr
from ..backend.functions import attenuation, horner, precision_of
from ..backend.types import Float
from .base import Coefficients, Solution, VertexScheme

# Below the first depth RADMC-3D takes the trapezoid's weights, below the second its emission.
_SERIES_BELOW = 1e-6
_THIN_BELOW = float(np.float32(1e-9))
# Where seven terms of the front weight's series suffice in single precision.
_SERIES_ENDS = 0.35


class OlsonKunasz(VertexScheme):
    """Solve a segment as RADMC-3D's ``secondorder`` does.

    On spherical grids rays run towards the camera, in RADMC-3D's sub-steps: `cutoff` and
    `order` have no effect.
    """

    name = "olson-kunasz"
    linear = False
    radmc3d_steps = True

    def between(self, front: Coefficients, back: Coefficients, length: Float) -> Solution:
        (j_front, a_front), (j_back, a_back) = front, back
        depth = [0.5 * (f + b) * length for f, b in zip(a_front, a_back, strict=True)]
        weights = [_weights(tau) for tau in depth]
        emission = []
        for c, (jf, jb) in enumerate(zip(j_front, j_back, strict=True)):
            k = c if len(depth) > 1 else 0
            emission.append(_emission(jf, jb, a_front[k], a_back[k], length, depth[k], weights[k]))
        return Solution(emission, [theta for theta, _, _ in weights], depth)


def _weights(tau: Float) -> tuple[Float, Float, Float]:
    """Return the transparency and the weights of the back and the front source function."""
    return _stable_weights(tau) if precision_of(type(tau)) == "single" else _radmc_weights(tau)


def _stable_weights(tau: Float) -> tuple[Float, Float, Float]:
    """Return the weights without subtractions of nearly equal numbers.

    In single precision RADMC-3D's arithmetic would lose all digits at τ = 1e-4.
    """
    theta, mean = attenuation(tau)
    series = horner(-tau, [1.0 / math.factorial(k) for k in range(2, 10)])
    front = dr.select(tau < _SERIES_ENDS, tau * series, 1.0 - mean)
    return theta, dr.fma(tau, mean, -front), front


def _radmc_weights(tau: Float) -> tuple[Float, Float, Float]:
    """Return e^-τ and RADMC-3D's weights: differences of nearly equal numbers."""
    thin, half, e = tau <= _SERIES_BELOW, 0.5 * tau, dr.exp(-tau)
    e0 = 1.0 - e
    front = (tau - e0) / dr.select(thin, 1.0, tau)
    return (
        dr.select(thin, 1.0 - tau, e),
        dr.select(thin, half, e0 - front),
        dr.select(thin, half, front),
    )


def _emission(
    j_front: Float,
    j_back: Float,
    a_front: Float,
    a_back: Float,
    s: Float,
    tau: Float,
    weights: tuple[Float, Float, Float],
) -> Float:
    single = precision_of(type(tau)) == "single"
    tiny = float(np.finfo(np.float32).tiny) if single else 1e-99
    _, w_back, w_front = weights
    q = w_back * (j_back / (a_back + tiny)) + w_front * (j_front / (a_front + tiny))
    cap = 0.5 * (j_front + j_back) * s
    return dr.minimum(dr.select(tau > _THIN_BELOW, q, cap), cap)
