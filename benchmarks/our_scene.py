"""voluminous on a benchmark scene, through its public interface."""

from __future__ import annotations

import functools
import operator
import time

import numpy as np
from astropy import units as u

import voluminous as vm
from scenes import PARSEC, PIXELS, Scene


def volume_of(scene: Scene) -> vm.Volume:
    """Return the scene's volume, lengths in cm."""
    edges = scene.edges() * PARSEC * u.cm
    return vm.Volume(vm.CartesianGrid(edges, edges, edges), density=scene.density())


def medium_of(scene: Scene) -> vm.Medium:
    """Return the scene's medium: the sum of its Gaussians."""
    parts = [
        vm.Gaussian(
            "log10(density)",
            center=center,
            sigma=sigma,
            color=color,
            opacity=scene.opacity,
            path_length=scene.path_length * u.cm,
        )
        for center, sigma, color in zip(scene.centers, scene.sigmas, scene.colors, strict=True)
    ]
    return functools.reduce(operator.add, parts)


def camera_of(scene: Scene, pixels: int = PIXELS) -> vm.Orthographic:
    """Return the scene's camera."""
    return vm.Orthographic(
        incl=scene.incl, phi=scene.phi, width=scene.frame * PARSEC * u.cm, resolution=pixels
    )


class OurScene:
    """One scene, ready to draw; `draw` returns seconds."""

    def __init__(self, scene: Scene, scheme: str, precision: str = "single", pixels: int = PIXELS):
        """Build volume, medium and camera; nothing is drawn yet."""
        self.volume, self.medium = volume_of(scene), medium_of(scene)
        self.camera = camera_of(scene, pixels)
        self.options = {"scheme": scheme, "precision": precision, "device": "cpu"}

    def draw(self) -> float:
        """Draw once, down to an array in memory; return the wall time of `render` in seconds."""
        start = time.perf_counter()
        image = vm.render(self.volume, self.medium, self.camera, **self.options)
        # An image that were computed only when looked at would otherwise cost nothing.
        self.intensity = np.asarray(image.intensity)
        return time.perf_counter() - start

    def picture(self) -> np.ndarray:
        """Return the intensity (ny, nx, 3)."""
        return self.intensity

    def describe(self) -> str:
        """Return the version."""
        return f"voluminous {vm.__version__}"
