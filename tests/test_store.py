"""Volumes in pieces: boxes are what the whole field has there, whatever they are read from."""

from __future__ import annotations

import numpy as np
import pytest

import voluminous as vm
from voluminous.deferred import Deferred, Pieces
from voluminous.store import level_factors, means

RNG = np.random.default_rng(3)
SHAPE = (9, 6, 5)
RHO = RNG.random(SHAPE, np.float32)


def assert_boxes(store, name, field):
    """Any box is the part of the field, in C order and of its type."""
    assert store.shape(0) == field.shape
    for _ in range(20):
        low = [int(RNG.integers(0, n)) for n in field.shape]
        high = [int(RNG.integers(a + 1, n + 1)) for a, n in zip(low, field.shape, strict=True)]
        box = store.read(name, low, high)
        assert box.flags.c_contiguous
        assert box.dtype == field.dtype
        np.testing.assert_array_equal(box, field[tuple(map(slice, low, high))])


def test_arrays_are_sliced():
    volume = vm.Volume(
        vm.CartesianGrid.uniform((200, 3, 2), (0, 1)), n=np.arange(1200).reshape(200, 3, 2)
    )
    store = volume.store
    assert (store.chunks, store.levels) == ((128, 3, 2), 1)
    assert store.extremes("n") is None
    assert_boxes(store, "n", volume.array("n"))


def test_pieces_are_read_and_fields_that_are_set_stand_beside_them(tmp_path):
    asked, coarse = [], means(RHO, (2, 2, 1))

    def read(low, high, level):
        asked.append((tuple(low), tuple(high), level))
        return (RHO, coarse)[level][tuple(map(slice, low, high))]

    volume = vm.Volume(vm.CartesianGrid.uniform(SHAPE, (0, 1)))
    table = np.stack([np.add.reduceat(RHO, [0, 8], 0)[:, :1, :1]] * 2, -1)
    pieces = Pieces(read, (8, 6, 4), (coarse.shape,), lambda: table)
    whole = Deferred(lambda: pytest.fail("the whole field is read"), "f4", "g", pieces=pieces)
    volume["rho"] = whole
    volume["half"] = RHO / 2
    store = volume.store
    assert (store.chunks, store.levels, store.shape(1)) == ((8, 6, 4), 2, (5, 3, 5))
    assert_boxes(store, "rho", RHO)
    asked.clear()
    np.testing.assert_array_equal(store.read("rho", (0, 0, 0), (5, 3, 5), 1), coarse)
    assert asked == [((0, 0, 0), (5, 3, 5), 1)]
    # The means of halves are the halves of means: powers of two.
    np.testing.assert_array_equal(store.read("half", (2, 1, 0), (5, 3, 5), 1), coarse[2:, 1:] / 2)
    assert store.extremes("rho").shape == (2, 1, 1, 2)
    np.testing.assert_array_equal(store.extremes("rho", 1)[0, 0, 0], [table.min(), table.max()])
    assert store.extremes("half") is None
    assert volume.waiting == ("rho",)


@pytest.mark.parametrize("dtype", ["<f4", ">f8", "<f2", "?", ">u2"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_boxes_of_mapped_files(tmp_path, dtype, order):
    values = np.asarray(100 * RHO, dtype, order=order)
    np.save(tmp_path / "rho.npy", values)
    volume = vm.open(tmp_path / "rho.npy")
    assert_boxes(volume.store, "rho", volume.array("rho"))


def test_what_cannot_be():
    volume = vm.Volume(vm.CartesianGrid.uniform(SHAPE, (0, 1)), rho=RHO)
    with pytest.raises(vm.errors.UnknownNameError, match="did you mean 'rho'"):
        volume.store.read("roh", (0, 0, 0), (1, 1, 1))
    for low, high in (((0, 0, 0), (0, 1, 1)), ((-1, 0, 0), (1, 1, 1)), ((0, 0, 0), (1, 1, 6))):
        with pytest.raises(vm.InputError, match="a box needs 0 <= low < high <="):
            volume.store.read("rho", low, high)
    with pytest.raises(vm.InputError, match="level must be from 0 to 0"):
        volume.store.shape(1)
    tree = vm.OctreeGrid([0, 1], [0, 1], [0, 1], [1, *[0] * 8])
    with pytest.raises(vm.InputError, match="resample"):
        vm.Volume(tree, rho=np.ones(8)).store.levels  # noqa: B018


@pytest.mark.parametrize("shape", [(8, 8, 8), (9, 7, 1), (5, 4, 3)])
def test_means(shape):
    """Of groups, incomplete ones at the ends; what is not known does not count."""
    values = RNG.normal(size=shape)
    values[0, 0, 0] = np.nan
    halves = means(values, (2, 2, 2))
    for index in np.ndindex(halves.shape):
        group = values[tuple(slice(2 * i, 2 * i + 2) for i in index)]
        np.testing.assert_allclose(halves[index], np.nanmean(group), rtol=1e-14)
    assert np.isnan(means(np.full(shape, np.nan, "f4"), (2, 2, 2))).all()
    numbers = means(np.full(shape, 2**31, np.uint32), (4, 2, 1))
    assert numbers.dtype == np.uint32
    assert (numbers == 2**31).all()
    assert level_factors(shape, means(values, (4, 2, 1)).shape) is not None
