"""The class Image: shapes, coordinates, units, drawing."""

import copy
import pickle

import numpy as np
import pytest
from astropy import units as u
from hypothesis import given, settings
from hypothesis import strategies as st

from voluminous.errors import InputError, UnitsError
from voluminous.image import Image
from voluminous.image.lengths import round_length


@pytest.mark.parametrize(
    ("given_dtype", "expected"), [("f4", "f4"), (">f8", "f8"), ("f2", "f4"), ("i2", "f8")]
)
def test_two_axes_become_one_channel_of_floats(given_dtype, expected):
    values = np.arange(6).reshape(2, 3).astype(given_dtype)
    image = Image(values)
    assert (image.shape, image.channels) == ((2, 3, 1), 1)
    assert image.intensity.dtype == np.dtype(expected)
    np.testing.assert_array_equal(image.intensity[..., 0], values)


@pytest.mark.parametrize(
    "bad", [np.ones(3), np.ones((1, 2, 3, 4)), np.ones((0, 3)), [["a"]], [[1], [1, 2]]]
)
def test_unusable_intensities_are_refused(bad):
    with pytest.raises(InputError, match="intensity"):
        Image(bad)


@pytest.mark.parametrize("shape", [(), (2, 3), (2, 3, 4), (4,)])
def test_planes_broadcast_to_the_image_and_are_read_only(shape):
    values = np.random.default_rng(0).random(shape)
    image = Image(np.zeros((2, 3, 4)), transparency=values)
    spread = values[..., None] if values.ndim == 2 else values
    np.testing.assert_array_equal(image.transparency, np.broadcast_to(spread, (2, 3, 4)))
    with pytest.raises(ValueError, match="read-only"):
        image.transparency[0, 0, 0] = 1


def test_optical_depth_is_computed_once_and_only_when_asked_for():
    calls = []

    def later():
        calls.append(1)
        return np.full((2, 3), 7.0)

    image = Image(np.zeros((2, 3, 2)), optical_depth=later)
    repr(image)
    assert not calls
    assert image.optical_depth.shape == (2, 3, 2)
    assert (image.optical_depth == 7).all()
    assert len(calls) == 1


def test_coordinates_and_oblong_pixels():
    image = Image(np.zeros((2, 3)))
    np.testing.assert_array_equal(image.x, [0, 1, 2])
    assert (image.extent, image.pixel_area) == ((-0.5, 2.5, -0.5, 1.5), 1)
    image = Image(np.zeros((2, 3)), x=[1, 3, 5], y=[10, 15], unit="pc")
    assert (image.pixel_size, image.pixel_area) == ((2, 5), 10)
    assert image.extent == (0, 6, 7.5, 17.5)


@pytest.mark.parametrize(
    "options",
    [
        *({"x": x} for x in ([0, 1], [0, 1, 1], [0, 2, 1], [0, 1, np.nan], [[0, 1, 2]])),
        *({"pixel_size": size} for size in (1.0, (1, 0), (1, np.inf), (1, 2, 3), "ab")),
    ],
)
def test_unusable_coordinates_are_refused(options):
    (name,) = options
    with pytest.raises(InputError, match=rf"^{name} "):
        Image(np.zeros((2, 3)), **options)


def test_quantities_bring_their_units():
    image = Image(
        np.ones((1, 2)) * u.Jy,
        x=[1, 2] * u.pc,
        y=[206264.806] * u.AU,
        transparency=[[50, 20]] * u.percent,
    )
    assert (image.unit, image.intensity_unit) == ("pc", "Jy")
    assert image.y[0] == pytest.approx(1, rel=1e-8)  # the digits given for au per pc
    np.testing.assert_allclose(image.transparency[..., 0], [[0.5, 0.2]])


def test_camera_and_provenance_become_what_a_file_gives_back():
    image = Image([[0.0]], camera={"incl": np.float32(0.5), "eye": (1, np.arange(2))})
    assert image.camera == {"incl": 0.5, "eye": [1, [0, 1]]}
    with pytest.raises(InputError, match="provenance"):
        Image([[0.0]], provenance={"scene": object()})


def test_repr_is_one_short_line():
    image = Image([[0.5, np.nan, 2.0]], unit="pc", intensity_unit="Jy")
    assert repr(image) == "<Image 3×1 pixels, 1 channel, 3×1 pc, intensity 0.5 … 2 Jy>"
    assert "not finite" in repr(Image([[np.nan]]))


def test_plot_has_axes_in_the_unit_and_shows_the_colours():
    image = Image(np.random.default_rng(1).random((2, 3, 3)), unit="pc")
    ax = image.plot(stretch="sqrt")
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("x [pc]", "y [pc]")
    (shown,) = ax.images
    assert shown.get_extent() == list(image.extent)
    assert shown.origin == "lower"
    np.testing.assert_array_equal(shown.get_array(), image.to_rgb(stretch="sqrt"))
    assert len(ax.figure.axes) == 1  # no colour bar


@pytest.mark.parametrize(
    "options",
    [{}, {"vmin": 0.2}, {"stretch": "asinh"}, {"colormap": "inferno", "stretch": "log"}],
)
def test_one_channel_has_a_colour_bar_and_the_colours_of_to_rgb(options):
    image = Image(np.random.default_rng(2).random((4, 5, 2)), intensity_unit="Jy")
    ax = image.plot(channels=1, **options)
    assert ax.images[0].colorbar.ax.get_ylabel() == "intensity [Jy]"
    (shown,) = ax.images
    colors = shown.to_rgba(shown.get_array())[..., :3]
    # A colormap has 256 steps.
    np.testing.assert_allclose(colors, image.to_rgb(channels=1, **options), atol=1 / 255)


@pytest.mark.parametrize("lowest", [0.01, 1e-7])
@pytest.mark.parametrize("shape", [(4, 20), (18, 21), (20, 4)])
def test_no_label_is_cut_off(shape, lowest):
    """Beside a long colour bar the layout of matplotlib pushed one off the figure."""
    values = np.random.default_rng(3).uniform(lowest, 0.5, shape)
    x = 4000 * np.linspace(-1, 1, shape[1])
    ax = Image(values, x=x, unit="AU", intensity_unit="Jy / sr").plot(norm="log")
    ax.figure.draw_without_rendering()
    for label in (ax.yaxis.label, ax.xaxis.label, ax.images[0].colorbar.ax.yaxis.label):
        box, whole = label.get_window_extent(), ax.figure.bbox
        assert np.all((box.min >= whole.min) & (box.max <= whole.max))


def test_limits_may_have_units():
    image = Image([[1.0, 5.0], [50.0, 100.0]], intensity_unit="K")
    one, other = {"vmin": 2, "vmax": 60}, {"vmin": 2 * u.K, "vmax": 60000 * u.mK}
    np.testing.assert_array_equal(image.to_rgb(**one), image.to_rgb(**other))
    clim = image.plot(colormap="inferno", **other).images[0].get_clim()
    assert clim == pytest.approx((2, 60), rel=1e-15)
    with pytest.raises(UnitsError, match="vmin is in cm, expected K"):
        image.plot(vmin=1 * u.cm)


def test_plot_uses_pyplot_where_the_user_does():
    import matplotlib.pyplot as plt

    before = plt.get_fignums()
    figure = Image(np.eye(3)).plot().figure
    assert set(plt.get_fignums()) - set(before) == {figure.number}
    plt.close(figure)


def test_a_scale_bar_is_within_the_picture():
    centres = np.linspace(-1.0, 1.0, 11)
    image = Image(np.eye(11), x=centres, y=centres, unit="pc")
    axes = image.plot(scale_bar=True)
    left, right, bottom, top = image.extent
    (bar,) = (line for line in axes.lines if line.get_gid() == "scale-bar")
    x, y = bar.get_data()
    assert left < min(x) < max(x) < left + 0.5 * (right - left)
    assert bottom < y[0] < bottom + 0.1 * (top - bottom)
    assert (*axes.get_xlim(), *axes.get_ylim()) == pytest.approx(image.extent)


@pytest.mark.parametrize(
    ("width", "unit", "length", "text"),
    [(0.25, "pc", 0.05, "0.05 pc"), (4e17, "cm", 1e17, "$10^{17}$ cm"), (8.4, "", 2, "2")],
)
def test_the_scale_bar_has_a_round_length(width, unit, length, text):
    edges = np.linspace(0, width, 11)
    centres = (edges[1:] + edges[:-1]) / 2
    ax = Image(np.eye(10), x=centres, y=centres, unit=unit).plot(scale_bar=True)
    (bar,) = ax.lines
    assert np.ptp(bar.get_xdata()) == pytest.approx(length)
    assert [t.get_text() for t in ax.texts] == [text]


@settings(deadline=None)
@given(st.floats(1e-30, 1e30))
def test_round_lengths_are_the_greatest_that_fit(longest):
    length = round_length(longest)
    # Steps are 2 or 2.5 apart; the tolerance is the rounding of a power of ten.
    assert length <= longest * (1 + 1e-12)
    assert length > longest / 2.5 * (1 - 1e-12)
    assert float(f"{length:.12e}".split("e")[0]) in (1, 2, 5)


# units


def many_planes(**units):
    values = np.linspace(1, 2, 24, dtype=np.float32).reshape(3, 4, 2)
    planes = {"error": 0.1 * values[..., 0], "lower": values - 0.5, "upper": values + 0.5}
    centres = {"x": 1e18 * np.arange(4.0), "y": 2e18 * np.arange(3.0)}
    return Image(values, transparency=0.25, optical_depth=0.5, **planes, **centres, **units)


def test_to_converts_coordinates_or_intensities_with_errors_and_bounds():
    image = many_planes(unit="cm", intensity_unit="g / cm2")
    planes = ("intensity", "error", "lower", "upper")
    there, factor = image.to("pc"), u.cm.to(u.pc)
    assert (there.unit, image.unit, there.intensity_unit) == ("pc", "cm", "g / cm2")
    np.testing.assert_allclose(there.x, factor * image.x, rtol=1e-14)
    np.testing.assert_allclose(there.extent, factor * np.array(image.extent), rtol=1e-14)
    np.testing.assert_allclose(there.pixel_size, factor * np.array(image.pixel_size), rtol=1e-14)
    for name in (*planes, "transparency", "optical_depth"):
        np.testing.assert_array_equal(getattr(there, name), getattr(image, name))
    there = image.to(u.kg / u.m**2)
    assert (there.intensity_unit, there.unit) == ("kg / m2", "cm")
    for name in planes:
        np.testing.assert_allclose(getattr(there, name), 10 * getattr(image, name), rtol=1e-6)
    np.testing.assert_array_equal(there.transparency, image.transparency)
    np.testing.assert_array_equal(there.x, image.x)


def test_to_a_unit_that_the_image_has_not_is_refused():
    with pytest.raises(UnitsError, match=r"no unit, and its plane is in pc"):
        Image(np.ones((2, 2)), unit="pc").to("kg")
    with pytest.raises(UnitsError, match="no unit"):
        Image(np.ones((2, 2))).to("pc")
    with pytest.raises(UnitsError, match="cannot be converted to kg"):
        many_planes(unit="cm", intensity_unit="K").to("kg")


@pytest.mark.parametrize("name", ["unit", "error", "other"])
def test_assigning_an_attribute_says_how_to_convert(name):
    image = many_planes(unit="cm")
    with pytest.raises(InputError, match=rf"Image.{name} cannot be changed; image.to\(unit\)"):
        setattr(image, name, "pc")
    with pytest.raises(AttributeError, match="cannot be changed"):
        delattr(image, name)
    assert image.unit == "cm"
    again = pickle.loads(pickle.dumps(copy.deepcopy(image)))
    np.testing.assert_array_equal(again.upper, image.upper)


def test_plot_converts_what_it_shows():
    image = many_planes(unit="cm", intensity_unit="g / cm2")
    ax = image.plot(unit="pc", channels=0, scale_bar=True)
    assert ax.get_xlabel() == "x [pc]"
    assert ax.images[0].get_extent() == pytest.approx(image.to("pc").extent)
    assert ax.texts[0].get_text() == "0.2 pc"
    ax = image.plot(unit="kg / m2", channels=0, vmax=1 * u.g / u.cm**2)
    assert ax.images[0].colorbar.ax.get_ylabel() == "intensity [kg m⁻²]"
    assert ax.images[0].get_clim()[1] == pytest.approx(10)


# as an array


def test_an_array_of_an_image_is_the_picture_with_its_top_row_first():
    image = Image(np.random.default_rng(1).random((3, 4, 3)))
    picture = np.asarray(image)
    np.testing.assert_array_equal(picture, image.to_rgb()[::-1])
    assert np.asarray(image, dtype=float).dtype == float
    with pytest.raises(InputError, match=r"give image\.intensity"):
        Image(image)
    with pytest.raises(TypeError, match="ufunc"):
        np.log10(image)
    with pytest.raises(ValueError, match="copy"):
        image.__array__(copy=False)


def test_numbers_of_an_image_are_not_changed_in_place():
    numbers = np.ones((2, 2, 1))
    image = Image(numbers)
    with pytest.raises(ValueError, match="read-only"):
        image.intensity *= 2
    numbers[0, 0] = 1  # what it was made of is not locked
    assert image.intensity.max() == 1
