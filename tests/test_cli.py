"""The command line: what it writes, what it says, and how it fails."""

import contextlib
import io
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import voluminous as vm
from voluminous import progress
from voluminous.cli import COMMANDS, doctor, main
from voluminous.progress import progress_bar

SCENE = """
[volume]
model = "sphere"
resolution = 8

[[medium]]
type = "coefficients"
emissivity = ["inside", "0.5 * inside"]
extinction = "0.1 * inside"

[camera]
width = 2.5
resolution = 6

[image]
exposure = 1
"""


@pytest.fixture
def scene(tmp_path, monkeypatch):
    """A small scene file in the working directory."""
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "scene.toml"
    path.write_text(SCENE)
    return path


def run(*arguments):
    return main([str(argument) for argument in arguments])


def process(*arguments, cwd):
    """Run Python as a user does: in a process of its own."""
    options = {"capture_output": True, "text": True, "encoding": "utf-8", "check": False}
    return subprocess.run([sys.executable, *arguments], cwd=cwd, **options)


# The command as a process


def test_the_process_renders_and_fails_as_it_should(scene, tmp_path):
    done = process("-m", "voluminous", "render", "scene.toml", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")  # no progress bar in a pipe
    assert done.stdout.startswith("scene.png: 6 x 6 pixels, 2 channels, post-classified, single")
    assert (tmp_path / "scene.png").read_bytes().startswith(b"\x89PNG")
    failed = process("-m", "voluminous", "render", "scene.tomm", cwd=tmp_path)
    assert (failed.returncode, failed.stdout) == (2, "")
    assert failed.stderr.endswith(": there is no file scene.tomm; did you mean scene.toml?\n")


def test_help_and_version_import_nothing_heavy(tmp_path):
    script = (
        "import sys, contextlib\n"
        "from voluminous.cli import COMMANDS, main\n"
        "for arguments in (['--help'], ['--version'], *([c, '--help'] for c in COMMANDS)):\n"
        "    with contextlib.suppress(SystemExit):\n"
        "        main(arguments)\n"
        "heavy = {'drjit', 'astropy', 'matplotlib', 'h5py', 'numpy', 'PIL', 'tqdm'}\n"
        "sys.exit(', '.join(heavy & set(sys.modules)) or 0)\n"
    )
    done = process("-c", script, cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert f"voluminous {vm.__version__}" in done.stdout
    assert all(name in done.stdout for name in COMMANDS)


def test_a_reader_that_goes_away_is_no_error(scene, tmp_path):
    # The pipe is closed before anything is written, as by `| head -0`.
    script = (
        "import os, sys\n"
        "from voluminous.cli import main\n"
        "end, start = os.pipe()\n"
        "os.dup2(start, 1); os.close(start); os.close(end)\n"
        "sys.exit(main(['info', 'scene.toml']))\n"
    )
    done = process("-c", script, cwd=tmp_path)
    assert "Traceback" not in done.stderr
    assert "Exception" not in done.stderr


# render


def test_options_and_outputs(scene, capsys):
    options = ["--scheme", "first-order", "--precision", "double", "--set", "camera.incl=40"]
    change = ["--set", "medium.1.extinction=0 * inside"]
    assert run("render", scene, *options, *change, "-o", "a.png", "-o", "a.npz") == 0
    assert "first-order, double precision" in capsys.readouterr().out
    image, picture = vm.Image.load("a.npz"), vm.Image.load("a.png")
    assert image.camera["incl"] == 40
    # Eight bits: half a step is 1/510.
    np.testing.assert_allclose(picture.intensity, image.to_rgb(exposure=1), atol=2e-3)
    again = vm.Scene.load("a.png")
    assert again.to_dict()["medium"][0]["extinction"] == "0 * inside"
    np.testing.assert_array_equal(image.intensity, again.render().intensity)


def test_an_image_is_a_scene(scene, tmp_path):
    vm.models.sphere(8).save(tmp_path / "ball.h5")
    (tmp_path / "out").mkdir()  # paths on the command line are those of the shell
    from_file = ["--set", 'volume={path = "ball.h5"}', "-q"]
    assert run("render", scene, "-o", "out/a.png", *from_file) == 0
    # The path in it is relative to the image, wherever that was written.
    assert vm.Scene.load("out/a.png").to_dict()["volume"]["path"] == "../ball.h5"
    assert run("render", "out/a.png", "-o", "b.npz", "-q") == 0
    assert run("render", scene, "-o", "c.npz", *from_file) == 0
    np.testing.assert_array_equal(
        vm.Image.load("b.npz").intensity, vm.Image.load("c.npz").intensity
    )


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["-o", "a.pgn"], "unknown image format '.pgn'; did you mean '.png'"),
        (["-o", "no/a.png"], "the directory no does not exist"),
        (["-o", "folder.png"], "folder.png is a directory"),
        (["--set", "camera.inlc=4"], "[camera]: unknown key 'inlc'; did you mean 'incl'"),
        (["--set", "camra.incl=3"], "unknown section 'camra'; did you mean 'camera'"),
        (["--scheme", "first"], "[render]: unknown scheme 'first'; did you mean 'first-order'"),
        (["--set", "image.bits=9"], "[image]: bits must be 8 or 16"),
        (["--set", "medium.1.emissivity=indside"], "did you mean 'inside'"),
    ],
)
def test_mistakes_are_told_before_work_and_write_nothing(
    scene, tmp_path, capsys, arguments, expected
):
    (tmp_path / "folder.png").mkdir()
    before = sorted(tmp_path.rglob("*"))
    assert run("render", scene, *arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("voluminous: error: ")
    assert expected in err
    assert sorted(tmp_path.rglob("*")) == before


def test_ctrl_c_leaves_no_half_written_file(scene, tmp_path, capsys, monkeypatch):
    (tmp_path / "scene.png").write_bytes(b"old")

    @contextlib.contextmanager
    def interrupted(*_):
        def report(done, total):
            raise KeyboardInterrupt

        yield report

    monkeypatch.setattr(progress, "progress_bar", interrupted)
    assert run("render", scene) == 130
    assert capsys.readouterr().err == "voluminous: interrupted\n"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["scene.png", "scene.toml"]
    assert (tmp_path / "scene.png").read_bytes() == b"old"


# Writes, tells it, and is then still busy, whatever the format.
SLOWLY = """
import contextlib, sys, threading, time
from voluminous import files

plain = files._naming_if_full

@contextlib.contextmanager
def slow(path, temporary):
    with plain(path, temporary):
        yield
        print("half", flush=True)
        # Frames are written by a thread, for which the program waits.
        time.sleep(60 if threading.current_thread() is threading.main_thread() else 1)

files._naming_if_full = slow
"""
WRITES = {
    "render": ["render", "scene.toml"],
    "convert": ["convert", "data.npz", "data.zarr"],
    "convert to a file": ["convert", "data.npz", "data.vti"],
    "movie": ["movie", "scene.toml", "--orbit", "360", "--frames", "2", "-o", "film.gif"],
}


@pytest.fixture
def half_written(scene, tmp_path):
    """Return a function that starts a process, and returns it when it has written half of it."""
    values = np.random.default_rng(0).random((4, 5, 6))
    np.savez(tmp_path / "data.npz", density=values)

    def start(code, *arguments):
        command = [sys.executable, "-c", SLOWLY + code, *arguments]
        started = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE)
        assert started.stdout.readline() == b"half\n"
        assert [path.name for path in tmp_path.rglob(".*.part*")]
        return started

    return start


COMMAND = "from voluminous.cli import main; sys.exit(main())"


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="this system has no such signals")
@pytest.mark.parametrize(
    ("verb", "name"), [*((verb, "SIGTERM") for verb in WRITES), ("render", "SIGHUP")]
)
def test_the_end_of_a_job_leaves_nothing_half_written(half_written, tmp_path, verb, name):
    before = sorted(tmp_path.iterdir())
    with half_written(COMMAND, *WRITES[verb]) as started:
        started.send_signal(getattr(signal, name))
        assert started.wait(60) == 128 + getattr(signal, name)
    left = [path for path in tmp_path.iterdir() if path.name != "film.gif.frames"]
    assert sorted(left) == before
    assert not list(tmp_path.rglob(".*"))


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="this system has no such signals")
def test_what_nohup_starts_survives_the_terminal(half_written):
    ignoring = "import signal; signal.signal(signal.SIGHUP, signal.SIG_IGN)\n"
    with half_written(ignoring + COMMAND, *WRITES["render"]) as started:
        started.send_signal(signal.SIGHUP)
        with pytest.raises(subprocess.TimeoutExpired):
            started.wait(1)
        started.kill()


@pytest.mark.parametrize("target", ["data.zarr", "data.h5", "picture.png"])
def test_what_a_killed_program_leaves_goes_when_the_same_is_written_again(
    half_written, tmp_path, target
):
    code = "import voluminous as vm; v = vm.open('data.npz')\n"
    code += f"(v if {target!r}[0] == 'd' else vm.render(v)).save({target!r})"
    with half_written(code) as started:
        started.kill()
    (left,) = tmp_path.rglob(".*.part*")
    volume = vm.open(tmp_path / "data.npz")
    (vm.render(volume) if target == "picture.png" else volume).save(tmp_path / target)
    assert not left.exists()
    assert not list(tmp_path.rglob(".*"))


# progress


class Terminal(io.StringIO):
    """An error stream that is a terminal, or not."""

    is_terminal = False

    def isatty(self):
        return self.is_terminal


def test_a_bar_on_a_terminal_only(monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")

    def shown(wanted, is_terminal, seconds):
        terminal = Terminal()
        terminal.is_terminal = is_terminal
        monkeypatch.setattr(sys, "stderr", terminal)
        now = [1000.0]
        monkeypatch.setattr(time, "monotonic", lambda: now[0])
        with progress_bar(wanted, "core") as report:
            now[0] += seconds
            for done, total in ((0, 1), (50, 200), (20, 100), (100, 100)):
                report(done, total)
        return "core" in terminal.getvalue()

    assert [shown(w, False, 3.0) for w in (None, True, False)] == [False, True, False]
    assert [shown(w, True, 3.0) for w in (None, True, False)] == [True, True, False]
    assert [shown(w, True, 1.0) for w in (None, True, False)] == [False, True, False]


# demo


def test_demo_draws_three_panels_and_what_it_tells_to_type_works(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert run("demo", "--resolution", "40", "--cells", "20") == 0
    out = capsys.readouterr().out
    names = ["core-1.png", "core-2.png", "core-3.png", "core.png"]
    assert sorted(p.name for p in tmp_path.iterdir()) == names
    assert all(name in out for name in names)
    assert out.count("40 x 40 pixels, 3 channels, first-order, single precision") == 1
    assert out.count("40 x 40 pixels, 3 channels, second-order, single precision") == 2
    command = out.strip().splitlines()[-1].split()
    assert command[0] == "voluminous"
    assert main(command[1:]) == 0
    assert vm.Image.load("oblique.png").camera["incl"] == 60


def test_demo_in_python_gives_the_panels(tmp_path):
    images = vm.demo(tmp_path / "figure.png", resolution=20, cells=10)
    assert [i.provenance["scheme"] for i in images] == ["first-order", *["second-order"] * 2]
    _, second, third = (i.intensity[10, 10] for i in images)
    assert third[0] < second[0]  # what is inside absorbs
    # One exposure: the note's panels can be compared.
    again = vm.Image.load(tmp_path / "figure-3.png").intensity
    shown = images[2].to_rgb(exposure=images[0].exposure)
    np.testing.assert_allclose(again, shown, atol=0.5 / 255 + 1e-6)
    with pytest.raises(vm.InputError, match="is a PNG"):
        vm.demo(tmp_path / "figure.pdf")


# info


def test_info_of_a_scene(scene, tmp_path, capsys):
    assert run("info", scene) == 0
    out = capsys.readouterr().out
    assert "a scene, all of it valid" in out
    assert re.search(r"medium 1\n +type +\"coefficients\"", out)
    assert out.strip().endswith(f"Next: voluminous render {scene}")
    scene.write_text(SCENE.replace('model = "sphere"\nresolution = 8', 'path = "nowhere.npz"'))
    assert run("info", scene) == 0
    assert "There is no file" in capsys.readouterr().out


def test_info_of_a_volume_gives_a_scene_that_renders(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    volume = vm.models.prestellar_core(8)
    values = volume.array("density").copy()
    values[0, 0, 0], values[1, 1, 1] = np.nan, np.inf
    volume["broken"] = values
    volume.save("a.h5")
    assert run("info", "a.h5") == 0
    out = capsys.readouterr().out
    assert "8 x 8 x 8 cells, uniform" in out
    assert "1 NaN (first at [0, 0, 0]), 1 infinite (first at [1, 1, 1])" in out
    assert "density: float32, 8 x 8 x 8, 1 / cm3" in out
    assert "3.85715e+17 cm" in out
    Path("scene.toml").write_text(out[out.index("[volume]") :])
    assert run("render", "scene.toml", "--set", "camera.resolution=8", "-q") == 0
    assert vm.Image.load("scene.png").intensity.max() > 0


def test_info_tells_what_cannot_be_read(tmp_path, capsys):
    np.savez(tmp_path / "a.npz", image=np.ones((2, 2)))
    assert run("info", tmp_path / "a.npz") == 0
    assert "no three-dimensional array" in capsys.readouterr().out


def test_info_of_an_image(scene, capsys):
    name = "a.fits"
    run("render", scene, "-o", name, "-q")
    assert run("info", name) == 0
    out = capsys.readouterr().out
    assert "an image of 6 x 6 pixels" in out
    assert "camera: type orthographic" in out
    assert f"voluminous render {name}" in out


# doctor


def test_doctor_finds_all_well_here(capsys):
    assert run("doctor") == 0
    out = capsys.readouterr().out
    assert "LLVM" in out
    assert "double precision: right to" in out
    assert "All is well" in out


def test_doctor_tells_what_is_wrong_and_goes_on(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(doctor._TOLERANCE, "single", -1.0)
    (tmp_path / "file").touch()
    monkeypatch.setenv("DRJIT_CACHE_DIR", str(tmp_path / "file" / "cache"))
    assert run("doctor") == 1
    out = capsys.readouterr().out
    assert "WRONG: compiled kernels cannot be kept in" in out
    assert "WRONG: rays on 'cpu' in single precision are off" in out
    assert "Wrong: cache, rays." in out
