"""Fields interpolated between the centres of curvilinear cells, classified along rays."""

from __future__ import annotations

import numpy as np
import pytest

import voluminous as vm

PI = np.pi
RADII = np.linspace(1.0, 3.0, 21)
THETA, PHI = np.linspace(0, PI, 17), np.linspace(0, 2 * PI, 25)
GRIDS = {
    "full": vm.SphericalGrid(RADII, THETA, PHI),
    "ball": vm.SphericalGrid(np.linspace(0, 3, 21), THETA, PHI),
    "wedge": vm.SphericalGrid(RADII, np.linspace(0.5, 2.4, 15), np.linspace(0.3, 4.5, 21)),
    "mirrored": vm.SphericalGrid(RADII, np.linspace(0, PI / 2, 12), PHI, mirror=True),
    "axisymmetric": vm.SphericalGrid(RADII, THETA),
    "radial": vm.SphericalGrid(RADII),
    "cylinder": vm.CylindricalGrid(RADII, PHI, np.linspace(-2, 2, 20)),
    "round cylinder": vm.CylindricalGrid(
        np.linspace(0, 3, 21), [0, 2 * PI], np.linspace(-2, 2, 20)
    ),
}
CAMERAS = {
    "oblique": vm.Orthographic(57, 33, width=6.4, resolution=40, center=(0, 0, 0)),
    "along the axis": vm.Orthographic(0, 7, width=6.4, resolution=40, center=(0, 0, 0)),
    "edge-on": vm.Orthographic(90, 0, width=6.4, resolution=40, center=(0, 0, 0)),
    "inside": vm.Perspective((1.9, 0.3, 0.4), (-1, 0.5, 0), width=0.9, resolution=30),
    "in the hole": vm.Perspective((0.1, 0.2, 0.1), (2, 1, 0.4), width=0.9, resolution=30),
}


def drawn(grid, medium, view, **options):
    """Return a picture of a medium of coordinates alone, or of fields."""
    options = {"precision": "double", "cutoff": 0, "tolerance": 1e-5, **options}
    return vm.render(grid, medium, CAMERAS[view], **options)


def volume_of(grid, expression):
    """Return a volume with a field of the coordinates."""
    volume = vm.Volume(grid)
    volume["f"] = expression
    return volume


@pytest.mark.parametrize("view", CAMERAS)
@pytest.mark.parametrize("name", GRIDS)
def test_a_constant_field_is_what_the_rays_cross(name, view):
    """Columns of one are chords: first order finds the same, by another walk."""
    volume = volume_of(GRIDS[name], "1 + 0*x")
    medium = vm.Coefficients("f", "0*f")
    columns = [
        drawn(volume, medium, view, scheme=s).intensity for s in ("post-classified", "first-order")
    ]
    np.testing.assert_allclose(*columns, rtol=0, atol=1e-9 * columns[1].max())


@pytest.mark.parametrize("view", ["oblique", "edge-on", "inside", "in the hole"])
@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("full", "0.7*r"),
        ("wedge", "1 + theta"),
        ("wedge", "phi"),
        ("mirrored", "theta"),
        ("axisymmetric", "r + theta"),
        ("cylinder", "2*R + z"),
        ("cylinder", "R"),
    ],
)
def test_what_is_linear_in_the_grids_coordinates_is_exact_between_centres(name, text, view):
    """A shell of the field, against the same shell of the coordinates themselves."""
    volume = volume_of(GRIDS[name], text)
    middle = float(np.median(volume.array("f")))
    width = 0.1 * float(np.ptp(volume.array("f")))
    shells = [vm.Gaussian(x, middle, width, [1.0], 0.3, 0.5) for x in ("f", text)]
    field, exact = (drawn(volume, shell, view).intensity for shell in shells)
    # Fields are constant beyond the outermost centres, coordinates are not: half a cell of a tail.
    # A cubic stands for sines and square roots of the distance.
    off = np.abs(field - exact) / exact.max()
    assert np.quantile(off, 0.9) < 5e-3
    assert off.max() < 0.1


@pytest.mark.parametrize("name", ["full", "cylinder"])
def test_second_order_in_the_cells_size(name):
    medium = vm.Gaussian("f", 0.5, 0.2, [1.0], 0.4, 0.5)
    text = "exp(-(x-0.5)**2 - y**2/2 - (z-0.2)**2)"
    errors = []
    for n in (1, 2):
        radii = np.linspace(0.7, 3.0, 16 * n + 1)
        grid = (
            vm.SphericalGrid(
                radii, np.linspace(0, PI, 16 * n + 1), np.linspace(0, 2 * PI, 24 * n + 1)
            )
            if name == "full"
            else vm.CylindricalGrid(
                radii, np.linspace(0, 2 * PI, 24 * n + 1), np.linspace(-2.5, 2.5, 20 * n + 1)
            )
        )
        volume = volume_of(grid, text)
        exact = vm.Gaussian(text, 0.5, 0.2, [1.0], 0.4, 0.5)
        pair = [drawn(volume, m, "oblique").intensity for m in (medium, exact)]
        errors.append(np.sqrt(np.mean((pair[0] - pair[1]) ** 2)))
    assert np.log2(errors[0] / errors[1]) > 1.75  # 2 in the limit; the axis is less smooth


@pytest.mark.parametrize("name", ["full", "mirrored", "cylinder"])
def test_azimuth_goes_round(name):
    """Turning field and camera together by whole cells changes nothing: there is no seam."""
    grid = GRIDS[name]
    axis = grid.coordinates.index("phi")
    values = np.random.default_rng(1).uniform(size=grid.shape)
    turned = np.roll(values, 7, axis)
    medium = vm.Gaussian("f", 0.5, 0.1, [1.0], 0.5, 0.3)
    step = 360 / grid.shape[axis]
    views = [
        vm.Orthographic(57, phi, width=6.4, resolution=30, center=(0, 0, 0))
        for phi in (20, 20 - 7 * step)
    ]
    pair = [
        vm.render(vm.Volume(grid, f=f), medium, camera, precision="double", tolerance=1e-4)
        for f, camera in zip((values, turned), views, strict=True)
    ]
    error = pair[0].error + pair[1].error
    assert (np.abs(pair[0].intensity - pair[1].intensity).max(axis=-1) <= error + 1e-9).all()


@pytest.mark.parametrize("scheme", ["post-classified", "first-order", "second-order"])
def test_single_precision_is_near_double(scheme):
    volume = volume_of(GRIDS["full"], "sin(3*x) + cos(2*y) * z")
    medium = vm.Gaussian("f", 0.5, 0.2, [1.0], 0.5, 0.3)
    pair = [
        vm.render(volume, medium, CAMERAS["oblique"], scheme=scheme, precision=p, tolerance=1e-4)
        for p in ("single", "double")
    ]
    off = np.abs(pair[0].intensity - pair[1].intensity)
    assert off.max() <= 1e-3 * pair[1].intensity.max()
    assert np.median(off) <= 1e-5 * pair[1].intensity.max()


def test_one_panel_is_near_too():
    volume = volume_of(GRIDS["full"], "sin(3*x) + cos(2*y) * z")
    medium = vm.Gaussian("f", 0.5, 0.2, [1.0], 0.5, 0.3)
    exact = drawn(volume, medium, "oblique").intensity
    quick = vm.render(volume, medium, CAMERAS["oblique"], tolerance=None).intensity
    assert np.sqrt(np.mean((quick - exact) ** 2)) < 0.01 * exact.max()
