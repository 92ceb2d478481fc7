"""Imaris: channels with their names and colours, extents, padding, times, levels."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

import voluminous as vm
from contracts import ReaderContract
from voluminous.io import find_reader

VALUES = np.arange(2 * 2 * 3 * 4 * 5, dtype=np.uint16).reshape(2, 2, 5, 4, 3)


def characters(text: str) -> np.ndarray:
    return np.array([c.encode() for c in text], "S1")


def write_imaris(path: Path) -> Path:
    """Two times of two channels of 3 x 4 x 5 voxels, in blocks filled up to 4 x 4 x 8."""
    with h5py.File(path, "w") as file:
        image = file.create_group("DataSetInfo/Image")
        ends = {"ExtMin": (10, 20, 30), "ExtMax": (11.5, 24, 40)}
        for name, numbers in ends.items():
            for axis, number in enumerate(numbers):
                image.attrs[f"{name}{axis}"] = characters(f"{number:.3f}")
        image.attrs["Unit"] = characters("um")
        for k, (name, color) in enumerate((("DAPI", "0 0 1"), ("Actin fibres", "1 0.5 0"))):
            group = file.create_group(f"DataSetInfo/Channel {k}")
            group.attrs["Name"], group.attrs["Color"] = characters(name), characters(color)
            group.attrs["ColorRange"] = characters("2.000 100.000")
        for time in range(2):
            for k in range(2):
                place = f"DataSet/ResolutionLevel 0/TimePoint {time}/Channel {k}"
                group = file.create_group(place)
                for axis, count in zip("XYZ", (3, 4, 5), strict=True):
                    group.attrs[f"ImageSize{axis}"] = characters(str(count))
                filled = np.zeros((8, 4, 4), np.uint16)
                filled[:5, :4, :3] = VALUES[time, k]
                group["Data"] = filled
                coarse = file.create_group(place.replace("Level 0", "Level 1"))
                for axis, count in zip("XYZ", (1, 2, 2), strict=True):
                    coarse.attrs[f"ImageSize{axis}"] = characters(str(count))
                coarse["Data"] = filled[:2, :2, :1]
    return path


def test_channels_lie_where_the_extents_say(tmp_path):
    path = write_imaris(tmp_path / "cell.h5")
    assert find_reader(path).name == "imaris"
    volume = vm.open(path, time=1)
    assert volume.fields == ("DAPI", "Actin_fibres")
    assert volume.unit == "um"
    np.testing.assert_allclose(volume.grid.bounds, [[10, 11.5], [20, 24], [30, 40]])
    np.testing.assert_array_equal(volume.array("DAPI"), VALUES[1, 0].transpose())
    np.testing.assert_array_equal(volume.array("Actin_fibres"), VALUES[1, 1].transpose())
    assert volume.meta["channels"]["Actin_fibres"] == {
        "label": "Actin fibres",
        "color": [1.0, 0.498, 0.0],
        "window": [2.0, 100.0],
    }
    assert volume.meta["times"] == 2


class TestImaris(ReaderContract):
    """Recognised by its groups."""

    @pytest.fixture
    def sample(self):
        return lambda directory: write_imaris(directory / "cell.ims")
