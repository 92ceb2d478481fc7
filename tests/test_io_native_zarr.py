"""Volumes saved as Zarr: the same bits come back; levels, statistics and rounded numbers."""

from __future__ import annotations

import itertools
import shutil
import subprocess
import sys

import h5py
import numpy as np
import pytest
from astropy.wcs import WCS

import voluminous as vm
from contracts import ReaderContract
from test_io_native import DTYPES, GRIDS, META, UNITS, assert_same, edges
from voluminous.cli import main
from voluminous.io.native.zarr import rounded
from voluminous.io.registry import open_lazily
from voluminous.store import means

zarr = pytest.importorskip("zarr", "3")


def volume_of(rng, shape=None):
    """Fields of all types and any bits, NaN among them."""
    walls = [edges(rng) if shape is None else np.arange(shape[a] + 1.0) for a in range(3)]
    volume = vm.Volume(vm.CartesianGrid(*walls, unit="0.5 kpc"))
    for k, dtype in enumerate(DTYPES):
        size = np.dtype(dtype).itemsize
        bits = rng.integers(0, 256, (volume.grid.size, size), np.uint8)
        values = bits.view(dtype) if dtype != "?" else bits > 99
        volume[f"f_{dtype.replace('?', 'bool')}"] = values.reshape(volume.grid.shape)
        volume.set_unit(volume.fields[-1], UNITS[k % len(UNITS)])
    volume.meta.update(META)
    return volume


@pytest.mark.parametrize("options", [{}, {"levels": True, "stats": True, "chunks": 2}])
def test_what_was_saved_comes_back_bit_for_bit(tmp_path, options):
    for seed in range(3):
        volume, path = volume_of(np.random.default_rng(seed)), tmp_path / f"{seed}.zarr"
        with np.errstate(all="ignore"):  # any bits overflow
            volume.save(path, **options)
        assert_same(vm.open(path), volume)
        lazy = open_lazily(shutil.make_archive(str(path), "zip", path))
        assert lazy.waiting == volume.fields
        assert_same(lazy, volume)


def test_curved_grids_and_the_sky_come_back(tmp_path):
    grid = vm.SphericalGrid(
        [1, 2, 4], [0, 1, np.pi / 2], [0, 1, 2, 2 * np.pi], mirror=True, unit="au"
    )
    volume = vm.Volume(grid, rho=np.arange(12.0).reshape(2, 2, 3))
    volume.save(tmp_path / "a.zarr")
    assert_same(vm.open(tmp_path / "a.zarr"), volume)
    cube = vm.models.sphere(4)
    cube.wcs = WCS(naxis=3)
    cube.wcs.wcs.ctype, cube.wcs.wcs.cdelt = ["RA---TAN", "DEC--TAN", "VELO"], [-1e-3, 1 / 3, 1e3]
    cube.save(tmp_path / "b.zarr")
    again = vm.open(tmp_path / "b.zarr").wcs
    assert again.wcs.cdelt.tolist() == cube.wcs.wcs.cdelt.tolist()


@pytest.mark.parametrize("shape", [(21, 8, 5), (4, 4, 4), (5, 33, 1)])
def test_levels_and_statistics(tmp_path, shape):
    """Means of means; ranges of the cells below, whatever the level."""
    values = np.random.default_rng(0).normal(size=shape).astype("f4")
    values[-1, 0, 0] = np.nan
    volume = vm.Volume(vm.CartesianGrid.uniform(shape, (0, 1)), rho=values, n=np.ones(shape, "u1"))
    volume.save(tmp_path / "a.zarr", levels=True, stats=True, chunks=(4, 8, 4))
    store = open_lazily(tmp_path / "a.zarr").store
    assert store.chunks == tuple(min(n, c) for n, c in zip(shape, (4, 8, 4), strict=True))
    level = values
    for k in range(store.levels):
        assert store.shape(k) == level.shape
        read = store.read("rho", (0, 0, 0), level.shape, k)
        # Stored means of means are of single precision.
        np.testing.assert_allclose(read, level, rtol=1e-5, atol=1e-6)
        assert (store.read("n", (0, 0, 0), level.shape, k) == 1).all()
        table = store.extremes("rho", k)
        numbers = [range(-(-n // c)) for n, c in zip(level.shape, store.chunks, strict=True)]
        assert table.shape == (*map(len, numbers), 2)
        for index in itertools.product(*numbers):
            sides = [c << k for c in store.chunks]
            low = [i * side for i, side in zip(index, sides, strict=True)]
            high = [a + side for a, side in zip(low, sides, strict=True)]
            part = values[tuple(map(slice, low, high))]
            np.testing.assert_array_equal(table[index], [part.min(), part.max()])
        level = means(values, (2 << k,) * 3)
    assert all(n <= c for n, c in zip(store.shape(store.levels - 1), (4, 8, 4), strict=True))


@pytest.mark.parametrize("dtype", ["f4", "f8"])
@pytest.mark.parametrize("bits", [1, 10, 22])
def test_rounding(dtype, bits):
    rng = np.random.default_rng(bits)
    values = (rng.normal(size=9999) * 10.0 ** rng.integers(-30, 30, 9999)).astype(dtype)
    result = rounded(values, bits)
    assert np.all(abs(result - values) <= abs(values) * 2.0 ** -(bits + 1))
    np.testing.assert_array_equal(rounded(result, bits), result)
    mantissas = np.frexp(result)[0] * 2.0 ** (bits + 1)
    np.testing.assert_array_equal(mantissas, np.rint(mantissas))
    # Half of the last bit: to even.
    half = 2.0 ** -(bits + 1)
    odd = np.array([1 + half, 1 + 3 * half], dtype)
    np.testing.assert_array_equal(rounded(odd, bits), [1, 1 + 4 * half])
    info = np.finfo(dtype)
    special = np.array([np.nan, np.inf, -np.inf, 0.0, -0.0, info.max, -info.max], dtype)
    assert rounded(special, bits).tobytes() == special.tobytes()


def test_rounded_numbers_are_what_levels_and_statistics_tell_of(tmp_path):
    rho = np.random.default_rng(1).random((8, 8, 8), np.float32)
    volume = vm.Volume(
        vm.CartesianGrid.uniform(8, (0, 1)), rho=rho, n=np.arange(512).reshape(8, 8, 8)
    )
    volume.save(tmp_path / "a.zarr", levels=True, stats=True, keep_bits=4, chunks=4)
    again = vm.open(tmp_path / "a.zarr")
    kept = again.array("rho")
    np.testing.assert_array_equal(kept, rounded(rho, 4))
    np.testing.assert_array_equal(again.array("n"), volume.array("n"))
    np.testing.assert_array_equal(
        again.store.read("rho", (0, 0, 0), (4, 4, 4), 1), rounded(means(kept, (2, 2, 2)), 4)
    )
    assert again.store.extremes("rho")[..., 0].min() == kept.min()


def test_what_is_lost_or_damaged_is_missed(tmp_path):
    path = tmp_path / "a.zarr"
    volume = vm.Volume(vm.CartesianGrid.uniform(8, (0, 1)), n=np.ones((8, 8, 8), int))
    volume.save(path, chunks=4, stats=True, levels=True)
    store = open_lazily(path).store
    reads = {
        "fields/n/c/0/1/0": lambda: store.read("n", (0, 0, 0), (4, 8, 4)),
        "levels/1/n/c/0/0/0": lambda: store.read("n", (0, 0, 0), (2, 2, 2), 1),
        "stats/n/c/0/0/0/0": lambda: store.extremes("n"),
    }
    for place, read in reads.items():
        piece, where = path / place, rf"a\.zarr: /{place.split('/c/')[0]}\[.*\]: "
        content = piece.read_bytes()
        for size in (0, 5, 20, len(content) - 1):
            piece.write_bytes(content[:size])
            with pytest.raises(vm.FileFormatError, match=where):
                read()
        piece.unlink()
        with pytest.raises(vm.FileFormatError, match=where + r"the chunk \(0, .*\) is missing"):
            read()
    assert store.without_ranges().read("n", (4, 4, 4), (8, 8, 8)).all()
    # The root tells of all arrays, so that a server need not be asked for each.
    for group in ("stats", "fields"):
        shutil.rmtree(path / group)
        with pytest.raises(vm.FileFormatError, match=rf"a\.zarr: /{group}/n.*is missing"):
            open_lazily(path).store.extremes("n") if group == "stats" else vm.open(path)
    volume.save(tmp_path / "b.zarr")
    assert open_lazily(tmp_path / "b.zarr").store.extremes("n") is None


def test_nothing_unfinished_is_left(tmp_path, monkeypatch):
    volume = vm.models.sphere(8)

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("voluminous.io.native.zarr.rounded", full)
    with pytest.raises(vm.InputError, match="no space left"):
        volume.save(tmp_path / "a.zarr")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"keep_bits": 0}, "keep_bits must be a number from 1 to 52, got 0"),
        ({"keep_bits": "10"}, "keep_bits must be"),
        ({"keep_bits": True}, "keep_bits must be"),
        ({"chunks": (4, 4)}, r"chunks must be a number of cells, or three, got \(4, 4\)"),
        ({"chunks": 5, "levels": True}, "chunks must be even where there are levels, got 5"),
        ({"level": True}, "did you mean 'levels'"),
    ],
)
def test_wrong_options(tmp_path, options, message):
    with pytest.raises(vm.errors.VoluminousError, match=message):
        vm.models.sphere(8).save(tmp_path / "a.zarr", **options)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("kind", [kind for kind in GRIDS if kind != "cartesian"])
def test_any_grid_comes_back_in_pieces(tmp_path, kind):
    for seed in range(2):
        rng = np.random.default_rng(seed)
        grid = GRIDS[kind](rng)
        volume = vm.Volume(grid, a=rng.random(grid.shape), b=rng.integers(0, 9, grid.shape))
        volume.meta.update(META)
        volume.save(path := tmp_path / f"{seed}.zarr", stats=True, chunks=7)
        again = open_lazily(path)
        assert again.waiting == volume.fields
        axes = len(grid.shape)
        assert again.store.chunks == tuple(min(7, n) for n in grid.shape)
        low = [n // 2 for n in grid.shape]
        part = volume.array("a")[tuple(slice(a, None) for a in low)]
        np.testing.assert_array_equal(again.store.read("a", low, grid.shape), part)
        first = tuple(slice(0, 7) for _ in range(axes))
        ends = [end(volume.array("b")[first]) for end in (np.min, np.max)]
        assert again.store.extremes("b")[(0,) * axes].tolist() == ends
        assert_same(again, volume)


def test_refined_grids_have_no_coarser_levels(tmp_path):
    tree = vm.Volume(vm.OctreeGrid([0, 1], [0, 1], [0, 1], [1, *[0] * 8]), rho=np.ones(8))
    with pytest.raises(vm.InputError, match="leave out levels"):
        tree.save(tmp_path / "a.zarr", levels=True)
    with pytest.raises(vm.InputError, match=r"chunks must be a number of cells, got \(2, 2, 2\)"):
        tree.save(tmp_path / "a.zarr", chunks=(2, 2, 2))
    tree.save(tmp_path / "a.zarr")
    assert open_lazily(tmp_path / "a.zarr").store.chunks == (8,)


def test_conversion_never_holds_the_whole(tmp_path, capsys, monkeypatch):
    """From HDF5 in pieces, on the command line; the file is never read whole."""
    rho = np.random.default_rng(0).random((20, 12, 8), np.float32)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("rho", data=rho, chunks=(5, 4, 3))
    source, target = str(tmp_path / "a.h5"), str(tmp_path / "b.zarr")
    options = ["--levels", "--stats", "--keep-bits", "10", "--chunks", "4"]
    with monkeypatch.context() as patch:
        patch.setattr("voluminous.volume.checked_array", lambda *_: pytest.fail("read whole"))
        assert main(["convert", source, target, *options, "--set", "spacing=2"]) == 0
    assert "a volume saved by voluminous (Zarr)" in capsys.readouterr().out
    volume = open_lazily(target)
    assert volume.grid.bounds.tolist() == [[0, 40], [0, 24], [0, 16]]
    assert volume.store.levels == 4
    np.testing.assert_array_equal(volume.array("rho"), rounded(rho, 10))
    assert main(["convert", source, str(tmp_path / "c.npz"), "--levels"]) == 2
    assert "--levels: the format npz has no such option" in capsys.readouterr().err


@pytest.mark.exhaustive
def test_conversion_takes_the_memory_of_a_few_chunks(tmp_path):
    """1024³ numbers, 4 GiB (an HDF5 file of chunks that were never written is small)."""
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("rho", shape=(1024,) * 3, dtype="f4", chunks=(64,) * 3)
    program = (
        "import resource, sys; from voluminous.cli import main; assert main(sys.argv[1:]) == 0;"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)"
    )
    words = ["convert", "a.h5", "b.zarr", "-q", "--levels", "--stats", "--keep-bits", "10"]
    command = [sys.executable, "-c", program, *words]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    # The process takes 120 MiB, a chunk 8 and its means 32 of temporary numbers.
    assert int(result.stdout) < 400 << 10
    assert open_lazily(tmp_path / "b.zarr").store.levels == 4


class TestSaved(ReaderContract):
    @pytest.fixture
    def sample(self):
        def write(directory):
            volume = vm.Volume(vm.CartesianGrid.uniform(4, (0, 1)), a=np.ones((4, 4, 4)))
            volume["b"] = np.arange(64, dtype="i4").reshape(4, 4, 4)
            volume.set_unit("b", "K")
            volume.save(directory / "a.zarr", levels=True, stats=True, chunks=2)
            return directory / "a.zarr"

        return write

    def victims(self, path):
        """Return the root's description, and the chunks of edges and of a field.

        The root tells what their descriptions tell.
        """
        parts = [path / "grid" / "x", path / "fields" / "a"]
        inside = (p for part in parts for p in sorted(part.rglob("c/*")) if p.is_file())
        return [path / "zarr.json", *inside]
