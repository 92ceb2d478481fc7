"""Films: paths of cameras, fading media, and files that are whole, resumed and alike."""

from __future__ import annotations

import functools
import os
import subprocess
import sys
import threading
import time
import warnings
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from astropy import units as u
from matplotlib.colors import FuncNorm, ListedColormap, Normalize, PowerNorm, SymLogNorm

import voluminous as vm
from voluminous.geometry import image_axes
from voluminous.movies import dolly, fade, fly, keyframes, orbit, zoom
from voluminous.movies.encode import encode

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
    weak, weaker = medium.scaled(1e-3), medium.scaled(2.5e-4)
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


class Brighter:
    """Makes images brighter, as an object, by a method, or in an attribute of the class."""

    offset = 0.0

    def __init__(self, factor):
        self.factor = factor

    def __call__(self, image):
        return image.replace(intensity=image.intensity * self.factor + self.offset)

    def method(self, image):
        return self(image)


def brighter(image, factor=2.0, *, power=1.0):
    return image.replace(intensity=(image.intensity * factor) ** power)


def by_closure(factor):
    return lambda image: brighter(image, factor)


def by_default(factor):
    def finish(image, factor=factor, *, table=np.full(3, factor)):  # noqa: B008
        return brighter(image, table[0])

    return finish


def by_source(text):
    """Return a function of a notebook, whose cell was run with this text."""
    cell = {"__name__": "__main__", "np": np}
    exec(text, cell)
    return cell["finish"]


# Functions that differ in one value, deeper and deeper.
FINISHES = {
    "closure": by_closure,
    "array": lambda factor: by_closure(np.full(3, factor)),
    "two closures": lambda factor: lambda image: by_closure(factor)(image),
    "default": by_default,
    "partial": lambda factor: functools.partial(brighter, factor=factor),
    "object": Brighter,
    "method": lambda factor: Brighter(factor).method,
    "class": lambda factor: type("Mine", (Brighter,), {"offset": factor - 2.0})(1.0),
    "code": lambda factor: by_source(
        f"finish = lambda image: (lambda i: i.replace(intensity=i.intensity * {factor}))(image)"
    ),
    "global": lambda factor: by_source(
        f"gain = {factor}\nfinish = lambda image: image.replace(intensity=image.intensity * gain)"
    ),
    "helper": lambda factor: by_source(
        f"helper = lambda x: np.clip(x, 0, 9) * {factor}\n"
        "finish = lambda image: image.replace(intensity=helper(image.intensity))"
    ),
    "cached": lambda factor: by_source(
        f"import functools\n@functools.lru_cache\ndef gain(): return {factor}\n"
        "finish = lambda image: image.replace(intensity=image.intensity * gain())"
    ),
}


@pytest.mark.parametrize("kind", FINISHES)
def test_frames_are_those_of_the_function_that_finishes_them(kind, tmp_path):
    make = FINISHES[kind]

    def drawn(finish):
        (path,) = vm.movie(VOLUME, SHELL, VIEW, tmp_path / "a.npz", finish=finish)
        return vm.Image.load(path).intensity, path.stat().st_mtime_ns

    plain = vm.render(VOLUME, SHELL, VIEW)
    before, first = drawn(make(2.0))
    np.testing.assert_array_equal(before, make(2.0)(plain).intensity)
    # The same function, defined again, is the same one.
    assert drawn(make(2.0))[1] == first
    after, _ = drawn(make(3.0))
    np.testing.assert_array_equal(after, make(3.0)(plain).intensity)
    assert np.any(after != before)


def test_what_cannot_be_told_again_counts_as_new(tmp_path):
    box = iter([2.0, 3.0]), threading.Lock()

    def finish(image):
        return brighter(image, next(box[0]))

    pictures = []
    for _ in range(2):
        with pytest.warns(UserWarning, match=r"cannot be identified again .*lock"):
            (path,) = vm.movie(VOLUME, SHELL, VIEW, tmp_path / "a.npz", finish=finish)
        pictures.append(vm.Image.load(path).intensity)
    np.testing.assert_allclose(pictures[1], 1.5 * pictures[0], rtol=1e-6)  # single precision


def colormap_of(*colors):
    return ListedColormap(colors, name="mine")


def by_function(factor):
    return vm.Medium.from_function(lambda a: (factor * a, a), ["a"], channels=1)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        [vm.Colormap("a", m, 0, 1, 0.4, path_length=1.0) for m in maps]
        for maps in [(colormap_of("red", "blue"), colormap_of("red", "green"))]
    ]
    + [
        [vm.Colormap("a", "viridis", norm=norm, path_length=1.0) for norm in norms]
        for norms in [
            (PowerNorm(1, 0, 1), PowerNorm(2, 0, 1)),
            (Normalize(0, 1), Normalize(0, 0.5)),
            (SymLogNorm(0.1, vmin=0, vmax=1), SymLogNorm(0.2, vmin=0, vmax=1)),
            [FuncNorm((lambda x, n=n: x**n, lambda x, n=n: x ** (1 / n)), 0, 1) for n in (2, 3)],
        ]
    ]
    + [
        (by_function(1.0), by_function(1.0 + 1e-6)),
        (SHELL, SHELL.replace(center=0.5 + 1e-7)),
        (SHELL, SHELL.replace(path_length=0.2 + 1e-7)),
    ],
)
def test_frames_are_those_of_the_medium(one, other, tmp_path):
    def drawn(medium):
        (path,) = vm.movie(VOLUME, medium, VIEW, tmp_path / "a.npz", precision="double")
        return vm.Image.load(path).intensity, path.stat().st_mtime_ns

    before, first = drawn(one)
    assert drawn(one.replace())[1] == first
    after, _ = drawn(other)
    wanted = vm.render(VOLUME, other, VIEW, precision="double").intensity
    np.testing.assert_array_equal(after, wanted)
    assert np.any(after != before)


def test_frames_are_those_of_the_display_options(tmp_path):
    def drawn(**picture):
        image = vm.Image(np.linspace(0, 1, 96).reshape(8, 12))
        options = {"picture": picture, "finish": lambda _: image}
        (path,) = vm.movie(VOLUME, SHELL, VIEW, tmp_path / "a.png", **options)
        return vm.Image.load(path).intensity

    maps = [{"colormap": colormap_of("red", c)} for c in ("blue", "green")]
    norms = [{"colormap": "viridis", "norm": PowerNorm(gamma)} for gamma in (1, 3)]
    for one, other in (maps, norms):
        assert np.any(drawn(**one) != drawn(**other))
    shown = []
    for color in ("blue", "green"):  # another map is registered under the same name
        matplotlib.colormaps.register(colormap_of("red", color), name="of a notebook")
        medium = vm.Colormap("a", "of a notebook", 0, 1, path_length=1.0)
        (path,) = vm.movie(VOLUME, medium, VIEW, tmp_path / "b.npz")
        shown.append((drawn(colormap="of a notebook"), vm.Image.load(path).intensity))
        matplotlib.colormaps.unregister("of a notebook")
    assert all(np.any(one != other) for one, other in zip(*shown, strict=True))


def test_frames_are_those_of_the_grid(tmp_path):
    """Cells of another octree with as many cells of each size."""
    shown = []
    for refined in ([0, 1] + 8 * [0], [1] + 8 * [0] + [0]):
        grid = vm.OctreeGrid([0, 1, 2], [0, 1], [0, 1], refined)
        volume = vm.Volume(grid, a=np.arange(9.0))
        camera = vm.Orthographic(0, 0, width=2, resolution=8)
        medium = vm.Coefficients("a", "a")
        (path,) = vm.movie(volume, medium, camera, tmp_path / "a.npz", scheme="first-order")
        shown.append(vm.Image.load(path).intensity)
    assert np.any(shown[0] != shown[1])


def test_frames_of_a_longer_film_are_named(tmp_path, monkeypatch):
    vm.movie(VOLUME, SHELL, orbit(VIEW, 1, 5), tmp_path / "a.png")
    (tmp_path / "a_00002.png").touch()  # of a film of ten thousand frames
    (tmp_path / "ab_0009.png").touch()
    with pytest.warns(UserWarning, match=r"3 more .* a_00002.png, a_0003.png, a_0004.png; remove"):
        vm.movie(VOLUME, SHELL, orbit(VIEW, 1, 3), tmp_path / "a.png")
    monkeypatch.chdir(tmp_path)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        vm.movie(VOLUME, SHELL, orbit(VIEW, 1, 3), "other.png")


def test_numbers_have_as_many_digits_as_the_last_one(tmp_path):
    for count, *ends in ((10_000, "a_0000", "a_9999"), (10_001, "a_00000", "a_10000")):
        share = (1, count - 1)  # the first frame and the last
        paths = vm.movie(VOLUME, SHELL, [VIEW] * count, tmp_path / "a.npz", share=share)
        assert [path.stem for path in paths] == ends


def test_functions_return_volumes(tmp_path):
    called = []

    def volume(factor):
        called.append(factor)
        return vm.Volume(GRID, a=VOLUME["a"] * factor)

    medium = vm.Coefficients("a", "a")
    draw = functools.partial(vm.movie, medium=medium, cameras=VIEW, path=tmp_path / "a.npz")
    series = [functools.partial(volume, factor) for factor in (1.0, 2.0)]
    before = [path.stat().st_mtime_ns for path in draw(series)]
    light = [vm.Image.load(tmp_path / f"a_000{k}.npz").intensity.sum() for k in range(2)]
    assert light[0] < light[1]
    # What they return decides, not how they are called.
    again = [lambda: volume(1.0), lambda: volume(3.0)]
    after = [path.stat().st_mtime_ns for path in draw(again)]
    assert [a == b for a, b in zip(before, after, strict=True)] == [True, False]
    with pytest.raises(vm.InputError, match="must return a Volume, got int"):
        draw(lambda: 3)
    # Those of this package are not called: files are told by their stamps.
    np.save(tmp_path / "a.npy", VOLUME["a"])
    opened = functools.partial(vm.open, tmp_path / "a.npy", bounds=(-1, 1))
    draw = functools.partial(draw, medium=vm.Coefficients("a", "a"), path=tmp_path / "b.npz")
    (path,) = draw(opened)
    wanted = vm.render(opened(), medium, VIEW).intensity
    np.testing.assert_array_equal(vm.Image.load(path).intensity, wanted)
    first = path.stat().st_mtime_ns
    assert draw(opened)[0].stat().st_mtime_ns == first
    wider = functools.partial(vm.open, tmp_path / "a.npy", bounds=(-2, 2))
    assert draw(wider)[0].stat().st_mtime_ns != first
    second = path.stat().st_mtime_ns
    np.save(tmp_path / "a.npy", VOLUME["a"] / 2)
    assert draw(wider)[0].stat().st_mtime_ns != second


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


@pytest.mark.parametrize("lines", [480, 718, 720, 1080])
@pytest.mark.parametrize("codec", ["libx264", "libsvtav1"])
def test_colours_of_an_mp4_are_tagged(lines, codec, tmp_path):
    """Whoever honours the tags sees the colours that were given: BT.709 from 720 lines."""
    av = pytest.importorskip("av")
    from PIL import Image

    colors, paths = [(255, 0, 0), (0, 255, 0), (0, 0, 255), (200, 120, 40)], []
    for k, color in enumerate(colors):
        paths.append(tmp_path / f"{k}.png")
        Image.new("RGB", (64, lines), color).save(paths[-1])
    encode(paths, tmp_path / "a.mp4", ".mp4", 30.0, codec)
    matrix, numbers = ("ITU709", (1, 1, 1)) if lines >= 720 else ("ITU601", (6, 6, 6))
    with av.open(str(tmp_path / "a.mp4")) as file:
        context = file.streams.video[0].codec_context
        tags = context.colorspace, context.color_primaries, context.color_trc
        assert (*tags, context.color_range) == (*numbers, 1)
        for frame, color in zip(file.decode(video=0), colors, strict=True):
            # The destination has no matrix: it is RGB.
            told = {"src_colorspace": matrix, "dst_colorspace": "ITU709"}
            shown = frame.reformat(format="rgb24", **told).to_ndarray()[lines // 2, 32]
            # Rounding of 8 bits, and what the codecs lose; of the other matrix it is 24.
            np.testing.assert_allclose(shown.astype(int), color, atol=4)


@pytest.mark.parametrize("fps", [7, 12, 24, 30, 33.3, 48, 50])
@pytest.mark.parametrize("suffix", [".gif", ".webp"])
def test_frames_begin_when_they_should(fps, suffix, tmp_path):
    from PIL import Image, ImageSequence

    paths = [tmp_path / f"{k}.png" for k in range(40)]
    for k, path in enumerate(paths):
        Image.new("RGB", (4, 4), (6 * k, 0, 0)).save(path)
    encode(paths, tmp_path / f"a{suffix}", suffix, fps, "")
    lasting = []
    with Image.open(tmp_path / f"a{suffix}") as file:
        for frame in ImageSequence.Iterator(file):
            frame.load()
            lasting.append(file.info["duration"])
    begins = np.cumsum([0, *lasting[:-1]])
    tick = 10 if suffix == ".gif" else 1
    # Rounded to what the format counts in.
    np.testing.assert_allclose(begins, 1000 * np.arange(40) / fps, atol=0.5 * tick + 1e-9)
    assert abs(lasting[-1] - 1000 / fps) <= 0.5 * tick + 1e-9


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
        (lambda path: vm.movie(VOLUME, SHELL, VIEW, path / "film.gif", fps=60), "0.1 and 50 in"),
        (lambda path: vm.movie(VOLUME, SHELL, VIEW, path / "film.mp4", fps="30"), "fps"),
        (lambda path: vm.movie(VOLUME, SHELL, VIEW, path / "a.png", fps=np.nan), "fps"),
        (lambda path: vm.movie(VOLUME, SHELL, VIEW, path / "a.mp4", codec=3), "codec"),
        (lambda path: vm.movie(VOLUME, None, VIEW, path / "a.png"), "Medium, got None"),
        (lambda path: vm.movie(VOLUME, SHELL, [VIEW, 3], path / "a.png"), "Camera, got 3"),
        (lambda path: vm.movie(3, SHELL, VIEW, path / "a.png"), "path of a file, got int"),
        (lambda path: vm.movie(VOLUME, SHELL, VIEW, path / "a.png", picture=3), "picture"),
        (lambda path: vm.movie(VOLUME, SHELL, VIEW, path / "a.png", finish=3), "finish"),
        (
            lambda path: vm.movie(VOLUME, SHELL, VIEW, path / "a.png", finish=lambda i: 3),
            "must return an image, got int",
        ),
        (
            lambda path: vm.movie(VOLUME, SHELL, VIEW, path / "a.png", picture={"annotate": VIEW}),
            "annotate is True or a dict",
        ),
        (lambda path: vm.movie(VOLUME, SHELL, VIEW, path / "a.png", tolerence=1), "tolerance"),
        (lambda path: orbit(VIEW, "x"), "turns"),
        (lambda path: orbit(VIEW, np.nan), "turns"),
        (lambda path: orbit(VIEW, [1, 2]), "turns"),
        (lambda path: orbit(None), "Orthographic, Perspective or Panorama"),
        (lambda path: zoom(VIEW, 10**400), "factor"),
        (lambda path: zoom(VIEW, None), "factor"),
        (lambda path: dolly(EYE, "near"), "factor"),
        (lambda path: fly("here"), "positions"),
        (lambda path: fade(SHELL, None, 3), "from a medium to a medium"),
        (lambda path: fade("a", SHELL, 3), "from a medium to a medium"),
        (lambda path: keyframes(3), "pairs"),
        (lambda path: keyframes([VIEW]), "pairs"),
        (lambda path: keyframes([(0, VIEW, 1)]), "pairs"),
        (lambda path: keyframes([("a", VIEW)]), "whole numbers"),
        (lambda path: keyframes([(None, VIEW), (3, VIEW)]), "whole numbers"),
        (lambda path: keyframes([(0, 3)]), "Orthographic, Perspective or Panorama"),
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
    with pytest.raises(vm.errors.VoluminousError, match=message):
        call(tmp_path)
