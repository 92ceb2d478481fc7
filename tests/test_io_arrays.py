"""Named arrays: coordinates beside them, vectors, values elsewhere; packed files; mischief."""

from __future__ import annotations

import bz2
import gzip
import io
import lzma
import os
import struct
import subprocess
import sys
import zipfile
from pathlib import Path

import h5py
import numpy as np
import pytest

import real_data
import voluminous as vm
from contracts import ReaderContract
from reference import data_directory
from voluminous.io import compressed, find_reader

RHO = np.arange(24, dtype=np.float32).reshape(2, 3, 4) + 1


# Coordinates beside data sets


@pytest.mark.parametrize("group", ["", "gas/"])
def test_centres_beside_a_field_make_edges(tmp_path, group):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file[f"{group}rho"] = RHO
        for axis, n in zip("xyz", RHO.shape, strict=True):
            file[f"{group}{axis}"] = 10.0 * np.arange(n) + 5
            file[f"{group}{axis}"].attrs["units"] = "kilometres"
    volume = vm.open(tmp_path / "a.h5")
    assert volume.grid.bounds.tolist() == [[0, 20], [0, 30], [0, 40]]
    assert str(volume.unit) == "km"


def test_coordinates_of_the_nearest_group_count(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["gas/rho"] = RHO
        for axis, n in zip("xyz", RHO.shape, strict=True):
            file[axis], file[f"gas/{axis}"] = np.arange(n + 1.0), 2 * np.arange(n + 1.0)
    assert vm.open(tmp_path / "a.h5").grid.bounds.tolist() == [[0, 4], [0, 6], [0, 8]]


@pytest.mark.parametrize("names", [("lev", "lat", "lon"), ("z", "y", "x")])
def test_dimension_scales_tell_order_and_places(tmp_path, names):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        rho = file.create_dataset("rho", data=RHO.T)
        for axis, (name, n) in enumerate(zip(names, RHO.T.shape, strict=True)):
            file[f"axes/{name}"] = 3.0 * np.arange(n)
            file[f"axes/{name}"].make_scale(name)
            rho.dims[axis].attach_scale(file[f"axes/{name}"])
    volume = vm.open(tmp_path / "a.h5")
    np.testing.assert_array_equal(volume.array("rho"), RHO)
    assert volume.grid.bounds.tolist() == [[-1.5, 4.5], [-1.5, 7.5], [-1.5, 10.5]]
    assert vm.open(tmp_path / "a.h5", axes="xyz").grid.shape == (4, 3, 2)


def test_coordinates_that_make_no_grid_are_explained(tmp_path):
    edges = {"x": [0, 1, 2], "y": [0, 1, 2, 2], "z": [0, 1, 2, 3, 4]}
    np.savez(tmp_path / "a.npz", rho=RHO, **edges)
    with pytest.raises(vm.InputError, match=r"x, y, z in the file make no grid.*Give bounds="):
        vm.open(tmp_path / "a.npz")


# Vectors


@pytest.mark.parametrize("where", ["first", "last"])
def test_vectors_are_three_fields(tmp_path, where):
    parts = np.stack([RHO, 10 * RHO, 100 * RHO], axis=0 if where == "first" else -1)
    parts = np.pad(parts, [(0, 0) if n == 3 else (0, 3) for n in parts.shape])
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["B"] = parts
    np.savez(tmp_path / "a.npz", B=parts)
    np.save(tmp_path / "B.npy", parts)
    for name in ("a.h5", "a.npz", "B.npy"):
        volume = vm.open(tmp_path / name, components=where)
        assert volume.fields == ("B_x", "B_y", "B_z")
        expected = np.take(parts, 1, axis=0 if where == "first" else -1)
        np.testing.assert_array_equal(volume.array("B_y"), expected)
        assert vm.open(tmp_path / name, "B", components=where).fields == volume.fields
        assert len(find_reader(tmp_path / name).info(tmp_path / name, components=where)) == 3


def test_which_axis_counts_components_is_told_where_only_one_can(tmp_path):
    np.save(tmp_path / "v.npy", np.zeros((9, 9, 9, 2)))
    assert vm.open(tmp_path / "v.npy").fields == ("v_0", "v_1")
    np.save(tmp_path / "v.npy", np.zeros((3, 9, 9, 3)))
    with pytest.raises(vm.FileFormatError, match=r"\(3, 9, 9, 3\), expected three axes"):
        vm.open(tmp_path / "v.npy", "v")
    with pytest.raises(vm.InputError, match="components must be 'first' or 'last'"):
        vm.open(tmp_path / "v.npy", components=0)


# Values that are elsewhere


def test_links_out_of_a_file_are_not_followed(tmp_path):
    with h5py.File(tmp_path / "secret.h5", "w") as file:
        file["rho"] = RHO
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["mine"] = RHO
        file["theirs"] = h5py.ExternalLink("secret.h5", "/rho")
        file["soft"] = h5py.SoftLink("/nowhere")
        file["group/loop"] = file["/"]
    assert vm.open(tmp_path / "a.h5").fields == ("mine",)
    with pytest.raises(vm.errors.UnknownNameError):
        vm.open(tmp_path / "a.h5", "theirs")


def test_values_in_another_file_are_refused(tmp_path):
    (tmp_path / "other.bin").write_bytes(RHO.tobytes())
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("rho", RHO.shape, RHO.dtype, external=[("other.bin", 0, RHO.nbytes)])
    with pytest.raises(vm.FileFormatError, match=r"values of /rho are in .*other\.bin.*h5repack"):
        vm.open(tmp_path / "a.h5")


def test_virtual_values_come_from_the_same_directory_only(tmp_path):
    (tmp_path / "data").mkdir()
    for place in ("inner.h5", "data/part.h5"):
        with h5py.File(tmp_path / place, "w") as file:
            file["rho"] = RHO
    for source in ("part.h5", "../inner.h5", "gone.h5"):
        layout = h5py.VirtualLayout(RHO.shape, RHO.dtype)
        layout[:] = h5py.VirtualSource(source, "rho", RHO.shape)
        with h5py.File(tmp_path / "data" / f"of_{Path(source).name}", "w") as file:
            file.create_virtual_dataset("rho", layout)
    np.testing.assert_array_equal(vm.open(tmp_path / "data" / "of_part.h5").array("rho"), RHO)
    with pytest.raises(vm.FileFormatError, match="outside of its directory"):
        vm.open(tmp_path / "data" / "of_inner.h5")
    with pytest.raises(vm.InputError, match="there is no such file"):
        vm.open(tmp_path / "data" / "of_gone.h5")


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (RHO.astype(complex), "real numbers, got dtype complex128"),
        (np.zeros((2, 0, 3)), "at least one cell"),
        (np.zeros((2, 2, 2), [("a", "f4")]), "real numbers"),
    ],
)
def test_hdf5_data_that_makes_no_field(tmp_path, values, message):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["rho"] = values
    with pytest.raises(vm.FileFormatError, match=message):
        vm.open(tmp_path / "a.h5", "rho")


@pytest.mark.parametrize("dtype", [">i2", ">f8", "<u4", "f2", "?"])
def test_hdf5_of_any_bytes_chunks_and_packing(tmp_path, dtype):
    values = (RHO > 5) if dtype == "?" else RHO.astype(dtype)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("rho", data=values, chunks=(1, 2, 3), compression="gzip", shuffle=True)
    np.testing.assert_array_equal(vm.open(tmp_path / "a.h5").array("rho"), values)


# Mischief in archives


def head(shape, dtype="<f4", order=False):
    told = f"{{'descr': '{dtype}', 'fortran_order': {order}, 'shape': {shape}}}\n".encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(told)) + told


@pytest.mark.parametrize(
    "shape", [(10**6,) * 3, (2**40, 2**40, 2**40), (-2, 3, 4), (2, 3, 3), (2, 3, 5)]
)
@pytest.mark.parametrize("name", ["a.npz", "a.npy"])
def test_a_head_that_does_not_fit_the_data(tmp_path, shape, name):
    content = head(shape) + RHO.tobytes()
    if name == "a.npz":
        with zipfile.ZipFile(tmp_path / name, "w") as archive:
            archive.writestr("rho.npy", content)
    else:
        if shape == (2, 3, 3):  # bytes that nobody asks for do no harm
            return
        (tmp_path / name).write_bytes(content)
    with pytest.raises(vm.FileFormatError, match=rf"{name}"):
        vm.open(tmp_path / name)


@pytest.mark.parametrize("announced", [8, 10**9])
def test_a_member_that_announces_another_size(tmp_path, announced):
    path = tmp_path / "a.npz"
    np.savez_compressed(path, rho=RHO)
    content = bytearray(path.read_bytes())
    with zipfile.ZipFile(path) as archive:
        size = struct.pack("<I", archive.infolist()[0].file_size)
    place = content.rindex(size)  # in the directory at the end
    content[place : place + 4] = struct.pack("<I", announced)
    path.write_bytes(content)
    with pytest.raises(vm.FileFormatError, match=r"a\.npz"):
        vm.open(path)


def test_a_wrong_checksum_shows(tmp_path):
    path = tmp_path / "a.npz"
    np.savez(path, rho=RHO)
    content = bytearray(path.read_bytes())
    place = content.index(RHO.tobytes()) + 40
    content[place] ^= 1
    path.write_bytes(content)
    with pytest.raises(vm.FileFormatError, match=r"a\.npz.*CRC"):
        vm.open(path)


# Packed files


PACKERS = {".gz": gzip.compress, ".bz2": bz2.compress, ".xz": lzma.compress}


def npy(array=RHO):
    target = io.BytesIO()
    np.save(target, array)
    return target.getvalue()


@pytest.mark.parametrize("suffix", PACKERS)
def test_packed_files_are_what_is_in_them(tmp_path, suffix):
    path = tmp_path / f"rho.npy{suffix}"
    path.write_bytes(PACKERS[suffix](npy()))
    volume = vm.open(path, spacing=2, unit="pc")
    np.testing.assert_array_equal(volume.array("rho"), RHO)
    assert not volume.waiting
    assert volume.grid.bounds[0].tolist() == [0, 4]
    (told,) = find_reader(path).info(path)
    assert (told.name, told.shape) == ("rho", RHO.shape)
    with pytest.raises(
        vm.errors.UnknownNameError, match="npy option 'spcing'; did you mean 'spacing'"
    ):
        vm.open(path, spcing=2)


def test_packed_hdf5(tmp_path):
    vm.models.sphere(6).save(tmp_path / "a.h5")
    (tmp_path / "b.h5.gz").write_bytes(gzip.compress((tmp_path / "a.h5").read_bytes()))
    assert vm.open(tmp_path / "b.h5.gz").fields == ("inside",)


def test_what_was_unpacked_disappears(tmp_path, monkeypatch):
    (tmp_path / "there").mkdir()
    monkeypatch.setattr(compressed.tempfile, "tempdir", str(tmp_path / "there"))
    path = tmp_path / "rho.npy.gz"
    path.write_bytes(gzip.compress(npy()))
    volume = vm.open(path)
    assert not os.listdir(tmp_path / "there")
    np.testing.assert_array_equal(volume.array("rho"), RHO)
    path.write_bytes(gzip.compress(npy()[:-7]))
    with pytest.raises(vm.FileFormatError, match=r"rho\.npy\.gz: .*cut short"):
        vm.open(path)
    assert not os.listdir(tmp_path / "there")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"hello", r"a\.x\.gz: a\.x is of a format that voluminous does not know"),
        (gzip.compress(b"hello"), "packed once more"),
        (b"", r"a\.x is empty"),
    ],
    ids=["text", "twice", "empty"],
)
def test_packed_files_of_nothing_known(tmp_path, content, message):
    (tmp_path / "a.x.gz").write_bytes(gzip.compress(content))
    with pytest.raises(vm.FileFormatError, match=message) as failure:
        vm.open(tmp_path / "a.x.gz")
    assert "voluminous-" not in str(failure.value)  # the directory where it was unpacked


def test_bombs_are_refused_before_they_fill_anything(tmp_path, monkeypatch):
    monkeypatch.setattr(compressed, "_SMALL", 1 << 20)
    path = tmp_path / "a.npy.bz2"
    path.write_bytes(bz2.compress(bytes(32 << 20)))
    assert path.stat().st_size < 100
    with pytest.raises(vm.FileFormatError, match="more than 1000 times its size"):
        vm.open(path)
    monkeypatch.setattr(compressed, "available_memory", lambda: 100)
    (tmp_path / "b.npy.gz").write_bytes(gzip.compress(npy()))
    with pytest.raises(
        vm.errors.MemoryNeededError, match="unpacking needs more than the 100 bytes"
    ):
        vm.open(tmp_path / "b.npy.gz")


class TestPacked(ReaderContract):
    @pytest.fixture
    def sample(self):
        def write(directory):
            # Its checksum, at the end, is all that tells of some damage.
            packed = gzip.compress(npy(np.random.default_rng(0).random((4, 5, 6))))
            (directory / "a.npy.gz").write_bytes(packed)
            return directory / "a.npy.gz"

        return write


class TestVectors(ReaderContract):
    @pytest.fixture
    def sample(self):
        def write(directory):
            np.savez_compressed(
                directory / "a.npz", v=np.ones((3, 5, 6, 7)), rho=np.ones((5, 6, 7))
            )
            return directory / "a.npz"

        return write


# Real data


def test_stellar_streams():
    truth = real_data.load("streams")
    volume = vm.open(data_directory() / "data" / "cosmo_grids" / "hdz2000.npy.bz2")
    assert volume.fields == ("hdz2000",)
    assert volume.array("hdz2000").dtype == np.uint8
    np.testing.assert_array_equal(volume.array("hdz2000"), truth.array("counts"))


def test_stent():
    truth = real_data.load("stent")
    volume = vm.open(data_directory() / "data" / "medical" / "stent_ct.npz", axes="zyx", unit="mm")
    assert volume.array("arr_0").dtype == np.int16
    np.testing.assert_array_equal(volume.array("arr_0"), truth.array("ct"))
    np.testing.assert_array_equal(volume.grid.bounds, truth.grid.bounds)


@pytest.mark.parametrize("down", ["x", "yz"])
@pytest.mark.parametrize("walls", [True, False], ids=["walls", "centres"])
@pytest.mark.parametrize("way", ["npz", "hdf5", "scales", "options"])
def test_arrays_are_turned_where_coordinates_decrease(tmp_path, down, walls, way):
    shape, width = (2, 3, 4), 0.5
    values = np.arange(24.0).reshape(shape)
    lines = {}
    for axis, count in zip("xyz", shape, strict=True):
        ticks = 10 + width * (np.arange(count + 1) if walls else np.arange(count) + 0.5)
        lines[axis] = ticks[::-1].copy() if axis in down else ticks
    path, options = tmp_path / ("a.npz" if way in ("npz", "options") else "a.h5"), {}
    if way == "npz":
        np.savez(path, s=values, **lines)
    elif way == "options":
        np.savez(path, s=values)
        options = lines
    else:
        with h5py.File(path, "w") as file:
            file["s"] = values
            for k, (axis, line) in enumerate(lines.items()):
                file[axis] = line
                if way == "scales" and not walls:
                    file[axis].make_scale(axis)
                    file["s"].dims[k].attach_scale(file[axis])
    volume = vm.open(path, "s", **options)
    turns = tuple(slice(None, None, -1 if axis in down else None) for axis in "xyz")
    np.testing.assert_array_equal(volume.array("s"), values[turns])
    assert volume.grid.bounds.tolist() == [[10, 11], [10, 11.5], [10, 12]]


@pytest.mark.parametrize("program", ["MATLAB", "Octave"])
def test_arrays_of_matlab_are_as_matlab_shows_them(tmp_path, program):
    """Both write their columns first, which HDF5 shows backwards."""
    values, path = np.arange(24.0).reshape(2, 3, 4), tmp_path / "a.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        place = "rho" if program == "MATLAB" else "rho/value"
        file[place] = values.T
        if program == "Octave":
            file["rho"].attrs["OCTAVE_NEW_FORMAT"] = np.uint8(1)
    if program == "MATLAB":
        with open(path, "r+b") as file:
            file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(128))
    volume = vm.open(path)
    np.testing.assert_array_equal(volume.array(volume.fields[0]), values)
    turned = vm.open(path, axes="zyx")
    np.testing.assert_array_equal(turned.array(turned.fields[0]), values.T)


@pytest.mark.parametrize(
    ("mark", "words"),
    [
        ("Grid00000042/Density", "piece of an output of Enzo"),
        ("DataContainers/ImageDataContainer/CellData/Phases", r"DREAM\.3D"),
        ("s00/resolutions", "BigDataViewer"),
        ("HDFEOS INFORMATION/StructMetadata.0", "HDF-EOS"),
    ],
)
def test_layouts_of_other_programs_are_said(tmp_path, mark, words):
    values = np.arange(24.0).reshape(2, 3, 4)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["rho"], file[mark] = values, np.zeros(3)
    with pytest.raises(vm.FileFormatError, match=words + r".*axes='zyx'"):
        vm.open(tmp_path / "a.h5")
    volume = vm.open(tmp_path / "a.h5", "rho", axes="xyz")
    np.testing.assert_array_equal(volume.array("rho"), values)


def test_times_are_no_components(tmp_path):
    """Dedalus writes (t, x, y, z), and may have three times in a file."""
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["tasks/b"] = np.zeros((3, 4, 5, 6))
        for axis, name in enumerate("txyz"):
            file["tasks/b"].dims[axis].label = name
    with pytest.raises(vm.FileFormatError, match="expected a three-dimensional"):
        vm.open(tmp_path / "a.h5")


def test_filters_of_hdf5plugin(tmp_path):
    pytest.importorskip("hdf5plugin")
    values = np.random.default_rng(0).random((8, 9, 10))
    np.save(tmp_path / "a.npy", values)
    # In processes of their own: filters stay registered, and not beside other libraries of HDF5.
    write = (
        "import h5py, hdf5plugin as p, numpy as np\n"
        "with h5py.File('a.h5', 'w') as file:\n"
        "  for name, packing in (('rho', p.Zstd()), ('t', p.Blosc()), ('v', p.LZ4())):\n"
        "    file.create_dataset(name, data=np.load('a.npy'), **packing)\n"
    )
    if subprocess.run([sys.executable, "-c", write], cwd=tmp_path).returncode:
        pytest.skip("hdf5plugin cannot pack here")
    script = (
        "import sys, voluminous as vm\n"
        "if sys.argv[1] == 'without': sys.modules['hdf5plugin'] = None\n"
        "try: print(*(vm.open('a.h5').array(n).sum() for n in ('rho', 't', 'v')))\n"
        "except vm.errors.MissingPackageError as error: print(error)\n"
    )

    def said(how):
        command = [sys.executable, "-c", script, how]
        return subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)

    assert np.allclose([float(word) for word in said("with").stdout.split()], values.sum())
    assert "a.h5: values are packed" in said("without").stdout
    assert "pip install hdf5plugin" in said("without").stdout
