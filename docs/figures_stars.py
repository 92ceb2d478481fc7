"""Pictures of "Stars and lines"."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from figures_media import row

import voluminous as vm

RED, BLUE = (1.0, 0.55, 0.3), (0.65, 0.8, 1.0)


def cloud(cells: int) -> vm.Volume:
    """A lumpy cloud of dust, parsecs across."""
    volume = vm.Volume(vm.CartesianGrid.uniform(cells, (-1, 1), unit="pc"))
    volume["lumps"] = "sin(9*x + 3*y) * cos(8*z - 4*y) * sin(7*y + 2*x)"
    volume["dust"] = "exp(-(x**2 + y**2 + 2*z**2) / 0.12) * (1 + 0.9 * lumps)"
    return volume


def cluster(count: int) -> vm.Stars:
    """Faint red stars and a few bright blue ones."""
    rng = np.random.default_rng(5)
    light = 10 ** rng.normal(-4.1, 0.45, count)
    colors = np.where(rng.random((count, 1)) < 0.6, RED, BLUE)
    places = rng.normal(0.0, 0.4, (count, 3))
    return vm.Stars(places, colors, luminosities=light, psf=2.2)


def orbit(radius: float, tilt: float) -> np.ndarray:
    """A circle around the centre, tilted about the x axis (degrees)."""
    angle, tilt = np.linspace(0.0, 2.0 * np.pi, 300)[:-1], np.deg2rad(tilt)
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    return np.stack([x, y * np.cos(tilt), y * np.sin(tilt)], axis=1)


def stars(target: Path, pixels: int) -> None:
    """A cluster in a cloud; and lines, balls and axes at their depths."""
    volume = cloud(96)
    # Red light comes through dust more easily.
    dust = vm.Coefficients(
        ["1.1 * dust", "1.1 * dust", "2.0 * dust"], ["3 * dust", "4 * dust", "5 * dust"]
    )
    camera = vm.Orthographic(65, 30, width=2.2, resolution=pixels)
    drawn = [
        vm.Stars([(0, 0, 0)], (1.0, 0.9, 0.6), radii=0.12, limb_darkening=0.7),
        vm.Spheres([(-0.6, 0, 0), (0.4, 0.5, -0.1)], 0.09, ["tomato", "skyblue"], limb_darkening=1),
        vm.Curves([orbit(0.6, 0), orbit(0.64, 10)], (0.35, 0.75, 0.5), width=1.5, closed=True),
        vm.Boxes(),
        vm.Axes(width=3),
    ]
    near = vm.Perspective((2.3, -1.7, 1.3), (0, 0, 0), fov=45, resolution=pixels)
    panels = {
        "without": vm.render(volume, dust, camera),
        "a cluster in it": vm.render(volume, dust, camera, objects=[cluster(600)]),
        "a star, planets, orbits": vm.render(volume, dust, near, objects=drawn),
    }
    row(target, panels, (10, 3.6), exposure=1.4)


def shells(grid: vm.OctreeGrid | vm.PatchGrid | vm.SphericalGrid) -> vm.Volume:
    """Gas that is denser towards the centre."""
    return vm.Volume(grid, gas="exp(-5 * r**1.5)")


def boxes(target: Path, pixels: int) -> None:
    """An octree, patches and a spherical grid, with their boxes."""
    walls = [np.linspace(-1, 1, 9)] * 3

    def near(x: np.ndarray, y: np.ndarray, z: np.ndarray, size: float) -> np.ndarray:
        return np.hypot(np.hypot(x, y), z) < 2.2 * size

    level = np.array([0, 1, 1, 2])
    low = np.array([(0, 0, 0), (4, 6, 4), (10, 4, 6), (12, 14, 12)])
    shape = np.array([(8, 8, 8), (6, 6, 6), (4, 6, 4), (6, 6, 8)])
    grids = {
        "octree": vm.OctreeGrid.from_function(*walls, near, 3),
        "patches": vm.PatchGrid.from_boxes(*walls, level, low, shape),
        "spherical": vm.SphericalGrid(
            np.geomspace(0.15, 1, 24), np.linspace(0.7, np.pi - 0.7, 24), np.linspace(0, 4.7, 48)
        ),
    }
    gas = vm.Coefficients(["1.2 * gas", "0.6 * gas", "0.3 * gas"], 0)
    camera = vm.Orthographic(62, 25, width=3.1, resolution=pixels)
    outlines = vm.Boxes(colors=["#8899bb", "deepskyblue", "gold", "tomato"], width=1.3)
    panels = {
        name: vm.render(shells(grid), gas, camera, objects=[outlines])
        for name, grid in grids.items()
    }
    row(target, panels, (10, 3.6), exposure=1.4)


STAR_FIGURES: dict[str, Callable[[Path, int], None]] = {"stars": stars, "boxes": boxes}
