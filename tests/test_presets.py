"""Media for data of a known kind."""

from __future__ import annotations

import numpy as np
import pytest

import voluminous as vm

GRID = vm.CartesianGrid.uniform(24, (-1, 1))
NAMES = [n for n in dir(vm.presets) if n not in ("fluorescence", "labels")]


def phantom():
    """Return air, fat, soft tissue and bone in shells, in Hounsfield units."""
    x, y, z = GRID.cell_centers(0, GRID.size)
    size = np.sqrt(x**2 + y**2 + z**2).reshape(GRID.shape)
    values = np.select([size < 0.4, size < 0.7, size < 0.8], [1000, 60, -90], -1000.0)
    return vm.Volume(GRID, ct=values + 100 * np.maximum(0.4 - size, 0.0) - 10 * size)


@pytest.mark.parametrize("name", NAMES)
def test_presets_show_something_and_are_plain_values(name):
    volume = phantom()
    medium = getattr(vm.presets, name)(volume)
    image = vm.render(volume, medium, vm.Orthographic(60, 30, resolution=32), tolerance=1e-2)
    assert np.isfinite(image.intensity).all()
    assert image.intensity.max() > 0.01
    assert medium.describe()["shading"] == 0.7
    assert getattr(vm.presets, name)(volume, "ct", shading=0).describe().get("shading", 0) == 0


def test_bone_is_bone_alone():
    image = vm.render(phantom(), vm.presets.bone(phantom()), vm.Orthographic(60, 30, resolution=32))
    shown = image.optical_depth[..., 0] > 0.05
    radius = np.hypot(*np.meshgrid(image.x, image.y))
    assert shown[radius < 0.35].all()
    assert not shown[radius > 0.6].any()


def test_channels_are_shown_in_their_colours_without_a_medium():
    values = np.zeros((2, 24, 24, 24))
    values[0, 4:9, 10:14, 10:14] = values[1, 15:20, 10:14, 10:14] = 200.0
    volume = vm.Volume(GRID, dna=values[0], actin=values[1])
    volume.meta["channels"] = {
        "dna": {"color": [0.0, 0.0, 1.0], "window": [0.0, 200.0]},
        "actin": {"color": [1.0, 0.0, 0.0], "window": [0.0, 200.0]},
    }
    light = vm.render(volume, camera=vm.Orthographic(width=2, resolution=24)).intensity
    left, right = light[12, 6], light[12, 17]
    assert left[2] > 0.1
    assert right[0] > 0.1
    assert max(left[0], left[1], right[1], right[2]) < 1e-3


@pytest.mark.parametrize("name", ["mr_head", "mr_angiography", "fluorescence"])
def test_presets_that_measure_levels_say_that_there_is_nothing_to_see(name):
    volume = vm.Volume(GRID, signal=np.full(GRID.shape, 7.0))
    with pytest.raises(vm.errors.InputError, match="signal is 7 everywhere: there is nothing"):
        getattr(vm.presets, name)(volume)
