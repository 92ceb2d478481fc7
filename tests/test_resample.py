"""Fields on other grids: means over cells, and what is kept of them."""

from __future__ import annotations

import numpy as np
import pytest
from astropy import units as u
from hypothesis import given, settings
from hypothesis import strategies as st

import voluminous as vm
from toy_grids import ShuffledGrid
from voluminous.errors import InputError, UnitsError, UnknownNameError

KINDS = [lambda grid: grid, ShuffledGrid]


def random_grid(counts, seed, bounds=(-1.0, 2.0)):
    rng = np.random.default_rng(seed)
    low, high = bounds
    return vm.CartesianGrid(
        *[np.concatenate([[low], np.sort(rng.uniform(low, high, n - 1)), [high]]) for n in counts]
    )


def on(grid, field):
    return grid.shuffled(field) if isinstance(grid, ShuffledGrid) else field


def integral(volume, name):
    return np.sum(volume.array(name) * volume.grid.cell_volumes)


def twin(values, source, target):
    """Return means over target cells, by all pairs of intervals along each axis."""
    for axis, (old, new) in enumerate(zip(source.edges, target.edges, strict=True)):
        low = np.maximum(old[:-1], new[:-1, None])
        part = np.clip(np.minimum(old[1:], new[1:, None]) - low, 0, None) / np.diff(new)[:, None]
        values = np.moveaxis(np.tensordot(part, values, (1, axis)), 0, axis)
    return values


@pytest.mark.parametrize("new", KINDS, ids=["axes", "flat"])
@pytest.mark.parametrize("old", KINDS, ids=["axes", "flat"])
@given(data=st.data())
@settings(max_examples=25)
def test_boxes_share_exactly_what_they_overlap(old, new, data):
    counts = st.tuples(*[st.integers(1, 6)] * 3)
    first = random_grid(data.draw(counts), data.draw(st.integers(0, 99)))
    limits = data.draw(st.sampled_from([(-1.0, 2.0), (-3.0, 3.0), (0.0, 1.0), (1.5, 4.0)]))
    second = random_grid(data.draw(counts), data.draw(st.integers(0, 99)), limits)
    values = np.random.default_rng(1).normal(size=first.shape)
    source, target = old(first), new(second)
    found = vm.Volume(source, f=on(source, values)).resample(target)
    expected = on(target, twin(values, first, second))
    # Rounding of walls and sums: of values of order one.
    np.testing.assert_allclose(found.array("f"), expected, atol=1e-12)


def test_an_octree_to_a_grid_of_planes_and_back():
    edges = np.linspace(-1, 1, 5)

    def near(x, y, z, size):
        return np.abs(np.sqrt(x * x + y * y + z * z) - 0.6) < size

    tree = vm.OctreeGrid.from_function(edges, edges, edges, near, 4)
    finest = vm.CartesianGrid.uniform(4 * 2**4, (-1, 1))
    volume = vm.Volume(tree, f=np.random.default_rng(0).random(tree.shape))
    fine = volume.resample(finest)
    # Every fine cell is inside one leaf.
    own = tree.locate(finest.cell_centers().T)
    np.testing.assert_allclose(fine["f"].ravel(), volume["f"][own], rtol=1e-13)
    np.testing.assert_allclose(fine.resample(tree)["f"], volume["f"], rtol=1e-12)
    coarse = random_grid((5, 6, 7), 3, (-1.0, 1.0))
    assert integral(volume.resample(coarse), "f") == pytest.approx(integral(volume, "f"), rel=1e-12)


def test_types_units_and_names():
    grid = vm.CartesianGrid.uniform(4, (0, 1), unit="pc")
    other = vm.CartesianGrid.uniform(2, (0, 1), unit="pc")
    counted = np.arange(64).reshape(grid.shape)
    volume = vm.Volume(grid, a=counted.astype("f4") * u.K, b=counted, c=counted > 31)
    found = volume.resample(other, ["a", "b"])
    assert found.fields == ("a", "b")
    assert found.units == {"a": "K", "b": ""}
    assert [found.array(n).dtype for n in "ab"] == [np.float32, np.float64]
    np.testing.assert_allclose(volume.resample(other)["c"][:, 0, 0], [0, 1])
    with pytest.raises(UnknownNameError, match="unknown field 'd'"):
        volume.resample(other, ["d"])
    with pytest.raises(InputError, match="write \\['a'\\]"):
        volume.resample(other, "a")
    with pytest.raises(UnitsError, match="in km, the volume's in pc"):
        volume.resample(vm.CartesianGrid.uniform(2, (0, 1), unit="km"))
    with pytest.raises(InputError, match="samples must be a positive"):
        volume.resample(other, samples=0)
    with pytest.raises(InputError, match="needs a grid"):
        volume.resample(7)


CURVED = {
    "spherical": lambda: vm.SphericalGrid(
        np.geomspace(0.02, 1, 20), np.linspace(0, np.pi, 9), np.linspace(0, 2 * np.pi, 13)
    ),
    "mirrored": lambda: vm.SphericalGrid(
        np.geomspace(0.02, 1, 20),
        np.linspace(0.3, np.pi / 2, 5),
        np.linspace(0, 2 * np.pi, 13),
        mirror=True,
    ),
    "cylindrical": lambda: vm.CylindricalGrid(
        np.linspace(0.1, 1, 8), np.linspace(0, 2 * np.pi, 13), np.linspace(-1, 1, 9)
    ),
}


@pytest.mark.parametrize("kind", CURVED)
def test_curvilinear_grids_keep_constants_and_nearly_the_integral(kind):
    grid = CURVED[kind]()
    volume = vm.Volume(grid, one=np.ones(grid.shape))
    volume["f"] = "exp(-3*r)"
    box = vm.CartesianGrid.uniform(24, (-1.05, 1.05))
    found = volume.resample(box)
    middle = found["one"] > 0.999
    assert middle.sum() > 1000
    np.testing.assert_allclose(found["one"][middle], 1, atol=1e-12)
    # Of the cells at the surface, of a fifth of the volume, 64 points tell the part that is inside.
    for name in ("one", "f"):
        assert integral(found, name) == pytest.approx(integral(volume, name), rel=1e-2)


@pytest.mark.parametrize("kind", CURVED)
def test_onto_a_curvilinear_grid(kind):
    box = vm.Volume(vm.CartesianGrid.uniform(64, (-1, 1)))
    box["one"], box["f"] = "1", "exp(-3*r)"
    grid = CURVED[kind]()
    found, exact = box.resample(grid, samples=3), vm.Volume(grid)
    exact["f"] = "exp(-3*r)"
    np.testing.assert_allclose(found["one"], 1, atol=1e-12)
    # Means over cells differ from values at their centres, and the box's cells are 0.03 wide.
    assert integral(found, "f") == pytest.approx(integral(exact, "f"), rel=3e-2)


AROUND = {
    "axisymmetric": vm.SphericalGrid(np.linspace(0.2, 1, 5), np.linspace(0, np.pi, 6)),
    "radial": vm.SphericalGrid(np.linspace(0, 1, 6)),
    "cylindrical": vm.CylindricalGrid(np.linspace(0, 1, 5), [0, 2 * np.pi], np.linspace(-1, 1, 4)),
}


@pytest.mark.parametrize("name", AROUND)
def test_a_wedge_on_cells_that_go_all_around(name):
    """A part of each cell is inside, which four points around the axis told to 30 % only."""
    wedge = vm.SphericalGrid(
        np.linspace(0.2, 1, 9), np.linspace(0.4, 2, 9), np.linspace(0.3, 4, 13)
    )
    source = vm.Volume(wedge, f=1 + np.random.default_rng(2).random(wedge.shape))
    found = source.resample(AROUND[name])
    # 64 points around: half a point's share at each wall of the wedge; walls in r and θ as well.
    assert integral(found, "f") == pytest.approx(integral(source, "f"), rel=0.03)


def test_a_grid_elsewhere_is_refused():
    volume = vm.Volume(vm.CartesianGrid.uniform(4, (0, 1)), f=np.ones((4, 4, 4)))
    with pytest.raises(InputError, match="nowhere in the volume"):
        volume.resample(vm.CartesianGrid.uniform(4, (2, 3)))


@pytest.mark.parametrize(
    "source",
    [
        vm.CartesianGrid.uniform(4, (0, 2)),
        vm.OctreeGrid([0, 1, 2], [0, 2], [0, 2], [1, *9 * [0]]),
        vm.SphericalGrid([0, 4, 5], [0, np.pi / 2], [0, 1, np.pi / 2]),
    ],
    ids=lambda grid: type(grid).__name__,
)
def test_cells_inside_have_values_whatever_is_outside(source):
    """NaN says "nothing is known" outside; zero times NaN made all cells unknown."""
    volume = vm.Volume(source, f=np.full(source.shape, 3.0))
    boxes = vm.CartesianGrid([-4, -1, 1, 2], [0, 1, 2], [0, 1, 2])
    inside = volume.resample(boxes, fill=np.nan).array("f")
    assert np.isnan(inside[:2]).all()  # outside, and half outside
    np.testing.assert_allclose(inside[2], 3.0, rtol=1e-12)


def in_chunks(volume, name, side):
    """Return a field put together from boxes of so many cells."""
    whole = np.empty(volume.grid.shape, volume.describe()["fields"][name]["dtype"])
    for place in np.ndindex(*(-(-n // side) for n in whole.shape)):
        low = [side * i for i in place]
        high = [min(a + side, n) for a, n in zip(low, whole.shape, strict=True)]
        whole[tuple(map(slice, low, high))] = volume.store.read(name, low, high)
    return whole


def test_particles_on_a_grid_chunk_by_chunk(tmp_path):
    """The bits do not depend on the chunks; mass and momentum are conserved to rounding."""
    rng = np.random.default_rng(2)
    points, mass, speed = rng.normal(size=(400, 3)), rng.random(400), rng.normal(size=400)
    tree = vm.Volume.from_particles(points, mass, fields={"v": speed}, unit="pc")
    tree["p"] = "density * v"
    # Neither bounds nor walls are those of the tree.
    counts = (23, 17, 12)
    edges = [
        np.linspace(a - 0.3, b + 0.2, n + 1)
        for (a, b), n in zip(tree.grid.bounds, counts, strict=True)
    ]
    grid = vm.CartesianGrid(*edges, unit="pc")
    volume, whole = tree.resample(grid, deferred=True), tree.resample(grid)
    assert volume.waiting == tree.fields
    assert volume.units == tree.units
    for name in tree.fields:
        made = in_chunks(volume, name, 23)
        for side in (4, 7):
            np.testing.assert_array_equal(in_chunks(volume, name, side), made)
        np.testing.assert_allclose(made, whole.array(name), rtol=1e-12, atol=1e-14)
    assert volume.waiting == tree.fields
    for name, total in (("density", mass.sum()), ("p", (mass * speed).sum())):
        # Sums of 400 numbers of order one, and of 4692.
        np.testing.assert_allclose(integral(volume, name), total, rtol=0, atol=1e-11)
    pytest.importorskip("zarr", "3")
    tree.resample(grid, deferred=True).save(tmp_path / "a.zarr", chunks=8, stats=True)
    again = vm.open(tmp_path / "a.zarr")
    np.testing.assert_array_equal(again.array("v"), volume.array("v"))


@pytest.mark.parametrize("dtype", ["f4", "f8", "i2"])
def test_boxes_of_a_grid_of_planes(dtype):
    source = random_grid((9, 12, 7), 1)
    values = (100 * np.random.default_rng(3).random(source.shape)).astype(dtype)
    old = vm.Volume(source, f=values)
    for bounds in ((-1, 2), (-2, 3), (0.5, 0.9)):
        grid = random_grid((11, 6, 13), 2, bounds)
        new = old.resample(grid, fill=2.5, deferred=True)
        made = new.array("f")
        np.testing.assert_array_equal(made, old.resample(grid, fill=2.5).array("f"))
        assert made.dtype == (np.float32 if dtype == "f4" else np.float64)
        box = new.store.read("f", (2, 1, 3), (5, 4, 4))
        np.testing.assert_array_equal(box, made[2:5, 1:4, 3:4])


def test_of_a_grid_larger_than_memory_a_part_is_read_at_a_time(monkeypatch):
    source = random_grid((300, 180, 160), 1)
    old = vm.Volume(source, f=np.random.default_rng(3).random(source.shape, np.float32))
    read, largest = vm.store.FieldStore.read, []

    def counted(self, name, low, high, level=0):
        box = read(self, name, low, high, level)
        largest.append(box.size)
        return box

    monkeypatch.setattr(vm.store.FieldStore, "read", counted)
    grid = random_grid((11, 6, 13), 2, (-1, 2))
    made = old.resample(grid, deferred=True).store.read("f", (0, 0, 0), grid.shape)
    np.testing.assert_array_equal(made, old.resample(grid).array("f"))
    assert sum(largest[:-1]) >= source.size
    assert max(largest) <= 1 << 22


def test_missing_values_in_boxes():
    source = random_grid((6, 5, 4), 4)
    values = np.random.default_rng(5).random(source.shape)
    values[1:3, 2, 1] = np.nan
    grid = random_grid((8, 7, 6), 6)
    for kind in KINDS:
        cells = kind(source)
        old = vm.Volume(cells, f=on(cells, values))
        made = in_chunks(old.resample(grid, deferred=True), "f", 3)
        np.testing.assert_allclose(made, old.resample(grid).array("f"), rtol=1e-12, atol=1e-14)


def test_what_cannot_be_made_in_boxes():
    sphere = vm.Volume(
        vm.SphericalGrid([1, 2], [0, 1, np.pi], [0, 2 * np.pi]), f=np.ones((1, 2, 1))
    )
    with pytest.raises(InputError, match="deferred=True needs cells that are boxes"):
        sphere.resample(vm.CartesianGrid.uniform(4, (-1, 1)), deferred=True)
    with pytest.raises(InputError, match="is nowhere in the volume"):
        vm.models.sphere(4).resample(vm.CartesianGrid.uniform(4, (7, 8)), deferred=True)
