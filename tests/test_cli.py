"""The command line: what it writes, what it says, and how it fails."""

import contextlib
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import voluminous as vm
from voluminous import progress
from voluminous.cli import COMMANDS, doctor, main
from voluminous.cli.statistics import histogram, numbers, statistics
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
    """Run the command as a user does: in a process of its own."""
    return subprocess.run(
        [sys.executable, "-m", "voluminous", *map(str, arguments)],
        capture_output=True,
        text=True,
        encoding="utf-8",
        cwd=cwd,
        check=False,
    )


# The command as a process


def test_the_process_renders_and_fails_as_it_should(scene, tmp_path):
    done = process("render", "scene.toml", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")  # no progress bar in a pipe
    assert done.stdout.startswith("scene.png: 6 x 6 pixels, 2 channels, post-classified, single")
    assert (tmp_path / "scene.png").read_bytes().startswith(b"\x89PNG")
    failed = process("render", "scene.tomm", cwd=tmp_path)
    assert (failed.returncode, failed.stdout) == (2, "")
    assert (
        failed.stderr
        == "voluminous: error: there is no file scene.tomm; did you mean scene.toml?\n"
    )


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
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, cwd=tmp_path, check=False
    )
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
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, cwd=tmp_path, check=False
    )
    assert "Traceback" not in done.stderr
    assert "Exception" not in done.stderr


# render


def test_render_writes_all_outputs(scene, tmp_path):
    assert run("render", scene, "-o", "a.png", "-o", "a.npz", "-q") == 0
    image = vm.Image.load("a.npz")
    np.testing.assert_array_equal(image.intensity, vm.Scene.load(scene).render().intensity)
    # Eight bits: half a step is 1/510.
    np.testing.assert_allclose(
        vm.Image.load("a.png").intensity, image.to_rgb(exposure=1), atol=2e-3
    )


def test_options_and_set_change_the_scene(scene, capsys):
    options = ["--scheme", "first-order", "--precision", "double", "--set", "camera.incl=40"]
    assert run("render", scene, *options, "--set", "medium.1.extinction=0 * inside") == 0
    assert "first-order, double precision" in capsys.readouterr().out
    image = vm.Image.load("scene.png")
    assert image.camera["incl"] == 40
    assert vm.Scene.load("scene.png").to_dict()["medium"][0]["extinction"] == "0 * inside"


def test_an_image_is_a_scene(scene, tmp_path):
    vm.models.sphere(8).save(tmp_path / "ball.h5")
    (tmp_path / "out").mkdir()
    from_file = ["--set", 'volume={path = "ball.h5"}', "-q"]
    assert run("render", scene, "-o", "out/a.png", *from_file) == 0
    # The path in it is relative to the image, wherever that was written.
    assert vm.Scene.load("out/a.png").to_dict()["volume"]["path"] == "../ball.h5"
    assert run("render", "out/a.png", "-o", "b.npz", "-q") == 0
    assert run("render", scene, "-o", "c.npz", *from_file) == 0
    np.testing.assert_array_equal(
        vm.Image.load("b.npz").intensity, vm.Image.load("c.npz").intensity
    )


def test_paths_on_the_command_line_are_those_of_the_shell(scene, tmp_path, monkeypatch):
    vm.models.sphere(8).save(tmp_path / "ball.npz")
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    text = SCENE.replace('model = "sphere"\nresolution = 8', 'path = "nowhere.npz"')
    scene.write_text(text)
    assert run("render", scene, "-q") == 2
    assert run("render", scene, "-q", "--set", "volume.path=../ball.npz") == 0


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["-o", "a.pgn"], "unknown image format '.pgn'; did you mean '.png'"),
        (["-o", "no/a.png"], "the directory no does not exist"),
        (["-o", "folder.png"], "folder.png is a directory"),
        (["--set", "camera.inlc=4"], "[camera]: unknown key 'inlc'; did you mean 'incl'"),
        (["--set", "camera.incl"], "--set expects KEY=VALUE"),
        (["--set", "camra.incl=3"], "unknown section 'camra'; did you mean 'camera'"),
        (["--scheme", "first"], "[render]: unknown scheme 'first'; did you mean 'first-order'"),
        (["--device", "gpu"], "[render]: unknown device 'gpu'"),
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


# progress


class Terminal:
    """An error stream that is a terminal."""

    encoding = "utf-8"

    def __init__(self):
        self.text = ""

    def isatty(self):
        return True

    def write(self, text):
        self.text += text

    def flush(self):
        pass


def test_a_bar_on_a_terminal_only(monkeypatch):
    terminal = Terminal()
    terminal.isatty = lambda: False
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setattr(progress, "_DELAY", 0.0)
    monkeypatch.setenv("COLUMNS", "80")

    def shown(wanted):
        terminal.text = ""
        with progress_bar(wanted, "core") as report:
            report(0, 1)
            report(50, 200)
            report(20, 100)
            report(100, 100)
        return "core" in terminal.text

    assert (shown(None), shown(True), shown(False)) == (False, True, False)
    terminal.isatty = lambda: True
    assert (shown(None), shown(True), shown(False)) == (True, True, False)
    monkeypatch.setattr(progress, "_DELAY", 60.0)
    assert (shown(None), shown(True), shown(False)) == (False, True, False)


# demo


def test_demo_draws_three_panels_and_says_so(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert run("demo", "--resolution", "40", "--cells", "20") == 0
    out = capsys.readouterr().out
    names = ["core-1.png", "core-2.png", "core-3.png", "core.png"]
    assert sorted(p.name for p in tmp_path.iterdir()) == names
    assert all(name in out for name in names)
    assert out.count("40 x 40 pixels, 3 channels, first-order, single precision") == 1
    assert out.count("40 x 40 pixels, 3 channels, second-order, single precision") == 2
    assert "s in all" in out
    first, second, third = (vm.Image.load(name).intensity for name in names[:3])
    assert first.shape == (40, 40, 3)
    assert not np.array_equal(first, second)
    assert not np.array_equal(first, third)


def test_demo_in_python_gives_the_panels(tmp_path):
    images = vm.demo(tmp_path / "figure.png", resolution=20, cells=10)
    assert [i.provenance["scheme"] for i in images] == ["first-order", *["second-order"] * 2]
    _, second, third = (i.intensity[10, 10] for i in images)
    assert third[0] < second[0]  # what is inside absorbs
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        *(f"figure-{k}.png" for k in (1, 2, 3)),
        "figure.png",
    ]
    # One exposure: the note's panels can be compared.
    again = vm.Image.load(tmp_path / "figure-3.png").intensity
    shown = images[2].to_rgb(exposure=images[0].exposure)
    np.testing.assert_allclose(again, shown, atol=0.5 / 255 + 1e-6)
    with pytest.raises(vm.InputError, match="is a PNG"):
        vm.demo(tmp_path / "figure.pdf")


def test_what_demo_tells_to_type_works(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    run("demo", "--resolution", "10", "--cells", "10", "--scheme", "first-order")
    command = capsys.readouterr().out.strip().splitlines()[-1].split()
    assert command[0] == "voluminous"
    assert main(command[1:]) == 0
    assert vm.Image.load("oblique.png").camera["incl"] == 60


def test_a_scheme_is_looked_up_before_a_file_is_read(tmp_path, capsys):
    damaged = tmp_path / "damaged.npy"
    np.save(damaged, np.zeros((8, 8, 8)))
    damaged.write_bytes(damaged.read_bytes()[:1000])
    for option, wrong, right in (
        ("--scheme", "first-odrer", "first-order"),
        ("--precision", "duoble", "double"),
        ("--device", "cdua", "cuda"),
    ):
        assert run("render", damaged, option, wrong) == 2
        assert f"unknown {option[2:]} '{wrong}'; did you mean '{right}'" in capsys.readouterr().err


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


@pytest.mark.parametrize("name", ["a.h5", "a.npz", "density.npy"])
def test_info_of_a_volume_gives_a_scene_that_renders(tmp_path, monkeypatch, capsys, name):
    monkeypatch.chdir(tmp_path)
    volume = vm.models.prestellar_core(8)
    values = volume.array("density").copy()
    values[0, 0, 0], values[1, 1, 1] = np.nan, np.inf
    volume["broken"] = values
    if name == "density.npy":
        np.save(name, volume.array("density"))
    else:
        volume.save(name)
    assert run("info", name) == 0
    out = capsys.readouterr().out
    assert "8 x 8 x 8 cells, uniform" in out
    if name != "density.npy":
        assert "1 NaN (first at [0, 0, 0]), 1 infinite (first at [1, 1, 1])" in out
        assert "density: float32, 8 x 8 x 8, 1 / cm3" in out
        assert "3.85715e+17 cm" in out
    Path("scene.toml").write_text(out[out.index("[volume]") :])
    assert run("render", "scene.toml", "--set", "camera.resolution=8", "-q") == 0
    assert vm.Image.load("scene.png").intensity.max() > 0


def test_info_tells_what_cannot_be_read(tmp_path, capsys):
    np.savez(tmp_path / "a.npz", rho=np.ones((0, 2, 2)), image=np.ones((2, 2)))
    assert run("info", tmp_path / "a.npz") == 0
    assert "expected at least one cell" in capsys.readouterr().out
    np.savez(tmp_path / "a.npz", image=np.ones((2, 2)))
    assert run("info", tmp_path / "a.npz") == 0
    assert "no three-dimensional array" in capsys.readouterr().out


@pytest.mark.parametrize("name", ["a.png", "a.fits", "a.npz"])
def test_info_of_an_image(scene, capsys, name):
    run("render", scene, "-o", name, "-q")
    assert run("info", name) == 0
    out = capsys.readouterr().out
    assert "an image of 6 x 6 pixels" in out
    assert "camera: type orthographic" in out
    assert f"voluminous render {name}" in out


def test_statistics():
    array = np.array([[1.0, 10.0], [np.nan, 100.0], [-np.inf, 10.0]])
    found = statistics(array)
    assert (found.least, found.greatest, found.nan, found.infinite) == (1, 100, 1, 1)
    assert numbers(found) == "1 … 100, mean 30.25, 1 NaN, 1 infinite"
    bars = histogram(array, found, logarithmic=True)
    assert [bars[1], bars[-2], bars.count("█")] == ["▄", "▄", 1]
    assert numbers(statistics(np.full(3, np.nan))) == "no finite value, 3 NaN"


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
