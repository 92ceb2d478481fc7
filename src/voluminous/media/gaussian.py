"""Gaussian shells, and their means over a panel on which the scalar is linear (pre-integration).

The segment integrals of Engel, Kraus & Ertl (2001, Graphics Hardware, equation 8) in closed form
instead of in a table: they hold for shells much thinner than a panel, and much thicker.
"""

from __future__ import annotations

import functools
import math
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from ..backend import dr
from ..backend.functions import branch, decay, horner, polynomial, precision_of
from ..backend.types import Float
from ..expressions import Ops
from ..expressions.traced_interval import TracedInterval
from .panel import Middle, extremes, middle_of
from .profiles import Shaped
from .quadrature import boole, midway, simpson

if TYPE_CHECKING:
    from ..bounds.enclosure import Enclosure, EnclosureContext

# Half width of a panel, in σ, up to which the series is taken, and its terms. What is left out is
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
# Of less light than this, as a part of the shell's, differences of error functions show no centre.
_LEAST_MASS = 1e-5
# Boole's rule is taken where the argument changes by less than this between its places.
_GENTLE = 2.0
# Its error over the third power of the square of that change plus half of what it changes by: at
# most 3 times as much in 98 % of cells of white noise.
_TOLD_BY_BOOLE = 0.04 / 64.0
# And that of the quartic through five places, as a part of their fourth difference.
_TOLD_BY_QUARTIC = 0.008
# Where nothing is too faint, the Gaussian ends where double precision does.
_LEAST = float(np.finfo(np.float64).tiny)


class Gaussian(Shaped):
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

    def halves(self, nodes: list[Float], faint: float) -> list[Float]:
        """Return the means by Boole's rule where the argument changes little, else as usual."""
        steps = [b - a for a, b in pairwise(nodes)]
        widest = extremes([dr.abs(d) for d in steps])[1]
        bent = extremes([dr.abs(b - a) for a, b in pairwise(steps)])[1]

        def smooth(nodes: list[Float], change: Float) -> list[Float]:
            values = [decay(0.5 * (z * z)) for z in midway(nodes)]
            first, last = boole(values[:5]), boole(values[4:])
            nearest = 1.0 + extremes([z * z for z in nodes])[0]
            near = extremes(values[::2])[1] * (nearest * nearest * nearest)
            error = _TOLD_BY_BOOLE * (change * change * change)
            error = error * dr.select(near < 1.0, near, 1.0)
            a, b, c, d, e = nodes
            bend = dr.abs(a + e - 4.0 * (b + d) + 6.0 * c)
            return [first, last, dr.fma(_TOLD_BY_QUARTIC * bend, 0.5 * (first + last), error)]

        def usual(nodes: list[Float], change: Float) -> list[Float]:
            return self.by_centers(nodes, faint)

        found: list[Float] = branch(
            (nodes, dr.fma(widest, widest, 0.5 * bent)), widest < _GENTLE, smooth, usual
        )
        return found

    def centers(self, nodes: list[Float], faint: float) -> list[tuple[Float, Middle]]:
        """Return them from error functions at three places, and Simpson's rule on narrow halves."""
        values = [decay(0.5 * (z * z)) for z in nodes]
        tails = precision_of(type(nodes[0])) == "double" or faint < _TAILS
        areas = [(_beyond if tails else _area)(z) for z in nodes[::2]]
        found = []
        for k in (0, 2):
            first, last, half = nodes[k], nodes[k + 2], 0.5 * (nodes[k + 2] - nodes[k])
            area = dr.abs(areas[k // 2 + 1] - areas[k // 2])
            if tails:
                sides = (first < 0.0) ^ (last < 0.0)
                whole = math.sqrt(math.pi / 2) - areas[k // 2] - areas[k // 2 + 1]
                area = dr.select(sides, whole, area)
            narrow = dr.abs(half) <= _NARROW_PANEL
            mean = area / dr.select(narrow, 1.0, dr.abs(half))
            one, middle, other = values[k : k + 3]
            mean = dr.select(narrow, simpson(one, middle, other), mean)
            least = 0.0 if tails else _LEAST_MASS
            found.append((mean, _middle(first, last, mean, one, other, least)))
        return found

    def middle(self, first: Float, last: Float, mean: Float) -> Middle:
        return gaussian_middle(first, last, mean)

    def change(self, low: Float, high: Float) -> Float:
        nearest = dr.select(low > 0.0, low, dr.select(high < 0.0, high, 0.0))
        farthest = dr.select(high > -low, high, low)
        return decay(0.5 * (nearest * nearest)) - decay(0.5 * (farthest * farthest))

    def mean_bounds(
        self, enclosure: Enclosure, center: float, width: float, context: EnclosureContext
    ) -> TracedInterval:
        """Return the mean on the chord, up to its error times the largest slope.

        The slope z exp(-z²/2) is largest at 1 and falls to both sides.
        """
        first, last, off, _ = enclosure.in_widths(context.plain(center), context.plain(width))
        z = (enclosure.values - context.number(center)) / context.number(width)
        near, far = z.smallest, z.size
        steepest = dr.select(far < 1.0, far, dr.select(near > 1.0, near, 1.0))
        slope = dr.select(steepest < 30.0, steepest * dr.exp(-0.5 * steepest * steepest), 1e-190)
        return enclosure.around(gaussian_mean(first, last), slope * off)

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

    Those of the truncated normal distribution (Johnson, Kotz & Balakrishnan 1994, *Continuous
    univariate distributions*, equation 13.134). On narrow panels, where these are 0/0, with
    z = m + h t: t = -m h / (h² + 3), and the variance 1/3. `mean` is that of exp(-z²/2) over the
    panel.
    """
    ends = [decay(0.5 * (z * z)) for z in (first, last)]
    return _middle(first, last, mean, *ends)


def _middle(
    first: Float, last: Float, mean: Float, one: Float, other: Float, least: float = _LEAST_MASS
) -> Middle:
    """Return the same, given exp(-z²/2) at both ends, and the least light that has a centre."""
    middle, half = 0.5 * (first + last), 0.5 * (last - first)
    mass = 2.0 * half * mean
    wide = (dr.abs(half) > _NARROW_PANEL) & (dr.abs(mass) > least) & dr.isfinite(half)
    per_mass, per_half = (1.0 / dr.select(wide, x, 1.0) for x in (mass, half))
    z = (one - other) * per_mass
    square = 1.0 + (first * one - last * other) * per_mass - z * z
    square = dr.select(square > 0.0, square, 0.0)
    narrow = 1.0 / (half * half + 3.0)
    return middle_of(
        dr.select(wide, (z - middle) * per_half, -middle * half * narrow),
        dr.select(wide, square * per_half * per_half, narrow),
    )
