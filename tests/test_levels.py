"""Coarser levels of a file: as volumes, in pictures, and as what large volumes are measured in."""

from __future__ import annotations

import pickle

import astropy.units as u
import numpy as np
import pytest

import voluminous as vm
from voluminous.errors import InputError
from voluminous.large.view import VolumeView
from voluminous.levels import level_within
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
    for number in range(1, whole.store.levels):
        expected = means(volume.array("a"), (1 << number,) * 3)
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
        # Stored means of means are of single precision.
        np.testing.assert_allclose(box, expected, rtol=1e-6)
        assert level.waiting == ("a",)
        np.testing.assert_array_equal(level.array("a"), box)
        # A level of a level; a level in another process; a level opened from the file.
        again = whole.level(1).level(number - 1)
        np.testing.assert_array_equal(again.array("a"), box)
        assert again.meta["level"] == number
        assert again.store.levels == whole.store.levels - number
        np.testing.assert_array_equal(
            pickle.loads(pickle.dumps(whole.level(number))).array("a"), box
        )
        opened = vm.open(tmp_path / "a.zarr", level=number)
        np.testing.assert_array_equal(opened.array("a"), box)
        # Ranges are those of the cells below.
        ranges = level.store.extremes("a")
        assert ranges.shape[:3] == tuple(
            -(-n // c) for n, c in zip(box.shape, (4, 4, 4), strict=True)
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
    samples = "voluminous.calibration.samples"
    monkeypatch.setattr(f"{samples}.level_within", lambda v, _: level_within(v, 16**3))
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


# --- the error of a level -------------------------------------------------------------------------


@pytest.mark.parametrize("memory", [None, "1 GiB"])
def test_how_far_a_picture_of_means_is_from_that_of_all_cells_is_unknown(stored, memory):
    assert vm.render(stored, MEDIUM, CAMERA, level=0, memory=memory).error is not None
    assert vm.render(stored, MEDIUM, CAMERA, level=1, memory=memory).error is None


def test_what_else_a_file_holds_of_its_levels_is_ignored(stored, tmp_path):
    """Distances of cells from their mean were stored once."""
    zarr = pytest.importorskip("zarr")
    expected = vm.render(stored, MEDIUM, CAMERA, level=1)
    root = zarr.open_group(str(tmp_path / "ball.zarr"), mode="r+", use_consolidated=False)
    for side in ("below", "above"):
        root.create_array(f"{side}/1/a", data=np.zeros((16, 16, 16), np.float32))
    zarr.consolidate_metadata(str(tmp_path / "ball.zarr"))
    image = vm.render(vm.open(tmp_path / "ball.zarr"), MEDIUM, CAMERA, level=1)
    assert np.array_equal(image.intensity, expected.intensity)


LARGE = 162  # along each side: more than the 4 million cells up to which a volume is measured whole


@pytest.fixture(scope="module")
def large(tmp_path_factory):
    pytest.importorskip("zarr", "3")
    path = tmp_path_factory.mktemp("large") / "large.zarr"
    x = np.linspace(-1, 1, LARGE, dtype=np.float32)
    r2 = x[:, None, None] ** 2 + x[:, None] ** 2 + x**2
    grid = vm.CartesianGrid.uniform(LARGE, (-1, 1), unit="pc")
    volume = vm.Volume(grid, density=np.exp(-4 * r2), temperature=(10 + 5 * r2) * u.K)
    volume["velocity"] = np.broadcast_to(x, grid.shape) * u.Unit("km/s")
    volume.save(path, levels=True, stats=True, chunks=54, keep_bits=6)
    return path


VERBS = {
    "render": lambda v, medium, camera, **how: vm.render(v, medium, camera, **how),
    "observe": lambda v, _, camera, **how: vm.observe(v, DUST, camera, wavelengths=[870.0], **how),
    "spectrum": lambda v, _, camera, **how: vm.spectrum(
        v, DUST, camera, wavelengths=[870.0], distance=140 * u.pc, tolerance=0.3, **how
    ),
    "plan": lambda v, medium, camera, **how: vm.plan(v, medium, camera, **how),
}
# Which measure in the cells of what they are given.
MEASURING = {
    "column": lambda v, _, camera, **how: vm.column(v, "density", camera, **how),
    "moments": lambda v, _, camera, **how: vm.moments(
        v, "density", camera, velocity="velocity", **how
    ),
    "project": lambda v, _, camera, **how: vm.project(v, "density", camera, **how),
    "tau_surface": lambda v, medium, camera, **how: vm.tau_surface(v, medium, camera, **how),
    "probe": lambda v, medium, camera, **how: vm.probe(
        v, medium, camera, (4, 4), tolerance=None, **how
    ),
    "measure": lambda v, _, __, **how: vm.measure(v, {"mass": "density"}, **how),
}
DUST = vm.Dust("density * 2e-22 g/cm3", "temperature", vm.Opacity.power_law(3.5, 870.0, 1.8))
OPEN = vm.Gaussian("density", 0.5, 0.2, "orange", opacity=0.5)  # path_length="auto"
SMALL_PICTURE = vm.Orthographic(30, 40, width=2.2, resolution=8)


@pytest.mark.parametrize("scheme", ["first-order", "post-classified"])
def test_what_is_measured_in_a_level_is_measured_chunk_by_chunk_too(large, scheme):
    """The default path length of more than 4 million cells, with memory=: the advertised call."""
    volume = vm.io.registry.open_lazily(large)
    assert volume.grid.size > 1 << 22
    assert OPEN.path_length == "auto"
    for level in (None, 1):
        pictures = [
            vm.render(volume, OPEN, SMALL_PICTURE, scheme=scheme, level=level, **memory)
            for memory in ({}, {"memory": "400 MB"})
        ]
        assert pictures[0].intensity.max() > 0
        whole, pieces = (image.intensity for image in pictures)
        # In memory wide steps through smooth blocks are within the tolerance.
        np.testing.assert_allclose(pieces, whole, atol=2e-3 * whole.max())


def test_levels_are_volumes_whatever_they_are_levels_of(large):
    volume = vm.open(large)
    outline = VolumeView.of(volume)
    for one in (volume, outline, VolumeView.of(volume.level(1))):
        level = one.level(1)
        assert type(level) is vm.Volume
        assert level.array("density").shape == level.grid.shape
        assert VolumeView.of(level).extremes("density").ndim == 4


@pytest.mark.parametrize("shape", [(16, 16, 16), (11, 13, 9)])
@pytest.mark.parametrize("dtype", ["f4", "f8"])
def test_a_mean_is_one_of_the_cells_that_count(tmp_path, shape, dtype):
    """Beside missing values and at the ends, on every level, as if made of the cells at once."""
    rng = np.random.default_rng(5)
    values = rng.uniform(1, 2, shape).astype(dtype)
    values[rng.random(shape) < 0.6] = np.nan
    values[:8, :8, :8] = np.nan
    values[0, 0, 0] = 7  # the only one
    grid = vm.CartesianGrid.uniform(shape, (0, 1))
    vm.Volume(grid, a=values).save(tmp_path / "a.zarr", levels=True, stats=True, chunks=4)
    volume = vm.open(tmp_path / "a.zarr")
    for number in range(1, volume.store.levels):
        side = 2**number
        level = volume.level(number).array("a")
        for index in np.ndindex(level.shape):
            cells = values[tuple(slice(i * side, (i + 1) * side) for i in index)]
            expected = np.nan if np.isnan(cells).all() else np.nanmean(cells, dtype=np.float64)
            # Of single precision once on each level.
            np.testing.assert_allclose(level[index], expected, rtol=1e-6)
    assert volume.level(2).array("a")[0, 0, 0] == 7


@pytest.mark.exhaustive
@pytest.mark.parametrize("memory", [None, "400 MB"])
@pytest.mark.parametrize("level", [None, 0, 1, 2, "auto"])
@pytest.mark.parametrize("verb", [*VERBS, *MEASURING])
@pytest.mark.filterwarnings("ignore")
def test_every_verb_at_every_level(large, verb, level, memory):
    volume = vm.io.registry.open_lazily(large)
    how = {} if memory is None else {"memory": memory}
    if verb in VERBS:
        how |= {} if level is None else {"level": level}
    elif level == "auto":
        pytest.skip("nothing is measured in a level that is chosen")
    elif level is not None:
        volume = volume.level(level)
    assert ({**VERBS, **MEASURING})[verb](volume, OPEN, SMALL_PICTURE, **how) is not None
