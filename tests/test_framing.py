"""Cameras that see what shows, and little around it."""

from __future__ import annotations

from contextlib import nullcontext

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
    with nullcontext() if density else pytest.warns(UserWarning, match="shows nothing"):
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


CENTER = (0.3117, 0.7003, 0.5201)


def nested(levels=12):
    """Return an octree on the unit box, refined towards a point, and cells' distances from it."""

    def near(x, y, z, size):
        return np.linalg.norm([x - CENTER[0], y - CENTER[1], z - CENTER[2]], axis=0) < 4 * size

    walls = np.linspace(0, 1, 5)
    grid = vm.OctreeGrid.from_function(walls, walls, walls, near, levels)
    return grid, np.linalg.norm(grid.cell_centers() - np.array(CENTER)[:, None], axis=0)


def share_lit(volume, medium, camera):
    light = vm.render(volume, medium, camera).intensity.sum(axis=-1)
    assert light.max() > 0
    return float(np.mean(light > 0.02 * light.max()))


# Cells there are a quarter of this wide, and 1e-3 of the box is a tenth of a coarse pixel.
SMALL = 5e-4
TINY = [
    vm.Coefficients("density", "density"),
    # What is faint everywhere else does not count.
    vm.Coefficients("density + 1e-5", 0),
    vm.Isosurface("density", level=5e3, color=(1, 0, 0)),
    # What only absorbs.
    vm.Coefficients(0, "density"),
]


@pytest.mark.parametrize("medium", TINY, ids=["emits", "faint halo", "surface", "absorbs"])
def test_what_is_far_smaller_than_a_coarse_pixel_is_framed(medium):
    grid, away = nested()
    volume = vm.Volume(grid, density=np.where(away < SMALL, 1e4, 0.0))
    camera = vm.Orthographic.framing(volume, medium, 60, 30, resolution=40)
    # A ball of 1e-3 fills 0.85 of the frame; fields fall to zero from cell to cell around it.
    assert 2 * SMALL < camera.width < 4 * SMALL
    middle = camera.frame(grid)
    found = middle.vectors[0] + np.array(camera.shift) @ middle.vectors[1:3]
    seen = np.array(CENTER) - found
    assert np.abs(middle.vectors[1:3] @ seen).max() < 0.2 * camera.width
    near = vm.Perspective.framing(volume, medium, 60, 30, resolution=40)
    assert np.linalg.norm(np.array(near.target) - CENTER) < 0.5 * camera.width
    if medium is not TINY[-1]:
        assert share_lit(volume, medium, camera) > 0.3
        assert share_lit(volume, medium, near) > 0.1


def test_what_is_small_is_framed_on_grids_of_any_kind(tmp_path):
    density = np.zeros((200, 200, 200), np.float32)
    density[150:152, 61:63, 33:35] = 1.0
    box = vm.Volume(vm.CartesianGrid.uniform(200, (0, 1)), density=density)
    assert 0.01 < vm.Orthographic.framing(box, DENSE, 60, 30).width < 0.03
    box.meta["y_down"] = True
    box.save(tmp_path / "box.zarr")
    whole = vm.Orthographic.framing(box, DENSE, view="stack")
    parts = vm.render(vm.open(tmp_path / "box.zarr"), DENSE, view="stack", memory="400 MB")
    # Chunks tell less of where it is than blocks: another coarse picture, with other pixels.
    assert parts.camera["width"] == pytest.approx(whole.width, rel=0.2)
    assert parts.intensity.max() > 0
    r = np.geomspace(1e-4, 1, 60)
    walls = np.linspace(0, np.pi, 9)
    grid = vm.SphericalGrid(r, walls, 2 * walls)
    inner = np.where(r[1:] < 1e-3, 1e4, 0.0)[:, None, None]
    ball = vm.Volume(grid, density=np.broadcast_to(inner, grid.shape).copy())
    camera = vm.Orthographic.framing(ball, DENSE, 60, 30, resolution=40)
    assert 1.5e-3 < camera.width < 3.5e-3
    assert share_lit(ball, DENSE, camera) > 0.3


def test_frames_without_anything_to_see_say_so():
    volume = vm.Volume(vm.CartesianGrid.uniform(8, (-1, 1)), density=np.ones((8, 8, 8)))
    medium = vm.Gaussian("density", 3.0, 0.1, 1.0, 1.0, 1.0)
    for kind in (vm.Orthographic, vm.Perspective):
        with pytest.warns(UserWarning, match="density is from 1 to 1") as told:
            kind.framing(volume, medium, 20, 30)
        assert told[0].filename == __file__
