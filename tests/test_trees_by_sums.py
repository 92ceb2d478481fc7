"""Media on trees beside plain sums of NumPy's along the same rays: octrees, patches, and holes."""

from __future__ import annotations

import numpy as np
import pytest

import voluminous as vm
from test_guaranteed_bounds import rays
from test_octree import random_octree
from test_patches import random_patches
from test_tree_fields import between, corner_values

pytestmark = pytest.mark.exhaustive

PIXELS, STEPS = 14, 4000
CAMERAS = {
    "outside": vm.Orthographic(50, 35, width=3.2, resolution=PIXELS),
    "inside": vm.Perspective((0.1, 0.2, -0.1), (1, -0.3, 0.2), fov=80, resolution=PIXELS),
}
# Half of all places are empty: corners of a chequerboard of cubes, some of them finer.
PLACES = np.array([p for p in np.ndindex(3, 3, 3) if sum(p) % 2 == 0], float) / 1.5 - 1.0
WALLS = [np.linspace(-1, 1, n) for n in (3, 2, 4)]
GRIDS = {
    "octree": lambda: random_octree(7, 3, 0.4, WALLS),
    "anisotropic": lambda: random_patches(4, [2, 1, 3], 2, 8, WALLS),
    "holes": lambda: vm.PatchGrid(
        PLACES, PLACES + 2 / 3, [[2 + 2 * (k % 2)] * 3 for k in range(len(PLACES))]
    ),
}


class Sums:
    """A field along all rays, and where there are cells."""

    def __init__(self, name, camera):
        self.grid = GRIDS[name]()
        field = np.random.default_rng(5).random(self.grid.size).astype(np.float32)
        self.volume = vm.Volume(self.grid, f=field)
        origin, direction = rays(camera, self.grid)
        walls = (self.grid.bounds.T - origin[:, None]) / direction[:, None]
        first, last = walls.min(axis=1).max(axis=1), walls.max(axis=1).min(axis=1)
        if isinstance(camera, vm.Perspective):
            first = np.maximum(first, 0.0)
        self.step = np.maximum(last - first, 0.0)[:, None] / STEPS
        s = first[:, None] + self.step * (np.arange(STEPS) + 0.5)
        points = (origin[:, None] + s[..., None] * direction[:, None]).reshape(-1, 3)
        cell = self.grid.locate(points)
        values = corner_values(self.grid, field.astype(float), "double")
        found = between(self.grid, values, np.maximum(cell, 0), points)
        self.field, self.inside = found.reshape(s.shape), (cell >= 0).reshape(s.shape)

    def seen(self, depth):
        """Return what is seen of a medium as bright as it is deep, from depths of steps."""
        depth = np.where(self.inside, depth, 0.0)
        before = np.cumsum(depth, axis=1) - depth
        return (-np.expm1(-depth) * np.exp(-before)).sum(axis=1).reshape(PIXELS, PIXELS)

    def crossed(self, place):
        """Return how much of a surface is crossed in steps, from how far into it they are."""
        both = self.inside[:, 1:] & self.inside[:, :-1]
        crossed = np.where(both, np.abs(np.diff(place, axis=1)), 0.0)
        return np.pad(crossed, [(0, 0), (1, 0)])


def check(image, exact, sums):
    """Compare a picture, its error and its bounds with sums that may be off by a number."""
    intensity = image.intensity[..., 0]
    off = np.abs(intensity - exact)
    # A grazed surface may lie between two steps of the sums.
    missed = np.mean(off > image.error + sums)
    outside = (image.lower[..., 0] > exact + sums) | (image.upper[..., 0] < exact - sums)
    assert missed <= 0.01
    assert np.mean(outside) <= 0.01
    slack = image.error + 1e-6
    assert np.all(image.lower[..., 0] <= intensity + slack)
    assert np.all(image.upper[..., 0] >= intensity - slack)


@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("view", CAMERAS)
@pytest.mark.parametrize("name", GRIDS)
def test_surfaces(name, view, precision):
    """A hole is a vacuum: nothing is crossed in it, whatever is on its other side."""
    camera, level, opacity = CAMERAS[view], 0.5, 0.4
    exact = Sums(name, camera)
    depth = -np.log1p(-opacity)
    for width in (0.0, 0.1):
        medium = vm.Isosurface("f", level, (1,), opacity, width)
        image = vm.render(exact.volume, medium, camera, precision=precision, bounds=True)
        if width == 0.0:
            place = (exact.field > level) * 1.0
        else:
            place = np.clip((exact.field - level) / width + 0.5, 0, 1)
        # Of a thick surface that ends at a hole sums lose what is crossed in half a step.
        sums = 1e-4 if width == 0.0 else 1e-2
        check(image, exact.seen(depth * exact.crossed(place)), sums)


@pytest.mark.parametrize("view", CAMERAS)
@pytest.mark.parametrize("name", GRIDS)
def test_shells(name, view):
    """Beyond a hole fields begin anew."""
    camera = CAMERAS[view]
    exact = Sums(name, camera)
    medium = vm.Gaussian("f", 0.6, 0.05, 5.0, 5.0, 1.0)
    image = vm.render(exact.volume, medium, camera, bounds=True)
    shape = np.exp(-0.5 * ((exact.field - 0.6) / 0.05) ** 2)
    # Where a shell ends at a hole sums are off by half a step of it.
    check(image, exact.seen(5.0 * shape * exact.step), 3e-3 if name == "holes" else 1e-4)


@pytest.mark.parametrize("tolerance", [None, 1e-3])
def test_holes(tolerance):
    """Whether errors are looked at or not."""
    camera = CAMERAS["outside"]
    exact = Sums("holes", camera)
    medium = vm.Isosurface("f", 0.5, (1,), 0.4)
    image = vm.render(exact.volume, medium, camera, tolerance=tolerance)
    crossed = exact.crossed((exact.field > 0.5) * 1.0)
    off = np.abs(image.intensity[..., 0] - exact.seen(-np.log1p(-0.4) * crossed))
    # One straight panel per cell does not see a surface that bends in and out of it.
    assert np.mean(off > 1e-3) <= (0.1 if tolerance is None else 0.01)
