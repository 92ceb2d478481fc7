"""Native files: every grid comes back bit for bit, with all that is known of the fields."""

from __future__ import annotations

import json

import h5py
import numpy as np
import pytest
from astropy import units as u
from astropy.wcs import WCS
from hypothesis import given, settings
from hypothesis import strategies as st

import voluminous as vm
from contracts import ReaderContract
from random_trees import random_flags
from voluminous.units import parse_unit

DTYPES = ("f4", "f8", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "?")
# The last has more digits than astropy shows.
UNITS = (None, "cm", "0.5 kpc", "1e-17 erg / (s cm2)", 0.12345678901234567 * u.pc)
LENGTHS = (None, "cm", "0.5 kpc", 0.12345678901234567 * u.pc)
META = {"a": [None, True, 3], "é": {"b": 1e-300, "c": "text"}, "": [[], -0.5]}


def edges(rng, low=-5.0, high=5.0):
    """Return strictly increasing edges of any spacing between two numbers, ends included."""
    ends = np.cumsum(rng.uniform(0.1, 1.0, rng.integers(1, 5)))
    return np.concatenate([[low], low + (high - low) * ends[:-1] / ends[-1], [high]])


def patches(rng):
    """Patches on any base cells; the later ones anywhere in those before."""
    walls = [edges(rng) for _ in range(3)]
    ratios = rng.integers(1, 5, (2, 3))
    level, low, shape = [0], [np.zeros(3, int)], [np.array([len(e) - 1 for e in walls])]
    for _ in range(5):
        parent = rng.integers(len(level))
        if level[parent] < len(ratios):
            first = rng.integers(0, shape[parent])
            end = rng.integers(first + 1, shape[parent] + 1)
            low.append((low[parent] + first) * ratios[level[parent]])
            shape.append((end - first) * ratios[level[parent]])
            level.append(level[parent] + 1)
    return vm.PatchGrid.from_boxes(*walls, level, low, shape, ratios)


def loose_patches(rng):
    """Patches that the coarsest cells do not tile: 3 finest cells beside 2 coarse ones."""
    corner, width = rng.uniform(-1e3, 1e3, 3), 10 ** rng.uniform(-3, 3)
    lower, upper = np.array([[0, 0, 0], [4, 0, 0]]), np.array([[4, 4, 2], [7, 3, 2]])
    shape = [[2, 2, 1], [3, 3, 2]]
    return vm.PatchGrid(corner + width * lower, corner + width * upper, shape, unit="au")


def curvilinear(rng, kind, refined):
    mirror, first, around = bool(rng.integers(2)), rng.uniform(-3, 3), rng.choice([2 * np.pi, 1.0])
    phi = np.linspace(first, first + around, rng.choice([2, 5]))
    walls, options = [edges(rng, rng.uniform(0, 1), 9.0), phi, edges(rng)], {}
    if kind is vm.SphericalGrid:
        theta = edges(rng, rng.uniform(0, 1), np.pi / 2 if mirror else rng.uniform(2, np.pi))
        walls, options = [walls[0], theta, phi], {"mirror": mirror}
    options["unit"] = parse_unit(rng.choice(np.array(LENGTHS, object)))
    grid = kind(*walls, **options)
    if not refined:
        return grid
    split = kind(*walls, refined=np.zeros(grid.size, int), **options).places.axes
    flags = random_flags(grid.size, 1 << len(split), seed=int(rng.integers(99)))
    return kind(*walls, refined=flags, **options)


def octree(rng):
    walls = [edges(rng) for _ in range(3)]
    bases = int(np.prod([len(w) - 1 for w in walls]))
    flags = random_flags(bases, 8, seed=int(rng.integers(99)))
    return vm.OctreeGrid(*walls, flags, unit=parse_unit(rng.choice(np.array(LENGTHS, object))))


GRIDS = {
    "cartesian": lambda rng: vm.CartesianGrid(*(edges(rng) for _ in range(3)), unit="0.5 kpc"),
    "octree": octree,
    "patches": patches,
    "loose patches": loose_patches,
    "spherical": lambda rng: curvilinear(rng, vm.SphericalGrid, False),
    "cylindrical": lambda rng: curvilinear(rng, vm.CylindricalGrid, False),
    "refined spherical": lambda rng: curvilinear(rng, vm.SphericalGrid, True),
    "refined cylindrical": lambda rng: curvilinear(rng, vm.CylindricalGrid, True),
}


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


@pytest.mark.parametrize("compress", [False, True])
@pytest.mark.parametrize("kind", GRIDS)
def test_what_was_saved_comes_back_bit_for_bit(tmp_path, kind, compress):
    for seed in range(6):
        rng = np.random.default_rng(seed)
        grid = GRIDS[kind](rng)
        volume, path = vm.Volume(grid), tmp_path / f"{seed}.h5"
        for k, dtype in enumerate(DTYPES):
            bits = rng.integers(0, 256, (grid.size, np.dtype(dtype).itemsize), np.uint8)
            values = bits.view(dtype) if dtype != "?" else bits > 99  # NaN and -0.0, too
            volume[f"field_{dtype.replace('?', 'bool')}"] = values.reshape(grid.shape)
            volume.set_unit(volume.fields[-1], UNITS[k % len(UNITS)])
        volume.meta.update(META)
        volume.save(path, compress=compress)
        again = vm.open(path)
        assert_same(again, volume)
        again.save(path)  # onto itself
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
        assert dict(file.attrs)["format"] == b"voluminous volume"
        assert file.attrs["version"] == 1
        assert set(file) == {"grid", "fields", "meta"}
        assert file["grid"].attrs["type"] == b"octree"
        assert file["grid"].attrs["unit"] == b"pc"
        assert b"children of a cell" in file["grid"].attrs["order"]
        np.testing.assert_array_equal(file["grid/levels"], [0] + 8 * [1])
        np.testing.assert_array_equal(file["grid/x"], [0, 1, 2])
        np.testing.assert_array_equal(file["fields/density"], np.arange(9.0))
        assert file["fields/density"].attrs["units"] == b"g / cm3"
        assert json.loads(file["meta"].asstr()[()]) == {"time": 1.5}


def test_large_fields_stay_in_the_file(tmp_path):
    volume = vm.models.sphere(8)
    volume.save(tmp_path / "plain.h5")
    volume.save(tmp_path / "packed.h5", compress=True)
    opened = vm.io.registry.open_lazily(tmp_path / "plain.h5")
    assert opened.waiting == volume.fields
    packed = vm.io.registry.open_lazily(tmp_path / "packed.h5")
    size = sum(volume.array(name).nbytes for name in volume.fields)
    assert opened.bytes_waiting == packed.bytes_waiting == size
    box = (0, 2, 4), (4, 4, 8)
    np.testing.assert_array_equal(
        opened.store.read("inside", *box), volume.store.read("inside", *box)
    )
    assert opened.waiting == volume.fields


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
