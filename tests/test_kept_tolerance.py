"""A picture keeps to its tolerance: `image.error` is at most that part of its maximum."""

from __future__ import annotations

import numpy as np
import pytest

import voluminous as vm
from test_turning_cameras import GRIDS, noise

SHELL = vm.Gaussian("a", 0.5, 0.1, (1, 0.5, 0.2), 0.3, 0.1)
MEDIA = {
    "shell": SHELL,
    # The brightest of all parts together is brighter than the picture is in any channel.
    "colours": SHELL + vm.Rectangle("a", 0.8, 0.05, (0.2, 0.5, 1.0), 0.5, 0.1),
    "surfaces": vm.Isosurface("a", [0.3, 0.6], "viridis", 0.4),
    "both signs": vm.Coefficients(["a", "-a"], "a"),
}
OPTIONS = [{}, {"background": 5.0}, {"tolerance": 1e-2}, {"tolerance": 1e-4, "precision": "double"}]


@pytest.mark.parametrize("options", OPTIONS, ids=str)
@pytest.mark.parametrize("medium", MEDIA)
def test_no_pixel_may_be_off_by_more_than_is_allowed(medium, options):
    camera = vm.Orthographic(60, 30, resolution=30)
    image = vm.render(noise(GRIDS["cartesian"]()), MEDIA[medium], camera, **options)
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
    image = vm.render(noise(GRIDS[grid]()), MEDIA["colours"], camera, background=0.5)
    assert image.error.max() <= 1e-3 * image.intensity.max() * (1 + 1e-6)


def test_what_single_precision_cannot_keep_double_does():
    """Rounding alone is 3e-6 of a pixel."""
    volume, camera = noise(GRIDS["cartesian"]()), vm.Orthographic(60, 30, resolution=30)
    image = vm.render(volume, SHELL, camera, tolerance=1e-6)
    assert image.provenance["precision"] == "double"
    assert image.error.max() <= 1e-6 * image.intensity.max()
