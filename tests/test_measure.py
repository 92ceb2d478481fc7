"""Totals: what cells, regions, conditions and parts of images hold."""

from __future__ import annotations

import re

import numpy as np
import pytest
from astropy import units as u

import voluminous as vm

RNG = np.random.default_rng(0)
EDGES = np.linspace(-1, 1, 21)


def near(x, y, z, size):
    return np.hypot(np.hypot(x, y), z) < 2 * size


GRIDS = {
    "cartesian": vm.CartesianGrid(EDGES, EDGES, EDGES, unit="pc"),
    "octree": vm.OctreeGrid.from_function(*[EDGES[::4]] * 3, near, 4, unit="pc"),
    "spherical": vm.SphericalGrid(
        np.linspace(0, 1.5, 20), np.linspace(0, np.pi, 12), np.linspace(0, 2 * np.pi, 17), unit="pc"
    ),
    "cylindrical": vm.CylindricalGrid(
        np.linspace(0, 1.5, 20), np.linspace(0, 2 * np.pi, 17), EDGES * 1.2, unit="pc"
    ),
}
QUANTITIES = {
    "mass": "density",
    "momentum": "density * los('velocity')",
    "energy": "0.5 * density * norm('velocity')**2",
}
CAMERA = vm.Orthographic(50, 30, 10, width=4, resolution=30)


def gas(kind="cartesian"):
    grid = GRIDS[kind]
    fields = {f"velocity_{a}": RNG.normal(size=grid.shape) * u.km / u.s for a in "xyz"}
    return vm.Volume(grid, density=(RNG.random(grid.shape) + 0.1) * u.g / u.cm**3, **fields)


@pytest.mark.parametrize("kind", GRIDS)
def test_totals_are_sums_over_cells(kind):
    volume = gas(kind)
    found = vm.measure(volume, QUANTITIES, camera=CAMERA)
    rho, volumes = volume.array("density"), volume.grid.cell_volumes
    parsec = (1 * u.pc).to_value(u.cm)
    assert found["mass"].unit == u.g
    assert found["mass"].value == pytest.approx((rho * volumes).sum() * parsec**3, rel=1e-12)
    square = sum(volume.array(f"velocity_{a}") ** 2 for a in "xyz")
    energy = (0.5 * rho * square * volumes).sum() * parsec**3 * u.g * (u.km / u.s) ** 2
    assert found["energy"].to_value(u.erg) == pytest.approx(energy.to_value(u.erg), rel=1e-12)
    assert found.volume.to_value("pc3") == pytest.approx(volumes.sum(), rel=1e-12)
    assert found.cells == volume.grid.size
    assert list(found) == list(QUANTITIES)


@pytest.mark.parametrize("kind", ["cartesian", "octree"])
def test_statistics_of_a_box_are_those_of_the_overlaps(kind):
    volume, chunks = gas(kind), {"memory": "1 GiB"}
    low, high = np.array([-0.83, -0.5, 0.211]), np.array([0.4, 0.77, 0.9])
    box = vm.regions.Box(low * u.pc, high * u.pc)
    centers, half = volume.grid.cell_centers(), 0.5 * volume.grid.cell_sizes()
    common = np.minimum(centers + half, high[:, None]) - np.maximum(centers - half, low[:, None])
    share = np.prod(np.clip(common, 0, None), axis=0)  # in pc³
    inside, rho = share > 1e-12, volume.array("density").ravel()
    for options in ({}, chunks):
        found = vm.measure(volume, "density", "density > 0.2 g/cm3", clip=box, **options)
        counts = inside & (rho > 0.2)
        assert found.cells == np.count_nonzero(counts)
        # Sums of a few thousand numbers, in another order.
        assert found.volume.to_value("pc3") == pytest.approx(share[counts].sum(), rel=1e-12)
        mean = np.average(rho[counts], weights=share[counts])
        assert found.means["density"].to_value("g/cm3") == pytest.approx(mean, rel=1e-12)
        assert found.minima["density"].to_value("g/cm3") == rho[counts].min()
        assert found.maxima["density"].to_value("g/cm3") == rho[counts].max()
    # Whole cells have no slivers of their neighbours.
    whole = vm.measure(volume, "density", clip=vm.regions.Box((-0.4, -1, 0), (0.6, 0.2, 0.4)))
    assert whole.volume.to_value("pc3") == pytest.approx(0.48, rel=1e-12)
    assert kind == "octree" or whole.cells == 10 * 12 * 4


def test_a_condition_chooses_cells():
    volume = gas()
    away = volume.evaluate("los('velocity')", camera=CAMERA)
    rho = volume.array("density")
    chosen = (away > 0.5) & (rho < 0.7)
    found = vm.measure(
        volume, "density", "los('velocity') > 500 m/s and density < 700 kg/m3", CAMERA
    )
    expected = (rho[chosen] * 1e-3).sum() * u.g / u.cm**3 * u.pc**3
    assert found["density"].to_value("Msun") == pytest.approx(expected.to_value("Msun"), rel=1e-12)
    assert found.cells == np.count_nonzero(chosen)


REGIONS = {
    "box": (vm.regions.Box((-0.33, -0.5, 0.01), (0.4, 0.5, 0.77)), 0.73 * 1.0 * 0.76),
    "sphere": (vm.regions.Sphere((0.1, 0, 0), 0.6 * u.pc), 4 / 3 * np.pi * 0.6**3),
    "cylinder": (
        vm.regions.Cylinder((-0.5, -0.3, 0), (0.4, 0.5, 0.2), 0.3),
        np.pi * 0.09 * np.sqrt(0.81 + 0.64 + 0.04),
    ),
    "cones": (
        vm.regions.DoubleCone((0, 0, 0), (1, 1, 2), 30, height=0.7),
        2 / 3 * np.pi / 3 * 0.7**3,
    ),
    "shell": (
        vm.regions.Sphere((0, 0, 0), 0.7) & ~vm.regions.Sphere((0, 0, 0), 0.5),
        4 / 3 * np.pi * (0.7**3 - 0.5**3),
    ),
}


@pytest.mark.parametrize("kind", GRIDS)
@pytest.mark.parametrize("name", REGIONS)
def test_volumes_of_regions(name, kind):
    region, expected = REGIONS[name]
    found = vm.measure(vm.Volume(GRIDS[kind]), {"one": "1"}, clip=region, samples=8)
    # Cells on the surface (0.4 wide in the octree) count to an eighth of their width; errors of
    # either sign cancel out, but not on faces that lie along walls.
    exact = 0.04 if kind == "octree" else 0.015
    assert found.volume.to_value("pc3") == pytest.approx(expected, rel=exact)


@pytest.mark.parametrize("kind", ["cartesian", "octree"])
def test_regions_thinner_than_a_cell_are_found(kind):
    one = {"one": "1"}
    # Nowhere near corners and middles of cells.
    start, end = np.array([-0.73, -0.61, -0.67]), np.array([0.57, 0.71, 0.49])
    needle = vm.regions.Cylinder(start, end, 0.03)
    bead = vm.regions.Sphere((0.237, 0.161, 0.223), 0.03)
    found = [
        vm.measure(vm.Volume(GRIDS[kind]), one, clip=region, samples=24).volume.to_value("pc3")
        for region in (needle, bead, needle | bead, ~bead, bead & ~needle)
    ]
    long, round_ = np.pi * 0.03**2 * np.linalg.norm(end - start), 4 / 3 * np.pi * 0.03**3
    whole = float(np.sum(GRIDS[kind].cell_volumes))
    # A part of a cell is a 24th wide: at most a quarter of the bead's diameter.
    expected = [long, round_, long + round_, whole - round_, round_]
    np.testing.assert_allclose(found, expected, rtol=0.1)


@pytest.mark.parametrize("kind", ["cartesian", "octree"])
def test_maps_add_up_to_the_totals(kind):
    volume = gas(kind)
    where, region = "los('velocity') > 0.1 km/s", REGIONS["cones"][0]
    plain = vm.measure(volume, QUANTITIES, where, CAMERA, clip=region)
    found = vm.measure(volume, QUANTITIES, where, CAMERA, clip=region, maps=True)
    for name, total in plain.items():
        assert found[name].value == pytest.approx(total.value, rel=1e-12)
        image = found.maps[name]
        area = np.prod(image.pixel_size) * u.pc**2
        summed = image.intensity.sum() * u.Unit(image.intensity_unit) * area
        assert summed.to_value(total.unit) == pytest.approx(total.value, rel=1e-12)
    assert found.volume.value == pytest.approx(plain.volume.value, rel=1e-12)


def test_an_aperture_is_a_part_of_the_image():
    volume = gas()
    whole = vm.measure(volume, "density", camera=CAMERA)["density"]
    left = np.zeros((30, 30), bool)
    left[:, :15] = True
    halves = [
        vm.measure(volume, "density", camera=CAMERA, aperture=part)["density"]
        for part in (left, ~left)
    ]
    assert sum(halves).value == pytest.approx(whole.value, rel=1e-12)
    polygon = [(-2, -2), (0, -2), (0, 2), (-2, 2)] * u.pc
    by_polygon = vm.measure(volume, "density", camera=CAMERA, aperture=polygon)["density"]
    assert by_polygon.value == pytest.approx(halves[0].value, rel=1e-12)


def test_a_table_over_angles():
    volume = gas()
    cameras = [vm.Orthographic(incl, 40, width=4, resolution=8) for incl in np.linspace(0, 180, 20)]
    table = vm.measure(volume, QUANTITIES, camera=cameras, maps=True)
    assert table.colnames == ["incl", "phi", "mass", "momentum", "energy", "volume", "cells"]
    assert len(table) == len(table.meta["maps"]) == 20
    mass = table["mass"].value
    np.testing.assert_allclose(mass, mass[0], rtol=1e-12)
    assert table["momentum"][0].value == pytest.approx(-table["momentum"][-1].value)
    assert table["incl"].unit == u.deg


def test_missing_values_are_counted():
    volume = gas()
    rho = volume.array("density").copy()
    rho[0, :, 0] = np.nan
    volume["density"] = rho * u.g / u.cm**3
    found = vm.measure(volume, QUANTITIES, camera=CAMERA)
    assert found.missing == {"mass": 20, "momentum": 20, "energy": 20}
    assert np.isfinite(found["mass"].value)


NOT_A_NUMBER = np.full(CAMERA.resolution[::-1], np.nan)


@pytest.mark.parametrize("quantities", ["mass", ["density", "mass"], {"m": "mass"}])
def test_names_of_totals_are_told_how_to_be_asked_for(quantities):
    volume = gas()
    with pytest.raises(vm.errors.UnknownNameError, match=re.escape("{'mass': 'density'}")):
        vm.measure(volume, quantities)
    volume["mass"] = volume["density"]  # unless there is a field of the name
    assert vm.measure(volume, quantities).volume > 0


SHAPE = GRIDS["cartesian"].shape


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"quantities": {}}, "say what to measure, such as quantities={'mass': 'density'}; fields"),
        ({"maps": True}, "give a camera"),
        ({"clip": 3}, "one of vm.regions"),
        ({"camera": 3}, "a camera, or a list of them"),
        ({"camera": [vm.Orthographic(), None]}, "number 1 is None"),
        ({"camera": CAMERA, "aperture": np.ones((3, 3))}, "aperture must be"),
        ({"camera": CAMERA, "aperture": NOT_A_NUMBER}, "from 0 to 1"),
        ({"camera": CAMERA, "aperture": [(0, 0), (1, np.nan), (1, 0)]}, "finite"),
        ({"quantities": "density * los('velocity')"}, "give a camera"),
        ({"samples": 0}, "samples must be a positive whole number"),
        ({"where": np.ones(SHAPE, bool)}, "put it into the volume"),
        ({"where": "density > 5 km/s"}, "'5 km / s' is in km / s, expected g / cm3"),
        ({"volume": np.ones((3, 3, 3))}, "need a Volume first, got ndarray"),
    ],
)
def test_what_makes_no_sense(asked, message):
    with pytest.raises(vm.InputError, match=message):
        vm.measure(**{"volume": gas(), "quantities": "density", **asked})


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: vm.regions.Sphere((0, 0), 1), "center must be three"),
        (lambda: vm.regions.Box((0, 0, 0), (1, 0, 1)), "low must be below high"),
        (lambda: vm.regions.Cylinder((0, 0, 0), (0, 0, 0), 1), "must differ"),
        (lambda: vm.regions.DoubleCone((0, 0, 0), (0, 0, 1), 20, side="left"), "side must be"),
        (lambda: vm.regions.Sphere((0, 0, 0), 1) & 3, "another region"),
    ],
)
def test_regions_that_make_no_sense(make, message):
    with pytest.raises(vm.InputError, match=message):
        make()
