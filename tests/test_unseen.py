"""A picture that shows nothing of a medium, or of a part of it, says why."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

import voluminous as vm
from voluminous.cli import main
from voluminous.errors import InputError
from voluminous.expressions.interval import Interval
from voluminous.media.ranges import RangeContext

CAMERA = vm.Orthographic(30, 20, resolution=12)


@pytest.fixture
def volume():
    grid = vm.CartesianGrid.uniform(6, (-1, 1))
    made = vm.Volume(grid, density=1 + np.arange(216.0).reshape(6, 6, 6))
    made.set_unit("density", "g / cm3")
    return made


@pytest.mark.parametrize(
    ("medium", "told"),
    [
        (
            vm.Isosurface("density", 500.0),
            r"isosurface at 500 lies .* density is from 1 to 216 g / cm3 .*vm.suggest_medium",
        ),
        (vm.Isosurface("density", level=[300, 400]), r"isosurface at 300, 400 lies"),
        (vm.Gaussian("log10(density)", -4, 0.1, 1, 1, 1), r"gaussian at -4 .* from 0 to 2.33445 "),
        (vm.Rectangle("density", 300, 1, 1, 1, 1), "rectangle at 300 lies"),
        (vm.Isosurface("density", 500.0, where="x > 0"), "at 500 where x > 0 lies"),
        (
            vm.Isosurface("density", 500.0) + vm.Rectangle("density", 300, 1, (1, 1, 1), 1, 1),
            "isosurface at 500 .*; its rectangle at 300",
        ),
    ],
)
@pytest.mark.parametrize("tolerance", [1e-3, None])
def test_values_that_are_not_there(volume, medium, told, tolerance):
    with pytest.warns(UserWarning, match=told) as caught:
        vm.render(volume, medium, CAMERA, tolerance=tolerance)
    assert caught[0].filename == __file__


@pytest.mark.parametrize("offset", [8, 20])
def test_tails_alone_are_told_though_a_display_brightens_them(volume, offset):
    shell = vm.Gaussian("log10(density)", 2.4 + 0.1 * offset, 0.1, (1, 1, 1), 0.5, 1)
    with pytest.warns(UserWarning, match=r"only the faintest edge .* from 0 to 2.33445 dex"):
        image = vm.render(volume, shell, CAMERA, precision="double")
    assert image.intensity.max() > 0


def test_what_tables_and_soft_gates_leave_may_be_wanted(volume):
    shell = vm.Gaussian("log10(density)", 2, 0.1, 1, 0.5, 1, where="density * 1e-6")
    ramp = vm.Colormap("density", "gray", 0, 1e6, opacity=lambda p: p**2, path_length=1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for medium in (shell, ramp):
            assert vm.render(volume, medium, CAMERA).intensity.max() > 0


def test_a_camera_that_looks_away(volume):
    medium = vm.Isosurface("density", 100.0)
    away = vm.Perspective((5, 0, 0), (6, 0, 0), fov=10, resolution=4)
    with pytest.warns(UserWarning, match="no ray of this camera meets it"):
        vm.render(volume, medium, away)


def test_no_warning_where_anything_shows_or_other_things_are_drawn(volume):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        vm.render(volume, vm.Isosurface("density", 100.0), CAMERA)
        vm.render(volume, vm.Isosurface("density", 100.0, color=0.0), CAMERA)  # it absorbs
        stars = vm.Stars([(0, 0, 0)], luminosities=1.0)
        vm.render(volume, vm.Isosurface("density", 500.0), CAMERA, objects=[stars])


@pytest.mark.parametrize("grid", [np.ones((3, 4, 5)), {"density": 1}, None, "sphere"])
def test_a_volume_needs_a_grid(grid):
    with pytest.raises(InputError, match=r"grid and its fields, such as vm\.Volume\("):
        vm.Volume(grid)


def cartesian():
    return vm.CartesianGrid.uniform(6, (-1, 1))


def octree():
    walls = np.linspace(-1, 1, 5)
    return vm.OctreeGrid.from_function(walls, walls, walls, lambda x, y, z, size: x > 0.5, 1)


def spherical():
    return vm.SphericalGrid(np.linspace(0.2, 1, 7))


def rising(grid):
    """A field from 1 to the number of cells."""
    return vm.Volume(grid, density=1 + np.arange(float(grid.size)).reshape(grid.shape))


def warnings_of(volume, medium, camera=CAMERA, **options):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        vm.render(volume, medium, camera, **options)
    return [str(one.message) for one in caught]


SEEN = vm.Isosurface("density", 3.5)


@pytest.mark.parametrize("grid", [cartesian, octree, spherical])
@pytest.mark.parametrize(
    ("lost", "told"),
    [
        (vm.Isosurface("density", 500.0), r"isosurface at 500 lies outside .* density is from 1 "),
        (vm.Gaussian("log10(density)", -4, 0.3, (1, 1, 1), 1), r"gaussian at -4 lies .* from 0 to"),
        (vm.Isosurface("density", level=[500, 3, 900]), r"isosurface at 500, 900 lies outside"),
        (
            vm.Isosurface("density", 3.0, where="x > 2"),
            r"isosurface at 3 is left out everywhere by where='x > 2': x is from -1 to 1 in this",
        ),
        (
            vm.Table("density", [-2, -1, 0], [(0, 0, 0), (1, 1, 1), (0, 0, 0)], [0, 1, 0]),
            r"table lies outside of all there is: density is from 1",
        ),
    ],
)
def test_each_part_that_is_nowhere_is_told(grid, lost, told):
    volume = rising(grid())
    (message,) = warnings_of(volume, SEEN + lost)
    assert message.startswith("the picture lacks a part of the medium: its ")
    with pytest.warns(UserWarning, match=told) as caught:
        vm.render(volume, lost + SEEN, CAMERA)
    assert len(caught) == 1
    assert caught[0].filename == __file__
    assert "vm.suggest_medium" in message


def test_levels_of_one_surface(volume):
    (message,) = warnings_of(volume, vm.Isosurface("density", level=[0.5, 100, 300]))
    assert "isosurface at 0.5, 300 lies" in message
    both = vm.Isosurface("density", level=[300, 400])
    assert warnings_of(volume, both)[0].startswith("the picture shows nothing of the medium")


@pytest.mark.parametrize(
    "part",
    [
        vm.Isosurface("density", 100.0, where="y < 0"),
        vm.Isosurface("density", 500.0, opacity=0),
        vm.Isosurface("density", level=[100, 500], opacity=[0.5, 0.0]),
        vm.Gaussian("density", 500.0, 1.0, (0, 0, 0), 0),
        vm.Gaussian("density", 216 + 40.0, 10.0, (1, 1, 1), 0.5),  # four σ: its tail shows
        vm.Gaussian("density", 216 + 60.0, 10.0, (1e9, 0, 0), 0),  # six σ, but bright
        vm.Gaussian("density", 100.0, 1.0, (1e-9, 0, 0), 0),  # faint, but there
        vm.Colormap("density", "viridis", 300, 400, 0.5),  # constant beyond its ends
        vm.Coefficients(["0 * x"] * 3, "0 * x"),  # formulas look for no value
        vm.Medium.from_function(lambda d: ([0 * d] * 3, 0 * d), "density", 3),
    ],
)
def test_no_false_alarms(volume, part):
    assert warnings_of(volume, SEEN + part) == []


def test_a_sum_has_the_shells_of_its_parts():
    part = vm.Isosurface("density", level=[100, 500], opacity=[0.5, 0.0])
    medium = part + vm.Gaussian("density", 2.0, 1.0, (1, 1, 1), 1) + vm.Coefficients(["x"] * 3, 0)
    assert [shell.value for shell in medium.shells()] == [100, 500, 2.0]
    assert [shell.dark for shell in medium.shells()] == [False, True, False]


def test_how_large_a_sum_may_be_on_a_ray():
    surfaces = vm.Isosurface("density", 3.0, color=(1, 1, 1), width=0.5)
    medium = surfaces + vm.Coefficients(["density"] * 3, 0)
    fields = {"density": Interval(np.array([1.0, 2.0]), np.array([2.0, 4.0]))}
    found = medium.largest(fields, RangeContext(None, lambda _: None))
    np.testing.assert_array_equal(found.emissivity, [[2.0, np.inf]] * 3)
    np.testing.assert_array_equal(found.extinction[0], [0.0, np.inf])


def test_parts_beside_the_frame_are_there(volume):
    beside = vm.Orthographic(30, 20, width=0.05, center=(-0.7, 0, 0), resolution=8)
    media = vm.Gaussian("x", -0.7, 0.05, (1, 1, 1), 1) + vm.Gaussian("x", 0.8, 0.01, (1, 1, 1), 1)
    assert warnings_of(volume, media, beside) == []


def test_parts_are_told_beside_a_camera_that_looks_away_and_objects(volume):
    medium = SEEN + vm.Isosurface("density", 500.0)
    away = vm.Perspective((5, 0, 0), (6, 0, 0), fov=10, resolution=4)
    (message,) = warnings_of(volume, medium, away)
    assert "no ray of this camera meets it" in message
    assert "its isosurface at 500 lies outside" in message
    (message,) = warnings_of(volume, medium, objects=[vm.Stars([(0, 0, 0)], luminosities=1.0)])
    assert message.startswith("the picture lacks a part")


def test_many_parts_are_counted(volume):
    medium = sum([vm.Isosurface("density", 500.0 + k) for k in range(7)], SEEN)
    (message,) = warnings_of(volume, medium)
    assert "at 503 lies" in message
    assert "; and 3 more. Choose" in message


def test_what_is_outside_is_kept_and_fields_are_looked_at_once(monkeypatch):
    values = 1 + np.arange(216.0).reshape(6, 6, 6)
    volume = vm.Volume(cartesian(), density=values)
    medium = SEEN + vm.Isosurface("density", 500.0)
    vm.render(volume, SEEN, CAMERA)
    looks = []
    monkeypatch.setattr(
        "voluminous.rendering.cache.Statistics._compute_extremes", lambda *a: looks.append(a)
    )
    assert len(warnings_of(volume, medium)) == 1
    assert len(warnings_of(volume, medium)) == 1
    assert not looks
    monkeypatch.undo()
    values[3, 3, 3] = 600  # changed in place: it is looked at again
    assert warnings_of(volume, medium) == []


def test_missing_values_are_not_in_the_range():
    values = 1 + np.arange(216.0).reshape(6, 6, 6)
    values[-1, -1, -1] = np.nan
    volume = vm.Volume(cartesian(), density=values)
    (message,) = warnings_of(volume, SEEN + vm.Isosurface("density", 215.5))
    assert "density is from 1 to 215 in" in message


def test_the_command_line_tells_each_part_once(tmp_path):
    volume = rising(cartesian())
    volume.save(tmp_path / "cube.h5")
    scene = tmp_path / "scene.toml"
    scene.write_text(
        """
        [volume]
        path = "cube.h5"
        [[medium]]
        type = "isosurface"
        expr = "density"
        level = [100, 500]
        [camera]
        type = "orthographic"
        resolution = 8
        """
    )
    told = "lacks a part of the medium: its isosurface at 500 lies .* density is from 1 to 216"
    with pytest.warns(UserWarning, match=told) as caught:
        assert main(["render", str(scene), "-o", str(tmp_path / "out.png")]) == 0
    assert len(caught) == 1
