"""Pictures drawn chunk by chunk: the bits of the whole, in memory that does not depend on it."""

from __future__ import annotations

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
        monkeypatch.setattr("voluminous.store.SIDE", side)
        monkeypatch.setattr("voluminous.rendering.pieces._WIDEST", side)

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


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
@pytest.mark.parametrize("grid", [UNIFORM, UNEVEN], ids=["uniform", "uneven"])
def test_chunks_have_the_bits_of_the_whole(grid, camera, chunks, reads):
    # Chunks of four cells, and at the ends of one, three and four; then of three, one and two.
    for side in (4, 3):
        chunks(side)
        del reads[:]
        assert_same_bits(*both(noise(grid), MEDIUM, camera, scheme="first-order"))
        assert len(set(reads)) == np.prod([-(-n // side) for n in SHAPE])


@pytest.mark.parametrize("tolerance", [None, 1e-3])
@pytest.mark.parametrize("camera", ["oblique", "along x", "from inside", "in a vertex"])
def test_chunks_have_the_bits_of_the_whole_on_interpolated_fields(tolerance, camera, chunks):
    chunks(4)
    grid = UNEVEN if camera == "oblique" else UNIFORM
    assert_same_bits(*both(noise(grid), MEDIUM, CAMERAS[camera], tolerance=tolerance))


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
    refused("order", order="back-to-front")
    refused("antialias", antialias="adaptive")
    refused("bounds", bounds=True)
    refused("objects", objects=[vm.Axes()])
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


MEASURED = """
import sys
import numpy as np
import voluminous as vm
from test_confined_walk import CAMERAS as WALKED
from test_confined_walk import SHAPE, UNEVEN, UNIFORM

def peak():  # what getrusage tells includes the parent's
    status = open("/proc/self/status").read().splitlines()
    return int(next(line.split()[1] for line in status if line.startswith("VmHWM"))) << 10

medium = vm.Gaussian("a", 0.5, 0.2, (1, 0.5, 0.2), opacity=0.4, path_length=50)
camera = vm.Orthographic(35, 50, width=900, resolution=200)
small = vm.Volume(vm.CartesianGrid.uniform(8, (0, 1)), a=np.linspace(0, 1, 512).reshape(8, 8, 8))
vm.render(small, medium, camera.replace(width=2), memory="1 GiB")
before = peak()
volume = vm.open(sys.argv[1])
image = vm.render(volume, medium, camera, scheme=sys.argv[2], memory="300 MiB")
assert image.intensity.max() > 0
print(peak() - before)
"""


@pytest.mark.exhaustive
@pytest.mark.skipif(sys.platform != "linux", reason="memory is told by /proc")
@pytest.mark.parametrize("scheme", ["first-order", "post-classified"])
def test_memory_does_not_depend_on_the_volume(tmp_path, scheme):
    # 512 MiB, of which less is in memory at any time than is allowed.
    path = tmp_path / "a.npy"
    array = np.lib.format.open_memmap(path, "w+", np.float32, (512, 512, 512))
    plane = np.random.default_rng(1).uniform(0, 1, (512, 512))
    for k in range(len(array)):
        array[k] = np.roll(plane, k, axis=0)
    del array
    command = [sys.executable, "-c", MEASURED, str(path), scheme]
    told = subprocess.run(command, capture_output=True, text=True, check=True, timeout=500)
    assert int(told.stdout) < 300 << 20
