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


@pytest.mark.parametrize(
    ("kind", "endings"),
    [("vector", "xyz"), ("RGB-color", ("red", "green", "blue")), ("list", "012")],
)
@pytest.mark.parametrize("axis", [0, 1, 3])
def test_nrrd_components(tmp_path, kind, endings, axis):
    nrrd = pytest.importorskip("nrrd")
    parts = RNG.random((3, 4, 5, 6)).astype(np.float32)
    kinds = ["domain"] * 3
    kinds.insert(axis, kind)
    spacings = [2.0] * 3
    spacings.insert(axis, np.nan)
    path = tmp_path / "v.nrrd"
    nrrd.write(str(path), np.moveaxis(parts, 0, axis), {"kinds": kinds, "spacings": spacings})
    volume = vm.open(path)
    assert volume.fields == tuple(f"v_{ending}" for ending in endings)
    for name, part in zip(volume.fields, parts, strict=True):
        np.testing.assert_array_equal(volume.array(name), part)
    np.testing.assert_array_equal(volume.grid.bounds[:, 0], -1.0)


@pytest.mark.parametrize(
    ("count", "dtype", "endings"),
    [
        (1, "f4", ("",)),
        (2, "f4", ("_0", "_1")),
        (3, "f4", ("_x", "_y", "_z")),
        (3, "u1", ("_red", "_green", "_blue")),
        (4, "u1", ("_red", "_green", "_blue", "_alpha")),
    ],
)
@pytest.mark.parametrize("axis", [0, 3])
def test_a_short_axis_without_a_kind_is_components(tmp_path, count, dtype, endings, axis):
    nrrd = pytest.importorskip("nrrd")
    parts = RNG.integers(0, 255, (count, 5, 6, 7)).astype(dtype)
    nrrd.write(str(tmp_path / "v.nrrd"), np.moveaxis(parts, 0, axis))
    volume = vm.open(tmp_path / "v.nrrd")
    assert volume.fields == tuple(f"v{ending}" for ending in endings)
    for name, part in zip(volume.fields, parts, strict=True):
        np.testing.assert_array_equal(volume.array(name), part)


def test_four_axes_of_which_nothing_is_told(tmp_path):
    nrrd = pytest.importorskip("nrrd")
    values = RNG.random((5, 6, 7, 8)).astype(np.float32)
    path = tmp_path / "v.nrrd"
    nrrd.write(str(path), values)
    with pytest.raises(vm.InputError, match=r"four axes.*one of its 8 steps with time=0.*kinds:"):
        vm.open(path)
    volume = vm.open(path, time=-1)
    np.testing.assert_array_equal(volume.array("v"), values[..., 7])
    assert volume.meta["times"] == 8
    # A user who knows better than the sizes.
    nrrd.write(str(path), values[..., :3])
    np.testing.assert_array_equal(vm.open(path, time=1).array("v"), values[..., 1])
    nrrd.write(str(path), values[:4, :3, :4, :3])  # either could be
    with pytest.raises(vm.InputError, match="four axes"):
        vm.open(path)


@pytest.mark.parametrize("space", ["4", "left-posterior-superior-time", "LPST"])
def test_nrrd_in_space_and_time(tmp_path, space):
    values = RNG.random((4, 5, 6, 3)).astype(np.float32)
    told = f"space dimension: {space}" if space == "4" else f"space: {space}"
    lines = [
        *("NRRD0004", "type: float", "dimension: 4", told, "sizes: 4 5 6 3", "endian: little"),
        "space directions: (0.5,0,0,0) (0,0.75,0,0) (0,0,2,0) (0,0,0,9)",
        *("kinds: domain domain domain domain", "space origin: (-10,20,30,7)", "encoding: raw"),
    ]
    path = tmp_path / "v.nrrd"
    path.write_bytes("\n".join(lines).encode() + b"\n\n" + values.tobytes("F"))
    volume = vm.open(path, time=2)
    np.testing.assert_array_equal(volume.array("v"), values[..., 2])
    np.testing.assert_allclose(volume.grid.bounds[:, 0], [-10.25, 19.625, 29])
    assert volume.meta.get("orientation") == (None if space == "4" else "LPS")
    path.write_bytes(path.read_bytes().replace(b"(0,0,2,0)", b"(0,0,2,1)"))
    with pytest.raises(vm.FileFormatError, match="along space or time"):
        vm.open(path)


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


def test_nrrd_places_by_spacings_minima_and_units(tmp_path):
    path = tmp_path / "a.nrrd"
    placed = {"spacings": "1 2 3", "axis_mins": "10 20 30", "centers": "cell node cell"}
    units = {"units": '"mm" "um" "mm"'}
    head = nrrd_text(**placed, **units)
    path.write_bytes(head.encode() + b"\n" + VALUES.tobytes("F"))
    grid = vm.open(path).grid
    np.testing.assert_allclose(grid.bounds, [[10, 14], [0.019, 0.029], [30, 48]], rtol=1e-12)
    assert grid.unit == "mm"


@pytest.mark.parametrize("way", ["one", "list", "pattern", "skip", "end", "lines"])
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
        "pattern": {"data_file": "s%02d.raw 0 5 1"},
        "skip": {"byte_skip": 5, "data_file": "a.raw"},
        "end": {"byte_skip": -1, "data_file": "a.raw"},
        "lines": {"line_skip": 2, "data_file": "a.raw"},
    }[way]
    path.write_text(nrrd_text(**fields))
    np.testing.assert_array_equal(vm.open(path).array("a"), VALUES)


@pytest.mark.parametrize("way", ["file", "list", "pattern", "packed", "text", "end", "channels"])
def test_metaimage_with_data_in_every_way(tmp_path, way):
    head = {"NDims": "3", "DimSize": "4 5 6", "ElementType": "MET_SHORT"}
    named, data, values = "a.raw", VALUES.tobytes("F"), VALUES[..., None]
    for k in range(6):
        (tmp_path / f"s{k + 1}.raw").write_bytes(VALUES[:, :, k].tobytes("F"))
    if way == "list":
        named = "LIST\n" + "\n".join(f"s{k + 1}.raw" for k in range(6)) + "\n"
    if way == "pattern":
        named = "s%d.raw 1 6 1"
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


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("order", ["<", ">"])
def test_nifti_of_both_versions_and_orders(tmp_path, dtype, version, order):
    nib = pytest.importorskip("nibabel")
    kind = nib.Nifti1Image if version == 1 else nib.Nifti2Image
    values = VALUES.astype(dtype)
    header = kind.header_class(endianness=order)
    header.set_data_dtype(dtype)
    nib.save(kind(values, np.diag([1.0, 2, 3, 1]), header), tmp_path / "t1.nii")
    volume = vm.open(tmp_path / "t1.nii")
    assert volume.array("t1").dtype == dtype
    # To the left and to the back is backwards in RAS.
    np.testing.assert_array_equal(volume.array("t1"), values[::-1, ::-1])


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


@pytest.mark.parametrize("ending", ["nii", "nii.gz"])
def test_nifti_time_steps(tmp_path, ending):
    nib = pytest.importorskip("nibabel")
    series = RNG.random((4, 5, 6, 3)).astype(np.float32)
    nib.save(nib.Nifti1Image(series, np.diag([-1.0, -1, 1, 1])), tmp_path / f"bold.{ending}")
    for time, step in [(None, 0), (2, 2), (-1, 2)]:
        options = {} if time is None else {"time": time}
        volume = vm.open(tmp_path / f"bold.{ending}", **options)
        np.testing.assert_array_equal(volume.array("bold"), series[..., step])
        assert (volume.meta["times"], volume.meta["time_step"]) == (3, step)
    for wrong in (3, -4, 1.5, True, "1"):
        with pytest.raises(vm.InputError, match="time"):
            vm.open(tmp_path / f"bold.{ending}", time=wrong)


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


def test_nifti_without_orientation_has_no_space(tmp_path):
    nib = pytest.importorskip("nibabel")
    image = nib.Nifti1Image(VALUES, None)
    image.header.set_zooms((1, 2, 3))
    image.header.set_xyzt_units("micron")
    image.set_sform(None, code=0)
    image.set_qform(None, code=0)
    nib.save(image, tmp_path / "cell.nii")
    volume = vm.open(tmp_path / "cell.nii")
    assert "orientation" not in volume.meta
    assert volume.unit == "um"
    np.testing.assert_array_equal(volume.array("cell"), VALUES)
    np.testing.assert_array_equal(volume.grid.bounds, [[-0.5, 3.5], [-1, 9], [-1.5, 16.5]])


@pytest.mark.parametrize(
    ("lines", "orientation"),
    [
        ("AnatomicalOrientation = RAI\nTransformMatrix = 1 0 0 0 1 0 0 0 1\n", "LPS"),
        ("AnatomicalOrientation = ASL\nTransformMatrix = 0 1 0 0 0 -1 -1 0 0\n", "LPS"),
        ("AnatomicalOrientation = RAI\n", "LPS"),
        ("AnatomicalOrientation = ILP\n", None),  # which ends are meant, nobody says
        ("AnatomicalOrientation = ???\nTransformMatrix = 1 0 0 0 1 0 0 0 1\n", None),
        ("TransformMatrix = 1 0 0 0 1 0 0 0 1\n", None),
    ],
)
def test_metaimages_are_patients_where_they_say_so(tmp_path, lines, orientation):
    head = "ObjectType = Image\nNDims = 3\nDimSize = 2 2 2\nElementType = MET_UCHAR\n"
    path = tmp_path / "scan.mha"
    path.write_bytes(f"{head}{lines}ElementDataFile = LOCAL\n".encode() + bytes(range(8)))
    volume = vm.open(path)
    assert volume.meta.get("orientation") == orientation
    volume.save(tmp_path / "again.mha")
    assert vm.open(tmp_path / "again.mha").meta.get("orientation") == orientation


@pytest.mark.parametrize(
    ("fields", "bounds"),
    [
        # Walls of cells: 4, 5 and 6 of them between these positions.
        ({"centers": "cell cell cell"}, [(0, 8), (10, 15), (-3, 3)]),
        ({"centerings": "cell cell cell"}, [(0, 8), (10, 15), (-3, 3)]),
        ({}, [(0, 8), (10, 15), (-3, 3)]),  # Teem's default
        # First and last nodes: cells reach half a step beyond.
        ({"centers": "node node node"}, [(-4 / 3, 28 / 3), (9.375, 15.625), (-3.6, 3.6)]),
        ({"centers": "node cell ???"}, [(-4 / 3, 28 / 3), (10, 15), (-3, 3)]),
        ({"centers": "node cell cell", "spacings": "2 3 4"}, [(-1, 7), (10, 25), (-3, 21)]),
        ({"axis_mins": "nan nan nan", "spacings": "2 3 4"}, [(0, 8), (0, 15), (-21, 3)]),
    ],
)
def test_nrrd_axes_between_positions(tmp_path, fields, bounds):
    fields = {"axis_mins": "0 10 -3", "axis_maxs": "8 15 3"} | fields
    path = tmp_path / "box.nrrd"
    path.write_bytes(nrrd_text(**fields).encode() + b"\n" + VALUES.tobytes("F"))
    volume = vm.open(path)
    np.testing.assert_allclose(volume.grid.bounds, bounds, atol=1e-12)
    np.testing.assert_array_equal(volume.array("box"), VALUES)


def test_nrrd_axes_that_run_backwards_are_flipped(tmp_path):
    path = tmp_path / "box.nrrd"
    head = nrrd_text(axis_mins="8 10 -3", axis_maxs="0 15 3", centers="cell cell cell")
    path.write_bytes(head.encode() + b"\n" + VALUES.tobytes("F"))
    volume = vm.open(path)
    np.testing.assert_allclose(volume.grid.bounds, [(0, 8), (10, 15), (-3, 3)])
    np.testing.assert_array_equal(volume.array("box"), VALUES[::-1])


def test_nrrd_axes_with_a_range_in_place_of_a_spacing(tmp_path):
    head = (
        "NRRD0004\ntype: uint8\ndimension: 3\nsizes: 2 3 4\nencoding: raw\n"
        "axis mins: nan 0 1\naxis maxs: nan 3 9\nspacings: 1 nan nan\n\n"
    )
    (tmp_path / "a.nrrd").write_bytes(head.encode() + bytes(range(24)))
    ends = [(edges[0], edges[-1]) for edges in vm.open(tmp_path / "a.nrrd").grid.edges]
    np.testing.assert_allclose(ends, [(-0.5, 1.5), (0, 3), (1, 9)])
