"""NetCDF of all kinds: read by what wrote it, lazily, and never beyond its end."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

import voluminous as vm
from contracts import ReaderContract
from voluminous.io import find_reader

xr = pytest.importorskip("xarray")

KINDS = {
    "classic": ("scipy", "NETCDF3_CLASSIC"),
    "64-bit offsets": ("scipy", "NETCDF3_64BIT"),
    "64-bit data": ("netCDF4", "NETCDF3_64BIT_DATA"),
    "4 by h5netcdf": ("h5netcdf", "NETCDF4"),
    "4 by netCDF4": ("netCDF4", "NETCDF4"),
}


def data():
    """Return heights, latitudes falling, with a missing value, packed numbers and bytes."""
    rng = np.random.default_rng(2)
    temperature = rng.random((2, 3, 4, 5), dtype=np.float32)
    temperature[1, 0, 0, 0] = np.nan
    dims = ("time", "height", "lat", "lon")
    return xr.Dataset(
        {
            "T": (dims, temperature, {"units": "degC"}),
            "cover": (dims[1:], rng.integers(-99, 99, (3, 4, 5)).astype(np.int8)),
            "packed": (dims[1:], np.arange(60.0).reshape(3, 4, 5) / 10),
        },
        {
            "time": np.array([0, 6]),
            "height": ("height", [10.0, 30.0, 50.0], {"units": "m"}),
            "lat": ("lat", [30.0, 20.0, 10.0, 0.0], {"units": "m"}),
            "lon": ("lon", np.arange(5) * 10.0, {"units": "m"}),
        },
    )


def written(path, kind="classic", unlimited=()):
    module, form = KINDS[kind]
    pytest.importorskip(module)
    data().to_netcdf(
        path,
        engine=module.lower(),
        format=form,
        unlimited_dims=unlimited,
        encoding={"packed": {"dtype": "i2", "scale_factor": 0.1, "_FillValue": -1}},
    )
    return path


@pytest.mark.parametrize("unlimited", [(), ("time",)], ids=["fixed", "records"])
@pytest.mark.parametrize("kind", KINDS)
def test_values_units_types_and_places(tmp_path, kind, unlimited):
    path = written(tmp_path / "a.nc", kind, unlimited)
    assert find_reader(path).name == "netcdf"
    volume = vm.open(path, "T", isel={"time": 1})
    expected = data()["T"].values[1].transpose(2, 1, 0)[:, ::-1]
    np.testing.assert_array_equal(volume.array("T"), expected)
    assert np.isnan(volume.array("T")).sum() == 1
    assert volume.array("T").dtype == np.float32
    assert volume.units["T"] == "deg_C"
    assert volume.unit == vm.Volume.from_xarray(data(), "cover").unit
    assert volume.grid.bounds.tolist() == [[-5, 45], [-5, 35], [0, 60]]
    others = vm.open(path, ["cover", "packed"])
    assert others.array("cover").dtype == np.int8
    expected = data()["packed"].values.transpose(2, 1, 0)[:, ::-1]
    # Steps of 0.1, in single precision.
    np.testing.assert_allclose(others.array("packed"), expected, atol=1e-6)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("part", [0.01, 0.5, 0.999])
def test_what_is_cut_short_is_no_zeros(tmp_path, kind, part):
    path = written(tmp_path / "a.nc", kind, ("time",))
    content = path.read_bytes()
    path.write_bytes(content[: int((min(part, 0.5) if "data" in kind else part) * len(content))])
    with pytest.raises(vm.FileFormatError, match=r"a\.nc.*cut short"):
        vm.open(path, "T", isel={"time": 1})


def test_groups(tmp_path):
    path = tmp_path / "a.nc"
    pytest.importorskip("h5netcdf")
    for mode, group in (("w", "model/ocean"), ("a", "model/land")):
        data()[["cover"]].to_netcdf(path, mode=mode, group=group, engine="h5netcdf")
    with pytest.raises(vm.FileFormatError, match=r"groups model, model/land, model/ocean with gr"):
        vm.open(path)
    assert vm.open(path, group="model/ocean").fields == ("cover",)
    with pytest.raises(vm.errors.UnknownNameError, match="unknown group 'model/see'"):
        vm.open(path, group="model/see")


def test_large_files_are_read_field_by_field(tmp_path):
    path = written(tmp_path / "a.nc")
    volume = vm.open(path, ["cover", "packed"]).unread()
    assert volume.waiting == ("cover", "packed")
    volume.array("cover")
    assert volume.waiting == ("packed",)
    path.unlink()
    with pytest.raises(vm.FileFormatError, match=r"a\.nc"):
        volume.array("packed")


# Damaged units make odd boxes, and h5netcdf complains about what it could not open.
@pytest.mark.filterwarnings("ignore")
class _Contract(ReaderContract):
    options: dict = {"isel": {"time": 0}}  # noqa: RUF012
    kind = ""

    @pytest.fixture
    def sample(self):
        return lambda directory: written(directory / "a.nc", self.kind)


# All but those that netCDF4's C library reads: what it makes of damage is not ours to test.
class TestClassic(_Contract):
    kind = "classic"


@pytest.mark.parametrize(
    ("calendar", "start", "when"),
    [
        ("noleap", "2001-01-01", "2001-02-01"),
        ("360_day", "2001-01-01", "2001-02-02"),
        ("julian", "2001-01-01", "2001-02-01"),
        ("standard", "0850-01-01", "0850-02-01"),
    ],
)
@pytest.mark.parametrize("kind", ["netcdf", "zarr", "memory"])
def test_calendars_of_climate_models(tmp_path, kind, calendar, start, when):
    pytest.importorskip("cftime")
    times = {"units": f"days since {start}", "calendar": calendar}
    values = np.random.default_rng(3).random((3, 4, 5, 6))
    stored = xr.Dataset(
        {"T": (("time", "z", "y", "x"), values)}, {"time": ("time", [0.0, 31.0, 59.0], times)}
    )

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", xr.SerializationWarning)  # our test's own
        decoded = xr.decode_cf(stored).load()

    def opened(**options):
        if kind == "memory":
            return vm.Volume.from_xarray(decoded, **options)
        return vm.open(tmp_path / kind, **options)

    with warnings.catch_warnings():
        warnings.simplefilter("error", xr.SerializationWarning)
        if kind == "netcdf":
            stored.to_netcdf(tmp_path / kind, engine="scipy")
        elif kind == "zarr":
            pytest.importorskip("zarr", "3")
            stored.to_zarr(tmp_path / kind, consolidated=False)
        by_number = opened(isel={"time": 1})
        by_date = opened(sel={"time": when})
    assert by_number.meta["time"].startswith(when)
    for volume in (by_number, by_date):
        np.testing.assert_array_equal(volume.array("T"), values[1].transpose(2, 1, 0))
    with pytest.raises(vm.InputError, match=r"no time = '1999-05-05': expected .* …"):
        opened(sel={"time": "1999-05-05"})
    with pytest.warns(UserWarning, match="z = time: h"):
        along = opened(dims=("x", "y", "time"), isel={"z": 0})
    assert along.meta["axes"]["z"]["to"] == pytest.approx(24 * (59 + 14))


def test_times_that_nobody_can_decode_are_numbers(tmp_path):
    times = {"units": "days since 2001-01-01", "calendar": "of my own"}
    stored = xr.Dataset(
        {"T": (("time", "z", "y", "x"), np.ones((2, 3, 4, 5)))},
        {"time": ("time", [0.0, 31.0], times)},
    )
    stored.to_netcdf(tmp_path / "a.nc", engine="scipy")
    stored.to_zarr(tmp_path / "a.zarr", consolidated=False)
    for name in ("a.nc", "a.zarr"):
        assert vm.open(tmp_path / name, sel={"time": 31.0}).meta["time"] == 31.0
