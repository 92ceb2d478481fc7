"""Gaussian shells, and their means over a panel on which the scalar is linear (pre-integration).

The segment integrals of Engel, Kraus & Ertl (2001, Graphics Hardware, equation 8) in closed form
instead of in a table: they hold for shells much thinner than a panel, and much thicker.
"""

from __future__ import annotations

import functools
import math
from dataclasses import replace
from typing import Any

import numpy as np

from ..backend import dr
from ..backend.functions import branch, decay, horner, polynomial, precision_of
from ..backend.types import Float
from ..expressions import Ops
from .contract import Sampling
from .profiles import SampledShaped
from .sampled import EIGHT, WEIGHTS, WEIGHTS_OF_EIGHT, Sampled
from .stretch import Middle, extremes, middle_of

# Half width of a stretch, in σ, up to which the series is taken, and its terms. What is left out is
# 2e-6 and 1e-18 of the peak; beyond it the difference of areas loses 3e-6 and 4e-15.
_SERIES = {"single": (0.3, 3), "double": (0.25, 8)}
# Of tails the series is good where their logarithm changes by less than twice that.
_CHANGE = 0.7
# A difference of error functions cannot resolve values below this fraction of the peak.
_TAILS = 1e-8
# erf(x) = 1 - (Σ a_k x^k)^-16 to 3e-7 (Abramowitz & Stegun 1964, 7.1.28), in x √2.
_ERF = (0.0705230784, 0.0422820123, 0.0092705272, 0.0001520143, 0.0002765672, 0.0000430638)
# With t = 1/(1 + c z): half the area beyond z over exp(-z²/2) t, in powers of t - ½, fitted to 3e-7
# for z up to 13, and to 4e-16 up to 39, where exp(-z²/2) is below all numbers. First c.
_BEYOND = {
    "single": (
        0.3,
        0.278198916,
        0.412539199,
        0.433896566,
        0.278376371,
        0.0362760572,
        -0.0979481487,
        -0.0420702447,
        0.0471526816,
    ),
    "double": (
        0.25,
        0.2366523829135606,
        0.38094272770499343,
        0.48520477743387014,
        0.4675409629992524,
        0.3027835246113774,
        0.07560180334613241,
        -0.06977836123926959,
        -0.06540568592044091,
        0.01069579247979477,
        0.037073102156410624,
        -0.0006114863050250722,
        -0.022550394042529065,
        0.0009090685944465406,
        0.01517893260377236,
        -0.003137031207924928,
        -0.010398477970885731,
        0.005030898012882874,
        0.0061302197551617345,
        -0.00505127360829725,
        -0.002164024807046733,
        0.002524557738911338,
    ),
}
# Half width, in σ, up to which a rational function is accurate.
_NARROW_PANEL = 0.25
# Ellipses around [0, 1], with half axes of (ρ ± 1/ρ)/4, and parts of a cubic's first three
# derivatives on the stretch that no imaginary part on them is above. For functions no larger than
# one there eight samples are off by 64/15 ρ^-16/(1 - ρ^-2) at most. The second is for tolerances of
# 1e-7 and less, which the first never meets: in double precision alone.
_SMALL, _LARGE = (3.0, (2 / 3, 0.073, 0.05)), (6.0, (1.46, 1.13, 0.6))
_ELLIPSES = {"single": [_SMALL], "double": [_SMALL, _LARGE]}
# With more of it nothing is known: 3 % for a line of seven and a half σ.
_MOST_ASIDE = 5.0
# The error of Lobatto's rule with four nodes is the sixth derivative over this.
_OFF = 1_512_000.0
# The second to sixth derivative of exp(-z²/2) are below these times its square root.
_DERIVATIVES = (1.15, 1.95, 3.75, 8.3, 20.0)
# A Gaussian is smooth where its argument changes by less than this along a stretch, in σ.
_SMOOTH = 3.0
# Where nothing is too faint, the Gaussian ends where double precision does.
_LEAST = float(np.finfo(np.float64).tiny)


class Gaussian(SampledShaped):
    """A Gaussian shell: T = h/path_length · exp(-((x - center)/sigma)²/2).

    Parameters
    ----------
    expr : str
        Expression x of the fields, e.g. ``"log10(density)"``.
    center, sigma : float or Quantity
        Where the shell is, and how wide, in x.
    color : float, sequence, str or ColorBy
        Emission h_j per channel: the intensity of one `path_length` of the peak, thin. A colour's
        name is red, green and blue; a `ColorBy` gives them by another expression.
    opacity : float or sequence
        Extinction h_α, one for all channels (grey) or one per channel: the optical depth of one
        `path_length` of the peak.
    path_length : float, Quantity or "auto", default "auto"
        Length to which `color` and `opacity` refer; plain numbers are in the volume's unit.
        ``"auto"`` is the median thickness of the shell in the volume that is rendered: one crossing
        shows the colour. `Medium.calibrated` gives the number.
    where : str, optional
        Expression of the fields that multiplies emission and extinction: a comparison, or a number,
        limited to 0 … 1. Where it has no value (NaN) it is 0.
    shading : float
        0 (default): none, as radiative transfer has it. Up to 1: that part of the emission goes
        with the cosine between a light and the gradient of x; the rest is ambient. An illustration.
    lights : list, optional
        Of ``"headlight"`` (the default, a light at the camera), directions (x, y, z) towards a
        light, or pairs of one of these and its relative intensity.

    Raises
    ------
    InputError
        For a negative opacity, a width or path length that is not positive, or anything not finite.

    Notes
    -----
    Peters, *The physics of volume rendering* (2014), section 2; the form with h and w, section 5.
    """

    width_name = "sigma"
    # Beyond six σ it is 1e-8; with so many places the trapezoidal rule is exact to rounding.
    profile_places = np.linspace(-6.0, 6.0, 481)

    def __init__(
        self,
        expr: Any,
        center: Any,
        sigma: Any,
        color: Any,
        opacity: Any,
        path_length: Any = "auto",
        *,
        where: Any = None,
        shading: float = 0.0,
        lights: Any = None,
    ) -> None:
        options: dict[str, Any] = {"where": where, "shading": shading, "lights": lights}
        super().__init__(expr, center, sigma, color, opacity, path_length, **options)

    def shape(self, ops: Ops, offset: Float, width: Float) -> Float:
        """Return exp(-(offset/σ)²/2); zero at infinity."""
        scaled = offset / width
        return ops.exp(-0.5 * (scaled * scaled))

    def mean_shape(self, first: Float, last: Float, faint: float) -> Float:
        return gaussian_mean(first, last, faint)

    def sample(self, offset: Float) -> Float:
        """Return exp(-offset²/2)."""
        return decay(0.5 * (offset * offset))

    @property
    def sampling(self) -> Sampling:
        return replace(super().sampling, finer=self.expr.smooth)

    def sampled_shape(
        self, nodes: list[Float], ends: list[Float], derivatives: list[Float], *, fine: bool
    ) -> Sampled:
        own = finely_sampled_gaussian if fine else sampled_gaussian
        return own(nodes, derivatives)

    def middle(self, first: Float, last: Float, mean: Float) -> Middle:
        return gaussian_middle(first, last, mean)

    def reach(self, faint: float) -> float:
        return math.sqrt(-2.0 * math.log(max(faint, _LEAST)))


def gaussian_mean(first: Float, last: Float, faint: float = 0.0) -> Float:
    """Return the mean of exp(-z²/2) for z from `first` to `last`.

    Means below `faint` may have the same absolute error as those near the peak: in single
    precision, thin shells in noise then take 0.85 of the time.
    """
    half = 0.5 * (last - first)
    kind = precision_of(type(half))
    narrow = dr.abs(half) <= _SERIES[kind][0]
    tails = kind == "double" or faint < _TAILS
    if tails:
        narrow &= dr.abs(half * (0.5 * (first + last))) <= _CHANGE
    mean = branch(
        args=(first, last, half),
        cond=narrow,
        true_fn=_series,
        false_fn=_difference_of_tails if tails else _difference,
    )
    return dr.select(dr.isnan(half), 0.0, mean)  # both ends infinite: log10 where nothing is


def _difference(first: Float, last: Float, half: Float) -> Float:
    """Return the difference of error functions at the ends, over the distance."""
    return dr.abs((_area(last) - _area(first)) * (1.0 / half))


def _difference_of_tails(first: Float, last: Float, half: Float) -> Float:
    """Return the same from the areas beyond the ends.

    Only the tail of an opaque shell is visible, where error functions are 1 within rounding.
    """
    apart = (first < 0.0) ^ (last < 0.0)
    one, other = _beyond(first), _beyond(last)
    area = dr.select(apart, math.sqrt(math.pi / 2) - one - other, dr.abs(one - other))
    return area / dr.abs(half)


def _series(first: Float, last: Float, half: Float) -> Float:
    """Integrate e^{-(m + h t)²/2} = e^{-m²/2} Σ He_k(m) (-h t)^k / k! term by term over t.

    The generating function of Hermite's polynomials (Abramowitz & Stegun 1964, 22.9.17).
    """
    _, terms = _SERIES[precision_of(type(half))]
    middle = 0.5 * (first + last)
    square = middle * middle
    total = horner(half * half, [horner(square, row) for row in _hermite_rows(terms)])
    return decay(0.5 * square) * total


@functools.cache
def _hermite_rows(terms: int) -> tuple[tuple[float, ...], ...]:
    """Return He_{2k}(m)/(2k + 1)! as polynomials of m², for k below `terms`."""
    rows = []
    for k in range(terms):
        n = 2 * k
        row = [0.0] * (k + 1)
        for j in range(k + 1):
            down = math.factorial(j) * math.factorial(n - 2 * j) * 2.0**j * (n + 1)
            row[k - j] = (-1.0) ** j / down
        rows.append(tuple(row))
    return tuple(rows)


def _area(z: Float) -> Float:
    """Return half the integral of exp(-z²/2) from 0 to z, by a rational function in single.

    Dr.Jit's error function takes 42 cycles per vector, this one 8.
    """
    scale = math.sqrt(math.pi / 8)
    size = dr.abs(z)
    base = polynomial(size, [1.0, *(a * 0.5 ** (0.5 * k) for k, a in enumerate(_ERF, start=1))])
    power = base * base
    power = power * power
    power = power * power
    value = scale - scale / (power * power)
    return dr.select(z < 0.0, -value, value)


def _beyond(z: Float) -> Float:
    """Return half the integral of exp(-z²/2) from |z| to infinity, with all its digits."""
    bend, *powers = _BEYOND[precision_of(type(z))]
    size = dr.abs(z)
    t = 1.0 / dr.fma(size, bend, 1.0)
    return decay(0.5 * (z * z)) * t * polynomial(t - 0.5, powers)


def gaussian_middle(first: Float, last: Float, mean: Float) -> Middle:
    """Return centre of mass and variance of exp(-z²/2) between two distances from the centre.

    With t from -1 to 1 over the panel, z = m + h t, the mean of z is the difference of exp(-z²/2)
    at both ends over its integral. For narrow panels, where that is 0/0, t = -m h / (h² + 3). The
    variance is 1/3 for narrow panels and 1/h² for wide ones: 1/(h² + 3). `mean` is that of
    exp(-z²/2) over the panel.
    """
    middle, half = 0.5 * (first + last), 0.5 * (last - first)
    variance = 1.0 / (half * half + 3.0)
    mass = 2.0 * half * mean
    drop = decay(0.5 * first * first) - decay(0.5 * last * last)
    wide = (dr.abs(half) > _NARROW_PANEL) & (mean > 0.0) & dr.isfinite(half)
    center = (drop / dr.select(wide, mass, 1.0) - middle) / dr.select(wide, half, 1.0)
    return middle_of(dr.select(wide, center, -middle * half * variance), variance)


def sampled_gaussian(nodes: list[Float], derivatives: list[Float]) -> Sampled:
    """Return the mean of exp(-z²/2) over a stretch, with a bound of its error.

    The bound follows from the sixth derivative by s: with indices for derivatives, T₂ … T₆ of the
    Gaussian by z and z₁ … z₃ of z by s, it is T₆ z₁⁶ + 15 T₅ z₁⁴ z₂ + T₄ (45 z₁² z₂² +
    20 z₁³ z₃) + T₃ (15 z₂³ + 60 z₁ z₂ z₃) + 10 T₂ z₃² (Faà di Bruno's formula).

    From z at Lobatto's `PLACES`, and bounds of |z₁|, |z₂| and |z₃|.
    """
    values = [decay(0.5 * (z * z)) for z in nodes]
    largest = extremes(values)[1]
    z1, z2, z3 = derivatives
    t2, t3, t4, t5, t6 = (t / _OFF for t in _DERIVATIVES)
    square = z1 * z1
    straight = horner(square, [15.0 * t3 * z2 * z2 * z2, 45.0 * t4 * z2 * z2, 15.0 * t5 * z2, t6])
    turning = dr.fma(z1, 20.0 * t4 * square + 60.0 * t3 * z2, 10.0 * t2 * z3)
    off = dr.sqrt(largest) * dr.fma(z3, turning, straight)
    start, *inner, end = values
    mean = dr.fma(WEIGHTS[0], start + end, WEIGHTS[1] * (inner[0] + inner[1]))
    return Sampled(mean, start, end, dr.select(z1 <= _SMOOTH, off, dr.inf))


def finely_sampled_gaussian(nodes: list[Float], derivatives: list[Float]) -> Sampled:
    """Return the same from z at the places `EIGHT`: good for slopes of up to five σ.

    In an ellipse the Gaussian is at most exp(y²/2), with y the imaginary part of z.
    """
    values = [decay(0.5 * (z * z)) for z in nodes]
    mean, lean = values[0] * 0.0, values[0] * 0.0
    for place, weight, value in zip(EIGHT, WEIGHTS_OF_EIGHT, values, strict=True):
        mean = dr.fma(weight, value, mean)
        lean = dr.fma(6.0 * (place - 0.5) * weight, value, lean)
    off = mean + dr.inf
    for rho, parts in _ELLIPSES[precision_of(type(mean))]:
        y = sum(part * d for part, d in zip(parts, derivatives, strict=True))
        least = 64 / 15 * rho**-16 / (1 - rho**-2)
        here = dr.select(y < _MOST_ASIDE, least / decay(0.5 * (y * y)), dr.inf)
        off = dr.select(here < off, here, off)
    return Sampled(mean, mean - lean, mean + lean, off)
