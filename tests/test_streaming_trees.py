"""Octrees and patches drawn part by part: the bits of the whole, in any order of the parts."""

from __future__ import annotations

import itertools
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import voluminous as vm
from test_io_native import patches
from test_octree import random_octree
from test_streaming import MEDIUM, assert_same_bits, both, reads
from voluminous.backend import get_backend
from voluminous.errors import InputError, MemoryNeededError
from voluminous.grids.trees.ghosts import LeavesWithGhosts
from voluminous.io.registry import open_lazily
from voluminous.large.chunks import CartesianChunks
from voluminous.rendering.sources.corner_layouts import lattices_of, lattices_of_leaves

__all__ = ["reads"]

FIRST = {"scheme": "first-order"}


@pytest.fixture
def chunks(monkeypatch):
    """Make parts of so many cells at most, the third power of a number."""

    def make(side):
        monkeypatch.setattr("voluminous.store.FieldStore.leaves", side**3)
        monkeypatch.setattr("voluminous.large.view.VolumeView.widest", side)

    return make


def pinwheel():
    """Return three boxes around a corner, each of which hides a part of the next."""
    lower = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]])
    upper = lower + np.array([[2, 1, 1], [1, 2, 1], [1, 1, 2]])
    return vm.PatchGrid(lower, upper, [[8, 4, 2], [4, 8, 2], [4, 4, 4]])


def holes():
    """Return patches with space between them, and a finer one that lies in two of them."""
    lower = [[0, 0, 0], [4, 0, 0], [9, 1, 1], [2, 1, 1]]
    upper = [[4, 4, 4], [7, 4, 4], [11, 3, 4], [5, 3, 3]]
    return vm.PatchGrid(lower, upper, [[4, 4, 4], [3, 4, 4], [2, 2, 3], [6, 4, 4]])


UNEVEN = ((0, 0.7, 2), (0, 1, 1.3, 3), (-1, 0, 1.5))
GRIDS = {
    "octree": random_octree(1, 4),
    "uneven octree": random_octree(2, 4, edges=UNEVEN),
    "patches": patches(np.random.default_rng(0)),
    "pinwheel": pinwheel(),
    "holes": holes(),
}


def cameras(grid):
    """Return cameras of all kinds, some inside."""
    middle, width = grid.bounds.mean(axis=1), np.ptp(grid.bounds, axis=1).max()
    options = {"center": middle, "width": 1.8 * width, "resolution": 20}
    inside, ahead = middle + 0.02 * width, middle + np.array([1, 1, 0.3])
    outside = middle + width * np.array([2, 1, 1])
    return {
        "oblique": vm.Orthographic(35, 50, 20, **options),
        "from below": vm.Orthographic(145, 230, **options),
        "along z": vm.Orthographic(0, 0, **options),
        "along the diagonal": vm.Orthographic(np.degrees(np.arccos(3**-0.5)), 45, **options),
        "from outside": vm.Perspective(outside, middle, 50, resolution=20),
        "from inside": vm.Perspective(inside, ahead, 80, resolution=20),
        "in a corner": vm.Perspective(grid.bounds[:, 0], middle, 80, resolution=20),
        "all around": vm.Panorama(inside, ahead, resolution=(24, 12)),
    }


def noise(grid, seed=5):
    """Return a volume of values from 0 to 1 in which nothing is invisible."""
    values = np.random.default_rng(seed).uniform(0, 1, grid.size).astype(np.float32)
    values[0], values[-1] = 0, 1
    return vm.Volume(grid, a=values)


@pytest.mark.parametrize("name", GRIDS)
def test_parts_have_the_bits_of_the_whole(name, chunks, reads):
    chunks(3 if name != "pinwheel" else 4)  # whole patches hide each other in turn
    volume = noise(GRIDS[name])
    for camera in cameras(volume.grid).values():
        del reads[:]
        assert_same_bits(*both(volume, MEDIUM, camera, **FIRST))
        if "octree" in name:  # rays come to each part once
            ranges = -(-volume.grid.size // 27)
            assert len(reads[ranges:]) == len(set(reads[ranges:]))


@pytest.mark.parametrize("count", [20, pytest.param(400, marks=pytest.mark.exhaustive)])
def test_patches_that_hide_each_other_in_turn(count, chunks):
    """In a quarter of all directions no order of the three boxes is right."""
    chunks(4)
    volume, (first, second) = noise(pinwheel()), np.random.default_rng(0).random((2, count))
    for u, v in zip(first, second, strict=True):
        incl, phi = np.degrees(np.arccos(2 * u - 1)), 360 * v
        camera = vm.Orthographic(incl, phi, center=(1, 1, 1), width=4, resolution=16)
        assert_same_bits(*both(volume, MEDIUM, camera, **FIRST))


@pytest.mark.parametrize("name", GRIDS)
def test_parts_have_the_bits_of_the_whole_on_interpolated_fields(name, chunks):
    """Vertices of parts, hanging ones too, have the values that they have in the whole."""
    chunks(5 if "octree" in name else 4)
    volume = noise(GRIDS[name])
    seen = cameras(volume.grid)
    for camera, tolerance in (("oblique", 1e-3), ("from inside", None)):
        assert_same_bits(*both(volume, MEDIUM, seen[camera], tolerance=tolerance))


@pytest.mark.parametrize("name", GRIDS)
def test_corner_values_of_parts_are_those_of_the_whole(name):
    grid, backend = GRIDS[name], get_backend("cpu")
    values = np.random.default_rng(1).random(grid.size, np.float32)
    (whole,) = lattices_of(grid, [values], backend)
    whole = np.asarray(whole.data).reshape(-1, 8)
    for most in (1, 40):
        parts = grid.parts(most)
        for first, last in list(itertools.pairwise(parts.ends.tolist()))[::9]:
            leaves = LeavesWithGhosts(grid, first, last)
            assert len(leaves.ghosts) < grid.size - leaves.own
            assert leaves.size == len(leaves.levels) == sum(leaves.cells_per_level)
            numbers = np.concatenate([np.arange(first, last), leaves.ghosts])
            expected = np.array(grid.boxes(0, grid.size))[..., numbers]
            np.testing.assert_array_equal(leaves.boxes(0, leaves.size), expected)
            near = np.concatenate([values[first:last], values[leaves.ghosts]])
            (found,) = lattices_of_leaves(leaves, [near], [1.0], backend)
            found = np.asarray(found.data).reshape(-1, 8)[: leaves.own]
            np.testing.assert_array_equal(found, whole[first:last])


def test_media_fields_and_samples(chunks):
    chunks(4)
    volume = noise(GRIDS["uneven octree"])
    camera = cameras(volume.grid)["oblique"]
    volume["n"] = np.arange(volume.grid.size) % 200
    several = vm.Gaussian("a + 0.1*z", 0.5, 0.2, "gold", 0.5, path_length=1) + vm.Gaussian(
        "n * r", 100, 50, "red", 0.5, path_length=1
    )
    for resolution in (20, 200):  # the medium on the ray, and in a table
        assert_same_bits(*both(volume, several, camera.replace(resolution=resolution), **FIRST))
    assert_same_bits(*both(volume, several, camera, tolerance=None))
    many = vm.Coefficients([f"a**{k % 5}" for k in range(20)], "a")
    assert_same_bits(*both(volume, many, camera, **FIRST))
    for axis in "xyz":
        volume[f"v_{axis}"] = np.random.default_rng(ord(axis)).normal(size=volume.grid.size)
    towards = vm.Gaussian("los(v) + norm(v)", 1, 0.5, "red", 0.5, path_length=1)
    assert_same_bits(*both(volume, towards, camera, **FIRST))
    gone = vm.Volume(volume.grid, a=np.where(volume["n"] % 9 == 4, np.nan, volume["a"]))
    assert_same_bits(*both(gone, MEDIUM, camera, **FIRST))
    whole, parts = both(volume, MEDIUM, camera, samples=2, background=0.1, **FIRST)
    np.testing.assert_array_equal(parts.intensity, whole.intensity)
    whole, parts = both(volume, MEDIUM, camera, precision="double", **FIRST)
    np.testing.assert_allclose(parts.intensity, whole.intensity, rtol=0, atol=1e-14)


def test_only_parts_that_show_something_and_are_not_hidden_are_read(tmp_path, reads):
    grid = vm.OctreeGrid(*[np.linspace(-1, 1, 5)] * 3, [1, *[0] * 8] * 64)
    values = np.zeros(grid.size, np.float32)
    values[40:48] = 1.0
    vm.Volume(grid, a=values).save(path := tmp_path / "a.zarr", stats=True, chunks=16)
    blob = vm.Gaussian("a", 1.0, 0.05, (1, 1, 1), opacity=2, path_length=0.5)
    camera = vm.Orthographic(35, 50, width=4, resolution=24)
    volume = open_lazily(path)

    def drawn(medium, **options):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("voluminous.large.view.VolumeView.widest", 2)
            del reads[:]
            return vm.render(volume, medium, camera, memory="1 GiB", **FIRST, **options)

    image = drawn(blob)
    assert reads == [((32,), (48,))]
    assert volume.waiting == ("a",)
    assert image.intensity.max() > 0.1
    np.testing.assert_array_equal(
        image.intensity, vm.render(open_lazily(path), blob, camera, **FIRST).intensity
    )
    opaque = vm.Gaussian("0*a", 0, 1, (1, 1, 1), opacity=1000, path_length=0.01)
    told = []
    drawn(opaque, progress=lambda done, total: told.append((done, total)))
    assert len(reads) < 24  # of 32: those at the back are not read
    assert told[-1] == (grid.size, grid.size)
    done = [cells for cells, total in told if total == grid.size]
    assert done == sorted(done)


def test_a_pixel_is_probed_part_by_part(chunks):
    chunks(4)
    volume = noise(GRIDS["uneven octree"])
    camera = cameras(volume.grid)["oblique"]
    whole, parts = (
        vm.probe(volume, MEDIUM, camera, (10, 10), memory=memory) for memory in (None, "1 GiB")
    )
    np.testing.assert_array_equal(parts.intensity, whole.intensity)
    np.testing.assert_array_equal(parts.cell, whole.cell)


def test_what_cannot_be_drawn_in_parts_is_refused():
    volume = noise(GRIDS["octree"])
    camera = cameras(volume.grid)["oblique"]
    for scheme in ("second-order", "olson-kunasz"):
        with pytest.raises(InputError, match=r"post-classified.*pre-integrated.*first-order"):
            vm.render(volume, MEDIUM, camera, scheme=scheme, memory="1 GiB")
    with pytest.raises(MemoryNeededError, match="chunks of 873 cells"):
        vm.render(volume, MEDIUM, camera, memory="20 MB", **FIRST)
    refined = vm.SphericalGrid([0, 1], [0, np.pi], [0, 3, 6], refined=2 * [1, *[0] * 4])
    gone = vm.Volume(volume.grid, a=np.where(np.arange(volume.grid.size) == 5, np.nan, 1.0))
    with pytest.raises(InputError, match="missing values, which memory= cannot interpolate"):
        vm.render(gone, MEDIUM, camera, memory="1 GiB")
    with pytest.raises(InputError, match="octrees and patches part by part"):
        vm.render(vm.Volume(refined, a=np.ones(refined.size)), MEDIUM, memory="1 GiB")


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None)
def test_rays_come_to_parts_of_an_octree_in_their_order(seed):
    rng = np.random.default_rng(seed)
    grid = random_octree(seed % 10, 4, edges=UNEVEN)
    parts = grid.parts(int(rng.integers(1, 60)))
    low, high = grid.corners()
    for k, (a, b) in enumerate(itertools.pairwise(parts.ends)):
        np.testing.assert_array_equal(low[:, a:b].min(axis=1), parts.low[k])
        np.testing.assert_array_equal(high[:, a:b].max(axis=1), parts.high[k])
    origin, direction = rng.uniform(-1, 3, 3), rng.normal(size=3)
    ranks = np.empty((2, len(parts.low)), int)
    ranks[0, parts.front_to_back(origin, None)] = np.arange(len(parts.low))
    ranks[1, parts.front_to_back(np.zeros(3), direction)] = np.arange(len(parts.low))
    t = np.sort(rng.uniform(0, 4, 500))
    for rank, starts, ways in (
        (ranks[0], np.repeat(origin[None], 20, 0), rng.normal(size=(20, 3))),
        (ranks[1], rng.uniform(-1, 3, (20, 3)), np.repeat(direction[None], 20, 0)),
    ):
        for start, way in zip(starts, ways, strict=True):
            cell = grid.locate(start + t[:, None] * way)
            part = np.searchsorted(parts.ends, cell[cell >= 0], "right") - 1
            assert np.all(np.diff(rank[part]) >= 0)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=50, deadline=None)
def test_shells_of_chunks_have_keys_that_increase_along_rays(seed):
    """Along any ray the Manhattan distance of the chunk, from the ray's first, grows by one."""
    rng = np.random.default_rng(seed)
    counts = rng.integers(1, 9, 3)
    walls = [np.sort(rng.uniform(-1, 1, n + 1)) for n in counts]
    origin = rng.uniform(-2, 2, 3)
    center = [int(np.searchsorted(w, o, "right")) - 1 for w, o in zip(walls, origin, strict=True)]
    # All walls that 20 000 rays meet, in the order in which they meet them.
    ways, axes = rng.normal(size=(20000, 3)), list(enumerate(zip(walls, origin, strict=True)))
    planes = np.concatenate([(w - o)[:, None] / ways[:, a] for a, (w, o) in axes])
    planes = np.sort(np.where(planes > 0, planes, np.inf), axis=0)
    with np.errstate(invalid="ignore"):
        middles, apart = 0.5 * (planes[1:] + planes[:-1]), np.diff(planes, axis=0) > 1e-12
        places = [o + middles * ways[:, a] for a, (_, o) in axes]
    index = np.stack([np.searchsorted(w, places[a], "right") - 1 for a, (w, _) in axes])
    inside = np.all((index >= 0) & (index < counts[:, None, None]), axis=0) & apart
    inside &= np.isfinite(middles)
    key = np.abs(index - np.reshape(center, (3, 1, 1))).sum(axis=0)
    assert np.all(np.diff(key, axis=0)[inside[1:] & inside[:-1]] == 1)
    # The order in which blocks are drawn is that of the keys.
    pieces = object.__new__(CartesianChunks)
    pieces.grid = vm.CartesianGrid(*walls)
    pieces.walls, pieces.side, pieces.dual = walls, (1, 1, 1), False
    boxes = pieces.blocks(False, np.stack([origin, origin], axis=-1), np.zeros(3))
    keys = [sum(abs(i - c) for i, c in zip(box.low, center, strict=True)) for box in boxes]
    assert keys == sorted(keys)
    assert len(keys) == counts.prod()


@pytest.mark.parametrize("name", ["uneven octree", "pinwheel"])
def test_parts_are_drawn_by_others(name, tmp_path, monkeypatch):
    """Blocks wait for those in front; rays that come to one again are drawn in another sweep."""
    monkeypatch.setattr("voluminous.large.view.VolumeView.widest", 4)
    monkeypatch.setattr("voluminous.large.chunks.CartesianChunks.most_tasks", 8)
    noise(GRIDS[name]).save(tmp_path / "a.zarr", stats=True, chunks=64)
    camera = cameras(GRIDS[name])["oblique"]
    volume = open_lazily(tmp_path / "a.zarr")
    with ThreadPoolExecutor(2) as executor:
        parts = vm.render(volume, MEDIUM, camera, executor=executor, **FIRST)
        kept = vm.render(volume, MEDIUM, camera, checkpoint=tmp_path / "kept", **FIRST)
        assert volume.waiting == ("a",)
    whole = vm.render(volume, MEDIUM, camera, **FIRST)
    assert_same_bits(whole, parts)
    assert_same_bits(whole, kept)
