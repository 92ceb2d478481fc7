"""What one ray saw: the pixel of the picture, and every segment as it should be."""

from __future__ import annotations

import numpy as np
import pytest
from astropy import units as u
from astropy.table import QTable

import voluminous as vm
from contracts.scheme import both_ways
from voluminous.cli import main

SCHEMES = [
    ("first-order", None),
    ("second-order", None),
    ("olson-kunasz", None),
    ("post-classified", None),
    ("post-classified", 1e-4),
]
# Rounding of some forty segments; the march itself is the same.
EXACT = {"single": 3e-6, "double": 1e-13}
WALLS = np.linspace(0, 8, 9)


def near(x, y, z, level):
    return np.hypot(np.hypot(x - 2.5, y - 4.5), z - 3.0) < 3.0 / (level + 1)


RADII, PHI = np.geomspace(0.5, 4, 7), np.linspace(0, 2 * np.pi, 9)
GRIDS = {
    "cartesian": vm.CartesianGrid(WALLS, WALLS, WALLS[:7]),
    "octree": vm.OctreeGrid.from_function(WALLS[::2], WALLS[::2], WALLS[::2], near, 2),
    "patches": vm.PatchGrid.from_boxes(
        WALLS, WALLS, WALLS, [0, 1], [[0, 0, 0], [4, 6, 2]], [[8, 8, 8], [6, 4, 8]]
    ),
    "spherical": vm.SphericalGrid(RADII, np.linspace(0, np.pi, 7), PHI),
    "mirrored": vm.SphericalGrid(RADII, np.linspace(0, np.pi / 2, 4), PHI, mirror=True),
    "cylindrical": vm.CylindricalGrid(RADII, PHI, np.linspace(-2, 3, 6)),
}
MEDIUM = vm.Coefficients(["a", "a * a"], ["0.3 * a", "0.5 * b"])
SIDE = vm.Orthographic(63, 21, resolution=(7, 5))


def volume_on(grid, missing=0.0):
    rng = np.random.default_rng(2)
    a, b = rng.random((2, *grid.shape)) + 0.1
    a[rng.random(grid.shape) < missing] = np.nan
    return vm.Volume(grid, a=a, b=b)


def check_pixel(found, image, precision):
    """The march, and the fold of its segments from both ends, are the picture's pixel."""
    exact = EXACT[precision]
    ix, iy = found.pixel
    expected = image.intensity[iy, ix]
    bright = np.abs(expected).max()
    np.testing.assert_allclose(found.intensity, expected, rtol=exact, atol=exact * bright)
    through = found.transparency
    if len(found):
        np.testing.assert_allclose(found.arriving[0], expected, atol=10 * exact * bright)
        last = found.gathered[-1] + through * found.background
        np.testing.assert_allclose(last, expected, atol=10 * exact * bright)
        np.testing.assert_allclose(found.depth[-1], found.optical_depth, rtol=10 * exact)
        # Wherever one stands, what is in front and what comes from behind make the pixel.
        theta = np.cumprod(found.theta, axis=0)
        whole = found.gathered[:-1] + theta[:-1] * found.arriving[1:]
        np.testing.assert_allclose(
            whole, np.broadcast_to(found.arriving[0], whole.shape), atol=10 * exact * bright
        )
    np.testing.assert_allclose(
        np.broadcast_to(found.optical_depth, expected.shape),
        image.optical_depth[iy, ix],
        rtol=exact,
    )


def check_points(found, exact):
    """Points are along the whole ray; the extinctions there add up to the optical depth."""
    points = found.points
    x, alpha = points.distance, points.alpha
    np.testing.assert_allclose(x[[0, -1]], [found.begin[0], found.end[-1]], rtol=1e-6, atol=1e-6)
    assert (np.diff(x) >= 0).all()
    means = np.nan_to_num(0.5 * (alpha[1:] + alpha[:-1]))  # hidden cells are transparent
    depth = (np.diff(x)[:, None] * means).sum(axis=0)
    np.testing.assert_allclose(depth, found.optical_depth, rtol=exact)


# Coefficients of cells are constant, and those of vertices linear on segments: trapezia are exact.
# Curves through interpolated fields bend; points are left out where that is less than 1e-3.
TRAPEZIA = {
    "first-order": 1e-5,
    "second-order": 1e-5,
    "olson-kunasz": 1e-5,
    "post-classified": 3e-3,
}


@pytest.mark.parametrize("precision", EXACT)
@pytest.mark.parametrize(("scheme", "tolerance"), SCHEMES)
def test_a_ray_gathers_what_the_picture_shows(scheme, tolerance, precision):
    volume = volume_on(GRIDS["cartesian"])
    options = {"scheme": scheme, "tolerance": tolerance, "precision": precision}
    options |= {"background": [0.3, 0.1], "cutoff": 0.0}
    image = vm.render(volume, MEDIUM, SIDE, **options)
    for pixel in ((3, 2), (1, 3)):
        found = vm.probe(volume, MEDIUM, SIDE, pixel, **options)
        check_pixel(found, image, precision)
        check_points(found, TRAPEZIA[scheme])
        assert len(found) > 6


@pytest.mark.each_value_once
@pytest.mark.parametrize("scheme", ["first-order", "second-order", "post-classified"])
@pytest.mark.parametrize("kind", GRIDS)
def test_on_every_grid_with_missing_cells(kind, scheme):
    volume = volume_on(GRIDS[kind], missing=0.4)
    tolerance = 1e-4 if kind == "patches" else None
    options = {"scheme": scheme, "tolerance": tolerance, "background": 0.2, "cutoff": 0.0}
    image = vm.render(volume, MEDIUM, SIDE, **options)
    found = vm.probe(volume, MEDIUM, SIDE, (3, 2), also="b", **options)
    check_pixel(found, image, "single")
    check_points(found, TRAPEZIA[scheme])
    missing = np.isnan(volume.array("a").reshape(-1)[found.cell])
    np.testing.assert_array_equal(found.hidden, missing)
    assert found.hidden.any()
    np.testing.assert_array_equal(found.b[found.hidden], 0)
    np.testing.assert_array_equal(found.theta[found.hidden], 1)
    np.testing.assert_array_equal(np.isnan(found.fields["a"]), missing)
    # The middle of a segment is in its cell; of very short ones rounding may put it beside.
    long = found.end - found.begin > 1e-4
    located = volume.grid.locate(found.position)
    np.testing.assert_array_equal(found.cell[long], located[long])
    np.testing.assert_array_equal(found.level, volume.grid.levels.reshape(-1)[found.cell])


@pytest.mark.parametrize("precision", EXACT)
def test_first_order_cell_by_cell(precision):
    # Straight through six cells: everything is known.
    volume = volume_on(vm.CartesianGrid(WALLS, WALLS, [0, 1, 3, 3.5, 4, 6, 8], unit="pc"))
    volume.set_unit("a", "erg / (s cm2 sr pc)")
    medium = vm.Coefficients("a", "b")
    down = vm.Orthographic(width=8, resolution=8)
    found = vm.probe(
        volume, medium, down, (2, 5), scheme="first-order", precision=precision, background=0.7
    )
    z, a, b = volume.grid.edges[2], *(volume.array(n)[2, 5] for n in "ab")
    exact = {"rtol": EXACT[precision], "atol": EXACT[precision]}
    tau = (b * np.diff(z))[::-1]
    emitted = (a / b)[::-1] * -np.expm1(-tau)
    expected = {
        # From above: the last cell comes first; distances count from the volume's middle.
        "begin": 4 - z[:0:-1],
        "end": 4 - z[-2::-1],
        "j": a[::-1],
        "alpha": b[::-1],
        "tau": tau,
        "theta": np.exp(-tau),
        "b": emitted,
        "depth": np.cumsum(tau),
        "gathered": np.cumsum(np.exp(-(np.cumsum(tau) - tau)) * emitted),
    }
    for name, values in expected.items():
        np.testing.assert_allclose(getattr(found, name).ravel(), values, **exact)
    np.testing.assert_allclose(found.position[:, :2], [[2.5, 5.5]] * 6, **exact)
    np.testing.assert_array_equal(found.index, [[2, 5, k] for k in range(5, -1, -1)])
    np.testing.assert_array_equal(found.fields["a"], a[::-1])
    table = found.table()
    assert table["a"].unit == table["j"].unit == u.Unit("erg / (s cm2 sr pc)")
    assert table["alpha"].unit == u.pc**-1
    assert table["b"].unit == u.Unit("erg / (s cm2 sr)")


@pytest.mark.parametrize("resolution", [12, 120])
def test_what_a_picture_remembers_is_what_a_probe_would_draw(resolution, monkeypatch):
    """Of pixels that were drawn once, and of those that were drawn again with smaller limits."""
    rng = np.random.default_rng(4)
    fields = {name: rng.uniform(0.2, 2.0, (8, 8, 6)) for name in "ab"}
    shells = vm.Gaussian("a", 0.5, 0.02, (1.0, 0.3), 2.0, 1.0)
    shells += vm.Gaussian("a * b", 1.5, 0.05, (0.2, 1.0), 0.5, 1.0)
    camera = vm.Orthographic(40, 30, resolution=resolution)
    options = {"tolerance": 1e-4}
    drawn, fresh = (vm.Volume(GRIDS["cartesian"], **fields) for _ in range(2))
    vm.render(drawn, shells, camera, **options)
    (rounds,) = [one for key, (one, _) in drawn.tables.items() if key[0] == "rounds"]
    traced = [pixel for pixel, _, _ in rounds.rounds if pixel is not None]
    again = np.concatenate([np.array([], int), *traced])
    # In a small picture nothing is known of its brightness before all pixels are traced.
    assert len(again) < resolution**2
    assert len(again) > 0 or resolution > 12
    once = np.setdiff1d(np.arange(resolution**2), again)
    for flat in (*again[:2], *once[len(once) // 2 :][:2]):
        pixel = (int(flat) % resolution, int(flat) // resolution)
        expected = vm.probe(fresh, shells, camera, pixel, **options)
        fresh.tables.clear()  # so that it draws each time
        with monkeypatch.context() as patch:
            patch.setattr("voluminous.measuring.probing.run", None)
            found = vm.probe(drawn, shells, camera, pixel, **options)
        for name in ("begin", "end", "j", "alpha", "gathered", "intensity"):
            np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


@pytest.mark.parametrize("scheme", ["first-order", "second-order"])
def test_both_directions_tell_the_same(scheme):
    volume = volume_on(GRIDS["cartesian"])
    one, other = (
        vm.probe(volume, MEDIUM, SIDE, (4, 2), scheme=one, precision="double")
        for one in both_ways(scheme)
    )
    np.testing.assert_array_equal(one.cell, other.cell)
    for name in ("begin", "end", "position", "j", "alpha", "tau", "b", "gathered", "arriving"):
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), atol=1e-11)
    for name in ("distance", "j", "alpha"):
        first, second = (getattr(found.points, name) for found in (one, other))
        np.testing.assert_allclose(first, second, atol=1e-11)


def test_distances_are_from_the_observer():
    volume = volume_on(GRIDS["cartesian"])
    place = np.array([3.2, 4.1, 2.3])
    inside = vm.Perspective(place, (8, 1, 6), resolution=9)
    image = vm.render(volume, MEDIUM, inside, scheme="first-order", precision="double")
    found = vm.probe(volume, MEDIUM, inside, (6, 1), scheme="first-order", precision="double")
    check_pixel(found, image, "double")
    assert found.begin[0] == 0
    away = np.linalg.norm(found.position - place, axis=1)
    np.testing.assert_allclose(away, 0.5 * (found.begin + found.end), rtol=1e-12)


def test_a_ray_that_misses_sees_the_background():
    volume = volume_on(GRIDS["cartesian"])
    wide = vm.Orthographic(width=100, resolution=10)
    found = vm.probe(volume, MEDIUM, wide, (0, 0), background=[0.25, 2.0])
    assert len(found) == len(found.table()) == 0
    np.testing.assert_array_equal(found.intensity, [0.25, 2.0])
    assert "meets nothing" in str(found)


def test_empty_cells_are_told_and_wide_steps_are_those_of_the_picture():
    core = vm.models.prestellar_core(48)
    shell = vm.Gaussian("log10(density)", 4.2, 0.3, [1, 0.5], 1.0, 1e17)
    camera = vm.Orthographic(50, 20, resolution=16)
    first = vm.probe(core, shell, camera, (8, 8), scheme="first-order")
    np.testing.assert_allclose(first.begin[1:], first.end[:-1], atol=1e-4 * core.grid.scale)
    narrow = vm.Gaussian("log10(density)", 4.2, 0.05, [1, 0.5], 1.0, 1e17)
    told = vm.probe(core, narrow, camera, (8, 8), scheme="first-order")
    np.testing.assert_array_equal(told.cell, first.cell)  # pictures leap over most of them
    assert (told.tau < 1e-12).any()
    image = vm.render(core, shell, camera, tolerance=None)
    found = vm.probe(core, shell, camera, (8, 8), tolerance=None)
    check_pixel(found, image, "single")
    assert len(found) < 0.7 * len(first)
    assert np.all(found.begin[1:] > found.end[:-1] - 1e-4 * core.grid.scale)
    np.testing.assert_allclose(found.scalars["log10(density)"], np.log10(found.fields["density"]))


def test_points_have_the_values_there_where_nothing_emits_too(tmp_path):
    # A linear field is what it is at each point; a narrow shell shines on a part of the ray alone.
    grid = vm.CartesianGrid.uniform(32, (-1, 1), unit="pc")
    volume = vm.Volume(
        grid, a=np.broadcast_to(grid.cell_centers()[2].reshape(grid.shape), (32,) * 3)
    )
    shell = vm.Gaussian("a", 0.3, 0.02, (1.0, 0.5), 0.4, 0.1)
    down = vm.Orthographic(width=1, resolution=8)
    for tolerance in (1e-3, None):  # in wide steps, too
        found = vm.probe(volume, shell, down, (3, 3), tolerance=tolerance)
        points = found.points
        x = points.distance
        z = np.clip(-x, -1 + 1 / 32, 1 - 1 / 32)  # from above; beyond the last centres it is flat
        np.testing.assert_allclose(x[[0, -1]], [-1, 1], atol=1e-6)
        np.testing.assert_allclose(points.fields["a"], z, atol=1e-5)
        shape = np.exp(-0.5 * ((z - 0.3) / 0.02) ** 2)
        np.testing.assert_allclose(points.alpha[:, 0], 4.0 * shape, atol=4e-3)
        np.testing.assert_allclose(points.j, np.outer(10.0 * shape, [1, 0.5]), atol=1e-2)
        assert len(x) < 400
        curve = found.plot().axes[0].lines[0].get_xydata()
        np.testing.assert_array_equal(curve[:, 0], x)
        np.testing.assert_array_equal(curve[:, 1], points.fields["a"])
        assert found.plot().axes[3].get_xlabel().endswith("[pc]")
    also = vm.probe(volume, shell, down, (3, 3), also="2 * a")
    assert np.isfinite(also.plot(show=["2 * a"]).axes[0].lines[0].get_ydata()).all()
    surface = vm.Isosurface("a", 0.3, (1.0, 0.5), 0.5)
    found = vm.probe(volume, surface, down, (3, 3))
    peak = found.points.distance[found.points.alpha[:, 0] > 0]
    assert peak.size == 1
    np.testing.assert_allclose(peak, -0.3, atol=1 / 16)


def test_tables_and_plots(tmp_path):
    volume = volume_on(vm.CartesianGrid(WALLS, WALLS, WALLS, unit="pc"))
    found = vm.probe(volume, MEDIUM, SIDE, (3, 2), also=["a * x", "r"], scheme="first-order")
    center = volume.grid.cell_centers()[:, found.cell]
    np.testing.assert_allclose(found.fields["a * x"], found.fields["a"] * center[0])
    assert found.units["r"] == "pc"
    for name in ("ray.ecsv", "ray.fits", "ray.csv"):
        found.save(tmp_path / name)
        again = QTable.read(tmp_path / name)
        assert again.colnames == found.table().colnames
        np.testing.assert_array_equal(again["b_1"], found.b[:, 1])
    assert QTable.read(tmp_path / "ray.fits")["alpha_0"].unit == u.pc**-1
    with pytest.raises(vm.errors.UnknownNameError, match="'c'"):
        found.plot(show=["c"])
    figure = found.plot(show=["a", "b", "r"])
    assert sum(axes.get_title(loc="left") != "" for axes in figure.axes) == 4
    found.save(tmp_path / "ray.png")
    assert (tmp_path / "ray.png").read_bytes().startswith(b"\x89PNG")
    pandas = pytest.importorskip("pandas")
    frame = found.to_pandas()
    assert isinstance(frame, pandas.DataFrame)
    np.testing.assert_array_equal(frame["gathered_0"], found.gathered[:, 0])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({}, "say which ray"),
        ({"pixel": (1, 1), "at": (0, 0)}, "say which ray"),
        ({"pixel": (7, 0)}, "7 x 5 pixels"),
        ({"pixel": 3}, "two whole numbers"),
        ({"at": (np.nan, 0)}, "two finite numbers"),
        ({"pixel": (0, 0), "also": "c"}, "'c'"),
        ({"pixel": (0, 0), "also": {"r"}}, "also must be a field or an expression"),
        ({"pixel": (0, 0), "background": [1, 2, 3]}, "background"),
    ],
)
def test_what_cannot_be_asked(arguments, message):
    volume = volume_on(GRIDS["cartesian"])
    with pytest.raises(vm.VoluminousError, match=message):
        vm.probe(volume, MEDIUM, SIDE, **arguments)


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
[render]
scheme = "first-order"
background = 0.5
samples = 2
"""


def test_the_command(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    star = '[[object]]\ntype = "stars"\npositions = [[0, 0, 0]]\nluminosities = 1\n'
    (tmp_path / "scene.toml").write_text(SCENE + star)
    asked = ["probe", "scene.toml", "--pixel", "2", "3", "--set", "camera.incl=20"]
    assert main([*asked, "--also", "x", "-o", "ray.ecsv", "-o", "ray.svg"]) == 0
    told = capsys.readouterr().out
    assert "Pixel (2, 3)" in told
    assert "ray.svg" in told
    assert "not in it, but in the picture: objects (stars)" in told
    assert "samples = 2" in told
    scene = vm.Scene.load("scene.toml")
    camera = scene.replaced({"camera.incl": 20}).camera
    image = vm.render(scene.volume(), scene.medium, camera, scheme="first-order", background=0.5)
    table = QTable.read("ray.ecsv")
    assert table["arriving_1"][0] == pytest.approx(image.intensity[3, 2, 1], rel=1e-6)
    assert "x" in table.colnames
    assert main(["probe", "scene.toml", "--at=-0.2,0.2", "-q"]) == 0
    assert main(["probe", "scene.toml", "--at", "1,2,3"]) == 2
    assert main(["probe", "scene.toml", "--pixel", "9", "0"]) == 2
    assert main([*asked, "-o", "ray.txt"]) == 2
    assert main([*asked, "-o", "no/ray.csv"]) == 2
