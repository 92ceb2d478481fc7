"""What media are at values, drawn as transfer functions, and what notebooks show of values."""

import matplotlib as mpl
import numpy as np
import pytest
from astropy import units as u

import voluminous as vm

mpl.use("Agg")
CORE = vm.models.prestellar_core(16)


def test_a_medium_at_values():
    j, alpha = vm.Gaussian("log10(density)", 4, 0.1, (1, 0.5, 0), 0.3, 2.0)([4.0, 4.1])
    shape = np.exp([0, -0.5])
    np.testing.assert_allclose(j, np.outer([0.5, 0.25, 0], shape), rtol=1e-12)
    np.testing.assert_allclose(alpha, 0.15 * shape, rtol=1e-12)
    shell = vm.Rectangle("density", 4 * u.cm**-3, 1 * u.cm**-3, 1, [0.5], 1.0)
    assert shell(3.5e6 * u.m**-3)[1] == 0.5
    j, alpha = shell(np.full((4, 3), 4) / u.cm**3)
    assert (j.shape, alpha.shape) == ((1, 4, 3), (4, 3))
    assert shell(5.5e6 * u.m**-3)[1] == 0.0


def test_a_medium_at_values_of_its_fields():
    medium = vm.Coefficients(["a", "2 * b"], "a * b")
    j, alpha = medium({"a": [1.0, 2.0], "b": 3.0})
    np.testing.assert_array_equal(j, [[1, 2], [6, 6]])
    np.testing.assert_array_equal(alpha, [3, 6])
    total = vm.Gaussian("a", 1, 1, 1, 1, 1.0, where="b > 2") + vm.Coefficients("b", "b")
    np.testing.assert_array_equal(total({"a": 1.0, "b": [1.0, 3.0]})[1], [1.0, 4.0])
    per_parsec = vm.Gaussian("a", 1, 1, 1, 1, 2 * u.pc)
    assert per_parsec(1.0)[1] == 0.5 / u.pc
    table = vm.Table("a", [0, 1], [0, 1], [[0], [2]], 1.0)
    assert table(0.5)[1] == 1.0
    with pytest.raises(vm.InputError, match="looks at a, b: give values by name"):
        medium(3.0)
    with pytest.raises(vm.InputError, match="also looks at b"):
        medium({"a": 3.0})
    shell = vm.Gaussian("a", 1, 1, 1, 1)
    assert shell(1.0)[1] == 1.0  # per path length
    with pytest.raises(vm.InputError, match="calibrate"):
        (shell + vm.Gaussian("a", 1, 1, 1, 1, 2.0))(1.0)


def test_values_have_the_units_that_lengths_and_fields_have():
    j, alpha = vm.Coefficients(["2*a0 + 1e-13 1/cm"], "a0")([1e-13] / u.cm)
    np.testing.assert_allclose(j.to_value("1/cm"), [[3e-13]])
    assert alpha.unit == 1 / u.cm
    line = vm.Coefficients("a0*exp(-(v/(2 km/s))**2)", "a0")
    j, _ = line({"a0": 1 / u.pc, "v": [0.0, 2e5] * u.cm / u.s})
    np.testing.assert_allclose(j.to_value("1/pc"), [[1, np.exp(-1)]])
    with pytest.raises(vm.UnitsError, match="a0"):
        vm.Coefficients("2*a0 + 1e-13", "a0")([1e-13] / u.cm)
    with pytest.raises(vm.UnitsError, match="inverse length"):
        vm.Coefficients(1, "density")([1.0] * u.g / u.cm**3)
    with pytest.raises(vm.InputError, match="plain numbers"):
        vm.Gaussian("log10(density)", 4, 0.1, 1, 1, 1.0)([1e4] / u.cm**3)
    shell = vm.Gaussian("log10(density)", 4, 0.1, 1, 1, 1.0)
    assert shell({"density": [1e4] / u.cm**3})[1] == 1.0
    assert shell({"log10(density)": [4.0]})[1] == 1.0


def test_values_that_cannot_be_used():
    shell = vm.Gaussian("a", 1, 1, 1, 1, 1.0)
    assert shell([])[0].shape == (1, 0)
    assert np.isnan(shell([np.nan])[1])
    for wrong in (None, "density", CORE):
        with pytest.raises(vm.InputError, match="values of a must be numbers"):
            shell(wrong)
    with pytest.raises(vm.InputError, match="one shape"):
        vm.Coefficients("a * b", 0)({"a": [1, 2], "b": [1, 2, 3]})
    with pytest.raises(vm.UnitsError, match="path_length=1 has no unit"):
        (shell + shell.replace(path_length=1 * u.pc))([1.0])
    j, _ = vm.Coefficients("exp(-los(velocity)**2)", 0)([1.0])
    np.testing.assert_allclose(j, [[np.exp(-1)]])


def test_a_function_at_values():
    erf = vm.Medium.from_function(lambda a, b: ([a, b], vm.math.erf(a)), ["a", "b"], 2)
    j, alpha = erf({"a": [0.5, 1.0], "b": 2.0})
    np.testing.assert_array_equal(j, [[0.5, 1.0], [2.0, 2.0]])
    np.testing.assert_allclose(alpha, [0.5204998778, 0.8427007929], rtol=1e-9)
    assert vm.Medium.from_function(lambda a: (a, a), ["a"], 1)([1.0] / u.cm)[1] == 1 / u.cm


def curves(axes):
    """Return j and α as they are drawn."""
    other = next(a for a in axes.figure.axes if a.get_ylabel().startswith(("extinction", "its")))
    return [line for a in (axes, other) for line in a.lines if len(line.get_xdata())]


def test_a_transfer_function_shows_what_the_medium_is():
    medium = vm.Gaussian("log10(density)", 4, 0.1, (1, 0.5, 0), 0.3).calibrated(CORE)
    axes = medium.plot(CORE)
    *channels, alpha = curves(axes)
    x = np.asarray(channels[0].get_xdata())
    j, extinction = medium(x)
    np.testing.assert_allclose([line.get_ydata() for line in channels], j, rtol=1e-12)
    np.testing.assert_allclose(alpha.get_ydata(), extinction, rtol=1e-12)
    assert x[0] < 4 < x[-1]
    assert axes.get_xlabel() == "log10(density) [dex(1 / cm3)]"
    assert axes.get_ylabel() == "emissivity j [cm⁻¹]"
    assert [t.get_text() for t in axes.get_legend().get_texts()][-1].startswith("α")


def test_without_a_volume_one_path_length_is_drawn():
    axes = vm.Gaussian("log10(density)", 4, 0.1, (1, 0.5, 0), 0.3, 2 * u.pc).plot()
    assert max(curves(axes)[-1].get_ydata()) == 0.3
    with pytest.raises(vm.InputError, match="depends on a volume"):
        vm.Coefficients("density", 0).plot()
    with pytest.raises(vm.InputError, match="calibrate"):
        vm.Colormap("density", "viridis").plot()


@pytest.mark.parametrize(
    "medium",
    [
        vm.Rectangle("density", 1e4, 1e3, "red", 1, where="x > 0"),
        vm.Colormap("density", "viridis", where="x > 0"),
        vm.Gaussian("log10(density)", 4, 0.1, vm.ColorBy("density", "viridis"), 1),
        vm.Isosurface("log10(density)", level=[3.5, 4], color="turbo"),
        vm.Isosurface("log10(density)", 4, "red", width=0.1),
        vm.Coefficients(["density", 0, "density"], 0),
        vm.Coefficients("density * x / r", 0),
        vm.Coefficients(["density", "2*density"], ["density*(1 cm2)", "2*density*(1 cm2)"]),
        vm.Medium.from_function(lambda d: (d, 0 * d), ["density"], 1, units=("1", "1/cm")),
    ],
)
def test_every_kind_of_medium_is_drawn(medium):
    axes = medium.plot(CORE)
    axes.figure.canvas.draw()
    assert axes.get_legend().get_texts()
    if isinstance(medium, vm.Isosurface):
        assert any("surface at 4" in t.get_text() for t in axes.get_legend().get_texts())
    else:
        assert all(np.any(np.isfinite(line.get_ydata())) for line in curves(axes))
    assert ("x > 0" in axes.get_title(loc="left")) == ("x > 0" in repr(medium))


def test_a_sum_has_a_panel_for_each_expression():
    total = vm.suggest_medium(CORE) + vm.Colormap("density", "viridis")
    panels = total.plot(CORE)
    assert [p.get_xlabel().split(" [")[0] for p in panels] == ["log10(density)", "density"]
    assert len(total.plot(CORE, ax=panels)) == 2
    figure = mpl.figure.Figure()
    assert len(total.plot(CORE, ax=figure.add_subplot())) == 2
    with pytest.raises(vm.InputError, match="ax must be one axes to be divided, or 2, got 3"):
        total.plot(CORE, ax=[panels[0]] * 3)
    assert vm.suggest_medium(CORE).plot(CORE, ax=panels[0]) is panels[0]
    with pytest.raises(vm.InputError, match="axes of matplotlib"):
        vm.suggest_medium(CORE).plot(CORE, ax=3)


def test_notebooks_show_values():
    for value in (vm.suggest_medium(CORE), vm.Orthographic(30), vm.Stars([(0, 0, 0)], radii=1)):
        assert "<table>" in value._repr_html_()
    for medium in (
        vm.suggest_medium(CORE),
        vm.Colormap("density", "viridis"),
        vm.Isosurface("a", 1),
    ):
        assert medium._repr_png_().startswith(b"\x89PNG")
        assert "data:image/png" in medium._repr_html_()
    for medium in (vm.Coefficients("density", 0), vm.Medium.from_function(max, ["a"], 1)):
        assert medium._repr_png_() is None
        assert "<table>" in medium._repr_html_()
    shown = CORE._repr_html_()
    assert "data:image/png" in shown
    assert "density" in shown
    assert CORE._repr_png_().startswith(b"\x89PNG")
    assert CORE.slice("density")._repr_png_().startswith(b"\x89PNG")
    assert "density" in CORE.slice("density")._repr_html_()
    assert CORE.slice("grad(density)")._repr_png_() is None
    assert "mass" in vm.measure(CORE, {"mass": "density"})._repr_html_()
    camera = vm.Orthographic(resolution=4)
    assert "segments" in vm.probe(CORE, vm.suggest_medium(CORE), camera, (2, 2))._repr_html_()
