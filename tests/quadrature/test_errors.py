"""A picture keeps to its tolerance, and its errors are honest."""

from __future__ import annotations

import numpy as np
import pytest

import voluminous as vm
from test_turning_cameras import GRIDS, noise

# --- A picture keeps to its tolerance: `image.error` is at most that part of its maximum.

SHELL = vm.Gaussian("a", 0.5, 0.1, (1, 0.5, 0.2), 0.3, 0.1)
NOISY = {
    "shell": SHELL,
    # The brightest of all parts together is brighter than the picture is in any channel.
    "colours": SHELL + vm.Rectangle("a", 0.8, 0.05, (0.2, 0.5, 1.0), 0.5, 0.1),
    "surfaces": vm.Isosurface("a", [0.3, 0.6], "viridis", 0.4),
    "both signs": vm.Coefficients(["a", "-a"], "a"),
}
OPTIONS = [{}, {"background": 5.0}, {"tolerance": 1e-2}, {"tolerance": 1e-4, "precision": "double"}]


@pytest.mark.parametrize("options", OPTIONS, ids=str)
@pytest.mark.parametrize("medium", NOISY)
def test_no_pixel_may_be_off_by_more_than_is_allowed(medium, options):
    camera = vm.Orthographic(60, 30, resolution=30)
    image = vm.render(noise(GRIDS["cartesian"]()), NOISY[medium], camera, **options)
    allowed = options.get("tolerance", 1e-3) * np.abs(image.intensity).max()
    # Errors are told in single precision.
    assert image.error.max() <= allowed * (1 + 1e-6)


def test_nor_where_there_is_only_what_is_dimmed():
    dust = vm.Gaussian("a", 0.5, 0.1, 0.0, 0.3, 0.1)
    image = vm.render(noise(GRIDS["cartesian"]()), dust, background=5.0)
    assert image.error.max() <= 1e-3 * image.intensity.max() * (1 + 1e-6)


@pytest.mark.parametrize("grid", ["octree", "spherical"])
def test_nor_on_other_grids(grid):
    camera = vm.Orthographic(60, 30, resolution=30)
    image = vm.render(noise(GRIDS[grid]()), NOISY["colours"], camera, background=0.5)
    assert image.error.max() <= 1e-3 * image.intensity.max() * (1 + 1e-6)


def test_what_single_precision_cannot_keep_double_does():
    """Rounding alone is 3e-6 of a pixel."""
    volume, camera = noise(GRIDS["cartesian"]()), vm.Orthographic(60, 30, resolution=30)
    image = vm.render(volume, SHELL, camera, tolerance=1e-6)
    assert image.provenance["precision"] == "double"
    assert image.error.max() <= 1e-6 * image.intensity.max()


# --- Opaque shells whose colour varies across them: more is seen of their front.

GRID = vm.CartesianGrid.uniform(4, (-1, 1))
CAMERA = vm.Orthographic(50, 30, width=2.4, resolution=20)
COLOR = vm.ColorBy("s", "inferno", -0.95, 0.28)
MEDIA = {
    "thin surface": vm.Isosurface("a", 0.6, COLOR, 0.8, 0.002),
    "thick surface": vm.Isosurface("a", 0.6, COLOR, 0.8, 0.05),
    "rectangle": vm.Rectangle("a", 0.6, 0.02, COLOR, 5.0, 0.1),
    "gaussian": vm.Gaussian("a", 0.6, 0.02, COLOR, 5.0, 0.1),
}


def volume():
    """Return noise to make shells of, and something smooth to colour them by."""
    x, y, z = np.reshape(GRID.cell_centers(), (3, *GRID.shape))
    noise = np.random.default_rng(3).random(GRID.shape)
    return vm.Volume(GRID, a=noise, s=np.sin(3 * x + 1) * np.cos(2 * y) + z)


@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("kind", MEDIA)
def test_errors_are_honest(kind, precision):
    """Panels and their halves take the colour in the middle of a shell: they agree, and are off."""
    image = vm.render(volume(), MEDIA[kind], CAMERA, precision=precision, bounds=True)
    off = np.maximum(image.lower - image.intensity, image.intensity - image.upper).max(axis=2)
    lit = image.intensity.max(axis=2) > 0
    # Of 35, 5 and 6 in 250 pixels that was not true; one is a surface that is grazed.
    assert np.mean((off > image.error)[lit]) <= 0.01
    # A grazed surface is crossed within a panel or is not.
    assert np.mean((off > 1e-3 * image.intensity.max())[lit]) <= 0.01


def test_what_is_seen_of_a_slab():
    """Along z a rectangle is a slab of depth τ, and its colour grows through it."""
    grid = vm.CartesianGrid([-1, 1], [-1, 1], np.linspace(-1, 1, 9))
    z = grid.centers[2].reshape(1, 1, -1)
    slab = vm.Volume(grid, a=z)
    gray = vm.ColorBy("a", "gray", -1, 1, samples=2)  # linear: from 0 to 1
    half, tau = 0.03, 20.0
    medium = vm.Rectangle("a", 0.06, half, gray, tau / (2 * half), 1.0)
    view = vm.Orthographic(0, 0, width=0.5, resolution=1)
    image = vm.render(slab, medium, view, precision="double", tolerance=1e-4)
    # Towards the observer, who is at +z: the front is at 0.09, seen to a depth of 1/τ.
    s = (np.arange(200_000) + 0.5) / 200_000
    color = 0.5 * (1 + 0.09 - 2 * half * s)
    exact = np.mean(color * np.exp(-tau * s)) * 2 * half
    off = abs(image.intensity[0, 0, 0] - exact)
    assert off < 1.1e-4 * exact
    assert off < image.error.item()
