"""Derivatives on refined spherical and cylindrical grids: what is exact, and orders elsewhere."""

from __future__ import annotations

import numpy as np
import pytest

import voluminous as vm
from random_trees import random_flags
from test_any_grid_derivatives import OPERATORS, at_jumps

PI, CIRCLE = np.pi, [0.0, 2 * np.pi]
UNEVEN = np.array([0.3, 1.2, 1.9, 3.4, 4.3, 5.8, 2 * PI + 0.3])
RADII, HEIGHTS = np.linspace(0, 2, 5), np.linspace(-1, 1, 4)


def spherical(r, theta, phi, seed=1, **options):
    count = (len(r) - 1) * (len(theta) - 1) * (len(phi) - 1)
    return vm.SphericalGrid(r, theta, phi, refined=random_flags(count, 8, 2, seed), **options)


GRIDS = {
    "centre": lambda: spherical(RADII, np.linspace(0, PI, 6), UNEVEN),
    "cavity": lambda: spherical(np.geomspace(0.1, 3, 6), np.linspace(0, PI, 6), UNEVEN),
    "wedge": lambda: spherical(RADII, np.linspace(0, 2, 5), np.linspace(0.2, 1.5, 5)),
    "cylinder": lambda: vm.CylindricalGrid(
        RADII, UNEVEN, HEIGHTS, refined=random_flags(4 * 6 * 3, 8)
    ),
    "mirrored": lambda: spherical(RADII, np.array([0, 0.3, 0.7, 1.2, PI / 2]), UNEVEN, mirror=True),
}
SYMMETRIC = {
    "axisymmetric": lambda: vm.SphericalGrid(
        RADII, np.linspace(0, PI, 6), [0.3, 2 * PI + 0.3], refined=random_flags(4 * 5, 4)
    ),
    "round cylinder": lambda: vm.CylindricalGrid(
        RADII, CIRCLE, HEIGHTS, refined=random_flags(4 * 3, 4)
    ),
}


def root_mean_square(values):
    return np.sqrt(np.mean(values**2))


def all_derivatives(volume):
    return np.array([*volume.evaluate("grad(f)"), volume.evaluate("laplacian(f)")])


def rounding(volume):
    """Return what is left of the digits of f in differences between the smallest cells, (4, 1)."""
    small = volume.grid.cell_sizes().min()
    most = 1e-15 * np.abs(volume["f"]).max()
    return 100 * most / np.array([[small], [small], [small], [small**2]])


@pytest.mark.parametrize("kind", GRIDS)
def test_linear_fields_are_exact_everywhere(kind):
    volume = vm.Volume(GRIDS[kind]())
    up = 0.0 if kind == "mirrored" else 0.5
    volume["f"] = f"1 + 2*x - 3*y + {up}*z"
    wrong = np.abs(all_derivatives(volume) - np.array([[2.0], [-3.0], [up], [0.0]]))
    # What keeps systems solvable is off by 1e-13 of slopes.
    assert np.all(wrong < rounding(volume) + 1e-11)


@pytest.mark.parametrize("kind", GRIDS)
def test_quadratic_fields_are_exact_at_jumps_on_the_axis_and_in_the_centre(kind):
    volume = vm.Volume(GRIDS[kind]())
    mixed = "0" if kind == "mirrored" else "3*y*z - 0.5*x*z + z"
    volume["f"] = f"x**2 + 2*y**2 - 5*z**2 + x*y + x - ({mixed})"
    slopes = ["2*x + y + 1", "4*y + x", "-10*z"]
    if kind != "mirrored":
        slopes = ["2*x + y + 1 + 0.5*z", "4*y + x - 3*z", "-10*z - 3*y + 0.5*x - 1"]
    expected = np.array([*(volume.evaluate(s) for s in slopes), np.full(volume.grid.size, -4.0)])
    wrong, known = np.abs(all_derivatives(volume) - expected), at_jumps(volume.grid)
    assert known.sum() > 50
    assert np.all(wrong[:, known] < rounding(volume) + 1e-10)


@pytest.mark.parametrize("kind", SYMMETRIC)
def test_quadratic_fields_are_exact_at_jumps_where_one_cell_goes_all_around(kind):
    volume = vm.Volume(SYMMETRIC[kind]())
    volume["f"] = "3*(x**2 + y**2) - 2*z**2 + z"
    known = at_jumps(volume.grid)
    assert known.sum() > 10
    np.testing.assert_allclose(volume.evaluate("laplacian(f)")[known], 8, atol=1e-9)


def locally_refined(grid, chosen, children):
    """Return the grid with some base cells split."""
    flags = np.concatenate([[1] + [0] * children if split else [0] for split in chosen])
    return (
        type(grid)(*grid.edges, refined=flags, mirror=True)
        if grid.mirror
        else type(grid)(*grid.edges, refined=flags)
    )


def evenly(n, low, high):
    return np.linspace(low, high, n + 1)


CONVERGING = {
    "spherical": lambda n: vm.SphericalGrid(
        evenly(n, 0.4, 2), evenly(n, 0, PI), evenly(2 * n, 0, 2 * PI)
    ),
    "mirrored": lambda n: vm.SphericalGrid(
        evenly(n, 0, 1), evenly(n, 0, PI / 2), evenly(2 * n, 0, 2 * PI), mirror=True
    ),
    "cylindrical": lambda n: vm.CylindricalGrid(
        evenly(n, 0, 1), evenly(2 * n, 0, 2 * PI), evenly(n, 0, 1)
    ),
    "axisymmetric": lambda n: vm.SphericalGrid(evenly(2 * n, 0, 1), evenly(n, 0, PI)),
}
WAVES = {  # f, its gradient and its Laplacian
    "axisymmetric": (
        "cos(x**2 + y**2)*exp(z)",
        ("-2*x*sin(x**2 + y**2)*exp(z)", "-2*y*sin(x**2 + y**2)*exp(z)", "cos(x**2 + y**2)*exp(z)"),
        "((1 - 4*(x**2 + y**2))*cos(x**2 + y**2) - 4*sin(x**2 + y**2))*exp(z)",
    ),
    "mirrored": (
        "sin(x)*exp(y)*cos(z)",
        ("cos(x)*exp(y)*cos(z)", "sin(x)*exp(y)*cos(z)", "-sin(x)*exp(y)*sin(z)"),
        "-sin(x)*exp(y)*cos(z)",
    ),
}


@pytest.mark.exhaustive
@pytest.mark.parametrize("kind", CONVERGING)
def test_derivatives_converge_at_jumps(kind):
    make, children = CONVERGING[kind], 4 if kind == "axisymmetric" else 8
    field, slopes, bend = WAVES.get(kind, WAVES["mirrored"])
    errors = []
    for n in (6, 12, 24):
        grid = make(n)
        x, y, z = grid.cell_centers().reshape(3, *grid.shape)
        layer = np.abs(x + 0.3 * y + 0.2 * z) < 0.4
        volume = vm.Volume(locally_refined(grid, fortran(layer), children))
        volume["f"] = field
        expected = np.array([volume.evaluate(e) for e in (*slopes, bend)])
        wrong = (all_derivatives(volume) - expected)[:, at_jumps(volume.grid)]
        sizes = np.sqrt(np.sum(wrong[:3] ** 2, axis=0)), np.abs(wrong[3])
        errors.append([f(own) for own in sizes for f in (np.max, root_mean_square)])
    largest, mean, largest_bend, mean_bend = 0.5 * (np.log2(errors[0]) - np.log2(errors[-1]))
    # Second and first order; the largest of what are more and more kinds of neighbours comes later.
    assert mean > 1.6
    assert largest > 1.1
    assert mean_bend > 0.9
    assert largest_bend > 0.6


def test_azimuth_goes_round():
    """Turned by one base cell, all is the same: leaves are numbered with phi slowest."""
    theta, phi = np.linspace(0, PI, 4), np.linspace(0, 2 * PI, 7)
    flags = [random_flags(4 * 3, 8, 2, seed) for seed in range(6)]
    rng = np.random.default_rng(2)
    counts = [vm.SphericalGrid(RADII, theta, [0, 1], refined=f).size for f in flags]
    values = [rng.normal(size=count) for count in counts]
    found = []
    for first in (0, 2):
        order = np.roll(np.arange(6), -first)
        grid = vm.SphericalGrid(
            RADII, theta, phi, refined=np.concatenate([flags[k] for k in order])
        )
        volume = vm.Volume(grid, f=np.concatenate([values[k] for k in order]))
        parts = np.split(
            np.array([volume.evaluate("gradmag(f)"), volume.evaluate("laplacian(f)")]),
            np.cumsum([counts[k] for k in order])[:-1],
            axis=1,
        )
        found.append(np.concatenate([parts[np.flatnonzero(order == k)[0]] for k in range(6)], 1))
    scale = np.abs(found[0]).max(axis=1, keepdims=True)
    np.testing.assert_allclose(found[1] / scale, found[0] / scale, rtol=0, atol=1e-9)


def test_a_mirrored_grid_has_the_derivatives_of_the_whole():
    theta, phi = np.linspace(0, PI / 2, 4), np.linspace(0, 2 * PI, 7)
    chosen = np.random.default_rng(4).random((4, 3, 6)) < 0.3
    both = np.concatenate([chosen, chosen[:, ::-1]], axis=1)
    half = locally_refined(vm.SphericalGrid(RADII, theta, phi, mirror=True), fortran(chosen), 8)
    whole = locally_refined(
        vm.SphericalGrid(RADII, np.append(theta, PI - theta[-2::-1]), phi), fortran(both), 8
    )
    values = np.random.default_rng(7).normal(size=half.size)
    image = half.locate(whole.cell_centers().T)
    same = whole.locate(half.cell_centers().T)
    for operation in OPERATORS:
        found = vm.Volume(half, f=values).evaluate(operation)
        expected = vm.Volume(whole, f=values[image]).evaluate(operation)[same]
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


def fortran(chosen):
    """Return flags of base cells in the order of leaves: r fastest."""
    return chosen.ravel(order="F")
