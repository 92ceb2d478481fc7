"""The pixels that discs and lines cover: areas in closed form, and what rays through them meet."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import voluminous as vm
from voluminous.objects.balls import disc_in_polygon

GRID = vm.CartesianGrid.uniform(4, (-1, 1))
VOLUME = vm.Volume(GRID, a=np.zeros(GRID.shape))
DARK = vm.Coefficients("a", "a")


def shown(camera, *things, **options):
    """Return the first channel of a picture of things in empty space."""
    image = vm.render(VOLUME, DARK, camera, objects=things, scheme="first-order", **options)
    return image, image.intensity[..., 0].astype(float)


@given(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(0.01, 12), st.floats(0.3, 3))
def test_the_disc_in_all_pixels_is_the_whole_disc(x, y, radius, aspect):
    edges = np.arange(-15, 16)
    low = [a.ravel() for a in np.meshgrid(edges[:-1] * aspect, edges[:-1])]
    corners = [
        (low[0] + i * aspect - x) + 1j * (low[1] + j - y)
        for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))
    ]
    area = disc_in_polygon(np.array(corners) / radius) * radius**2
    reach = min(15 * aspect, 15) - 0.5
    assert area.min() > -1e-12
    assert area.max() < aspect + 1e-12
    if radius < reach:
        # Rounding of 900 areas, each a difference of sectors of the disc.
        assert area.sum() == pytest.approx(np.pi * radius**2, rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("place", [(0, 0, 0), (0.3, 1.2, 0.9), (1.5, -0.4, 0.3)])
@pytest.mark.parametrize("radius", [0.01, 0.3])
def test_spheres_on_a_flat_screen_are_ellipses(place, radius):
    camera = vm.Perspective((3, 0, 0), (0, 0, 0), fov=80, posang=20, resolution=60)
    image, seen = shown(camera, vm.Spheres([place], radius), precision="double")
    way = np.array(place) - (3, 0, 0)
    distance = np.linalg.norm(way)
    sin2, cos2 = (radius / distance) ** 2, (way[0] / distance) ** 2
    # A cone around a direction at θ from the axis, cut by the screen: semi-axes of sin α cos α / K
    # and sin α / √K with K = cos² θ - sin² α.
    area = np.pi * sin2 * np.sqrt(1 - sin2) / (cos2 - sin2) ** 1.5
    assert seen.sum() * image.pixel_area == pytest.approx(area, rel=1e-10)


@pytest.mark.parametrize("radius", [0.2, 0.8, 1.4])
def test_spheres_on_a_dome_are_where_rays_meet_them(radius):
    dome = {"fov": 250, "projection": "spherical"}
    camera = vm.Perspective((0.5, 0.2, 0.1), (1, 0, 0), **dome, resolution=80)
    place = np.array([-0.6, 1.3, -0.4])
    _, seen = shown(camera, vm.Spheres([place], radius))
    fine = camera.replace(resolution=400)
    frame = fine.frame(GRID)
    u, v = np.meshgrid(*frame.coordinates())
    # Rays by the formula of the dome, in NumPy.
    q = np.hypot(u, v)
    ex, ey, ez = frame.vectors[1:]
    sinc = np.sinc(q / np.pi)
    ray = (u * sinc)[..., None] * ex + (v * sinc)[..., None] * ey - np.cos(q)[..., None] * ez
    way = place - frame.vectors[0]
    along = ray @ way
    hit = (along > 0) & (way @ way - along**2 < radius**2)
    counted = hit.reshape(80, 5, 80, 5).mean(axis=(1, 3))
    # 16 or 25 rays a pixel tell its edge to a fifth; images are ellipses to 2 %, or of rays.
    assert np.abs(seen - counted).max() < 0.2
    assert seen.sum() == pytest.approx(counted.sum(), rel=5e-3)


@pytest.mark.parametrize("radius", [0.005, 0.2])
def test_limb_darkening_keeps_the_luminosity(radius):
    camera = vm.Orthographic(width=2, resolution=100)
    star = vm.Stars([(0.1, 0.05, 0)], radii=radius, luminosities=2.0, limb_darkening=0.6)
    image, seen = shown(camera, star)
    # At the middles of pixels, of which the radius has 10: it is steep at the edge.
    assert seen.sum() * image.pixel_area == pytest.approx(2.0, rel=5e-3)


@pytest.mark.parametrize("width", [0.3, 1.0, 2.7])
@pytest.mark.parametrize("angle", [0, 0.1, 17, 45])
def test_lines_cover_their_width(width, angle):
    """A strip from the left to the right edge: its area is width · nx / cos φ."""
    camera = vm.Orthographic(width=2, resolution=60)
    slope = np.tan(np.deg2rad(angle))
    far = [[-3, -3 * slope + 0.011, 0], [3, 3 * slope + 0.011, 0]]
    if angle == 45:  # it leaves through a corner: the middle columns
        columns = slice(10, 50)
    else:
        columns = slice(0, 60)
    _, seen = shown(camera, vm.Curves(far, width=width), precision="double")
    expected = width / np.cos(np.deg2rad(angle))
    np.testing.assert_allclose(seen[:, columns].sum(axis=0), expected, rtol=1e-6)


@pytest.mark.parametrize("fov", [60, 140])
def test_lines_in_perspective_go_where_their_points_go(fov):
    things = np.random.default_rng(3).uniform(-1, 1, (6, 2, 3))
    dome = {"fov": 2 * fov, "projection": "spherical"}
    for camera in (
        vm.Perspective((1.4, 0.3, 0.2), (0, 0, 0), fov=fov, resolution=70),
        vm.Perspective((0.4, 0.3, 0.2), (0, 0, 0), **dome, resolution=70),
    ):
        frame = camera.frame(GRID)
        for ends in things:
            _, seen = shown(camera, vm.Curves(ends, width=2.0))
            s = np.linspace(0, 1, 4001)[:, None]
            u, v, depth = camera.project((ends[0] + s * (ends[1] - ends[0])).T, GRID)
            pixel = [w / step + 34.5 for w, step in zip((u, v), frame.pixel, strict=True)]
            inside = np.all([(p > -0.5) & (p < 69.5) for p in pixel], axis=0) & (depth > 0)
            x, y = (np.round(p[inside]).astype(int) for p in pixel)
            assert np.all(seen[y, x] > 0.45)  # a pixel with the middle of a strip of two
            near = np.zeros((74, 74), bool)
            for dx, dy in np.ndindex(5, 5):
                near[y + dy, x + dx] = True
            assert not seen[3:-3, 3:-3][~near[5:-5, 5:-5]].any()


def test_widths_in_space_shrink_with_distance():
    camera = vm.Perspective((4, 0, 0), (0, 0, 0), fov=40, resolution=100)
    lines = [[[2, -2, 0], [2, 2, 0]], [[-2, -2, 0.5], [-2, 2, 0.5]]]
    from astropy import units as u

    _, seen = shown(camera, vm.Curves(lines, width=0.05 * u.one))
    pixel = camera.frame(GRID).pixel[0]
    rows = seen[:, 45:55].sum(axis=0)
    expected = 0.05 / pixel * (1 / 2 + 1 / 6)
    np.testing.assert_allclose(rows, expected, rtol=2e-2)  # 0.5 at 6 is 5 degrees off the axis


def test_no_points_and_no_table_are_refused():
    for points in ([], np.zeros((0, 3)), np.zeros((0, 5, 3))):
        with pytest.raises(vm.InputError, match="got none"):
            vm.Curves(points)
    with pytest.raises(vm.InputError, match="expected a table of astropy"):
        vm.Stars.from_table(3, luminosity=1)
