"""Spheres that shine or hide: discs in the picture, antialiased by the area they cover."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import InputError
from ..units import as_given, plain, unit_of
from .balls import Balls, nearby
from .contract import Layers, SceneObject, View
from .values import check_colors, positions_of


class Spheres(SceneObject):
    """Spheres of given radii.

    A sphere is a layer where a ray meets it first: an intensity `colors`, which hides the fraction
    `opacity` of what is behind, the medium in it included. The edge of its image is antialiased:
    exactly, by the covered part of each pixel.

    Parameters
    ----------
    positions : array_like or Quantity, shape (n, 3)
        Centres, in the volume's unit.
    radii : float, array_like or Quantity, shape (n,)
    colors : str, float, Quantity or array_like
        Intensity: one for all, or a list; each a number, one per channel, or a name for red, green
        and blue. A list of numbers is one per channel; one per sphere has shape (n, 1).
    opacity : float or array_like, shape (n,)
        From 0 (it only shines) to 1 (nothing behind is seen).
    limb_darkening : float
        u in I(μ) = I(1) (1 - u (1 - μ)), μ being the cosine between the ray and the surface's
        normal. With 1 spheres look like balls that are lit from the observer.
    depth, channel, relative
        As for `SceneObject`.

    Raises
    ------
    InputError
        For shapes that do not fit, or radii that are not positive.
    """

    def __init__(
        self,
        positions: Any,
        radii: Any,
        colors: Any = 1.0,
        *,
        opacity: Any = 1.0,
        limb_darkening: float = 0.0,
        depth: str = "true",
        channel: int | None = None,
        relative: bool = False,
    ) -> None:
        super().__init__(depth=depth, channel=channel, relative=relative)
        self.positions, self.radii = as_given(positions, "positions"), as_given(radii, "radii")
        self.colors, self.opacity, self.limb_darkening = colors, opacity, limb_darkening
        self.count = len(positions_of(self.positions, "positions", (None, 3)))
        self._checked(self.radii, "radii", np.inf)
        self.opacities = self._checked(opacity, "opacity", 1.0)
        self.darkening = self._checked(limb_darkening, "limb_darkening", 1.0)
        check_colors(colors, self.count, "colors")

    def _checked(self, value: Any, what: str, most: float) -> np.ndarray:
        """Return a number for each; from 0 to `most`, or, if that is infinite, positive ones."""
        array = np.asarray(plain(value, unit_of(value), what))
        if array.shape not in ((), (self.count,)):
            raise InputError(
                f"{what} must be a number or one for each of {self.count}, got shape {array.shape}"
            )
        if most < np.inf:
            inside, wanted = (array >= 0.0) & (array <= most), f"from 0 to {most:g}"
        else:
            inside, wanted = (array > 0.0) & (array < most), "positive and finite"
        if not np.all(inside):
            raise InputError(f"{what} must be {wanted}, got {value!r}")
        return np.asarray(np.broadcast_to(array, self.count))

    def layers(self, view: View) -> Layers | None:
        if not self.count:
            return None
        radius = np.broadcast_to(view.length(self.radii, "radii"), self.count)
        positions = np.asarray(view.length(self.positions, "positions"))
        order = nearby(*view.place(positions))
        balls = Balls(positions.take(order, axis=0), radius.take(order), view)
        pixels = balls.covered()
        depth, cosine = balls.meet(pixels)
        ball, x, y, covered = pixels
        owner = order.take(ball)
        color = self._surface(view, radius).take(owner, axis=0)
        color *= (1.0 - self.darkening.take(owner) * (1.0 - cosine))[:, None]
        opacity = covered * self.opacities.take(owner)
        layers = Layers(y * view.frame.pixels[0] + x, depth, covered[:, None] * color, opacity)
        met = np.isfinite(depth)
        return layers if met.all() else layers.some(np.flatnonzero(met))

    def _surface(self, view: View, radius: np.ndarray) -> np.ndarray:
        return self.intensities(self.colors, self.count, view, view.intensity_unit)
