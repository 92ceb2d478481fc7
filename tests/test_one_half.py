"""What panels and their halves agree about, and are wrong: what lies in one half, or at an end."""

from __future__ import annotations

import numpy as np
import pytest

import voluminous as vm

# One ray, from z = 2 to z = 0: f is one on its way in, zero on its way out, linear between centres.
VOLUME = vm.Volume(vm.CartesianGrid([-1, 1], [-1, 1], [0, 1, 2]), f=[[[0.0, 1.0]]])
ALONG = vm.Orthographic(width=0.5, resolution=1)
DISTANCE = (np.arange(200_000) + 0.5) / 100_000
FIELD = np.clip(1.5 - DISTANCE, 0, 1)


def off(medium, emissivity, extinction, precision):
    """Return how far a pixel is off, and what it is said to be off by, relatively."""
    step = DISTANCE[1] - DISTANCE[0]
    depth = np.broadcast_to(extinction * step, DISTANCE.shape)
    exact = np.sum(emissivity * step * np.exp(0.5 * depth - np.cumsum(depth)))
    image = vm.render(VOLUME, medium, ALONG, precision=precision)
    return abs(image.intensity.item() / exact - 1), image.error.item() / exact


@pytest.mark.parametrize("precision", ["single"])
@pytest.mark.parametrize("opacity", [0.5, 2.0, 8.0])
@pytest.mark.parametrize("first", np.linspace(0.02, 0.7, 8))
def test_what_is_in_front_in_a_narrow_table(first, opacity, precision):
    """A dark peak that hides a bright one from where it is looked at, wherever they are."""
    values = first + np.array([0, 0.05, 0.1, 0.15, 0.2])
    bright, dark = np.array([0.0, 1, 0, 0, 0]), np.array([0.0, 0, 0, 1, 0])
    opacities = opacity * (0.3 * bright + dark)
    table = vm.Table("f", values, bright, opacities, 0.05)
    j, alpha = (np.interp(FIELD, values, v) / 0.05 for v in (bright, opacities))
    wrong, told = off(table, j, alpha, precision)
    assert wrong <= told + 1e-6
    assert told <= 2e-3


@pytest.mark.parametrize("precision", ["single"])
@pytest.mark.parametrize("place", [0.02, 0.1, 0.5, 0.9, 0.98])
@pytest.mark.parametrize("sigma", [1.0, 4.0, 14.0])
@pytest.mark.parametrize("kink", ["max", "min"])
def test_a_kink_in_a_wide_shell(kink, sigma, place, precision):
    """A parabola through the ends and the middle does not turn where the field does."""
    shell = vm.Gaussian(f"{kink}(f, {place})", place + sigma, sigma, 1.0, 0.1, 1.0)
    field = getattr(np, f"{kink}imum")(FIELD, place)
    j = np.exp(-0.5 * ((field - place) / sigma - 1) ** 2)
    wrong, told = off(shell, j, 0.1 * j, precision)
    assert wrong <= told + 1e-6
    assert told <= 2e-3


@pytest.mark.parametrize(("precision", "tolerance"), [("single", 1e-3), ("double", 1e-6)])
@pytest.mark.parametrize("power", [1, 2, 3])
@pytest.mark.parametrize(("begin", "opacity"), [(0.9, 10), (0.3, 100), (0.7, 1000), (0.9, 1000)])
def test_colours_that_begin_in_one_half(begin, opacity, power, precision, tolerance):
    """Where one half is empty the whole is the other one: they agree, whatever varies in it."""
    grid = vm.CartesianGrid([-1, 1], [-1, 1], [0, 1, 2])
    volume = vm.Volume(grid, f=[[[1.0, 0.0]]])  # the densest is behind
    medium = vm.Colormap("f", "viridis", begin, 1.5, lambda p: opacity * p**power, 1.0)
    image = vm.render(volume, medium, ALONG, precision=precision, tolerance=tolerance)
    f, step = np.clip(DISTANCE - 0.5, 0, 1), DISTANCE[1] - DISTANCE[0]
    depth = np.interp(f, medium.values, medium.opacities[:, 0]) * step
    seen = step * np.exp(0.5 * depth - np.cumsum(depth))
    exact = [np.sum(np.interp(f, medium.values, column) * seen) for column in medium.colors.T]
    wrong = np.abs(image.intensity[0, 0] - exact).max()
    assert wrong <= image.error.item() + 1e-6 * np.max(exact)
    assert image.error.item() <= 1.1 * tolerance * np.max(exact)
