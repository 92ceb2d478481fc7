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


def head(slope=1.0, intercept=0.0, dtype=np.int16, name="a"):
    """Return air, lung, water and bone with noise, as a scanner stores them."""
    x, y, z = GRID.cell_centers(0, GRID.size)
    size = np.sqrt(x**2 + y**2 + z**2).reshape(GRID.shape)
    values = np.select([size < 0.3, size < 0.7, size < 0.75], [900.0, 40.0, -700.0], -1000.0)
    values += np.random.default_rng(1).normal(size=size.shape) * 20
    values = slope * values + intercept
    return vm.Volume(
        GRID, {name: np.clip(np.round(values), 0 if intercept else None, None).astype(dtype)}
    )


@pytest.mark.parametrize(
    ("changes", "scale"),
    [
        ({}, (1.0, 0.0)),
        ({"intercept": 1024.0}, (1.0, 1024.0)),
        ({"slope": 1 / 12, "intercept": 84.0, "dtype": np.uint8, "name": "ct"}, (1 / 12, 84.0)),
        ({"slope": 1 / 12, "intercept": 84.0, "dtype": np.uint8}, None),
        ({"slope": 0.1}, None),
        ({"slope": 1e3, "dtype": np.int32, "name": "ct"}, None),
    ],
)
def test_hounsfield_units_are_recognised(changes, scale):
    volume = head(**changes)
    name = volume.fields[0]
    found = vm.presets.hounsfield(volume, name)
    if scale is None:
        assert found is None
        assert vm.presets.recognised(volume) == ([], [])
        return
    # Bytes are 12 HU wide, and peaks are found to one of them.
    np.testing.assert_allclose(found, scale, atol=1.5 if scale[1] == 84.0 else 0.0)
    assert vm.presets.recognised(volume)[0][0] == "skin_and_bone"
    # Where a cell is bone does not depend on how the scanner stores it.
    nodes = vm.presets.bone(volume).values
    shown = np.interp(volume[name], nodes, vm.presets.bone(volume).opacities[:, 0]) > 0.5
    truth = np.interp(head()["a"], vm.presets.bone(head()).values, [0, 3, 8, 8]) > 0.5
    assert np.mean(shown == truth) > 0.999
    assert bool(vm.presets.recognised(volume)[1]) == (scale != (1.0, 0.0))


def test_bytes_that_may_be_ct_are_rescaled_with_a_warning():
    volume = head(1 / 12, 84.0, np.uint8)
    with pytest.warns(UserWarning, match="air at 1, soft tissue at 87"):
        medium = vm.presets.skin_and_bone(volume)
    assert medium.values.min() > 0


def test_dyes_have_their_colours():
    names = {"DAPI": 2, "Hoechst_33342": 2, "EGFP": 1, "FITC_": 1, "mCherry": 0, "TexasRed": 0}
    values = np.random.default_rng(0).random((8, 8, 8))
    grid = vm.CartesianGrid.uniform(8, (0, 1))
    volume = vm.Volume(grid, dict.fromkeys([*names, "Cy5"], values))
    white = {"color": [1.0, 1.0, 1.0]}
    volume.meta["channels"] = {name: {"label": name, **white} for name in volume.fields}
    parts = vm.presets.fluorescence(volume).components()
    for part, brightest in zip(parts, [*names.values(), None], strict=True):
        if brightest is None:  # beyond red: magenta
            assert part.color == (1.0, 0.0, 1.0)
        else:
            assert int(np.argmax(part.color)) == brightest
    # What a file says of a single one stays.
    volume.meta["channels"]["DAPI"]["color"] = [1.0, 1.0, 0.0]
    assert vm.presets.fluorescence(volume).components()[0].color == (1.0, 1.0, 0.0)
