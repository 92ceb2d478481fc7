"""Colours as matplotlib writes them, with alpha, at every door; and volumes that show nothing."""

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.colors import ListedColormap

import voluminous as vm
from voluminous.errors import InputError

VIRIDIS = mpl.colormaps["viridis"]
RED, PALE = (1.0, 0.0, 0.0, 1.0), (1.0, 0.0, 0.0, 0.5)
CORE = vm.models.prestellar_core(16)
CAMERA = vm.Orthographic(resolution=6)
SHELL = vm.Gaussian("log10(density)", 4, 0.1, "red", 0.3, 1e16)


def drawn(**options):
    return vm.render(CORE, SHELL, CAMERA, **options).intensity


DOORS = {
    "gaussian": lambda c: vm.Gaussian("a", 1, 1, c, 1).color,
    "rectangle": lambda c: vm.Rectangle("a", 1, 1, c, 1).color,
    "isosurface": lambda c: vm.Isosurface("a", 1, c).colors,
    "isosurfaces": lambda c: vm.Isosurface("a", level=[1, 2], color=[c, c]).colors,
    "table": lambda c: vm.Table("a", [1, 2], [c, c], [0, 1]).colors,
    "mix": lambda c: vm.Image(np.ones((2, 2, 2))).to_rgb(mix=[c, c]),
    "star": lambda c: drawn(objects=[vm.Stars([(0, 0, 0)], c, radii=1e16)]),
    "stars": lambda c: drawn(objects=[vm.Stars(np.zeros((2, 3)), [c, c], radii=1e16)]),
    "spheres": lambda c: drawn(objects=[vm.Spheres(np.zeros((1, 3)), 1e16, c)]),
    "lines": lambda c: drawn(objects=[vm.Curves(np.eye(3) * 1e16, c)]),
    "boxes": lambda c: drawn(objects=[vm.Boxes(colors=c)]),
    "axes": lambda c: drawn(objects=[vm.Axes(colors=[c, c, c])]),
}


@pytest.mark.parametrize("door", DOORS)
def test_an_alpha_of_one_is_dropped_and_any_other_refused(door):
    expected = DOORS[door](RED[:3])
    np.testing.assert_array_equal(DOORS[door](RED), expected)
    np.testing.assert_array_equal(DOORS[door](np.array(RED)), expected)
    np.testing.assert_array_equal(DOORS[door]("#ff0000ff"), expected)
    for color in (PALE, np.array(PALE), "#ff000080", ("red", 0.5)):
        with pytest.raises(InputError, match="opacity="):
            DOORS[door](color)


def test_backgrounds():
    np.testing.assert_array_equal(drawn(background=RED), drawn(background=RED[:3]))
    with pytest.raises(InputError, match="background: a colour has no opacity"):
        drawn(background=PALE)


def test_what_is_behind_a_picture_and_around_it():
    image = vm.render(CORE, SHELL, CAMERA)
    white = image.to_rgb(background="white")
    np.testing.assert_array_equal(image.to_rgb(background="#ffffffff"), white)
    np.testing.assert_array_equal(image.to_rgb(background=(1, 1, 1, 1)), white)
    for color in ("#ffffff80", ("white", 0.5), (1, 1, 1, 0.5)):
        with pytest.raises(InputError, match="background: a colour has no opacity"):
            image.to_rgb(background=color)
        with pytest.raises(InputError, match="paper: a colour has no opacity"):
            image.annotate(paper=color)


def test_colormaps_with_alpha_are_refused():
    clear = ListedColormap([PALE, RED], name="clear")
    for make in (
        lambda: vm.Colormap("a", clear, 0, 1),
        lambda: vm.ColorBy("a", clear, 0, 1),
        lambda: vm.suggest_medium(CORE, cmap=clear),
    ):
        with pytest.raises(InputError, match="opacity="):
            make()
    rows = VIRIDIS([0.2, 0.8])
    np.testing.assert_array_equal(vm.Table("a", [1, 2], rows, [0, 1]).colors, rows[:, :3])


def test_a_list_of_four_is_four_channels_unless_it_ends_in_one():
    assert vm.Gaussian("a", 1, 1, [0.1, 0.2, 0.3, 0.5], 1).channels == 4
    assert vm.Gaussian("a", 1, 1, [0.1, 0.2, 0.3, 1.0], 1).color == (0.1, 0.2, 0.3)
    assert vm.Table("a", [1, 2], [[0, 0, 0, 1], [1, 1, 1, 1]], 1).channels == 3
    assert vm.Table("a", [1, 2], [[0, 0, 0, 0.5], [1, 1, 1, 1]], 1).channels == 4
    assert vm.Table("a", [1, 2, 3, 4], [0.1, 0.2, 0.3, 1.0], 1).channels == 1
    assert vm.Gaussian("a", 1, 1, (0.1, 0.2, 0.3, 5.0), 1).channels == 4
    assert vm.Table("a", [1, 2, 3, 4], (0.1, 0.2, 0.3, 1.0), 1).channels == 1


def test_one_emissivity_for_several_extinctions():
    with pytest.raises(InputError, match="give three emissivities"):
        vm.Coefficients(0, ["a", "b", "c"])
