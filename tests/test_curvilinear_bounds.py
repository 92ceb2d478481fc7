"""Guaranteed bounds on curvilinear grids: the truth, by brute force, is inside them.

And pictures are as near to it as they promise, where rays come near the axis and the centre too:
there own coordinates bend sharply.
"""

from __future__ import annotations

import functools
import itertools
import math

import numpy as np
import pytest

import voluminous as vm
from test_guaranteed_bounds import rays

CIRCLE = np.linspace(0, 2 * np.pi, 6)
RADII = [0.5, 1, 2, 3]
POLAR = np.linspace(0, np.pi, 5)
GRIDS = {
    "sphere": vm.SphericalGrid(RADII, POLAR, CIRCLE + 0.3),
    "mirrored": vm.SphericalGrid(RADII, np.linspace(0.5, np.pi / 2, 4), CIRCLE, mirror=True),
    "axisymmetric, to the centre": vm.SphericalGrid([0, 1, 2, 3], POLAR),
    "cylinder": vm.CylindricalGrid([0, 1, 2, 3], CIRCLE, [-1, 0.2, 2]),
}
# The middle pixels' rays pass through the centre and the axis.
VIEWS = {
    "outside": vm.Orthographic(60, 33, width=6.4, resolution=5, center=(0, 0, 0)),
    "inside": vm.Perspective((1.2, 0.3, 0.4), (0, 0, 0), fov=50, resolution=4),
}
POINTS = 20000
# Wider than the default: a test takes a third of the time.
TOLERANCE = 5e-3


@functools.cache
def volume(name):
    grid = GRIDS[name]
    return vm.Volume(grid, a=np.random.default_rng(7).random(grid.shape))


def weights(edges, value, periodic):
    """Return the cells below and above, and how near the upper one is."""
    centers = 0.5 * (edges[1:] + edges[:-1])
    if len(centers) == 1:
        return np.zeros(value.shape, int), np.zeros(value.shape, int), np.zeros(value.shape)
    if periodic:
        value = centers[0] + np.mod(value - centers[0], edges[-1] - edges[0])
        centers = np.append(centers, centers[0] + edges[-1] - edges[0])
    value = np.clip(value, centers[0], centers[-1])
    low = np.clip(np.searchsorted(centers, value) - 1, 0, len(centers) - 2)
    part = (value - centers[low]) / (centers[low + 1] - centers[low])
    return low, (low + 1) % (len(edges) - 1), part


def field(volume, native):
    """Return a field at places given by own coordinates: linear in each between centres."""
    grid = volume.grid
    around = [
        weights(e, q, name == "phi" and grid.is_periodic)
        for e, q, name in zip(grid.edges, native, grid.coordinates, strict=True)
    ]
    total = np.zeros(native[0].shape)
    for side in itertools.product((0, 1), repeat=3):
        weight = math.prod(w[2] if s else 1 - w[2] for s, w in zip(side, around, strict=True))
        total += weight * volume["a"][tuple(w[s] for s, w in zip(side, around, strict=True))]
    return total


def shell(a, native):
    profile = np.exp(-0.5 * ((a - 0.5) / 0.1) ** 2)
    return profile, 0.7 * profile


def own_coordinates(a, native):
    return a * (2 + np.sin(native[1]) + np.cos(native[2])), 0.1 * native[0]


def medium_on(name, formula):
    """Return a medium, with the names of the grid's coordinates."""
    if formula is shell:
        return vm.Gaussian("a", 0.5, 0.1, [1.0], 0.7, 1.0)
    first, second, third = GRIDS[name].coordinates
    return vm.Coefficients(f"a * (2 + sin({second}) + cos({third}))", f"0.1 * {first}")


def truth_of(name, view, formula):
    """Return intensities by a midpoint rule along rays, from before the domain to behind it."""
    own, (origin, direction) = volume(name), rays(VIEWS[view], volume(name).grid)
    first, length = (0.0, 6.0) if view == "inside" else (-5.0, 10.0)
    if view == "outside":
        first -= np.sum(origin * direction, axis=1, keepdims=True)
    t = first + length * (np.arange(POINTS) + 0.5) / POINTS + np.zeros((len(origin), 1))
    points = (origin[:, None] + t[..., None] * direction[:, None]).reshape(-1, 3)
    native, inside = own.grid.native(points), own.grid.locate(points) >= 0
    j, alpha = (np.where(inside, c, 0.0) for c in formula(field(own, native), native))
    j, depth = j.reshape(t.shape), alpha.reshape(t.shape) * (length / POINTS)
    before = np.cumsum(depth, axis=1) - 0.5 * depth
    return np.sum(j * np.exp(-before), axis=1) * (length / POINTS)


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    ("name", "view", "formula"),
    [
        ("sphere", "outside", shell),
        ("sphere", "inside", own_coordinates),
        ("mirrored", "outside", own_coordinates),
        ("axisymmetric, to the centre", "outside", own_coordinates),
        ("cylinder", "outside", shell),
    ],
)
def test_the_truth_is_inside_and_the_picture_is_near(name, view, formula):
    truth = truth_of(name, view, formula)
    image = vm.render(
        volume(name), medium_on(name, formula), VIEWS[view], bounds=True, tolerance=TOLERANCE
    )
    brightest = image.intensity.max()
    # The twin finds the ends of the domain to one of its steps.
    slack = 2e-3 * brightest
    truth = truth.reshape(image.shape)
    assert np.all(image.lower <= truth + slack)
    assert np.all(image.upper >= truth - slack)
    assert np.max(image.upper - image.lower) <= 1.001 * TOLERANCE * brightest
    assert np.all(image.lower <= image.intensity + 0.2 * TOLERANCE * brightest)
    assert np.all(image.upper >= image.intensity - 0.2 * TOLERANCE * brightest)


def test_a_refined_grid_is_bounded_too():
    """The bracket of what is linear between the corners of leaves holds the picture of that."""
    flags = [1, *8 * [0], 0, 0, 1, *8 * [0], 0, 0, 0, 0]
    grid = vm.SphericalGrid([0.5, 1, 3], np.linspace(0, np.pi, 3), CIRCLE[[0, 2, 4]], refined=flags)
    leaves = vm.Volume(grid, a=np.random.default_rng(7).random(grid.shape))
    image = vm.render(
        leaves, medium_on("sphere", shell), VIEWS["outside"], bounds=True, tolerance=TOLERANCE
    )
    brightest = image.intensity.max()
    assert np.max(image.upper - image.lower) <= 1.001 * TOLERANCE * brightest
    assert np.all(image.lower <= image.intensity + 0.2 * TOLERANCE * brightest)
    assert np.all(image.upper >= image.intensity - 0.2 * TOLERANCE * brightest)
