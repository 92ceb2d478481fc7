"""NRRD, NIfTI and MetaImage: types, scales, components, times, and data in other files."""

import zlib

import numpy as np
import pytest

import voluminous as vm
from scanner_files import (
    DTYPES,
    ORIGIN,
    RNG,
    TO_RAS,
    UPRIGHT,
    VALUES,
    check_places,
    nrrd_text,
    write_nrrd,
)


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("endian", ["little", "big"])
@pytest.mark.parametrize("encoding", ["raw", "gzip", "bzip2", "ascii"])
def test_nrrd_in_every_encoding(tmp_path, dtype, endian, encoding):
    nrrd = pytest.importorskip("nrrd")
    values = VALUES.astype(dtype)
    path = tmp_path / "density.nrrd"
    nrrd.write(str(path), values, {"encoding": encoding, "endian": endian})
    volume = vm.open(path)
    np.testing.assert_array_equal(volume.array("density"), values)
    assert volume.array("density").dtype == dtype
    np.testing.assert_array_equal(volume.grid.bounds[:, 0], -0.5)


def test_vectors_turn_with_the_coordinates(tmp_path):
    pytest.importorskip("nrrd")
    parts = RNG.random((3, 4, 5, 6)).astype(np.float32)
    steps = np.vstack([np.full(3, np.nan), UPRIGHT])
    path = write_nrrd(
        tmp_path / "v.nrrd",
        parts,
        ORIGIN,
        steps,
        space="right-anterior-superior",
        kinds=["vector", "domain", "domain", "domain"],
    )
    volume = vm.open(path)
    # The file says x to the right, y to the front: LPS has both the other way round.
    for name, part, sign in zip(("v_x", "v_y", "v_z"), parts, np.diag(TO_RAS), strict=True):
        check_places(volume, sign * part, ORIGIN, UPRIGHT, name)


@pytest.mark.parametrize("way", ["one", "list", "skip", "end", "lines"])
def test_nrrd_with_data_elsewhere(tmp_path, way):
    data, path = VALUES.tobytes("F"), tmp_path / "a.nhdr"
    slices = [VALUES[:, :, k].tobytes("F") for k in range(6)]
    for k, part in enumerate(slices):
        (tmp_path / f"s{k:02d}.raw").write_bytes(part)
    packed = {"skip": b"12345" + data, "end": b"12345" + data, "lines": b"a\nb\n" + data}
    (tmp_path / "a.raw").write_bytes(packed.get(way, data))
    listed = "".join(f"s{k:02d}.raw\n" for k in range(6))
    fields = {
        "one": {"data_file": "a.raw"},
        "list": {"data_file": f"LIST\n{listed}"},
        "skip": {"byte_skip": 5, "data_file": "a.raw"},
        "end": {"byte_skip": -1, "data_file": "a.raw"},
        "lines": {"line_skip": 2, "data_file": "a.raw"},
    }[way]
    path.write_text(nrrd_text(**fields))
    np.testing.assert_array_equal(vm.open(path).array("a"), VALUES)


@pytest.mark.parametrize("way", ["file", "list", "packed", "text", "end", "channels"])
def test_metaimage_with_data_in_every_way(tmp_path, way):
    head = {"NDims": "3", "DimSize": "4 5 6", "ElementType": "MET_SHORT"}
    named, data, values = "a.raw", VALUES.tobytes("F"), VALUES[..., None]
    for k in range(6):
        (tmp_path / f"s{k + 1}.raw").write_bytes(VALUES[:, :, k].tobytes("F"))
    if way == "list":
        named = "LIST\n" + "\n".join(f"s{k + 1}.raw" for k in range(6)) + "\n"
    if way == "packed":
        head["CompressedData"], data = "True", zlib.compress(data)
    if way == "text":
        head["BinaryData"], data = "False", " ".join(map(str, VALUES.ravel("F"))).encode()
    if way == "end":
        head["HeaderSize"], data = "-1", b"something before" + data
    if way == "channels":
        values = RNG.integers(0, 99, (4, 5, 6, 2)).astype(np.int16)
        head["ElementNumberOfChannels"], data = "2", values.transpose(2, 1, 0, 3).tobytes()
    (tmp_path / "a.raw").write_bytes(data)
    head["ElementDataFile"] = named
    path = tmp_path / "a.mhd"
    path.write_text("".join(f"{key} = {value}\n" for key, value in head.items()))
    volume = vm.open(path)
    assert len(volume.fields) == values.shape[3]
    for k, name in enumerate(volume.fields):
        np.testing.assert_array_equal(volume.array(name), values[..., k])


def test_nifti_scales_to_floats_only_where_it_must(tmp_path):
    nib = pytest.importorskip("nibabel")
    image = nib.Nifti1Image(VALUES, np.diag([-1.0, -1, 1, 1]))
    image.header.set_slope_inter(0.5, -3)
    nib.save(image, tmp_path / "scaled.nii")
    with open(tmp_path / "scaled.nii", "r+b") as file:  # nibabel writes the inverse
        file.seek(352)
        file.write(VALUES.tobytes("F"))
    volume = vm.open(tmp_path / "scaled.nii")
    assert volume.array("scaled").dtype == np.float32
    np.testing.assert_array_equal(volume.array("scaled"), 0.5 * VALUES - 3)
    np.testing.assert_array_equal(
        volume.array("scaled"), nib.load(tmp_path / "scaled.nii").get_fdata(dtype=np.float32)
    )


def test_nifti_vectors_and_colors(tmp_path):
    nib = pytest.importorskip("nibabel")
    parts = RNG.random((4, 5, 6, 1, 3)).astype(np.float32)
    image = nib.Nifti1Image(parts, np.diag([-1.0, -1, 1, 1]))
    image.header.set_intent("displacement vector")
    nib.save(image, tmp_path / "warp.nii")
    volume = vm.open(tmp_path / "warp.nii")
    for k, (name, sign) in enumerate(zip(("warp_x", "warp_y", "warp_z"), (-1, -1, 1), strict=True)):
        np.testing.assert_array_equal(volume.array(name), sign * parts[..., 0, k])
    colors = RNG.integers(0, 255, (4, 5, 6, 3)).astype(np.uint8)
    packed = colors.copy().view([("R", "u1"), ("G", "u1"), ("B", "u1")])[..., 0]
    nib.save(nib.Nifti1Image(packed, np.diag([-1.0, -1, 1, 1])), tmp_path / "rgb.nii")
    volume = vm.open(tmp_path / "rgb.nii")
    assert volume.fields == ("rgb_red", "rgb_green", "rgb_blue")
    np.testing.assert_array_equal(volume.array("rgb_green"), colors[..., 1])
