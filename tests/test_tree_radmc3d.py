"""Against images of the real RADMC-3D on an octree, and against the twin: refined grids."""

from __future__ import annotations

import functools

import numpy as np
import pytest

import voluminous as vm
from reference import data_directory, model_of, stored_in
from scenes import camera_of, medium_of
from test_octree import random_octree
from test_patches import random_patches, tiles
from twin.boxes import Boxes, render_boxes
from twin.camera import Camera

SCHEMES = {1: "first-order", 2: "olson-kunasz"}


@functools.cache
def octree():
    """Return the octree model and its grid; skip the calling test if the data is absent."""
    path = data_directory() / "radmc3d" / "octree_0.npz"
    if not path.is_file():
        pytest.skip(f"no {path}; set VOLUMINOUS_TEST_DATA")
    stored, meta = stored_in(path)
    model = model_of(stored, meta, {"n": stored["n"].astype(np.float64)})
    return model, vm.OctreeGrid(*model.edges, stored["octree_bits"], unit="cm")


def difference(found, expected):
    """Return the largest difference over the maximum."""
    return np.abs(found - expected).max() / np.abs(expected).max()


CASES = [f"{order}_{view}" for order in ("first", "second") for view in ("z", "obl", "obl2")]
CASES += ["first_fluxcons", "second_fluxcons", "first_tau", "second_tau", "local_proj1"]


@pytest.mark.parametrize("case_id", CASES)
def test_octree_is_radmc3d(case_id):
    model, grid = octree()
    case = model.cases[case_id]
    image = vm.render(
        vm.Volume(grid, n=model.fields["n"]),
        medium_of(model),
        camera_of(case),
        scheme=SCHEMES[case.order],
        precision="double",
        cutoff=0,
        antialias="radmc3d" if case.camera["fluxcons"] else None,
    )
    found = image.optical_depth if case.quantity == "tau" else image.intensity
    # For τ <= 1e-4 RADMC-3D takes 1 - exp(-τ) = τ in first order.
    tolerance = 1e-12 if case.quantity == "tau" else {1: 2e-5, 2: 1e-9}[case.order]
    assert difference(found, case.image) <= tolerance


CUBES = np.array([[0, 0, 0], [2, 0, 0], [3, 0, 0], [2, 1, 0.0]])
UNEVEN = ([-1.0, -0.3, 0.1, 0.8], [0.0, 0.5, 0.75, 2.0], [-1.0, -0.9, 1.0])
LAYERS = [[0, 1, 2, 1, 2, 2, 2], [1, 1, 1, 1, 2, 3, 2], [2, 2, 2, 2, 1, 2, 1]]


def hanging():
    """Return three base cells, one of them four levels deep at its wall and in a corner."""
    grid = vm.OctreeGrid([0, 1, 2, 3], [0, 1], [0, 1])
    for point in ([1.99, 0.4, 0.6], [1.01, 0.01, 0.01]) * 4:
        grid = grid.refine(np.arange(grid.size) == grid.locate(np.array([point])))
    return grid


GRIDS = {
    "octree": lambda: random_octree(1, 3, 0.25),
    "rectilinear": lambda: random_octree(2, 3, 0.2, UNEVEN),
    "jumps of several levels": hanging,
    "layers": lambda: vm.PatchGrid.from_layers(*[np.linspace(-1, 1, 5)] * 3, LAYERS),
    "ratio 3": lambda: random_patches(2, 3, 2, 5, [np.arange(4.0)] * 3),
    "anisotropic": lambda: random_patches(3, [2, 1, 4], 2, 4, [np.arange(4.0)] * 3),
    "tiles": lambda: tiles(1, 2, 2),
    "holes": lambda: vm.PatchGrid(CUBES, CUBES + 1, [[2, 2, 2], [4, 4, 4], [4, 4, 4], [2, 2, 2]]),
}


@functools.cache
def grid_named(name):
    return GRIDS[name]()


def views(grid, count=12):
    """Return twin cameras at infinity and inside of a grid."""
    low, high = grid.bounds.T
    middle, half = 0.5 * (low + high), 0.55 * float(np.linalg.norm(high - low))
    inside = low + np.array([0.43, 0.37, 0.61]) * (high - low)
    size = {"nx": count, "ny": count, "half_size": (half, half), "point": tuple(middle)}
    return {
        "oblique": Camera(**size, incl=57.3, phi=33.0, posang=20.0),
        "from below": Camera(**size, incl=131.0, phi=-77.0),
        "inside": Camera(count, count, (0.6, 0.6), point=tuple(middle), observer=tuple(inside)),
    }


def vm_camera(camera):
    """Return the package's camera for the twin's."""
    width, pixels = [2 * half for half in camera.half_size], (camera.nx, camera.ny)
    if camera.observer is not None:
        return vm.Perspective(camera.observer, camera.point, width=width, resolution=pixels)
    angles = camera.incl, camera.phi, camera.posang
    return vm.Orthographic(*angles, width=width, resolution=pixels, center=camera.point)


def compare(grid, camera, precisions=("double", "single")):
    """Assert that a picture of random coefficients is the twin's, in every scheme."""
    boxes = Boxes(*(corner.T for corner in grid.corners()), grid.levels)
    j, alpha = np.random.default_rng(5).random((2, grid.size, 2))
    volume = vm.Volume(grid, j0=j[:, 0], j1=j[:, 1], a0=alpha[:, 0], a1=alpha[:, 1])
    medium = vm.Coefficients(["j0", "j1"], ["a0", "a1"])
    for scheme in ("first-order", "second-order", "olson-kunasz"):
        expected = render_boxes(boxes, j, alpha, camera, scheme)
        for precision in precisions:
            options = {"scheme": scheme, "precision": precision, "cutoff": 0}
            image = vm.render(volume, medium, vm_camera(camera), **options)
            # τ - (1 - exp(-τ)) by subtraction is RADMC-3D's rule, in both.
            exact = 1e-9 if scheme == "olson-kunasz" else 1e-12
            slack = 1e-4 if precision == "single" else exact
            assert difference(image.intensity, expected[0]) <= slack
            assert difference(image.optical_depth, expected[1]) <= max(slack, 1e-12)


@pytest.mark.each_value_once
@pytest.mark.parametrize("view", ["oblique", "from below", "inside"])
@pytest.mark.parametrize("name", GRIDS)
def test_refined_grids_are_the_twin(name, view):
    grid = grid_named(name)
    compare(grid, views(grid)[view])
