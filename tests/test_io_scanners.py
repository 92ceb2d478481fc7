"""Voxels of scanners: the right value at the right place, in all formats."""

import bz2
import gzip
import itertools
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import real_data
import voluminous as vm
from contracts import ReaderContract
from scanner_files import (
    DTYPES,
    ORIGIN,
    RNG,
    SAGITTAL,
    TO_RAS,
    UPRIGHT,
    VALUES,
    WIDTHS,
    centers,
    check_places,
    dicom_frames,
    nrrd_text,
    volume_of,
    write_dicom,
    write_metaimage,
    write_nifti,
    write_nrrd,
)
from voluminous.io.scanners.placement import Placement, arranged

ORIENTATIONS = [
    np.eye(3)[list(order)] * np.array(signs)[:, None]
    for order in itertools.permutations(range(3))
    for signs in itertools.product((1, -1), repeat=3)
]
quickly = settings(max_examples=40, deadline=None)


@pytest.mark.parametrize("turn", ORIENTATIONS)
def test_all_48_orientations_are_undone(turn):
    steps = UPRIGHT @ turn
    arrangement = arranged(VALUES.shape, Placement(ORIGIN, steps, "mm", "LPS"))
    assert arrangement.direction is None
    volume = vm.Volume(arrangement.grid, ct=arrangement.put(VALUES))
    check_places(volume, VALUES, ORIGIN, steps)


def rotation(q):
    a, b, c, d = q / np.linalg.norm(q)
    x = np.array([[0, -d, c], [d, 0, -b], [-c, b, 0]])
    return np.eye(3) + 2 * a * x + 2 * x @ x


@quickly
@given(
    q=arrays(float, 4, elements=st.floats(-1, 1)).filter(lambda q: np.linalg.norm(q) > 0.1),
    mirrored=st.booleans(),
)
def test_oblique_voxels_keep_their_axes_and_tell_where_they_truly_are(q, mirrored):
    steps = np.diag(WIDTHS * [1, 1, -1 if mirrored else 1]) @ rotation(q)
    shape = (10, 12, 14)
    arrangement = arranged(shape, Placement(ORIGIN, steps, "mm", "LPS"))
    index = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"))
    truth = ORIGIN[:, None, None, None] + np.tensordot(steps.T, index, 1)
    truth = np.stack([arrangement.put(x) for x in truth])
    here = np.stack(np.meshgrid(*centers(arrangement.grid), indexing="ij"))
    middle = arrangement.grid.bounds.mean(axis=1)[:, None, None, None]
    turn = np.eye(3) if arrangement.direction is None else arrangement.direction
    there = middle + np.tensordot(turn, here - middle, 1)
    # Without a direction a hundredth of a voxel per axis is let pass.
    limit = 1e-9 if arrangement.direction is not None else 0.03 * WIDTHS.max()
    assert np.max(abs(there - truth)) < limit
    np.testing.assert_allclose(turn.T @ turn, np.eye(3), atol=1e-12)
    # The nearest axes: no other choice of order and signs is nearer.
    best = max(np.trace(turn @ other) for other in ORIENTATIONS)
    assert np.trace(turn) > best - 1e-5


@pytest.mark.parametrize("steps", [UPRIGHT, SAGITTAL], ids=["axial", "sagittal"])
def test_the_same_voxels_lie_at_the_same_place_in_all_formats(tmp_path, steps):
    pytest.importorskip("nibabel")
    pytest.importorskip("nrrd")
    pytest.importorskip("pydicom")
    frames = dicom_frames(VALUES, ORIGIN, steps)
    frames.save_as(tmp_path / "frames.dcm", enforce_file_format=True)
    paths = [
        write_metaimage(tmp_path / "head.mha", VALUES, ORIGIN, steps),
        write_nifti(tmp_path / "sform.nii", VALUES, ORIGIN, steps),
        write_nifti(tmp_path / "qform.nii.gz", VALUES, ORIGIN, steps, qform=True),
        write_nifti(tmp_path / "pair.img", VALUES, ORIGIN, steps),
        write_nrrd(tmp_path / "lps.nrrd", VALUES, ORIGIN, steps),
        write_nrrd(tmp_path / "ras.nhdr", VALUES, ORIGIN, steps, space="right-anterior-superior"),
        write_dicom(tmp_path / "series", VALUES, ORIGIN, steps),
        tmp_path / "series" / "IM03",
        tmp_path / "frames.dcm",
    ]
    for path in paths:
        volume = vm.open(path)
        assert volume.meta["orientation"] == "LPS"
        assert volume.unit == "mm"
        assert volume.array(volume.fields[0]).dtype == np.int16
        check_places(volume, VALUES, ORIGIN, steps)


@quickly
@given(
    values=st.sampled_from([*DTYPES, np.int8, np.uint32, np.int64, np.uint64, np.bool_]).flatmap(
        lambda dtype: arrays(dtype, st.tuples(*[st.integers(1, 4)] * 3))
    ),
    ending=st.sampled_from(["mha", "mhd", "nrrd", "nii", "nii.gz"]),
    turned=st.booleans(),
)
def test_what_was_saved_comes_back(tmp_path_factory, values, ending, turned):
    volume = volume_of(values)
    volume.meta["orientation"] = "LPS"
    if turned:
        volume.meta["direction"] = rotation(np.array([0.9, 0.3, -0.1, 0.2])).tolist()
    path = tmp_path_factory.mktemp("saved") / f"density.{ending}"
    volume.save(path)
    again = vm.open(path)
    expected = values.astype(np.uint8) if values.dtype == np.bool_ else values
    assert again.fields == ("density",)
    assert again.array("density").dtype == expected.dtype
    np.testing.assert_array_equal(again.array("density"), expected)
    # NIfTI-1 keeps places in single precision.
    kept = 1e-6 if "nii" in ending else 1e-13
    np.testing.assert_allclose(again.grid.bounds, volume.grid.bounds, atol=60 * kept)
    assert again.meta["orientation"] == "LPS"
    # Few voxels may be turned by less than a hundredth of one: never here.
    assert ("direction" in again.meta) == turned
    if turned:
        np.testing.assert_allclose(again.meta["direction"], volume.meta["direction"], atol=kept)


@pytest.mark.parametrize("ending", ["mha", "nrrd", "nii"])
def test_a_patient_who_lies_another_way_is_written_in_lps(tmp_path, ending):
    volume = volume_of(VALUES)
    volume.meta["orientation"] = "SRP"  # z becomes y, x becomes z, and y becomes -x
    volume.save(tmp_path / f"a.{ending}")
    again = vm.open(tmp_path / f"a.{ending}")
    assert again.meta["orientation"] == "LPS"
    turned = volume.array("density").transpose(1, 2, 0)[::-1]
    np.testing.assert_array_equal(again.array(again.fields[0]), turned)
    low, high = volume.grid.bounds[[1, 2, 0]].T
    expected = np.array([[-high[0], low[1], low[2]], [-low[0], high[1], high[2]]]).T
    np.testing.assert_allclose(again.grid.bounds, expected, atol=1e-4)  # NIfTI: single precision


@pytest.mark.parametrize("ending", ["mha", "h5"])
def test_a_part_of_a_turned_scan_stays_where_it_was(tmp_path, ending):
    volume = volume_of(VALUES)
    volume.meta["orientation"] = "LPS"
    turn = rotation(np.array([0.9, 0.3, -0.1, 0.2]))
    volume.meta["direction"] = turn.tolist()
    edges = [e[k:] for k, e in enumerate(volume.grid.edges)]
    part = volume.resample(vm.CartesianGrid(*edges, unit=volume.unit))
    part.save(tmp_path / f"part.{ending}")
    again = vm.open(tmp_path / f"part.{ending}")
    assert again.meta["orientation"] == "LPS"

    def truly(one):
        """Return the true place of the last cell."""
        middle = one.grid.bounds.mean(axis=1)
        about = np.asarray(one.meta.get("direction_center", middle))
        return about + turn @ (one.grid.cell_centers()[:, -1] - about)

    np.testing.assert_allclose(truly(again), truly(volume), atol=1e-9)
    np.testing.assert_allclose(truly(part), truly(volume), atol=1e-9)


@pytest.mark.parametrize("ending", ["mha", "nrrd", "nii"])
def test_what_a_format_cannot_hold_is_refused(tmp_path, ending):
    two = volume_of(VALUES)
    two["other"] = "2 * density"
    uneven = vm.Volume(vm.CartesianGrid([0, 1, 3], [0, 1], [0, 1]), a=np.ones((2, 1, 1)))
    ball = vm.SphericalGrid([0, 1, 2])
    turned = volume_of(VALUES)
    turned.meta["direction"] = [1, 2, 3]
    for volume, told in [
        (two, "one field"),
        (turned, "3 x 3"),
        (uneven, "equal width"),
        (vm.Volume(ball, a=np.ones(ball.shape)), "Cartesian"),
    ]:
        with pytest.raises(vm.InputError, match=told):
            volume.save(tmp_path / f"x.{ending}")
    assert not list(tmp_path.iterdir())


def test_the_frog_is_read_as_it_is():
    expected = real_data.load("frog")
    path = real_data.data_directory() / "data" / "classic_small" / "frogtissue.mhd"
    volume = vm.open(path)
    assert volume.array("frogtissue").dtype == np.uint8
    np.testing.assert_array_equal(volume.array("frogtissue"), expected.array("tissue"))
    np.testing.assert_array_equal(np.ptp(volume.grid.bounds, axis=1), [500, 470, 204])


@pytest.mark.parametrize("steps", [UPRIGHT, SAGITTAL], ids=["upright", "sagittal"])
def test_itk_in_hdf5(tmp_path, steps):
    itk = pytest.importorskip("SimpleITK")
    image = itk.GetImageFromArray(VALUES.T)
    widths = np.linalg.norm(steps, axis=1)
    image.SetOrigin(ORIGIN.tolist())
    image.SetSpacing(widths.tolist())
    image.SetDirection((np.asarray(steps) / widths[:, None]).T.ravel().tolist())
    itk.WriteImage(image, str(tmp_path / "a.hdf5"))
    volume = vm.open(tmp_path / "a.hdf5")
    check_places(volume, VALUES, ORIGIN, steps)
    assert volume.array("a").dtype == VALUES.dtype
    assert (str(volume.unit), volume.meta["orientation"]) == ("mm", "LPS")
    parts = np.stack([VALUES, VALUES + 1, -VALUES], axis=-1).astype(np.float32)
    several = itk.GetImageFromArray(parts.transpose(2, 1, 0, 3), isVector=True)
    several.CopyInformation(image)
    itk.WriteImage(several, str(tmp_path / "v.hdf5"))
    check_places(vm.open(tmp_path / "v.hdf5"), parts[..., 1], ORIGIN, steps, "v_y")


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


@pytest.mark.parametrize("encoding", ["gzip", "bzip2"])
def test_packed_nrrd_is_unpacked_as_far_as_its_header_says(tmp_path, encoding):
    pytest.importorskip("nrrd")
    pack = {"gzip": gzip.compress, "bzip2": bz2.compress}[encoding]
    data, path = VALUES.tobytes("F"), tmp_path / "a.nrrd"
    head = nrrd_text(encoding=encoding, byte_skip=6).encode() + b"\n"
    packed = pack(b"before" + data)
    path.write_bytes(head + packed)
    np.testing.assert_array_equal(vm.open(path).array("a"), VALUES)
    for damaged in (pack(b"before" + data + b"more"), packed[:-9], packed[:-4] + b"0000"):
        path.write_bytes(head + damaged)
        with pytest.raises(vm.FileFormatError):
            vm.open(path)


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


@pytest.mark.parametrize("format", ["nrrd", "metaimage"])
@pytest.mark.parametrize(
    ("named", "sides"),
    [
        ("s%d.raw 1 6 1", 6),  # a file for each slice
        ("s%02d.raw 1 6 1 2", 6),  # and how many dimensions it has
        ("s%d.raw 10 0 -2 2", 6),
        ("s%03i.raw 7 9 1", 3),  # slabs of two slices
        ("s%d.raw 1 30 1 1", 30),  # a file for each row
        ("LIST 2", 6),
        ("a b %d.raw 1 6 1", 6),
    ],
)
def test_data_in_numbered_files(tmp_path, named, sides, format):
    if format == "nrrd":
        pytest.importorskip("nrrd")
    pattern, *numbers = named.rsplit(".raw")
    first, _, step = map(int, numbers[0].split()[:3]) if numbers else (1, 0, 1)
    data = VALUES.tobytes("F")
    size, names = len(data) // sides, []
    for k in range(sides):
        names += [f"{pattern}.raw" % (first + k * step) if numbers else f"f{k}.dat"]
        (tmp_path / names[-1]).write_bytes(data[k * size : (k + 1) * size])
    listed = "" if numbers else "\n" + "\n".join(names) + "\n"
    path = tmp_path / ("a.nhdr" if format == "nrrd" else "a.mhd")
    if format == "nrrd":
        path.write_text(nrrd_text(data_file=named + listed))
    else:
        head = "NDims = 3\nDimSize = 4 5 6\nElementType = MET_SHORT\n"
        path.write_text(f"{head}ElementDataFile = {named}{listed}\n")
    np.testing.assert_array_equal(vm.open(path).array("a"), VALUES)
    for broken in (names[-1], names[0]):
        (tmp_path / broken).unlink()
        with pytest.raises(vm.FileFormatError, match="there is no such file") as failure:
            vm.open(path)
        assert broken in str(failure.value)


@pytest.mark.parametrize(
    "named",
    ["s%d.raw 1 4 1", "s%d.raw 3 1 1", "s%999999999d.raw 1 6 1", "s%d.raw 1 6 0", "s%d"],
)
def test_numbered_files_that_make_no_volume(tmp_path, named):
    pytest.importorskip("nrrd")
    for k in range(1, 5):
        (tmp_path / f"s{k}.raw").write_bytes(VALUES.tobytes("F")[: 2 * 30])
    (tmp_path / "a.nhdr").write_text(nrrd_text(data_file=named))
    with pytest.raises(vm.FileFormatError, match=r"evenly|no such file|are no files|cut short"):
        vm.open(tmp_path / "a.nhdr")


def test_numbers_of_axes_say_which_are_in_space(tmp_path):
    """Teem leaves out kinds: an axis without a position is none in space."""
    pytest.importorskip("nrrd")
    parts = RNG.random((3, 4, 5, 2)).astype(np.float32)
    fields = {"dimension": 4, "sizes": "3 4 5 2", "type": "float"}
    limits = {"axis_mins": "nan 1 2 3", "axis_maxs": "nan 5 12 7"}
    for k, lines in enumerate((limits, {"spacings": "nan 1 2 2", "axis_mins": "NaN 1 2 3"})):
        path = tmp_path / f"v{k}.nrrd"
        path.write_bytes(nrrd_text(**fields, **lines).encode() + b"\n" + parts.tobytes("F"))
        volume = vm.open(path)
        assert volume.fields == tuple(f"v{k}_{axis}" for axis in "xyz")
        np.testing.assert_array_equal(volume.array(f"v{k}_y"), parts[1])
        np.testing.assert_allclose(volume.grid.bounds, [(1, 5), (2, 12), (3, 7)])
    last = {"axis_mins": "1 2 3 nan", "sizes": "3 4 5 2"}
    path.write_bytes(nrrd_text(**{**fields, **last}).encode() + b"\n" + parts.tobytes("F"))
    assert vm.open(path).fields == ("v1_0", "v1_1")
    np.testing.assert_array_equal(vm.open(path, time=1).array("v1"), parts[..., 1])


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


class TestNRRD(ReaderContract):
    @pytest.fixture
    def sample(self):
        def write(directory):
            volume_of(VALUES).save(directory / "density.nrrd")
            return directory / "density.nrrd"

        return write


class TestNIfTI(ReaderContract):
    options = {"time": 1}  # noqa: RUF012

    @pytest.fixture(params=["nii", "nii.gz"])
    def sample(self, request):
        nib = pytest.importorskip("nibabel")

        def write(directory):
            values = np.stack([VALUES, VALUES + 1], axis=-1)
            nib.save(nib.Nifti1Image(values, np.eye(4)), directory / f"t1.{request.param}")
            return directory / f"t1.{request.param}"

        return write


class TestMetaImage(ReaderContract):
    @pytest.fixture
    def sample(self):
        return lambda directory: write_metaimage(directory / "a.mha", VALUES, ORIGIN, SAGITTAL)
