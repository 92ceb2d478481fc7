"""Volumes: fields, their types and units, derived fields, and what they refuse."""

from __future__ import annotations

import json
import pickle

import numpy as np
import pytest
from astropy import units as u
from hypothesis import given
from hypothesis import strategies as st

import voluminous as vm
from voluminous.deferred import Deferred

GRID = vm.CartesianGrid([0.0, 1.0, 3.0], [0.0, 1.0, 2.0, 3.0], [-1.0, 0.0, 1.0, 2.0, 4.0])
SHAPE = (2, 3, 4)
COUNTED = np.arange(24).reshape(SHAPE)


def depth_of(volume, name):
    """Return the optical depth of a field as extinction, along z."""
    camera = vm.Orthographic(width=(3, 3), resolution=(6, 6))
    image = vm.render(
        volume, vm.Coefficients("0", name), camera, scheme="first-order", precision="double"
    )
    return image.optical_depth[..., 0].T[::2, ::2]


TYPES = "f4", "f8", "f2", "g", "i1", "u1", "i2", "i4", "u4", "i8", "u8", ">f4", ">f8", ">i4", "?"


@pytest.mark.parametrize("dtype", TYPES)
def test_every_kind_of_number_renders_as_its_value(dtype):
    values = COUNTED.astype(dtype)
    expected = (values.astype(float) * np.diff(GRID.edges[2])).sum(axis=2)
    # The pixels' columns: x cells are 1 and 2 wide.
    depth = depth_of(vm.Volume(GRID, a=values), "a")
    np.testing.assert_allclose(depth, expected[[0, 1, 1]], rtol=1e-14)


def test_contiguous_arrays_are_not_copied():
    for dtype in ("f4", "f8", "i4", "u1", "?"):
        array = COUNTED.astype(dtype)
        assert np.shares_memory(vm.Volume(GRID, a=array).array("a"), array)
    quantity = COUNTED.astype(float) * u.K
    assert np.shares_memory(vm.Volume(GRID, a=quantity).array("a"), quantity.value)


def test_any_layout_has_the_same_values():
    values = COUNTED.astype(float)
    strided, reversed_ = np.repeat(values, 2, axis=2)[..., ::2], values[::-1].copy()[::-1]
    for array in (np.asfortranarray(values), strided, reversed_, COUNTED.tolist()):
        volume = vm.Volume(GRID, a=array)
        np.testing.assert_array_equal(volume["a"], COUNTED)
        assert volume.array("a").flags.c_contiguous


def test_fields_are_read_only_and_read_only_arrays_are_taken():
    frozen = COUNTED.astype(float)
    frozen.setflags(write=False)
    volume = vm.Volume(GRID, a=frozen)
    with pytest.raises(ValueError, match="read-only"):
        volume["a"][0, 0, 0] = 1
    depth_of(volume, "a")
    own = COUNTED.astype(float)
    vm.Volume(GRID, a=own)
    own[0, 0, 0] = 7  # the caller's array stays the caller's


def test_mapping_and_keywords():
    volume = vm.Volume(GRID, {"a": COUNTED, "b": COUNTED * u.K}, c=COUNTED)
    assert volume.fields == ("a", "b", "c")
    assert list(volume) == ["a", "b", "c"]
    assert len(volume) == 3
    assert "a" in volume
    assert "d" not in volume
    assert volume.units == {"a": "", "b": "K", "c": ""}
    assert volume["b"].unit == u.K
    assert "b (float64 K)" in repr(volume)
    assert "no fields" in repr(vm.Volume(GRID))
    told = volume.describe()
    assert json.loads(json.dumps(told)) == told
    assert told["fields"]["b"] == {"dtype": "float64", "unit": "K"}


def test_deletion_and_replacement():
    volume = vm.Volume(GRID, a=COUNTED, b=COUNTED * u.K)
    del volume["b"]
    assert volume.fields == ("a",)
    volume["a"] = 2 * COUNTED
    np.testing.assert_array_equal(volume["a"], 2 * COUNTED)
    with pytest.raises(vm.errors.UnknownNameError, match="unknown field 'b'"):
        del volume["b"]
    with pytest.raises(KeyError):
        volume["b"]


def test_derived_fields_use_fields_and_coordinates():
    volume = vm.Volume(GRID, density=1.0 + COUNTED)
    volume["logn"] = "log10(density)"
    np.testing.assert_allclose(volume["logn"], np.log10(1 + COUNTED), rtol=1e-15)
    volume["place"] = "x + 10*y + 100*z"
    x, y, z = np.meshgrid(*GRID.centers, indexing="ij")
    np.testing.assert_allclose(volume["place"], x + 10 * y + 100 * z, rtol=1e-15)
    volume["again"] = "logn*r"
    expected = np.log10(1 + COUNTED) * np.sqrt(x**2 + y**2 + z**2)
    np.testing.assert_allclose(volume["again"], expected, rtol=1e-15)
    volume["constant"] = "3"
    np.testing.assert_array_equal(volume["constant"], np.full(SHAPE, 3.0))


def test_single_precision_stays_single():
    volume = vm.Volume(GRID, a=COUNTED.astype("f4"))
    volume["b"] = "2*a + 1"
    assert volume["b"].dtype == np.float32
    volume["c"] = "2*a + x"
    assert volume["c"].dtype == np.float64


def test_large_volumes_are_evaluated_in_parts():
    counted = np.arange(130.0**3).reshape(130, 130, 130)
    volume = vm.Volume(vm.CartesianGrid.uniform(130, (-1, 1)), a=counted)
    np.testing.assert_array_equal(volume.evaluate("a*2 + x*0"), 2.0 * counted)


@given(st.sampled_from(["pc", "cm", "km", "K", "g / cm3", "1 / cm"]), st.floats(1e-3, 1e3))
def test_units_come_back(unit, factor):
    quantity = factor * COUNTED * u.Unit(unit)
    volume = vm.Volume(GRID, a=quantity)
    assert (volume["a"] == quantity).all()
    volume.set_unit("a", "K")
    np.testing.assert_array_equal(volume["a"].value, quantity.value)
    assert volume["a"].unit == u.K
    volume.set_unit("a", None)
    assert not hasattr(volume["a"], "unit")


def test_coordinates_have_the_unit_of_the_grid():
    grid = vm.CartesianGrid.uniform(2, (-1, 1), unit="pc")
    volume = vm.Volume(grid, a=np.ones(grid.shape))
    assert volume.unit == u.pc
    assert volume.field_unit("r") == u.pc
    assert volume.field_unit("a") is None
    assert vm.Volume(GRID).unit is None


@pytest.mark.parametrize(
    ("name", "value", "told"),
    [
        (
            "a",
            np.zeros((4, 3, 2)),
            r"shape \(4, 3, 2\), expected the grid's \(2, 3, 4\); transpose",
        ),
        ("a", np.zeros(24), r"shape \(24,\).*; reshape it"),
        ("a", np.zeros((3, 4, 5)), "made of the walls of cells"),
        ("a", np.zeros((*SHAPE, 3)), "each component a field of its own, such as a_x"),
        ("a", [[1, 2], [3]], "'a' must be an array of numbers: "),
        ("a", 3.0, r"shape \(\)"),
        ("a", np.zeros(SHAPE, dtype=complex), "real numbers.*imaginary"),
        ("a", np.full(SHAPE, "x"), "real numbers"),
        ("a", np.full(SHAPE, None), "real numbers"),
        ("two words", COUNTED, "must be an identifier"),
        ("if", COUNTED, "must be an identifier"),
        ("1a", COUNTED, "must be an identifier"),
        ("", COUNTED, "must be an identifier"),
        (3, COUNTED, "must be an identifier"),
        ("x", COUNTED, "'x' is reserved"),
        ("r", COUNTED, "'r' is reserved"),
        ("log10", COUNTED, "'log10' is reserved"),
        ("pi", COUNTED, "'pi' is reserved"),
    ],
)
def test_fields_that_cannot_be(name, value, told):
    volume = vm.Volume(GRID)
    with pytest.raises(vm.InputError, match=told):
        volume[name] = value
    assert not volume.fields
    with pytest.raises(vm.InputError, match="the unit of length is the grid's"):
        vm.Volume(GRID, density=COUNTED, unit="pc")


def test_unknown_field_names_the_nearest():
    volume = vm.Volume(GRID, density=COUNTED)
    for act in (lambda: volume["densty"], lambda: volume.evaluate("log10(densty)")):
        with pytest.raises(vm.errors.UnknownNameError, match="did you mean 'density'"):
            act()


def test_names_are_those_that_expressions_know():
    volume = vm.Volume(GRID, {"ﬁeld": COUNTED})  # the ligature fi, which Python normalises
    assert volume.fields == ("field",)
    np.testing.assert_array_equal(volume.evaluate("ﬁeld"), COUNTED)


def test_derived_fields_have_the_unit_of_their_expression():
    grid = vm.CartesianGrid.uniform(2, (0, 1), unit="pc")
    volume = vm.Volume(grid, rho=np.ones(grid.shape))
    volume.set_unit("rho", "g cm-3")
    volume["half"] = "rho / 2"
    volume["far"] = "2 * r"
    volume["exponent"] = "log10(rho)"
    assert volume.units == {
        "rho": "g / cm3",
        "half": "g / cm3",
        "far": "pc",
        "exponent": "dex(g / cm3)",
    }


def test_arrays_that_nobody_else_has_need_not_be_hashed():
    own = COUNTED.astype(np.float32)
    volume = vm.Volume(GRID, a=own, b="a", c="2*a")
    before = {name: volume.digest(name) for name in volume}
    assert len(set(before.values())) == 3
    own[0, 0, 0] += 1  # of the user, who may: what was computed of it is as it was
    assert own.flags.writeable
    now = {name: volume.digest(name) for name in volume}
    assert now["a"] != before["a"]
    assert (now["b"], now["c"]) == (before["b"], before["c"])
    volume["c"] = "2*a"  # another array, whatever is in it
    assert volume.digest("c") != before["c"]
    assert pickle.loads(pickle.dumps(volume)).array("c")[0, 0, 0] == 2 * own[0, 0, 0]


def test_nothing_is_taken_of_what_others_hold():
    base = np.zeros((2, *SHAPE))
    volume = vm.Volume(GRID)
    volume["deferred"] = Deferred(lambda: base[0], "f8")
    volume["given"] = base[1]
    volume.load()
    assert base.flags.writeable
    before = [volume.digest(name) for name in ("deferred", "given")]
    base += 1
    assert all(a != volume.digest(n) for a, n in zip(before, ("deferred", "given"), strict=True))


def test_files_that_a_user_has_mapped_may_change(tmp_path):
    np.save(tmp_path / "mapped.npy", COUNTED)
    opened = vm.open(tmp_path / "mapped.npy")
    mapped = vm.Volume(GRID, a=np.load(tmp_path / "mapped.npy", mmap_mode="r+"))
    mapped.own()
    before = mapped.digest("a"), opened.digest("mapped")
    writer = np.load(tmp_path / "mapped.npy", mmap_mode="r+")
    writer[0, 0, 0] += 1
    assert mapped.digest("a") != before[0]
    assert opened.digest("mapped") == before[1]
    np.testing.assert_array_equal(opened.array("mapped"), COUNTED)


@pytest.mark.parametrize("resolution", [-4, 0, 1, 7, 2.5])
def test_a_core_of_cells_that_cannot_be_is_refused(resolution):
    with pytest.raises(vm.InputError, match=r"positive whole numbers|must be even, got [17]"):
        vm.models.prestellar_core(resolution)


def test_more_cells_than_fit_into_memory_are_refused():
    with pytest.raises(vm.errors.MemoryNeededError, match=r"a grid of 1\d+ x 1 x 1 cells needs"):
        vm.CartesianGrid.uniform((10**21, 1, 1), (0, 1))


@pytest.mark.parametrize("name", ["grid", "unit", "units", "density", "fields"])
def test_attributes_of_a_volume_are_not_assigned(name):
    grid = vm.CartesianGrid.uniform(2, (0, 1), unit="pc")
    volume = vm.Volume(grid, density=np.ones(grid.shape))
    with pytest.raises(vm.errors.ImmutableError, match=f"Volume.{name} cannot be assigned"):
        setattr(volume, name, "cm")
    volume.meta = {"time": 1.0}
    assert volume.grid is grid
    assert volume.fields == ("density",)


def test_a_pickled_volume_is_equal_and_its_fields_have_numbers_of_their_own():
    grid = vm.CartesianGrid.uniform((4, 3, 2), (-1, 1), unit="pc")
    volume = vm.Volume(grid, density=np.arange(24.0).reshape(grid.shape))
    volume.own()
    other = pickle.loads(pickle.dumps(volume))
    assert np.array_equal(other.array("density"), volume.array("density"))
    assert other.field_unit("density") == volume.field_unit("density")
    assert not other.array("density").flags.writeable
    # Caches take equal numbers for equal contents.
    assert other.digest("density") != volume.digest("density")
