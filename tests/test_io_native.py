"""Native files: every grid comes back bit for bit, with all that is known of the fields."""

from __future__ import annotations

import json

import h5py
import numpy as np
import pytest
from astropy import units as u
from astropy.wcs import WCS
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import voluminous as vm
from contracts import ReaderContract
from random_trees import random_flags
from voluminous.io import find_reader
from voluminous.io.names import field_name
from voluminous.units import parse_unit

NAMES = st.from_regex(r"[a-z_][a-z0-9_]{0,8}", fullmatch=True).filter(
    lambda name: field_name(name) == name and name not in ("theta", "phi", "R")
)
DTYPES = ("f4", "f8", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "?")
# The last has more digits than astropy shows.
UNITS = (None, "cm", "pc", "0.5 kpc", "g / cm3", "1e-17 erg / (s cm2)", 0.12345678901234567 * u.pc)
META = st.dictionaries(
    st.text(max_size=8),
    st.recursive(
        st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(),
        lambda inner: st.lists(inner, max_size=3),
        max_leaves=4,
    ),
    max_size=3,
)


def edges(draw, low=-5.0, high=5.0, cells=3):
    """Return strictly increasing edges of any spacing between two numbers, ends included."""
    widths = draw(arrays(float, draw(st.integers(1, cells)), elements=st.floats(0.1, 1.0)))
    ends = np.concatenate([[0.0], np.cumsum(widths)])
    inner = low + (high - low) * ends[1:-1] / ends[-1]
    return np.concatenate([[low], inner, [high]])


def flags(draw, bases, children):
    """Return the split flags of a random tree, depth first."""
    return random_flags(bases, children, seed=draw(st.integers(0, 99)))


@st.composite
def cartesian(draw):
    return vm.CartesianGrid(
        *(edges(draw) for _ in range(3)), unit=parse_unit(draw(st.sampled_from(UNITS)))
    )


@st.composite
def octrees(draw):
    x, y, z = (edges(draw) for _ in range(3))
    bases = (len(x) - 1) * (len(y) - 1) * (len(z) - 1)
    return vm.OctreeGrid(
        x, y, z, flags(draw, bases, 8), unit=parse_unit(draw(st.sampled_from(UNITS)))
    )


@st.composite
def patches(draw):
    """Patches on any base cells; the later ones anywhere in those before."""
    walls = [edges(draw, cells=6) for _ in range(3)]
    ratios = draw(arrays(np.int64, (2, 3), elements=st.integers(1, 4)))
    rng = np.random.default_rng(draw(st.integers(0, 99)))
    level, low, shape = [0], [np.zeros(3, int)], [np.array([len(e) - 1 for e in walls])]
    for _ in range(draw(st.integers(0, 5))):
        parent = rng.integers(len(level))
        if level[parent] < len(ratios):
            first = rng.integers(0, shape[parent])
            end = rng.integers(first + 1, shape[parent] + 1)
            low.append((low[parent] + first) * ratios[level[parent]])
            shape.append((end - first) * ratios[level[parent]])
            level.append(level[parent] + 1)
    return vm.PatchGrid.from_boxes(*walls, level, low, shape, ratios)


@st.composite
def loose_patches(draw):
    """Patches that the coarsest cells do not tile: 3 finest cells beside 2 coarse ones."""
    corner = draw(arrays(float, 3, elements=st.floats(-1e3, 1e3)))
    width = draw(st.floats(1e-3, 1e3))
    lower, upper = np.array([[0, 0, 0], [4, 0, 0]]), np.array([[4, 4, 2], [7, 3, 2]])
    shape = [[2, 2, 1], [3, 3, 2]]
    return vm.PatchGrid(corner + width * lower, corner + width * upper, shape, unit="au")


@st.composite
def spherical(draw, refined=False):
    mirror = draw(st.booleans())
    theta = edges(draw, draw(st.floats(0, 1)), np.pi / 2 if mirror else draw(st.floats(2, np.pi)))
    first = draw(st.floats(-np.pi, np.pi))
    phi = edges(draw, first, first + draw(st.sampled_from([2 * np.pi, 1.0])))
    walls = (edges(draw, draw(st.floats(0, 1)), 9.0), theta, phi)
    return curvilinear(draw, vm.SphericalGrid, walls, refined, mirror=mirror)


@st.composite
def cylindrical(draw, refined=False):
    phi = edges(draw, 0.0, draw(st.sampled_from([2 * np.pi, 3.0])))
    walls = (edges(draw, draw(st.floats(0, 1)), 9.0), phi, edges(draw))
    return curvilinear(draw, vm.CylindricalGrid, walls, refined)


def curvilinear(draw, kind, walls, refined, **options):
    options["unit"] = parse_unit(draw(st.sampled_from(UNITS)))
    grid = kind(*walls, **options)
    if not refined:
        return grid
    azimuth = walls[2 if kind is vm.SphericalGrid else 1]
    assume(len(azimuth) == 2 or np.diff(azimuth).max() <= np.pi)  # wider ones are refused
    split = kind(*walls, refined=np.zeros(grid.size, int), **options).places.axes
    return kind(*walls, refined=flags(draw, grid.size, 1 << len(split)), **options)


GRIDS = st.one_of(
    cartesian(),
    octrees(),
    patches(),
    loose_patches(),
    spherical(),
    cylindrical(),
    spherical(refined=True),
    cylindrical(refined=True),
)


@st.composite
def volumes(draw):
    grid = draw(GRIDS)
    volume = vm.Volume(grid)
    for name in draw(st.lists(NAMES, unique=True, min_size=1, max_size=3)):
        if name not in volume.coordinates:
            volume[name] = draw(arrays(draw(st.sampled_from(DTYPES)), grid.shape))
            volume.set_unit(name, draw(st.sampled_from(UNITS)))
    volume.meta.update(draw(META))
    return volume


def assert_same_grid(mine, theirs):
    assert type(mine) is type(theirs)
    assert mine.describe() == theirs.describe()
    assert mine.unit == theirs.unit
    np.testing.assert_array_equal(mine.levels, theirs.levels)
    np.testing.assert_array_equal(mine.cell_centers(), theirs.cell_centers())
    for walls in ("edges", "base_edges", "fine_edges"):
        if hasattr(theirs, walls):
            for a, b in zip(getattr(mine, walls), getattr(theirs, walls), strict=True):
                np.testing.assert_array_equal(a, b)
    if isinstance(theirs, vm.PatchGrid):
        for name in ("sizes", "level", "low", "shape", "extent"):
            np.testing.assert_array_equal(
                getattr(mine.patches, name), getattr(theirs.patches, name)
            )


def assert_same(mine, theirs):
    assert_same_grid(mine.grid, theirs.grid)
    assert mine.fields == theirs.fields  # in their order, too
    assert mine.meta == theirs.meta
    for name in theirs.fields:
        a, b = mine.array(name), theirs.array(name)
        assert a.dtype == b.dtype
        assert mine.field_unit(name) == theirs.field_unit(name)
        assert a.tobytes() == b.tobytes()  # NaN, their payload, and -0.0


@settings(
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
    deadline=None,
)
@given(volume=volumes(), compress=st.booleans())
def test_what_was_saved_comes_back_bit_for_bit(tmp_path_factory, volume, compress):
    path = tmp_path_factory.mktemp("native") / "volume.h5"
    volume.save(path, compress=compress)
    again = vm.open(path)
    assert_same(again, volume)
    again.save(path)  # onto itself, while its numbers are mapped
    assert_same(vm.open(path), volume)
    assert_same(again, volume)


@given(unit=st.floats(1e-30, 1e30), power=st.integers(-3, 3))
@settings(deadline=None)
def test_units_keep_all_digits(unit, power):
    from voluminous.io.native.grids import exact_name

    known = u.Unit(unit * u.pc**power * u.g)
    assert parse_unit(exact_name(known)).scale == pytest.approx(known.scale, rel=1e-15)


def test_the_sky_comes_back(tmp_path):
    volume = vm.models.sphere(4)
    wcs = WCS(naxis=3)
    wcs.wcs.ctype = ["GLON-CAR", "GLAT-CAR", "VRAD"]
    wcs.wcs.crval = [159.123456789012345, -20.1, 1000 / 3]
    wcs.wcs.cdelt = [-1 / 120, 1 / 120, 200 / 7]
    wcs.wcs.cunit = ["deg", "deg", "m/s"]
    wcs.wcs.restfrq = 110.201354e9
    wcs.pixel_shape = (4, 4, 4)
    volume.wcs = wcs
    volume.save(tmp_path / "a.h5")
    again = vm.open(tmp_path / "a.h5").wcs
    places = np.random.default_rng(0).uniform(0, 4, (20, 3))
    np.testing.assert_array_equal(again.wcs_pix2world(places, 0), wcs.wcs_pix2world(places, 0))
    assert (again.pixel_shape, again.wcs.restfrq) == (wcs.pixel_shape, wcs.wcs.restfrq)


# The layout is a promise: h5py is enough to read it.


def test_the_file_explains_itself(tmp_path):
    grid = vm.OctreeGrid([0, 1, 2], [0, 1], [0, 1], [0, 1] + 8 * [0], unit="pc")
    volume = vm.Volume(grid, density=np.arange(9.0) * u.g / u.cm**3)
    volume.meta["time"] = 1.5
    volume.save(tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5") as file:
        assert dict(file.attrs)["format"] == "voluminous volume"
        assert file.attrs["version"] == 1
        assert set(file) == {"grid", "fields", "meta"}
        assert file["grid"].attrs["type"] == "octree"
        assert file["grid"].attrs["unit"] == "pc"
        assert "children of a cell" in file["grid"].attrs["order"]
        np.testing.assert_array_equal(file["grid/levels"], [0] + 8 * [1])
        np.testing.assert_array_equal(file["grid/x"], [0, 1, 2])
        np.testing.assert_array_equal(file["fields/density"], np.arange(9.0))
        assert file["fields/density"].attrs["units"] == "g / cm3"
        assert json.loads(file["meta"].asstr()[()]) == {"time": 1.5}


def test_files_of_before_still_open(tmp_path):
    # Version 0.1 wrote the edges and the fields side by side.
    path = tmp_path / "old.h5"
    with h5py.File(path, "w") as file:
        for axis in "xyz":
            file[axis] = np.linspace(-1, 1, 5)
            file[axis].attrs["units"] = "pc"
        file["density"] = np.ones((4, 4, 4), np.float32)
        file["density"].attrs["units"] = "1 / cm3"
    volume = vm.open(path)
    assert find_reader(path).name == "hdf5"
    assert (volume.unit, volume.units) == (u.pc, {"density": "1 / cm3"})
    np.testing.assert_array_equal(volume.grid.edges[0], np.linspace(-1, 1, 5))


def test_large_fields_stay_in_the_file(tmp_path):
    volume = vm.models.sphere(8)
    volume.save(tmp_path / "plain.h5")
    volume.save(tmp_path / "packed.h5", compress=True)
    opened = vm.io.registry.open_lazily(tmp_path / "plain.h5")
    assert opened.waiting == volume.fields
    assert opened.bytes_waiting == 0  # mapped: nothing to take memory for
    packed = vm.io.registry.open_lazily(tmp_path / "packed.h5")
    assert packed.bytes_waiting == sum(volume.array(name).nbytes for name in volume.fields)
    array = opened.array("inside")
    assert array.flags.aligned
    while array.base is not None and not isinstance(array, np.memmap):
        array = array.base
    assert isinstance(array, np.memmap)


# Damage


@pytest.mark.parametrize("kind", ["cartesian", "octree", "patches", "refined"])
class TestNative(ReaderContract):
    options: dict = {}  # noqa: RUF012

    @pytest.fixture
    def sample(self, kind):
        x = np.linspace(0, 1, 4)
        grid = {
            "cartesian": lambda: vm.CartesianGrid(x, x, x, unit="pc"),
            "octree": lambda: vm.OctreeGrid(x, x, x, 26 * [0] + [1] + 8 * [0]),
            "patches": lambda: vm.PatchGrid.from_boxes(
                x, x, x, [0, 1], [[0, 0, 0], [2, 2, 2]], [[3, 3, 3], [2, 2, 2]]
            ),
            "refined": lambda: vm.SphericalGrid(x, x, x, refined=26 * [0] + [1] + 8 * [0]),
        }[kind]()

        def write(directory):
            volume = vm.Volume(grid)
            volume["density"] = np.random.default_rng(0).random(grid.shape)
            volume.set_unit("density", "g / cm3")
            volume["count"] = np.arange(grid.size, dtype=np.int16).reshape(grid.shape)
            volume.meta["time"] = 1.0
            volume.save(directory / "volume.h5", compress=kind == "octree")
            return directory / "volume.h5"

        return write


@pytest.fixture
def saved(tmp_path):
    """A function that changes a saved file by h5py and returns its path."""
    path = tmp_path / "a.h5"
    grid = vm.PatchGrid([[0, 0, 0], [0, 0, 0]], [[4, 4, 4], [1, 1, 1]], [[4, 4, 4], [2, 2, 2]])
    vm.Volume(grid, density=np.ones(71)).save(path)

    def changed(change):
        with h5py.File(path, "r+") as file:
            change(file)
        return path

    return changed


def put(place, value):
    """Return a change that replaces a data set."""

    def change(file):
        del file[place]
        if value is not None:
            file[place] = value

    return change


def attribute(place, name, value):
    return lambda file: file[place].attrs.__setitem__(name, value)


def promise(file):
    del file["fields/density"]
    file.create_dataset("fields/density", (71, 2**40), "f8", chunks=(71, 1024))


CHANGES = {
    "version": (attribute("/", "version", 2), "version 2 .* expected 1"),
    "type": (attribute("grid", "type", "hexagons"), "'hexagons', expected cartesian"),
    "cells": (attribute("grid", "cells", 72), "makes 71 cells, but says 72"),
    "no shape": (put("grid/shape", None), "'patches' lacks 'shape'"),
    "huge": (put("grid/shape", [[4, 4, 2**40], [2, 2, 2]]), "a patch of 1.7.*e\\+13 cells"),
    "text": (put("grid/level", "level"), "/grid/level must be numbers"),
    "length": (put("fields/density", np.ones(70)), r"shape \(70,\), expected \(71,\)"),
    "promise": (promise, "promises values of shape .* but has 0 bytes"),
    "group": (put("fields", None), "expected a group /fields"),
    "outside": (
        put("fields/density", h5py.ExternalLink("b.h5", "/x")),
        "a data set /fields",
    ),
    "circle": (
        put("fields/density", h5py.SoftLink("/fields/density")),
        "a data set /fields",
    ),
    "no json": (lambda file: file.__setitem__("meta", "{"), "a.h5"),
    "no table": (lambda file: file.__setitem__("meta", "[1]"), "a table in JSON"),
    "number": (lambda file: file.__setitem__("wcs", 3), "/wcs must be a text"),
    "edges": (put("grid/x", [0.0, 1.0, 0.5]), "x edges must"),
    "unit": (attribute("grid", "unit", "parsnip"), "not a unit"),
}


@pytest.mark.parametrize("name", list(CHANGES))
def test_what_does_not_fit_is_named(saved, name):
    change, expected = CHANGES[name]
    with pytest.raises(vm.FileFormatError, match=expected) as failure:
        vm.open(saved(change))
    assert "a.h5" in str(failure.value)
