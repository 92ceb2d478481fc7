"""Cameras that see what shows, and little around it."""

from __future__ import annotations

import numpy as np
import pytest
from astropy import units as u

import voluminous as vm

DENSE = vm.Coefficients("density", "density")


def lump(center, radius, unit=None, n=64):
    """Return a box from 0 to 16 that is empty but for a ball."""
    grid = vm.CartesianGrid.uniform(n, (0, 16), unit=unit)
    x = (np.arange(n) + 0.5) * 16 / n
    away = sum((a - c) ** 2 for a, c in zip(np.ix_(x, x, x), center, strict=True))
    return vm.Volume(grid, density=1.0 * (away < radius**2))


@pytest.mark.parametrize("resolution", [100, (120, 60), (40, 90)])
@pytest.mark.parametrize("angles", [(0, 0), (60, 30), (90, 90), (130, 200)])
def test_all_that_shows_is_in_the_frame_and_fills_it(angles, resolution):
    volume = lump((4, 10, 12), 2.0)
    camera = vm.Orthographic.framing(volume, DENSE, *angles, resolution=resolution)
    image = vm.render(volume, DENSE, camera)
    lit = image.intensity[..., 0] > 0.02 * image.intensity.max()
    spans = [np.flatnonzero(lit.any(axis=a)) for a in (0, 1)]
    filled = [(s[-1] - s[0] + 1) / n for s, n in zip(spans, lit.shape[::-1], strict=True)]
    assert all(s[0] > 0 and s[-1] < n - 1 for s, n in zip(spans, lit.shape[::-1], strict=True))
    # 0.85 of the frame, up to the pixels of the coarse picture: 0.3 of a ball of 4.
    assert 0.7 < max(filled) < 0.95
    # A ball is in the middle.
    middles = [0.5 * (s[0] + s[-1] + 1) / n for s, n in zip(spans, lit.shape[::-1], strict=True)]
    assert middles == pytest.approx([0.5, 0.5], abs=0.06)


@pytest.mark.parametrize("density", [0.0, 1.0])
def test_the_whole_box_is_seen_where_nothing_shows_or_all_of_it(density):
    volume = vm.Volume(vm.CartesianGrid.uniform(8, (-1, 1)), density=np.full((8, 8, 8), density))
    camera = vm.Orthographic.framing(volume, DENSE, 20, 30, resolution=50)
    assert camera.width is None
    assert camera.describe() == vm.Orthographic(20, 30, resolution=50).describe()


def test_lengths_are_in_the_unit_of_the_volume():
    plain, parsecs = (
        vm.Orthographic.framing(lump((4, 10, 12), 2.0, unit), DENSE) for unit in (None, u.pc)
    )
    assert (plain.width, plain.shift) == (parsecs.width, parsecs.shift)


def test_a_first_picture_shows_what_there_is():
    volume = lump((4, 10, 12), 2.0)
    image = vm.render(volume)
    whole = vm.render(volume, vm.suggest_medium(volume), vm.Orthographic(60, 30))
    share = [np.mean(i.intensity.sum(axis=-1) > 0.02 * i.intensity.max()) for i in (image, whole)]
    assert share[0] > 0.3 > 3 * share[1]


def test_what_cannot_be_drawn_is_told_as_by_render():
    with pytest.raises(vm.errors.UnknownNameError, match="densty"):
        vm.Orthographic.framing(lump((4, 10, 12), 2.0), vm.Coefficients("densty", 1.0))
    with pytest.raises(vm.InputError, match="medium"):
        vm.Orthographic.framing(lump((4, 10, 12), 2.0), "density")


def test_without_a_medium_the_whole_volume_is_seen():
    density = np.zeros((16, 16, 16))
    density[4:6, 8:10, 8:10] = 1
    volume = vm.Volume(vm.CartesianGrid.uniform(16, (0, 16)), density=density)
    volume.meta["orientation"] = "LPS"
    camera = vm.Orthographic.framing(volume, view="left", resolution=32)
    assert camera.frame(volume.grid).pixel[0] == 0.5
    assert vm.project(volume, "density", camera).intensity.max() == 1


def test_a_perspective_camera_sees_the_same():
    volume = lump((4, 10, 12), 2.0)
    near = vm.Perspective.framing(volume, DENSE, 60, 30, resolution=64)
    image = vm.render(volume, DENSE, near).intensity[..., 0]
    edges = [image[0], image[-1], image[:, 0], image[:, -1]]
    assert max(edge.max() for edge in edges) < 0.02 * image.max()
    there = np.flatnonzero((image > 0.02 * image.max()).any(axis=0))
    assert np.ptp(there) > 0.4 * 64
    assert near.framing(volume, fov=90).width == pytest.approx((2.0, 2.0))
    with pytest.raises(vm.InputError, match="between 0 and 180"):
        vm.Perspective.framing(volume, fov=180)
