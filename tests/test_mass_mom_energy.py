"""Mass, momentum and energy as optical depths, against images of RADMC-3D and sums over cells.

One ray per pixel is good to a few 1e-4 here, in RADMC-3D and in ours; exact columns lose nothing.
"""

from __future__ import annotations

import numpy as np
import pytest

import reference
import scenes
import voluminous as vm

QUANTITIES = {"mass": "rho", "momentum": "rho * abs(v)", "energy": "0.5 * rho * v * v"}


@pytest.fixture(scope="module")
def model():
    return reference.load_model("mass_mom_energy")


@pytest.fixture(scope="module")
def gas(model):
    return vm.Volume(vm.CartesianGrid(*model.edges, unit="cm"), model.fields)


@pytest.fixture(scope="module")
def cells(model, gas):
    """The sums over cells, in the order of QUANTITIES."""
    return np.einsum("xyzc,xyz->c", model.alpha, gas.grid.cell_volumes)


def columns(gas, camera, **options):
    """Return all maps, shape (ny, nx, quantity)."""
    images = [vm.column(gas, q, camera, **options) for q in QUANTITIES.values()]
    return np.concatenate([image.intensity for image in images], axis=2)


def off(maps, camera, gas, cells):
    """Return how far totals of maps are from those of the cells, relatively."""
    area = np.prod(camera.frame(gas.grid).pixel)
    return np.abs(maps.sum(axis=(0, 1)) * area / cells - 1)


def test_columns_along_rays_are_optical_depths_of_radmc3d(model, gas, cells):
    case = model.cases["first"]
    camera = scenes.camera_of(case)
    found = columns(gas, camera, precision="double")
    np.testing.assert_allclose(found, case.image, rtol=0, atol=1e-12 * case.image.max())
    # So the totals are as good as one ray per pixel is, and no better.
    own, theirs = (off(maps, camera, gas, cells) for maps in (found, case.image))
    np.testing.assert_allclose(own, theirs, atol=1e-12)
    assert np.all((own > 1e-5) & (own < 1e-3))


def test_more_rays_find_more_of_it(model, gas, cells):
    camera = scenes.camera_of(model.cases["first"])
    found = columns(gas, camera, precision="double", samples=8)
    # With a pixel an eighth as wide the error of 7e-4 falls 64-fold, and by more, as errors of
    # pixels average out.
    assert off(found, camera, gas, cells).max() < 1e-5


@pytest.mark.parametrize("case_id", ["first", "first_fluxcons"])
def test_exact_columns_lose_nothing(model, gas, cells, case_id):
    camera = scenes.camera_of(model.cases[case_id])  # 90 pixels and 30, for 24 cells
    assert off(columns(gas, camera, method="exact"), camera, gas, cells).max() < 1e-12


def test_measured_totals_are_those_of_the_cells(model, gas, cells):
    camera = scenes.camera_of(model.cases["first"])
    found = vm.measure(gas, QUANTITIES, camera=camera, maps=True)
    np.testing.assert_allclose([found[name].value for name in QUANTITIES], cells, rtol=1e-12)
    for k, name in enumerate(QUANTITIES):
        expected = columns(gas, camera, method="exact")[..., k]
        np.testing.assert_allclose(found.maps[name].intensity[..., 0], expected, rtol=1e-12)


@pytest.mark.parametrize(("method", "tolerance"), [("rays", 2e-3), ("exact", 1e-14)])
def test_momentum_has_a_sign(model, gas, cells, method, tolerance):
    # All but 0.7 % of it cancels, so errors are to be compared with the sum of |ρ v|.
    camera = scenes.camera_of(model.cases["first"])
    image = vm.column(gas, "rho * v", camera, method=method, precision="double")
    direct = float((model.fields["rho"] * model.fields["v"] * gas.grid.cell_volumes).sum())
    assert image.intensity.min() < 0 < image.intensity.max()
    total = float(image.intensity.sum()) * image.pixel_area
    assert total == pytest.approx(direct, abs=tolerance * cells[1])
