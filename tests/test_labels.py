"""Labels of segmentations: their medium, their tables, and volumes of several files."""

from __future__ import annotations

import argparse

import numpy as np
import pytest

import scanner_files
import voluminous as vm
from voluminous.cli import main
from voluminous.cli.view import _series
from voluminous.scene import settings

GRID = vm.CartesianGrid.uniform(16, (0, 16), unit="mm")
COLORS = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
ACROSS = vm.Orthographic(90, 0, width=16, resolution=16)


def organs():
    """Return labels 1 and 9 side by side, and nowhere the 5 between them."""
    values = np.zeros(GRID.shape, np.uint8)
    values[2:8, 4:12, 2:14], values[8:14, 4:12, 2:14] = 1, 9
    return vm.Volume(GRID, organ=values)


@pytest.mark.parametrize("scheme", [None, "first-order"])
def test_between_two_labels_lies_no_third(scheme):
    medium = vm.Labels("organ", [1, 5, 9], colors=COLORS, opacities=0.5, path_length=4, shading=0)
    image = vm.render(organs(), medium, ACROSS, scheme=scheme)
    assert image.provenance["scheme"] == (scheme or "second-order")
    assert image.intensity[..., 1].max() == 0.0
    assert image.intensity[..., 0].max() > 0.5
    assert image.intensity[..., 2].max() > 0.5
    # Eight cells of 1 mm, of which 4 mm take half of the light.
    inside = image.transparency[8, 5]
    np.testing.assert_allclose(inside, 0.25, rtol=1e-5)


def test_a_hidden_label_is_an_absent_one_and_others_are_lit():
    both = vm.Labels("organ", [1, 9], visible=[True, False], path_length=4)
    alone = vm.Labels("organ", [1], path_length=4)
    images = [vm.render(organs(), medium, ACROSS) for medium in (both, alone)]
    np.testing.assert_array_equal(images[0].intensity, images[1].intensity)


def test_media_beside_labels_are_not_interpolated_either():
    medium = vm.Labels("organ", [1, 9]) + vm.Rectangle("organ", 9, 0.5, [1, 1, 1], 0.3)
    assert medium.discrete


def test_labels_go_through_a_scene():
    volume = organs()
    volume.meta["labels"] = {"organ": [{"number": 9, "name": 'a "b"', "color": [0.1, 0.2, 0.3]}]}
    medium = vm.presets.labels(volume)
    assert medium.labels == ["1", 'a "b"']
    scene = vm.Scene({"volume": {"path": "a.nii"}, "medium": medium}, volume=volume)
    text = scene.dumps()
    again = vm.Scene(settings.loads(text))
    assert again.medium.key() == medium.key()
    assert again.medium.labels == medium.labels


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"numbers": [1, 1]}, "no other has"),
        ({"numbers": [0.5]}, "whole numbers"),
        ({"opacities": [0.5, 2]}, "from 0 to 1"),
        ({"labels": ["a"]}, "one for each number"),
        ({"visible": [1, 0]}, "for each label"),
    ],
)
def test_wrong_tables_are_refused(changes, words):
    with pytest.raises(vm.InputError, match=words):
        vm.Labels("organ", **{"numbers": [1, 9], **changes})


SLICER = "# table\n0 Background 0 0 0 0\n1 left_lung 255 0 51 127\n9 liver 0 255 0 255\n"
FREESURFER = "#No. Label R G B A\n0 Unknown 0 0 0 0\n1 left_lung 255 0 51 0\n9 liver 0 255 0 0\n"
SNAP = '0 0 0 0 0 0 0 "Clear"\n1 255 0 51 0.5 0 1 "left lung"\n9 0 255 0 1 1 1 "liver"\n'
FSL = "1 1.0 0.0 0.2 left lung\n9 0 1 0 liver\n"


@pytest.mark.parametrize(
    ("name", "text", "opacity", "visible"),
    [
        ("a.ctbl", SLICER, 127 / 255, True),
        ("a.lut", FREESURFER, 1.0, True),
        ("a.label", SNAP, 0.5, False),
        ("b.label", "\ufeff" + SNAP.replace("liver", "liver #2"), 0.5, False),
        ("a.lut", FSL, 1.0, True),
    ],
)
def test_tables_of_labels(tmp_path, name, text, opacity, visible):
    organs().save(tmp_path / "organ.nii.gz")
    (tmp_path / name).write_text(text)
    volume = vm.open([tmp_path / "organ.nii.gz", tmp_path / name])
    lung, liver = volume.meta["labels"]["organ"]
    assert lung == {
        "number": 1,
        "name": "left lung",
        "color": [1.0, 0.0, 0.2],
        "opacity": opacity,
        "visible": visible,
    }
    seen = liver["number"], liver["name"].removesuffix(" #2"), liver["color"]
    assert seen == (9, "liver", [0.0, 1.0, 0.0])


def test_what_is_no_table_is_refused(tmp_path):
    organs().save(tmp_path / "organ.nii.gz")
    (tmp_path / "a.ctbl").write_text("1 liver 255 0\n")
    with pytest.raises(vm.FileFormatError, match="line 1: expected a label's number"):
        vm.open([tmp_path / "organ.nii.gz", tmp_path / "a.ctbl"])


def test_segments_of_slicer_have_their_names(tmp_path):
    nrrd = pytest.importorskip("nrrd")
    header = {"space": "left-posterior-superior", "space directions": np.eye(3)}
    header |= {"kinds": ["domain"] * 3, "space origin": [0, 0, 0]}
    header |= {"Segment0_ID": "S1", "Segment0_Name": "liver", "Segment0_Color": "0.9 0.5 0.4"}
    header |= {"Segment0_LabelValue": "9", "Segment0_Layer": "0"}
    nrrd.write(str(tmp_path / "a.seg.nrrd"), organs().array("organ"), header)
    medium = vm.presets.labels(vm.open(tmp_path / "a.seg.nrrd"))
    assert (medium.numbers, medium.labels) == ([1, 9], ["1", "liver"])
    assert medium.describe()["colors"][1] == [0.9, 0.5, 0.4]


# --- several files ------------------------------------------------------------------------------


def test_files_of_one_grid_are_one_volume_and_one_scene(tmp_path):
    ct = vm.Volume(GRID, ct=np.arange(16**3, dtype=np.int16).reshape(GRID.shape))
    ct.save(tmp_path / "ct.nrrd")
    organs().save(tmp_path / "seg.nii.gz")
    files = [str(tmp_path / name) for name in ("ct.nrrd", "seg.nii.gz")]
    volume = vm.open(files)
    assert volume.fields == ("ct", "seg")
    assert volume["seg"].dtype == np.uint8
    np.testing.assert_array_equal(volume["seg"], organs()["organ"])
    assert "one volume of 2 files: ct, seg" in volume.meta["notes"]
    for order in (files, files[::-1]):
        assert vm.presets.recognised(vm.open(order))[0][0] == "labels"
    # As the command line has it: the picture carries both files.
    picture = tmp_path / "a.png"
    set_ = ["--set", "camera.resolution=8"]
    assert main(["render", *files, *set_, "-o", str(picture), "-q"]) == 0
    scene = vm.Scene.load(picture)
    assert scene.to_dict()["volume"]["path"] == ["ct.nrrd", "seg.nii.gz"]
    assert scene.medium.labels == ["1", "9"]
    np.testing.assert_array_equal(scene.volume()["seg"], volume["seg"])


def test_another_grid_is_resampled_in_the_patient(tmp_path):
    """Cells of an oblique scan are those at the same true place; values linear in it are exact."""
    steps = scanner_files.UPRIGHT
    turn, angle = np.eye(3), np.deg2rad(20)
    turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    first = np.zeros((40, 40, 14), np.int16)
    scanner_files.write_nifti(tmp_path / "a.nii", first, np.array([-10.0, -14.0, -13.0]), steps)
    shape, other = (40, 40, 24), np.diag([0.6, 0.7, 1.1]) @ turn.T
    origin = -(np.array(shape) - 1) / 2 @ other
    index = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1)
    place = origin + index @ other
    ramp = (place @ [1.0, 2.0, -0.5]).astype(np.float32)
    part = (np.floor(place[..., 0] / 3) % 2 + 1).astype(np.uint8)
    scanner_files.write_nifti(tmp_path / "ramp.nii", ramp, origin, other)
    scanner_files.write_nifti(tmp_path / "part.nii", part, origin, other)
    volume = vm.open([tmp_path / name for name in ("a.nii", "ramp.nii", "part.nii")])
    centers = volume.grid.cell_centers(0, volume.grid.size).T.reshape(*volume.grid.shape, 3)
    inside = np.isfinite(volume["ramp"])
    assert 0.5 < inside.mean() < 1.0
    truth = centers @ [1.0, 2.0, -0.5]
    # Beyond the outermost centres, half a cell wide, the field is constant.
    error = np.abs(volume["ramp"] - truth)[inside]
    assert np.quantile(error, 0.8) < 1e-4
    assert error.max() < 0.5 * (0.6 + 2 * 0.7 + 0.5 * 1.1)
    # The nearest cell is at most half a cell away.
    parts = volume["part"][inside]
    assert set(np.unique(parts)) == {1, 2}
    away = np.abs((centers[..., 0][inside] + 1.5) % 3 - 1.5)
    assert np.all((parts == np.floor(centers[..., 0][inside] / 3) % 2 + 1) | (away < 0.6))
    assert not volume["part"][~inside].any()
    assert "resampled onto the 40 × 40 × 14 of a.nii" in volume.meta["notes"][1]


def test_volumes_apart_and_of_other_grids_are_refused(tmp_path):
    scanner_files.write_nifti(tmp_path / "a.nii", organs().array("organ"), np.zeros(3), np.eye(3))
    far = np.array([500.0, 0, 0])
    scanner_files.write_nifti(tmp_path / "b.nii", organs().array("organ"), far, np.eye(3))
    with pytest.raises(vm.InputError, match=r"do not overlap: x from 499\.5 to 515\.5"):
        vm.open([tmp_path / "a.nii", tmp_path / "b.nii"])
    grid = vm.SphericalGrid([1, 2, 3], [0, np.pi], [0, 2 * np.pi])
    vm.Volume(grid, rho=np.ones(grid.shape)).save(tmp_path / "disc.h5")
    with pytest.raises(vm.InputError, match="another grid"):
        vm.open([tmp_path / "a.nii", tmp_path / "disc.h5"])
    with pytest.raises(vm.InputError, match="expected a file with a volume"):
        vm.open([])


def test_numbered_files_are_a_series_and_others_are_not(tmp_path):
    for k in range(3):
        vm.Volume(GRID, rho=np.full(GRID.shape, float(k))).save(tmp_path / f"ts_{k}.npz")
        organs().save(tmp_path / f"scan{k}.nii.gz")
    organs().save(tmp_path / "seg.nii.gz")

    def series(*names, over=None):
        files = [tmp_path / name for name in names]
        args = argparse.Namespace(
            scene=files[0], more=files[1:], over=over, format=None, quiet=True, set=[]
        )
        return [path.name for path in _series(args)], args.set

    assert series("ts_0.npz", "ts_1.npz")[0] == ["ts_0.npz", "ts_1.npz"]
    # Fields that are called as their files are called alike.
    assert series("scan0.nii.gz", "scan1.nii.gz") == (
        ["scan0.nii.gz", "scan1.nii.gz"],
        ["name=scan"],
    )
    assert series("scan0.nii.gz", "seg.nii.gz")[0] == []
    assert series("scan0.nii.gz", "seg.nii.gz", over="")[0] == ["scan0.nii.gz", "seg.nii.gz"]
    assert len(series("ts_0.npz", over=str(tmp_path / "ts_*.npz"))[0]) == 3
    with pytest.raises(vm.InputError, match="there are no files"):
        series("ts_0.npz", over="none_*.npz")


def test_labels_larger_than_memory_are_drawn_cell_by_cell(tmp_path):
    organs().save(tmp_path / "organ.zarr", chunks=8)
    volume = vm.open(tmp_path / "organ.zarr")
    medium = vm.Labels("organ", [1, 9], colors=COLORS[:2], path_length=4, shading=0)
    image = vm.render(volume, medium, ACROSS, memory="200 MiB")
    assert image.provenance["scheme"] == "first-order"
    whole = vm.render(organs(), medium, ACROSS, scheme="first-order")
    np.testing.assert_allclose(image.intensity, whole.intensity, atol=1e-6)
