"""vm.suggest_medium: what it chooses, and that a picture of any data shows something."""

from __future__ import annotations

import numpy as np
import pytest

import real_data
import voluminous as vm
from voluminous.calibration.histogram import histogram, sampled_values
from voluminous.calibration.suggest import is_wide, labels_of, main_scalar, noise_of
from voluminous.cli import main
from voluminous.drawing import api
from voluminous.expressions import Expression

CAMERA = vm.Orthographic(60, 30, resolution=100)


def cube(function, cells=40, **more):
    """Return a volume over (-1, 1)³ with a field `a` of the radius."""
    grid = vm.CartesianGrid.uniform(cells, (-1, 1))
    x, y, z = np.meshgrid(*grid.centers, indexing="ij")
    return vm.Volume(grid, a=function(np.sqrt(x**2 + y**2 + z**2)), **more)


def shells(medium):
    return medium.components()


def boundary(radius, values):
    """Return two materials with a smooth boundary, an error function four cells wide."""
    low, high = values
    return lambda r: low + (high - low) * 0.5 * (1 - np.tanh((r - radius) / 0.1))


@pytest.mark.parametrize("values", [(0.0, 1.0), (-1000.0, 50.0), (5.0, 6.0)])
def test_one_level_is_at_the_boundary_of_two_materials(values):
    # The mean gradient of tanh is greatest in the middle: d tanh = 1 - tanh².
    (shell,) = shells(vm.suggest_medium(cube(boundary(0.6, values)), n=1))
    assert shell.center == pytest.approx(np.mean(values), abs=0.05 * np.ptp(values))


def test_several_materials_get_a_level_each():
    # Three boundaries: 0 | 1 | 2 | 3 from outside to inside, at 0.5, 1.5, 2.5.
    steps = [boundary(radius, (0.0, 1.0)) for radius in (0.75, 0.5, 0.25)]
    volume = cube(lambda r: sum(step(r) for step in steps), 64)
    centers = [shell.center for shell in shells(vm.suggest_medium(volume, n=3))]
    assert centers == pytest.approx([0.5, 1.5, 2.5], abs=0.25)


def test_scale_free_data_gets_equally_spaced_logarithms():
    media = shells(vm.suggest_medium(vm.models.prestellar_core(64), n=5))
    assert {shell.expr.text for shell in media} == {"log10(density)"}
    steps = np.diff([shell.center for shell in media])
    assert np.ptp(steps) < 0.25 * steps.mean()  # the bins of the small, innermost shells are noisy


def test_both_ends_of_signed_data_are_seen():
    # Two jets of opposite velocity, each in less than a percent of the volume.
    grid = vm.CartesianGrid.uniform(48, (-1, 1))
    x, y, z = np.meshgrid(*grid.centers, indexing="ij")
    speed = np.exp(-(x**2 + y**2) / 0.1**2 - (abs(z) - 0.5) ** 2 / 0.3**2)
    centers = [
        shell.center for shell in shells(vm.suggest_medium(vm.Volume(grid, v=np.sign(z) * speed)))
    ]
    assert centers == pytest.approx([-c for c in reversed(centers)], abs=0.05)  # few cells
    assert centers[-1] > 0.4


def test_levels_are_above_noise_around_zero():
    # A source of 30 σ in noise, as telescopes see it.
    volume = cube(lambda r: 3.0 * np.exp(-((r / 0.4) ** 2)))
    noise = np.random.default_rng(2).normal(0, 0.1, volume.grid.shape)
    noisy = vm.Volume(volume.grid, a=volume.array("a") + noise)
    assert noise_of(sampled_values(noisy, Expression("a"))) == pytest.approx(0.1, rel=0.05)
    centers = [shell.center for shell in shells(vm.suggest_medium(noisy))]
    assert min(centers) > 0.4
    assert max(centers) > 1.5
    # Without the noise nothing is negative, and the range begins at zero.
    assert min(shell.center for shell in shells(vm.suggest_medium(volume))) < 0.4


def test_the_area_of_an_isosurface_is_that_of_the_sphere():
    volume, field = cube(lambda r: r, 64), Expression("a")
    found = histogram(volume, field, sampled_values(volume, field))
    expected = 4 * np.pi * found.centers**2 / 12  # in squares of the diagonal
    for low in np.arange(0.3, 0.9, 0.1):
        bins = (found.centers > low) & (found.centers < low + 0.1)
        # Some thousand cells, whose centres are no random points: a percent.
        assert found.area[bins].mean() == pytest.approx(expected[bins].mean(), rel=0.02)


@pytest.mark.parametrize(
    ("values", "wide"),
    [
        (np.geomspace(1, 1e3, 1000), True),
        (np.geomspace(1, 50, 1000), False),
        (np.linspace(-1, 1, 1000), False),
        (np.tanh(np.linspace(1e-9, 2, 1000)) ** 9, False),  # a material and its outskirts
        (np.concatenate([np.full(900, 1e-18), np.linspace(1e-9, 1, 100)]), False),  # a floor
        (np.concatenate([np.zeros(5000), np.geomspace(1e-9, 1, 100)]), True),
        (np.concatenate([[-1e-9], np.geomspace(1e-3, 1, 9999)]), True),  # one cell of noise
        (np.zeros(100), False),
        (np.array([]), False),
    ],
)
def test_a_logarithm_is_for_what_spans_decades(values, wide):
    assert is_wide(np.sort(values)) is wide


@pytest.mark.parametrize(
    ("names", "chosen"),
    [
        (("pressure", "density"), "density"),
        (("temperature", "Rho"), "Rho"),
        (("velocity_x", "vel2", "speed"), "speed"),
        (("flat", "noisy"), "noisy"),
        (("velocity_x",), "velocity_x"),
        (("velocity", "noisy"), "noisy"),
        (("velocity",), "velocity"),
    ],
)
def test_the_field_to_look_at_first(names, chosen):
    grid = vm.CartesianGrid.uniform(6, (0, 1))
    noise = np.random.default_rng(3).random(grid.shape)
    fields = {name: np.ones(grid.shape) if name == "flat" else noise for name in names}
    assert main_scalar(vm.Volume(grid, fields)).text == chosen


def test_labels_get_a_colour_each_but_not_the_background():
    a = np.zeros((12, 12, 12), np.uint8)
    a[2:5, 2:5, 2:5], a[6:10, 6:10, 6:10], a[7, 7, 7] = 2, 3, 5
    volume = vm.Volume(vm.CartesianGrid.uniform(12, (0, 12)), tissue=a)
    medium = vm.suggest_medium(volume, n=2)
    assert medium == vm.presets.labels(volume)
    assert medium.numbers == [2, 3, 5]
    assert len({tuple(color) for color in medium.describe()["colors"]}) == 3


@pytest.mark.parametrize(
    "values",
    [
        [0, 62, 125, 187],  # a coarsely measured number
        [0.5, 1.5],
        range(200),
        [3],
    ],
)
def test_what_is_no_label(values):
    a = np.resize(np.array(values), (8, 8, 8))
    for cells in (a, np.sort(a.ravel()).reshape(a.shape)):
        volume, field = vm.Volume(vm.CartesianGrid.uniform(8, (0, 1)), a=cells), Expression("a")
        found = labels_of(volume, field, sampled_values(volume, field))
        assert found is None or (cells is not a and len(values) == 200)


@pytest.mark.parametrize("value", [0.0, -3.25, 1e30, 1e-30])
def test_a_constant_shows_nothing(value):
    grid = vm.CartesianGrid.uniform(4, (0, 1))
    volume = vm.Volume(grid, a=np.full(grid.shape, value))
    with pytest.raises(vm.InputError, match="nothing to see"):
        vm.suggest_medium(volume)


def test_rounding_is_no_structure():
    value = 300.0
    # What is left of a constant after some arithmetic: a few units in the last place.
    noise = 1 + 1e-15 * np.random.default_rng(1).normal(size=(12, 12, 12))
    volume = vm.Volume(vm.CartesianGrid.uniform(12, (-1, 1)), temperature=value * noise)
    with pytest.raises(vm.InputError, match=f"temperature is {value:g} everywhere"):
        vm.suggest_medium(volume)
    # One odd cell, and the range of all others is no wider than rounding.
    odd = volume.array("temperature").copy()
    odd[5, 6, 7] *= 2
    del volume["temperature"]
    volume["temperature"] = odd
    assert len(shells(vm.suggest_medium(volume))) == 4


CORE = vm.models.prestellar_core(8)
UNKNOWN, INPUT = vm.errors.UnknownNameError, vm.InputError


@pytest.mark.parametrize(
    ("volume", "options", "error", "told"),
    [
        (CORE, {"expr": "densty"}, UNKNOWN, "density"),
        (CORE, {"cmap": "turbot"}, UNKNOWN, "turbo"),
        *((CORE, {"n": n}, INPUT, "positive whole number") for n in (0, 2.5, np.nan, np.inf, None)),
        (CORE, {"n": 101}, INPUT, "100 at most"),
        (CORE, {"opacity": -1}, INPUT, "positive"),
        (CORE, {"opacity": "1"}, INPUT, "positive"),
        (CORE, {"expr": "log10(-density)"}, INPUT, "no finite value"),
        (CORE, {"expr": np.zeros(3)}, INPUT, "expr must be a field or an expression"),
        (CORE, {"expr": 3}, INPUT, "for 3 shells write n=3"),
        (np.ones((2, 2, 2)), {}, INPUT, "needs a vm.Volume first.*holds an array"),
        ("data.npz", {}, INPUT, "vm.open"),
        (vm.Volume(CORE.grid), {}, INPUT, "no fields"),
    ],
)
def test_errors_say_what_to_do(volume, options, error, told):
    with pytest.raises(error, match=told):
        vm.suggest_medium(volume, **options)


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", real_data.names())
def test_a_picture_of_real_data_shows_something(name):
    volume = real_data.load(name)
    image = vm.render(volume, vm.suggest_medium(volume), CAMERA, scheme="second-order")
    shown = image.to_rgb().max(axis=-1)
    visible = shown > 0.05
    # Not black, and not full to the edge: the frame is wider than any volume.
    assert 0.03 < visible.mean() < 0.9
    # Faint and bright parts, neither of which is all there is.
    assert np.mean(shown[visible] > 0.98) < 0.1
    assert np.quantile(shown[visible], 0.95) > 3 * np.quantile(shown[visible], 0.05)
    # Colours, not one only: chromaticities differ by more than rounding.
    tints = image.to_rgb()[visible] / image.to_rgb()[visible].sum(axis=-1, keepdims=True)
    assert tints.std(axis=0).max() > 0.05
    # Nothing hides all the rest: rays through the middle of the picture come through in places.
    assert np.quantile(image.transparency[visible], 0.9) > 0.2


@pytest.fixture
def data(tmp_path, monkeypatch):
    """A data file in the working directory."""
    monkeypatch.chdir(tmp_path)
    cube(lambda r: np.exp(-5 * r), 12, velocity_x=np.ones((12,) * 3)).save("ball.npz")
    return tmp_path


def test_render_makes_a_picture_of_a_data_file(data, capsys):
    assert main(["render", "ball.npz"]) == 0
    assert "ball.png: 800 x 800 pixels, 3 channels" in capsys.readouterr().out
    image = vm.Image.load("ball.png")
    assert image.camera["incl"] == 60
    assert image.provenance["scene"]["volume"] == {"path": "ball.npz", "fields": ["a"]}
    assert 0.1 < (image.intensity.max(axis=-1) > 0.02).mean() < 0.9


def test_a_picture_of_a_data_file_is_a_scene(data):
    small = ["--set", "camera.resolution=20"]
    assert main(["render", "ball.npz", "-o", "a.png", "-n", "2", "--incl", "10", *small]) == 0
    assert main(["render", "a.png", "-o", "b.png"]) == 0
    first, second = vm.Image.load("a.png"), vm.Image.load("b.png")
    np.testing.assert_array_equal(first.intensity, second.intensity)
    assert first.camera["incl"] == 10
    assert len(first.provenance["scene"]["medium"]) == 2


def test_a_first_picture_needs_a_volume_only():
    volume = vm.models.prestellar_core(16)
    image = vm.render(volume)
    expected = vm.render(volume, vm.suggest_medium(volume), vm.Orthographic(incl=60, phi=30))
    np.testing.assert_array_equal(image.intensity, expected.intensity)
    with pytest.raises(vm.InputError, match="Volume"):
        vm.render("density")


def test_the_medium_of_first_pictures_is_found_once_and_anew_where_a_field_has_changed(monkeypatch):
    counted = []
    found = api.suggest_medium
    monkeypatch.setattr(api, "suggest_medium", lambda volume: counted.append(1) or found(volume))
    values = cube(boundary(0.5, (0.0, 1.0)), 24).array("a").copy()
    volume = vm.Volume(vm.CartesianGrid.uniform(24, (-1, 1)), a=values)
    first = vm.render(volume)
    np.testing.assert_array_equal(vm.render(volume).intensity, first.intensity)
    assert len(counted) == 1
    values[:] = 1.0 - values  # in place, as whoever has the array may
    assert vm.render(volume).provenance["medium"] == vm.suggest_medium(volume).describe()
    volume["b"] = np.zeros(volume.grid.shape)
    vm.render(volume)
    assert len(counted) == 3


def organs():
    """Return a volume of three labels within each other."""
    labels = np.zeros((8, 8, 8), np.uint8)
    labels[2:6, 2:6, 2:6], labels[3:5, 3:5, 3:5] = 1, 3
    labels[2, 2, 2] = 2
    return vm.Volume(vm.CartesianGrid.uniform(8, (-1, 1)), organ=labels)


def test_a_first_picture_of_labels_shows_no_others_between_two():
    volume = organs()
    image = vm.render(volume)
    assert image.provenance["scheme"] == "second-order"
    medium = vm.suggest_medium(volume)
    for options in ({}, {"scheme": "second-order"}):
        chosen = vm.render(volume, medium, vm.Orthographic.framing(volume, medium), **options)
        np.testing.assert_array_equal(image.intensity, chosen.intensity)
    assert vm.render(volume, scheme="first-order").provenance["scheme"] == "first-order"
