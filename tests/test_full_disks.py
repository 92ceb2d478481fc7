"""Where a disk is full nothing is lost: the old file stays, no half of a new one, and it is told.

The system refuses to make files longer than a limit, as it does where there is no space.
"""

from __future__ import annotations

from contextlib import contextmanager

import numpy as np
import pytest

import voluminous as vm
from voluminous.cli import main
from voluminous.files import replacing

pytestmark = pytest.mark.exhaustive

resource = pytest.importorskip("resource")

SIZE = 512  # bytes: less than anything below takes


@contextmanager
def full_disk():
    """No file can be longer than a few bytes."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (SIZE, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.fixture(scope="module")
def volume():
    values = np.random.default_rng(1).random((12, 12, 12))
    return vm.Volume(vm.CartesianGrid.uniform(12, (0, 1), unit="pc"), density=values)


@pytest.fixture(scope="module")
def image(volume):
    return vm.render(volume, vm.Coefficients("density", 1), vm.Orthographic(30, 20, resolution=40))


def refused(write, place):
    """Assert that nothing in a directory changes, and the error names the file."""
    before = {path: path.read_bytes() for path in place.rglob("*") if path.is_file()}
    with full_disk(), pytest.raises(OSError, match=r"cannot save .*: there is no space left; make"):
        write()
    assert {path: path.read_bytes() for path in place.rglob("*") if path.is_file()} == before


@pytest.mark.parametrize("suffix", [".png", ".tif", ".exr", ".fits", ".npz"])
def test_images_stay(image, tmp_path, suffix):
    path = tmp_path / f"image{suffix}"
    path.write_bytes(b"what was there before")
    refused(lambda: image.save(path), tmp_path)


@pytest.mark.parametrize(
    "suffix", [".h5", ".npz", ".vti", ".fits", ".nii", ".nii.gz", ".nrrd", ".mha"]
)
def test_volumes_stay(volume, tmp_path, suffix):
    path = tmp_path / f"volume{suffix}"
    path.write_bytes(b"what was there before")
    refused(lambda: volume.save(path), tmp_path)


def test_a_model_of_radmc3d_is_replaced_as_a_whole_or_not_at_all(volume, tmp_path):
    place = tmp_path / "model"
    vm.io.radmc3d.write(vm.models.sphere(2), place, {"gas_density": "inside"})
    fields = vm.Volume(volume.grid, rho=volume.array("density"))
    options = {"fields": {"gas_density": "rho"}, "overwrite": True}
    refused(lambda: vm.io.radmc3d.write(fields, place, **options), tmp_path)
    vm.io.radmc3d.write(fields, place, **options)
    assert vm.open(place).grid.shape == (12, 12, 12)
    assert sorted(path.name for path in place.iterdir()) == ["amr_grid.inp", "gas_density.inp"]


def test_a_new_directory_is_not_left_behind(volume, tmp_path):
    fields = vm.Volume(volume.grid, gas_density=volume.array("density"))
    refused(lambda: fields.save(tmp_path / "model", format="radmc3d"), tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", [".csv", ".pdf"])
def test_probes_stay(volume, tmp_path, suffix):
    found = vm.probe(
        volume, vm.Coefficients("density", 1), vm.Orthographic(30, 20, resolution=9), (4, 4)
    )
    path = tmp_path / f"probe{suffix}"
    path.write_bytes(b"what was there before")
    refused(lambda: found.save(path), tmp_path)


@pytest.mark.parametrize("suffix", [".png", ".exr"])
def test_the_command_line_tells_it(volume, tmp_path, capsys, suffix):
    volume.save(tmp_path / "cube.h5")
    out = tmp_path / f"image{suffix}"
    arguments = [str(tmp_path / "cube.h5"), "-o", str(out), "-q", "--set", "camera.resolution=30"]
    with full_disk():
        assert main(["render", *arguments]) == 2
    assert f"error: cannot save {out}: there is no space left" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["cube.h5"]


def test_other_errors_stay_as_they_are(tmp_path):
    for error in (FileNotFoundError(2, "No such file"), KeyError("x"), KeyboardInterrupt()):
        with pytest.raises(type(error)) as caught, replacing(tmp_path / "a.png"):
            raise error
        assert caught.value is error
    assert not list(tmp_path.iterdir())
