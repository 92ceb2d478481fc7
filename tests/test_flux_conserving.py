"""Flux conservation where cells differ in size: pixels are divided as their rays ask for."""

from __future__ import annotations

import numpy as np
import pytest

import voluminous as vm
from curvilinear_reference import load_spherical, why_absent
from scenes import camera_of, medium_of
from test_octree import random_octree

INSIDE = vm.Perspective((0.31, -0.2, 0.13), (1.2, 0.4, 0.3), width=1.4, resolution=4)
WIDE = vm.Gaussian("a", 0.6, 0.3, [1.0, 0.5], 2.0, 1.0)


def noise():
    """Return a volume of a random field, rough from cell to cell."""
    grid = random_octree(1, 3, 0.3, [np.linspace(-1, 1, 5)] * 3)
    return vm.Volume(grid, a=10 ** np.random.default_rng(3).uniform(-0.5, 0.5, grid.size))


def test_pixels_are_divided_where_cells_are_small():
    """Three pixels: beside the grid, over two base cells of which one is refined, and beside it."""
    grid = vm.OctreeGrid([0, 1, 2], [0, 1], [0, 1], [0, 1, *8 * [0]])
    volume = vm.Volume(grid, a=np.random.default_rng(1).random(grid.size))
    camera = vm.Orthographic(width=(6, 2), resolution=(3, 1), center=(1, 0.5, 0.5))
    options = {"scheme": "first-order", "precision": "double"}
    medium = vm.Coefficients("a", "a")
    image = vm.render(volume, medium, camera, antialias="radmc3d", **options)
    # Two wide, it is quartered for cells one wide, and again where a quarter's ray meets halves.
    assert image.intensity[0, 0] == image.intensity[0, 2] == 0
    fine, coarse = (
        vm.Orthographic(width=(2, 2), resolution=n, center=(1, 0.5, 0.5)) for n in (4, 2)
    )
    fine, coarse = (
        vm.render(volume, medium, c, **options).intensity[..., 0] for c in (fine, coarse)
    )
    expected = 0.5 * coarse[:, 0].mean() + 0.5 * fine[:, 2:].mean()
    np.testing.assert_allclose(image.intensity[0, 1, 0], expected, rtol=1e-12)


@pytest.mark.parametrize("scheme", ["first-order", "post-classified"])
def test_flux_conservation_is_the_mean_over_pixels(scheme):
    volume, medium = noise(), WIDE
    coarse, fine = (
        vm.Orthographic(57, 33, 20, width=3.2, resolution=n, center=(0, 0, 0)) for n in (6, 192)
    )
    options = {"scheme": scheme, "precision": "double"}
    image = vm.render(volume, medium, coarse, antialias="radmc3d", background=0.3, **options)
    exact = vm.render(volume, medium, fine, background=0.3, **options)
    for name in ("intensity", "transparency", "optical_depth"):
        mean = getattr(exact, name).reshape(6, 32, 6, 32, -1).mean(axis=(1, 3))
        assert np.abs(getattr(image, name) - mean).max() <= 0.05 * mean.max()


@pytest.mark.parametrize("scheme", ["first-order", "post-classified"])
def test_progress_is_told_by_the_area_that_is_done(scheme):
    camera, reports = vm.Orthographic(57, 33, width=3.2, resolution=6, center=(0, 0, 0)), []
    options = {"scheme": scheme, "antialias": "radmc3d"}
    vm.render(noise(), WIDE, camera, progress=lambda *told: reports.append(told), **options)
    fractions = [done / total for done, total in reports]
    assert fractions == sorted(fractions)
    assert reports[-1] == (36, 36)


def test_flux_conservation_needs_parallel_rays_and_pixels_that_are_not_huge():
    volume, medium = noise(), WIDE
    even = vm.Volume(vm.CartesianGrid.uniform(4, (-1, 1)), a=np.ones((4, 4, 4)))
    for each in (volume, even):  # angles are not compared with widths, in no unit of length
        with pytest.raises(vm.InputError, match="parallel rays"):
            vm.render(each, medium, INSIDE, antialias="radmc3d")
    huge = vm.Orthographic(width=1e5, resolution=1, center=(0, 0, 0))
    with pytest.raises(vm.InputError, match="needs more than 4096 x 4096 rays for a pixel"):
        vm.render(volume, medium, huge, antialias="radmc3d", scheme="first-order")


@pytest.mark.parametrize("case_id", ["first_fluxcons", "second_fluxcons"])
@pytest.mark.parametrize("name", ["spher3d", "spher2d"])
def test_flux_conservation_on_spherical_grids_is_radmc3d(name, case_id):
    if reason := why_absent():
        pytest.skip(reason)
    model = load_spherical(name)
    case = model.cases[case_id]
    image = vm.render(
        vm.Volume(model.grid, n=model.model.fields["n"]),
        medium_of(model.model),
        camera_of(case),
        scheme={1: "first-order", 2: "olson-kunasz"}[case.order],
        precision="double",
        cutoff=0,
        antialias="radmc3d",
    )
    # For τ <= 1e-4 RADMC-3D takes 1 - exp(-τ) = τ in first order.
    off = np.abs(image.intensity - case.image).max() / case.image.max()
    assert off <= {1: 2e-5, 2: 2e-9}[case.order]


@pytest.mark.parametrize(("scheme", "mirror"), [("first-order", True), ("second-order", False)])
def test_flux_conservation_on_a_refined_sphere_is_that_of_the_finer_one(scheme, mirror):
    theta = np.linspace(0.4, np.pi / 2 if mirror else 2.6, 4)
    walls = [1, 2, 5], theta, np.linspace(0, 2 * np.pi, 5)
    refined = vm.SphericalGrid(*walls, refined=[1, *8 * [0]] * 24, mirror=mirror)
    finer = vm.SphericalGrid(*refined.fine_edges, mirror=mirror)
    values = np.random.default_rng(4).random(finer.shape)
    leaves = values.ravel()[finer.locate(refined.cell_centers().T)]
    camera = vm.Orthographic(60, 30, width=11, resolution=5, center=(0, 0, 0))
    options = {"scheme": scheme, "antialias": "radmc3d", "precision": "double"}
    images = [
        vm.render(volume, WIDE, camera, **options).intensity
        for volume in (vm.Volume(finer, a=values), vm.Volume(refined, a=leaves))
    ]
    np.testing.assert_allclose(images[1], images[0], rtol=1e-11)


@pytest.mark.parametrize("refined", [None, 6 * [1, *8 * [0]]])
def test_pixels_are_divided_for_the_cells_of_cylinders(refined):
    """Cells as high as pixels are wide, or half as high: one ray a pixel, or two by two."""
    grid = vm.CylindricalGrid([8, 12], np.linspace(0, 2 * np.pi, 7), [0.0, 1.0], refined=refined)
    volume = vm.Volume(grid, a=np.random.default_rng(1).random(grid.shape))
    camera = vm.Orthographic(70, 20, width=30, resolution=30, center=(0, 0, 0))
    options = {"scheme": "first-order", "precision": "double"}
    image, expected = (
        vm.render(volume, WIDE, camera, **rays, **options).intensity
        for rays in ({"antialias": "radmc3d"}, {"samples": 1 if refined is None else 2})
    )
    np.testing.assert_allclose(image, expected, rtol=1e-12)
    assert np.mean(expected > 0) > 0.1


def test_flux_conservation_on_cylinders_keeps_the_sum():
    grid = vm.CylindricalGrid(np.linspace(1, 3, 9), np.linspace(0, 2 * np.pi, 25), [-0.5, 0, 0.5])
    volume = vm.Volume(grid, a=np.random.default_rng(1).random(grid.shape))
    camera = vm.Orthographic(60, 30, width=6.4, resolution=16, center=(0, 0, 0))
    options = {"scheme": "first-order", "precision": "double"}
    image = vm.render(volume, vm.Coefficients("a", "0"), camera, antialias="radmc3d", **options)
    total = image.intensity.sum() * (6.4 / 16) ** 2
    # Rays are a fraction of a cell apart: a hundred thousand of them, and cells' edges.
    assert total == pytest.approx(np.sum(volume["a"] * grid.cell_volumes), rel=2e-3)
