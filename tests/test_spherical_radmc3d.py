"""Against images of the real RADMC-3D, and against the twin: spherical grids."""

from __future__ import annotations

import numpy as np
import pytest

import voluminous as vm
from curvilinear_reference import load_spherical, spherical_cases
from scenes import camera_of, medium_of
from twin.camera import Camera
from twin.curvilinear import Frame
from twin.curvilinear_render import render_curvilinear
from voluminous.radmc3d.olson_kunasz import OlsonKunasz
from voluminous.schemes.base import Steps

WITHOUT_SUB_STEPS = "second_obl_nomaxdphi"  # camera_maxdphi = 0


def render(model, grid, case, scheme, **options):
    """Return what corresponds to a reference image."""
    image = vm.render(
        vm.Volume(grid, n=model.model.fields["n"]),
        medium_of(model.model),
        camera_of(case),
        scheme=scheme,
        **{"precision": "double", "cutoff": 0, **options},
    )
    return image.optical_depth if case.quantity == "tau" else image.intensity


def difference(found, expected):
    """Return the largest difference over the maximum."""
    return np.abs(found - expected).max() / np.abs(expected).max()


@pytest.mark.parametrize(("name", "case_id"), spherical_cases(lambda case: case.order == 1))
def test_first_order_is_radmc3d(name, case_id):
    model = load_spherical(name)
    case = model.cases[case_id]
    # For τ <= 1e-4 RADMC-3D takes 1 - exp(-τ) = τ; it pushes rays on by 5e-12 of the radius.
    tolerance = 1e-9 if case.quantity == "tau" else 2e-5
    assert difference(render(model, model.grid, case, "first-order"), case.image) <= tolerance


@pytest.mark.parametrize(("name", "case_id"), spherical_cases(lambda case: case.order == 2))
def test_olson_kunasz_is_radmc3d(name, case_id, monkeypatch):
    model = load_spherical(name)
    case = model.cases[case_id]
    grid = vm.SphericalGrid(*model.grid.edges, unit="cm")
    if case_id == WITHOUT_SUB_STEPS:
        monkeypatch.setattr(OlsonKunasz, "steps", lambda *_: Steps("cells"))
    assert difference(render(model, grid, case, "olson-kunasz"), case.image) <= 2e-9


PI = np.pi
GRIDS = {
    "mirrored": vm.SphericalGrid(
        np.geomspace(1, 10, 9), np.linspace(0.5, PI / 2, 6), np.linspace(0, 2 * PI, 9), mirror=True
    ),
    "wedge": vm.SphericalGrid(
        np.geomspace(1, 10, 9), np.linspace(0, PI, 7), np.linspace(0.3, 4.9, 8)
    ),
    "narrow wedge": vm.SphericalGrid([0, 3, 6, 10], [0.2, 1, 2, 2.5], np.linspace(0.3, 2, 5)),
    "radial": vm.SphericalGrid(np.geomspace(1, 10, 9)),
    "cylinder": vm.CylindricalGrid(
        np.geomspace(1, 10, 9), np.linspace(0.3, 4.9, 8), np.linspace(-6, 7, 6)
    ),
}
CAMERAS = {
    "oblique": Camera(24, 24, (11.0, 11.0), incl=57.3, phi=33.0, posang=20.0),
    "from below": Camera(24, 24, (11.0, 11.0), incl=131.0, phi=-77.0),
    "along the axis": Camera(24, 24, (11.0, 11.0), phi=7.0),
    "edge-on": Camera(24, 24, (11.0, 11.0), incl=90.0, phi=10.0),
    "inside": Camera(24, 24, (0.6, 0.6), observer=(3.0, -1.0, 2.0), point=(0.0, 2.0, 0.5)),
    "in the cavity": Camera(24, 24, (0.6, 0.6), observer=(0.1, -0.2, 0.1), point=(3.0, 2.0, 1.0)),
}


def medium_with(grid):
    """Return a volume of random coefficients, and their values (n1, n2, n3, 1)."""
    j, a = np.random.default_rng(2).random((2, *grid.shape))
    return vm.Volume(grid, j=j, a=0.2 * a), j[..., None], 0.2 * a[..., None]


def vm_camera(camera):
    """Return the package's camera for the twin's."""
    width = [2 * half for half in camera.half_size]
    if camera.observer is None:
        return vm.Orthographic(
            camera.incl,
            camera.phi,
            camera.posang,
            width=width,
            resolution=(camera.nx, camera.ny),
            center=(0, 0, 0),
        )
    return vm.Perspective(
        camera.observer, camera.point, width=width, resolution=(camera.nx, camera.ny)
    )


@pytest.mark.parametrize("view", CAMERAS)
@pytest.mark.parametrize("name", GRIDS)
def test_first_order_is_the_twin_to_rounding(name, view):
    grid, camera = GRIDS[name], CAMERAS[view]
    volume, j, a = medium_with(grid)
    expected = render_curvilinear(Frame.of(grid), j, a, camera, "first-order")
    found = vm.render(
        volume,
        vm.Coefficients("j", "a"),
        vm_camera(camera),
        scheme="first-order",
        precision="double",
        cutoff=0,
    )
    assert difference(found.intensity, expected["intensity"]) < 1e-12
    assert difference(found.optical_depth, expected["optical_depth"]) < 1e-12


@pytest.mark.parametrize("view", ["oblique", "from below", "along the axis"])
@pytest.mark.parametrize("name", ["mirrored", "wedge", "narrow wedge", "radial"])
def test_olson_kunasz_is_the_twin(name, view):
    grid, camera = GRIDS[name], CAMERAS[view]
    volume, j, a = medium_with(grid)
    expected = render_curvilinear(Frame.of(grid), j, a, camera, "olson-kunasz", largest_turn=0.1)
    found = vm.render(
        volume,
        vm.Coefficients("j", "a"),
        vm_camera(camera),
        scheme="olson-kunasz",
        precision="double",
        cutoff=0,
    )
    assert difference(found.intensity, expected["intensity"]) < 1e-11
