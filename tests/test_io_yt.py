"""Data sets of yt on their own cells: checked cell by cell against yt itself."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from astropy import units as u
from hypothesis import given, settings
from hypothesis import strategies as st

import voluminous as vm
from voluminous.io.axes import round_unit
from voluminous.io.leaves import ABSENT, placed_values, tree_of_leaves

yt = pytest.importorskip("yt")
yt.set_log_level(50)
# astropy's parsec differs from unyt's in the tenth digit.
CONSTANTS = 1e-9
# The units in which yt shows fields, as astropy names them.
SHOWN = {"g/cm**3": "g / cm3", "cm/s": "cm / s", "km/s": "km / s", "K": "K"}


def random_fields(shape, seed=0):
    rng = np.random.default_rng(seed)
    return {
        "density": (rng.uniform(1, 2, shape), "g/cm**3"),
        "velocity_x": (rng.normal(0, 1, shape), "km/s"),
        "velocity_y": (rng.normal(0, 1, shape), "km/s"),
        "velocity_z": (rng.normal(0, 1, shape), "km/s"),
        "temperature": (rng.uniform(1, 2, shape), "K"),
    }


def grids(boxes, seed=1):
    """Return what `yt.load_amr_grids` wants of (left, right, level, dimensions)."""
    found = []
    for k, (left, right, level, dims) in enumerate(boxes):
        place = {"left_edge": left, "right_edge": right, "level": level, "dimensions": dims}
        found.append({**place, **random_fields(dims, seed + k)})
    return found


def uniform(**options):
    return yt.load_uniform_grid(random_fields((4, 6, 8)), [4, 6, 8], **options)


BOX = np.array([[-1.0, 3.0], [2.0, 8.0], [0.5, 8.5]])
NESTED = [
    ([0, 0, 0], [1, 1, 1], 0, [8, 8, 8]),
    ([0.25, 0.25, 0.25], [0.75, 0.5, 0.75], 1, [8, 4, 8]),
    ([0.25, 0.5, 0.25], [0.75, 0.75, 0.5], 1, [8, 4, 4]),
    ([0.375, 0.3125, 0.375], [0.5, 0.4375, 0.5], 2, [4, 4, 4]),
]
PLANES = [([0, 0, 0], [1, 1, 1], 0, [8, 8, 1]), ([0.25, 0.5, 0], [0.5, 1, 1], 1, [4, 8, 1])]


def octree(zones=2, seed=3):
    """Return an octree whose root is split, then two of its children, then one of theirs."""
    mask = np.array([8, *_split([0, 2], [[], [5]])], np.uint8)
    leaves = int((mask == 0).sum()) * zones**3
    values = {
        ("gas", name): (v.reshape(-1, 1), unit)
        for name, (v, unit) in random_fields(leaves, seed).items()
    }
    return yt.load_octree(
        mask, values, bbox=BOX, num_zones=zones, partial_coverage=0, length_unit="pc"
    )


def _split(which, inner):
    flags = []
    for child in range(8):
        if child not in which:
            flags.append(0)
            continue
        flags.append(8)
        deeper = inner[which.index(child)]
        flags += _split(deeper, [[] for _ in deeper]) if deeper else [0] * 8
    return flags


DATASETS = {
    "uniform": (vm.CartesianGrid, lambda: uniform(bbox=BOX, length_unit="kpc")),
    "pieces": (vm.CartesianGrid, lambda: uniform(bbox=BOX, nprocs=8)),
    "uneven": (
        vm.CartesianGrid,
        lambda: uniform(
            cell_widths=[np.arange(1, 5) / 10, np.full(6, 1 / 6), np.arange(8, 0, -1) / 36]
        ),
    ),
    "nested": (
        vm.PatchGrid,
        lambda: yt.load_amr_grids(grids(NESTED), [8, 8, 8], length_unit="pc"),
    ),
    "by four": (
        vm.PatchGrid,
        lambda: yt.load_amr_grids(
            grids([NESTED[0], ([0.25] * 3, [0.5] * 3, 1, [8, 8, 8])]), [8, 8, 8], refine_by=4
        ),
    ),
    "flat": (vm.PatchGrid, lambda: yt.load_amr_grids(grids(PLANES), [8, 8, 1])),
    "holes": (vm.PatchGrid, lambda: yt.load_amr_grids(grids(NESTED[1:3]), [8, 8, 8])),
    "octree": (vm.OctreeGrid, octree),
    "octree of single cells": (vm.OctreeGrid, lambda: octree(1)),
    "octree of large octs": (vm.OctreeGrid, lambda: octree(4)),
}


@functools.cache  # yt takes half a second for each
def dataset(name):
    return DATASETS[name][1]()


def cartesian(ds, points):
    """Return x, y, z (n, 3) of places in yt's own coordinates: formulas from any textbook."""
    order = [str(name) for name in ds.coordinates.axis_order]
    at = {name: points[:, k] for k, name in enumerate(order)}
    geometry = str(ds.geometry)
    if geometry == "cartesian":
        return points
    if geometry in ("cylindrical", "polar"):
        return np.stack(
            [at["r"] * np.cos(at["theta"]), at["r"] * np.sin(at["theta"]), at["z"]], axis=1
        )
    if geometry == "spherical":
        r, theta, phi = at["r"], at["theta"], at["phi"]
    else:
        depth = geometry.startswith("internal")
        r = 60 - at["depth"] if depth else 50 + at["altitude"]
        theta, phi = np.radians(90 - at["latitude"]), np.radians(at["longitude"])
    across = r * np.sin(theta)
    return np.stack([across * np.cos(phi), across * np.sin(phi), r * np.cos(theta)], axis=1)


def check_cells(volume, data, ds, fields=("density", "velocity_x", "temperature")):
    """Compare all cells of a region, found by where yt says they are."""
    length = ds.quan(1, "code_length").to("cm").d / volume.grid.unit.to("cm")
    centers = cartesian(ds, data.fcoords.to("code_length").d) * length
    cells = volume.grid.locate(centers)
    assert (cells >= 0).all()
    assert len(np.unique(cells)) == len(cells)
    for name in fields:
        values = volume.array(name).reshape(-1)
        expected = data["gas", name]
        assert volume.units[name] == SHOWN[str(expected.units)]
        np.testing.assert_array_equal(values[cells], expected.d)
        assert np.isnan(values).sum() == values.size - len(cells)
    if str(ds.geometry) == "cartesian":
        volumes = data["gas", "cell_volume"].to("cm**3").d / volume.grid.unit.to("cm") ** 3
        np.testing.assert_allclose(volume.grid.cell_volumes.reshape(-1)[cells], volumes, rtol=1e-8)
    return cells


@pytest.mark.parametrize("name", DATASETS)
def test_every_cell_is_where_yt_has_it(name):
    ds = dataset(name)
    volume = vm.Volume.from_yt(ds)
    assert type(volume.grid) is DATASETS[name][0]
    cells = check_cells(volume, ds.all_data(), ds)
    if name != "holes":
        assert len(cells) == volume.grid.size
        np.testing.assert_allclose(
            volume.grid.bounds.T,
            [e.to(ds.length_unit).d for e in (ds.domain_left_edge, ds.domain_right_edge)],
            rtol=CONSTANTS,
            atol=1e-12,
        )


REGIONS = {
    "box": lambda ds, c, w: ds.box(c - 0.23 * w, c + 0.31 * w),
    "sphere": lambda ds, c, w: ds.sphere(c, 0.3 * w.min()),
    "corner": lambda ds, c, w: ds.box(c - 0.5 * w, c - 0.1 * w),
    "cut": lambda ds, c, w: ds.cut_region(ds.all_data(), ["obj['gas', 'density'] > 1.6"]),
    "slab": lambda ds, c, w: ds.r[:, float(c[1]) : float(c[1] + 0.2 * w[1]), :],
}


# yt itself makes no spheres in such octrees, and neither corners nor slabs in planes.
CANNOT = {("octree", "sphere"), ("flat", "corner"), ("flat", "slab")}


PARTS = [
    (name, region)
    for name in ("uniform", "pieces", "nested", "by four", "octree", "flat")
    for region in REGIONS
    if (name, region) not in CANNOT
]


@pytest.mark.parametrize(("name", "region"), PARTS)
def test_a_region_has_its_own_cells_only(name, region):
    ds = dataset(name)
    data = REGIONS[region](ds, ds.domain_center, ds.domain_width)
    volume = vm.Volume.from_yt(data, ["density", "velocity_x", "temperature"])
    cells = check_cells(volume, data, ds)
    # No larger than its cells need: the grid's ends are those of a cell, or of one that they halve.
    center, width = (v.to(ds.length_unit).d for v in (data.fcoords, data.fwidth))
    low, high = center - 0.5 * width, center + 0.5 * width
    ends = np.stack([low.min(axis=0), high.max(axis=0)], axis=1)
    widest = width.max(axis=0)
    assert (abs(volume.grid.bounds - ends).max(axis=1) < widest * (1 + 1e-6)).all()
    assert len(cells) <= volume.grid.size


AROUND = 2 * np.pi
GEOMETRIES = {
    "cylindrical": ("cylindrical", None, [[0.5, 2], [-1, 1], [0, AROUND]]),
    "polar": ("polar", None, [[0, 2], [0, AROUND], [-1, 1]]),
    "wedge": ("polar", None, [[1, 2], [0.3, 1.8], [-1, 1]]),
    "spherical": ("spherical", None, [[1, 2], [0, np.pi], [0, AROUND]]),
    "turned": ("spherical", ("phi", "theta", "r"), [[0, AROUND], [0.4, 1.5], [1, 2]]),
    "geographic": ("geographic", None, [[-90, 90], [-180, 180], [0, 10]]),
    "internal_geographic": ("internal_geographic", None, [[-60, 30], [-20, 80], [0, 10]]),
}


@pytest.mark.parametrize("name", GEOMETRIES)
def test_curvilinear_coordinates(name):
    geometry, order, box = GEOMETRIES[name]
    ds = uniform(geometry=geometry, axis_order=order, bbox=np.array(box, float))
    if "geographic" in geometry:
        ds.surface_height, ds.outer_radius = ds.quan(50, "code_length"), ds.quan(60, "code_length")
    volume = vm.Volume.from_yt(ds, ["density", "temperature"])
    assert len(check_cells(volume, ds.all_data(), ds, ["density", "temperature"])) == 192
    part = ds.cut_region(ds.all_data(), ["obj['gas', 'density'] > 1.5"])
    check_cells(vm.Volume.from_yt(part, ["density"]), part, ds, ["density"])


def test_sampled_arrays():
    ds = dataset("nested")
    for data in (
        ds.covering_grid(1, [0.25] * 3, [4, 6, 8]),
        ds.arbitrary_grid([0.1] * 3, [0.7] * 3, [5, 6, 7]),
    ):
        volume = vm.Volume.from_yt(data, "density", unit="pc")
        assert volume.grid.shape == tuple(data.ActiveDimensions)
        np.testing.assert_array_equal(volume.array("density"), data["gas", "density"].d)
        ends = np.stack([data.left_edge.d, data.right_edge.d], axis=1)
        np.testing.assert_allclose(volume.grid.bounds, ends, rtol=CONSTANTS)


def test_fields_go_by_many_names():
    ds = dataset("uniform")
    same = [
        vm.Volume.from_yt(ds, fields)
        for fields in (
            "density",
            ("gas", "density"),
            "gas/density",
            ["density"],
            [("gas", "density")],
            ds.fields.gas.density,
        )
    ]
    assert all(volume.fields == ("density",) for volume in same)
    assert vm.Volume.from_yt(ds, ("density", "temperature")).fields == ("density", "temperature")
    named = vm.Volume.from_yt(ds, {"rho": ("gas", "density"), "t": "temperature"})
    np.testing.assert_array_equal(named.array("rho"), same[0].array("density"))
    assert vm.Volume.from_yt(ds, ["velocity"]).fields == ("velocity_x", "velocity_y", "velocity_z")
    assert set(vm.Volume.from_yt(ds).fields) == set(random_fields(1))
    derived = vm.Volume.from_yt(ds, ["velocity_magnitude", "cell_mass"])
    speed = ds.all_data()["gas", "velocity_magnitude"].d
    np.testing.assert_array_equal(derived.array("velocity_magnitude").reshape(-1), speed)


def test_an_unknown_field_is_told_with_the_nearest():
    ds = dataset("uniform")
    with pytest.raises(vm.errors.UnknownNameError, match="did you mean 'density'") as failure:
        vm.Volume.from_yt(ds, "densty")
    assert len(str(failure.value)) < 400  # not all that yt derives


def test_units_of_lengths_and_fields():
    ds = dataset("uniform")
    volume = vm.Volume.from_yt(ds, "density", units={"density": "Msun/pc3"})
    assert str(volume.unit) == "kpc"
    assert volume.units["density"] == "solMass / pc3"
    expected = ds.all_data()["gas", "density"].to("Msun/pc**3").d
    # The Sun's mass differs in the fourth digit between unyt and astropy.
    np.testing.assert_allclose(volume.array("density").reshape(-1), expected, rtol=1e-3)
    in_pc = vm.Volume.from_yt(ds, "density", unit="pc")
    np.testing.assert_allclose(in_pc.grid.bounds, 1000 * volume.grid.bounds, rtol=CONSTANTS)
    with pytest.raises(vm.UnitsError, match="density"):
        vm.Volume.from_yt(ds, "density", units={"density": "K"})
    with pytest.raises(vm.errors.UnknownNameError):
        vm.Volume.from_yt(ds, "density", units={"temperature": "K"})


@pytest.mark.parametrize(
    ("width", "unit"),
    [("3 Mpc", "Mpc"), ("999 pc", "pc"), ("5 AU", "AU"), ("2 micron", "um"), ("1 cm", "cm")],
)
def test_the_unit_of_length_suits_the_domain(width, unit):
    assert str(round_unit(u.Quantity(width))) == unit


def test_what_is_no_volume_is_refused():
    ds = dataset("uniform")
    for data, told in ((ds.slice(0, 0.5), "three dimensions"), (3.0, "float")):
        with pytest.raises(vm.InputError, match=told):
            vm.Volume.from_yt(data)
    with pytest.raises(vm.InputError, match="no cells"):
        vm.Volume.from_yt(ds.cut_region(ds.all_data(), ["obj['gas', 'density'] > 5"]))
    connectivity = np.array([[0, 1, 2, 3, 4, 5, 6, 7]])
    corners = np.array([[i, j, k] for k in (0.0, 1) for j in (0.0, 1) for i in (0.0, 1)])
    mesh = yt.load_unstructured_mesh(
        connectivity, corners, elem_data={("connect1", "test"): np.ones((1, 1))}
    )
    with pytest.raises(vm.InputError, match="unstructured"):
        vm.Volume.from_yt(mesh)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10**6), axes=st.sampled_from([(0, 1, 2), (0, 1)]))
def test_leaves_with_holes_make_a_tree(seed, axes):
    """Random trees lose random leaves: the others keep their places and values."""
    rng = np.random.default_rng(seed)
    edges = [np.arange(3.0), np.linspace(0, np.pi, 3), np.linspace(0, AROUND, 2 + 1)]
    kind = vm.OctreeGrid
    if axes == (0, 1):
        kind, edges[2] = vm.SphericalGrid, np.array([0, AROUND])
    flags = _random_flags(rng, (len(edges[2]) - 1) * 4, 1 << len(axes))
    whole = kind(*edges, refined=flags)
    low, _ = whole.corners() if kind is vm.OctreeGrid else whole.spans()
    sizes = np.array([[e[1] - e[0]] for e in edges]) / np.where(
        np.isin(np.arange(3), axes)[:, None], 2.0**whole.levels, 1.0
    )
    start = np.array([[e[0]] for e in edges])
    index = np.round((low - start) / sizes).astype(int).T
    kept = rng.permutation(whole.size)[: rng.integers(1, whole.size + 1)]
    ratio = [2 if axis in axes else 1 for axis in range(3)]
    grid, source = tree_of_leaves(kind, edges, whole.levels[kept], index[kept], ratio)
    values = rng.uniform(1, 2, whole.size)
    field = placed_values(values[kept], source)
    centers = whole.cell_centers().T
    found = grid.locate(centers)
    expected = np.full(whole.size, np.nan)
    expected[kept] = values[kept]
    np.testing.assert_array_equal(field[found], expected)
    assert (source == ABSENT).sum() == np.isnan(field).sum()
    # Largest cells that fit: no siblings that could be one.
    assert grid.size <= whole.size


def _random_flags(rng, bases, children, depth=0):
    flags = []
    for _ in range(bases):
        split = depth < 3 and rng.random() < 0.35
        flags += [1, *_random_flags(rng, children, children, depth + 1)] if split else [0]
    return flags


def test_leaves_that_overlap_are_refused():
    edges = [np.arange(3.0)] * 3
    with pytest.raises(vm.InputError):
        tree_of_leaves(vm.OctreeGrid, edges, [0, 1], [[0, 0, 0], [1, 1, 1]])
