"""Volumes in pieces: boxes are what the whole field has there, whatever they are read from."""

from __future__ import annotations

import pickle
import subprocess
import sys

import h5py
import numpy as np
import pytest

import voluminous as vm
from voluminous.deferred import Deferred, Pieces
from voluminous.io.registry import open_lazily
from voluminous.store import level_factors, means

RNG = np.random.default_rng(3)
SHAPE = (9, 6, 5)
RHO = RNG.random(SHAPE, np.float32)


def assert_boxes(store, name, field):
    """Any box is the part of the field, in C order and of its type."""
    assert store.shape(0) == field.shape
    for _ in range(20):
        low = [int(RNG.integers(0, n)) for n in field.shape]
        high = [int(RNG.integers(a + 1, n + 1)) for a, n in zip(low, field.shape, strict=True)]
        box = store.read(name, low, high)
        assert box.flags.c_contiguous
        assert box.dtype == field.dtype
        np.testing.assert_array_equal(box, field[tuple(map(slice, low, high))])


def test_arrays_are_sliced():
    volume = vm.Volume(
        vm.CartesianGrid.uniform((200, 3, 2), (0, 1)), n=np.arange(1200).reshape(200, 3, 2)
    )
    store = volume.store
    assert (store.chunks, store.levels) == ((128, 3, 2), 1)
    assert store.extremes("n") is None
    assert_boxes(store, "n", volume.array("n"))


def test_pieces_are_read_and_fields_that_are_set_stand_beside_them(tmp_path):
    asked, coarse = [], means(RHO, (2, 2, 1))

    def read(low, high, level):
        asked.append((tuple(low), tuple(high), level))
        return (RHO, coarse)[level][tuple(map(slice, low, high))]

    volume = vm.Volume(vm.CartesianGrid.uniform(SHAPE, (0, 1)))
    parts = [[RHO[:8, :, :4], RHO[:8, :, 4:]], [RHO[8:, :, :4], RHO[8:, :, 4:]]]
    table = np.array([[[[p.min(), p.max()] for p in row]] for row in parts])
    pieces = Pieces(read, (8, 6, 4), (coarse.shape,), lambda: table)
    whole = Deferred(lambda: pytest.fail("the whole field is read"), "f4", "g", pieces=pieces)
    volume["rho"] = whole
    volume["half"] = RHO / 2
    store = volume.store
    assert (store.chunks, store.levels, store.shape(1)) == ((8, 6, 4), 2, (5, 3, 5))
    assert_boxes(store, "rho", RHO)
    asked.clear()
    np.testing.assert_array_equal(store.read("rho", (0, 0, 0), (5, 3, 5), 1), coarse)
    assert asked == [((0, 0, 0), (5, 3, 5), 1)]
    # The means of halves are the halves of means: powers of two.
    np.testing.assert_array_equal(store.read("half", (2, 1, 0), (5, 3, 5), 1), coarse[2:, 1:] / 2)
    assert store.extremes("rho").shape == (2, 1, 2, 2)
    np.testing.assert_array_equal(store.extremes("rho", 1)[0, 0, 0], [table.min(), table.max()])
    assert store.extremes("half") is None
    assert volume.waiting == ("rho",)


@pytest.mark.parametrize("dtype", ["<f4", ">f8", "<f2", "?", ">u2"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_boxes_of_numpy_files(tmp_path, dtype, order):
    values = np.asarray(100 * RHO, dtype, order=order)
    np.save(tmp_path / "rho.npy", values)
    volume = vm.open(tmp_path / "rho.npy")
    assert_boxes(volume.store, "rho", volume.array("rho"))


def as_hdf5(path):
    """Write arrays with z first, y running down, a vector, and pieces of (2, 3, 4)."""
    with h5py.File(path, "w") as file:
        turned = RHO.T[:, ::-1]
        item = file.create_dataset("rho", data=turned, chunks=(2, 3, 4), compression="gzip")
        for axis, (name, n) in enumerate(zip("zyx", turned.shape, strict=True)):
            file[name] = np.arange(n)[:: -1 if name == "y" else 1] + 0.5
            file[name].make_scale(name)
            item.dims[axis].attach_scale(file[name])
        file.create_dataset("B", data=[-turned, turned, 2 * turned], chunks=(3, 2, 3, 4))
    return {"fields": {"rho": "rho", "B_y": "B_y"}, "axes": "zyx"}


def as_matlab(path):
    with h5py.File(path, "w", userblock_size=512) as file:
        file.create_dataset("rho", data=RHO.T, chunks=(2, 3, 4))
    with open(path, "r+b") as start:
        start.write(b"MATLAB 7.3 MAT-file")
    return {}


def as_zarr(path, version=3):
    zarr = pytest.importorskip("zarr", "3")
    group = zarr.open_group(str(path), mode="w", zarr_format=version)
    group.create_array("gas/rho", shape=SHAPE, dtype="f4", chunks=(4, 3, 2))[...] = RHO
    return {}


def as_labelled_zarr(path):
    pytest.importorskip("zarr", "3")
    xr = pytest.importorskip("xarray")
    down = {"z": ("z", -np.arange(5.0)), "y": np.arange(6.0), "x": np.arange(9.0)}
    data = xr.Dataset({"rho": (("t", "z", "y", "x"), RHO.T[None, ::-1])}, down)
    data.to_zarr(path, encoding={"rho": {"chunks": (1, 2, 3, 4)}})
    return {}


def as_netcdf(path):
    xr = pytest.importorskip("xarray")
    xr.Dataset({"rho": (("z", "y", "x"), RHO.T)}).to_netcdf(path, engine="scipy")
    return {}


def as_raw(path):
    RHO.astype(">f4").tofile(path, "")
    return {"shape": SHAPE, "dtype": ">f4", "axes": "xyz"}


def as_raw_x_first(path):
    RHO.T.tofile(path)
    return {"shape": SHAPE, "dtype": "f4"}


def as_native(path):
    packed = {"compress": True} if path.suffix == ".h5" else {"chunks": 4, "stats": True}
    vm.Volume(vm.CartesianGrid.uniform(SHAPE, (0, 1)), rho=RHO).save(path, **packed)
    return {}


def as_npy(path):
    np.save(path, RHO)
    return {}


FILES = [
    ("a.h5", as_hdf5),
    ("a.mat", as_matlab),
    ("a.zarr", as_zarr),
    ("b.zarr", lambda path: as_zarr(path, 2)),
    ("c.zarr", as_labelled_zarr),
    ("a.nc", as_netcdf),
    ("rho.raw", as_raw),
    ("rho.raw", as_raw_x_first),
    ("b.h5", as_native),
    ("d.zarr", as_native),
    ("rho.npy", as_npy),
]


@pytest.mark.parametrize(("name", "write"), FILES)
def test_boxes_of_files(tmp_path, name, write):
    options = write(tmp_path / name)
    volume = open_lazily(tmp_path / name, **options).unread()
    store = volume.store
    for field in volume.fields:
        assert_boxes(store, field, RHO)
    assert volume.waiting == volume.fields or name.endswith(".raw")
    np.testing.assert_array_equal(volume.array("rho"), RHO)


def test_other_processes_read_boxes(tmp_path):
    """What is pickled has no values; each process opens the file when it reads."""
    volumes = []
    for k, (name, write) in enumerate(FILES):
        (tmp_path / str(k)).mkdir()
        options = write(tmp_path / str(k) / name)
        volumes.append(open_lazily(tmp_path / str(k) / name, **options).unread())
    xr, sent = pytest.importorskip("xarray"), tmp_path / "volumes.pickle"
    xr.Dataset({"rho": (tuple("xyz"), RHO)}).to_zarr(tmp_path / "opened.zarr")
    opened = vm.Volume.from_xarray(xr.open_zarr(tmp_path / "opened.zarr", chunks=None))
    volumes.append(opened.unread())
    with open(sent, "wb") as file:
        pickle.dump(volumes, file)
    assert volumes[0].waiting
    program = (
        "import pickle, sys, numpy as np\n"
        "volumes = pickle.load(open(sys.argv[1], 'rb'))\n"
        "boxes = [v.store.read('rho', (1, 2, 0), (4, 5, 3)) for v in volumes]\n"
        "np.save(sys.argv[2], boxes)\n"
        "assert all(v.waiting or v.fields for v in volumes)\n"
    )
    command = [sys.executable, "-c", program, sent, tmp_path / "boxes.npy"]
    subprocess.run(command, check=True, cwd="/")
    for box in np.load(tmp_path / "boxes.npy"):
        np.testing.assert_array_equal(box, RHO[1:4, 2:5, :3])


@pytest.mark.parametrize("size", [8, 9])
def test_levels_of_a_pyramid(tmp_path, size):
    """Levels that are no powers of two of the cells are left out."""
    zarr = pytest.importorskip("zarr", "3")
    group = zarr.open_group(str(tmp_path / "a.ome.zarr"), mode="w")
    cells = RNG.random((2, size, 8, 6), np.float32)
    shapes = [(size, 8, 6), (size, 4, 3), (size // 2, 2, 2)]
    scales = [[1.0, n, m, m] for n, m in ((1.0, 1.0), (1.0, 2.0), (2.0, 4.0))]
    levels = [cells[:, :, :: size // a, :: 8 // b] for a, b, _ in shapes]
    for k, (shape, values) in enumerate(zip(shapes, levels, strict=True)):
        levels[k] = values[:, : shape[0], : shape[1], : shape[2]]
        group.create_array(str(k), data=levels[k], chunks=(1, 4, 4, 4))
    steps = [[{"type": "scale", "scale": scale}] for scale in scales]
    data = [{"path": str(k), "coordinateTransformations": s} for k, s in enumerate(steps)]
    axes = [{"name": "c", "type": "channel"}, *({"name": a, "type": "space"} for a in "zyx")]
    told = {"version": "0.5", "multiscales": [{"axes": axes, "datasets": data}]}
    group.attrs["ome"] = told
    volume = open_lazily(tmp_path / "a.ome.zarr")
    store = volume.store
    assert store.levels == (3 if size == 8 else 2)
    for level in range(store.levels):
        shape = store.shape(level)
        assert shape == shapes[level][::-1]
        values = store.read("channel_1", (0, 1, 0), shape, level)
        np.testing.assert_array_equal(values, levels[level][1].T[:, 1:])
    assert_boxes(store, "channel_0", cells[0].T)
    assert open_lazily(tmp_path / "a.ome.zarr", level=2).store.levels == 1


def test_what_cannot_be():
    volume = vm.Volume(vm.CartesianGrid.uniform(SHAPE, (0, 1)), rho=RHO)
    with pytest.raises(vm.errors.UnknownNameError, match="did you mean 'rho'"):
        volume.store.read("roh", (0, 0, 0), (1, 1, 1))
    for low, high in (((0, 0, 0), (0, 1, 1)), ((-1, 0, 0), (1, 1, 1)), ((0, 0, 0), (1, 1, 6))):
        with pytest.raises(vm.InputError, match="a box needs 0 <= low < high <="):
            volume.store.read("rho", low, high)
    with pytest.raises(vm.InputError, match="level must be from 0 to 0"):
        volume.store.shape(1)


def as_leaves():
    # More than one chunk of 2^18 leaves.
    refined = np.tile([1, *8 * [0]], (1 << 15) + 1)
    tree = vm.OctreeGrid(np.arange((1 << 15) + 2), [0, 1], [0, 1], refined)
    volume = vm.Volume(tree, rho=np.arange(float(tree.size)), unit_=np.ones(tree.size))
    volume.set_unit("rho", "g/cm3")
    return volume


@pytest.mark.parametrize("kind", ["memory", "native", "packed", "radmc3d"])
def test_leaves_of_a_tree(tmp_path, kind):
    """They are counted along one axis."""
    volume = as_leaves()
    if kind == "radmc3d":
        del volume["unit_"]
        vm.radmc3d.write(volume, tmp_path, {"dust_density": "rho"})
        opened, name = vm.open(tmp_path), "dust_density"
    elif kind == "memory":
        opened, name = volume, "rho"
    else:
        volume.save(tmp_path / "a.h5", compress=kind == "packed")
        opened, name = open_lazily(tmp_path / "a.h5"), "rho"
    store = opened.store
    assert store.levels == 1
    assert kind == "packed" or store.chunks == (1 << 18,)
    assert_boxes(store, name, volume.array("rho"))


@pytest.mark.parametrize("shape", [(8, 8, 8), (9, 7, 1), (5, 4, 3)])
def test_means(shape):
    """Of groups, incomplete ones at the ends; what is not known does not count."""
    values = RNG.normal(size=shape)
    values[0, 0, 0] = np.nan
    halves = means(values, (2, 2, 2))
    for index in np.ndindex(halves.shape):
        group = values[tuple(slice(2 * i, 2 * i + 2) for i in index)]
        np.testing.assert_allclose(halves[index], np.nanmean(group), rtol=1e-14, atol=1e-15)
    assert np.isnan(means(np.full(shape, np.nan, "f4"), (2, 2, 2))).all()
    numbers = means(np.full(shape, 2**31, np.uint32), (4, 2, 1))
    assert numbers.dtype == np.uint32
    assert (numbers == 2**31).all()
    assert level_factors(shape, means(values, (4, 2, 1)).shape) is not None
