"""Fields on refined curvilinear grids between leaves: continuous, linear where they are."""

from __future__ import annotations

import numpy as np
import pytest

import voluminous as vm
from contracts.bundle import Bundle, on_a_sphere
from curvilinear_rays import adversarial_rays
from random_trees import random_flags
from test_spherical_refined import CIRCLE, GRIDS, RADII
from voluminous.backend import get_backend
from voluminous.rendering.sources.vertex_values import CornerValues

PI = np.pi
BITS = np.indices((2, 2, 2)).reshape(3, 8)
UNEVEN = np.array([0, 0.9, 1.6, 3.1, 4.0, 5.5, 2 * PI])
MORE = {
    **GRIDS,
    "logarithmic": vm.SphericalGrid(
        np.geomspace(1e-3, 10, 5), np.linspace(0.2, 2.9, 4), UNEVEN, refined=random_flags(72, 8)
    ),
    "round cylinder": vm.CylindricalGrid(
        [0, 4, 10], [0, 2 * PI], [-5, 0, 5], refined=random_flags(4, 4)
    ),
}


def corner_values(grid, field, precision="double"):
    """Return the values at the corners of all leaves, (n, 8)."""
    backend = get_backend("cpu", precision)
    (found,) = CornerValues(grid, [field], backend).compute()
    return np.array(found).reshape(-1, 8)


def corner_points(grid):
    """Return the own coordinates of the corners of all leaves, (3, n, 8)."""
    low, high = grid.spans()
    return np.where(BITS[:, None] == 1, high[..., None], low[..., None])


def between(grid, values, cell, native):
    """Return what is multilinear in leaves, at own coordinates (3, m)."""
    low, high = (side[:, cell] for side in grid.spans())
    turn = 2 * PI * (np.array(grid.coordinates) == "phi")[:, None]
    near = native + turn * np.round((0.5 * (low + high) - native) / (2 * PI))
    f = np.clip((near - low) / (high - low), 0, 1)
    weight = np.where(BITS[:, :, None] == 1, f[:, None], 1 - f[:, None]).prod(axis=0)
    return np.einsum("km,mk->m", weight, values[cell])


def pairs_across_faces(grid, count=20_000):
    """Return own coordinates of points on faces, and the leaves on both sides of them."""
    rng = np.random.default_rng(6)
    low, high = (side.T for side in grid.spans())
    cell = rng.integers(0, grid.size, count)
    points = rng.uniform(low[cell], high[cell])
    lane, axis, up = np.arange(count), rng.integers(0, 3, count), rng.integers(0, 2, count)
    points[lane, axis] = np.where(up, high[cell, axis], low[cell, axis])
    beyond = points.copy()
    beyond[lane, axis] += (2 * up - 1) * 1e-3 * (high - low)[cell, axis]
    # Beyond a pole, or the axis, is another azimuth: not a face.
    name = np.array(grid.coordinates)[axis]
    inside = np.where(name == "theta", (beyond[lane, axis] > 0) & (beyond[lane, axis] < PI), True)
    inside &= np.where(axis == 0, beyond[:, 0] > 0, True)
    other = grid.locate(grid.position(beyond.T).T)
    there = (other >= 0) & inside
    return points[there].T, cell[there], other[there]


@pytest.mark.each_value_once
@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("name", MORE)
def test_fields_are_continuous(name, precision):
    """Whatever the field: leaves of any sizes agree on the wall they share, where φ closes too."""
    grid = MORE[name]
    field = np.random.default_rng(3).random(grid.size)
    values = corner_values(grid, field, precision)
    points, cell, other = pairs_across_faces(grid)
    one, two = (between(grid, values, c, points) for c in (cell, other))
    assert np.mean(cell != other) > 0.3
    assert np.abs(one - two).max() <= 1e-6
    # Nothing is beyond what leaves say.
    assert values.min() >= field.min() - 1e-7
    assert values.max() <= field.max() + 1e-7


def is_inner(grid):
    """Return which leaves are a base cell away from the surface, and two from where φ jumps."""
    corner, size = grid.boxes(0, grid.size)
    least = np.ones(3, int)
    least[grid.coordinates.index("phi")] += grid.is_periodic
    margin = (least * grid.divisions)[:, None]
    last = (grid.divisions * grid.base_shape)[:, None]
    return ((corner >= margin) & (corner + size <= last - margin)).all(axis=0)


@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize(
    ("name", "slopes"),
    [
        ("full", (1, 2, -0.5)),
        ("open cones", (1, 2, -0.5)),
        ("wedge", (0.3, -1, 1)),
        ("logarithmic", (1, 2, -0.5)),
        ("cylinder", (2, 1, 0.5)),
    ],
)
def test_what_is_linear_in_own_coordinates_is_exact_inside(name, slopes, precision):
    grid = MORE[name]
    values = corner_values(grid, np.array(slopes) @ grid.native_centers(), precision)
    expected, inner = np.tensordot(slopes, corner_points(grid), 1), is_inner(grid)
    assert inner.sum() > 8
    # Gradients come from sums of squares over a mixture of widths: some digits go.
    slack = {"single": 1e-6, "double": 1e-11}[precision]
    assert np.abs(values - expected)[inner].max() <= slack * np.abs(expected).max()


def split(kind, edges, chosen, **options):
    """Return a grid with chosen base cells (bool, of the base's shape) split once."""
    flags = [flag for one in chosen.ravel(order="F") for flag in ([1] + [0] * 8 if one else [0])]
    return kind(*edges, refined=flags, **options)


def test_azimuth_goes_round():
    """Turning tree and field by base cells turns the corners' values: there is no seam."""
    rng, theta = np.random.default_rng(1), np.linspace(0.3, PI, 4)
    chosen, fine = rng.random((3, 3, 6)) < 0.4, rng.random((6, 6, 12))
    found = []
    for turn in (0, 2):
        grid = split(vm.SphericalGrid, (RADII, theta, CIRCLE), np.roll(chosen, turn, 2))
        corner, _ = grid.boxes(0, grid.size)
        field = np.roll(fine, 2 * turn, 2)[tuple(corner)]
        order = np.lexsort([corner[0], corner[1], (corner[2] - 2 * turn) % 12])
        found.append(corner_values(grid, field)[order])
    np.testing.assert_allclose(*found, rtol=0, atol=1e-12)


def some_rays():
    """Return rays from outside, inside and the cavity, and some in special directions."""
    origins = np.random.default_rng(5).uniform(-4, 4, (24, 3))
    directions = on_a_sphere(24, 4)
    origins[:6] -= 20 * directions[:6]
    origins[6:9] *= 0.1
    special = [((2, 0.4, -14), (0, 0, 1)), ((0, 0, 14), (0, 0, -1)), ((-14, 1, 0), (1, 0, 0))]
    through = [
        ((14, 0, 1e-3), (-1, 0, 0)),
        ((3, 4, 0), (-0.6, -0.8, 0)),
        ((0, 0, 0), (0.6, 0, 0.8)),
    ]
    more = np.array(special + through, float)
    return np.concatenate([origins, more[:, 0]]), np.concatenate([directions, more[:, 1]])


def columns(grid, field, scheme="post-classified", camera=None, **options):
    """Return the columns of a field, along these rays by default."""
    camera, medium = camera or Bundle(*some_rays(), start=True), vm.Coefficients("f", "0*f")
    options = {"precision": "double", "cutoff": 0, **options}
    volume = vm.Volume(grid, f=field)
    return camera.flat(vm.render(volume, medium, camera, scheme=scheme, **options).intensity)


@pytest.mark.each_value_once
@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("name", MORE)
def test_a_constant_field_is_what_the_rays_cross(name, precision):
    """Columns of one are chords: first order finds the same, by another walk.

    Through vertices, along walls and the axis, and through the centre too: no step is lost, none
    hangs. In single precision, a ray enters and leaves where some roundings tell.
    """
    grid, ones = MORE[name], np.ones(MORE[name].size)
    rays = zip(some_rays(), adversarial_rays(grid, 3 * grid.edges[0][-1]), strict=True)
    camera = Bundle(*[np.concatenate(each) for each in rays], start=True)
    found, expected = (
        columns(grid, ones, scheme, camera, precision=precision)
        for scheme in ("post-classified", "first-order")
    )
    slack = {"single": 1e-5, "double": 1e-9}[precision]
    np.testing.assert_allclose(found, expected, rtol=0, atol=slack * expected.max())
