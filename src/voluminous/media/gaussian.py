"""Gaussian shells."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from ..backend.functions import decay
from ..expressions import Ops
from .modulation import Middle
from .sampled import Sampled, finely_sampled_gaussian, sampled_gaussian
from .sampled_shapes import SampledShaped
from .shape_means import gaussian_mean
from .shape_middles import gaussian_middle

if TYPE_CHECKING:
    from ..expressions.traced_interval import TracedInterval

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
    Peters, *The physics of volume rendering* (2014), section 4.
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
        shading: Any = 0.0,
        lights: Any = None,
    ) -> None:
        super().__init__(expr, center, sigma, color, opacity, path_length, where, shading, lights)

    def shape(self, ops: Ops, offset: Any, width: Any) -> Any:
        """Return exp(-(offset/σ)²/2); zero at infinity."""
        scaled = offset / width
        return ops.exp(-0.5 * (scaled * scaled))

    def mean_shape(self, first: Any, last: Any, faint: float) -> Any:
        return gaussian_mean(first, last, faint)

    def sample(self, offset: Any) -> Any:
        """Return exp(-offset²/2)."""
        return decay(0.5 * (offset * offset))

    @property
    def finer(self) -> bool:
        return self.smooth

    def sampled_shape(
        self, nodes: list[Any], ends: list[Any], derivatives: list[Any], *, fine: bool
    ) -> Sampled:
        own = finely_sampled_gaussian if fine else sampled_gaussian
        return own(nodes, derivatives)

    def mean_bounds(
        self, first: Any, last: Any, off: Any, farthest: Any, z: TracedInterval
    ) -> TracedInterval:
        from .mean_bounds import gaussian_bounds

        return gaussian_bounds(gaussian_mean(first, last), off, z)

    def middle(self, first: Any, last: Any, mean: Any) -> Middle:
        return gaussian_middle(first, last, mean)

    def reach(self, faint: float) -> float:
        return math.sqrt(-2.0 * math.log(max(faint, _LEAST)))
