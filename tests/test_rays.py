"""No ray leaks, hangs or goes mad: on faces, edges and vertices, in every direction."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import voluminous as vm
from contracts import Bundle, box_limits, on_a_sphere
from contracts.camera import rays_of
from voluminous.schemes import SCHEMES

EDGES = {
    "uniform": [0.0, 1.0, 2.0, 3.0, 4.0],
    "uneven": [0.0, 0.5, 0.5 + 2.0**-10, 2.25, 4.0],
    "a million to one": [0.0, 2.0**-20, 2.0, 2.0 + 2.0**-20, 4.0],
}
# All the ways along axes, face diagonals and space diagonals: 26 of them.
LATTICE = np.array([d for d in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(d)])
# A dozen roundings of distances of up to the diagonal, 7, over the cosine with a wall.
ROUNDING = {"single": 1e-5, "double": 1e-12}


@pytest.fixture(params=sorted(ROUNDING))
def precision(request):
    return request.param


@pytest.fixture(params=sorted(EDGES))
def volume(request):
    return volume_of(EDGES[request.param])


def volume_of(edges):
    """Return a cube of cells with an extinction of one, and one between 1 and 2."""
    grid, rng = vm.CartesianGrid(edges, edges, edges), np.random.default_rng(0)
    return vm.Volume(grid, one=np.ones(grid.shape), a=rng.uniform(1, 2, size=grid.shape))


def special_points(edges):
    """Return vertices and the middles of edges, faces and cells; those outside, and inside."""
    ticks = np.sort(np.concatenate([edges, 0.5 * np.add(edges[1:], edges[:-1])]))
    points = np.array(list(itertools.product(ticks, repeat=3)))
    inside = np.all((points > edges[0]) & (points < edges[-1]), axis=1)
    return points, points[inside]


def lengths(bounds, origins, directions, *, start):
    """Return the lengths of lines in a closed box, or of rays that start at their origins."""
    enter, leave = box_limits(bounds, origins, directions)
    return np.maximum(leave - np.maximum(enter, 0), 0) if start else leave - enter


def check(volume, origins, directions, precision, scheme="first-order", *, start=False):
    """Assert that α = 1 gives the length, and 1 <= α <= 2 from one to two times as much."""
    origins, directions = np.broadcast_arrays(origins, directions)
    rays = Bundle(origins, directions, start=start)
    exact = lengths(volume.grid.bounds, origins, directions, start=start)

    def depth(extinction):
        image = vm.render(
            volume,
            vm.Coefficients("0", extinction),
            rays,
            scheme=scheme,
            precision=precision,
            cutoff=0,
        )
        return rays.flat(image.optical_depth)

    found, noisy = depth("one"), depth("a")
    rounding = ROUNDING[precision]
    np.testing.assert_allclose(found, exact, rtol=0, atol=rounding)
    assert (noisy >= exact - rounding).all()
    assert (noisy <= 2 * exact + 2 * rounding).all()


@pytest.mark.each_value_once
@pytest.mark.parametrize("scheme", sorted(SCHEMES))
def test_lines_along_walls_and_through_vertices(volume, precision, scheme):
    points, _ = special_points(volume.grid.edges[0])
    if scheme != "first-order":  # they walk alike: what differs are the corners
        points = points[:: len(points) // 100]
    for way in LATTICE:
        # Exact numbers: the lines do go through the points, and along the walls.
        check(volume, points - 8 * way, way / np.linalg.norm(way), precision, scheme)


@pytest.mark.each_value_once
@pytest.mark.parametrize("tilt", [1e-300, 1e-17, 1e-12, 1e-9, 0.05])
def test_lines_nearly_along_walls(volume, precision, tilt):
    edges = volume.grid.edges[0]
    points, _ = special_points(edges)
    if tilt == 0.05:  # as much as never leads from a wall of the thinnest cell to the next
        tilt *= np.diff(edges).min()
    for axis, sign in itertools.product(range(3), (-1.0, 1.0)):
        way = np.full(3, tilt)
        way[(axis + 1) % 3] *= -1
        way[axis] = sign
        way /= np.linalg.norm(way)
        # On an outer wall, the last bit of where such a line starts says whether it is inside.
        across = np.delete(points, axis, axis=1)
        inside = np.all((across > edges[0]) & (across < edges[-1]), axis=1)
        check(volume, points[inside] - 8 * way, way, precision)


def test_lines_within_rounding_of_walls_and_vertices(volume, precision):
    rng = np.random.default_rng(1)
    _, points = special_points(volume.grid.edges[0])
    for way in LATTICE:
        nudged = points * (1 + rng.integers(-3, 4, size=points.shape) * 2.0**-52)
        ways = way + rng.integers(-3, 4, size=points.shape) * 2.0**-53
        ways /= np.linalg.norm(ways, axis=1, keepdims=True)
        check(volume, nudged - 8 * ways, ways, precision)


@pytest.mark.each_value_once
@pytest.mark.parametrize("scheme", sorted(SCHEMES))
def test_observer_inside_and_on_the_walls(volume, precision, scheme):
    points, _ = special_points(volume.grid.edges[0])
    points = points[:: 1 if scheme == "first-order" else 7]
    ways = LATTICE / np.linalg.norm(LATTICE, axis=1, keepdims=True)
    for way in np.concatenate([ways, on_a_sphere(6, seed=4)]):
        check(volume, points, way, precision, scheme, start=True)


def test_a_line_along_a_wall_belongs_to_one_of_its_cells(precision):
    edges = EDGES["uniform"]
    grid = vm.CartesianGrid(edges, edges, edges)
    column = 1.0 + np.arange(4)[:, None] + 10.0 * np.arange(4)
    volume = vm.Volume(grid, a=np.repeat(column[:, :, None], 4, axis=2))
    places = np.array(list(itertools.product(edges, [0.5, *edges])))
    origins = np.column_stack([places, np.full(len(places), 9.0)])
    for down in (-1.0, 1.0):
        rays = Bundle(origins * [1, 1, -down], [0.0, 0.0, down])
        medium = vm.Coefficients("0", "a")
        image = vm.render(volume, medium, rays, scheme="first-order", precision=precision)
        for (x, y), depth in zip(places, rays.flat(image.optical_depth), strict=True):
            near = [column[i, j] for i in _cells_at(x) for j in _cells_at(y)]
            assert np.abs(depth / 4 - near).min() < ROUNDING[precision]


def _cells_at(coordinate):
    """Return the numbers of the unit cells that a coordinate touches."""
    return [i for i in range(4) if i <= coordinate <= i + 1]


@pytest.mark.parametrize("projection", ["flat", "spherical"])
@pytest.mark.parametrize("eye", [(2, 2, 2), (2, 1.5, 2), (0, 2, 2), (4, 4, 4), (0, 0, 0.5)])
def test_perspective_from_special_places(volume, precision, eye, projection):
    camera = vm.Perspective(
        eye, np.add(eye, (0, 0, -1)), width=3.0, projection=projection, resolution=31, up=(0, 1, 0)
    )
    image = vm.render(
        volume, vm.Coefficients("0", "one"), camera, scheme="first-order", precision=precision
    )
    exact = lengths(volume.grid.bounds, *rays_of(camera, volume.grid), start=True)
    found = image.optical_depth.ravel()
    np.testing.assert_allclose(found, exact, rtol=0, atol=ROUNDING[precision])


@pytest.mark.parametrize("angles", [(0, 0), (90, 0), (90, 90), (180, 270), (45, 0), (90, 45)])
def test_pixels_on_walls(volume, precision, angles):
    # 17 pixels of 1/4 across 4: every fourth column of them runs along the walls.
    camera = vm.Orthographic(*angles, width=4.25, resolution=17)
    image = vm.render(
        volume, vm.Coefficients("0", "one"), camera, scheme="first-order", precision=precision
    )
    exact = lengths(volume.grid.bounds, *rays_of(camera, volume.grid), start=False)
    found = image.optical_depth.ravel()
    # Seen at an angle, the outer edges themselves may be met or missed.
    doubtful = _grazes(volume.grid.bounds, *rays_of(camera, volume.grid))
    np.testing.assert_allclose(found[~doubtful], exact[~doubtful], rtol=0, atol=ROUNDING[precision])
    assert np.isfinite(found).all()


def _grazes(bounds, origins, directions):
    """Return the lines that come within rounding of missing (or meeting) a box."""
    grown = bounds + np.array([-1e-9, 1e-9])
    more, less = (lengths(b, origins, directions, start=False) for b in (grown, 2 * bounds - grown))
    return (more > 0) & (less == 0) | (more - less > 1e-3)


@pytest.mark.parametrize("shape", [(1, 1, 1), (1, 1, 40), (40, 1, 1), (1, 40, 2)])
def test_flat_grids_and_odd_pictures(shape, precision):
    grid = vm.CartesianGrid.uniform(shape, ((0, 1), (0, 2), (-3, 0)))
    volume = vm.Volume(grid, one=np.ones(shape))
    for resolution, width in [(1, 0.5), ((1, 9), (1.0, 4.0)), ((33, 2), (2.0, 0.1)), (18, None)]:
        camera = vm.Orthographic(70, 20, width=width, resolution=resolution)
        image = vm.render(
            volume, vm.Coefficients("0", "one"), camera, scheme="first-order", precision=precision
        )
        exact = lengths(grid.bounds, *rays_of(camera, grid), start=False)
        found = image.optical_depth.ravel()
        np.testing.assert_allclose(found, exact, rtol=0, atol=ROUNDING[precision])
        assert (found > 0).any()
