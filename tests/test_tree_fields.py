"""Fields on refined grids between cells: continuous, linear where they are, of second order."""

from __future__ import annotations

import functools

import numpy as np
import pytest

import voluminous as vm
from contracts.bundle import Bundle, box_limits, on_a_sphere
from test_octree import random_octree, zoom
from test_patches import random_patches, tiles
from voluminous.backend import get_backend
from voluminous.rendering.sources.vertex_values import CornerValues

UNEVEN = ([-1.0, -0.3, 0.1, 0.8], [0.0, 0.5, 0.75, 2.0], [-1.0, -0.8, 1.0])
ONES = [np.arange(4.0)] * 3
CUBES = np.array([[0, 0, 0], [2, 0, 0], [3, 0, 0], [2, 1, 0.0]])
GRIDS = {
    "octree": lambda: random_octree(1, 5, 0.3),
    "rectilinear": lambda: random_octree(2, 4, 0.3, UNEVEN),
    "ratio 2": lambda: random_patches(1, 2),
    "ratio 3": lambda: random_patches(2, 3, 2, 8, ONES),
    "anisotropic": lambda: random_patches(3, [2, 1, 4], 2, 8, ONES),
    "tiles": lambda: tiles(1, 3, 2),
    "holes": lambda: vm.PatchGrid(CUBES, CUBES + 1, [[2, 2, 2], [4, 4, 4], [4, 4, 4], [2, 2, 2]]),
}
BITS = np.indices((2, 2, 2)).reshape(3, 8)


@functools.cache
def grid_named(name):
    return GRIDS[name]()


def corner_values(grid, field, precision):
    """Return the values at the corners of all cells, (n, 8)."""
    backend = get_backend("cpu", precision)
    (found,) = CornerValues(grid, [field], backend).compute()
    return np.array(found).reshape(-1, 8)


def corner_points(grid):
    """Return where they are, (n, 8, 3)."""
    low, high = grid.corners()
    return np.where(BITS.T[None] == 1, high.T[:, None], low.T[:, None])


def between(grid, values, cell, points):
    """Return what is trilinear in cells, at points (m, 3) in them."""
    low, high = grid.corners()
    f = np.clip((points.T - low[:, cell]) / (high - low)[:, cell], 0, 1)
    weight = np.where(BITS[:, :, None] == 1, f[:, None], 1 - f[:, None]).prod(axis=0)
    return np.einsum("km,mk->m", weight, values[cell])


def pairs_across_faces(grid, count=20_000):
    """Return points on faces, and the cells on both sides of them."""
    rng = np.random.default_rng(6)
    low, high = (c.T for c in grid.corners())
    cell = rng.integers(0, grid.size, count)
    points = rng.uniform(low[cell], high[cell])
    lane, axis, up = np.arange(count), rng.integers(0, 3, count), rng.integers(0, 2, count)
    points[lane, axis] = np.where(up, high[cell, axis], low[cell, axis])
    beyond = points.copy()
    beyond[lane, axis] += (2 * up - 1) * 1e-3 * (high - low).min(axis=0)[axis]
    other = grid.locate(beyond)
    there = other >= 0
    return points[there], cell[there], other[there]


@pytest.mark.each_value_once
@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("name", GRIDS)
def test_fields_are_continuous(name, precision):
    """Whatever the field: neighbours of any sizes agree on all of the wall they share."""
    grid = grid_named(name)
    field = np.random.default_rng(3).random(grid.size)
    values = corner_values(grid, field, precision)
    points, *cells = pairs_across_faces(grid)
    one, other = (between(grid, values, cell, points) for cell in cells)
    assert np.abs(one - other).max() <= 1e-6
    # Nothing is beyond what cells say.
    assert values.min() >= field.min() - 1e-7
    assert values.max() <= field.max() + 1e-7


def inner_cells(grid):
    """Return the cells at least one of the largest cells away from the surface and from holes."""
    low, high = (c.T for c in grid.corners())
    margin = (high - low).max(axis=0)
    around = [
        grid.locate(0.5 * (low + high) + margin * np.array(step) * 1.01)
        for step in np.indices((3, 3, 3)).reshape(3, -1).T - 1
    ]
    inside = (low - margin > grid.bounds[:, 0]) & (high + margin < grid.bounds[:, 1])
    return inside.all(axis=1) & (np.array(around) >= 0).all(axis=0)


def test_fields_are_linear_through_twenty_levels():
    """In double precision, which `render` takes by itself: nothing is lost where cells are tiny."""
    point = np.array([0.1, 1 / 3, -0.7])
    grid = zoom(20, tuple(point))
    values = corner_values(grid, (grid.cell_centers().T - point).sum(axis=1), "double")
    expected = (corner_points(grid) - point).sum(axis=2)
    low, high = (c.T for c in grid.corners())
    inner = (np.abs(0.5 * (low + high) - point).max(axis=1) < 0.02) & (grid.levels > 6)
    # Rounding of coordinates near one, compared with the cells.
    slack = 1e-15 + 1e-12 * (high - low).max(axis=1)
    assert inner.sum() > 50
    assert (np.abs(values - expected).max(axis=1) <= slack)[inner].all()


LINEAR = {
    "octree": lambda: random_octree(4, 4, 0.4, [np.arange(6.0)] * 3),
    "rectilinear": lambda: random_octree(
        5, 3, 0.4, [np.array([-1, 0, 0.3, 0.5, 0.7, 1.5])] + [np.array([0, 1, 1.5, 2, 2.2, 3])] * 2
    ),
    "ratio 3": lambda: random_patches(2, 3, 2, 10, [np.arange(6.0)] * 3),
    "anisotropic": lambda: random_patches(3, [2, 1, 4], 2, 10, [np.arange(6.0)] * 3),
}


@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("name", LINEAR)
def test_linear_fields_are_exact_inside(name, precision):
    grid = LINEAR[name]()
    slopes = np.array([2.0, -3.0, 0.5])
    values = corner_values(grid, slopes @ grid.cell_centers(), precision)
    inner, expected = inner_cells(grid), corner_points(grid) @ slopes
    assert inner.sum() > 20
    slack = {"single": 2e-6, "double": 1e-12}[precision]
    assert np.abs(values - expected)[inner].max() <= slack * np.abs(expected).max()


def smooth(x, y, z):
    return np.sin(1.3 * x + 0.4) * np.cos(0.9 * y) + 0.3 * np.sin(2 * z)


def around_a_shell(base, levels=2):
    """Return a tree refined where it is near a sphere."""
    edges = np.linspace(-1, 1, base + 1)

    def near(x, y, z, size):
        return np.abs(np.sqrt(x * x + y * y + z * z) - 0.6) < 0.15

    return vm.OctreeGrid.from_function(edges, edges, edges, near, levels)


def test_corners_at_jumps_of_level_are_of_second_order():
    errors = []
    for n in (8, 16, 32):
        grid = around_a_shell(n)
        points = corner_points(grid)
        inner = (np.abs(points) < 0.8).all(axis=2)
        values = corner_values(grid, smooth(*grid.cell_centers()), "double")
        errors.append(np.abs(values - smooth(*np.moveaxis(points, 2, 0)))[inner].max())
    assert (-np.diff(np.log2(errors)) > 1.8).all()


@pytest.mark.parametrize("name", ["even", "refined"])
def test_sums_over_cells_are_kept_if_asked_for(name):
    """Values at corners that are limited to what is around them change the sum of a steep field.

    What is left: corners at the surface and at jumps of level do not weigh all cells alike.
    """
    even = name == "even"
    grid = vm.OctreeGrid(*[np.linspace(-1, 1, 17)] * 3) if even else around_a_shell(16)
    radius, size = np.linalg.norm(grid.cell_centers(), axis=0), grid.cell_volumes
    fields = [1.0 * (radius < 0.55), *([np.exp(-10 * radius)] if even else [])]
    for data, field in zip(
        CornerValues(grid, fields, get_backend("cpu", "double"), [True] * len(fields)).compute(),
        fields,
        strict=True,
    ):
        values = np.array(data).reshape(-1, 8)
        assert np.sum(values.mean(axis=1) * size) == pytest.approx(np.sum(field * size), rel=1e-3)
        assert values.min() >= 0.0


def analytic(origins, directions, points=8001):
    """Return the intensity of the medium below, by the midpoint rule."""
    enter, leave = box_limits(np.array([[-1.0, 1.0]] * 3), origins, directions)
    step = (leave - enter) / points
    t = enter[:, None] + step[:, None] * (np.arange(points) + 0.5)
    place = origins[:, :, None] + directions[:, :, None] * t[:, None]
    shape = np.exp(-0.5 * ((smooth(*np.moveaxis(place, 1, 0)) - 0.3) / 0.3) ** 2)
    tau = 0.7 * step[:, None] * (np.cumsum(shape, axis=1) - 0.5 * shape)
    return (shape * np.exp(-tau)).sum(axis=1) * step


def test_pictures_are_of_second_order_in_the_width_of_cells():
    rng = np.random.default_rng(2)
    origins, directions = rng.uniform(-0.3, 0.3, (64, 3)), on_a_sphere(64, 4)
    medium, camera = vm.Gaussian("a", 0.3, 0.3, [1.0], 0.7, 1.0), Bundle(origins, directions)
    exact, errors = analytic(origins, directions), []
    for n in (4, 8, 16, 32):
        grid = around_a_shell(n, 1)
        volume = vm.Volume(grid, a=smooth(*grid.cell_centers()))
        image = vm.render(volume, medium, camera, precision="double", tolerance=1e-7, cutoff=0.0)
        errors.append(np.sqrt(np.mean((camera.flat(image.intensity) - exact) ** 2)))
    assert -np.diff(np.log2(errors)).mean() > 1.85


def test_corners_in_even_parts_are_of_fourth_order():
    """Where all cells around are alike; plain means are off by the second derivatives."""
    errors = []
    for n in (8, 16, 32):
        grid = vm.OctreeGrid(*[np.linspace(-1, 1, n + 1)] * 3)
        points = corner_points(grid)
        inner = (np.abs(points) < 0.7).all(axis=2)
        values = corner_values(grid, smooth(*grid.cell_centers()), "double")
        errors.append(np.abs(values - smooth(*np.moveaxis(points, 2, 0)))[inner].max())
    assert (-np.diff(np.log2(errors)) > 3.7).all()
