"""Fields interpolated between the centres of curvilinear cells, classified along rays."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import voluminous as vm
from twin.curvilinear import Frame, chord
from voluminous.measuring.columns import lines_of_sight

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


@pytest.mark.each_value_once
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


LINEAR = {
    "0.7*r": "full",
    "1 + theta": "wedge",
    "phi": "wedge",
    "theta": "mirrored",
    "r + theta": "axisymmetric",
    "2*R + z": "cylinder",
    "R": "cylinder",
}
# A kernel for each text and kind of camera: those of perspective are compiled for three texts.
OTHERS = [
    pytest.param(view, text, marks=[] if text in ("0.7*r", "phi", "R") else pytest.mark.exhaustive)
    for view, text in itertools.product(["inside", "in the hole"], LINEAR)
]


@pytest.mark.each_value_once
@pytest.mark.parametrize(
    ("view", "text"), [*itertools.product(["oblique", "edge-on"], LINEAR), *OTHERS]
)
def test_what_is_linear_in_the_grids_coordinates_is_exact_between_centres(view, text):
    """A shell of the field, against the same shell of the coordinates themselves."""
    volume = volume_of(GRIDS[LINEAR[text]], text)
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


def sampled(grid, values, points):
    """Return a field between centres: linear in each own coordinate, constant beyond the last."""
    own = Frame.of(grid).coordinates(points)
    index, part = [], []
    for axis, edges in enumerate(grid.edges):
        centers = 0.5 * (edges[1:] + edges[:-1])
        if axis == Frame.of(grid).phi_axis:  # a full circle: one more on either side
            values = np.take(values, np.arange(-1, len(centers) + 1), axis, mode="wrap")
            centers = np.concatenate([[centers[-1] - 2 * PI], centers, [centers[0] + 2 * PI]])
        place = np.interp(own[..., axis], centers, np.arange(len(centers)))
        low = np.minimum(place.astype(int), len(centers) - 2)
        index.append(low)
        part.append(place - low)
    total = 0.0
    for corner in np.ndindex(2, 2, 2):
        weight = np.prod([f if c else 1 - f for f, c in zip(part, corner, strict=True)], axis=0)
        total = total + weight * values[tuple(i + c for i, c in zip(index, corner, strict=True))]
    return total


@pytest.mark.parametrize("tolerance", [1e-3, 1e-5])
@pytest.mark.parametrize("name", ["coarse ball", "coarse cylinder"])
def test_white_noise_keeps_to_the_tolerance_and_errors_are_honest(name, tolerance):
    """Wide cells around axis and centre, thin shells: against many points along each ray."""
    radii, phi = np.linspace(0, 1, 9), np.linspace(0, 2 * PI, 13)
    grid = {
        "coarse ball": vm.SphericalGrid(radii, np.linspace(0, PI, 9), phi),
        "coarse cylinder": vm.CylindricalGrid(radii, phi, np.linspace(-1, 1, 9)),
    }[name]
    values, width = np.random.default_rng(5).random(grid.shape), 0.03
    camera = vm.Orthographic(57, 33, width=1.8, resolution=12, center=(0, 0, 0))
    shell = vm.Gaussian("f", 0.5, width, 1.0, 0, 1.0)
    image = vm.render(
        vm.Volume(grid, f=values), shell, camera, precision="double", tolerance=tolerance
    )
    origins, directions = (a.reshape(-1, 3) for a in lines_of_sight(camera, grid))
    enter, leave = (t.astype(float) for t in chord(Frame.of(grid), origins, directions))
    truth = []
    for origin, direction, first, last in zip(origins, directions, enter, leave, strict=True):
        step = max(last - first, 0.0) / 30_000
        t = first + step * (np.arange(30_000) + 0.5)
        f = sampled(grid, values, origin + t[:, None] * direction)
        truth.append(step * np.sum(np.exp(-0.5 * ((f - 0.5) / width) ** 2)))
    off = np.abs(image.intensity.reshape(-1) - truth) / np.max(truth)
    # Of single cells of noise, some touch what no estimate sees.
    assert np.quantile(off, 0.98) <= 2 * tolerance
    # What sums over points are off by themselves.
    assert np.mean(off <= image.error.reshape(-1) / np.max(truth) + 2e-6) >= 0.98
