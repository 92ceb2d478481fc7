"""Rays that begin on the axis or in the centre of a curvilinear grid, or go through it.

Azimuth has no value there, and in the centre the polar angle has none. What a ray sees is the limit
along it: on either side of the axis a field of its own, and a jump between.
"""

from __future__ import annotations

import numpy as np
import pytest

import voluminous as vm
from test_curvilinear_fields import sampled
from voluminous.measuring.columns import lines_of_sight

PI = np.pi
LEVELS = (0.3, 0.5, 0.6)
SURFACES = vm.Isosurface("f", list(LEVELS), 1, 0.5)  # each crossing halves what is behind
ROUND = [0, 2, 4, 2 * PI]
EDGES = {
    vm.SphericalGrid: ([0, 0.5, 1], [0, 1.2, PI], ROUND),
    vm.CylindricalGrid: ([0, 0.5, 1], ROUND, [-1, 0, 1]),
}
OBSERVERS = {"centre": (0, 0, 0), "axis": (0, 0, 0.3), "axis, rounded": (1e-17, -2e-17, 0.3)}
THROUGH = {
    "centre and axis": vm.Orthographic(60, 30, width=1.9, resolution=(1, 15), center=(0, 0, 0)),
    "edge-on": vm.Orthographic(90, 17, width=1.9, resolution=(1, 14), center=(0, 0, 0)),
    "from inside": vm.Perspective((0.5, 0.1, 0.2), (0, 0, 0.33), fov=1, resolution=1),
    "from outside": vm.Perspective((3, 1.1, 2), (0, 0, 0.33), fov=1, resolution=1),
}
ACCURACIES = [(1e-2, "single"), (1e-3, "single"), (1e-3, "double"), (1e-7, "double")]
kinds = pytest.mark.parametrize("kind", EDGES)


def around(position):
    """Return a wide view from a place."""
    return vm.Perspective(position, (-1, 0, 0.1), fov=120, resolution=8)


def noise(grid, seed):
    """Return a volume of white noise."""
    return vm.Volume(grid, f=np.random.default_rng(seed).random(grid.shape))


def crossings(volume, camera, first):
    """Return how often rays pass a level from a distance on, by brute force."""
    grid, counts = volume.grid, []
    lines = (a.reshape(-1, 3) for a in lines_of_sight(camera, grid))
    for origin, direction in zip(*lines, strict=True):
        axis = -np.dot(origin[:2], direction[:2]) / np.dot(direction[:2], direction[:2])
        t = np.linspace(first, 5, 20000)
        t = np.sort(np.concatenate([t[np.abs(t - axis) > 1e-6], [axis - 1e-6, axis + 1e-6]]))
        points = origin + t[t >= first, None] * direction
        f = sampled(grid, volume["f"], points[grid.locate(points) >= 0])
        counts.append(sum(np.count_nonzero(np.diff(f > level)) for level in LEVELS))
    return np.array(counts)


def counted(volume, camera, tolerance, precision, medium=SURFACES):
    """Return how many crossings the transparency of a picture tells."""
    image = vm.render(volume, medium, camera, tolerance=tolerance, precision=precision, cutoff=0)
    return -np.log2(image.transparency.reshape(-1))


@pytest.mark.each_value_once
@kinds
@pytest.mark.parametrize("observer", OBSERVERS)
def test_an_observer_on_the_axis_sees_what_lies_on_the_way(kind, observer):
    volume, camera = noise(kind(*EDGES[kind]), 1), around(OBSERVERS[observer])
    expected = crossings(volume, camera, 1e-7)
    assert len(set(expected)) > 2
    for accuracy in [*ACCURACIES, (None, "single")]:
        found = counted(volume, camera, *accuracy)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-3)


@pytest.mark.exhaustive
@kinds
@pytest.mark.parametrize("view", THROUGH)
@pytest.mark.parametrize("seed", [1, 2])
def test_a_jump_across_the_axis_is_one_crossing_of_each_level_between(kind, view, seed):
    volume = noise(kind(*EDGES[kind]), seed)
    first = 0.0 if view.startswith("from") else -5.0
    expected = crossings(volume, THROUGH[view], first)
    for accuracy in [*ACCURACIES, (None, "single")]:
        found = counted(volume, THROUGH[view], *accuracy)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-3)
    image = vm.render(volume, SURFACES, THROUGH[view], bounds=True)
    truth = 1 - 0.5 ** expected.reshape(image.lower.shape)
    assert np.all((image.lower <= truth + 1e-9) & (image.upper >= truth - 1e-9))


@kinds
@pytest.mark.parametrize("position", [(0, 0, 0), (0, 0, 0.3)])
def test_in_a_refined_grid_rays_see_azimuths_of_one_half_plane(kind, position):
    """Or of two, if they go through the axis: a surface with y = 0 is crossed there, and once."""
    quarters = [np.linspace(0, 2 * PI, 5) if e is ROUND else e for e in EDGES[kind]]
    volume = vm.Volume(kind(*quarters, refined=[1, *8 * [0]] * 16))
    volume["f"] = "sin(phi)"
    surface = vm.Isosurface("f", 0, 1, 0.5)
    across = vm.Orthographic(60, 30, width=1.4, resolution=(1, 9), center=(0, 0, 0))
    for accuracy in ACCURACIES:
        begun = counted(volume, around(position), *accuracy, surface)
        np.testing.assert_array_equal(begun, 0)
        through = counted(volume, across, *accuracy, surface)
        np.testing.assert_allclose(through, 1, rtol=0, atol=1e-3)
