"""Fluxes: closed forms of spheres, whatever is drawn: frames, rings, apertures."""

from __future__ import annotations

import numpy as np
import pytest
from astropy import units as u

import voluminous as vm
from voluminous.observing.rings import Rings
from voluminous.physics.constants import CODATA

FREQUENCIES = np.array([1e11, 3e11, 1e12])
TEMPERATURE, DENSITY, RADIUS = 20.0, 3e-15, 1e13
PARSEC = (1 * u.pc).to_value("cm")
JANSKYS = 1e23  # in one erg/s/cm²/Hz
KAPPA = vm.Opacity.power_law(3.5, 870.0, 1.5)
DUST = vm.Dust("rho", TEMPERATURE, KAPPA)


def flux_of_ball(radius=RADIUS, within=np.inf, distance=PARSEC):
    """Return the flux in Jy of a uniform isothermal ball, or of the part of it within a circle.

    I(p) = B (1 - exp(-2α √(R² - p²))); the integral over 2π p dp, with y = 2α √(R² - p²), has the
    primitive (y²/2 + (1 + y) exp(-y)) / 4α² (Osterbrock 1974, appendix 2, has it with y = 2αR).
    """
    alpha = DENSITY * KAPPA.absorption(FREQUENCIES)

    def primitive(y):
        return 0.5 * y**2 + (1.0 + y) * np.exp(-y)

    inner = 2.0 * alpha * np.sqrt(max(radius**2 - within**2, 0.0))
    total = primitive(2.0 * alpha * radius) - primitive(inner)
    planck = CODATA.planck(FREQUENCIES, TEMPERATURE)
    return JANSKYS * 2.0 * np.pi * planck * total / (4.0 * alpha**2) / distance**2


@pytest.fixture(scope="module")
def shells():
    """A ball on a spherical grid, whose innermost cells are a thousandth of it."""
    r = np.concatenate([[1e-3], np.geomspace(0.01, 1.0, 12)]) * RADIUS
    grid = vm.SphericalGrid(r, [0.0, np.pi], [0.0, 2.0 * np.pi], unit="cm")
    return vm.Volume(grid, rho=np.full(grid.shape, DENSITY) * u.g / u.cm**3)


@pytest.fixture(scope="module")
def cube():
    """A cube: its flux along an axis is that of a slab."""
    edges = np.linspace(-0.5, 0.5, 5) * RADIUS
    grid = vm.CartesianGrid(edges, edges, edges, unit="cm")
    return vm.Volume(grid, rho=np.full(grid.shape, DENSITY) * u.g / u.cm**3)


def test_a_ball_on_rings(shells):
    """The cavity of a thousandth holds 1e-9 of the ball."""
    found = vm.spectrum(shells, DUST, incl=30, frequencies=FREQUENCIES, distance=1 * u.pc)
    assert found.unit == "Jy"
    np.testing.assert_allclose(found.flux, flux_of_ball(), rtol=1e-3)
    near = vm.spectrum(shells, DUST, frequencies=FREQUENCIES, distance=0.1 * u.pc)
    np.testing.assert_allclose(near.flux, 100.0 * found.flux, rtol=1e-3)


def test_an_aperture(shells):
    """A circle of 0.4 of the ball's radius, as an angle and as a length."""
    distance = 10 * u.pc
    radius = 0.4 * RADIUS
    angle = np.arctan(radius / (10 * PARSEC)) * u.rad
    expected = flux_of_ball(within=radius, distance=10 * PARSEC)
    for aperture in (angle.to("arcsec"), radius * u.cm):
        found = vm.spectrum(
            shells, DUST, frequencies=FREQUENCIES, aperture=aperture, distance=distance
        )
        np.testing.assert_allclose(found.flux, expected, rtol=1e-3)


def test_a_frame_around_a_cube(cube):
    """Seen along an axis: a slab's intensity on the area of a face."""
    alpha = DENSITY * KAPPA.absorption(FREQUENCIES)
    intensity = CODATA.planck(FREQUENCIES, TEMPERATURE) * -np.expm1(-alpha * RADIUS)
    found = vm.spectrum(cube, DUST, frequencies=FREQUENCIES, distance=1 * u.pc)
    np.testing.assert_allclose(found.flux, JANSKYS * intensity * (RADIUS / PARSEC) ** 2, rtol=1e-3)
    # Seen at an angle the flux does not depend on how it is turned in the picture.
    turned = [
        vm.spectrum(
            cube,
            DUST,
            vm.Orthographic(50, 20, posang, width=2 * RADIUS, resolution=64),
            frequencies=FREQUENCIES,
            distance=1 * u.pc,
        ).flux
        for posang in (0, 35)
    ]
    np.testing.assert_allclose(*turned, rtol=1e-3)


def test_thin_dust_weighs_what_its_flux_says(cube):
    """F = M κ B / d² where the optical depth is small."""
    thin = vm.Dust("1e-6 * rho", TEMPERATURE, KAPPA)
    found = vm.spectrum(cube, thin, incl=50, phi=20, frequencies=FREQUENCIES, distance=1 * u.pc)
    mass = 1e-6 * DENSITY * RADIUS**3
    expected = mass * KAPPA.absorption(FREQUENCIES) * CODATA.planck(FREQUENCIES, TEMPERATURE)
    np.testing.assert_allclose(found.flux, JANSKYS * expected / PARSEC**2, rtol=1e-3)


@pytest.mark.parametrize("shape", ["rings", "frame"])
def test_a_star_adds_its_flux(shape, shells, cube):
    """π R² B / d², through what is in front of it: half of the ball, or of the cube."""
    volume = shells if shape == "rings" else cube
    radius, hot = 1e9, 5000.0
    star = vm.Stars([(0.0, 0.0, 0.0)], [vm.Blackbody(hot)], luminosities=[np.pi * radius**2])
    dark, lit = (
        vm.spectrum(
            volume, DUST, frequencies=FREQUENCIES, objects=objects, tolerance=1e-3, distance="1 pc"
        ).flux
        for objects in ([], [star])
    )
    half = RADIUS if shape == "rings" else 0.5 * RADIUS
    through = np.exp(-DENSITY * KAPPA.absorption(FREQUENCIES) * half)
    surface = JANSKYS * np.pi * radius**2 * CODATA.planck(FREQUENCIES, hot) / PARSEC**2
    np.testing.assert_allclose(lit - dark, surface * through, rtol=2e-3)


def test_rings_of_one_ray(shells):
    """Rings are annuli: a medium of constant brightness has the flux of the circle."""
    rings = Rings(np.linspace(0.0, 0.5, 6) * RADIUS, None, 8)
    assert rings.areas.sum() * 8 == pytest.approx(np.pi * (0.5 * RADIUS) ** 2)
    fine = rings.finer()
    assert fine.resolution == (16, 10)
    assert fine.areas.sum() * 16 == pytest.approx(np.pi * (0.5 * RADIUS) ** 2)
    image = vm.render(shells, vm.Coefficients("1", 0), rings, scheme="first-order")
    radii = np.sqrt(rings.squares[1::2])
    expected = 2.0 * np.sqrt(RADIUS**2 - radii**2)
    outside = radii > 1e-3 * RADIUS
    np.testing.assert_allclose(
        image.intensity[outside, :, 0], np.tile(expected[:, None], 8)[outside], rtol=1e-5
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"distance": -1 * u.pc}, "distance must be positive"),
        ({"distance": None}, "needs the distance of the observer"),
        ({"camera": vm.Orthographic(), "incl": 30}, "give a camera, which has its angles"),
        ({"camera": vm.Orthographic(), "phi": 0 * u.deg}, "give a camera, which has its angles"),
        ({"aperture": 0 * u.arcsec}, "aperture must be a positive angle or length"),
        ({"camera": vm.Perspective((0, 0, -9e13), (0, 0, 0))}, "picture of a vm.Orthographic"),
        ({"camera": vm.Orthographic(), "aperture": 1 * u.arcsec}, "give one of them"),
    ],
)
def test_what_cannot_be_is_refused(arguments, message, cube):
    with pytest.raises(vm.InputError, match=message):
        vm.spectrum(cube, DUST, frequencies=FREQUENCIES, **{"distance": 1 * u.pc, **arguments})


def test_a_tolerance_that_is_not_kept_warns(cube):
    far = vm.Orthographic(50, 20, width=6 * RADIUS, resolution=512)
    with pytest.warns(UserWarning, match="fluxes still change"):
        vm.spectrum(cube, DUST, far, frequencies=FREQUENCIES, tolerance=1e-6, distance=1 * u.pc)


def test_a_star_where_dust_is_dark():
    """At 0.3 micron dust of 10 K is 1e-2000 of a star, whose flux is all there is."""
    edges = np.linspace(-0.5, 0.5, 3) * RADIUS
    grid = vm.CartesianGrid(edges, edges, edges, unit="cm")
    haze = vm.Volume(grid, rho=np.full(grid.shape, 1e-24) * u.g / u.cm**3)
    star = vm.Stars([(0.0, 0.0, 0.0)], [vm.Blackbody(5000.0)], radii=1e9, points=True)
    waves = [0.3, 1.0, 870.0]
    found = vm.spectrum(
        haze,
        vm.Dust("rho", 10.0, KAPPA),
        wavelengths=waves,
        objects=star,
        tolerance=None,
        distance=1 * u.pc,
    )
    expected = (
        JANSKYS * np.pi * 1e18 * CODATA.planck(2.99792458e14 / np.array(waves), 5000.0) / PARSEC**2
    )
    np.testing.assert_allclose(found.flux, expected, rtol=1e-4)


def test_a_bright_centre_of_an_octree():
    """Cells of 1/500 of the domain hold most of the light: pixels of 1/64 miss them."""
    edges = np.linspace(-0.5, 0.5, 5) * RADIUS

    def near(x, y, z, size):
        return np.sqrt(x**2 + y**2 + z**2) < 2.0 * size

    grid = vm.OctreeGrid.from_function(edges, edges, edges, near, 7, unit="cm")
    radius = np.linalg.norm(np.array(grid.cell_centers(0, grid.size)), axis=0).reshape(grid.shape)
    density = 1e-20 * (1.0 + 1e6 * (radius < 0.004 * RADIUS))
    volume = vm.Volume(grid, rho=density * u.g / u.cm**3)
    found = vm.spectrum(
        volume,
        DUST,
        incl=30,
        frequencies=FREQUENCIES,
        scheme="first-order",
        tolerance=1e-2,
        distance=1 * u.pc,
    )
    mass = float(np.sum(density * grid.cell_volumes))
    expected = mass * KAPPA.absorption(FREQUENCIES) * CODATA.planck(FREQUENCIES, TEMPERATURE)
    np.testing.assert_allclose(found.flux, JANSKYS * expected / PARSEC**2, rtol=1e-2)


def test_a_spectrum_has_the_unit_of_a_cube_s_total(cube):
    """The same picture, summed by both."""
    camera = vm.Orthographic(50, 20, width=2 * RADIUS, resolution=32)
    how = {"frequencies": FREQUENCIES, "distance": 10 * u.pc}
    total = vm.observe(cube, DUST, camera, **how).total()
    found = vm.spectrum(cube, DUST, camera, tolerance=None, **how)
    # Without a tolerance another scheme draws it, to 1e-4 of the brightest pixel.
    np.testing.assert_allclose(found.flux, total.flux, rtol=1e-3)
    assert found.unit == total.unit == "Jy"
    assert found.distance == pytest.approx(10 * PARSEC)
