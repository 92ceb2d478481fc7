"""Films by several processes: the same bytes whoever draws, whatever is killed."""

from __future__ import annotations

import functools
import hashlib
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import voluminous as vm
from test_movies import SHELL, VIEW, VOLUME, left_by_the_dead
from voluminous.cli import main
from voluminous.files import remove_unfinished, replacing
from voluminous.io.registry import open_lazily
from voluminous.movies import film, orbit

CAMERAS = orbit(VIEW, 1, 6)


@pytest.fixture(scope="module")
def pool():
    with ProcessPoolExecutor(2, multiprocessing.get_context("spawn")) as executor:
        yield executor


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    directory = tmp_path_factory.mktemp("whole")
    return sums(vm.movie(VOLUME, SHELL, CAMERAS, directory / "frames"))


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("file") / "a.npy"
    np.save(path, VOLUME["a"])
    return path


def sums(paths):
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in paths}


def placed(file):
    """Return the volume in a file, not read, in the same place as the one in memory."""
    return open_lazily(file, {"a": file.stem}, bounds=(-1, 1))


def test_frames_in_a_directory_are_the_same_by_other_processes(pool, whole, tmp_path):
    told = []
    paths = vm.movie(
        VOLUME,
        SHELL,
        CAMERAS,
        f"{tmp_path}/frames/",
        executor=pool,
        progress=lambda *done: told.append(done),
    )
    assert paths == [tmp_path / "frames" / f"{k:04d}.png" for k in range(6)]
    assert sums(paths) == whole
    assert sums((tmp_path / "frames").iterdir()) == whole
    assert told == sorted(told)
    assert told[-1] == (6, 6)


def test_volumes_reach_other_processes(pool, file, tmp_path):
    there = vm.movie(placed(file), SHELL, CAMERAS, tmp_path / "lazy", executor=pool)
    here = vm.movie(placed(file), SHELL, CAMERAS, tmp_path / "lazy_too")
    assert sums(here) == sums(there)
    # Files are opened there; two volumes in turn.
    for k in range(2):
        vm.Volume(VOLUME.grid, a=VOLUME["a"] * (1 + k)).save(tmp_path / f"out_{k}.npz")
    series = sorted(tmp_path.glob("out_*.npz"))
    here = vm.movie(series, SHELL, CAMERAS, tmp_path / "here")
    there = vm.movie(series, SHELL, CAMERAS, tmp_path / "there", executor=pool)
    assert sums(here) == sums(there)


def scaled(factor):
    return vm.Volume(VOLUME.grid, a=VOLUME["a"] * factor)


def test_functions_are_called_by_other_processes(pool, file, tmp_path):
    series = [functools.partial(scaled, factor) for factor in (1.0, 0.5)]
    here = vm.movie(series, SHELL, CAMERAS, tmp_path / "here")
    there = vm.movie(series, SHELL, CAMERAS, tmp_path / "there", executor=pool)
    assert sums(here) == sums(there)
    opened = functools.partial(vm.open, file, bounds=(-1, 1))
    there = vm.movie(opened, SHELL, CAMERAS, tmp_path / "file", executor=pool)
    assert sums(there) == sums(vm.movie(opened, SHELL, CAMERAS, tmp_path / "file here"))
    lambdas = [lambda: scaled(1.0), lambda: scaled(0.5)]
    with ThreadPoolExecutor(2) as threads:
        paths = vm.movie(lambdas, SHELL, CAMERAS, tmp_path / "threads", executor=threads)
    assert sums(paths) == sums(here)
    with pytest.raises(vm.InputError, match=r"lambda.* cannot be sent to other processes"):
        vm.movie(lambdas, SHELL, CAMERAS, tmp_path / "lambdas", executor=pool)


def large():
    """Return a volume of more than 8 MiB."""
    return VOLUME.resample(vm.CartesianGrid.uniform(132, (-1, 1)))


def test_large_arrays_are_refused_and_large_files_are_not(pool, tmp_path):
    volume, file = large(), tmp_path / "a.npy"
    np.save(file, volume["a"])
    with pytest.raises(vm.InputError, match=r"volume\.save"):
        vm.movie(volume, SHELL, CAMERAS, tmp_path / "frames", executor=pool)
    vm.movie(placed(file), SHELL, CAMERAS[:2], tmp_path / "lazy", executor=pool)
    # What was read is read again there.
    vm.movie(vm.open(file), SHELL, CAMERAS[:2], tmp_path / "read", executor=pool)
    with ThreadPoolExecutor(2) as threads:  # they share memory
        vm.movie(volume, SHELL, CAMERAS[:2], tmp_path / "threads", executor=threads)


def test_what_is_no_executor_is_refused(tmp_path):
    with pytest.raises(vm.InputError, match="Dask client"):
        vm.movie(VOLUME, SHELL, CAMERAS, tmp_path / "frames", executor=4)


def test_errors_of_files_are_tried_again_and_others_name_the_frame(tmp_path):
    tries = []

    def finish(image):
        number = len(tries)
        tries.append(image)
        if number in errors:
            raise errors[number]
        return image

    with ThreadPoolExecutor(1) as threads:
        options = {"executor": threads, "picture": {"exposure": 1.0}, "finish": finish}
        errors = dict.fromkeys((1, 2, 3), OSError("stale"))
        paths = vm.movie(VOLUME, SHELL, CAMERAS[:2], tmp_path / "a", **options)
        assert all(path.is_file() for path in paths)
        assert len(tries) == 5
        tries.clear()
        errors = dict.fromkeys(range(1, 9), OSError("the disk is gone"))
        with pytest.raises(vm.errors.VoluminousError, match="frame 1: OSError: the disk is gone"):
            vm.movie(VOLUME, SHELL, CAMERAS[:2], tmp_path / "b", **options)
        assert len(tries) == 5  # the first frame, and four tries
        with pytest.raises(vm.InputError, match=r"frame \d: samples"):
            vm.movie(VOLUME, SHELL, CAMERAS[:2], tmp_path / "c", samples=0, **options)


def test_cancelling_takes_effect_while_a_frame_is_drawn(tmp_path):
    begun, go_on, drawn = threading.Event(), threading.Event(), []

    def finish(image):
        begun.set()
        go_on.wait(60)
        drawn.append(image)
        return image

    def progress(done, total):
        if begun.is_set():
            raise KeyboardInterrupt

    with ThreadPoolExecutor(1) as threads:
        with pytest.raises(KeyboardInterrupt):
            vm.movie(
                VOLUME,
                SHELL,
                CAMERAS,
                tmp_path / "frames",
                finish=finish,
                picture={"exposure": 1.0},
                executor=threads,
                progress=progress,
            )
        assert not drawn  # it did not wait for the frame
        go_on.set()
    assert len(drawn) == 1  # and all that had not begun was cancelled


# Draws a film with some workers; prints the frames made after each report.
DRIVER = """
import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
import voluminous as vm
from test_movies import SHELL, VIEW

if __name__ == "__main__":
    source, target, frames = sys.argv[1], sys.argv[2], int(sys.argv[3])
    volume = vm.open(source, bounds=(-1, 1))
    with ProcessPoolExecutor(int(sys.argv[4]), get_context("spawn")) as pool:
        vm.movie(
            volume,
            SHELL.replace(expr=volume.fields[0]),
            vm.orbit(VIEW, frames=frames),
            target,
            executor=pool,
            progress=lambda done, total: print(done, flush=True),
        )
"""


def environment():
    paths = [str(Path(__file__).parent), str(Path(vm.__file__).parents[1])]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}


def film_that_is_killed(tmp_path, file, frames, stops, workers):
    """Draw a film, killing driver and workers whenever so many frames are made; return its sums."""
    script, target = tmp_path / "driver.py", tmp_path / "frames"
    script.write_text(DRIVER)
    command = [sys.executable, str(script), str(file), str(target), str(frames), str(workers)]
    for stop in [*stops, frames + 1]:
        child = subprocess.Popen(
            command, env=environment(), stdout=subprocess.PIPE, text=True, start_new_session=True
        )
        for line in child.stdout:
            if int(line) >= stop:
                os.killpg(child.pid, signal.SIGKILL)
        child.stdout.close()
        killed = child.wait() != 0
        # On a busy machine all frames may be there before the signal is.
        made = len(list(target.glob("[0-9]*.png")))
        assert made == frames or (killed and stop <= frames)
    return sums(target.iterdir())


def test_a_film_whose_driver_is_killed_is_the_same(file, tmp_path):
    volume = vm.open(file, bounds=(-1, 1))
    medium = SHELL.replace(expr=volume.fields[0])
    whole = sums(vm.movie(volume, medium, orbit(VIEW, frames=64), tmp_path / "whole"))
    assert film_that_is_killed(tmp_path, file, 64, [3], workers=1) == whole


@pytest.mark.exhaustive
def test_a_film_of_200_frames_killed_five_times_is_the_same(tmp_path):
    file = tmp_path / "a.npy"
    rng = np.random.default_rng(1)
    np.save(file, rng.random((64, 64, 64), np.float32))
    volume = vm.open(file, bounds=(-1, 1))
    medium = SHELL.replace(expr=volume.fields[0])
    whole = sums(vm.movie(volume, medium, orbit(VIEW, frames=200), tmp_path / "whole"))
    stops = sorted(rng.choice(190, 5, replace=False) + 1)
    assert film_that_is_killed(tmp_path, file, 200, stops, workers=2) == whole
    assert len(whole) == 200


@pytest.mark.exhaustive
def test_memory_does_not_grow_with_the_number_of_frames(tmp_path):
    """Two hundred frames later a program takes five per cent more memory at most."""
    psutil = pytest.importorskip("psutil")
    sizes = []

    def progress(done, total):
        sizes.append(psutil.Process().memory_info().rss)

    camera = VIEW.replace(resolution=(200, 200))
    vm.movie(VOLUME, SHELL, orbit(camera, frames=210), tmp_path / "a", progress=progress)
    assert np.mean(sizes[-5:]) <= 1.05 * np.mean(sizes[-201:-196])


def test_workers_that_are_killed_lose_nothing(file, tmp_path, whole, monkeypatch):
    distributed = pytest.importorskip("distributed")
    volume = placed(file)
    cameras = orbit(VIEW, frames=24)
    undisturbed = sums(vm.movie(volume, SHELL, cameras, tmp_path / "whole"))
    options = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": ":0"}
    with (
        distributed.LocalCluster(processes=True, **options) as cluster,
        distributed.Client(cluster) as client,
    ):
        killed = []

        def progress(done, total):
            if done >= 3 and not killed:
                killed.append(next(iter(client.run(os.getpid).values())))
                os.kill(killed[0], signal.SIGKILL)

        paths = vm.movie(
            volume, SHELL, cameras, tmp_path / "frames", executor=client, progress=progress
        )
        assert killed
        assert sums(paths) == undisturbed
        assert sums((tmp_path / "frames").iterdir()) == undisturbed
        # Arrays in memory are sent once.
        sent = vm.movie(large(), SHELL, CAMERAS[:2], tmp_path / "sent", executor=client)
    assert sums(sent) == sums(vm.movie(large(), SHELL, CAMERAS[:2], tmp_path / "here"))


def test_a_process_that_dies_is_told_in_words(tmp_path):
    options = {"finish": dies, "picture": {"exposure": 1.0}}
    with (
        ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as executor,
        pytest.raises(vm.errors.VoluminousError, match=r"frame \d: a process .* died"),
    ):
        vm.movie(VOLUME, SHELL, CAMERAS[:3], tmp_path / "a", executor=executor, **options)


def dies(image):
    os._exit(9)


def test_damaged_frames_are_made_again(tmp_path):
    paths = vm.movie(VOLUME, SHELL, CAMERAS, tmp_path / "frames")
    before = sums(paths)
    content = paths[2].read_bytes()
    paths[2].write_bytes(content[:-20])  # cut short, the description whole
    half = len(content) - 60
    paths[4].write_bytes(content[:half] + bytes([content[half] ^ 1]) + content[half + 1 :])
    paths[5].unlink()
    vm.movie(VOLUME, SHELL, CAMERAS, tmp_path / "frames")
    assert sums(paths) == before


def test_shares_make_a_film_without_an_executor(tmp_path, whole):
    for k in (3, 1, 2):
        own = vm.movie(VOLUME, SHELL, CAMERAS, tmp_path / "frames", share=(k, 3))
        if k != 2:
            assert [path.stem for path in own] == [f"{k - 1:04d}", f"{k + 2:04d}"]
    assert sums(own) == whole
    for k in (2, 1):
        (one, *_) = vm.movie(VOLUME, SHELL, CAMERAS, tmp_path / "film.gif", share=(k, 2))
        assert one.name == ("0001.png" if k == 2 else "film.gif")
    assert len(list((tmp_path / "film.gif.frames").iterdir())) == 6
    for share in [(0, 3), (4, 3), 2, (1.5, 3)]:
        with pytest.raises(vm.InputError, match="share"):
            vm.movie(VOLUME, SHELL, CAMERAS, tmp_path / "frames", share=share)


def test_the_exposure_of_frames_that_are_there_is_taken(tmp_path, monkeypatch):
    vm.movie(VOLUME, SHELL, CAMERAS, tmp_path / "frames", share=(1, 3))
    monkeypatch.setattr(film, "display", None)
    vm.movie(VOLUME, SHELL, CAMERAS, tmp_path / "frames", share=(2, 3))
    with pytest.raises(TypeError):  # of another film it is not
        vm.movie(VOLUME, SHELL, CAMERAS[:5], tmp_path / "frames")


def test_files_that_others_write_are_left_alone(tmp_path):
    path = tmp_path / "0001.png"
    dead = left_by_the_dead(path)
    machine = dead.name.split(".")[2].split("-")[0]
    far = dead.with_name(dead.name.replace(machine, "0" * 8))
    old = dead.with_name(dead.name.replace(machine, "1" * 8))
    for other in (far, old):
        other.write_bytes(b"half")
    os.utime(old, (time.time() - 7200,) * 2)
    remove_unfinished([tmp_path / "0002.png"])
    assert {dead, far, old} == set(tmp_path.iterdir())
    with replacing(path) as mine:
        mine.write_bytes(b"half")
        remove_unfinished([path])
        assert {far, mine} == set(tmp_path.iterdir())
        mine.write_bytes(b"whole")
    assert path.read_bytes() == b"whole"


def test_fingerprints_are_those_of_contents_and_files(file, tmp_path):
    lazy = placed(file)
    told = lazy.fingerprint()
    assert lazy.waiting == ("a",)
    code = (
        "import sys, voluminous as vm, numpy as np\n"
        "from voluminous.io.registry import open_lazily\n"
        "vm.Volume(vm.CartesianGrid.uniform(2, (0, 1)), a=np.ones((2, 2, 2))).own()\n"
        "print(open_lazily(sys.argv[1], {'a': 'a'}, bounds=(-1, 1)).fingerprint())\n"
    )
    other = subprocess.run(
        [sys.executable, "-c", code, str(file)], env=environment(), capture_output=True, check=True
    )
    assert other.stdout.decode().strip() == told
    lazy.load()
    assert lazy.fingerprint() == told
    assert open_lazily(file, {"a": "a"}, bounds=(-2, 1)).fingerprint() != told
    lazy["a"] = VOLUME["a"] * 2
    assert lazy.fingerprint() != told
    grids = [vm.CartesianGrid.uniform(8, (-1, n)) for n in (1, 2)]
    one, two = (vm.Volume(grid, a=VOLUME["a"]).fingerprint() for grid in grids)
    assert one != two
    assert one == VOLUME.fingerprint()


def test_the_script_for_slurm_draws_a_film(tmp_path, capsys, monkeypatch):
    """Run as an array runs it: one job after another."""
    monkeypatch.chdir(tmp_path)
    VOLUME.save("volume.h5")
    words = ["movie", "volume.h5", "--orbit", "3", "--set", "camera.resolution=8", "-o"]
    assert main([*words, "a film.gif", "--slurm-array", "2"]) == 0
    script = capsys.readouterr().out
    (tmp_path / "film.sh").write_text(script)
    assert "#SBATCH --array=1-2\n" in script
    for job in ("2", "1"):
        assert not (tmp_path / "a film.gif").exists()
        env = {**environment(), "SLURM_ARRAY_TASK_ID": job}
        subprocess.run(["bash", "film.sh"], env=env, check=True, capture_output=True)
    assert (tmp_path / "a film.gif").exists()
    for more in (["--slurm"], ["--slurm-array=3", "-q"]):
        assert main([*words, "b.gif", *more]) == 0
        last = capsys.readouterr().out.splitlines()[-1]
        assert last.endswith(f'b.gif{" -q" * ("-q" in more)} --share "$SLURM_ARRAY_TASK_ID/3"')
    for more in (["--slurm-array=4"], ["--share", "3"], ["--share", "1/2", "--slurm-array"]):
        assert main([*words, "b.gif", *more]) == 2
        assert more[0].split("=")[0] in capsys.readouterr().err


def test_fingerprints_of_levels_read_nothing(tmp_path):
    VOLUME.save(tmp_path / "a.zarr", levels=True, stats=True, chunks=4)
    volume = open_lazily(tmp_path / "a.zarr")
    coarse = volume.level(1)
    assert len({volume.fingerprint(), coarse.fingerprint()}) == 2
    assert coarse.waiting == volume.waiting == ("a",)


def test_the_exposure_of_a_large_film_is_measured_in_a_coarse_level(tmp_path):
    x, y, z = np.meshgrid(*[np.linspace(-1, 1, 32)] * 3, indexing="ij")
    fine = vm.Volume(vm.CartesianGrid.uniform(32, (-1, 1)), a=np.exp(-(x**2) - y**2 - z**2))
    fine.save(tmp_path / "a.zarr", levels=True, stats=True, chunks=8)
    volume, drawn = open_lazily(tmp_path / "a.zarr"), []

    def finish(image):
        drawn.append(image.provenance.get("level"))
        return image

    vm.movie(volume, SHELL, CAMERAS[:2], tmp_path / "frames", finish=finish)
    assert drawn == [1, 1, None, None]
