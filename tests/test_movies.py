"""Films: paths of cameras, fading media, and files that are whole, resumed and alike."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from astropy import units as u

import voluminous as vm
from voluminous.movies import dolly, fade, fly, keyframes, orbit, zoom
from voluminous.movies.fade import scaled
from voluminous.rotation import image_axes

GRID = vm.CartesianGrid.uniform(8, (-1, 1))
X, Y, Z = np.meshgrid(*[np.linspace(-0.9, 0.9, 8)] * 3, indexing="ij")
VOLUME = vm.Volume(GRID, a=np.exp(-(X**2) - 2 * Y**2 - 3 * Z**2))
SHELL = vm.Gaussian("a", 0.5, 0.1, (1.0, 0.5, 0.2), 0.3, path_length=0.2)
CORE = vm.Gaussian("a", 0.8, 0.1, (0.2, 0.5, 1.0), 0.3, path_length=0.3)
VIEW = vm.Orthographic(60, 30, 10, width=2.5, resolution=(12, 8))
EYE = vm.Perspective((0, -4, 1), (0, 0, 0), 40, resolution=8)


def left_by_the_dead(path):
    """Begin to write a file in a process that is killed then; return what it leaves."""
    code = (
        "import os, sys\nfrom pathlib import Path\nfrom voluminous.files import replacing\n"
        "with replacing(Path(sys.argv[1])) as file:\n"
        "    file.write_bytes(b'half')\n    print(file, flush=True)\n    os.kill(os.getpid(), 9)\n"
    )
    child = subprocess.run([sys.executable, "-c", code, str(path)], stdout=subprocess.PIPE)
    return Path(child.stdout.decode().strip())


def axes(camera):
    vectors = camera.frame(GRID).vectors
    return vectors[1:3]


@pytest.mark.parametrize("camera", [VIEW, EYE, vm.Panorama((0, 0.1, 0), (0, 1, 0), resolution=8)])
@pytest.mark.parametrize("axis", [(0, 0, 1), (1, 2, 3)])
def test_an_orbit_closes(camera, axis):
    path = orbit(camera, 1, 12, axis=axis)
    assert len(path) == 12
    assert path[0] is camera
    for one, next_one in zip(path, [*path[1:], path[0]], strict=True):
        turn = axes(next_one) @ np.linalg.inv(np.vstack([axes(one), np.cross(*axes(one))]))
        # Every step is the same rotation, by 30 degrees: the trace of a rotation is 1 + 2 cos.
        full = np.vstack([axes(one), np.cross(*axes(one))])
        after = np.vstack([axes(next_one), np.cross(*axes(next_one))])
        assert np.trace(after.T @ full) == pytest.approx(1 + 2 * np.cos(np.pi / 6), abs=1e-9)
        assert turn.shape == (2, 3)


def test_an_orbit_keeps_the_target_and_the_distance():
    for camera in orbit(EYE, 0.5, 5, axis=(1, 0, 0)):
        np.testing.assert_allclose(camera.target, 0, atol=1e-14)
        assert np.linalg.norm(camera.position) == pytest.approx(np.sqrt(17))


def test_phi_grows_on_an_orbit_and_the_other_angles_stay():
    path = orbit(VIEW, 1, 4)
    assert [c.phi for c in path] == [30, 120, 210, 300]
    assert {(c.incl, c.posang) for c in path} == {(60, 10)}


def test_zoom_and_dolly_are_geometric():
    widths = [c.width[0] for c in zoom(VIEW, 1000, 4)]
    np.testing.assert_allclose(widths, 2.5 / np.array([1, 10, 100, 1000]))
    away = [np.linalg.norm(c.position) for c in dolly(EYE, 8, 4)]
    np.testing.assert_allclose(away, np.sqrt(17) / np.array([1, 2, 4, 8]))
    assert dolly(EYE, 8, 4)[2].width == pytest.approx(EYE.width)


def test_units_stay():
    camera = vm.Orthographic(width=2 * u.pc, center=(1, 0, 0) * u.pc)
    last = zoom(camera, 4, 3)[-1]
    assert last.width.to_value("pc") == pytest.approx([0.5, 0.5])
    around = orbit(vm.Perspective((1, 0, 0) * u.pc, (0, 0, 0) * u.pc), 0.5, 2)
    assert around[1].position.to_value("pc") == pytest.approx([0, -1, 0], abs=1e-12)


def test_a_flight_has_constant_speed_and_looks_ahead():
    angle = np.linspace(0, np.pi, 9)
    points = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    path = fly(points, 50, fov=70, resolution=8)
    places = np.array([c.position for c in path])
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    np.testing.assert_allclose(steps, np.pi / 49, rtol=5e-3)  # chords; a spline through 9 points
    ahead = np.array([np.subtract(c.target, c.position) for c in path])
    tangent = np.stack([-places[:, 1], places[:, 0], 0 * places[:, 0]], axis=1)
    ahead /= np.linalg.norm(ahead, axis=1)[:, None]
    assert np.all(np.sum(ahead * tangent, axis=1) > 0.999)
    assert {tuple(c.target) for c in fly(points, 3, target=(0, 0, 0))} == {(0, 0, 0)}


@pytest.mark.parametrize("ease", ["smooth", "linear", "through"])
def test_keyframes_are_met(ease):
    keys = [
        (0, vm.Orthographic(0, 0, 0, 4.0, center=(0, 0, 0))),
        (10, vm.Orthographic(60, 90, 5, 2.0, center=(1, 0, 0))),
        (25, vm.Orthographic(90, 200, 0, 0.1, center=(1, 0.5, 0))),
    ]
    path = keyframes(keys, ease)
    assert len(path) == 26
    for frame, camera in keys:
        np.testing.assert_allclose(axes(path[frame]), axes(camera), atol=1e-12)
        np.testing.assert_allclose(path[frame].width, camera.width, rtol=1e-12)
        np.testing.assert_allclose(path[frame].center, camera.center, atol=1e-12)


def test_a_smooth_way_starts_and_ends_at_rest_and_a_linear_one_does_not():
    keys = [(0, vm.Orthographic(0, 0, width=1)), (100, vm.Orthographic(90, 0, width=1))]
    smooth, even = (np.array([c.incl for c in keyframes(keys, e)]) for e in ("smooth", "linear"))
    np.testing.assert_allclose(even, np.linspace(0, 90, 101), atol=1e-9)
    t = np.linspace(0, 1, 101)
    np.testing.assert_allclose(smooth, 90 * t**2 * (3 - 2 * t), atol=1e-9)


def test_a_zoom_between_keys_goes_straight_to_its_end():
    """What is in the middle at the end moves on a straight line through the picture, inwards."""
    keys = [
        (0, vm.Orthographic(0, 0, 0, 10.0, center=(0, 0, 0))),
        (50, vm.Orthographic(0, 0, 0, 0.01, center=(3, 1, 0))),
    ]
    place = [
        (3 - c.center[0]) / c.width[0] for c in keyframes(keys, "linear")
    ]  # in widths of the picture
    np.testing.assert_allclose(np.diff(place) <= 1e-9, True)
    assert place[0] == pytest.approx(0.3)


def test_rotations_take_the_shortest_way():
    keys = [(0, vm.Orthographic(90, 10, width=1)), (10, vm.Orthographic(90, 350, width=1))]
    middle = keyframes(keys, "linear")[5]
    np.testing.assert_allclose(axes(middle), image_axes(90, 0, 0)[:2], atol=1e-12)


@pytest.mark.parametrize(
    "medium",
    [
        SHELL,
        vm.Rectangle("a", 0.5, 0.1, 1.0, 0.3, path_length=0.2),
        vm.Table("a", [0, 1], [[0.0], [1.0]], [0.0, 0.5], path_length=0.2),
        vm.Colormap("a", "viridis", 0, 1, 0.4, path_length=0.2),
        vm.Coefficients(["a", "2*a"], "a"),
        vm.Isosurface("a", 0.5, 1.0, 0.4, width=0.2),
    ],
)
def test_fading_scales_emission_and_extinction(medium):
    """A thin medium at a quarter of its strength has a quarter of everything, to first order."""
    weak, weaker = scaled(medium, 1e-3), scaled(medium, 2.5e-4)
    pictures = [vm.render(VOLUME, m, VIEW, precision="double") for m in (weak, weaker)]
    ratio = pictures[1].intensity.sum() / pictures[0].intensity.sum()
    assert ratio == pytest.approx(0.25, rel=1e-2)  # self-absorption is of second order
    depth = pictures[1].optical_depth.sum() / pictures[0].optical_depth.sum()
    assert depth == pytest.approx(0.25, rel=1e-2)


def test_a_fade_ends_where_it_should_and_keeps_what_both_have():
    media = fade(SHELL + CORE, SHELL + CORE.replace(color="red"), 5)
    assert media[0].components() == (SHELL, CORE)
    assert media[-1].components() == (SHELL, CORE.replace(color="red"))
    assert len(media[2].components()) == 3
    with pytest.raises(vm.InputError, match="calibrated"):
        fade(SHELL, vm.Gaussian("a", 0.5, 0.1, 1.0, 0.3), 3)


def test_frames_are_pictures_of_one_exposure(tmp_path):
    cameras = zoom(VIEW, 4, 5)
    paths = vm.movie(VOLUME, SHELL, cameras, tmp_path / "zoom.png")
    assert [p.name for p in paths] == [f"zoom_{k:04d}.png" for k in range(5)]
    assert sorted(p.name for p in tmp_path.iterdir()) == [p.name for p in paths]
    images = [vm.render(VOLUME, SHELL, camera) for camera in cameras]
    exposure = min(image.exposure for image in images)
    for path, image in zip(paths, images, strict=True):
        shown = vm.Image.load(path).intensity
        # The exposure comes from coarse pictures, here the same as the pictures themselves.
        np.testing.assert_allclose(shown, image.to_rgb(exposure=exposure), atol=2 / 255)


def test_an_interrupted_film_goes_on_and_is_the_same(tmp_path):
    cameras = orbit(VIEW, 1, 6)
    whole = vm.movie(VOLUME, SHELL, cameras, tmp_path / "whole.png")

    def stop_at(frame):
        def progress(done, total):
            if done == frame:
                raise KeyboardInterrupt

        return progress

    for frame in (1, 1, 2, 4, 5):
        with pytest.raises(KeyboardInterrupt):
            vm.movie(VOLUME, SHELL, cameras, tmp_path / "cut.png", progress=stop_at(frame))
    left_by_the_dead(tmp_path / "cut_0003.png")
    paths = vm.movie(VOLUME, SHELL, cameras, tmp_path / "cut.png")
    for one, other in zip(whole, paths, strict=True):
        assert one.read_bytes() == other.read_bytes()
    assert len(list(tmp_path.iterdir())) == 12


def test_a_film_that_was_killed_goes_on_and_leaves_nothing(tmp_path):
    cameras = orbit(VIEW, 1, 100)
    target = tmp_path / ("of_a_name_of_more_than_forty_letters_" + 5 * "x" + ".gif")
    frames = tmp_path / f"{target.name}.frames"
    code = (
        "import voluminous as vm\nfrom test_movies import SHELL, VIEW, VOLUME\n"
        f"vm.movie(VOLUME, SHELL, vm.orbit(VIEW, frames=100), {str(target)!r})"
    )
    paths = os.pathsep.join([str(Path(__file__).parent), str(Path(vm.__file__).parents[1])])
    child = subprocess.Popen([sys.executable, "-c", code], env={**os.environ, "PYTHONPATH": paths})
    while child.poll() is None and not (frames / "0003.png").exists():
        time.sleep(0.005)
    child.kill()
    child.wait()
    assert 4 <= len(list(frames.glob("[0-9]*.png"))) < 100
    # Killed while it wrote, too.
    left_by_the_dead(frames / "0007.png")
    left_by_the_dead(target)
    vm.movie(VOLUME, SHELL, cameras, target, keep_frames=True)
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted([target.name, frames.name])
    whole = vm.movie(VOLUME, SHELL, cameras, tmp_path / "whole.png")
    for one, other in zip(whole, sorted(frames.iterdir()), strict=True):
        assert one.read_bytes() == other.read_bytes()


def test_only_what_changed_is_made_again(tmp_path):
    cameras = orbit(VIEW, 1, 4)
    picture = {"exposure": 1.0}
    paths = vm.movie(VOLUME, SHELL, cameras, tmp_path / "a.png", picture=picture)
    before = [p.stat().st_mtime_ns for p in paths]
    changed = [*cameras[:2], VIEW.replace(incl=20), cameras[3]]
    paths[3].write_bytes(b"damaged")
    vm.movie(VOLUME, SHELL, changed, tmp_path / "a.png", picture=picture)
    after = [p.stat().st_mtime_ns for p in paths]
    assert [a == b for a, b in zip(before, after, strict=True)] == [True, True, False, False]


@pytest.mark.parametrize("suffix", [".mp4", ".gif", ".webp"])
def test_films_have_their_frames(tmp_path, suffix):
    if suffix == ".mp4":
        av = pytest.importorskip("av")
    cameras = orbit(VIEW.replace(resolution=(65, 48)), 1, 8)
    (path,) = vm.movie(VOLUME, SHELL, cameras, tmp_path / f"film{suffix}", fps=12)
    assert [p.name for p in tmp_path.iterdir()] == [path.name]
    first = vm.render(VOLUME, SHELL, cameras[0])
    if suffix == ".mp4":
        with av.open(str(path)) as file:
            frames = [f.to_ndarray(format="rgb24") for f in file.decode(video=0)]
            assert file.streams.video[0].average_rate == 12
    else:
        from PIL import Image, ImageSequence

        with Image.open(path) as file:
            frames = [np.asarray(f.convert("RGB")) for f in ImageSequence.Iterator(file)]
            assert abs(file.info["duration"] - 1000 / 12) < 6  # GIF counts hundredths of a second
    assert len(frames) == 8
    exposure = min(vm.render(VOLUME, SHELL, c).exposure for c in cameras)
    wanted = first.to_rgb(exposure=exposure)[::-1]
    # Codecs lose some: eight of 255 on average is a picture that nobody would take for another.
    assert np.abs(frames[0][:48, :65] / 255 - wanted).mean() < 8 / 255


def test_a_series_in_time_is_opened_file_by_file(tmp_path):
    for k in range(3):
        vm.Volume(GRID, a=VOLUME["a"] * (1 + k)).save(tmp_path / f"out_{k}.npz")
    series = sorted(tmp_path.glob("out_*.npz"))
    medium = vm.Coefficients("a", "a")
    paths = vm.movie(series, medium, orbit(VIEW, 1, 6), tmp_path / "film.npz")
    light = [vm.Image.load(p).intensity.mean() for p in paths]
    assert len(light) == 6
    assert light[0] < light[2] < light[4]
    assert len(vm.movie(series, medium, VIEW, tmp_path / "still.npz")) == 3


def test_the_unit_of_a_scale_bar_is_that_of_the_first_frame(tmp_path, monkeypatch):
    volume = vm.Volume(vm.CartesianGrid.uniform(4, (-1, 1), unit="pc"), a=np.ones((4, 4, 4)))
    given = []
    monkeypatch.setattr(vm.Image, "save", lambda image, path, **options: given.append(options))
    cameras = zoom(vm.Orthographic(width=2, resolution=16), 1000, 2)
    medium = vm.Coefficients("a", "a")
    vm.movie(volume, medium, cameras, tmp_path / "a.png", picture={"annotate": {"title": "a"}})
    assert [options["annotate"] for options in given] == [{"title": "a", "unit": "pc"}] * 2


def test_an_anaglyph_has_one_eye_in_red_and_one_in_cyan(tmp_path):
    camera = vm.Perspective((0, -4, 1), (0, 0, 0), 40, resolution=8, stereo="side-by-side")
    image = vm.render(VOLUME, SHELL, camera)
    both = image.anaglyph()
    assert both.shape == (8, 8, 3)
    np.testing.assert_array_equal(both.intensity[..., 1:], image.intensity[:, 8:, 1:])
    left = image.intensity[:, :8] @ np.array([0.2126, 0.7152, 0.0722], np.float32)
    np.testing.assert_allclose(both.intensity[..., 0], left, rtol=1e-6)
    above = vm.render(VOLUME, SHELL, camera.replace(stereo="over-under")).anaglyph()
    np.testing.assert_allclose(above.intensity, both.intensity, rtol=1e-5, atol=1e-6)
    vm.movie(VOLUME, SHELL, [camera], tmp_path / "a.png", finish=lambda i: i.anaglyph())
    with pytest.raises(vm.InputError, match="stereo"):
        vm.render(VOLUME, SHELL, EYE).anaglyph()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda path: vm.movie(VOLUME, SHELL, VIEW, path / "film.avi"), r"\.mp4"),
        (lambda path: vm.movie(VOLUME, [SHELL] * 3, [VIEW] * 2, path / "film.gif"), "3 media"),
        (lambda path: vm.movie(VOLUME, SHELL, [], path / "film.gif"), "at least one"),
        (lambda path: vm.movie(VOLUME, SHELL, VIEW, path / "film.gif", fps=0), "fps"),
        (lambda path: orbit(VIEW, frames=0), "frames"),
        (lambda path: orbit(VIEW, axis=(0, 0, 0)), "axis"),
        (lambda path: zoom(vm.Orthographic(), 10), "width"),
        (lambda path: zoom(VIEW, -1), "factor"),
        (lambda path: dolly(VIEW, 2), "position"),
        (lambda path: fly([(0, 0, 0)]), "positions"),
        (lambda path: keyframes([(5, VIEW), (2, VIEW)]), "ascend"),
        (lambda path: keyframes([(0, VIEW), (2, EYE)]), "one kind"),
        (lambda path: keyframes([(0, VIEW), (2, vm.Orthographic())]), "width and center"),
    ],
)
def test_bad_arguments(call, message, tmp_path):
    with pytest.raises(vm.InputError, match=message):
        call(tmp_path)
