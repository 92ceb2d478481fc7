"""Pictures drawn block by block by several processes: the same bits, and nothing drawn is lost."""

from __future__ import annotations

import functools
import multiprocessing
import os
import pickle
import shutil
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor

import numpy as np
import pytest

import voluminous as vm
from test_confined_walk import UNIFORM
from test_streaming import CAMERAS, MEDIUM, chunks, noise, reads
from test_streaming import assert_same_bits as assert_same_in_memory
from voluminous.backend import dr
from voluminous.errors import InputError, VoluminousError

__all__ = ["chunks", "reads"]


class Counting(ThreadPoolExecutor):
    """Counts tasks; may fail at some."""

    def __init__(self, fails=lambda number: None):
        super().__init__(2)
        self.count, self.fails = 0, fails

    def submit(self, function, *given):
        self.count += 1
        error = self.fails(self.count)
        if error is None:
            return super().submit(function, *given)
        failed = Future()
        failed.set_exception(error)
        return failed


def assert_same_bits(whole, parts):
    """Compare with a picture of which the file was read: of chunks fewer cells are looked at.

    They tell how much fields vary, which is a small part of the error.
    """
    if whole.error is not None:
        np.testing.assert_allclose(parts.error, whole.error, rtol=1e-5)
        whole = whole.replace(error=parts.error)
    assert_same_in_memory(whole, parts)


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """Return a volume that is read from a file, in chunks of eight cells."""
    path = tmp_path_factory.mktemp("sweep") / "noise.zarr"
    values = np.random.default_rng(2).random((40, 32, 24), dtype=np.float32)
    grid = vm.CartesianGrid.uniform(values.shape, (-1, 1))
    vm.Volume(grid, a=values).save(path, stats=True, chunks=8)
    return path


@pytest.fixture
def narrow(monkeypatch):
    """Make boxes of one chunk, and blocks of two along each axis."""
    monkeypatch.setattr("voluminous.large.view.VolumeView.widest", 8)
    monkeypatch.setattr("voluminous.large.chunks.CartesianChunks.most_tasks", 12)


@pytest.mark.parametrize("options", [{"scheme": "first-order"}, {"tolerance": None}, {}])
@pytest.mark.parametrize(
    "camera", ["oblique", "along the diagonal", "along x", "from inside", "in a vertex"]
)
def test_blocks_have_the_bits_of_the_whole(camera, options, chunks):
    chunks(4)
    volume = noise(UNIFORM)
    whole = vm.render(volume, MEDIUM, CAMERAS[camera], **options)
    executor = Counting()
    with executor:
        parts = vm.render(volume, MEDIUM, CAMERAS[camera], executor=executor, **options)
    assert_same_in_memory(whole, parts)
    assert executor.count > 3


def test_processes_have_the_bits_of_the_whole(stored, narrow):
    volume = vm.open(stored)
    camera = vm.Orthographic(35, 50, width=4, resolution=60)
    pool = ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn"))
    with pool:
        for options in ({"scheme": "first-order", "samples": 2}, {}):
            whole = vm.render(vm.open(stored), MEDIUM, camera, **options)
            parts = vm.render(volume, MEDIUM, camera, executor=pool, **options)
            assert_same_bits(whole, parts)
    # The optical depth of rays that stopped is computed here, when the pool is closed.
    opaque = MEDIUM.replace(path_length=0.01)
    with ThreadPoolExecutor(1) as pool:
        image = vm.render(volume, opaque, camera, executor=pool, scheme="first-order")
    whole = vm.render(vm.open(stored), opaque, camera, scheme="first-order")
    np.testing.assert_array_equal(image.optical_depth, whole.optical_depth)


def test_what_was_drawn_is_not_drawn_again(stored, narrow, tmp_path, reads):
    volume, camera = vm.open(stored), vm.Orthographic(35, 50, width=4, resolution=60)
    whole = vm.render(vm.open(stored), MEDIUM, camera)
    draw = functools.partial(
        vm.render, volume, MEDIUM, camera, memory="1 GiB", checkpoint=tmp_path / "kept"
    )
    del reads[:]
    assert_same_bits(whole, draw())
    all_of_them = len(reads)
    del reads[:]
    for stop in (0.3, 0.6, 0.9):

        def cancel(done, total, stop=stop):
            if done > stop * total:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            draw(progress=cancel)
    assert any((tmp_path / "kept").rglob("*-*"))
    # A file that is not whole is drawn again; one of another picture is not taken.
    damaged = next((tmp_path / "kept").rglob("*-*"))
    damaged.write_bytes(damaged.read_bytes()[:100])
    dim = MEDIUM.replace(opacity=0.1)
    np.testing.assert_array_equal(
        vm.render(volume, dim, camera, checkpoint=tmp_path / "kept").intensity,
        vm.render(vm.open(stored), dim, camera).intensity,
    )
    own = len(reads)
    assert_same_bits(whole, draw())
    assert len(reads) < 1.3 * all_of_them + own
    assert not list((tmp_path / "kept").iterdir())


def interrupted(draw, when=0.6):
    """Draw, but cancel in between."""

    def cancel(done, total):
        if done > when * total:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        draw(progress=cancel)


def by_function(factor):
    return vm.Medium.from_function(lambda a: (factor * a, a), ["a"], channels=1)


def mapped(*colors, **options):
    from matplotlib.colors import ListedColormap

    return vm.Colormap("a", ListedColormap(colors, "mine"), 0, 1, 0.4, 0.5, **options)


def by_norm(gamma):
    from matplotlib.colors import PowerNorm

    return vm.Colormap("a", "viridis", None, None, 0.4, 0.5, norm=PowerNorm(gamma, 0, 1))


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (by_function(1.0), by_function(2.0)),
        (mapped("red", "blue"), mapped("red", "green")),
        (by_norm(1.0), by_norm(3.0)),
        (MEDIUM, MEDIUM.replace(center=0.5 + 1e-6)),
        (
            vm.Table("a", np.linspace(0, 1, 40), np.linspace(0, 1, 40)[:, None], 1.0, 0.5),
            vm.Table("a", np.linspace(0, 1, 40), np.linspace(0, 1, 40)[:, None] ** 2, 1.0, 0.5),
        ),
    ],
)
def test_blocks_of_another_medium_are_not_taken(one, other, stored, narrow, tmp_path):
    camera = vm.Orthographic(35, 50, width=4, resolution=16)
    draw = functools.partial(vm.render, vm.open(stored), camera=camera, scheme="first-order")
    kept = {"checkpoint": tmp_path / "kept", "precision": "double"}
    interrupted(functools.partial(draw, medium=one, **kept))
    assert any((tmp_path / "kept").rglob("*-*"))
    image, wanted = draw(medium=other, **kept), draw(medium=other, precision="double")
    np.testing.assert_array_equal(image.intensity, wanted.intensity)
    # Those of the same medium, made again, are taken, and then removed.
    before = len(list((tmp_path / "kept").iterdir()))
    draw(medium=one, **kept)
    assert len(list((tmp_path / "kept").iterdir())) == before - 1


class Evil:
    """A pickle that makes a file when it is read."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return open, (str(self.path), "w")


def damage(files, rng, evil):
    """Damage some files of a checkpoint, each in another way."""
    contents = [file.read_bytes() for file in files]
    for k, (file, content) in enumerate(zip(files, contents, strict=True)):
        data = bytearray(content)
        kind = rng.integers(8)
        if kind == 0:
            data[rng.integers(len(data))] ^= 1 << rng.integers(8)
        elif kind == 1:
            data = data[: rng.integers(len(data))]
        elif kind == 2:
            data = contents[k - 1]
        elif kind == 3:
            data = rng.bytes(rng.integers(1000))
        elif kind == 4:
            data = pickle.dumps(Evil(evil))
        elif kind == 5:
            first = rng.integers(len(data))
            data[first : first + 64] = bytes(len(data[first : first + 64]))
        elif kind == 6:
            # The arrays of one block with the checksum of another.
            data = contents[k - 1][:32] + content[32:]
        file.write_bytes(data)


@pytest.mark.parametrize(
    "seeds", [range(3), pytest.param(range(3, 60), marks=pytest.mark.exhaustive)]
)
@pytest.mark.parametrize("options", [{"scheme": "first-order"}, {}])
def test_damaged_blocks_are_drawn_again(options, seeds, stored, narrow, tmp_path):
    camera = vm.Orthographic(35, 50, width=4, resolution=16)
    draw = functools.partial(vm.render, vm.open(stored), MEDIUM, camera, **options)
    whole, kept = draw(), tmp_path / "kept"
    for seed in seeds:
        interrupted(functools.partial(draw, checkpoint=kept), 0.9)
        files = sorted(kept.rglob("*-*"))
        assert len(files) > 5
        damage(files, np.random.default_rng(seed), tmp_path / "evil")
        assert_same_bits(whole, draw(checkpoint=kept))
        assert not list(kept.iterdir())
        assert not (tmp_path / "evil").exists()


def test_tasks_that_cannot_read_are_tried_again(stored, narrow):
    volume, camera = vm.open(stored), CAMERAS["oblique"]
    whole = vm.render(vm.open(stored), MEDIUM, camera, scheme="first-order")
    draw = functools.partial(vm.render, volume, MEDIUM, camera, scheme="first-order")
    with Counting(lambda number: OSError("gone") if number in (2, 3, 7) else None) as executor:
        assert_same_bits(whole, draw(executor=executor))
    with (
        Counting(lambda number: OSError("gone") if number > 4 else None) as executor,
        pytest.raises(VoluminousError, match=r"block . of 12: OSError: gone"),
    ):
        draw(executor=executor)
    with (
        Counting(lambda number: ValueError("wrong") if number == 4 else None) as executor,
        pytest.raises(VoluminousError, match="ValueError: wrong"),
    ):
        draw(executor=executor)
    assert executor.count < 12


def test_cancelling_does_not_wait(stored, narrow):
    started, go_on = threading.Event(), threading.Event()

    class Slow(ThreadPoolExecutor):
        def submit(self, function, *given):
            def wait_first():
                started.set()
                go_on.wait()
                return function(*given)

            return super().submit(wait_first)

    def cancel(done, total):
        if started.is_set():
            raise KeyboardInterrupt

    executor = Slow(1)
    with pytest.raises(KeyboardInterrupt):
        vm.render(vm.open(stored), MEDIUM, CAMERAS["oblique"], executor=executor, progress=cancel)
    go_on.set()
    executor.shutdown()


def test_progress_grows_to_all_cells(stored, narrow):
    told = []
    with ThreadPoolExecutor(2) as executor:
        vm.render(
            vm.open(stored),
            MEDIUM,
            CAMERAS["oblique"],
            executor=executor,
            progress=lambda done, total: told.append((done, total)),
        )
    done = [d for d, _ in told]
    assert done == sorted(done)
    assert told[-1] == (40 * 32 * 24, 40 * 32 * 24)


def test_refusals(stored, monkeypatch):
    camera = CAMERAS["oblique"]
    with pytest.raises(InputError, match=r"executor is a .*, or a Dask client, got 4"):
        vm.render(vm.open(stored), MEDIUM, camera, executor=4)
    monkeypatch.setattr("voluminous.large.tracer.BlockTracer.most_sent", 1 << 10)
    with (
        ThreadPoolExecutor(1) as executor,
        pytest.raises(InputError, match=r"write the volume first, volume.save\('big.zarr'"),
    ):
        vm.render(noise(UNIFORM), MEDIUM, camera, executor=executor)
    # Other fields in memory are not sent.
    volume = vm.open(stored)
    volume["b"] = np.ones(volume.grid.shape)
    with ThreadPoolExecutor(1) as executor:
        vm.render(volume, MEDIUM, camera, executor=executor)
    assert volume.fields == ("a", "b")


def _die(*given):
    os.kill(os.getpid(), signal.SIGKILL)


def test_a_pool_whose_process_dies_is_named(stored, narrow, tmp_path, monkeypatch):
    volume, camera = vm.open(stored), CAMERAS["oblique"]
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=context) as pool:
        pool.submit(_die)
        with pytest.raises(VoluminousError, match="finished blocks with checkpoint="):
            vm.render(volume, MEDIUM, camera, executor=pool, checkpoint=tmp_path / "kept")


SCRIPT = """
import sys
import voluminous as vm
from voluminous.large.chunks import CartesianChunks
from voluminous.large.view import VolumeView
from concurrent.futures import ThreadPoolExecutor
VolumeView.widest, CartesianChunks.most_tasks = 8, 12
medium = vm.Gaussian("a", 0.5, 0.2, (1, 0.5, 0.2), opacity=0.4, path_length=0.5)
image = vm.render(
    vm.open(sys.argv[1]), medium, vm.Orthographic(35, 50, width=4, resolution=60),
    checkpoint=sys.argv[2], executor=ThreadPoolExecutor(2),
)
image.save(sys.argv[3])
"""


def test_a_killed_driver_goes_on(stored, tmp_path):
    kept, picture = tmp_path / "kept", tmp_path / "picture.npz"
    command = [sys.executable, "-c", SCRIPT, str(stored), str(kept), str(picture)]
    for count in (3, 9):
        process = subprocess.Popen(command)
        while process.poll() is None and len(list(kept.rglob("*-*"))) < count:
            time.sleep(0.005)
        process.kill()
        process.wait()
    before = len(list(kept.rglob("*-*")))
    assert before >= 9
    subprocess.run(command, check=True)
    whole = vm.render(vm.open(stored), MEDIUM, vm.Orthographic(35, 50, width=4, resolution=60))
    np.testing.assert_array_equal(vm.Image.load(picture).intensity, whole.intensity)
    assert not list(kept.iterdir())


@pytest.mark.parametrize("deaths", [1, pytest.param(10, marks=pytest.mark.exhaustive)])
def test_dask_goes_on_where_workers_die(stored, narrow, deaths):
    distributed = pytest.importorskip("distributed")
    camera = vm.Orthographic(35, 50, width=4, resolution=60)
    whole = vm.render(vm.open(stored), MEDIUM, camera, scheme="first-order")
    rng = np.random.default_rng(deaths)
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=None
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        for _ in range(deaths):
            last, killed = rng.integers(1, 6), []

            def kill(done, total, last=last, killed=killed):
                if done > last * total / 8 and not killed:
                    workers = [w for w in cluster.workers.values() if w.process.is_alive()]
                    killed.append(workers[rng.integers(len(workers))].pid)
                    os.kill(killed[0], signal.SIGKILL)

            image = vm.render(
                vm.open(stored),
                MEDIUM,
                camera,
                scheme="first-order",
                executor=client,
                progress=kill,
            )
            assert_same_bits(whole, image)
            assert killed


def test_the_number_of_threads_changes_no_bit(stored, narrow):
    # Threads of a pool take numbers below 1e-38 for zero; a kernel that is run by the caller, as
    # one thread, does not. Rays become that dark, and that opaque, in these blocks.
    faint = vm.Coefficients(["1e-36*a", "a*exp(-60*a)", "a"], ["30*a"])
    camera = vm.Orthographic(35, 50, width=4, resolution=60)
    count, images = dr.thread_count(), []
    try:
        for threads in (1, 2):
            dr.set_thread_count(threads)
            draw = functools.partial(vm.render, vm.open(stored), faint, camera, cutoff=0)
            images += [draw(memory="1 GiB"), draw(checkpoint=stored.with_name("kept"))]
    finally:
        dr.set_thread_count(count)
    for image in images[1:]:
        assert_same_in_memory(images[0], image)


@pytest.mark.exhaustive
@pytest.mark.parametrize("processes", [2, 3, 4, 7])
def test_mpi_has_the_bits_of_the_whole(processes, stored, tmp_path):
    pytest.importorskip("mpi4py", reason="pip install mpi4py mpich")
    start = shutil.which("mpiexec")
    if start is None:
        pytest.skip("mpiexec is not there: pip install mpich")
    script = tmp_path / "draw.py"
    body = SCRIPT.replace("ThreadPoolExecutor(2)", "MPIPoolExecutor()")
    lines = body.replace("from concurrent.futures import Thread", "from mpi4py.futures import MPI")
    head, tail = lines.split("image = ", 1)
    main = "\n    ".join(("image = " + tail).splitlines())
    script.write_text(f"{head}if __name__ == '__main__':\n    {main}\n")
    picture = tmp_path / "picture.npz"
    command = [start, "-n", processes, sys.executable, "-m", "mpi4py.futures", script]
    kept = tmp_path / "kept"
    subprocess.run([str(c) for c in (*command, stored, kept, picture)], check=True, timeout=300)
    whole = vm.render(vm.open(stored), MEDIUM, vm.Orthographic(35, 50, width=4, resolution=60))
    np.testing.assert_array_equal(vm.Image.load(picture).intensity, whole.intensity)
