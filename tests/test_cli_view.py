"""The commands view and movie."""

from __future__ import annotations

import argparse
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import voluminous as vm
from voluminous.cli import main

SCENE = """
[volume]
model = "prestellar_core"
resolution = 16
[[medium]]
type = "gaussian"
expr = "log10(density)"
center = 4
sigma = 0.2
color = [1.0, 0.5, 0.2]
opacity = 0.3
path_length = "2e16 cm"
[camera]
incl = 60
width = "0.25 pc"
resolution = 24
"""


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(SCENE)
    return path


def test_an_orbit_of_a_scene(scene, tmp_path):
    assert main(["movie", str(scene), "--orbit", "3", "-o", str(tmp_path / "a.npz"), "-q"]) == 0
    images = [vm.Image.load(tmp_path / f"a_{k:04d}.npz") for k in range(3)]
    wanted = vm.Scene.load(scene).replaced({"camera.phi": 120.0}).render()
    np.testing.assert_array_equal(images[1].intensity, wanted.intensity)


@pytest.mark.parametrize("how", [["--zoom", "10"], ["--dolly", "3"], ["--keyframes", "KEYS"]])
def test_other_paths(scene, tmp_path, how):
    keys = tmp_path / "keys.toml"
    keys.write_text(
        "[[keyframe]]\nframe = 0\n[[keyframe]]\nframe = 3\ncamera.incl = 20\n"
        'camera.width = "0.1 pc"\n'
    )
    if how[0] == "--dolly":
        scene.write_text(
            SCENE.replace(
                'incl = 60\nwidth = "0.25 pc"',
                'type = "perspective"\nposition = ["0 pc", "-0.5 pc", "0 pc"]\n'
                'target = ["0 pc", "0 pc", "0 pc"]',
            )
        )
    words = [str(keys) if word == "KEYS" else word for word in how]
    path = tmp_path / "film.gif"
    assert main(["movie", str(scene), *words, "--frames", "4", "-o", str(path), "-q"]) == 0
    from PIL import Image

    with Image.open(path) as film:
        assert film.n_frames == 4


def test_a_series(scene, tmp_path, capsys):
    core = vm.models.prestellar_core(16)
    for k in range(2):
        core.save(tmp_path / f"out_{k}.npz")
    arguments = ["movie", str(scene), "--over", str(tmp_path / "out_*.npz")]
    assert main([*arguments, "-o", str(tmp_path / "b.png")]) == 0
    assert "b_0000.png … b_0001.png" in capsys.readouterr().out


FILE_SCENE = """
[volume]
path = "out_0.npz"
bounds = ["-5 pc", "5 pc"]
[volume.units]
density = "g/cm3"
[volume.derived]
twice = "2 * density"
[[medium]]
type = "coefficients"
emissivity = "twice * 1 cm3/(g pc)"
extinction = "density * 1 cm3/(g pc)"
[camera]
resolution = 12
[render]
background = "behind.npz"
[image]
stretch = "asinh"
"""


def test_a_series_is_opened_as_the_file_of_the_scene(tmp_path, monkeypatch):
    """With bounds, units, names and derived fields, and before the scene's background."""
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(1)
    for k in range(3):
        np.savez(f"out_{k}.npz", density=rng.random((8, 8, 8)), other=np.ones((8, 8, 8)))
    vm.Image(np.full((12, 12, 1), 0.5)).save("behind.npz")
    Path("scene.toml").write_text(FILE_SCENE)
    words = ["movie", "scene.toml", "--over", "out_[12].npz", "-q"]
    assert main([*words, "-o", "film.npz"]) == 0
    for k in (0, 1):
        shown = vm.Image.load(f"film_000{k}.npz")
        scene = vm.Scene.load("scene.toml").replaced({"volume.path": f"out_{k + 1}.npz"})
        wanted = scene.render()
        np.testing.assert_array_equal(shown.intensity, wanted.intensity)
        assert shown.unit == wanted.unit == "pc"
    # The scale bar has a unit; the scene's own file need not be there.
    Path("out_0.npz").unlink()
    assert main([*words, "--annotate", "-o", "film.png"]) == 0
    assert main([*words, "--zoom", "3", "--frames", "2", "-o", "zoom.png"]) == 0
    # Frames that are there are taken, unless their file or the scene was changed.
    before = [Path(f"film_000{k}.npz").stat().st_mtime_ns for k in (0, 1)]
    np.savez("out_2.npz", density=rng.random((8, 8, 8)))
    assert main([*words, "-o", "film.npz"]) == 0
    after = [Path(f"film_000{k}.npz").stat().st_mtime_ns for k in (0, 1)]
    assert [a == b for a, b in zip(before, after, strict=True)] == [True, False]
    assert main([*words, "--set", "volume.derived.twice=3 * density", "-o", "film.npz"]) == 0
    last = [Path(f"film_000{k}.npz").stat().st_mtime_ns for k in (0, 1)]
    assert all(a != b for a, b in zip(after, last, strict=True))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ([], "what moves"),
        (["--orbit", "3", "--zoom", "2"], "--orbit and --zoom"),
        (["--over", "nothing_*"], "no files"),
        (["--orbit", "0"], "positive whole"),
    ],
)
def test_films_that_cannot_be(scene, tmp_path, capsys, options, message):
    assert main(["movie", str(scene), *options, "-o", str(tmp_path / "a.png")]) == 2
    assert message in capsys.readouterr().err


def test_view_has_all_fields_of_a_file(tmp_path):
    from voluminous.cli import render, view

    core = vm.models.prestellar_core(16)
    core["warm"] = "density**0.5"
    core.save(tmp_path / "core.npz")
    parser = argparse.ArgumentParser()
    view.add_arguments(parser)
    args = parser.parse_args([str(tmp_path / "core.npz")])
    args.quiet = True
    scene = render.scene_from(args, all_fields=True)
    assert set(scene.volume().fields) == {"density", "warm"}
    assert "fields" not in scene.to_dict()["volume"]
    assert set(render.scene_from(args).volume().fields) == {"density"}


@pytest.mark.parametrize("how", [["--no-browser"], ["--socket"]])
def test_view_prints_its_address_and_ends_with_ctrl_c(scene, how):
    pytest.importorskip("uvicorn")
    command = [sys.executable, "-m", "voluminous", "view", str(scene), *how]
    environment = {k: v for k, v in os.environ.items() if k != "SSH_CONNECTION"}
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
    ) as process:
        text = ""
        while "#token=" not in text:
            line = process.stdout.readline()
            assert line, process.stderr.read()
            text += line
        assert re.search(r"http://127\.0\.0\.1:\d+/#token=[\w-]{43}\n", text)
        assert ("ssh -N -L" in text) == (how == ["--socket"])
        time.sleep(0.2)
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == 130
        if how == ["--socket"]:
            folder = re.search(r"-L 8080:(\S+)/view\.sock", text)[1]
            assert not os.path.exists(folder)


def test_view_of_what_cannot_be_opened(tmp_path, capsys):
    """No address for what nothing can read; of other files the page is told what is wrong, too."""
    pytest.importorskip("uvicorn")
    (tmp_path / "words.txt").write_text("no volume")
    for name in ("missing.npy", "words.txt"):
        assert main(["view", str(tmp_path / name), "--no-browser"]) == 2
        out, err = capsys.readouterr()
        assert "#token=" not in out
        assert name in err
    np.save(tmp_path / "short.npy", np.zeros((8, 8, 8)))
    content = (tmp_path / "short.npy").read_bytes()
    (tmp_path / "short.npy").write_bytes(content[:-100])
    assert main(["view", str(tmp_path / "short.npy"), "--no-browser"]) == 2
    out, err = capsys.readouterr()
    assert "#token=" in out
    assert "short.npy" in err
