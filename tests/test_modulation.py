"""Gates and colours by other expressions: `where` and `ColorBy` on every medium."""

from __future__ import annotations

import matplotlib
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import voluminous as vm
from voluminous.scene.settings import loads

PRECISIONS = ["single", "double"]
SCHEMES = ["post-classified", "first-order"]
ALONG_X = vm.Orthographic.looking([-1, 0, 0], [0, 0, 1], width=0.25, resolution=1)


def line(resolution=16, **fields):
    """Return a volume from 0 to 1, whose fields a ray along x sees as functions of x."""
    grid = vm.CartesianGrid.uniform((resolution, 2, 2), (0, 1))
    volume = vm.Volume(grid, a="x")
    for name, text in fields.items():
        volume[name] = text
    return volume


def seen(medium, volume=None, camera=ALONG_X, **options):
    """Return the picture's only pixel."""
    return vm.render(volume or line(b="x"), medium, camera, **options).intensity[0, 0]


def media(**options):
    """Return one medium of each kind that takes a gate."""
    return {
        "gaussian": vm.Gaussian("a", 0.5, 0.1, (1.0, 0.5, 0.2), 0.3, 0.2, **options),
        "rectangle": vm.Rectangle("a", 0.5, 0.1, (1.0, 0.5, 0.2), 0.3, 0.2, **options),
        "table": vm.Table("a", [0.2, 0.5, 0.7], np.eye(3), [0.1, 0.5, 0.2], 0.3, **options),
        "colormap": vm.Colormap("a", "viridis", 0.1, 0.9, 0.4, 0.3, **options),
    }


KINDS = sorted(media())


# Gates


@pytest.mark.each_value_once
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("scheme", "precision"), [("post-classified", "single"), ("first-order", "double")]
)
def test_a_gate_of_one_changes_nothing_and_one_of_zero_leaves_nothing(kind, scheme, precision):
    options = {"scheme": scheme, "precision": precision, "tolerance": 1e-5}
    plain = seen(media()[kind], **options)
    found = seen(media(where="b + 2")[kind], **options)
    # In single precision media without a gate are sampled, to the tolerance.
    np.testing.assert_allclose(found, plain, rtol=1e-5 if precision == "single" else 1e-14)
    closed = seen(media(where="log10(-1 - b)")[kind], **options)  # NaN
    np.testing.assert_array_equal(closed, 0)


@pytest.mark.parametrize("kind", KINDS)
def test_a_hard_gate_is_the_medium_restricted(kind):
    # The gate is open where the ray is in the last third: what is seen through the other two is
    # not there. Adding both halves of a cut gives the whole.
    thin = {"tolerance": 1e-5, "precision": "double"}
    parts = [media(where=gate)[kind] for gate in ("b > 0.43", "b <= 0.43")]
    whole = seen(media()[kind], **thin)
    np.testing.assert_allclose(seen(parts[0] + parts[1], **thin), whole, rtol=1e-4)


@pytest.mark.parametrize("precision", PRECISIONS)
def test_a_gate_inside_a_cell_is_found_where_it_is(precision):
    # A uniform medium between 0.43 and 0.57, which no cell's wall or centre is near to: 0.14 long.
    medium = vm.Table("a", [-1, 2], [1.0, 1.0], 0, 1.0, where="0.43 < b < 0.57")
    for resolution in (3, 16):
        volume = line(resolution, b="x")
        found = seen(medium, volume, tolerance=1e-5, precision=precision)
        # In single precision panels are halved eight times at most.
        assert found.item() == pytest.approx(0.14, rel=1e-3 if precision == "double" else 5e-3)


@settings(max_examples=30, deadline=None)
@given(lo=st.floats(-2, 2), size=st.floats(0, 2), share=st.floats(0, 1), threshold=st.floats(-1, 1))
def test_bounds_hold_gated_and_coloured_coefficients(lo, size, share, threshold):
    by = vm.ColorBy("b", "plasma", -1, 1)
    medium = vm.Gaussian("a", 0.5, 1.0, by, 0.4, 1.0, where=f"b > {threshold!r}")
    found = medium.bounds({"a": lo, "b": lo}, {"a": lo + size, "b": lo + size})
    value = lo + share * size
    gate = value > threshold
    shape = gate * np.exp(-0.5 * (value - 0.5) ** 2)
    rgb = np.array(matplotlib.colormaps["plasma"](np.linspace(0, 1, 256)))[:, :3]
    color = [np.interp(value, np.linspace(-1, 1, 256), channel) for channel in rgb.T]
    assert found.a_lo[0] - 1e-15 <= 0.4 * shape <= found.a_hi[0] + 1e-15
    for c in range(3):
        assert found.j_lo[c] - 1e-15 <= color[c] * shape <= found.j_hi[c] + 1e-15


# Colours


def test_colour_by_a_constant_is_that_colour():
    volume = line(b="0 * x + 0.3")
    color = matplotlib.colormaps["viridis"](np.linspace(0, 1, 256))[:, :3]
    expected = np.array([np.interp(0.3, np.linspace(0, 1, 256), c) for c in color.T])
    for scheme in SCHEMES:
        by = vm.Gaussian("a", 0.5, 0.1, vm.ColorBy("b", "viridis", 0, 1), 0.3, 0.2)
        plain = vm.Gaussian("a", 0.5, 0.1, expected, 0.3, 0.2)
        found = [seen(medium, volume, scheme=scheme) for medium in (by, plain)]
        np.testing.assert_allclose(found[0], found[1], rtol=2e-4)  # to the tolerance


@pytest.mark.each_value_once
@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("place", [0.21, 0.5, 0.77])
def test_a_thin_shell_has_the_colour_of_its_place(place, precision):
    # Far thinner than a cell. The colour is that of b = 1 - x where a = x passes the centre.
    volume = line(8, b="1 - x")
    by = vm.ColorBy("b", "plasma", 0, 1, brightness=2.0)
    thin = 1e-4
    cases = [
        (1, vm.Gaussian("a", place, thin, by, 0, thin * np.sqrt(2 * np.pi))),
        (1, vm.Rectangle("a", place, thin, by, 0, 2 * thin)),
        # Of optical depth one, and its emission is its opacity times the colour.
        (-np.expm1(-1), vm.Table("a", [place - thin, place, place + thin], by, [0, 1, 0], thin)),
    ]
    color = matplotlib.colormaps["plasma"](np.linspace(0, 1, 256))[:, :3]
    expected = 2 * np.array([np.interp(1 - place, np.linspace(0, 1, 256), c) for c in color.T])
    for factor, medium in cases:
        found = seen(medium, volume, precision=precision)
        # The tolerance of the picture, and the shell's own extent.
        np.testing.assert_allclose(found, factor * expected, atol=2e-3 * expected.max())


# Scenes, and what is refused


SCENE = """
[volume]
model = "prestellar_core"
resolution = 8

[[medium]]
type = "gaussian"
expr = "log10(density)"
center = 3.5
sigma = 0.05
opacity = 0.3
path_length = "auto"
where = "x > 0"
color = {expr = "log10(density)", cmap = "inferno", vmin = 3, vmax = 5, norm = "linear"}

[[medium]]
type = "table"
expr = "log10(density)"
values = [3, 4, 5]
colors = {expr = "r", cmap = "viridis", vmin = "0 pc", vmax = "0.1 pc", brightness = 0.5}
opacities = [0, 1, 0]
path_length = "0.1 pc"

[[medium]]
type = "colormap"
expr = "density"
cmap = "viridis"
vmin = 1
vmax = 10
opacity = 0.1
path_length = 1.0
where = "0.5"
"""


def test_scenes_carry_gates_and_colours():
    scene = vm.Scene(loads(SCENE))
    again = vm.Scene(loads(scene.dumps()))
    assert again.medium.key() == scene.medium.key()
    objects = vm.Scene({"volume": {"model": "sphere"}, "medium": scene.medium})
    assert objects.medium.key() == scene.medium.key()
    first, second, third = scene.medium.components()
    assert first.color == (1.0, 1.0, 1.0)
    assert first.describe()["where"] == "x > 0"
    assert second.color == (0.5, 0.5, 0.5)
    assert third.describe()["where"] == "0.5"


BY = vm.ColorBy("b", "viridis", 0, 1)
UNKNOWN, INPUT = vm.errors.UnknownNameError, vm.InputError
REFUSED = [
    (lambda: vm.ColorBy("b", "virids", 0, 1), UNKNOWN, "viridis"),
    (lambda: vm.ColorBy("b", "viridis", 1, 0), INPUT, "vmin must be below vmax"),
    (lambda: vm.ColorBy("b", "viridis", 0, 1, norm="log"), INPUT, "positive vmin"),
    (lambda: vm.ColorBy("b", "viridis", 0, 1, brightness=[1, 2]), INPUT, "one number"),
    (lambda: vm.Gaussian("a", 0, 1, 1, 1, 1, where="b >"), vm.errors.ExpressionError, "b >"),
    (lambda: vm.Table("a", [0, 1], BY, np.ones((2, 2)), 1), INPUT, "one column or 3"),
    (lambda: vm.Isosurface("a", [0, 1], "ornge"), UNKNOWN, "the color 'orange'"),
    (lambda: seen(vm.Gaussian("a", 0, 1, 1, 1, 1, where="bb")), UNKNOWN, "'b'"),
]


@pytest.mark.parametrize(("make", "error", "match"), REFUSED)
def test_what_is_refused(make, error, match):
    with pytest.raises(error, match=match):
        make()
