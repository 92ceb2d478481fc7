"""Three short films: around an orbital of hydrogen, through three decades, from haze to surfaces.

python examples/films.py [pixels]
"""

from __future__ import annotations

import sys

import numpy as np

import voluminous as vm
from voluminous import movies


def orbital() -> vm.Volume:
    """Return an f orbital of hydrogen, in Bohr radii: eight lobes of both signs."""
    volume = vm.Volume(vm.CartesianGrid.uniform(64, (-30, 30)))
    volume["psi"] = "x * y * z * exp(-r / 4) / 30"
    return volume


def haze() -> vm.Medium:
    """Return a glow around one value of each sign."""
    plus = vm.Gaussian("psi", 0.2, 0.05, "orange", 0.4, path_length=4)
    return plus + vm.Gaussian("psi", -0.2, 0.05, "royalblue", 0.4, path_length=4)


def around(name: str, pixels: int, frames: int = 24) -> None:
    """Turn the orbital; half of a turn looks like the start."""
    camera = vm.Orthographic(65, 0, width=56, resolution=pixels)
    path = vm.orbit(camera, turns=0.5, frames=frames)
    vm.movie(orbital(), haze(), path, name, fps=12, tolerance=None)


def inwards(name: str, pixels: int, frames: int = 24) -> None:
    """Go through three decades of a cloud that has no scale, cut open."""
    walls = np.linspace(-1, 1, 9)
    grid = vm.OctreeGrid.from_function(
        walls, walls, walls, lambda x, y, z, size: np.sqrt(x**2 + y**2 + z**2) < 6 * size, 14
    )
    cloud = vm.Volume(grid)
    cloud["lobes"] = "sin(4*x/r + 2*log(r)) * sin(4*y/r - 2*log(r)) + sin(4*z/r + log(r))"
    cloud["dex"] = "0.4 * lobes - 2 * log10(r)"
    surfaces = vm.Isosurface("dex", np.arange(0, 9, 0.5), "turbo", 1, shading=0.9, where="y < 0")
    camera = vm.Orthographic(70, 200, width=1.5, center=(0, 0, 0), resolution=pixels)
    path = movies.zoom(camera, 1e3, frames)
    vm.movie(cloud, surfaces, path, name, fps=12, tolerance=None)


def clearing(name: str, pixels: int, frames: int = 24) -> None:
    """Let surfaces come out of the haze, while the camera turns."""
    surfaces = vm.Isosurface("psi", [-0.2, 0.2], ["royalblue", "orange"], 0.95, shading=0.8)
    media = movies.fade(haze(), surfaces, frames)
    camera = vm.Orthographic(65, 0, width=56, resolution=pixels)
    path = vm.orbit(camera, turns=0.5, frames=frames)
    vm.movie(orbital(), media, path, name, fps=12, tolerance=None)


if __name__ == "__main__":
    side = int(sys.argv[1]) if len(sys.argv) > 1 else 160
    around("film_orbit.webp", side)
    inwards("film_zoom.webp", side)
    clearing("film_fade.webp", side)
