"""GRIB by cfgrib, and files that another engine of xarray opens."""

from __future__ import annotations

import numpy as np
import pytest

import voluminous as vm
from voluminous.io import find_reader

VALUES = 250 + np.random.default_rng(0).random((3, 5, 6))


def grib(path, kind="isobaricInhPa", levels=(1000, 500, 200), mode="wb"):
    """Write a message per level, south at the last row."""
    codes = pytest.importorskip("eccodes")
    pytest.importorskip("cfgrib")
    told = {"Ni": 6, "Nj": 5, "bitsPerValue": 24, "typeOfLevel": kind, "shortName": "t"}
    told |= {"iDirectionIncrementInDegrees": 10.0, "jDirectionIncrementInDegrees": 5.0}
    for end, (lat, lon) in (("First", (20.0, 0.0)), ("Last", (0.0, 50.0))):
        told[f"latitudeOf{end}GridPointInDegrees"] = lat
        told[f"longitudeOf{end}GridPointInDegrees"] = lon
    with open(path, mode) as file:
        for level, values in zip(levels, VALUES, strict=True):
            message = codes.codes_grib_new_from_samples("regular_ll_pl_grib2")
            for key, value in {**told, "level": level}.items():
                codes.codes_set(message, key, value)
            codes.codes_set_values(message, values.ravel())
            codes.codes_write(message, file)
            codes.codes_release(message)
    return path


@pytest.mark.parametrize("name", ["air.grib", "no_suffix"])
@pytest.mark.filterwarnings("ignore:the coordinates are of different kinds")
def test_grib(tmp_path, name):
    path = grib(tmp_path / name)
    assert find_reader(path).name == "xarray"
    volume = vm.open(path)
    # Pressures fall upwards, and latitudes in the file.
    np.testing.assert_allclose(volume.array("t"), VALUES.transpose(2, 1, 0)[:, ::-1], atol=1e-4)
    assert volume.units["t"] == "K"
    assert volume.grid.edges[0].tolist() == [-5, 5, 15, 25, 35, 45, 55]
    assert volume.meta["axes"]["z"]["unit"] == "hPa"
    assert [entry.name for entry in tmp_path.iterdir()] == [name]  # no index beside it


@pytest.mark.filterwarnings("ignore:the coordinates are of different kinds")
def test_messages_of_several_kinds_must_be_chosen(tmp_path):
    path = grib(tmp_path / "air.grib")
    grib(path, "heightAboveGround", (10, 50, 100), "ab")
    with pytest.raises(vm.FileFormatError, match=r"filter_by_keys=\{'typeOfLevel'"):
        vm.open(path)
    for kind in ("heightAboveGround", "isobaricInhPa"):
        volume = vm.open(path, filter_by_keys={"typeOfLevel": kind})
        assert volume.meta["axes"]["z"]["name"] == kind
