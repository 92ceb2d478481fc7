"""Kernels are compiled once: neither numbers nor where they are in memory make another one."""

from __future__ import annotations

import numpy as np
import pytest

import voluminous as vm
from voluminous.backend import dr, from_host, get_backend

MEDIUM = vm.Gaussian("d", 0.5, 0.05, (1, 0.5, 0.1), 0.3, 0.5)
FULL = (0, 2 * np.pi)


def uniform(n):
    return vm.CartesianGrid(*(np.linspace(-1, 1, n + k) for k in range(3)))


def uneven(n):
    return vm.CartesianGrid(*(np.linspace(-1, 1, n + k) ** 3 for k in range(3)))


def octree(n):
    base = [np.linspace(-1, 1, n + k) for k in range(3)]
    return vm.OctreeGrid.from_function(*base, lambda x, y, z, w: x * y > z, 2)


def spherical(n):
    return vm.SphericalGrid(
        np.linspace(0.2, 1, n), np.linspace(0, np.pi, n + 1), np.linspace(*FULL, n + 2)
    )


def cylindrical(n):
    return vm.CylindricalGrid(
        np.linspace(0.2, 1, n), np.linspace(*FULL, n + 1), np.linspace(-1, 1, n + 2)
    )


GRIDS = {f.__name__: f for f in (uniform, uneven, octree, spherical, cylindrical)}


def draw(grid, n, scheme):
    volume = vm.Volume(grid, d=np.random.default_rng(n).random(grid.shape))
    camera = vm.Orthographic(60 + n, 30 - n, resolution=(20 + n, 40 - n))
    vm.render(volume, MEDIUM, camera, scheme=scheme)


@pytest.mark.parametrize("scheme", ["first-order", "second-order", "post-classified"])
@pytest.mark.parametrize("kind", GRIDS)
def test_grids_of_all_sizes_share_theirs(kind, scheme, kernels):
    known = kernels(draw, GRIDS[kind](7), 7, scheme) | kernels(draw, GRIDS[kind](8), 8, scheme)
    assert kernels(draw, GRIDS[kind](19), 19, scheme) <= known


def test_lists_of_pixels_share_that_of_the_whole_picture(kernels):
    """What is off is drawn again by the kernel that drew it: one of many lanes, for one ray too."""
    volume = vm.Volume(uniform(9), d=np.random.default_rng(0).random((8, 9, 10)))
    camera = vm.Orthographic(60, 30, resolution=30)
    known = kernels(vm.render, volume, MEDIUM, camera, tolerance=0.5)
    assert kernels(vm.render, volume, MEDIUM, camera, tolerance=1e-3) <= known


@pytest.mark.parametrize("shift", [1, 2, 3, 5])
def test_memory_may_begin_anywhere(shift, kernels):
    kind = get_backend("cpu").Float
    numbers = np.arange(100 + shift, dtype=np.float32)

    def run(values):
        dr.eval(from_host(kind, values) + dr.opaque(kind, 1.0))

    assert kernels(run, numbers[shift:]) == kernels(run, numbers[:100].copy())
    np.testing.assert_array_equal(np.asarray(from_host(kind, numbers[shift:])), numbers[shift:])


def test_numbers_are_converted_and_put_side_by_side():
    backend = get_backend("cpu")
    columns = np.arange(12.0).reshape(4, 3)
    held = np.asarray(from_host(backend.UInt, columns[:, 1]))
    assert held.dtype == np.uint32
    assert held.tolist() == [1, 4, 7, 10]
