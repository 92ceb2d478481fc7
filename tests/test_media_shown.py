"""What media are at values, drawn as transfer functions, and what notebooks show of values."""

import matplotlib as mpl
import numpy as np
import pytest
from astropy import units as u

import voluminous as vm
from voluminous.deferred import Deferred

mpl.use("Agg")
CORE = vm.models.prestellar_core(16)


def test_a_medium_at_values():
    j, alpha = vm.Gaussian("log10(density)", 4, 0.1, (1, 0.5, 0), 0.3, 2.0)([4.0, 4.1])
    shape = np.exp([0, -0.5])
    np.testing.assert_allclose(j, shape[:, None] * [0.5, 0.25, 0], rtol=1e-12)
    np.testing.assert_allclose(alpha, 0.15 * shape, rtol=1e-12)
    shell = vm.Rectangle("density", 4 * u.cm**-3, 1 * u.cm**-3, 1, [0.5], 1.0)
    assert shell(3.5e6 * u.m**-3)[1] == 0.5
    assert shell(5.5e6 * u.m**-3)[1] == 0.0


def test_a_medium_at_values_of_its_fields():
    medium = vm.Coefficients(["a", "2 * b"], "a * b")
    j, alpha = medium({"a": [1.0, 2.0], "b": 3.0})
    np.testing.assert_array_equal(j, [[1, 6], [2, 6]])
    np.testing.assert_array_equal(alpha, [3, 6])
    total = vm.Gaussian("a", 1, 1, 1, 1, 1.0, where="b > 2") + vm.Coefficients("b", "b")
    np.testing.assert_array_equal(total({"a": 1.0, "b": [1.0, 3.0]})[1], [1.0, 4.0])
    per_parsec = vm.Gaussian("a", 1, 1, 1, 1, 2 * u.pc)
    assert per_parsec(1.0)[1] == 0.5
    table = vm.Table("a", [0, 1], [0, 1], [[0], [2]], 1.0)
    assert table(0.5)[1] == 1.0
    with pytest.raises(vm.InputError, match="give a dict with values of each"):
        medium(3.0)
    with pytest.raises(vm.UnknownNameError, match="'b'"):
        medium({"a": 3.0})
    with pytest.raises(vm.InputError, match="auto"):
        vm.Gaussian("a", 1, 1, 1, 1)(1.0)


def test_a_transfer_function_shows_what_the_medium_is():
    medium = vm.calibrate(vm.Gaussian("log10(density)", 4, 0.1, (1, 0.5, 0), 0.3), CORE)
    axes = medium.plot(CORE)
    x, red = axes.lines[0].get_data()
    np.testing.assert_allclose(red, medium(np.asarray(x))[0][:, 0], rtol=1e-12)
    assert x[0] < 4 < x[-1]
    assert axes.get_xlabel().startswith("log10(density) [")
    assert [t.get_text() for t in axes.get_legend().get_texts()][-1] == "α"


@pytest.mark.parametrize(
    "medium",
    [
        vm.Rectangle("density", 1e4, 1e3, "red", 1, where="x > 0"),
        vm.Colormap("density", "viridis", where="x > 0"),
        vm.Gaussian("log10(density)", 4, 0.1, vm.ColorBy("density", "viridis"), 1),
        vm.Isosurface("log10(density)", levels=[3.5, 4], color="turbo"),
        vm.Coefficients(["density", 0, "density"], 0),
        vm.Coefficients("density * x / r", 0),
        vm.Medium.from_function(lambda d: (d, 0 * d), ["density"], 1, units=("1", "1/cm")),
    ],
)
def test_every_kind_of_medium_is_drawn(medium):
    axes = medium.plot(CORE)
    assert axes.lines
    for line in axes.lines:
        assert np.any(np.isfinite(line.get_ydata()))
    assert ("x > 0" in axes.get_title()) == ("x > 0" in repr(medium))


def test_a_sum_has_a_panel_for_each_expression():
    total = vm.auto(CORE) + vm.Colormap("density", "viridis")
    panels = total.plot(CORE)
    assert [p.get_xlabel().split(" [")[0] for p in panels] == ["log10(density)", "density"]
    with pytest.raises(vm.InputError, match="leave out ax"):
        total.plot(CORE, ax=panels[0])
    assert vm.auto(CORE).plot(CORE, ax=panels[0]) is panels[0]


def test_notebooks_show_values():
    for value in (vm.auto(CORE), vm.Orthographic(30), vm.Star((0, 0, 0), radius=1)):
        assert "<table>" in value._repr_html_()
    assert "linear-gradient" in vm.Colormap("density", "viridis")._repr_html_()
    shown = CORE._repr_html_()
    assert "data:image/png" in shown
    assert "density" in shown
    assert CORE.slice("density")._repr_png_().startswith(b"\x89PNG")


def test_a_notebook_counts_what_lacks_a_value():
    a = np.ones((4, 4, 4))
    a[0] = np.nan
    volume = vm.Volume(vm.CartesianGrid.uniform(4, (-1, 1)), a=a)
    assert "<td>0.25</td>" in volume._repr_html_()


def test_a_notebook_reads_no_file():
    volume = vm.Volume(vm.CartesianGrid.uniform(4, (-1, 1)))
    volume["a"] = Deferred(lambda: np.ones((4, 4, 4)), "f8")
    assert "not read yet" in volume._repr_html_()
    assert volume.waiting == ("a",)
