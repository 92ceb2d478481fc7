"""Whatever is given for an argument, what comes is a picture or an error of this package's own."""

from __future__ import annotations

import contextlib

import numpy as np
import pytest
from astropy import units as u

import voluminous as vm

VOLUME = vm.Volume(vm.CartesianGrid.uniform(4, (-1, 1)))
VOLUME["a"] = "x"
SHELL = vm.Gaussian("a", 0.3, 0.1, 1.0, 0.3, 1.0)
CAMERA = vm.Orthographic(resolution=2)

# Numbers, texts, sequences and things that are none of what is asked for.
STRANGE = (
    *(None, "", "abc", "1 m", "a +", b"x", np.nan, np.inf, -1, 0, 1j, 10**400, True, -0.5),
    *([], [1, 2], [[1, 2], [3]], [None], ["red", 3], {}, (1, 2, 3, 4), range(3)),
    *(3 * u.m, np.array(None), np.array([1.0, np.nan]), object(), abs, SHELL),
)

SHELLS = {"expr": "a", "color": (1, 0.5, 0), "opacity": 0.3, "where": "a > 0"}
MAPPED = {"expr": "a", "cmap": "viridis", "vmin": 0, "vmax": 1, "norm": "linear", "samples": 16}
MAKERS = {
    "Gaussian": (vm.Gaussian, {**SHELLS, "center": 0.3, "sigma": 0.1, "path_length": 1.0}),
    "Rectangle": (vm.Rectangle, {**SHELLS, "center": 0.3, "half_width": 0.1, "path_length": 1.0}),
    "Isosurface": (
        vm.Isosurface,
        {**SHELLS, "level": 0.3, "width": 0.0, "density": "crossing", "shading": 0.5},
    ),
    "several levels": (
        vm.Isosurface,
        {"expr": "a", "level": [0.3, 0.4], "color": "viridis", "opacity": [0.3, 0.2]},
    ),
    "Table": (
        vm.Table,
        {"expr": "a", "values": [0, 1], "colors": [1, 2], "opacities": [0, 1], "path_length": 1},
    ),
    "Colormap": (vm.Colormap, {**MAPPED, "opacity": 1.0, "path_length": 1.0}),
    "ColorBy": (vm.ColorBy, {**MAPPED, "brightness": 1.0}),
    "Coefficients": (vm.Coefficients, {"emissivity": "a", "extinction": 1}),
    "function": (
        lambda fields, channels, parameters: vm.Medium.from_function(
            lambda a, p: (a, p * a), fields, channels, parameters=parameters
        ),
        {"fields": ["a"], "channels": 1, "parameters": {"p": 1}},
    ),
    "auto": (
        vm.suggest_medium,
        {"volume": VOLUME, "expr": "a", "n": 2, "opacity": 1.0, "cmap": "turbo"},
    ),
    "Orthographic": (
        vm.Orthographic,
        {"incl": 1, "phi": 1, "posang": 1, "width": 1, "resolution": 2, "shift": (0, 0)},
    ),
    "Perspective": (
        vm.Perspective,
        {"position": (3, 0, 0), "target": (0, 0, 0), "fov": 30, "resolution": 2, "zenith": 0},
    ),
    "Volume": (vm.Volume, {"grid": VOLUME.grid, "fields": {"a": np.zeros((4, 4, 4))}}),
    "column": (vm.column, {"volume": VOLUME, "quantity": "a", "camera": CAMERA}),
    "probe": (
        vm.probe,
        {"volume": VOLUME, "medium": SHELL, "camera": CAMERA, "pixel": (1, 1)},
    ),
}


@pytest.mark.parametrize(
    ("name", "argument"), [(name, key) for name, (_, given) in MAKERS.items() for key in given]
)
@pytest.mark.filterwarnings("ignore:the picture shows nothing")
def test_arguments_are_taken_or_refused_by_name(name, argument):
    make, given = MAKERS[name]
    make(**given)
    for strange in STRANGE:
        with contextlib.suppress(vm.VoluminousError):
            make(**{**given, argument: strange})


OPTIONS = ("scheme", "tolerance", "background", "device", "cutoff", "samples")
OPTIONS += ("antialias", "bounds", "max_panels")


@pytest.mark.parametrize("option", OPTIONS)
def test_options_of_render_are_taken_or_refused_by_name(option):
    for strange in STRANGE:
        with contextlib.suppress(vm.VoluminousError):
            image = vm.render(VOLUME, SHELL, CAMERA, **{option: strange})
            assert np.all(np.isfinite(image.intensity))


def test_a_background_with_a_unit_is_refused():
    """NumPy would drop the unit, and the picture would be of other light."""
    with pytest.raises(vm.InputError, match="background must be plain numbers"):
        vm.render(VOLUME, SHELL, CAMERA, background=3 * u.m)


def test_maps_without_a_camera_say_that_they_need_one():
    with pytest.raises(vm.InputError, match=r"needs a camera .*, got NoneType"):
        vm.column(VOLUME, "a", None)
    with pytest.raises(vm.InputError, match=r"needs a camera .*, got NoneType"):
        vm.moments(VOLUME, "a", None, velocity="a")


@pytest.mark.parametrize("samples", ["many", None, 1.5, 1, 10**9])
@pytest.mark.parametrize("make", [vm.Colormap, vm.ColorBy])
def test_entries_of_a_map_are_a_whole_number(make, samples):
    with pytest.raises(vm.InputError, match="samples must be a whole number from 2 to"):
        make("a", "viridis", 0, 1, samples=samples)
