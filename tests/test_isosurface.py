"""Isosurfaces: every crossing counted once, and seen in its own colour."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from astropy import units as u

import voluminous as vm
from contracts.bundle import Bundle, on_a_sphere
from voluminous.errors import InputError
from voluminous.scene.settings import loads

RAYS = 256
# A crossing within this of a turning point of the field may be seen as none, in float32.
GRAZING = {"single": 1e-4, "double": 1e-6}


def one_dual_cell(values):
    """Return a volume whose centres are the corners of the unit cube, rays through that cube."""
    edges = [np.array([-0.5, 0.5, 1.5])] * 3
    values = np.asarray(values, np.float32).astype(float)
    return vm.Volume(vm.CartesianGrid(*edges), a=values)


def crossings(values, origin, direction, level):
    """Return how often a ray passes the level, and how near to it the field turns on the ray."""
    t = np.linspace(-4, 4, 40001)
    inside = np.all(np.abs(origin + t[:, None] * direction - 0.5) <= 1, axis=1)
    place = np.clip(origin + t[inside, None] * direction, 0, 1)
    at = values[..., None]
    for part in place.T:
        at = at[0] + part * (at[1] - at[0])
    at -= level
    rising = np.diff(at) > 0
    turns = np.flatnonzero(rising[1:] != rising[:-1]) + 1
    return np.count_nonzero(np.diff(at > 0)), np.abs(at[[0, -1, *turns]]).min()


@functools.cache
def cubics():
    """Return cells, levels, rays through them, and what `crossings` says of these."""
    rng, found = np.random.default_rng(8), []
    for number in range(12):
        # Alternating corners: up to three crossings in one cell.
        sign = (-1.0) ** np.indices((2, 2, 2)).sum(axis=0)
        values = (rng.normal(size=(2, 2, 2)) + 1.5 * sign).astype(np.float32).astype(float)
        level = rng.normal(0, 0.15)
        # Half of them along diagonals, where the cubic turns most.
        origins = rng.uniform(0, 1, (RAYS, 3))
        directions = on_a_sphere(RAYS, number)
        directions[: RAYS // 2] = np.sign(directions[: RAYS // 2]) + 0.3 * directions[: RAYS // 2]
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        exact = [crossings(values, o, d, level) for o, d in zip(origins, directions, strict=True)]
        found.append(
            (values, level, Bundle(origins, directions), *map(np.array, zip(*exact, strict=True)))
        )
    return found


@pytest.mark.parametrize("precision", ["single", "double"])
def test_crossings_are_the_roots_of_the_cubic(precision):
    counted = []
    for values, level, camera, count, near in cubics():
        volume, opacity = one_dual_cell(values), 0.2
        medium = vm.Isosurface("a - 0.0", level, [1.0], opacity)
        image = vm.render(volume, medium, camera, precision=precision, cutoff=0.0)
        found = camera.flat(image.optical_depth) / -np.log1p(-opacity)
        clear = near > GRAZING[precision]
        # Of all 1500 rays one finds one of three crossings: its nodes show no more.
        assert np.mean(np.abs(found - count)[clear] > 1e-4) < 0.005
        counted.append(count[clear])
    counted = np.concatenate(counted)
    assert {0, 1, 2, 3} <= set(counted.tolist())


def slope(axis_values=(0.0, 1.0, 2.0, 3.0, 4.0), gradient=1.0):
    """Return a field that grows along x."""
    values = gradient * np.array(axis_values)
    field = np.broadcast_to(values[:, None, None], (len(values), 4, 4))
    bounds = ((0, len(values)), (0, 4), (0, 4))
    return vm.Volume(vm.CartesianGrid.uniform(field.shape, bounds), a=field)


def seen(volume, medium, direction=(1.0, 0, 0), through=(2.5, 2.0, 2.0), **options):
    """Return what one ray shows: intensity per channel, and transparency."""
    direction = np.asarray(direction, float) / np.linalg.norm(direction)
    camera = Bundle([np.asarray(through) - 20 * direction], [direction])
    image = vm.render(volume, medium, camera, **options)
    return image.intensity[0, 0], float(image.transparency[0, 0, 0])


@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("width", [0.0, 1e-3, 0.4])
def test_levels_are_seen_one_behind_the_other(width, precision):
    colors = np.array([[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]])
    medium = vm.Isosurface("a", level=[0.7, 1.6, 3.1], color=colors, opacity=0.4, width=width)
    options = {"precision": precision}
    there, left = seen(slope(), medium, **options)
    back, _ = seen(slope(), medium, (-1.0, 0, 0), **options)
    shown = 0.4 * 0.6 ** np.arange(3)
    np.testing.assert_allclose(there, shown, rtol=2e-5)
    np.testing.assert_allclose(back, shown[::-1], rtol=2e-5)
    np.testing.assert_allclose(left, 0.6**3, rtol=2e-5)


@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("gradient", [1e-3, 1.0, 1e4])
def test_a_crossing_is_as_dense_at_every_angle_and_gradient(gradient, precision):
    for width in (0.0, 0.3 * gradient):
        medium = vm.Isosurface("a", 1.93 * gradient, [0.8, 0.1], 0.3, width)
        for angle in (0, 30, 60, 80):
            way = (np.cos(np.radians(angle)), np.sin(np.radians(angle)), 0)
            through = (2.43, 2.0, 2.0)
            color, left = seen(slope(gradient=gradient), medium, way, through, precision=precision)
            np.testing.assert_allclose(color, [0.24, 0.03], rtol=2e-5)
            np.testing.assert_allclose(left, 0.7, rtol=2e-5)


@pytest.mark.parametrize("width", [0.0, 0.3])
@pytest.mark.parametrize("angle", [0, 30, 60])
def test_density_by_gradient_is_that_of_a_sheet(angle, width):
    """A sheet is 1/cos as thick seen at an angle; head-on it is one crossing."""
    medium = vm.Isosurface("a", 1.93, [1.0], 0.3, width, density="gradient")
    way = (np.cos(np.radians(angle)), np.sin(np.radians(angle)), 0)
    color, left = seen(slope(), medium, way, (2.43, 2.0, 2.0))
    depth = -np.log(0.7) / np.cos(np.radians(angle))
    np.testing.assert_allclose(left, np.exp(-depth), rtol=1e-4)
    np.testing.assert_allclose(color, 1 - np.exp(-depth), rtol=1e-4)


@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("angle", [90.0, 89.999])
def test_a_sheet_of_some_thickness_is_seen_edge_on(angle, precision):
    """A ray along it is in it all the way, though it crosses nothing: 4 long, a slope of 1."""
    medium = vm.Isosurface("a", 1.93, [1.0], 0.05, 0.3, density="gradient")
    way = (np.cos(np.radians(angle)), np.sin(np.radians(angle)), 0)
    color, left = seen(slope(), medium, way, (2.43, 2.0, 2.0), precision=precision)
    depth = -np.log(0.95) * 4 / 0.3
    np.testing.assert_allclose(left, np.exp(-depth), rtol=1e-5)  # rounding of single precision
    np.testing.assert_allclose(color, 1 - np.exp(-depth), rtol=1e-5)


@pytest.mark.parametrize("shading", [0.0, 0.4, 1.0])
def test_shading_is_by_the_cosine(shading):
    medium = vm.Isosurface("a", 1.93, [1.0], 0.3, shading=shading)
    for angle in (0, 35, 70):
        way = (np.cos(np.radians(angle)), 0, np.sin(np.radians(angle)))
        color, left = seen(slope(), medium, way, (2.43, 2.0, 2.0))
        lit = 1 - shading + shading * np.cos(np.radians(angle))
        np.testing.assert_allclose(color, 0.3 * lit, rtol=1e-4)
        np.testing.assert_allclose(left, 0.7, rtol=1e-5)  # light takes nothing away


def test_second_order_with_a_width_agrees():
    """On tabulated coefficients the slope is |∇x|: a sheet, seen head-on one crossing."""
    n = 128
    volume = vm.Volume(
        vm.CartesianGrid.uniform((n, 4, 4), ((0, 5), (0, 4), (0, 4))),
        a=np.broadcast_to(((np.arange(n) + 0.5) * 5 / n)[:, None, None], (n, 4, 4)),
    )
    medium = vm.Isosurface("a", 2.1, [1.0], 0.3, 1.0)
    color, left = seen(volume, medium, scheme="second-order", through=(2.5, 2.1, 2.2))
    # The edges of the shell fall within cells: a part in its 26.
    np.testing.assert_allclose([color[0], left], [0.3, 0.7], rtol=0.03)


def test_without_a_width_other_schemes_say_what_to_do():
    medium = vm.Isosurface("a", 2.1, [1.0])
    with pytest.raises(InputError, match="post-classified"):
        seen(slope(), medium, scheme="second-order")


BAD = {
    "level": [{}, {"level": []}, {"level": float("nan")}],
    "width": [{"level": 1.0, "width": -1.0}],
    "opacity": [{"level": 1.0, "opacity": wrong} for wrong in (1.5, -0.1, [0.1, 0.2])],
    "shading": [{"level": 1.0, "shading": 2}],
    "color": [{"level": [1, 2], "color": c} for c in ([[1, 0, 0]], [[1.0, 0.0], [1.0]])],
}


def test_levels_are_quantities_in_any_kind_of_list():
    array = [1.0, 2000.0] * u.m
    for levels in (array, list(array), (1 * u.m, 2 * u.km)):
        medium = vm.Isosurface("a", level=levels)
        assert [level.to_value("m") for level in medium.levels] == [1, 2000]


@pytest.mark.parametrize("named", BAD)
def test_what_does_not_fit_is_refused(named):
    for given in BAD[named]:
        with pytest.raises(InputError, match=named):
            vm.Isosurface("a", **given)


def ramp():
    """Return a volume whose field grows along z, seen along z."""
    grid = vm.CartesianGrid.uniform((2, 2, 16), ((-1, 1), (-1, 1), (0, 4)))
    return vm.Volume(grid, a=np.broadcast_to(grid.centers[2], grid.shape))


@pytest.mark.each_value_once
@pytest.mark.parametrize("width", [0.0, 0.2])
@pytest.mark.parametrize(
    ("opacity", "rows"),
    [
        ((0.1, 0.5, 1.0), [[0.1] * 3, [0.5] * 3, [1.0] * 3]),
        ([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6], [0.7, 0.8, 0.9]],) * 2,
        ([0.2, [0.4, 0.5, 0.6], 0.9], [[0.2] * 3, [0.4, 0.5, 0.6], [0.9] * 3]),
        (0.3, [[0.3] * 3] * 3),
    ],
    ids=["one each", "rows", "mixed", "one for all"],
)
def test_every_level_has_its_own_opacity(opacity, rows, width):
    colors = np.array([[1.0, 0.2, 0.3], [0.4, 1.0, 0.6], [0.7, 0.8, 1.0]])
    medium = vm.Isosurface("a", level=[1, 2, 3], color=colors, opacity=opacity, width=width)
    image = vm.render(ramp(), medium, vm.Orthographic(width=1, resolution=1), bounds=True)
    through = 1 - np.array(rows)
    # From the observer, above, to the last one: each shows color · opacity of what is left.
    before = np.cumprod(np.vstack([np.ones(3), through[:0:-1]]), axis=0)[::-1]
    shown = (before * colors * (1 - through)).sum(axis=0)
    np.testing.assert_allclose(image.intensity[0, 0], shown, rtol=1e-5)
    np.testing.assert_allclose(image.transparency[0, 0], through.prod(axis=0), atol=1e-6)
    assert (image.lower <= image.intensity + 1e-6).all()
    assert (image.upper >= image.intensity - 1e-6).all()
    for one in (medium, medium.replace(density="gradient", shading=0.5, color="viridis")):
        scene = vm.Scene({"volume": {"model": "sphere"}, "medium": one})
        assert vm.Scene(loads(scene.dumps())).medium.key() == one.key()
