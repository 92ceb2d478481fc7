"""Vectors by name: components in any coordinates, and along the line of sight."""

from __future__ import annotations

import numpy as np
import pytest
from astropy import units as u

import voluminous as vm
from contracts import Bundle
from voluminous.errors import ExpressionError, InputError, UnitsError, UnknownNameError
from voluminous.expressions import Expression, derived_field

EDGES = ([-2.0, -1.0, 0.5, 2.0], [-1.0, 0.3, 1.5], [-2.0, 0.1, 1.0, 3.0])
CARTESIAN = vm.CartesianGrid(*EDGES)
SPHERICAL = vm.SphericalGrid(
    [0.5, 1.0, 2.0], np.linspace(0.1, 3.0, 6), np.linspace(0, 2 * np.pi, 9)
)
CYLINDRICAL = vm.CylindricalGrid([0.5, 1.0, 2.0], np.linspace(0, 2 * np.pi, 9), [-1.0, 0.0, 2.0])
GRIDS = [CARTESIAN, SPHERICAL, CYLINDRICAL]
ORTHOGRAPHIC = vm.Orthographic(50, 20, 10, resolution=32)
PERSPECTIVE = vm.Perspective((5.0, 3.0, 1.0), (0.0, 0.0, 0.0), resolution=32)


def random_vector(grid, names, seed=0):
    rng = np.random.default_rng(seed)
    return {f"v_{name}": rng.normal(size=grid.shape) for name in names}


def centers(grid):
    return grid.cell_centers().reshape(3, *grid.shape)


@pytest.mark.parametrize("grid", GRIDS, ids=lambda g: type(g).__name__)
@pytest.mark.parametrize("system", [("r", "theta", "phi"), ("R", "phi", "z"), ("x", "y", "z")])
def test_components_in_all_systems_are_the_same_vector(grid, system):
    volume = vm.Volume(grid, random_vector(grid, system))
    x, y, z = (volume.evaluate(f"v_{axis}") for axis in "xyz")
    px, py, pz = centers(grid)
    distance, axial = np.sqrt(px**2 + py**2 + pz**2), np.hypot(px, py)
    close = {"rtol": 1e-12, "atol": 1e-13}
    expected = {
        "r": (x * px + y * py + z * pz) / distance,
        "R": (x * px + y * py) / axial,
        "phi": (y * px - x * py) / axial,
        "theta": ((x * px + y * py) * pz / axial - z * axial) / distance,
    }
    for name, values in expected.items():
        np.testing.assert_allclose(volume.evaluate(f"v_{name}"), values, **close)
    given = np.sqrt(sum(volume[f"v_{name}"] ** 2 for name in system))
    np.testing.assert_allclose(volume.evaluate("norm('v')"), given, **close)


@pytest.mark.parametrize("grid", GRIDS, ids=lambda g: type(g).__name__)
@pytest.mark.parametrize("camera", [ORTHOGRAPHIC, PERSPECTIVE], ids=["parallel", "eye"])
def test_the_line_of_sight_points_away_from_the_observer(grid, camera):
    volume = vm.Volume(grid, random_vector(grid, "xyz"))
    points = centers(grid)
    if camera is PERSPECTIVE:
        away = points - np.array([5.0, 3.0, 1.0]).reshape(3, 1, 1, 1)
        away /= np.sqrt(np.sum(away**2, axis=0))
    else:
        vectors = camera.frame(grid).vectors
        away = vectors[3].reshape(3, 1, 1, 1)  # the direction of its rays, which run away
    v = np.stack([volume[f"v_{axis}"] for axis in "xyz"])
    found = volume.evaluate("los('v')", camera=camera)
    np.testing.assert_allclose(found, np.sum(v * away, axis=0), rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("scheme", ["first-order", "second-order", "post-classified"])
def test_pictures_know_their_camera(scheme):
    rng = np.random.default_rng(1)
    grid = vm.CartesianGrid.uniform(6, (-1, 1))
    volume = vm.Volume(grid, {f"v_{a}": rng.normal(size=grid.shape) for a in "xyz"})
    seen = vm.Gaussian("los('v')", 0.5, 0.5, [1.0, 0.5], 0.3, path_length=1.0)
    for camera in (
        vm.Orthographic(30, 40, resolution=16),
        vm.Perspective((3, 0, 1), (0, 0, 0), resolution=16),
        vm.Orthographic(30, 40, resolution=16),
    ):
        explicit = vm.Volume(grid, w=volume.evaluate("los('v')", camera=camera))
        medium = vm.Gaussian("w", 0.5, 0.5, [1.0, 0.5], 0.3, path_length=1.0)
        expected = vm.render(explicit, medium, camera, scheme=scheme)
        found = vm.render(volume, seen, camera, scheme=scheme)
        np.testing.assert_array_equal(found.intensity, expected.intensity)
        assert np.ptp(found.intensity) > 0


def test_what_is_kept_is_that_of_the_camera_and_of_the_fields():
    volume = vm.Volume(CARTESIAN, random_vector(CARTESIAN, "xyz"))
    above, below = vm.Orthographic(), vm.Orthographic(180)
    seen = [volume.evaluate("los('v')", camera=c) for c in (above, below, above)]
    np.testing.assert_allclose(seen[0], -volume["v_z"], rtol=1e-12)
    np.testing.assert_allclose(seen[1], volume["v_z"], rtol=1e-12)
    np.testing.assert_array_equal(seen[0], seen[2])
    own = np.ones(CARTESIAN.shape)
    volume["v_z"] = own
    view = volume.seen_by(above)
    np.testing.assert_allclose(view.array('los("v")'), -1)
    own *= 3
    view.refresh()
    np.testing.assert_allclose(view.array('los("v")'), -3)


def test_units_of_components():
    plain = np.ones(SPHERICAL.shape)
    fields = {
        "v_r": plain * u.km / u.s,
        "v_theta": plain * u.m / u.s,
        "v_phi": 0 * plain * u.km / u.s,
    }
    volume = vm.Volume(SPHERICAL, fields)
    assert volume.field_unit("v_x") == u.km / u.s
    speed = volume.evaluate("norm('v')")
    np.testing.assert_allclose(speed, np.sqrt(1 + 1e-6), rtol=1e-12)
    assert volume.seen_by(ORTHOGRAPHIC).expression_unit(Expression("los('v')")) == u.km / u.s
    volume["v_phi"] = plain * u.rad / u.s
    with pytest.raises(UnitsError, match="units of one kind, got v_r in km / s, v_theta"):
        volume.evaluate("v_x")


def test_names_of_vectors_in_expressions():
    assert Expression("norm('v')").names == ("v_x", "v_y", "v_z")
    assert Expression("los('v') + 1").names == ('los("v")',)
    assert derived_field("los( 'v' )").name == 'los("v")'
    assert derived_field("los(v)").name == 'los("v")'
    assert Expression('los("v")') == Expression("los('v')")
    for text in ("los(2 * v)", "los('v') + 'v'", "los('a b')", "los()", "norm('los(v)')"):
        with pytest.raises(ExpressionError):
            Expression(text)


def test_what_is_missing_is_named():
    volume = vm.Volume(CARTESIAN, random_vector(CARTESIAN, "xyz"))
    with pytest.raises(InputError, match=r"give a camera: volume\.evaluate"):
        volume.evaluate("los('v')")
    with pytest.raises(UnknownNameError, match="unknown field 'w_x'"):
        volume.evaluate("los('w')", camera=ORTHOGRAPHIC)
    with pytest.raises(InputError, match="Bundle does not tell its lines of sight"):
        vm.render(volume, vm.Coefficients("los('v')", "1"), Bundle([[0, 0, -9.0]], [[0, 0, 1.0]]))
    half = vm.SphericalGrid([1.0, 2.0], [0.5, np.pi / 2], mirror=True)
    mirrored = vm.Volume(half, random_vector(half, "xyz"))
    with pytest.raises(InputError, match=r"mirror image: volume\.unfolded\(\) has both"):
        mirrored.evaluate("los('v')", camera=ORTHOGRAPHIC)


AXISYMMETRIC = {
    "spherical": vm.SphericalGrid(np.linspace(0.5, 3, 9), np.linspace(0.2, np.pi, 7)),
    "radial": vm.SphericalGrid(np.linspace(0.5, 3, 9)),
    "cylindrical": vm.CylindricalGrid(np.linspace(0, 3, 9), [0, 2 * np.pi], [-1.0, 0.0, 2.0]),
    "refined": vm.SphericalGrid([1.0, 2.0, 3.0], [0.5, 2.0], refined=[1, 0, 0, 0, 0, 0]),
}


@pytest.mark.parametrize("grid", AXISYMMETRIC.values(), ids=AXISYMMETRIC)
def test_a_cell_all_around_has_a_line_of_sight_only_from_its_axis(grid):
    """From elsewhere one side of it comes and the other goes: it had the velocity of one side."""
    volume = vm.Volume(grid, random_vector(grid, grid.coordinates))
    for camera in (ORTHOGRAPHIC, PERSPECTIVE, vm.Orthographic(90)):
        with pytest.raises(InputError, match=r"goes all around: volume\.unfolded\(phi=64\)"):
            volume.evaluate("los('v')", camera=camera)
    centre = vm.Perspective((0, 0, 0), (1, 2, 3)), "v_r"
    above = vm.Orthographic(), "-v_z"
    for camera, expected in [centre] if grid is AXISYMMETRIC["radial"] else [centre, above]:
        found = volume.evaluate("los('v')", camera=camera)
        np.testing.assert_allclose(found, volume.evaluate(expected), atol=1e-12)


def test_lines_of_sight_of_an_unfolded_disc_converge_in_second_order():
    # Ring of R from 1 to 2 that turns: seen from the side, ∫ v·n ds through x = b is odd in b and
    # is b ∫ ds / R; chord by chord that is 2 b (asinh(√(4 - b²)/b) - asinh(√(1 - b²)/b)).
    grid = vm.CylindricalGrid(np.linspace(1, 2, 41), [0, 2 * np.pi], [-1.0, 1.0])
    disc = vm.Volume(grid, v_R="0", v_phi="1", v_z="0")
    camera = vm.Orthographic(90, 0, width=(4, 1), resolution=(40, 1))
    errors = []
    for phi in (16, 32, 64):
        medium = vm.Coefficients("los('v')", 0)
        image = vm.render(disc.unfolded(phi=phi), medium, camera, tolerance=1e-5)
        b = np.abs(image.x)
        outer, inner = (np.sqrt(np.maximum(r * r - b * b, 0)) for r in (2.0, 1.0))
        exact = 2 * b * (np.arcsinh(outer / b) - np.arcsinh(inner / b))
        found = np.abs(image.intensity[0, :, 0])
        errors.append(np.abs(found - exact).max())
    assert np.log2(errors[0] / errors[2]) > 3.5
    assert errors[2] < 5e-3


@pytest.mark.parametrize(
    ("grid", "fields", "asked", "message"),
    [
        ("spherical", "abc", {"phi": 3}, r"phi must be a whole number of cells, 4 or more; got 3"),
        ("spherical", "abc", {"theta": 8}, r"theta can only be divided where one cell goes all"),
        ("refined", "abc", {"phi": 8}, r"refined grid cannot be unfolded; use volume\.resample"),
        ("spherical", "xyz", {"phi": 8}, r"'v_x' is .* along x, .*\(v_r, v_theta, v_phi\)"),
    ],
)
def test_what_cannot_be_divided(grid, fields, asked, message):
    volume = vm.Volume(AXISYMMETRIC[grid], random_vector(AXISYMMETRIC[grid], fields))
    with pytest.raises(InputError, match=message):
        volume.unfolded(**asked)


def both_halves():
    """Return a mirrored volume, and the cells' values as functions of place."""
    grid = vm.SphericalGrid(
        np.geomspace(1, 3, 6), np.linspace(0.3, np.pi / 2, 5), np.linspace(0, 2 * np.pi, 9),
        mirror=True, unit="pc",
    )  # fmt: skip
    volume = vm.Volume(grid, rho="2 * r + x", v_r="x", v_theta="r + y", v_phi="z")
    volume["w_x"], volume["w_y"], volume["w_z"] = "z", "x", "z + y"
    volume["height_z"] = "z"  # no vector: there are no height_x and height_y
    for name in ("v_r", "v_theta", "v_phi", "w_x", "w_y", "w_z"):
        volume.set_unit(name, "km/s")
    volume.set_unit("rho", None)
    volume.meta["time"] = 3.0
    return volume


def test_both_halves_of_a_mirrored_volume():
    volume = both_halves()
    whole = volume.unfolded()
    assert not whole.grid.mirror
    assert whole.grid.shape == (5, 8, 8)
    assert whole.meta == {"time": 3.0}
    assert whole.units["v_r"] == "km / s"
    for name, sign in {
        "rho": 1,
        "v_r": 1,
        "v_theta": -1,
        "w_x": 1,
        "w_z": -1,
        "height_z": 1,
    }.items():
        np.testing.assert_array_equal(whole.array(name)[:, :4], volume.array(name))
        np.testing.assert_array_equal(whole.array(name)[:, :3:-1], sign * volume.array(name))
    # Cartesian components of a vector in spherical ones: mirrored, z changes sign.
    up, down = whole.array("v_z")[:, :4], whole.array("v_z")[:, :3:-1]
    np.testing.assert_allclose(down, -up, atol=1e-12)
    np.testing.assert_allclose(whole.grid.cell_volumes.sum(), volume.grid.cell_volumes.sum())
