"""Everything around grids, on one that is not Cartesian: the same as on the one it is made of."""

from __future__ import annotations

import numpy as np
import pytest
from astropy import units as u

import voluminous as vm
from toy_grids import LinearCells, ShuffledGrid

EDGES = ([0.0, 1.0, 3.0, 3.5], [-1.0, 0.0, 1.0, 2.0, 2.5], [-1.0, 0.0, 1.0, 2.0, 4.0, 5.0])
GRID = vm.CartesianGrid(*EDGES, unit="pc")
FLAT = ShuffledGrid(GRID)
VALUES = np.random.default_rng(5).random(GRID.shape)
CAMERA = vm.Orthographic(60, 30, resolution=24)


def both(**fields):
    """Return volumes of the same fields on both grids."""
    flat = {
        name: FLAT.shuffled(f) * getattr(f, "unit", 1) if hasattr(f, "unit") else FLAT.shuffled(f)
        for name, f in fields.items()
    }
    return vm.Volume(GRID, fields), vm.Volume(FLAT, flat)


@pytest.mark.parametrize("text", ["log10(a)", "a * x", "y + 10 * z", "a / r", "3", "a > 0.5"])
def test_expressions_are_evaluated_cell_by_cell(text):
    original, flat = both(a=VALUES)
    np.testing.assert_array_equal(flat.evaluate(text), FLAT.shuffled(original.evaluate(text)))
    assert flat.evaluate(text).shape == FLAT.shape


@pytest.mark.parametrize("precision", ["single"])
@pytest.mark.parametrize("scheme", ["first-order", "second-order", "olson-kunasz"])
@pytest.mark.parametrize("emission", ["a", "a * x + r"])
def test_pictures_are_the_same(scheme, emission, precision):
    medium = vm.Coefficients(emission, "2 * a")
    images = [
        vm.render(volume, medium, CAMERA, scheme=scheme, precision=precision)
        for volume in both(a=VALUES)
    ]
    # Table and walk are the original's, only cells have other numbers: the same arithmetic; but
    # coordinates are squared by NumPy, where a kernel fuses a multiplication and an addition.
    # Olson-Kunasz in double precision walks the original as RADMC-3D does, the other grid exactly.
    exact = 1e-6 if precision == "single" else 1e-12
    np.testing.assert_allclose(images[1].intensity, images[0].intensity, rtol=exact)


def test_pictures_on_the_ray_are_the_same_as_from_a_table(monkeypatch):
    _, flat = both(a=VALUES)
    medium = vm.Coefficients("a * x + r", "2 * a")
    from_table = vm.render(flat, medium, CAMERA, scheme="first-order")
    flat.tables.clear()
    monkeypatch.setattr("voluminous.rendering.sources.table.fits", lambda needed: False)
    on_ray = vm.render(flat, medium, CAMERA, scheme="first-order")
    np.testing.assert_array_equal(on_ray.intensity, from_table.intensity)
    assert np.any(on_ray.intensity)


def test_a_scheme_that_the_grid_has_no_walk_for_is_refused():
    _, flat = both(a=VALUES)
    with pytest.raises(vm.InputError, match=r"ShuffledGrid; use scheme='first-order'"):
        vm.render(flat, vm.Coefficients("a", "a"), CAMERA)


@pytest.mark.parametrize("parts", [[1 * u.K, 1000], [1, 1000 * u.mK], [1 * u.K, 1000 * u.cm]])
def test_parts_of_a_field_all_have_units_or_none(parts):
    grid = vm.PatchGrid([[0, 0, 0], [2, 0, 0]], [[2, 2, 2], [4, 2, 2]], [[2, 2, 2], [2, 2, 2]])
    field = [np.ones((2, 2, 2)) * part for part in parts]
    with pytest.raises(vm.UnitsError, match="part"):
        vm.Volume(grid, a=field)


PLACES = {
    "cartesian": vm.CartesianGrid([0, 1, 2], [0, 1, 2], [0, 1, 2], unit="pc"),
    "octree": vm.OctreeGrid([0, 1, 2], [0, 1, 2], [0, 1, 2], [1, *15 * [0]], unit="pc"),
    "patches": vm.PatchGrid([[0, 0, 0]], [[2, 2, 2]], [[2, 2, 2]], unit="pc"),
    "spherical": vm.SphericalGrid([0, 1, 2], [0, 1, 2], unit="pc"),
    "cylindrical": vm.CylindricalGrid([0, 1, 2], [0, 2, 4], [0, 1, 2], unit="pc"),
    "refined": vm.SphericalGrid([0, 1, 2], refined=[1, 0, 0, 0], unit="pc"),
}


@pytest.mark.parametrize("name", PLACES)
def test_points_may_have_a_unit(name):
    grid, points = PLACES[name], [[1.5, 0.5, 0.5], [0.1, 0.2, 0.3], [9.0, 0.0, 0.0]]
    cells = grid.locate(points)
    assert (cells[:2] >= 0).all()
    assert cells[2] == -1
    for unit in (u.pc, u.kpc, u.km):
        np.testing.assert_array_equal(grid.locate((points * u.pc).to(unit)), cells)
    with pytest.raises(vm.UnitsError, match="points is in K, expected pc"):
        grid.locate(points * u.K)


@pytest.mark.parametrize("precision", ["single"])
def test_an_octree_shows_the_grid_that_it_refines(precision):
    edges = np.linspace(-1, 1, 5)
    tree = vm.OctreeGrid.from_function(
        edges, edges, edges, lambda x, y, z, s: x * x + y * y + z * z < 0.5, 2
    )
    fine = vm.CartesianGrid.uniform(16, (-1, 1))
    leaves = vm.Volume(tree, a=np.random.default_rng(0).random(tree.shape))
    cells = vm.Volume(fine, a=leaves["a"][tree.locate(fine.cell_centers().T)].reshape(fine.shape))
    medium = vm.Coefficients("a", "2 * a")
    expected, found = (
        vm.render(v, medium, CAMERA, scheme="first-order", precision=precision)
        for v in (cells, leaves)
    )
    # Rays are cut into other segments, of the same coefficients: rounding, and rays in single
    # precision that graze a wall on its other side.
    exact = 2e-5 if precision == "single" else 1e-12
    np.testing.assert_allclose(found.intensity, expected.intensity, atol=exact)
    assert found.intensity.max() > 0.3


@pytest.mark.parametrize("scheme", ["post-classified", "pre-integrated"])
def test_fields_that_jump_between_cells_are_not_carried_over(scheme):
    grid = LinearCells(*EDGES, np.array([1, 0, 0, 0, 0, 0, 0, 0, 0] + 59 * [0]))
    values = np.random.default_rng(2).random(grid.size)
    volume, medium = vm.Volume(grid, a=values), vm.Gaussian("a", 0.5, 0.2, "red", 0.5, 1.0)
    camera, options = vm.Orthographic(90, 90, resolution=24), {"precision": "double"}
    expected = vm.render(volume, medium, camera, scheme="first-order", **options)
    image = vm.render(volume, medium, camera, scheme=scheme, **options)
    np.testing.assert_allclose(image.intensity, expected.intensity, rtol=2e-3)
    # Values are kept between the field's extremes: cells that have these do not slope.
    grid.rise = 0.5 * np.minimum(values - values.min(), values.max() - values)
    emission = vm.Coefficients("a", "0")
    sloping = vm.render(vm.Volume(grid, a=values), emission, camera, scheme=scheme, **options)
    flat = vm.render(volume, emission, camera, scheme="first-order", **options)
    np.testing.assert_allclose(sloping.intensity, flat.intensity, rtol=1e-6)  # along x: the mean
