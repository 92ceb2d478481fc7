"""Reference models as directories of RADMC-3D: read bit for bit, and drawn as RADMC-3D does."""

from __future__ import annotations

import numpy as np
import pytest

import reference
import voluminous as vm
from curvilinear_reference import load_spherical
from curvilinear_reference import why_absent as no_spherical
from radmc3d_directory import put_field, put_grid
from radmc3d_models import same
from scenes import camera_of, medium_of
from test_tree_radmc3d import octree


@pytest.mark.parametrize("name", reference.CARTESIAN)
def test_reference_models(tmp_path, name):
    model = reference.load_model(name)
    encoding = "binary" if name == "core" else "text"  # a million numbers
    put_grid(tmp_path, model.edges, encoding=encoding)
    for field, array in model.fields.items():
        flat = array.transpose(2, 1, 0).ravel()
        put_field(tmp_path, field, flat, encoding=encoding)
    volume = vm.open(tmp_path)
    for found, expected in zip(volume.grid.edges, model.edges, strict=True):
        same(found, expected)
    assert set(volume.fields) == set(model.fields)
    for field, array in model.fields.items():
        same(volume.array(field), array)


def image_of(directory, medium, case):
    volume = vm.open(directory, {"n": "gas_density.inp"})
    options = {"scheme": "first-order", "precision": "double", "cutoff": 0}
    image = vm.render(volume, medium, camera_of(case), **options).intensity
    return np.abs(image - case.image).max() / np.abs(case.image).max()


def test_an_octree_is_drawn_as_by_radmc3d(tmp_path):
    model, grid = octree()
    put_grid(tmp_path, model.edges, flags=grid.refined)
    put_field(tmp_path, "gas_density", model.fields["n"])
    volume = vm.open(tmp_path)
    np.testing.assert_array_equal(volume.grid.refined, grid.refined)
    same(volume.array("gas_density"), model.fields["n"])
    assert image_of(tmp_path, medium_of(model), model.cases["first_obl"]) <= 2e-5


@pytest.mark.parametrize("name", ["spher3d", "spher2d"])
def test_a_spherical_model_is_drawn_as_by_radmc3d(tmp_path, name):
    if reason := no_spherical():
        pytest.skip(reason)
    found = load_spherical(name)
    edges, density = found.grid.edges, found.model.fields["n"]
    active = (1, 1, int(len(edges[2]) > 2))
    put_grid(tmp_path, edges, coordinates=100, active=active)
    put_field(tmp_path, "gas_density", density.transpose(2, 1, 0).ravel())
    volume = vm.open(tmp_path)
    for mine, theirs in zip(volume.grid.edges, edges, strict=True):
        same(mine, np.asarray(theirs))
    same(volume.array("gas_density"), density)
    case = next(c for c in found.cases.values() if (c.order, c.quantity) == (1, "intensity"))
    assert image_of(tmp_path, medium_of(found.model), case) <= 2e-5
