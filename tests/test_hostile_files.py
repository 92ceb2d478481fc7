"""Files that would be waited for, take all memory, or never end: refused, in little memory."""

from __future__ import annotations

import json
import os
import socket
import tempfile

import h5py
import numpy as np
import pytest

import voluminous as vm
from limited import run

pytest.importorskip("resource")

VALUES = np.random.default_rng(5).random((4, 4, 4), np.float32)
GRID = vm.CartesianGrid.uniform(4, (0, 1), unit="pc")


def pipe(path):
    path.unlink(missing_ok=True)
    os.mkfifo(path)
    return path


# Nobody writes to these pipes: whoever opens one waits for ever.


def test_pipes_sockets_and_devices_are_no_files(tmp_path):
    for suffix in ("h5", "nrrd", "nii.gz", "fits", "zarr", "vti", "raw", "dcm", "xyz", "png"):
        pipe(tmp_path / f"a.{suffix}")
    for name in ("co.dat", "dustkappa_a.inp", "scene.toml", "spectrum.ecsv", "image.out"):
        pipe(tmp_path / name)
    said = run(
        """
        from voluminous.scene import Scene

        def told(read, path):
            try:
                read(path)
            except vm.InputError as error:
                assert str(path) in str(error) and "is a pipe, a socket or a device" in str(error)
                return
            raise AssertionError(path)

        for path in folder.glob("a.*"):
            told(vm.open, path)
        told(lambda path: vm.open(path, format="raw"), folder / "a.raw")
        told(vm.open, Path("/dev/zero"))
        for name in ("a.png", "a.fits", "image.out"):
            told(vm.Image.load, folder / name)
        told(vm.Spectrum.load, folder / "spectrum.ecsv")
        told(vm.Opacity.open, folder / "dustkappa_a.inp")
        told(vm.Molecule.open, folder / "co.dat")
        told(Scene.load, folder / "scene.toml")
        print("all")
        """,
        tmp_path,
    )
    assert said == "all\n"


def test_sockets_are_no_files():
    # The names of sockets must be short.
    with tempfile.TemporaryDirectory() as folder, socket.socket(socket.AF_UNIX) as end:
        end.bind(f"{folder}/s.h5")
        with pytest.raises(vm.InputError, match="is a pipe, a socket or a device"):
            vm.open(f"{folder}/s.h5")


def test_headers_that_name_pipes(tmp_path):
    nibabel = pytest.importorskip("nibabel")
    pytest.importorskip("nrrd")
    pytest.importorskip("vtkmodules")
    pipe(tmp_path / "cells.raw")
    (tmp_path / "a.nhdr").write_text(
        "NRRD0004\ntype: float\ndimension: 3\nsizes: 2 2 2\nendian: little\nencoding: raw\n"
        "data file: cells.raw\n\n"
    )
    (tmp_path / "b.mhd").write_text(
        "ObjectType = Image\nNDims = 3\nDimSize = 2 2 2\nElementType = MET_FLOAT\n"
        "ElementDataFile = cells.raw\n"
    )
    nibabel.save(nibabel.Nifti1Pair(VALUES, np.eye(4)), str(tmp_path / "c.hdr"))
    pipe(tmp_path / "c.img")
    pipe(tmp_path / "piece.vti")
    (tmp_path / "d.pvti").write_text(
        '<VTKFile type="PImageData" version="0.1"><PImageData WholeExtent="0 1 0 1 0 1">'
        '<Piece Extent="0 1 0 1 0 1" Source="piece.vti"/></PImageData></VTKFile>'
    )
    vm.Volume(GRID, a=VALUES).save(tmp_path / "e.zarr")
    pipe(tmp_path / "e.zarr/fields/a/c/0/0/0")
    with h5py.File(tmp_path / "f.h5", "w") as file:
        layout = h5py.VirtualLayout(VALUES.shape, "f4")
        layout[...] = h5py.VirtualSource("piece.vti", "a", shape=VALUES.shape)
        file.create_virtual_dataset("a", layout)
    script = """
    for name in ("a.nhdr", "b.mhd", "c.hdr", "d.pvti", "e.zarr", "f.h5"):
        assert "is a pipe" in refusal(folder / name), name
    """
    run(script, tmp_path)


def test_pipes_in_directories_are_passed_by(tmp_path):
    vm.Volume(GRID, a=VALUES).save(tmp_path / "cells.h5")
    pipe(tmp_path / "b.h5")
    (tmp_path / "amrex/Level_0").mkdir(parents=True)
    pipe(tmp_path / "amrex/Header")
    script = """
    said = refusal(folder)
    assert "cells.h5" in said and "b.h5" not in said, said
    refusal(folder / "amrex")
    """
    run(script, tmp_path)


# Values that are their own


def virtual(file, name, source, place):
    layout = h5py.VirtualLayout(VALUES.shape, "f4")
    layout[...] = h5py.VirtualSource(source, place, shape=VALUES.shape)
    file.create_virtual_dataset(name, layout)


def write_virtual(folder, kind):
    with h5py.File(folder / "a.h5", "w") as file, h5py.File(folder / "b.h5", "w") as other:
        if kind in ("itself", "netcdf"):
            virtual(file, "a", ".", "a")
        elif kind == "by name":
            virtual(file, "a", "a.h5", "a")
        elif kind == "two":
            virtual(file, "a", ".", "b")
            virtual(file, "b", ".", "a")
        elif kind == "files":
            virtual(file, "a", "b.h5", "b")
            virtual(other, "b", "a.h5", "a")
        elif kind == "link":
            virtual(file, "a", ".", "c")
            file["c"] = h5py.SoftLink("/a")
        else:
            group = file.create_group("plot")
            group.attrs.update(NX_class="NXdata", signal="a", default=".")
            virtual(group, "a", ".", "/plot/a")


def test_virtual_data_sets_of_themselves(tmp_path):
    """HDF5 would go round for ever, until its stack is full and the process dies."""
    for kind in ("itself", "by name", "two", "files", "link", "netcdf", "nexus"):
        (tmp_path / kind).mkdir()
        write_virtual(tmp_path / kind, kind)
    script = """
    for each in sorted(folder.iterdir()):
        options = {"format": "netcdf"} if each.name == "netcdf" else {}
        said = refusal(each / "a.h5", **options)
        assert "are virtual, and come from itself" in said, each.name
    """
    run(script, tmp_path)


def test_virtual_data_sets_of_virtual_ones_are_read(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file, h5py.File(tmp_path / "b.h5", "w") as other:
        other["values"] = VALUES
        virtual(file, "b", "b.h5", "values")
        virtual(file, "a", ".", "b")
    np.testing.assert_array_equal(vm.open(tmp_path / "a.h5", "a").array("a"), VALUES)


def test_a_group_of_nexus_that_shows_itself(tmp_path):
    with h5py.File(tmp_path / "a.nxs", "w") as file:
        file.attrs.update(NX_class="NXroot", default="/plot")
        group = file.create_group("plot")
        group.attrs.update(NX_class="NXdata", signal="a", default="/plot")
        group["a"] = VALUES
    run("assert vm.open(folder / 'a.nxs').fields == ('a',)", tmp_path)


def test_own_files_have_no_heap_of_texts(tmp_path):
    """HDF5 hangs on a heap that is zeros; texts of fixed length need none."""
    volume = vm.Volume(GRID, a=VALUES)
    volume.set_unit("a", "g / cm3")
    volume.meta["title"] = "é" * 3000
    volume.save(tmp_path / "a.h5")
    assert b"GCOL" not in (tmp_path / "a.h5").read_bytes()
    again = vm.open(tmp_path / "a.h5")
    assert (again.meta, again.units, again.unit) == (volume.meta, volume.units, volume.unit)


def test_texts_of_any_length_are_read_as_before(tmp_path):
    volume = vm.Volume(GRID, a=VALUES)
    volume.set_unit("a", "g / cm3")
    volume.meta["title"] = "é"
    volume.save(tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5", "a") as file:
        for item in (file, file["grid"], file["fields/a"]):
            for name, value in dict(item.attrs).items():
                item.attrs[name] = value.decode() if isinstance(value, bytes) else value
        text = file["meta"].asstr()[()]
        del file["meta"]
        file["meta"] = text
    assert b"GCOL" in (tmp_path / "a.h5").read_bytes()
    again = vm.open(tmp_path / "a.h5")
    assert (again.meta, again.units, again.unit) == (volume.meta, volume.units, volume.unit)


# Numbers that nothing stands for


def test_levels_that_cells_do_not_make(tmp_path):
    pytest.importorskip("zarr", "3")
    for k, levels in enumerate([10**9, 5, 0, -1, 2.5, "2", None]):
        vm.Volume(GRID, a=VALUES).save(tmp_path / f"{k}.zarr")
        path = tmp_path / f"{k}.zarr/zarr.json"
        described = json.loads(path.read_text())
        described["attributes"]["levels"] = levels
        path.write_text(json.dumps(described))
    script = """
    for path in sorted(folder.iterdir()):
        assert "levels" in refusal(path), path
    """
    run(script, tmp_path)


def test_channels_that_no_instrument_has(tmp_path):
    zarr = pytest.importorskip("zarr", "3")
    (tmp_path / "a.mhd").write_text(
        "NDims = 3\nDimSize = 4 4 4\nElementType = MET_FLOAT\nCompressedData = True\n"
        "ElementNumberOfChannels = 1000000000\nElementDataFile = a.zraw\n"
    )
    (tmp_path / "a.zraw").write_bytes(b"x")
    group = zarr.open_group(str(tmp_path / "b.zarr"), mode="w")
    group.create_array("0", shape=(10**9, 4, 4, 4), dtype="f4", chunks=(1, 4, 4, 4))
    scale = [{"type": "scale", "scale": [1.0] * 4}]
    data = [{"path": "0", "coordinateTransformations": scale}]
    axes = [{"name": a} for a in "czyx"]
    group.attrs["ome"] = {"version": "0.5", "multiscales": [{"axes": axes, "datasets": data}]}
    script = """
    for name in ("a.mhd", "b.zarr"):
        assert "1000000000 channels or components" in refusal(folder / name), name
    """
    run(script, tmp_path)
