"""Plans say what pictures drawn chunk by chunk take, and read nothing to know it."""

from __future__ import annotations

import numpy as np
import pytest

import voluminous as vm
from test_confined_walk import UNIFORM
from test_octree import random_octree
from test_streaming import CAMERAS, MEDIUM, chunks, noise, reads
from voluminous.cli import main
from voluminous.errors import MemoryNeededError, UnknownNameError
from voluminous.store import FieldStore

__all__ = ["chunks", "reads"]

# Chunks of the volumes below are few and small: half a gigabyte is for other things.
ENOUGH = "500 MB"


def blob(n):
    """Return a volume of which only the middle is visible with `MEDIUM`."""
    grid = vm.CartesianGrid.uniform(n, (-1, 1))
    x, y, z = np.meshgrid(*[np.linspace(-1, 1, n)] * 3, indexing="ij")
    return vm.Volume(grid, a=np.where(x**2 + y**2 + z**2 < 0.2, 0.5, 9.0).astype(np.float32))


def chunks_read(reads, side):
    """Return how many chunks some boxes are in, each of which is in one."""
    return len({tuple(np.array(low) // side) for low, _ in reads})


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
def test_the_chunks_of_a_plan_are_those_that_are_read(camera, chunks, reads):
    """But for chunks at the rim of a picture, which no ray through a pixel's middle meets."""
    chunks(3)
    volume = noise(UNIFORM)
    options = {"memory": ENOUGH, "scheme": "first-order"}
    plan = vm.plan(volume, MEDIUM, camera, **options)
    measured = len(reads)  # ranges of what is in memory
    del reads[:]
    vm.render(volume, MEDIUM, camera, **options, cutoff=0.0)
    read = chunks_read(reads[measured:], 3)
    # Beside an observer who is inside what is in the picture is not known: it counts.
    outside = np.isfinite(camera.project(volume.grid.bounds, volume.grid)[0]).all()
    assert read <= plan.visible <= (1.3 * read + 2 if outside and camera.straight else 27)


@pytest.mark.parametrize("scheme", ["first-order", "pre-integrated", "post-classified"])
def test_chunks_that_show_nothing_are_left_out(scheme, chunks, reads):
    chunks(8)
    volume, camera = blob(64), vm.Orthographic(35, 25, width=3, resolution=40)
    options = {"memory": ENOUGH, "scheme": scheme}
    plan = vm.plan(volume, MEDIUM, camera, **options)
    measured = len(reads)
    del reads[:]
    vm.render(volume, MEDIUM, camera, **options, cutoff=0.0)
    read = chunks_read(reads[measured:], 8)
    assert plan.chunks == 512
    assert read <= plan.visible <= 1.3 * read
    assert read < 0.5 * 512
    assert plan.bytes_read == plan.visible * 8**3 * 4


def test_of_a_picture_that_shows_a_part_only_that_is_read(chunks):
    chunks(8)
    near = vm.Orthographic(0, 0, width=0.25, center=(0.5, 0.5, 0), resolution=40)
    plan = vm.plan(noise(vm.CartesianGrid.uniform(64, (-1, 1))), MEDIUM, near, memory=ENOUGH)
    assert 8 <= plan.visible <= 4 * 8


def test_nothing_of_a_file_is_read(tmp_path, monkeypatch):
    blob(64).save(tmp_path / "a.zarr", stats=True, levels=True, chunks=8)
    blob(64).save(tmp_path / "b.zarr", chunks=8)
    volumes = [vm.io.registry.open_lazily(tmp_path / name) for name in ("a.zarr", "b.zarr")]
    monkeypatch.setattr(FieldStore, "read", None)
    medium, camera = MEDIUM.replace(path_length="auto"), CAMERAS["oblique"]
    with_stats, without = (vm.plan(v, medium, camera, memory=ENOUGH) for v in volumes)
    assert with_stats.known
    assert with_stats.visible < 512 == with_stats.chunks
    assert not without.known
    assert without.visible == without.chunks
    assert "--stats" in str(without)
    on_disk = sum(
        p.stat().st_size for p in (tmp_path / "a.zarr/fields/a").rglob("*") if p.is_file()
    )
    assert 0 < with_stats.bytes_stored <= on_disk
    assert all(volume.waiting == ("a",) for volume in volumes)
    monkeypatch.undo()
    coarse = vm.plan(volumes[0], MEDIUM, camera, memory=ENOUGH, level=1)
    assert (coarse.shape, coarse.level, coarse.chunks) == ((32, 32, 32), 1, 64)


def test_memory_is_that_of_each_process(chunks):
    chunks(4)
    volume = noise(vm.CartesianGrid.uniform(64, (-1, 1)))
    camera = vm.Orthographic(35, 25, resolution=50)
    one, four = (vm.plan(volume, MEDIUM, camera, memory=ENOUGH, workers=n) for n in (1, 4))
    assert one.chunks == four.chunks == 4096
    assert "in each of 4 processes" in str(four)


def test_memory_is_that_of_drawing():
    volume, camera = noise(UNIFORM), CAMERAS["oblique"]
    with pytest.raises(MemoryNeededError) as planned:
        vm.plan(volume, MEDIUM, camera, memory="1 MB")
    with pytest.raises(MemoryNeededError) as drawn:
        vm.render(volume, MEDIUM, camera, memory="1 MB")
    assert str(planned.value) == str(drawn.value)
    big = vm.plan(volume, MEDIUM, CAMERAS["oblique"].replace(resolution=2000), memory="3 GB")
    assert big.memory > vm.plan(volume, MEDIUM, camera).memory + 200 * 2000**2


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"workers": 0}, vm.InputError, "workers"),
        ({"sample": 2}, UnknownNameError, "samples"),
        ({"scheme": "second-order"}, vm.InputError, "chunk by chunk"),
        ({"bounds": True}, vm.InputError, "bounds"),
        ({"memory": "much"}, vm.InputError, "memory"),
    ],
)
def test_what_cannot_be_planned_is_refused(options, error, message):
    with pytest.raises(error, match=message):
        vm.plan(noise(UNIFORM), MEDIUM, CAMERAS["oblique"], **options)


def test_refined_grids_are_refused():
    with pytest.raises(vm.InputError, match="Cartesian"):
        vm.plan(vm.Volume(random_octree(1, 2), {}), MEDIUM, CAMERAS["oblique"])


def test_the_command_line_prints_a_plan(tmp_path, capsys):
    blob(16).save(tmp_path / "a.h5")
    words = ["plan", str(tmp_path / "a.h5"), "--scheme", "first-order", "-q"]
    assert main([*words, "--workers", "8"]) == 0
    told = capsys.readouterr().out
    assert "16 x 16 x 16, level 0" in told
    assert "8 processes" in told
    assert main([*words, "--workers", "0"]) == 2
