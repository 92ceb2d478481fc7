"""MINC, MGH, AFNI, PAR/REC and Analyze: voxel by voxel where nibabel says they are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import voluminous as vm
from scanner_files import check_places
from voluminous.io import find_reader

nibabel = pytest.importorskip("nibabel")
SAMPLES = Path(nibabel.__file__).parent / "tests" / "data"
FILES = {
    "tiny.mnc": "minc",
    "small.mnc": "minc",
    "minc1_4d.mnc": "minc",
    "minc2_4d.mnc": "minc",
    "minc2-4d-d.mnc": "minc",
    "minc2_1_scale.mnc": "minc",
    "test.mgz": "mgh",
    "example4d+orig.HEAD": "afni",
    "example4d+orig.BRIK.gz": "afni",
    "scaled+tlrc.BRIK": "afni",
    "phantom_varscale.PAR": "parrec",
    "phantom_varscale.REC": "parrec",
}


@pytest.mark.filterwarnings("ignore::ResourceWarning")
@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("time", [0, -1])
def test_voxels_are_where_nibabel_says(name, time):
    path = SAMPLES / name
    if not path.is_file():
        pytest.skip("nibabel was installed without its samples")
    assert find_reader(path).name == FILES[name]
    volume = vm.open(path, time=time)
    image = nibabel.load(path)
    values = np.asarray(image.dataobj)
    if values.ndim == 4:
        values = np.take(values, time, axis=0 if name.endswith(".mnc") else 3)
    got = volume.array(volume.fields[0])
    middle = volume.grid.bounds.mean(axis=1)
    direction = np.array(volume.meta.get("direction", np.eye(3)))
    assert volume.meta["orientation"] == "LPS"
    assert volume.unit == "mm"
    rng = np.random.default_rng(1)
    for _ in range(50):
        index = tuple(rng.integers(n) for n in values.shape)
        lps = (image.affine @ [*index, 1])[:3] * [-1, -1, 1]
        inside = middle + np.linalg.solve(direction, lps - middle)
        cell = tuple(
            int(np.searchsorted(edges, x)) - 1
            for edges, x in zip(volume.grid.edges, inside, strict=True)
        )
        assert got[cell] == pytest.approx(values[index], rel=1e-6)


def write_minc2(path: Path) -> Path:
    """Stored numbers 0 … 100 that stand for -1 … 3, slices of z, in steps of 2, 3 and -4 mm."""
    import h5py

    with h5py.File(path, "w") as file:
        dimensions = file.create_group("minc-2.0/dimensions")
        for name, start, step in (("xspace", 5, 2), ("yspace", 6, 3), ("zspace", 7, -4)):
            item = dimensions.create_dataset(name, data=0)
            item.attrs["start"], item.attrs["step"] = float(start), float(step)
            item.attrs["direction_cosines"] = [float(name[0] == axis) for axis in "xyz"]
        image = file.create_group("minc-2.0/image/0")
        stored = np.arange(24, dtype=np.int16).reshape(2, 3, 4) * 4
        item = image.create_dataset("image", data=stored)
        item.attrs["dimorder"] = np.bytes_("zspace,yspace,xspace")
        item.attrs["valid_range"] = [0.0, 100.0]
        image.create_dataset("image-min", data=-1.0)
        image.create_dataset("image-max", data=3.0)
    return path


def test_minc_in_hdf5_has_axes_widths_and_true_values(tmp_path):
    path = write_minc2(tmp_path / "head.h5")  # its content tells, not its name
    volume = vm.open(path)
    values = -1 + 4 * np.arange(24).reshape(2, 3, 4) / 25
    # World coordinates are RAS: x and y change sign. The second slice lies below the first.
    steps = np.array([[0, 0, -4.0], [0, -3.0, 0], [-2.0, 0, 0]])
    check_places(volume, values.astype(np.float32), np.array([-5.0, -6.0, 7.0]), steps)
    assert volume.grid.shape == (4, 3, 2)
