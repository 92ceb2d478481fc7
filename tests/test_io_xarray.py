"""Volumes of xarray: every value keeps its place, in any order of dimensions and coordinates."""

from __future__ import annotations

import subprocess
import sys
import warnings

import numpy as np
import pytest
from astropy import units as u
from hypothesis import given, settings
from hypothesis import strategies as st

import voluminous as vm
import voluminous.xarray

xr = pytest.importorskip("xarray")

N = {"x": 4, "y": 3, "z": 2}


@st.composite
def cubes(draw):
    """Return an array of which each value is a function of the coordinates, and that function."""
    order = draw(st.permutations("xyz"))
    centers = {}
    for axis in "xyz":
        steps = draw(st.lists(st.floats(0.1, 10.0), min_size=2, max_size=5))
        line = np.cumsum(steps) - draw(st.floats(-5, 5))
        centers[axis] = line[::-1] if draw(st.booleans()) else line
    x, y, z = np.meshgrid(*(centers[a] for a in "xyz"), indexing="ij")
    values = x + 100 * y + 10_000 * z
    array = xr.DataArray(values, dims=("x", "y", "z"), coords=centers, name="f")
    return array.transpose(*order), centers


@settings(deadline=None)
@given(cubes())
def test_values_stay_at_their_coordinates(cube):
    array, centers = cube
    volume = vm.Volume.from_xarray(array)
    sorted_ = [np.sort(centers[a]) for a in "xyz"]
    x, y, z = np.meshgrid(*sorted_, indexing="ij")
    np.testing.assert_array_equal(volume.array("f"), x + 100 * y + 10_000 * z)
    for edges, line in zip(volume.grid.edges, sorted_, strict=True):
        # Edges of equal cells are put in even steps: to what a coordinate is rounded to in a file.
        np.testing.assert_allclose(
            0.5 * (line[1:] + line[:-1]), edges[1:-1], rtol=0, atol=1e-4 * np.ptp(line)
        )
        assert edges[0] < line[0] < edges[1]


def cube(dims=("z", "y", "x"), **options):
    values = np.arange(24.0).reshape([N[d] for d in ("z", "y", "x")])
    return xr.DataArray(values, dims=dims, name="rho", **options)


def test_depth_grows_downwards():
    coords = {"z": ("z", [10.0, 20.0], {"units": "m", "positive": "down"})}
    coords |= {a: (a, np.arange(float(N[a])), {"units": "m"}) for a in "xy"}
    volume = vm.Volume.from_xarray(cube(coords=coords))
    assert volume.grid.bounds[2].tolist() == [-25, -5]
    top = volume.array("rho")[..., -1]
    np.testing.assert_array_equal(top, cube().values[0].T)
    assert volume.meta["axes"]["z"] == {"name": "z", "unit": "m", "from": 25.0, "to": 5.0}


def atmosphere():
    coords = {
        "lon": ("lon", np.arange(0.0, 360.0, 30.0), {"units": "degrees_east"}),
        "lat": ("lat", np.linspace(75.0, -75.0, 6), {"units": "degrees_north"}),
        "plev": ("plev", [1000.0, 850.0, 500.0], {"units": "hPa"}),
        "time": np.array(["2001-01-01", "2001-02-01"], "M8[ns]"),
    }
    rng = np.random.default_rng(1)
    wind = (("time", "plev", "lat", "lon"), rng.random((2, 3, 6, 12)), {"units": "m s-1"})
    return xr.Dataset(
        {"u": wind, "v": wind, "ps": (("time", "lat", "lon"), rng.random((2, 6, 12)))}, coords
    )


def test_angles_and_pressures_are_no_lengths_and_a_warning_says_so():
    with pytest.warns(UserWarning, match=r"z = plev: hPa\): z is fitted into 180, which is no"):
        volume = vm.Volume.from_xarray(atmosphere(), "u", isel={"time": 1})
    assert volume.unit is None
    np.testing.assert_allclose(volume.grid.bounds, [[-15, 345], [-90, 90], [0, 180]])
    # Up is where the pressure is low: 75, 350 and 150 hPa wide halves around the levels.
    np.testing.assert_allclose(
        volume.grid.edges[2], 180 * (1075 - np.array([1075.0, 925, 675, 325])) / 750
    )
    expected = atmosphere().u.values[1].transpose(2, 1, 0)[:, ::-1]
    np.testing.assert_array_equal(volume.array("u"), expected)
    assert volume.units["u"] == "m / s"
    assert volume.meta["time"] == "2001-02-01T00:00:00.000000000"


def test_other_dimensions_are_chosen():
    with pytest.raises(vm.InputError, match=r"\(time: 2, plev: 3, lat: 6, lon: 12\); choose one of "
                       r"time with isel=\{'time': 0\}"):  # fmt: skip
        vm.Volume.from_xarray(atmosphere(), "u")
    whole = {"aspect": (1, 1, 1)}
    by_value = vm.Volume.from_xarray(atmosphere(), "u", sel={"time": "2001-02-01"}, **whole)
    by_number = vm.Volume.from_xarray(atmosphere(), "u", isel={"time": 1}, **whole)
    np.testing.assert_array_equal(by_value.array("u"), by_number.array("u"))
    part = vm.Volume.from_xarray(atmosphere(), "u", isel={"time": [1], "lon": slice(2, 5)}, **whole)
    np.testing.assert_array_equal(part.array("u"), by_number.array("u")[2:5])


def test_pieces_are_computed_when_they_are_used():
    dask = pytest.importorskip("dask")
    computed = []

    def compute(block):
        computed.append(block.shape)
        return 2 * block

    # Twice 128 MiB and more are not read at once.
    ones = xr.DataArray(
        dask.array.ones((2, 4200, 4200), chunks=(1, 4200, 4200)), dims=("x", "y", "z")
    )
    data = xr.Dataset({"a": ones, "b": ones})
    data = data.map(lambda v: v.copy(data=v.data.map_blocks(compute, meta=np.empty((0, 0, 0)))))
    volume = vm.Volume.from_xarray(data)
    assert volume.waiting == ("a", "b")
    assert not computed
    with dask.config.set(scheduler="synchronous"):
        assert (volume.array("b") == 2).all()
    assert len(computed) == 2
    assert volume.waiting == ("a",)


def test_the_accessor_comes_with_voluminous_xarray_alone():
    script = "import xarray, voluminous; print(hasattr(xarray.DataArray, 'voluminous'))\n"
    script += "import voluminous.xarray; print(hasattr(xarray.DataArray, 'voluminous'))"
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["False", "True"]


@pytest.fixture
def ball():
    z, y, x = np.meshgrid(*[np.linspace(-1, 1, 12)] * 3, indexing="ij")
    density = np.exp(-4 * (x**2 + y**2 + z**2))
    return xr.DataArray(density, dims=("z", "y", "x"), name="rho")


def test_a_picture_is_that_of_the_volume(ball):
    camera = vm.Orthographic(resolution=8)
    medium = vm.Coefficients("rho", 0.1)
    options = {"scheme": "first-order", "precision": "double"}
    mine = ball.to_dataset().voluminous.render(medium, camera, spacing=0.1, unit="pc", **options)
    volume = vm.Volume.from_xarray(ball, spacing=0.1, unit="pc")
    np.testing.assert_array_equal(
        mine.intensity, vm.render(volume, medium, camera, **options).intensity
    )
    assert ball.voluminous.to_volume(unit="pc").unit == u.pc
    assert "render" in repr(ball.voluminous)
    by_field = ball.voluminous.render("rho**2", camera)
    assert (
        by_field.provenance["medium"]
        == vm.suggest_medium(vm.Volume.from_xarray(ball), "rho**2").describe()
    )


def test_packed_numbers_are_unpacked_though_xarray_was_told_not_to():
    stored = np.arange(24, dtype=np.int16).reshape(2, 3, 4)
    stored[0, 0, 0] = -9
    told = {"scale_factor": 0.5, "add_offset": 3.0, "_FillValue": np.int16(-9), "units": "K"}
    data = xr.Dataset({"t": (("z", "y", "x"), stored, told)})
    expected = np.where(stored == -9, np.nan, 0.5 * stored + 3).T
    for packed in (data, data.t):
        volume = vm.Volume.from_xarray(packed)
        np.testing.assert_allclose(volume.array("t"), expected)
        assert volume.units["t"] == "K"


def test_dimensions_may_be_called_by_numbers():
    values = np.random.default_rng(1).random((2, 3, 4, 5))
    data = xr.DataArray(values, dims=(0, 1, 2, 3))
    for isel in ({0: 1}, {"0": 1}):
        volume = vm.Volume.from_xarray(data, isel=isel, dims=(3, 2, 1))
        np.testing.assert_array_equal(volume.array("data"), values[1].transpose(2, 1, 0))
    part = vm.Volume.from_xarray(data, isel={0: 0, 1: slice(1, None)})
    np.testing.assert_array_equal(part.array("data"), values[0, 1:])
    with pytest.raises(vm.InputError, match="differ by their types only"):
        vm.Volume.from_xarray(data.rename({2: "0"}))


def test_corners_of_cells_are_no_fields():
    rng = np.random.default_rng(2)
    shape = {"k": 3, "y": 5, "x": 6}

    def on(*dims):
        return dims, rng.random([shape.get(dim, 4) for dim in dims])

    data = xr.Dataset({"T": on("k", "y", "x"), "depth": on("k", "y", "x")})
    data["depth"].attrs["bounds"] = "depth_ends"
    data["depth_ends"] = on("k", "y", "x", "two")
    data["lat_vertices"], data["lon_vertices"] = on("y", "x", "vertices"), on("y", "x", "vertices")
    data["z_bnds"] = (("k", "y", "bnds"), rng.random((3, 5, 2)))
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # nothing is left out that is worth a word
        volume = vm.Volume.from_xarray(data)
    assert (volume.fields, volume.grid.shape) == (("T", "depth"), (6, 5, 3))
    with pytest.raises(vm.InputError, match="expected a variable of three dimensions"):
        vm.Volume.from_xarray(data.drop_vars(["T", "depth"]).drop_vars("depth_ends"))
    corners = vm.Volume.from_xarray(data, "lat_vertices")  # whoever asks for them
    assert corners.grid.shape == (6, 5, 4)
