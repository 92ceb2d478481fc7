"""Named arrays: coordinates beside them, vectors, values elsewhere; packed files; mischief."""

from __future__ import annotations

import bz2
import gzip
import io
import lzma
import struct
import zipfile

import h5py
import numpy as np
import pytest
import scipy.io

import voluminous as vm
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


def test_bombs_are_refused_before_they_fill_anything(tmp_path, monkeypatch):
    monkeypatch.setattr(compressed, "available_memory", lambda: 100)
    (tmp_path / "b.npy.gz").write_bytes(gzip.compress(npy()))
    with pytest.raises(
        vm.errors.MemoryNeededError, match="unpacking needs more than the 100 bytes"
    ):
        vm.open(tmp_path / "b.npy.gz")


# Real data


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


def test_files_of_matlab_before_hdf5_are_named(tmp_path):
    scipy.io.savemat(tmp_path / "a.mat", {"rho": RHO})
    with pytest.raises(vm.FileFormatError, match=r"MATLAB file of a version before 7\.3; save it"):
        vm.open(tmp_path / "a.mat")
