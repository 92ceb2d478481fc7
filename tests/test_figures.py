"""Images in figures: colour bars of media, rows with one scale, annotations in given axes."""

import numpy as np
import pytest
from astropy import units as u
from matplotlib.figure import Figure

import voluminous as vm

CM = {"unit": "cm", "x": 1e17 * np.arange(30), "y": 1e17 * np.arange(20)}
SHELLS = vm.Gaussian("log10(density)", 3.5, 0.1, (0.4, 0.4, 0.8), 0.3, 0.1)


def picture(factor=1.0, channels=3, **options):
    values = factor * np.random.default_rng(channels).random((20, 30, channels))
    features = options.pop("medium", SHELLS).known_features()
    provenance = {"color_bars": [bar for feature in features for bar in feature.color_bars()]}
    return vm.Image(values, provenance=provenance, **CM, **options)


def test_a_plot_has_the_bar_of_its_medium():
    ax = picture().plot()
    (bar,) = ax.child_axes
    assert bar.get_ylabel() == "log10(density)"
    low, high = bar.get_ylim()
    assert low < 3.5 < high
    assert not picture().plot(colorbar=False).child_axes
    assert not picture(channels=1).plot(colorbar=False).child_axes


def test_several_scalars_have_bars_beside_each_other():
    other = vm.Gaussian("temperature", 10.0, 0.1, (0.4, 0.4, 0.8), 0.3, 0.1)
    ax = picture(medium=SHELLS + other).plot()
    ax.figure.draw_without_rendering()
    first, second = (bar.get_tightbbox() for bar in ax.child_axes)
    assert first.x1 < second.x0
    assert second.x1 <= ax.figure.bbox.x1


@pytest.mark.parametrize("channels", [1, 3])
def test_a_row_has_one_scale_one_unit_and_one_bar(channels):
    first, second = picture(channels=channels), picture(0.5, channels)
    axes = vm.plot_row([first, second.to("m")], titles=["a", "b"], unit="pc", scale_bar=True)
    assert [ax.get_title() for ax in axes] == ["a", "b"]
    assert [ax.get_xlabel() for ax in axes] == ["x [pc]", "x [pc]"]
    assert axes[1].get_ylabel() == ""
    assert [len(ax.child_axes) for ax in axes] == [0, 1]
    shown = [ax.images[0] for ax in axes]
    if channels == 1:
        assert shown[0].get_clim() == shown[1].get_clim() == pytest.approx((0, 1), abs=0.01)
    else:
        half = shown[0].get_array() / 2
        np.testing.assert_allclose(shown[1].get_array(), half, atol=0.01)


@pytest.mark.parametrize(
    ("images", "options", "message"),
    [
        ([], {}, "list of images"),
        ([np.ones((2, 2))], {}, "list of images"),
        ([picture(), picture(channels=1)], {}, "as many channels"),
        ([picture()], {"titles": ["a", "b"]}, "titles"),
        ([picture()], {"ax": Figure().subplots(1, 2)}, "one axes for each"),
    ],
)
def test_rows_that_do_not_fit_are_refused(images, options, message):
    with pytest.raises(vm.InputError, match=message):
        vm.plot_row(images, **options)


def test_annotations_are_drawn_into_given_axes():
    figure = Figure(layout="constrained")
    left, right = figure.subplots(1, 2)
    image = picture()
    assert image.annotate(ax=left, title="A title", time="now") is left
    image.annotate(ax=right, unit="pc", ticks=True, color_bar=False)
    figure.draw_without_rendering()
    assert left.get_title() == "A title"
    assert {t.get_text() for t in left.texts} >= {"now", "0.2 pc"}
    assert len(left.child_axes) == 1
    assert not left.get_xticks().size
    assert right.get_xlabel() == "x [pc]"
    assert {t.get_text() for t in right.texts} == {"0.2 pc"}
    assert not right.child_axes
    # The bar is as long as it says, whatever the layout has done since.
    (bar,) = (p for p in right.patches if p.get_gid() == "scale-bar")
    ends = right.transData.inverted().transform(bar.get_window_extent().get_points())
    assert np.ptp(ends[:, 0]) == pytest.approx(0.2, rel=1e-6)
    with pytest.raises(vm.InputError, match="leave out ax"):
        image.annotate(ax=left, paper="white")


def test_a_probe_is_drawn_into_given_axes():
    volume = vm.models.prestellar_core(8)
    shell = vm.Gaussian("log10(density)", 3.5, 0.1, 1.0, 0.1, 2.5e16 * u.cm)
    found = vm.probe(volume, shell, vm.Orthographic(resolution=4), (1, 1))
    figure = Figure(layout="constrained")
    one, other = figure.subplots(1, 2)
    assert found.plot(ax=one) is figure
    panels = figure.axes[2:6]
    assert panels[0].get_title(loc="left") == "what is there"
    assert all(other.get_position().x0 > panel.get_position().x1 for panel in panels)
    four = Figure().subplots(2, 2)
    found.plot(ax=four)
    assert all(panel.lines for panel in four.ravel()[1:])
    with pytest.raises(vm.InputError, match="or 4"):
        found.plot(ax=Figure().subplots(1, 3))
    with pytest.raises(vm.InputError, match="subplot"):
        found.plot(ax=Figure().add_axes((0, 0, 1, 1)))
    with pytest.raises(vm.InputError, match="ax or figure"):
        found.plot(Figure(), ax=one)
