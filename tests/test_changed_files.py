"""Files that another program changes, cuts short or removes while a volume of them is in use."""

import os
import pickle
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import h5py
import numpy as np
import pytest

import voluminous as vm
from voluminous.io.payload import stored
from voluminous.io.registry import open_lazily

SIDE = 24
GRID = vm.CartesianGrid.uniform(SIDE, (-1, 1))
OLD = np.random.default_rng(1).uniform(0, 1, GRID.shape).astype(np.float32)
NEW = 1 - OLD
MEDIUM = vm.Gaussian("a", 0.5, 0.2, "orange", opacity=0.5, path_length=0.5)
CAMERA = vm.Orthographic(30, 40, width=2.0, resolution=12)
CHANGED = "was changed since it was opened: open it again"


def as_npy(path, values):
    np.save(path, values)


def as_fortran(path, values):
    np.save(path, np.asfortranarray(values))


def as_raw(path, values):
    path.write_bytes(values.tobytes())


def as_native(path, values):
    vm.Volume(GRID, a=values).save(path)


def as_chunks(path, values):
    with h5py.File(path, "w") as file:
        file.create_dataset("a", data=values, chunks=(8, 8, 8))


def as_netcdf(path, values):
    xarray = pytest.importorskip("xarray")
    data = xarray.DataArray(
        values, dims=("x", "y", "z"), coords={k: np.arange(SIDE) for k in "xyz"}
    )
    data.to_dataset(name="a").to_netcdf(path, engine="scipy", format="NETCDF3_64BIT")


RAW = {"shape": GRID.shape, "dtype": "float32", "axes": "xyz"}
FILES = {
    "npy": ("a.npy", as_npy, {}),
    "fortran": ("a.npy", as_fortran, {}),
    "raw": ("a.raw", as_raw, RAW),
    "native": ("a.h5", as_native, {}),
    "chunks": ("a.h5", as_chunks, {}),
    "netcdf": ("a.nc", as_netcdf, {}),
}


@pytest.fixture(params=FILES)
def large(request, tmp_path):
    """Return a file that counts as large, its volume of which nothing is read, and its writer."""
    name, write, options = FILES[request.param]
    path = tmp_path / name
    write(path, OLD)
    volume = open_lazily(path, **options).unread()
    assert volume.waiting == volume.fields
    return path, volume, lambda: write(path, NEW)


def rewrite(path, write):
    write()


def replace(path, write):
    content = path.read_bytes()
    write()
    path.with_suffix(".other").write_bytes(path.read_bytes())
    path.write_bytes(content)
    os.replace(path.with_suffix(".other"), path)


def cut_short(path, write):
    os.truncate(path, path.stat().st_size // 3)


def drawn(volume, **options):
    return vm.render(volume, MEDIUM, CAMERA, scheme="first-order", **options).intensity


@pytest.mark.parametrize("change", [rewrite, replace, cut_short])
def test_a_file_that_was_changed_is_refused(large, change):
    """Whole, in boxes, drawn in pieces, and in other processes, which know when it was opened."""
    path, volume, write = large
    sent = pickle.dumps(volume.unread())
    change(path, write)
    attempts = [
        lambda: volume.array("a"),
        lambda: volume.store.read("a", (0, 8, 8), (8, 16, 16)),
        lambda: drawn(volume, memory="200 MB"),
        lambda: drawn(volume, memory="200 MB", executor=ThreadPoolExecutor(2)),
        lambda: pickle.loads(sent).store.read("a", (0, 8, 8), (8, 16, 16)),
    ]
    for attempt in attempts:
        with pytest.raises(vm.FileFormatError, match=CHANGED) as error:
            attempt()
        assert str(path) in str(error.value)


def test_a_file_that_is_gone_is_named(large):
    path, volume, _ = large
    path.unlink()
    with pytest.raises(vm.FileFormatError, match="was moved or deleted since it was opened"):
        volume.array("a")


def test_what_was_read_stays(large):
    """One volume shows one state of a file: in memory and in pieces, and as films tell it."""
    _, volume, write = large
    before, known = drawn(volume), volume.fingerprint()
    write()
    assert volume.fingerprint() == known
    for options in ({}, {"memory": "200 MB"}):
        np.testing.assert_array_equal(drawn(volume, **options), before)


def test_a_change_while_it_is_drawn_is_noticed(tmp_path):
    """Blocks that were drawn before are old, others would be new: there is no such picture."""
    zarr = pytest.importorskip("zarr", "3")
    vm.Volume(GRID, a=OLD).save(tmp_path / "a.zarr", chunks=8, stats=True)
    volume = open_lazily(tmp_path / "a.zarr")
    told = []

    def progress(done, total):
        if not told:
            zarr.open_group(str(tmp_path / "a.zarr"), mode="r+")["fields/a"][...] = OLD[::-1]
        told.append(done)

    with pytest.raises(vm.FileFormatError, match=CHANGED):
        drawn(volume, memory="200 MB", executor=ThreadPoolExecutor(1), progress=progress)
    assert told


@pytest.mark.parametrize("kind", ["native", 2, 3])
def test_chunks_of_a_store_that_were_changed_are_refused(tmp_path, kind):
    """Those that were not stay readable; another store at the same place is refused as a whole."""
    zarr = pytest.importorskip("zarr", "3")
    path = tmp_path / "a.zarr"

    def write(place):
        if kind == "native":
            vm.Volume(GRID, a=OLD).save(place, chunks=8, levels=True, stats=True)
        else:
            group = zarr.open_group(str(place), mode="w", zarr_format=kind)
            group.create_array("a", data=OLD, chunks=(8, 8, 8))

    write(path)
    volume = open_lazily(path)
    stored_at = zarr.open_group(str(path), mode="r+")["fields/a" if kind == "native" else "a"]
    stored_at[8:16] = NEW[8:16]
    np.testing.assert_array_equal(volume.store.read("a", (0, 0, 0), (8, 9, 9)), OLD[:8, :9, :9])
    with pytest.raises(vm.FileFormatError, match=f"{CHANGED}.*chunk .1, 0, 0"):
        volume.store.read("a", (0, 0, 0), (24, 24, 24))
    with pytest.raises(vm.FileFormatError, match=CHANGED):
        volume.array("a")
    again = open_lazily(path)
    write(tmp_path / "b.zarr")
    path.rename(tmp_path / "old.zarr")
    (tmp_path / "b.zarr").rename(path)
    with pytest.raises(vm.FileFormatError, match=CHANGED):
        again.store.read("a", (0, 0, 0), (8, 8, 8))


def test_the_numbers_that_a_header_names(tmp_path):
    vm.radmc3d.write(
        vm.Volume(vm.CartesianGrid.uniform(4, (0, 1), unit="cm"), a=np.ones((4, 4, 4))),
        tmp_path,
        {"dust_density": "a"},
        binary=True,
    )
    volume = open_lazily(tmp_path)
    (tmp_path / "image.out").write_text("what RADMC-3D writes beside it is no matter")
    assert volume.array("dust_density").sum() == 64
    volume = open_lazily(tmp_path)
    file = tmp_path / "dust_density.binp"
    content = file.read_bytes()
    file.write_bytes(content[:-8] + np.float64(2).tobytes())
    with pytest.raises(vm.FileFormatError, match=f"dust_density.binp {CHANGED}"):
        volume.array("dust_density")


DIES = """
import os, sys, threading, time
import numpy as np
import voluminous as vm
from voluminous.io.registry import open_lazily

path, stop = sys.argv[1], time.time() + 3
content = open(path, "rb").read()

def damage():
    while time.time() < stop:
        os.truncate(path, 4096)
        open(path, "r+b").write(content)

threading.Thread(target=damage).start()
while time.time() < stop:
    try:
        volume = open_lazily(path)
        volume.array(volume.fields[0]).sum()
        volume.store.read(volume.fields[0], (0, 0, 0), (9, 9, 9)).sum()
    except vm.InputError:
        pass
print("alive")
"""


@pytest.mark.exhaustive
@pytest.mark.parametrize("kind", ["npy", "native", "netcdf", "fits", "mrc", "nii"])
def test_no_process_dies_of_a_file_that_is_cut_short(tmp_path, kind):
    """Pages of a mapped file that are no longer there would end it (SIGBUS)."""
    if kind in FILES:
        name, write, _ = FILES[kind]
        write(path := tmp_path / name, OLD)
    elif kind == "fits":
        vm.Volume(GRID, a=OLD).save(path := tmp_path / "a.fits")
    elif kind == "mrc":
        mrcfile = pytest.importorskip("mrcfile")
        path = tmp_path / "a.mrc"
        with mrcfile.new(path) as file:
            file.set_data(OLD)
    else:
        pytest.importorskip("nibabel")
        vm.Volume(GRID, a=OLD).save(path := tmp_path / "a.nii")
    ended = subprocess.run([sys.executable, "-c", DIES, path], capture_output=True, text=True)
    assert (ended.returncode, ended.stdout) == (0, "alive\n"), ended.stderr


@pytest.mark.parametrize("shape", [(5, 6, 7), (40,), (3, 1, 4, 5), (2, 3, 20000)])
def test_parts_of_stored_numbers(tmp_path, shape):
    """Rows are read with what is between them, or, where they are long, one by one."""
    rng = np.random.default_rng(3)
    values = rng.integers(0, 1 << 30, shape).astype(">i4")
    (tmp_path / "a").write_bytes(b"head" + values.tobytes() + b"end")
    for _ in range(40):
        ends = [sorted(rng.integers(0, n + 1, 2).tolist()) for n in shape]
        index = tuple(
            int(rng.integers(n))
            if rng.random() < 0.2
            else slice(*e)
            if rng.random() < 0.7
            else slice(None)
            for n, e in zip(shape, ends, strict=True)
        )
        part = stored(tmp_path / "a", 4, shape, values.dtype, index)
        np.testing.assert_array_equal(part, values[index])
