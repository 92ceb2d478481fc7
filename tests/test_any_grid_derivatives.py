"""Derivatives on grids that are not Cartesian: linear fields, closed forms, and orders."""

from __future__ import annotations

import numpy as np
import pytest

import voluminous as vm
from toy_grids import ShuffledGrid
from voluminous.derivatives import differences

EDGES = ([0.0, 1.0, 3.0, 3.5, 4.0], [-1.0, 0.0, 1.0, 2.0, 2.5], [-1.0, 0.0, 1.0, 2.0, 4.0, 5.0])
OPERATORS = ["gradmag(f)", "laplacian(f)", "grad(f).x", "grad(f).y", "grad(f).z"]


def random_fields(grid, *shapes):
    return np.random.default_rng(3).normal(size=grid.shape)


@pytest.mark.parametrize("operation", OPERATORS)
def test_flat_cells_in_a_row_have_the_derivatives_of_a_cartesian_grid(operation):
    original = vm.CartesianGrid(*EDGES)
    flat = ShuffledGrid(original)
    values = random_fields(original)
    expected = vm.Volume(original, f=values).evaluate(operation)
    found = vm.Volume(flat, f=flat.shuffled(values)).evaluate(operation)
    inside = np.zeros(original.shape, bool)
    inside[1:-1, 1:-1, 1:-1] = True
    inside = flat.shuffled(inside)
    # Ends are of first order here, of second on a Cartesian grid.
    np.testing.assert_allclose(found[inside], flat.shuffled(expected)[inside], rtol=1e-10)


@pytest.mark.parametrize("shape", [(1, 4, 5), (3, 1, 1), (1, 1, 1)])
def test_an_axis_of_one_cell_has_no_slope(shape):
    flat = ShuffledGrid(vm.CartesianGrid.uniform(shape, (0, 1)))
    volume = vm.Volume(flat)
    volume["f"] = "1 + 2*x - 3*y + 0.5*z"
    expected = np.where(np.array(shape) > 1, [2.0, -3.0, 0.5], 0.0)[:, None]
    found = volume.evaluate("grad(f)")
    np.testing.assert_allclose(found, expected + 0 * found, atol=1e-12)


def spherical(n, **options):
    return vm.SphericalGrid(
        np.geomspace(1, 3, n + 1),
        np.linspace(0.2, 2.8, n + 1),
        np.linspace(0, 2 * np.pi, 2 * n + 1),
        **options,
    )


def cylindrical(n):
    return vm.CylindricalGrid(
        np.geomspace(1, 3, n + 1), np.linspace(0, 2 * np.pi, 2 * n + 1), np.linspace(-1, 2, n + 1)
    )


EXACT = {  # of f = exp(x) sin(y) z³
    "grad(f).x": "exp(x)*sin(y)*z**3",
    "grad(f).y": "exp(x)*cos(y)*z**3",
    "grad(f).z": "3*exp(x)*sin(y)*z**2",
    "laplacian(f)": "6*exp(x)*sin(y)*z",
    "gradmag(f)": "exp(x)*sqrt(z**6 + 9*sin(y)**2*z**4)",
}


@pytest.mark.parametrize("make", [spherical, cylindrical])
@pytest.mark.parametrize("operation", EXACT)
def test_curvilinear_derivatives_converge_with_second_order(make, operation):
    errors = []
    for n in (12, 24, 48):
        volume = vm.Volume(make(n))
        volume["f"] = "exp(x)*sin(y)*z**3"
        wrong = volume.evaluate(f"{operation} - ({EXACT[operation]})")
        # Second derivatives are of first order in surface layers: the same part of each is left.
        inside = (slice(n // 6, -n // 6),) * 3
        errors.append(np.sqrt(np.mean(wrong[inside] ** 2)))
    assert np.log2(errors[1] / errors[2]) > 1.8


def test_the_azimuth_goes_round():
    volume = vm.Volume(cylindrical(8))
    volume["f"] = "cos(phi)"
    whole = volume.evaluate("grad(f)")
    turned = vm.Volume(volume.grid, f=np.roll(volume["f"], 3, axis=1)).evaluate("gradmag(f)")
    np.testing.assert_allclose(turned, np.roll(np.sqrt(np.sum(whole**2, 0)), 3, axis=1), atol=1e-13)


def test_a_mirrored_grid_has_the_slopes_of_the_whole():
    r, phi = np.linspace(1, 2, 5), np.linspace(0, 2 * np.pi, 9)
    theta = np.linspace(0.3, np.pi / 2, 7)
    half = vm.Volume(vm.SphericalGrid(r, theta, phi, mirror=True))
    both = vm.Volume(vm.SphericalGrid(r, np.append(theta, np.pi - theta[-2::-1]), phi))
    for volume in (half, both):
        volume["f"] = "x + cos(3*z)"
    for operation in OPERATORS:
        expected = both.evaluate(operation)[:, :6]
        np.testing.assert_allclose(half.evaluate(operation), expected, rtol=1e-11, atol=1e-11)


def random_octree(seed, levels=4):
    rng = np.random.default_rng(seed)
    edges = [np.array([0.0, 1.0, 2.5, 3.0]), np.array([-1.0, 0.0, 1.0]), np.array([0.0, 2.0, 3.0])]
    grid = vm.OctreeGrid(*edges)
    for _ in range(levels):
        grid = grid.refine(rng.random(grid.size) < 0.2)
    return grid


def patches():
    """Return a grid with ratios 2 and 3, overlap, and a hole."""
    lower = [[0, 0, 0], [3, 0, 0], [1, 1, 1], [2, 1, 1]]
    upper = [[2, 4, 4], [4, 4, 4], [2, 2, 3], [2.5, 2, 2]]
    shapes = [[2, 4, 4], [2, 4, 4], [2, 2, 4], [3, 6, 6]]
    return vm.PatchGrid(lower, upper, shapes)


UNEVEN = {
    "octree": lambda: random_octree(0),
    "another": lambda: random_octree(1),
    "deep": lambda: vm.OctreeGrid.from_function(
        [-1.0, 0.0, 1.0],
        [-1.0, 0.0, 1.0],
        [-1.0, 0.0, 1.0],
        lambda x, y, z, s: x + y + z < 3 * s - 3 + 1e-9,
        12,
    ),
    "patches": patches,
}


@pytest.mark.parametrize("kind", UNEVEN)
def test_linear_fields_are_exact_across_jumps_of_level(kind):
    volume = vm.Volume(UNEVEN[kind]())
    volume["f"] = "1 + 2*x - 3*y + 0.5*z"
    gradient = volume.evaluate("grad(f)")
    # Differences between the smallest cells lose digits.
    rounding = 1e-14 * 10 / volume.grid.cell_sizes().min()
    expected = np.array([[2.0], [-3.0], [0.5]]) + 0 * gradient
    np.testing.assert_allclose(gradient, expected, atol=max(1e-12, rounding))


def at_jumps(grid):
    """Return which cells have neighbours on all sides, of which some are of other sizes."""
    slopes = differences(grid, lambda first, last: np.zeros(last - first)).slopes
    _, alone, aside = slopes.looked_at(slopes.part([(0, grid.size)]))
    return np.array(aside & ~alone)


@pytest.mark.parametrize("kind", UNEVEN)
def test_some_cells_are_looked_at_as_all_of_them_are(kind):
    grid = UNEVEN[kind]()
    values = random_fields(grid)
    cells = differences(grid, lambda a, b: values[a:b])
    whole, surface = cells.gradient([(0, grid.size)])
    for runs in ([(7, 30)], [(20, 30), (3, 9), (12, 13)]):
        gradient, alone = cells.gradient(runs)
        some = np.concatenate([np.arange(*run) for run in runs])
        np.testing.assert_array_equal(gradient, whole[:, some])
        np.testing.assert_array_equal(alone, surface[some])


QUADRATIC = "x**2 + 2*y**2 - 5*z**2 + x*y - 3*y*z + 0.5*x*z + x"  # ∇² is -4


@pytest.mark.parametrize("kind", ["octree", "another", "patches"])
def test_laplacians_of_quadratic_fields_are_exact_across_jumps_of_level(kind):
    volume = vm.Volume(UNEVEN[kind]())
    volume["f"] = QUADRATIC
    found = volume.evaluate("laplacian(f)")
    # Base cells are at the surface on both sides, and so are those beside a hole.
    known = volume.grid.levels > 0
    if kind == "patches":
        low, high = volume.grid.corners()
        known &= ((low >= 1) & (high <= 3)).all(axis=0)
    # Rounding of f, over the square of the smallest width.
    rounding = 1e-15 * 50 / volume.grid.cell_sizes().min() ** 2
    np.testing.assert_allclose(found[known], -4, atol=max(1e-10, 10 * rounding))


def best_quadratic(grid, values, cell):
    """Return gradient and Laplacian of what fits the cells at 56 places around a cell best."""
    lattice = np.array([-0.75, -0.25, 0.25, 0.75])
    places = np.stack(np.meshgrid(*[lattice] * 3), axis=-1).reshape(-1, 3)
    places = places[np.abs(places).max(axis=1) > 0.5]
    center, size = grid.cell_centers()[:, cell], grid.cell_sizes()[:, cell]
    low, units = grid.boxes(cell, cell + 1)
    found = grid.tree.find(np.floor(low + units * (0.5 + places.T)).astype(int)).number
    x, y, z = (grid.cell_centers()[:, found] - center[:, None]) / size[:, None]
    terms = [x, y, z, x * x / 2, y * y / 2, z * z / 2, x * y, x * z, y * z]
    weight = 1 / (x * x + y * y + z * z)
    rise = values[found] - values[cell]
    fit, *_ = np.linalg.lstsq(np.transpose(terms * weight), rise * weight, rcond=None)
    return *(fit[:3] / size), np.sum(fit[3:6] / size**2)


@pytest.mark.parametrize("kind", ["octree", "another"])
def test_derivatives_at_jumps_are_those_of_the_best_quadratic_function(kind):
    grid = UNEVEN[kind]()
    volume = vm.Volume(grid, f=random_fields(grid))
    found = np.array([*volume.evaluate("grad(f)"), volume.evaluate("laplacian(f)")])
    at_jump = np.flatnonzero(at_jumps(grid))
    assert len(at_jump) > 30
    best = np.transpose([best_quadratic(grid, volume["f"], cell) for cell in at_jump])
    np.testing.assert_allclose(found[:, at_jump], best, rtol=1e-8, atol=1e-8)


def one_level():
    edges = np.linspace(-1, 1, 9)
    return vm.OctreeGrid(edges, edges, edges)


def tiles():
    """Return a grid of eight patches of one level."""
    corners = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)], float)
    return vm.PatchGrid(corners, corners + 1, [[4, 4, 4]] * 8)


@pytest.mark.parametrize("make", [one_level, tiles])
def test_laplacians_of_quadratic_fields_are_exact_up_to_the_surface(make):
    volume = vm.Volume(make())
    volume["f"] = "x**2 + 2*y**2 + 3*z**2 + x*y"
    np.testing.assert_allclose(volume.evaluate("laplacian(f)"), 12, rtol=1e-11)


R = np.linspace(1, 2, 17)
SYMMETRIC = {
    "radial": lambda refined: vm.SphericalGrid(R, refined=refined),
    "axisymmetric": lambda refined: vm.CylindricalGrid(
        R, np.array([0, 2 * np.pi]), np.linspace(0, 1, 5), refined=refined
    ),
}


@pytest.mark.parametrize("kind", SYMMETRIC)
def test_what_turns_with_an_angle_counts_where_there_is_one_cell_around(kind):
    """∇² r² is 6 and ∇² R² is 4: two thirds (a half) of it along angles that have one cell."""
    count = SYMMETRIC[kind](None).size
    distance, exact = ("r", 6) if kind == "radial" else ("R", 4)
    for refined in (None, [0] * count):
        volume = vm.Volume(SYMMETRIC[kind](refined))
        found = volume.evaluate(f"laplacian({distance}**2)")
        # One-sided gradients at the surface are of first order: half a cell, 1/32 of the radius.
        np.testing.assert_allclose(found, exact, rtol=0.04)
        np.testing.assert_allclose(np.median(found), exact, rtol=2e-3)


def refined_slab(n):
    """Return a smooth field on n³ cells, of which an oblique layer is refined."""
    edges = np.linspace(-1, 1, n + 1)
    grid = vm.OctreeGrid.from_function(
        edges, edges, edges, lambda x, y, z, s: np.abs(x + 0.3 * y) < 0.4, 1
    )
    volume = vm.Volume(grid)
    volume["f"] = "sin(x)*exp(y)*cos(z)"
    return volume


def test_laplacians_on_a_tree_converge_at_jumps_too():
    errors = []
    for n in (8, 16, 32):
        volume = refined_slab(n)
        grid = volume.grid
        wrong = np.abs(volume.evaluate("laplacian(f) + sin(x)*exp(y)*cos(z)"))
        inside = (np.abs(grid.cell_centers()) < 1 - 2.5 / n).all(axis=0)
        errors.append((wrong[inside].max(), np.sqrt(np.mean(wrong[inside] ** 2))))
    largest, mean = np.log2(np.array(errors)[:-1] / np.array(errors)[1:]).T
    # Of first order at jumps, of second elsewhere; the largest moves from place to place.
    assert (largest > 0.5).all()
    assert (mean > 1.3).all()


def test_gradients_on_a_tree_converge():
    errors = []
    for n in (4, 8, 16):
        volume = refined_slab(n)
        grid = volume.grid
        wrong = volume.evaluate("grad(f).x - cos(x)*exp(y)*cos(z)")
        errors.append(np.sqrt(np.average(wrong**2, weights=grid.cell_volumes)))
    # Of second order inside a level; of first at jumps and at the surface, which are a thin layer.
    assert np.log2(errors[1] / errors[2]) > 1.3
