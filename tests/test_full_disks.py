"""Where a disk is full nothing is lost: the old file stays, no half of a new one, and it is told.

The system refuses to make files longer than a limit, as it does where there is no space.
"""

from __future__ import annotations

import errno
import functools
import os
import re
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import numpy as np
import pytest

import voluminous as vm
from voluminous.cli import main
from voluminous.files import new_directory, replacing
from voluminous.image.formats import FORMATS
from voluminous.io.registry import READERS

resource = pytest.importorskip("resource")

NO_SPACE = r"cannot save .*: there is no space left; make"
# Bytes: less than anything below takes; and more than the headers and the buffers of libraries.
SIZE, LATER = 512, 20_000


@contextmanager
def full_disk(size=SIZE):
    """No file can be longer than a few bytes."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.fixture(scope="module")
def volume():
    values = np.random.default_rng(1).random((24, 24, 24))
    return vm.Volume(vm.CartesianGrid.uniform(24, (0, 1), unit="pc"), density=values)


@pytest.fixture(scope="module")
def image(volume):
    return vm.render(volume, vm.Coefficients("density", 1), vm.Orthographic(30, 20, resolution=40))


def refused(write, place, size=SIZE):
    """Assert that nothing in a directory changes, and the error names the file."""
    before = {path: path.read_bytes() for path in place.rglob("*") if path.is_file()}
    with (
        full_disk(size),
        pytest.raises(OSError, match=r"cannot save .*: there is no space left; make"),
    ):
        write()
    assert {path: path.read_bytes() for path in place.rglob("*") if path.is_file()} == before


@pytest.mark.parametrize("suffix", sorted({s for f in FORMATS for s in f.suffixes}))
def test_images_stay(image, tmp_path, suffix):
    path = tmp_path / f"image{suffix}"
    path.write_bytes(b"what was there before")
    options = {"wavelengths": ["1 mm"]} if suffix in (".out", ".bout") else {}
    refused(lambda: image.save(path, **options), tmp_path, 64)  # a .jpg has 400


WRITERS = {s: r for r in READERS if r.writes for s in r.write_suffixes or r.suffixes}


@pytest.mark.parametrize("size", [SIZE, LATER])
@pytest.mark.parametrize("suffix", WRITERS)
def test_volumes_stay(volume, tmp_path, suffix, size):
    """Later on libraries tell it in other ways: NumPy's ``tofile`` has no number, VTK no reason."""
    path = tmp_path / f"volume{suffix}"
    directory = WRITERS[suffix].writes_directory
    if not directory:
        path.write_bytes(b"what was there before")
    refused(lambda: volume.save(path), tmp_path, size)
    assert len(list(tmp_path.iterdir())) == (not directory)


@pytest.mark.parametrize("suffix", [".fits", ".ecsv"])
def test_spectra_stay(volume, tmp_path, suffix):
    gas = vm.FreeFree("density * 1e4 cm**-3", temperature="8000 K")
    options = {"wavelengths": ["1 cm", "2 cm"], "distance": "1 kpc"}
    spectrum = vm.spectrum(volume, gas, vm.Orthographic(30, 20, resolution=4), **options)
    path = tmp_path / f"spectrum{suffix}"
    path.write_bytes(b"what was there before")
    refused(lambda: spectrum.save(path), tmp_path)


@pytest.mark.parametrize("suffix", [".gif", ".webp", ".mp4"])
def test_films_stay_and_go_on_with_the_frames_that_are_made(volume, tmp_path, suffix):
    if suffix == ".mp4":
        pytest.importorskip("av")
    cameras = vm.orbit(vm.Orthographic(60, 0, resolution=8), turns=1, frames=12)
    path = tmp_path / f"film{suffix}"
    path.write_bytes(b"what was there before")
    film = functools.partial(vm.movie, volume, vm.Coefficients("density", 1), cameras, path)
    # Dr.Jit keeps what it compiles in files, too, which is not what this is about.
    vm.movie(volume, vm.Coefficients("density", 1), cameras, tmp_path / "before.png")
    with full_disk(64), pytest.raises(OSError, match=NO_SPACE):
        film()
    assert path.read_bytes() == b"what was there before"
    assert film() == [path]


def test_blocks_of_a_checkpoint_name_their_folder(volume, tmp_path):
    camera = vm.Orthographic(30, 20, resolution=8)
    medium, folder = vm.Coefficients("density", 1), tmp_path / "blocks"
    with full_disk(), pytest.raises(OSError, match=NO_SPACE):
        vm.render(volume, medium, camera, checkpoint=folder)
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


UNWRITABLE = {"a file": "is a file; give the name of a directory", "/proc": "give another name"}


@pytest.mark.parametrize("place", UNWRITABLE)
@pytest.mark.parametrize("suffix", [*WRITERS, "radmc3d", "film", "film.mp4", "image", "blocks"])
def test_where_nothing_can_be_written_the_place_and_the_remedy_are_named(
    volume, image, tmp_path, suffix, place
):
    (tmp_path / "a file").write_bytes(b"what was there before")
    path = (tmp_path / place) / f"out{suffix}"  # the second, if it is absolute
    if place == "/proc" and not path.parent.is_dir():
        pytest.skip("this system has no /proc")
    camera, medium = vm.Orthographic(60, 0, resolution=4), vm.Coefficients("density", 1)
    write = {
        "radmc3d": lambda: vm.Volume(volume.grid, gas_density=volume.array("density")).save(
            path, format="radmc3d"
        ),
        "film": lambda: vm.movie(volume, medium, [camera], path),
        "film.mp4": lambda: vm.movie(volume, medium, [camera], path),
        "image": lambda: image.save(path.with_suffix(".png")),
        "blocks": lambda: vm.render(volume, medium, camera, checkpoint=path),
    }.get(suffix, lambda: volume.save(path))
    told = "give" if suffix == "blocks" else UNWRITABLE[place]
    with pytest.raises(vm.InputError, match=f"cannot save {re.escape(str(path.parent))}.*{told}"):
        write()
    assert (tmp_path / "a file").read_bytes() == b"what was there before"
    assert len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize("number", [errno.EACCES, errno.EROFS, errno.EPERM])
@pytest.mark.parametrize("suffix", [".h5", ".zarr", ".png"])
def test_folders_without_permission(volume, image, tmp_path, monkeypatch, suffix, number):
    def refuse(path, *_, **__):
        raise OSError(number, os.strerror(number), str(path))

    monkeypatch.setattr("pathlib.Path.mkdir", refuse)
    monkeypatch.setattr("pathlib.Path.touch", refuse)
    monkeypatch.setattr("pathlib.Path.unlink", refuse)
    path = tmp_path / f"out{suffix}"
    with pytest.raises(vm.InputError, match=f"cannot save .*{os.strerror(number)}; give another"):
        (image if suffix == ".png" else volume).save(path)


def test_of_two_writers_of_one_directory_the_later_is_refused(volume, tmp_path):
    """Both have begun when the first of them ends."""
    path = tmp_path / "cells.zarr"
    told = pytest.raises(vm.InputError, match=r"cells.zarr is there already; give a new name")
    with told, new_directory(path) as temporary:
        (temporary / "mine").touch()
        volume.save(path)
    np.testing.assert_array_equal(vm.open(path).array("density"), volume.array("density"))
    assert [path.name for path in tmp_path.iterdir()] == ["cells.zarr"]


def test_many_writers_of_one_directory(volume, tmp_path):
    path = tmp_path / "cells.zarr"
    with ThreadPoolExecutor(6) as threads:
        tried = [threads.submit(volume.save, path) for _ in range(6)]
    errors = [one.exception() for one in tried]
    assert errors.count(None) == 1
    assert all(isinstance(error, vm.InputError) for error in errors if error is not None)
    np.testing.assert_array_equal(vm.open(path).array("density"), volume.array("density"))
    assert [path.name for path in tmp_path.iterdir()] == ["cells.zarr"]


def test_a_model_of_radmc3d_is_replaced_as_a_whole_or_not_at_all(volume, tmp_path):
    place = tmp_path / "model"
    vm.radmc3d.write(vm.models.sphere(2), place, {"gas_density": "inside"})
    fields = vm.Volume(volume.grid, rho=volume.array("density"))
    options = {"fields": {"gas_density": "rho"}, "overwrite": True}
    refused(lambda: vm.radmc3d.write(fields, place, **options), tmp_path)
    vm.radmc3d.write(fields, place, **options)
    assert vm.open(place).grid.shape == (24, 24, 24)
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
