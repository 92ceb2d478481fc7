"""Volumes, media, cameras and images go to other processes, before and after pictures of them."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest

import voluminous as vm
from test_in_bounds import GRIDS, noise

SHELL = vm.Gaussian("a", 0.5, 0.1, (1, 0.5), 0.3, 0.5)
CAMERA = vm.Orthographic(60, 30, resolution=9)
COPIES = {"pickle": lambda thing: pickle.loads(pickle.dumps(thing)), "deepcopy": copy.deepcopy}


@pytest.mark.parametrize("copied", COPIES)
@pytest.mark.parametrize("grid", GRIDS)
def test_volumes_that_were_drawn_can_be_copied(grid, copied):
    volume = noise(grid)
    volume["b"] = "2*a"
    drawn = [vm.render(volume, SHELL, CAMERA, tolerance=None).intensity for _ in range(2)]
    other = COPIES[copied](volume)
    assert list(other) == ["a", "b"]
    found = vm.render(other, SHELL, CAMERA, tolerance=None).intensity
    np.testing.assert_array_equal(found, drawn[0])
    # The copy is one: what happens to it leaves the other as it was.
    other["a"] = np.zeros(other.grid.shape)
    assert volume.array("a").any()


@pytest.mark.parametrize("copied", COPIES)
def test_images_bring_an_optical_depth_that_was_not_asked_for(copied):
    volume = noise("octree")
    image = vm.render(volume, SHELL, CAMERA, cutoff=0.5)
    other = COPIES[copied](image)
    np.testing.assert_array_equal(other.intensity, image.intensity)
    np.testing.assert_array_equal(other.optical_depth, image.optical_depth)
    assert other.provenance == image.provenance


@pytest.mark.parametrize(
    "thing",
    [
        SHELL + vm.Rectangle("a", 0.2, 0.1, (1, 0), 0.2),
        vm.Gaussian("a", 0.5, 0.1, vm.ColorBy("b", "magma", 0, 1), 0.3, where="b > 0.2"),
        vm.Isosurface("a", [0.2, 0.4], "viridis", 0.5, shading=True),
        vm.Table("a", [0, 1], ["red", "blue"], [0.1, 0.2]),
        vm.Coefficients(["a", "b"], "a*b"),
    ],
    ids=lambda medium: type(medium).__name__,
)
@pytest.mark.parametrize("copied", COPIES)
def test_media_can_be_copied(thing, copied):
    other = COPIES[copied](thing)
    assert other.key() == thing.key()
    assert other.describe() == thing.describe()
