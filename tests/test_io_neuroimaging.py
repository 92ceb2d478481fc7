"""MINC, MGH, AFNI, PAR/REC and Analyze: voxel by voxel where nibabel says they are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import voluminous as vm
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
