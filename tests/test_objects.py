"""Stars, spheres and lines among the medium: closed forms of one more pair (b, θ) on the way."""

from __future__ import annotations

import itertools
import json

import numpy as np
import pytest
from astropy import units as u
from hypothesis import given
from hypothesis import strategies as st

import voluminous as vm
from contracts.scheme import both_ways
from voluminous.backend import get_backend
from voluminous.objects.contract import View
from voluminous.rendering.layers import Pairs, fold
from voluminous.scene.sections import build_objects

J, ALPHA, THICK = 2.0, 0.7, 1.5
SOURCE = J / ALPHA
# z from 0 to 1.5, seen from above.
SLAB = vm.models.uniform_slab(emissivity=J, extinction=ALPHA, thickness=THICK)
MEDIUM = vm.Coefficients("j", "a")
CAMERA = vm.Orthographic(width=0.2, resolution=21)
# Rounding of sums over some cells.
EXACT = {"single": 3e-6, "double": 1e-13}
SCHEMES = ("post-classified", "second-order", "first-order", "olson-kunasz")


def behind(depth_in_front, intensity):
    """What is seen of an intensity behind a part of the slab."""
    theta = np.exp(-ALPHA * depth_in_front)
    return intensity * theta + SOURCE * (1.0 - theta)


def front_of(z):
    """How much of the slab is above z."""
    return np.clip(THICK - z, 0.0, THICK)


@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("z", [-5.0, 0.31, 5.0])
def test_a_disc_behind_inside_and_in_front_of_a_slab(z, scheme, precision):
    star = vm.Stars([(0, 0, z)], 5.0, radii=0.05)
    options = {"scheme": scheme, "precision": precision}
    image = vm.render(SLAB, MEDIUM, CAMERA, objects=star, **options)
    seen = behind(front_of(z + 0.05), 5.0)
    assert image.intensity[10, 10, 0] == pytest.approx(seen, rel=EXACT[precision])
    assert image.transparency[10, 10, 0] == 0.0
    # Optical depths are those of the medium alone.
    assert image.optical_depth[10, 10, 0] == pytest.approx(ALPHA * THICK, rel=EXACT[precision])
    plain = vm.render(SLAB, MEDIUM, CAMERA, **options)
    x, y = np.meshgrid(image.x, image.y)
    away = np.hypot(x, y) > 0.05 + image.pixel_size[0]
    np.testing.assert_array_equal(image.intensity[away], plain.intensity[away])
    np.testing.assert_array_equal(image.transparency[away], plain.transparency[away])


@pytest.mark.parametrize("precision", EXACT)
def test_a_point_is_dimmed_on_its_own_line_of_sight(precision):
    # The slab is a wedge of extinction: α grows with x, so that pixels differ within.
    grid = vm.CartesianGrid.uniform((40, 4, 4), [(-1, 1), (-1, 1), (0, 1)])
    x = grid.cell_centers()[0].reshape(grid.shape)
    volume = vm.Volume(grid, a=2.0 + x)
    camera = vm.Orthographic(width=2, resolution=4)
    for place in (-0.61, 0.13, 0.88):
        star = vm.Stars([(place, 0.2, 0.5)], luminosities=3.0)
        options = {"precision": precision, "scheme": "first-order"}
        image = vm.render(volume, vm.Coefficients(0, "a"), camera, objects=[star], **options)
        cell = x[grid.locate([[place, 0.2, 0.5]])[0] // 16, 0, 0]
        total = image.intensity.sum() * image.pixel_area
        assert total == pytest.approx(3.0 * np.exp(-0.5 * (2.0 + cell)), rel=EXACT[precision])


@pytest.mark.parametrize(
    "camera",
    [
        vm.Orthographic(35, 70, 0, width=3, resolution=(30, 20)),
        vm.Orthographic(35, 70, 25, width=(3, 2.5), resolution=(30, 20), shift=(0.3, -0.2)),
        vm.Orthographic(110, -20, 200, width=3, resolution=25, center=(0.2, 0.1, 0)),
        vm.Perspective((3, 2, 1), (0, 0, 0.1), fov=50, posang=33, resolution=(30, 20)),
        vm.Perspective((0.5, 2, 1), (0, 0, 0.1), fov=150, projection="spherical", resolution=31),
    ],
)
def test_points_are_in_the_pixels_whose_rays_pass_them(camera):
    """The star is put on a ray through a pixel; its flux must be there, and nowhere else."""
    volume, medium = vm.models.sphere(4), vm.Coefficients("0 * inside", 0)
    frame, rng = camera.frame(volume.grid), np.random.default_rng(7)
    nx, ny = frame.pixels
    for _ in range(5):
        ix, iy, du, dv = rng.integers(nx), rng.integers(ny), *rng.uniform(-0.49, 0.49, 2)
        view = View(camera, volume.grid, frame, get_backend("cpu", "double"), 1, 1, None, float)
        origin, direction = view.rays(np.array([ix + du]), np.array([iy + dv]))
        star = vm.Stars(origin + 1.7 * direction, luminosities=1.0)
        image = vm.render(volume, medium, camera, objects=[star], scheme="first-order")
        assert np.flatnonzero(image.intensity[..., 0]) == iy * nx + ix


def test_fluxes_of_points_and_small_discs_are_the_same_from_everywhere():
    """A point is the limit of a small disc; in the middle its flux is L/D²."""
    empty, medium = vm.models.sphere(8), vm.Coefficients("0 * inside", 0)
    flat = vm.Perspective((3, 0, 0), (0, 0, 0), fov=80, posang=20, resolution=20)
    dome = vm.Perspective((3, 0, 0), (0, 0, 0), fov=160, projection="spherical", resolution=20)
    for camera in (flat, dome, vm.Orthographic(20, 30, 40, width=6, resolution=20)):
        for place in ((0, 0, 0), (1.0, 0.5, 0.7)):
            options = {"camera": camera, "precision": "double", "scheme": "first-order"}
            point, disc = (
                vm.render(empty, medium, objects=vm.Stars([place], **size), **options)
                for size in ({"luminosities": 2.0}, {"luminosities": 2.0, "radii": 1e-3})
            )
            # A disc of 1e-3: (R/D)² remains.
            assert point.intensity.sum() == pytest.approx(disc.intensity.sum(), rel=1e-5)
    image = vm.render(
        empty, medium, flat, objects=vm.Stars([(0, 0, 0)], luminosities=2.0), precision="double"
    )
    assert image.intensity.sum() * image.pixel_area == pytest.approx(2.0 / 9.0, rel=1e-7)


@pytest.mark.parametrize("psf", [0.3, 4.0, [0.2, 0.4] * u.pc])
def test_a_psf_spreads_what_there_is(psf):
    volume = vm.Volume(vm.CartesianGrid.uniform(4, (-1, 1), unit="pc"), a=np.ones((4, 4, 4)))
    camera = vm.Orthographic(width=4, resolution=80)
    stars = vm.Stars([[0.11, 0.02, 0.0], [-0.3, 0.5, -2.0]], luminosities=[1.0, 2.0], psf=psf)
    image = vm.render(volume, vm.Coefficients(0, "a"), camera, objects=[stars], precision="double")
    theta = np.exp([-1.0, -2.0])
    assert image.intensity.sum() * image.pixel_area == pytest.approx(theta @ [1, 2], rel=1e-12)
    one = vm.Stars([(0.11, 0.02, 5.0)], luminosities=1.0, psf=psf)
    light = vm.render(volume, vm.Coefficients(0, "a"), camera, objects=[one]).intensity[..., 0]
    x, y = np.meshgrid(image.x, image.y)
    width = getattr(psf, "value", np.multiply(psf, image.pixel_size[0]))
    for place, fwhm in zip((x - 0.11, y - 0.02), np.broadcast_to(width, 2), strict=True):
        # Pixels add their own width; a Gaussian cut off at 4 σ has lost 1e-3 of its square.
        expected = fwhm**2 / (8 * np.log(2)) + image.pixel_size[0] ** 2 / 12
        if fwhm > 1.5 * image.pixel_size[0]:
            assert np.average(place, weights=light) == pytest.approx(0, abs=1e-4)
            spread = np.average(place**2, weights=light)
            assert spread == pytest.approx(expected, rel=5e-3)


def test_points_between_layers_are_hidden_by_those_in_front():
    sheet, dark = vm.Spheres([(0, 0, 0.5)], 0.05, 0.0, opacity=0.75), vm.Coefficients(0, "a")
    for z, part in ((0.7, 1.0), (0.3, 0.25)):
        star = vm.Stars([(0.001, 0.002, z)], luminosities=1.0)
        image = vm.render(SLAB, dark, CAMERA, objects=[star, sheet], precision="double")
        total = image.intensity.sum() * image.pixel_area
        assert total == pytest.approx(part * np.exp(-ALPHA * (THICK - z)), rel=1e-12)


@pytest.mark.parametrize("precision", EXACT)
def test_a_line_is_seen_at_its_depth_all_along(precision):
    line = vm.Curves([[-0.09, 0, 0.2], [0.09, 0, 1.3]], 4.0, width=3)
    image = vm.render(SLAB, MEDIUM, CAMERA, objects=[line], precision=precision)
    z = 0.75 + image.x * 1.1 / 0.18
    inner = slice(2, -2)
    np.testing.assert_allclose(
        image.intensity[10, inner, 0], behind(front_of(z), 4.0)[inner], rtol=EXACT[precision]
    )
    np.testing.assert_array_equal(image.transparency[10, inner], 0.0)


def test_foreground_is_undimmed_and_hides():
    for thing in (
        vm.Stars([(0, 0, -9)], 5.0, radii=0.05, depth="foreground"),
        vm.Curves([[-1, 0, -9], [1, 0, -9]], 5.0, width=3, depth="foreground"),
    ):
        image = vm.render(SLAB, MEDIUM, CAMERA, objects=[thing], background=3.0)
        assert image.intensity[10, 10, 0] == 5.0
        assert image.transparency[10, 10, 0] == 0.0
    star = vm.Stars([(0, 0, -9)], luminosities=1.0, depth="foreground")
    plain = vm.render(SLAB, MEDIUM, CAMERA, precision="double")
    image = vm.render(SLAB, MEDIUM, CAMERA, objects=[star], precision="double")
    added = (image.intensity - plain.intensity).sum() * image.pixel_area
    assert added == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize("depth", ["true", "foreground"])
def test_a_channel_of_its_own(depth):
    """As in the note: the star is the fourth channel of a picture of three."""
    medium = vm.Coefficients(["j", "j", "2 * j"], "a")
    star = vm.Stars([(0, 0, 0.5)], 5.0, radii=0.05, channel=3, depth=depth)
    image = vm.render(SLAB, medium, CAMERA, objects=[star], precision="double", background=1.0)
    assert image.shape == (21, 21, 4)
    seen = 5.0 if depth == "foreground" else 5.0 * np.exp(-ALPHA * 0.95)
    assert image.intensity[10, 10, 3] == pytest.approx(seen, rel=1e-13)
    assert image.intensity[0, 0, 3] == 0.0
    hidden = 0.0 if depth == "foreground" else SOURCE * (1 - np.exp(-ALPHA * 0.95))
    assert image.intensity[10, 10, 0] == pytest.approx(hidden, abs=1e-13)
    assert image.to_rgb().shape == (21, 21, 3)


def test_channels_with_their_own_extinction():
    medium = vm.Coefficients(["j", "j"], ["a", "3 * a"])
    star = vm.Stars([(0, 0, 0.5)], (4.0, 5.0), radii=0.05)
    point = vm.Stars([(0.052, 0.052, 0.5)], (1.0, 2.0), luminosities=1.0)
    image = vm.render(SLAB, medium, CAMERA, objects=[star, point], precision="double")
    plain = vm.render(SLAB, medium, CAMERA, precision="double")
    for channel, (alpha, color) in enumerate([(ALPHA, 4.0), (3 * ALPHA, 5.0)]):
        theta = np.exp(-alpha * 0.95)
        expected = color * theta + J / alpha * (1 - theta)
        assert image.intensity[10, 10, channel] == pytest.approx(expected, rel=1e-12)
        added = (image.intensity - plain.intensity)[15, 15, channel] * image.pixel_area
        assert added == pytest.approx((channel + 1) * np.exp(-alpha), rel=1e-10)
    with pytest.raises(vm.InputError, match="channel 2 is beyond the medium's 2"):
        vm.render(SLAB, medium, CAMERA, objects=[vm.Stars([(0, 0, 0)], radii=1, channel=2)])
    front = vm.Stars([(0, 0, 0)], 6.0, radii=0.05, channel=2, depth="foreground")
    assert vm.render(SLAB, medium, CAMERA, objects=[front]).intensity[10, 10, 2] == 6.0


GRIDS = {
    "uniform": vm.CartesianGrid.uniform((48, 40, 40), (-1, 1)),
    "rectilinear": vm.CartesianGrid(
        *(np.sort(np.random.default_rng(k).uniform(-1, 1, 9)) for k in range(3))
    ),
    "octree": vm.OctreeGrid.from_function(
        *[np.linspace(-1, 1, 4)] * 3, lambda x, y, z, s: np.hypot(x, y) < s, 3
    ),
    "patches": vm.PatchGrid([[-1] * 3, [-0.5] * 3], [[1] * 3, [0.5] * 3], [[8] * 3, [8] * 3]),
    "spherical": vm.SphericalGrid(
        np.linspace(0.2, 1, 7), np.linspace(0, np.pi, 6), np.linspace(0, 2 * np.pi, 5)
    ),
    "cylindrical": vm.CylindricalGrid(
        np.linspace(0, 1, 7), np.linspace(0, 2 * np.pi, 6), np.linspace(-1, 1, 6)
    ),
}
VIEWS = {
    "parallel": vm.Orthographic(33, 44, 55, width=2.6, resolution=24),
    "flat": vm.Perspective((2.2, 1.1, 1.4), (0, 0, 0), fov=40, resolution=24),
    "inside": vm.Perspective(
        (0.3, 0.1, 0.2), (1, 0, 0), fov=150, projection="spherical", resolution=24
    ),
}


SEEN = [
    pytest.param(grid, view, missing, marks=pytest.mark.exhaustive if far else [])
    for grid, view, missing in itertools.product(GRIDS, VIEWS, [False, True])
    for far in [missing and view != "parallel"]
]


@pytest.mark.each_value_once
@pytest.mark.parametrize(("grid", "view", "missing"), SEEN)
def test_layers_that_show_nothing_change_nothing(grid, view, missing):
    """Rays in stretches are the rays: on all grids, from outside and inside."""
    grid, rng = GRIDS[grid], np.random.default_rng(7)
    values = rng.random(grid.size) + 0.1
    if grid.shape[0] == 48:
        values[: grid.size // 2] = 0.0
    if missing:
        values[::7] = np.nan
    volume = vm.Volume(grid, a=values.reshape(grid.shape))
    balls = vm.Spheres(rng.uniform(-1, 1, (9, 3)), rng.uniform(0.1, 0.5, 9), 0.0, opacity=0.0)
    for precision, scheme in zip(("double", "single"), both_ways("first-order"), strict=True):
        options = {"scheme": scheme, "precision": precision}
        medium = vm.Coefficients("a", "2 * a")
        plain = vm.render(volume, medium, VIEWS[view], **options)
        image = vm.render(volume, medium, VIEWS[view], objects=balls, **options)
        exact = 1e-12 if precision == "double" else 1e-5
        np.testing.assert_allclose(image.intensity, plain.intensity, rtol=0, atol=exact)
        np.testing.assert_allclose(image.transparency, plain.transparency, rtol=0, atol=exact)


pairs = st.lists(st.tuples(st.floats(0, 1), st.floats(0, 1)), min_size=1, max_size=7)


@given(st.lists(pairs, min_size=1, max_size=5))
def test_folding_is_folding_one_after_another(groups):
    flat = np.array([pair for group in groups for pair in group])
    folded = fold(
        Pairs(flat[:, :1], flat[:, 1:], np.zeros((len(flat), 3))), [len(g) for g in groups]
    )
    for k, group in enumerate(groups):
        emission, theta = 0.0, 1.0
        for b, t in group:
            emission, theta = emission + theta * b, theta * t
        # Rounding: another order of the same sums of numbers up to 7.
        assert folded.emission[k, 0] == pytest.approx(emission, rel=1e-14, abs=1e-15)
        assert folded.transparency[k, 0] == pytest.approx(theta, rel=1e-14, abs=1e-300)


def test_units():
    grid = vm.CartesianGrid.uniform(4, (-1, 1), unit="pc")
    volume = vm.Volume(grid, j=np.ones(grid.shape) * u.Jy / u.pc, a=np.zeros(grid.shape) / u.pc)
    camera = vm.Orthographic(width=2, resolution=10)
    things = [
        vm.Stars([(0.0, 0.0, 5.0)], 3000.0 * u.mJy, radii=0.5),
        vm.Stars([(0, 0, 5000) * u.mpc], 3 * u.Jy, radii=500 * u.mpc),
        vm.Stars(
            [[0 * u.pc, 0 * u.pc, 5 * u.pc]],
            luminosities=3 * np.pi * 0.25 * u.Jy * u.pc**2,
            radii=0.5 * u.pc,
        ),
    ]
    for thing in things:
        image = vm.render(volume, vm.Coefficients("j", "a"), camera, objects=[thing])
        assert image.intensity[5, 5, 0] == pytest.approx(3.0, rel=1e-6)
    with pytest.raises(vm.UnitsError, match="radii is in s"):
        vm.render(volume, MEDIUM, camera, objects=[vm.Stars([(0, 0, 0)], radii=1 * u.s)])


def test_stars_of_a_table():
    from astropy.table import QTable, Table

    columns = {
        "x": [0.0, 100.0] * u.mpc,
        "y": [0.0, 0.1] * u.pc,
        "z": [1.0, 2.0] * u.pc,
        "L": [1.0, 2.0],
        "r": [1.0, 0.5],
        "g": [2.0, 3.0],
        "name": ["red", "#0000ff"],
    }
    volume = vm.Volume(vm.CartesianGrid.uniform(2, (-1, 1), unit="pc"), a=np.zeros((2, 2, 2)))
    camera = vm.Orthographic(width=2, resolution=20)
    medium = vm.Coefficients(["a", "a", "a"], 0)
    for table in (Table(columns), QTable(columns), columns):
        stars = vm.Stars.from_table(table, color=["r", "g", "g"], luminosity="L")
        image = vm.render(volume, medium, camera, objects=[stars])
        total = image.intensity.sum(axis=(0, 1)) * image.pixel_area
        np.testing.assert_allclose(total, [2.0, 8.0, 8.0], rtol=1e-6)
    named = vm.Stars.from_table(Table(columns), color="name", radius=0.2, luminosity=None)
    assert named.colors == ["red", "#0000ff"]
    plain = vm.Stars.from_table(Table(columns), color="white", luminosity="L")
    assert plain.colors == "white"
    with pytest.raises(vm.errors.UnknownNameError, match="did you mean 'name'"):
        vm.Stars.from_table(Table(columns), luminosity="nam")


def test_objects_describe_themselves_and_pictures_tell_them():
    things = [
        vm.Stars([(1, 2, 3) * u.pc], "red", radii=0.1 * u.pc, depth="foreground"),
        vm.Stars(np.zeros((3, 3)), luminosities=[1, 2, 3], psf=2.0),
        vm.Spheres([[1, 2, 3]], 2.0, limb_darkening=0.5),
        vm.Curves([[[0, 0, 0], [1, 1, 1]], [[0, 0, 0], [1, 2, 3], [4, 5, 6]]], width=2.0 * u.mpc),
        vm.Boxes(width=2),
        vm.Axes(length=1 * u.pc),
    ]
    told = [thing.describe() for thing in things]
    assert json.loads(json.dumps(told)) == told
    assert [thing.describe() for thing in build_objects(told)] == told
    assert "Stars(positions=" in repr(things[0])
    many = vm.Stars(np.random.default_rng(7).random((1000, 3)), luminosities=1.0)
    image = vm.render(SLAB, MEDIUM, CAMERA, objects=[many])
    assert image.provenance["objects"] == [
        {"type": "stars", "positions": "3000 values", "luminosities": 1.0}
    ]


def test_scenes_have_objects(tmp_path):
    settings = {
        "volume": {"model": "sphere", "resolution": 8},
        "medium": {"type": "coefficients", "emissivity": ["inside"] * 3, "extinction": "inside"},
        "object": [
            {"type": "stars", "positions": [[0, 0, 3]], "colors": "red", "radii": 0.5},
            {"type": "boxes"},
        ],
        "camera": {"resolution": 20},
    }
    scene = vm.Scene(settings)
    image = scene.render()
    np.testing.assert_array_equal(image.intensity[10, 10], [1, 0, 0])
    image.save(tmp_path / "image.npz")
    again = vm.Scene.load(tmp_path / "image.npz")
    np.testing.assert_array_equal(again.render().intensity, image.intensity)
    with pytest.raises(vm.errors.UnknownNameError, match=r"\[\[object\]\] 1.*did you mean 'radii'"):
        scene.replaced({"object.1.radi": 2})
    assert scene.render(objects=[]).intensity.max() < image.intensity.max()


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda: vm.Stars([(0, 0, 0)]), "give a star a radius"),
        (lambda: vm.Stars([(0, 0)], radii=1), r"positions must be finite, of shape \(n, 3\)"),
        (lambda: vm.Stars([(0, 0, 0)], radii=0), "radii must be positive"),
        (lambda: vm.Stars([(0, 0, 0)], radii=1, psf=2), "a psf is for points"),
        (lambda: vm.Stars([(0, 0, 0)], luminosities=1, psf=0), "psf must be a positive width"),
        (lambda: vm.Stars([(0, 0, 0)], radii=1, opacity=2), "opacity must be from 0 to 1"),
        (lambda: vm.Stars([(0, 0, 0)], radii=1, channel=-1), "channel must be a whole number"),
        (lambda: vm.Stars([[0, 0, 0]] * 4, np.ones((3, 2)), radii=1), "list of 4"),
        (lambda: vm.Spheres([[0, 0, 0]] * 4, [1, 2]), "one for each of 4"),
        (lambda: vm.Curves([[0, 0, 0]]), "two points or more"),
        (lambda: vm.Curves([[0, 0, 0], [1, 1, np.inf]]), "must be finite"),
        (lambda: vm.Curves(np.zeros((3, 2, 3)), width=0), "width must be a positive"),
        (lambda: vm.render(SLAB, MEDIUM, CAMERA, objects=["star"]), "number 0 is of type str"),
        (
            lambda: vm.render(SLAB, MEDIUM, CAMERA, objects=vm.Boxes(), bounds=True),
            "bounds are of the medium alone",
        ),
        (
            lambda: vm.render(SLAB, MEDIUM, CAMERA, objects=vm.Stars([(0, 0, 0)], "red", radii=1)),
            "names are red, green and blue",
        ),
    ],
)
def test_what_makes_no_sense(make, told):
    with pytest.raises(vm.InputError, match=told):
        make()


def test_unknown_names_come_with_the_nearest():
    with pytest.raises(vm.errors.UnknownNameError, match=r"unknown color 'oragne'.*'orange'"):
        vm.Stars([(0, 0, 0)], "oragne", radii=1)
    with pytest.raises(vm.errors.UnknownNameError, match="did you mean 'foreground'"):
        vm.Stars([(0, 0, 0)], radii=1, depth="forground")


@pytest.mark.parametrize("thing", ["point", "psf", "disc"])
def test_the_error_counts_how_unsure_the_light_of_a_bright_star_is(thing):
    """A star a million times brighter than the cloud in front of it: what dims it must be known."""
    rng = np.random.default_rng(2)
    volume = vm.Volume(vm.CartesianGrid.uniform(8, (-1, 1)), a=rng.random((8, 8, 8)))
    cloud = vm.Coefficients(["a"], "8 * a**3")
    camera = vm.Orthographic(40, 20, width=2.0, resolution=9)
    options = {"psf": 2.0} if thing == "psf" else {}
    size = {"radii": 0.2} if thing == "disc" else {"luminosities": 1.0}
    star = vm.Stars([(0, 0, -0.7)], colors=1e6, **size, **options)
    rough = vm.render(volume, cloud, camera, objects=[star], tolerance=0.3)
    options = {"tolerance": 1e-8, "precision": "double", "cutoff": 0}
    exact = vm.render(volume, cloud, camera, objects=[star], **options)
    off = np.abs(rough.intensity - exact.intensity).max(axis=2)
    assert off.max() > 1.0  # far more than the cloud's own error
    # Estimates are of a difference between two solutions: a tenth of a per cent for rounding.
    assert np.all(off <= 1.001 * rough.error + 1e-6 * exact.intensity.max())
