"""Pictures drawn chunk by chunk: the bits of the whole, in memory that does not depend on it."""

from __future__ import annotations

import itertools
import re
import subprocess
import sys
import threading

import numpy as np
import pytest

import voluminous as vm
from test_confined_walk import CAMERAS as WALKED
from test_confined_walk import SHAPE, UNEVEN, UNIFORM
from voluminous.errors import InputError, MemoryNeededError
from voluminous.io.registry import open_lazily
from voluminous.store import FieldStore

VERTEX = [float(edges[4]) for edges in UNIFORM.edges]
CAMERAS = {
    **WALKED,
    "in a vertex": vm.Perspective(VERTEX, (1, 1, 0.3), 80, resolution=24),
    "all around": vm.Panorama((0.1, 0.05, 0.02), (1, 1, 0.3), resolution=(32, 16)),
}
MEDIUM = vm.Gaussian("a", 0.5, 0.2, (1, 0.5, 0.2), opacity=0.4, path_length=0.5)
ORTHOGRAPHIC = CAMERAS["oblique"]


def noise(grid, seed=5):
    """Return a volume of values from 0 to 1 in which nothing is invisible."""
    values = np.random.default_rng(seed).uniform(0, 1, grid.shape).astype(np.float32)
    values[0, 0, 0], values[-1, -1, -1] = 0, 1
    return vm.Volume(grid, a=values)


@pytest.fixture
def chunks(monkeypatch):
    """Make chunks of arrays in memory this wide, and blocks of one chunk."""

    def make(side):
        monkeypatch.setattr("voluminous.store.FieldStore.side", side)
        monkeypatch.setattr("voluminous.large.view.VolumeView.widest", side)

    return make


@pytest.fixture
def reads(monkeypatch):
    """Return the list of the boxes that are read."""
    boxes, read = [], FieldStore.read

    def counted(self, name, low, high, level=0):
        boxes.append((tuple(low), tuple(high)))
        return read(self, name, low, high, level)

    monkeypatch.setattr(FieldStore, "read", counted)
    return boxes


@pytest.fixture
def ahead(monkeypatch):
    """Return the list of the boxes that are read ahead: not of those of which samples are taken."""
    boxes, read = [], FieldStore.read

    def counted(self, name, low, high, level=0):
        if threading.current_thread() is not threading.main_thread():
            boxes.append((tuple(low), tuple(high)))
        return read(self, name, low, high, level)

    monkeypatch.setattr(FieldStore, "read", counted)
    return boxes


def both(volume, medium, camera, **options):
    """Return the picture of the whole volume, and that drawn chunk by chunk."""
    whole = vm.render(volume, medium, camera, **options)
    return whole, vm.render(volume, medium, camera, memory="1 GiB", **options)


def assert_same_bits(whole, parts):
    np.testing.assert_array_equal(parts.intensity, whole.intensity)
    np.testing.assert_array_equal(parts.transparency, whole.transparency)
    np.testing.assert_array_equal(parts.optical_depth, whole.optical_depth)
    if whole.error is not None:
        np.testing.assert_array_equal(parts.error, whole.error)
    assert whole.intensity.max() > 0


@pytest.mark.each_value_once
@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
@pytest.mark.parametrize("grid", [UNIFORM, UNEVEN], ids=["uniform", "uneven"])
def test_chunks_have_the_bits_of_the_whole(grid, camera, chunks, reads):
    # Chunks of four cells, and at the ends of one, three and four; then of three, one and two.
    for side in (4, 3):
        chunks(side)
        del reads[:]
        assert_same_bits(*both(noise(grid), MEDIUM, camera, scheme="first-order"))
        assert len(set(reads)) == np.prod([-(-n // side) for n in SHAPE])


@pytest.mark.each_value_once
@pytest.mark.parametrize("tolerance", [None, 1e-3])
@pytest.mark.parametrize("camera", ["oblique", "along x", "from inside", "in a vertex"])
def test_chunks_have_the_bits_of_the_whole_on_interpolated_fields(tolerance, camera, chunks):
    chunks(4)
    grid = UNEVEN if camera == "oblique" else UNIFORM
    assert_same_bits(*both(noise(grid), MEDIUM, CAMERAS[camera], tolerance=tolerance))


@pytest.mark.parametrize(
    ("antialias", "scheme"),
    [
        ("adaptive", "first-order"),
        ("radmc3d", "first-order"),
        ("radmc3d", "post-classified"),
        pytest.param("adaptive", "post-classified", marks=pytest.mark.exhaustive),
    ],
)
def test_more_rays_have_the_bits_of_the_whole(antialias, scheme, chunks):
    chunks(4)
    camera = ORTHOGRAPHIC.replace(resolution=3)  # in noise up to 256 rays for each pixel
    assert_same_bits(*both(noise(UNIFORM), MEDIUM, camera, antialias=antialias, scheme=scheme))


@pytest.mark.parametrize("scheme", ["first-order", "post-classified"])
def test_objects_are_between_the_blocks(scheme, chunks):
    chunks(4)
    middle = UNIFORM.bounds.mean(axis=1)
    stars = vm.Stars([middle + 0.2], luminosities=3.0)
    balls = vm.Stars([middle - 0.1], 5.0, radii=0.1, opacity=0.5)
    whole, parts = both(
        noise(UNIFORM), MEDIUM, ORTHOGRAPHIC, objects=[stars, balls, vm.Boxes()], scheme=scheme
    )
    assert_same_bits(whole, parts)
    bare = vm.render(noise(UNIFORM), MEDIUM, ORTHOGRAPHIC, scheme=scheme)
    assert np.abs(whole.intensity - bare.intensity).max() > 0.1


def test_observers_beside_the_wall_of_a_chunk(chunks):
    # Cells of interpolated fields lie between centres: half a cell below the wall of a chunk rays
    # begin in the next one, and go through this one later.
    chunks(4)
    volume = noise(UNIFORM)
    for part in (-0.3, 0.3, 0.5):
        place = [e[4] + part * (e[5] - e[4]) for e in map(np.asarray, UNIFORM.edges)]
        for target in ((-1, -1, -1), (1, -1, 0.3)):
            camera = vm.Perspective([float(x) for x in place], target, 90, resolution=24)
            assert_same_bits(*both(volume, MEDIUM, camera, tolerance=None))


@pytest.mark.each_value_once
@pytest.mark.parametrize("scheme", ["first-order", "pre-integrated"])
@pytest.mark.parametrize("camera", CAMERAS)
def test_stored_chunks_are_read_once(camera, scheme, tmp_path, chunks, ahead):
    # Rays that interpolate need a layer of chunks that were read before: of blocks on the near
    # side, on whichever side of a wall the observer is.
    volume, options = noise(UNIFORM), {"scheme": scheme}
    volume.save(tmp_path / "a.zarr", chunks=3, stats=True)
    stored = open_lazily(tmp_path / "a.zarr")
    whole = vm.render(volume, MEDIUM, CAMERAS[camera], **options)
    for side in (3, 6):
        chunks(side)
        del ahead[:]
        image = vm.render(stored, MEDIUM, CAMERAS[camera], memory="1 GiB", **options)
        assert_same_bits(whole, image)
        # Here the observer is between the outer layers of two chunks: both are read at first.
        between = 9 if (camera, scheme) == ("all around", "pre-integrated") else 0
        assert len(ahead) <= np.prod([-(-n // 3) for n in SHAPE]) + between


def test_pixels_beyond_the_tolerance_are_drawn_again(chunks, reads):
    chunks(5)
    for resolution in (24, 120):
        del reads[:]
        camera = vm.Orthographic(35, 50, width=4, resolution=resolution)
        assert_same_bits(*both(noise(UNIFORM), MEDIUM, camera))
        # After the ranges: all pixels, and those again whose error is too large for the brightness
        # that this gave; or a sample of pixels, which gives it, and all pixels.
        assert len(reads) > 2 * 8


def test_media_samples_backgrounds_and_numbers(chunks):
    chunks(4)
    volume, options = noise(UNIFORM), {"scheme": "first-order"}
    whole, parts = both(volume, MEDIUM, ORTHOGRAPHIC, samples=2, background=(0.1, 0.2, 0.3))
    np.testing.assert_array_equal(parts.intensity, whole.intensity)
    # Coordinates, several media with their path lengths measured, and bytes.
    several = vm.Gaussian("a", 0.5, 0.2, "gold", 0.5) + vm.Gaussian(
        "a + 0.1*z", 0.3, 0.2, "red", 0.5
    )
    assert_same_bits(*both(volume, several, ORTHOGRAPHIC, **options))
    whole_numbers = vm.Volume(UNIFORM, a=(volume["a"] * 255).astype(np.uint8))
    shell = vm.Gaussian("a/255", 0.5, 0.2, "red", 0.5)
    assert_same_bits(*both(whole_numbers, shell, ORTHOGRAPHIC, **options))
    assert_same_bits(*both(whole_numbers, shell, ORTHOGRAPHIC))
    # More channels than are drawn together.
    many = vm.Coefficients([f"a**{k % 5}" for k in range(20)], "a")
    assert_same_bits(*both(volume, many, ORTHOGRAPHIC, **options))
    # In double precision rays add up in other bits.
    whole, parts = both(volume, MEDIUM, ORTHOGRAPHIC, precision="double", **options)
    np.testing.assert_allclose(parts.intensity, whole.intensity, rtol=0, atol=1e-14)


def test_only_chunks_that_show_something_are_read(chunks, reads):
    chunks(4)
    grid = vm.CartesianGrid.uniform(16, (-1, 1))
    volume = vm.Volume(grid, a="x*0")
    values = np.zeros(grid.shape, np.float32)
    values[8:12, 4:8, 12:16] = np.random.default_rng(1).uniform(0.9, 1.1, (4, 4, 4))
    volume["a"] = values
    blob = vm.Gaussian("a", 1.0, 0.05, (1, 1, 1), opacity=2, path_length=0.5)
    # The cells of the chunk; and those of the eight blocks in which it is seen, with one layer.
    for scheme, most in (("first-order", 4**3), ("post-classified", 8 * 5**3)):
        whole = vm.render(volume, blob, ORTHOGRAPHIC, scheme=scheme)
        del reads[:]
        parts = vm.render(volume, blob, ORTHOGRAPHIC, scheme=scheme, memory="1 GiB")
        ranges = 64
        assert sum(np.prod(np.subtract(high, low)) for low, high in set(reads[ranges:])) <= most
        # Faint places that the whole picture leaves out.
        scale = whole.intensity.max()
        error = 1e-7 * scale if whole.error is None else whole.error[..., None] + parts.error.max()
        assert np.all(np.abs(parts.intensity - whole.intensity) <= error)
        assert scale > 0.1


def test_chunks_behind_an_opaque_one_are_not_read(chunks, reads):
    chunks(4)
    grid = vm.CartesianGrid.uniform(16, (-1, 1))
    volume = vm.Volume(grid, a=np.random.default_rng(1).uniform(0.9, 1.1, grid.shape))
    opaque = vm.Gaussian("a", 1.0, 0.2, (1, 1, 1), opacity=100, path_length=0.1)
    camera = vm.Orthographic(0, 0, width=1.9, resolution=24)
    whole, parts = both(volume, opaque, camera, scheme="first-order")
    np.testing.assert_array_equal(parts.intensity, whole.intensity)
    # Some are read ahead while rays still go to the one before.
    assert len(reads) <= 64 + 1.3 * 16
    np.testing.assert_array_equal(parts.optical_depth, whole.optical_depth)


def ball(radius, folder):
    """Return values near one in a ball and zero around it, stored in chunks of 4³, and whose."""
    grid = vm.CartesianGrid.uniform(32, (-1, 1))
    x, y, z = np.meshgrid(*grid.centers, indexing="ij")
    values = np.random.default_rng(1).uniform(0.9, 1.1, grid.shape).astype(np.float32)
    volume = vm.Volume(grid, a=np.where(x * x + y * y + z * z < radius**2, values, 0))
    volume.save(folder / "ball.zarr", chunks=4, stats=True)
    return volume["a"], open_lazily(folder / "ball.zarr")


@pytest.mark.parametrize("side", [4, 8])
def test_chunks_that_show_nothing_are_not_read(side, tmp_path, chunks, ahead):
    chunks(side)
    values, stored = ball(0.3, tmp_path)
    shows = values.reshape(8, 4, 8, 4, 8, 4).max(axis=(1, 3, 5)) > 0
    assert 0.03 < np.mean(shows) < 0.1
    thin = vm.Gaussian("a", 1, 0.05, "white", opacity=0.1, path_length=1)
    vm.render(stored, thin, ORTHOGRAPHIC, scheme="first-order", memory="1 GiB")
    # Blocks of several chunks are visible as a whole; of them, too, only those that show something.
    assert {low for low, _ in ahead} == {tuple(4 * i for i in p) for p in np.argwhere(shows)}
    assert len(ahead) == np.count_nonzero(shows)


@pytest.mark.parametrize("side", [4, 16])
def test_chunks_behind_an_opaque_surface_are_not_read(side, tmp_path, chunks, ahead):
    chunks(side)
    values, stored = ball(0.8, tmp_path)
    opaque = vm.Gaussian("a", 1, 0.07, "white", opacity=100, path_length=0.01)
    camera = vm.Orthographic(0, 0, width=2, resolution=64)
    image = vm.render(stored, opaque, camera, scheme="first-order", memory="1 GiB")
    assert image.transparency.min() < 1e-6
    # Rays are at their end in the first cell, and stop after the next one.
    met = (values > 0) & (np.cumsum(values > 0, axis=2) <= 2)
    visible = np.count_nonzero(met.reshape(8, 4, 8, 4, 8, 4).any(axis=(1, 3, 5)))
    assert visible <= len(ahead) <= 1.3 * visible


def test_progress_counts_cells_and_cancels(chunks):
    chunks(4)
    told = []
    vm.render(
        noise(UNIFORM),
        MEDIUM,
        ORTHOGRAPHIC,
        memory=1 << 30,
        progress=lambda done, total: told.append((done, total)),
    )
    done = [d for d, _ in told]
    assert done == sorted(done)
    assert told[-1] == (UNIFORM.size, UNIFORM.size)
    assert len(set(done)) > 8

    def cancel(done, total):
        if done:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        vm.render(noise(UNIFORM), MEDIUM, ORTHOGRAPHIC, memory=1 << 30, progress=cancel)


def test_what_cannot_be_drawn_in_chunks_is_refused():
    volume = noise(UNIFORM)

    def refused(match, volume=volume, medium=MEDIUM, camera=ORTHOGRAPHIC, **options):
        with pytest.raises(InputError, match=match):
            vm.render(volume, medium, camera, **{"memory": "1 GiB", **options})

    for memory in ("two gigabytes", "1 GiBs", "", -1, 0, True, [1], "1.2.3 GB"):
        refused("memory is the number of bytes", memory=memory)
    for scheme in ("second-order", "olson-kunasz"):
        refused("post-classified.*pre-integrated.*first-order", scheme=scheme)
    refused("bounds", bounds=True)
    refused("medium that is given", medium=None)
    refused("computed", medium=vm.Gaussian("gradmag(a)", 0.5, 0.2, "red", 0.5))
    refused("Cartesian", volume=vm.Volume(vm.SphericalGrid([0, 1, 2]), a=np.ones((2, 1, 1))))
    hole = volume["a"].copy()
    hole[1, 2, 3] = np.nan
    refused("missing", volume=vm.Volume(UNIFORM, a=hole))
    stereo = vm.Perspective((0.0, 0.0, 0.0), (1, 0, 0), 50, stereo="side-by-side", eye_distance=3)
    refused("one place", camera=stereo.replace(resolution=(48, 24)))
    with pytest.raises(MemoryNeededError, match="fewer pixels"):
        vm.render(volume, MEDIUM, ORTHOGRAPHIC, memory="20 MB")
    negative = vm.Coefficients("a", "where(a > 0.999, -1, a)")
    cell = tuple(int(i) for i in np.argwhere(volume["a"] > 0.999)[0])
    many = ORTHOGRAPHIC.replace(resolution=400)
    with pytest.raises(InputError, match=re.escape(str(cell))):
        vm.render(volume, negative, many, memory="1 GiB", scheme="first-order")


LIMITED = """
import resource
import sys
import numpy as np
import voluminous as vm

def status(what):  # what getrusage tells includes the parent's
    lines = open("/proc/self/status").read().splitlines()
    return int(next(line.split()[1] for line in lines if line.startswith(what))) << 10

path, scheme, pixels, limit = sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4]) << 20
memory = {} if sys.argv[5:] == ["whole"] else {"memory": limit}
medium = vm.Gaussian("a", 0.5, 0.2, (1, 0.5, 0.2), opacity=0.4, path_length=50)
small = vm.Volume(vm.CartesianGrid.uniform(8, (0, 1)), a=np.linspace(0, 1, 512).reshape(8, 8, 8))
camera = vm.Orthographic(35, 50, width=2, resolution=64)
vm.render(small, medium, camera, scheme=scheme, **memory)
volume = vm.open(path)
camera = camera.replace(width=1.8 * volume.grid.shape[0], resolution=pixels)
before = status("VmRSS")
resource.setrlimit(resource.RLIMIT_DATA, (status("VmData") + limit,) * 2)
image = vm.render(volume, medium, camera, scheme=scheme, **memory)
assert image.intensity.max() > 0
print(status("VmHWM") - before)
"""


def limited(path, scheme, pixels, mebibytes, *how):
    """Return how drawing ended in a process that may take so much more memory; it told how much."""
    command = [sys.executable, "-c", LIMITED, *map(str, (path, scheme, pixels, mebibytes, *how))]
    return subprocess.run(command, capture_output=True, text=True, timeout=2000)


def large_file(folder, layers):
    """Return the path of a file of so many MiB: a plane that moves on in each."""
    path = folder / "a.npy"
    array = np.lib.format.open_memmap(path, "w+", np.float32, (layers, 512, 512))
    plane = np.random.default_rng(1).uniform(0, 1, (512, 512))
    for k in range(len(array)):
        array[k] = np.roll(plane, k, axis=0)
    return path


def tiled(folder, times):
    """Return the path of a store of 256³ numbers, repeated along each axis by links to files."""
    zarr = pytest.importorskip("zarr")
    cells, path = 256 * times, folder / f"{times}.zarr"
    values = np.random.default_rng(1).uniform(0, 1, (256,) * 3).astype(np.float32)
    once = vm.Volume(vm.CartesianGrid.uniform(256, (0, 256)), a=values)
    once.save(folder / "once.zarr", stats=True, keep_bits=10)
    about, root = zarr.open_group(folder / "once.zarr"), zarr.open_group(path, zarr_format=3)
    arrays = {f"grid/{axis}": np.linspace(0, cells, cells + 1) for axis in "xyz"}
    arrays["stats/a"] = np.tile(about["stats/a"][...], (times, times, times, 1))
    for place, data in arrays.items():
        root.create_array(place, data=data, chunks=data.shape)
    (folder / "once.zarr/fields").rename(path / "fields")
    root["fields/a"].resize((cells,) * 3)
    root.attrs.update(about.attrs)
    root.attrs["grid"] = {**root.attrs["grid"], "cells": cells**3}
    for place in itertools.product(range(2 * times), repeat=3):
        first = path / "fields/a/c" / "/".join(str(i % 2) for i in place)
        file = path / "fields/a/c" / "/".join(map(str, place))
        file.parent.mkdir(parents=True, exist_ok=True)
        if file != first:
            file.hardlink_to(first)
    return path


on_linux = pytest.mark.skipif(sys.platform != "linux", reason="memory is limited and told by Linux")


@on_linux
def test_memory_is_what_was_asked_for(tmp_path):
    # 264 MiB of numbers, which are not read when they are opened, in no more memory than 200 MiB,
    # which is enforced; whole they need more.
    path = large_file(tmp_path, 264)
    for scheme in ("first-order", "post-classified"):
        ended = limited(path, scheme, 100, 200)
        assert ended.returncode == 0, ended.stderr
    whole = limited(path, "post-classified", 100, 200, "whole")
    assert "MemoryNeededError" in whole.stderr


@on_linux
@pytest.mark.exhaustive
def test_memory_does_not_depend_on_the_volume(tmp_path):
    peaks = []
    for times, mebibytes in ((4, 512), (8, 768)):
        (folder := tmp_path / str(times)).mkdir()
        ended = limited(tiled(folder, times), "first-order", 800, mebibytes)
        assert ended.returncode == 0, ended.stderr
        peaks.append(int(ended.stdout))
    assert peaks[1] <= 1.2 * peaks[0]
