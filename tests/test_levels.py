"""Coarser levels of a file: as volumes, in pictures, and as what large volumes are measured in."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import voluminous as vm
from voluminous.errors import InputError
from voluminous.store import FieldStore, means

BOUNDS = [(-1, 1), (-1, 1), (-1, 1)]
MEDIUM = vm.Gaussian("a", 0.5, 0.2, (1, 0.5, 0.2), opacity=0.4, path_length=0.5)
CAMERA = vm.Orthographic(60, 30, width=3, resolution=24)


def ball(shape, dtype=np.float32):
    """Return a smooth ball on a grid."""
    grid = vm.CartesianGrid.uniform(shape, BOUNDS, unit="pc")
    volume = vm.Volume(grid)
    volume["a"] = "exp(-2 * r**2)"
    volume["a"] = volume.array("a").astype(dtype)
    volume.set_unit("a", "g/cm3")
    return volume


@pytest.fixture
def stored(tmp_path):
    """Return a volume of 32³ cells in chunks of 8³, unread."""
    path = tmp_path / "ball.zarr"
    ball(32).save(path, levels=True, stats=True, chunks=8)
    return vm.io.registry.open_lazily(path)


@pytest.fixture
def reads(monkeypatch):
    """Return the list of the levels and numbers of cells that are read."""
    boxes, read = [], FieldStore.read

    def counted(self, name, low, high, level=0):
        values = read(self, name, low, high, level)
        boxes.append((self.shape(0)[0], level, values.size))
        return values

    monkeypatch.setattr(FieldStore, "read", counted)
    return boxes


def test_a_level_is_a_volume_of_means_between_the_same_bounds(tmp_path):
    volume = ball((20, 17, 5))
    volume.meta["time"] = 3.0
    volume.save(tmp_path / "a.zarr", levels=True, stats=True, chunks=4)
    whole = vm.io.registry.open_lazily(tmp_path / "a.zarr")
    expected = volume.array("a")
    for number in range(1, whole.store.levels):
        expected = means(expected, (2, 2, 2))
        level = whole.level(number)
        assert level.waiting == ("a",)
        assert level.unit == whole.unit
        assert level.units == whole.units
        assert level.meta == {"time": 3.0, "level": number}
        np.testing.assert_array_equal(level.grid.bounds, whole.grid.bounds)
        np.testing.assert_array_equal(
            level.grid.edges[1][:-1], whole.grid.edges[1][: -1 : 2**number]
        )
        box = level.store.read("a", (0, 0, 0), level.grid.shape)
        np.testing.assert_array_equal(box, expected)
        assert level.waiting == ("a",)
        np.testing.assert_array_equal(level.array("a"), expected)
        # A level of a level; a level in another process; a level opened from the file.
        again = whole.level(1).level(number - 1)
        np.testing.assert_array_equal(again.array("a"), expected)
        assert again.meta["level"] == number
        assert again.store.levels == whole.store.levels - number
        np.testing.assert_array_equal(
            pickle.loads(pickle.dumps(whole.level(number))).array("a"), expected
        )
        opened = vm.open(tmp_path / "a.zarr", level=number)
        np.testing.assert_array_equal(opened.array("a"), expected)
        # Ranges are those of the cells below.
        ranges = level.store.extremes("a")
        assert ranges.shape[:3] == tuple(
            -(-n // c) for n, c in zip(expected.shape, (4, 4, 4), strict=True)
        )
        assert ranges[..., 0].min() == volume.array("a").min()
    assert whole.level(0) is whole


def test_a_level_knows_the_sky(tmp_path):
    from astropy.wcs import WCS

    volume = ball(16)
    volume.wcs = WCS(naxis=3)
    volume.wcs.wcs.ctype = ["RA---TAN", "DEC--TAN", "VRAD"]
    volume.wcs.wcs.crpix, volume.wcs.wcs.cdelt = [8.5, 8.5, 1], [-0.1, 0.1, 2]
    volume.wcs.pixel_shape = (16, 16, 16)
    volume.save(tmp_path / "a.zarr", levels=True, chunks=4)
    whole = vm.open(tmp_path / "a.zarr")
    coarse = whole.level(1).wcs
    # The middle of a pair of pixels is the middle of one coarse pixel.
    np.testing.assert_allclose(
        coarse.wcs_pix2world([[2, 3, 1]], 0), whole.wcs.wcs_pix2world([[4.5, 6.5, 2.5]], 0)
    )
    camera = vm.Orthographic(0, resolution=8)
    pictures = [vm.render(whole, MEDIUM, camera, level=k) for k in (0, 1)]
    assert pictures[1].wcs.to_header_string() == pictures[0].wcs.to_header_string()


def test_files_without_levels_say_how_to_store_some(tmp_path, stored):
    volume = ball(8)
    for draw in (lambda: volume.level(1), lambda: vm.render(volume, MEDIUM, CAMERA, level=1)):
        with pytest.raises(InputError, match=r"no coarser levels: .*convert FILE .* --levels"):
            draw()
    assert vm.render(volume, MEDIUM, CAMERA, level="auto").provenance["level"] == 0
    with pytest.raises(InputError, match="from 0 to 2"):
        stored.level(3)
    for wrong in (-1, 1.0, True, "coarse"):
        with pytest.raises(InputError, match="level"):
            vm.render(stored, MEDIUM, CAMERA, level=wrong)
    with pytest.raises(InputError, match="bounds=True is for all cells"):
        vm.render(stored, MEDIUM, CAMERA, level=1, bounds=True)
    disc = vm.Volume(vm.CylindricalGrid([1, 2, 3], [0, 2 * np.pi], [-1, 1]), a="R")
    with pytest.raises(InputError, match="levels are of Cartesian grids"):
        disc.level(1)
    assert vm.render(disc, MEDIUM, CAMERA, level="auto").provenance["level"] == 0


@pytest.mark.parametrize("options", [{}, {"memory": "1 GiB"}, {"scheme": "first-order"}], ids=str)
def test_a_picture_of_a_level_is_that_of_its_volume(stored, options):
    for level in (0, 1, 2):
        image = vm.render(stored, MEDIUM, CAMERA, level=level, **options)
        expected = vm.render(stored.level(level), MEDIUM, CAMERA, **options)
        np.testing.assert_array_equal(image.intensity, expected.intensity)
        np.testing.assert_array_equal(image.transparency, expected.transparency)
        assert image.provenance["level"] == level
    assert "level" not in vm.render(stored, MEDIUM, CAMERA).provenance


def test_cells_of_a_picture_are_no_wider_than_its_pixels(stored):
    def level(camera):
        return vm.render(stored, MEDIUM, camera, level="auto").provenance["level"]

    # Cells of levels 0, 1, 2 are 1/16, 1/8 and 1/4 wide.
    for pixels, expected in ((40, 0), (17, 0), (16, 1), (9, 1), (8, 2), (1, 2)):
        assert level(vm.Orthographic(0, 0, width=2, resolution=pixels)) == expected
    wide = vm.Orthographic(0, 0, width=(2, 0.5), resolution=(8, 8))
    assert level(wide) == 0  # pixels are 1/4 by 1/16
    # From far away, pixels are as wide as the distance to the next corner times their angle.
    for distance, expected in ((26, 2), (13, 1), (12, 0), (-0.5, 0)):
        camera = vm.Perspective((distance + 1.0, 0, 0), (0, 0, 0), width=0.16, resolution=16)
        assert level(camera) == expected


def test_the_nearest_cells_are_those_that_may_be_visible(tmp_path):
    volume = ball(32)
    volume["a"] = np.where(volume.grid.centers[0][:, None, None] < 0, volume.array("a"), 0)
    paths = {stats: tmp_path / f"{stats}.zarr" for stats in (True, False)}
    for stats, path in paths.items():
        volume.save(path, levels=True, stats=stats, chunks=8)
    shell = vm.Gaussian("a", 0.5, 0.05, 1.0, opacity=0.4, path_length=0.5)  # invisible at zero
    # Pixels at the edge are 0.16 wide at x = 0, 3 away, and 0.1 where the grid begins.
    camera = vm.Perspective((3, 0, 0), (0, 0, 0), width=0.7, resolution=12)
    found = {
        stats: vm.render(vm.open(path), shell, camera, level="auto").provenance["level"]
        for stats, path in paths.items()
    }
    assert found == {True: 1, False: 0}


def test_large_volumes_are_measured_in_a_level(stored, reads, monkeypatch):
    for room in ("samples", "histogram", "thickness"):
        monkeypatch.setattr(f"voluminous.calibration.{room}.BUDGET", 16**3)
    medium = vm.suggest_medium(stored)
    shell = vm.Gaussian("a", 0.5, 0.1, (1, 1, 1), 0.1, path_length="auto")
    colours = vm.Colormap("a", "viridis")
    coarse = stored.level(1)
    assert shell.calibrated(stored).path_length == shell.calibrated(coarse).path_length
    assert medium.describe() == vm.suggest_medium(coarse).describe()
    camera = vm.Orthographic.framing(stored, shell)
    for level in (1, 2):
        image = vm.render(stored, shell + colours, camera.replace(resolution=8), level=level)
        # What is "auto" does not depend on the level that is drawn.
        assert image.provenance["medium"] == (shell + colours).calibrated(stored).describe()
    assert vm.render(stored, camera=camera, level=2).provenance["level"] == 2
    assert stored.waiting == ("a",)
    assert all(level for cells, level, _ in reads if cells == 32)
