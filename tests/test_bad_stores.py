"""Stores that are damaged, or unusual: refused, flagged or right, but never a wrong picture."""

from __future__ import annotations

import os
import re
import warnings
from contextlib import contextmanager

import h5py
import numpy as np
import pytest

import voluminous as vm
from voluminous.cli import main
from voluminous.io.registry import open_lazily

zarr = pytest.importorskip("zarr", "3")
xr = pytest.importorskip("xarray")
pytest.importorskip("h5netcdf")

RHO = np.random.default_rng(4).random((9, 8, 5), np.float32)
SPACING, UNIT = 2.0, "pc"
MEDIUM = vm.Gaussian("rho", 0.5, 0.2, (1, 0.5, 0.2), opacity=0.4, path_length="3 pc")
CAMERA = vm.Orthographic(50, 20, width="20 pc", resolution=8)


def as_saved(path, values, chunks):
    """Write the package's own store; returns what to open it with."""
    grid = vm.CartesianGrid(*(SPACING * np.arange(n + 1) for n in values.shape), unit=UNIT)
    volume = vm.Volume(grid, rho=values)
    volume.set_unit("rho", "g / cm3")
    volume.save(path, chunks=chunks, stats=True)
    return {}


def as_zarr(version, codec):
    def write(path, values, chunks):
        group = zarr.open_group(str(path), mode="w", zarr_format=version)
        packed = {"default": "auto", "none": None}.get(codec)
        if codec == "blosc" and version == 2:
            packed = pytest.importorskip("numcodecs").Blosc()
        elif codec == "blosc":
            packed = zarr.codecs.BloscCodec()
        sides = {"shape": values.shape, "dtype": values.dtype, "chunks": chunks}
        array = group.create_array("rho", compressors=packed, fill_value=0.25, **sides)
        array[...] = values
        array.attrs["units"] = "g / cm3"
        return {"spacing": SPACING, "unit": UNIT}

    return write


def as_named_zarr(path, values, chunks):
    dataset(values).to_zarr(path, encoding={"rho": {"chunks": chunks}}, zarr_format=2)
    return {}


def as_microscope(path, values, chunks):
    group = zarr.open_group(str(path), mode="w")
    sides = {"shape": values.T.shape, "dtype": values.dtype, "chunks": chunks[::-1]}
    group.create_array("0", **sides)[...] = values.T
    axes = [{"name": a, "type": "space", "unit": "parsec"} for a in "zyx"]
    steps = [{"type": "scale", "scale": [SPACING] * 3}]
    data = [{"path": "0", "coordinateTransformations": steps}]
    group.attrs["ome"] = {"version": "0.5", "multiscales": [{"axes": axes, "datasets": data}]}
    return {"name": "rho", "level": 0}


def as_hdf5(path, values, chunks, **packed):
    with h5py.File(path, "w") as file:
        # HDF5 has no chunks that are larger than the array.
        chunks = tuple(map(min, chunks, values.shape))
        item = file.create_dataset("rho", values.shape, values.dtype, chunks=chunks, **packed)
        item[...] = values
        item.attrs["units"] = "g/cm**3"
    return {"spacing": SPACING, "unit": UNIT}


def as_netcdf(path, values, chunks):
    chunks = tuple(map(min, chunks, values.shape))
    encoding = {"rho": {"chunksizes": chunks, "zlib": True}}
    dataset(values).to_netcdf(path, engine="h5netcdf", encoding=encoding)
    return {}


def dataset(values):
    """Return named arrays in kiloparsecs that lie where the cells of the others do."""
    names = dict(zip("xyz", values.shape, strict=True))
    lines = {a: (a, 0.002 * (np.arange(n) + 0.5), {"units": "kpc"}) for a, n in names.items()}
    return xr.Dataset({"rho": (tuple("xyz"), values, {"units": "g cm-3"})}, lines)


WRITERS = {
    "saved.zarr": as_saved,
    "2.zarr": as_zarr(2, "default"),
    "3.zarr": as_zarr(3, "default"),
    "named.zarr": as_named_zarr,
    "cells.ome.zarr": as_microscope,
    "rho.h5": as_hdf5,
    "rho.nc": as_netcdf,
}


@pytest.mark.filterwarnings("ignore:Consolidated metadata")
@pytest.mark.parametrize("dtype", ["<f4", ">f4"])
@pytest.mark.parametrize(
    "chunks", [(4, 3, 2), (2, 8, 5), (16, 16, 16), (8, 7, 4)], ids=["few", "flat", "wide", "rest"]
)
@pytest.mark.parametrize("name", WRITERS)
def test_any_chunks_are_right(tmp_path, monkeypatch, name, chunks, dtype):
    """Chunks of three widths, of whole layers, larger than the volume, and rests of one cell."""
    monkeypatch.setattr("voluminous.large.view.VolumeView.widest", 4)
    options = WRITERS[name](tmp_path / name, RHO.astype(dtype), chunks)
    volume = open_lazily(tmp_path / name, **options).unread()
    assert volume.waiting == ("rho",)
    np.testing.assert_array_equal(volume.store.read("rho", (1, 2, 0), (9, 7, 5)), RHO[1:, 2:7])
    # Sizes of cells and units are those of the file.
    ends = [[0, SPACING * n] for n in RHO.shape]
    centred = 0.5 * SPACING if "ome" in name else 0.0
    found = volume.grid.bounds * volume.unit.to(UNIT)
    # Edges are in the middle between the centres of a file: of three roundings.
    np.testing.assert_allclose(found, np.array(ends) - centred, rtol=1e-14, atol=1e-14)
    assert volume.units["rho"] == ("" if "ome" in name else "g / cm3")
    image = vm.render(volume, MEDIUM, CAMERA, scheme="first-order", memory="1 GiB")
    assert volume.waiting == ("rho",)
    whole = vm.Volume(volume.grid, rho=RHO)
    expected = vm.render(whole, MEDIUM, CAMERA, scheme="first-order")
    assert image.intensity.max() > 0.1
    np.testing.assert_array_equal(image.intensity, expected.intensity)


# Of each format the key of the chunk (0, 1, 0), as the grid counts.
KEYS = {
    "saved.zarr": "fields/rho/c/0/1/0",
    "2.zarr": "rho/0.1.0",
    "3.zarr": "rho/c/0/1/0",
    "named.zarr": "rho/0.1.0",
    "cells.ome.zarr": "0/c/0/1/0",
}


@pytest.mark.filterwarnings("ignore:Consolidated metadata")
@pytest.mark.parametrize("name", KEYS)
def test_a_chunk_that_is_missing(tmp_path, name):
    """Of the package's own store it is an error; others may leave out chunks of fill values."""
    options = WRITERS[name](tmp_path / name, RHO, (4, 3, 2))
    (tmp_path / name / KEYS[name]).unlink()
    if name == "saved.zarr":
        where = r"saved\.zarr: .*missing \(field 'rho', level 0, chunk \(0, 1, 0\)\)"
        with pytest.raises(vm.FileFormatError, match=where):
            vm.open(tmp_path / name)
        return
    with pytest.warns(UserWarning, match="no chunk") as told:
        values = vm.open(tmp_path / name, **options).array("rho")
    assert re.search(rf"{name}: there is no chunk {KEYS[name]}", str(told[-1].message))
    fill = np.float32(0.25 if name in ("2.zarr", "3.zarr") else 0)
    lost = values[:4, 3:6, :2]
    assert np.all(np.isnan(lost) if name == "named.zarr" else lost == fill)
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # said once
        warnings.filterwarnings("ignore", "Consolidated")
        open_lazily(tmp_path / name, **options).store.read("rho", (0, 3, 0), (4, 6, 2))


def test_a_chunk_of_hdf5_that_was_never_written(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        item = file.create_dataset("rho", RHO.shape, "f4", chunks=(3, 4, 5), fillvalue=0.5)
        item[:6] = RHO[:6]
    store = open_lazily(tmp_path / "a.h5").store
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        np.testing.assert_array_equal(store.read("rho", (1, 0, 0), (6, 8, 5)), RHO[1:6])
    with pytest.warns(UserWarning, match=r"a\.h5: the chunk \(2, 0, 0\) of /rho was never written"):
        assert np.all(store.read("rho", (1, 0, 0), (9, 8, 5))[5:] == 0.5)


@pytest.mark.filterwarnings("ignore:Consolidated metadata")
@pytest.mark.parametrize("name", KEYS)
@pytest.mark.parametrize("part", [0, 0.2, 0.7, 1])
def test_a_chunk_that_is_cut_short(tmp_path, name, part):
    """The error names the store, the field, the level and the chunk."""
    options = WRITERS[name](tmp_path / name, RHO, (4, 3, 2))
    volume = open_lazily(tmp_path / name, **options).unread()
    with unnoticed(tmp_path / name / KEYS[name]) as chunk:
        cut(chunk, part)
    where = rf"{name}: .*\(field 'rho', level 0, chunk \(0, 1, 0\)\)"
    with pytest.raises(vm.FileFormatError, match=where):
        volume.store.read("rho", (0, 0, 0), RHO.shape)
    with pytest.raises(vm.FileFormatError, match=where):
        vm.render(volume, MEDIUM, CAMERA, memory="1 GiB")
    with pytest.raises(vm.FileFormatError, match=where):
        vm.open(tmp_path / name, **options)


@pytest.mark.parametrize("codec", ["blosc", "none"])
@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("part", [0, 0.2, 0.7, 1])
def test_a_chunk_without_checksum_that_is_cut_short(tmp_path, version, codec, part):
    """Blosc reads on beyond the end of what it is given."""
    options = as_zarr(version, codec)(tmp_path / "a.zarr", RHO, (4, 3, 2))
    cut(tmp_path / "a.zarr" / KEYS[f"{version}.zarr"], part)
    with pytest.raises(vm.FileFormatError, match=r"a\.zarr: .*level 0, chunk \(0, 1, 0\)\)"):
        vm.open(tmp_path / "a.zarr", **options)


@contextmanager
def unnoticed(path):
    """Let a file look as old as it is."""
    before = path.stat()
    yield path
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))


def cut(path, part):
    content = path.read_bytes()
    path.write_bytes(content[: min(int(part * len(content)), len(content) - 1)])


@pytest.mark.parametrize("name", ["rho.h5", "rho.nc"])
def test_a_damaged_chunk_of_hdf5(tmp_path, name):
    packed = {"compression": "gzip"} if name == "rho.h5" else {}
    options = WRITERS[name](tmp_path / name, RHO, (4, 3, 2), **packed)
    with h5py.File(tmp_path / name) as file:
        place = file["rho"].id.get_chunk_info_by_coord((0, 3, 0)).byte_offset
    volume = open_lazily(tmp_path / name, **options).unread()
    with unnoticed(tmp_path / name) as path, open(path, "r+b") as file:
        file.seek(place)
        file.write(bytes(8))
    with pytest.raises(vm.FileFormatError, match=rf"{name}: .*level 0, chunk \(0, 1, 0\)"):
        vm.render(volume, MEDIUM, CAMERA, memory="1 GiB")
    cut(tmp_path / name, 0.7)
    with pytest.raises(vm.FileFormatError, match=rf"{name}: "):
        vm.open(tmp_path / name, **options)


@pytest.mark.filterwarnings("ignore:Consolidated metadata")
@pytest.mark.parametrize("name", WRITERS)
def test_a_chunk_of_nan(tmp_path, name):
    """Such cells are hidden, as in memory, or refused where fields are interpolated."""
    values = RHO.copy()
    values[4:8, 3:6, 2:4] = np.nan
    options = WRITERS[name](tmp_path / name, values, (4, 3, 2))
    volume = open_lazily(tmp_path / name, **options).unread()
    with pytest.raises(vm.InputError, match="'rho' has missing values"):
        vm.render(volume, MEDIUM, CAMERA, memory="1 GiB")
    hidden = vm.render(volume, MEDIUM, CAMERA, scheme="first-order", memory="1 GiB")
    expected = vm.render(vm.Volume(volume.grid, rho=values), MEDIUM, CAMERA, scheme="first-order")
    np.testing.assert_array_equal(hidden.intensity, expected.intensity)


@pytest.mark.parametrize("cells", [slice(0, 4), slice(2, 3), slice(0, 1)], ids=str)
@pytest.mark.parametrize("value", [7.0, -7.0, np.nan])
def test_ranges_that_are_not_those_of_the_cells(tmp_path, cells, value):
    """They are missed when the chunk is read: whole, or a layer of it for its neighbours."""
    path = tmp_path / "a.zarr"
    as_saved(path, RHO, (4, 3, 2))
    with zarr.config.set({"array.write_empty_chunks": True}):
        zarr.open(str(path), mode="r+")["fields/rho"][cells, 3:6, 2:4] = value
    volume = open_lazily(path)
    where = r"a\.zarr: field 'rho', level 0, chunk \(0, 1, 1\): cells are from .*stored range"
    for options in ({"scheme": "first-order"}, {}):
        with pytest.raises(vm.FileFormatError, match=where):
            vm.render(volume, MEDIUM, CAMERA, memory="1 GiB", **options)
    with pytest.raises(vm.FileFormatError, match=where):
        volume.store.read("rho", (3 if cells.stop == 4 else 0, 5, 3), (4, 6, 4))
    # Converting makes new ones.
    assert main(["convert", str(path), str(tmp_path / "b.zarr"), "--stats", "--chunks", "4"]) == 0
    ends = vm.open(tmp_path / "b.zarr").store.extremes("rho")[0, 0, 0]
    np.testing.assert_array_equal(ends[0 if value < 0 else 1], value)


def test_levels_are_compared_with_ranges_too(tmp_path):
    path = tmp_path / "a.zarr"
    vm.Volume(vm.CartesianGrid.uniform(8, (0, 1)), rho=RHO[:8, :, :1].repeat(8, 2)).save(
        path, chunks=2, stats=True, levels=True
    )
    zarr.open(str(path), mode="r+")["levels/1/rho"][3, 0, 0] = 2
    where = r"level 1, chunk \(1, 0, 0\): cells are from"
    with pytest.raises(vm.FileFormatError, match=where):
        open_lazily(path).store.read("rho", (0, 0, 0), (4, 4, 4), 1)
