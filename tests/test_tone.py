"""From intensities to display values."""

import matplotlib
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from matplotlib.colors import LogNorm, PowerNorm

from voluminous.errors import InputError, UnknownNameError
from voluminous.image import Image
from voluminous.image.tone import STRETCHES, curve

SHAPES = st.tuples(st.integers(1, 4), st.integers(1, 4), st.integers(1, 5))
# Far inside float32, so that ratios of colours are exact to its rounding.
BRIGHT = st.floats(1e-6, 1e6)
ANY = st.floats(allow_nan=True, allow_infinity=True, width=32)
STRETCH = st.sampled_from([*STRETCHES, 0.5, 3.0])


@pytest.mark.parametrize("stretch", [*STRETCHES, 0.4, 1, 7.5])
def test_curves_rise_from_black_to_white_and_have_an_inverse(stretch):
    bend = curve(stretch)
    v = np.linspace(0, 1, 1001)
    shown = bend.forward(v)
    # Rounding of a few elementary functions.
    np.testing.assert_allclose(shown[[0, -1]], [0, 1], atol=1e-14)
    assert (np.diff(shown) > 0).all()
    np.testing.assert_allclose(bend.inverse(shown), v, atol=1e-13)
    expected = {"sqrt": np.sqrt(v), "gamma": v ** (1 / 2.2), 0.4: v**2.5}
    expected |= {
        "asinh": np.arcsinh(10 * v) / np.arcsinh(10),
        "log": np.log1p(100 * v) / np.log(101),
    }
    np.testing.assert_allclose(shown, expected.get(stretch, shown), rtol=1e-12)


@settings(deadline=None)
@given(arrays(np.float64, SHAPES, elements=ANY), STRETCH, st.sampled_from(["hue", "clip"]))
def test_display_values_are_numbers_from_0_to_1(values, stretch, gamut):
    shown = Image(values).to_rgb(stretch=stretch, gamut=gamut)
    assert shown.shape == (*values.shape[:2], 3)
    assert shown.dtype == np.float32
    assert np.isfinite(shown).all()
    assert shown.min() >= 0
    assert shown.max() <= 1


@settings(deadline=None)
@given(arrays(np.float64, (2, 3, 3), elements=BRIGHT), STRETCH, st.floats(1e-3, 1e3))
def test_colours_keep_their_hue_however_bright(values, stretch, exposure):
    shown = Image(values).to_rgb(exposure=exposure, stretch=stretch).astype(np.float64)
    ratio = values / values.max(axis=-1, keepdims=True)
    # A handful of float32 roundings.
    np.testing.assert_allclose(shown, ratio * shown.max(axis=-1, keepdims=True), rtol=2e-6)


@settings(deadline=None)
@given(arrays(np.float64, (2, 3, 3), elements=BRIGHT), st.floats(1e-3, 1e3))
def test_clipping_treats_every_colour_on_its_own(values, exposure):
    shown = Image(values).to_rgb(exposure=exposure, gamut="clip")
    np.testing.assert_allclose(shown, np.minimum(values * exposure, 1), rtol=1e-6)


def test_automatic_exposure_leaves_one_lit_pixel_in_a_thousand_beyond_white():
    values = np.zeros((200, 100, 3))
    values[:100, :, 1] = np.arange(1.0, 10001).reshape(100, 100)  # half of the picture is lit
    shown = Image(values * 1e-25).to_rgb()[..., 1]
    assert (shown == 1).sum() == 10
    assert shown[99, 89] == pytest.approx(9990 / 9990.001, rel=1e-6)


def test_pixels_without_a_number():
    values = np.full((1, 4, 3), 0.5)
    values[0, 1] = [np.nan, 0.5, 0.25]
    values[0, 2] = [np.inf, 0.5, 0.25]
    values[0, 3] = [-np.inf, -1, 1]
    shown = Image(values).to_rgb(exposure=1)
    np.testing.assert_allclose(shown[0, 1], [0, 0.5, 0.25])
    np.testing.assert_allclose(shown[0, 2], [1, 0, 0], atol=1e-20)
    np.testing.assert_allclose(shown[0, 3], [0, 0, 1])


def test_white_and_black_points():
    values = np.array([[1.0, 2.0, 3.0, 4.0, 5.0]])
    shown = Image(values).to_rgb(vmin=2, vmax=4)[0, :, 0]
    np.testing.assert_allclose(shown, [0, 0, 0.5, 1, 1])
    np.testing.assert_array_equal(Image(values).to_rgb(vmin=2, exposure=0.25)[0, :, 0], shown)


def test_channels_can_be_chosen_and_mixed():
    values = np.random.default_rng(5).random((3, 4, 5))
    image = Image(values)
    grey = image.to_rgb(exposure=1, channels=1)
    np.testing.assert_array_equal(grey, np.repeat(values[..., 1:2], 3, axis=-1).astype("f4"))
    swapped = image.to_rgb(exposure=1, channels=(4, 0, 2))
    np.testing.assert_allclose(swapped, values[..., [4, 0, 2]], rtol=1e-6)
    mix = np.array([[0.1, 0.2, 0.3], [0.3, 0.1, 0.0]])
    mixed = image.to_rgb(exposure=1, channels=(1, 3), mix=mix)
    np.testing.assert_allclose(mixed, values[..., [1, 3]] @ mix, rtol=1e-6)
    orange, blue = Image([[[1.0, 0.0], [0.0, 1.0]]]).to_rgb(exposure=1)[0]
    assert orange[0] > orange[1] > orange[2]
    assert blue[2] > blue[1] > blue[0]


def test_colormap_is_matplotlibs_and_spans_the_values_by_default():
    table = matplotlib.colormaps["viridis"]
    for colormap in ("viridis", table):
        shown = Image([[3.0, 4.0, np.inf, -np.inf, 5.0]]).to_rgb(colormap=colormap)[0]
        ends = np.array([table(v)[:3] for v in (0.0, 0.5, 1.0)])
        np.testing.assert_allclose(shown, ends[[0, 1, 2, 0, 2]], atol=1e-7)


def test_colormap_norms():
    values = np.array([[0.0, 1e-9, 1e-3, 1.0]])
    shown = Image(values).to_rgb(colormap="gray", norm="log")[0, :, 0]
    np.testing.assert_allclose(shown, [0, 0, 0.5, 1], atol=1 / 255)
    own = PowerNorm(0.5)
    shown = Image([[0.0, 0.25, 1.0]]).to_rgb(colormap="gray", norm=own)[0, :, 0]
    np.testing.assert_allclose(shown, [0, 0.5, 1], atol=1 / 255)
    assert own.vmax is None  # the user's norm is not changed


def test_background_is_seen_through_the_transparency():
    image = Image(np.full((1, 2, 3), 0.25), transparency=np.array([[0.0, 0.5]]))
    shown = image.to_rgb(exposure=1, background=(1, 0.5, 0))
    np.testing.assert_allclose(shown[0], [[0.25, 0.25, 0.25], [0.75, 0.5, 0.25]])
    assert image.to_rgb(exposure=1, background="white").max() == 0.75


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"exposure": 0}, "exposure must be greater than 0"),
        ({"exposure": "bright"}, "exposure must be a number"),
        ({"exposure": 1, "vmax": 1}, "not both"),
        ({"vmin": 2, "vmax": 1}, "above vmin"),
        ({"stretch": -1}, "stretch must be greater than 0"),
        ({"stretch": "sqrt", "softening": 0.1}, "softening is for"),
        ({"channels": 4}, "integers from 0 to 3"),
        ({"channels": 0.5}, "integers from 0 to 3"),
        ({"mix": np.eye(3)}, r"shape \(4, 3\)"),
        ({"mix": [["a"] * 3] * 4}, "numbers"),
        ({"colormap": "gray"}, "choose one with channels"),
        ({"colormap": "gray", "channels": 0, "mix": np.eye(3)}, "mix"),
        ({"colormap": 3, "channels": 0}, "name or a matplotlib colormap"),
        ({"colormap": "gray", "channels": 0, "norm": "cubic"}, "norm must be"),
        ({"colormap": "gray", "channels": 0, "norm": LogNorm(), "vmin": 1}, "inside the norm"),
        ({"colormap": "gray", "channels": 0, "norm": "log", "stretch": "sqrt"}, "not both"),
        ({"colormap": "gray", "channels": 0, "norm": "log", "vmin": 0}, "positive"),
        ({"colormap": "gray", "channels": 0, "vmin": 2, "vmax": 1}, "less than vmax"),
        ({"norm": "log"}, "norm belongs to a colormap"),
        ({"background": "white"}, "transparency is known"),
    ],
)
def test_contradictions_are_refused(options, message):
    with pytest.raises(InputError, match=message):
        Image(np.ones((2, 3, 4))).to_rgb(**options)


def test_a_norm_alone_shows_one_channel_in_grey():
    image = Image([[1.0, 10.0], [100.0, 1000.0]], transparency=0.5)
    grey = image.to_rgb(norm="log")
    np.testing.assert_array_equal(grey, image.to_rgb(norm="log", colormap="gray"))
    np.testing.assert_allclose(grey[..., 0], [[0, 1 / 3], [2 / 3, 1]], atol=1 / 255)
    drawn = image.plot(norm="log", background="white").images[0].get_array()
    np.testing.assert_array_equal(drawn, image.to_rgb(norm="log", background="white"))


@pytest.mark.parametrize(
    ("options", "nearest"),
    [({"stretch": "sqr"}, "sqrt"), ({"gamut": "hues"}, "hue"), ({"colormap": "viridi"}, "viridis")],
)
def test_unknown_names_come_with_the_nearest(options, nearest):
    with pytest.raises(UnknownNameError, match=f"did you mean '{nearest}'"):
        Image(np.ones((2, 3))).to_rgb(**options)


def signed_map():
    y, x = np.mgrid[-1:1:20j, -1:1:30j]
    return np.where(x * x + y * y < 1, x, np.nan)


def test_one_channel_of_both_signs_is_blue_white_and_red():
    image = Image(signed_map())
    rgb = image.to_rgb()
    red, _, blue = np.moveaxis(rgb[10], -1, 0)
    assert blue[3] > 2 * red[3]
    assert red[-4] > 2 * blue[-4]
    middle = rgb[10, 14:16].mean(axis=0)
    assert middle.min() > 0.9  # white: zero
    assert (rgb[0, 0] == 0).all()  # nothing
    # Alike on both sides, though values are not.
    shifted = Image(signed_map() + 0.2).to_rgb()
    np.testing.assert_allclose(shifted[10, 11:13].mean(axis=0), 1, atol=0.05)
    # A colour bar tells of the same.
    axes = image.plot()
    shown = axes.get_images()[0]
    assert shown.norm.vmin == -shown.norm.vmax
    np.testing.assert_allclose(shown.cmap(shown.norm(0.0))[:3], 1, atol=0.04)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("scale", [1e-30, 3e35])
@pytest.mark.parametrize("channels", [1, 2, 4])
@pytest.mark.parametrize("signed", [False, True])
def test_the_exposure_that_was_taken_repeats_the_picture(channels, scale, dtype, signed):
    rng = np.random.default_rng(channels)
    values = scale * rng.lognormal(size=(20, 30, channels))
    values *= rng.choice([-1, 1], size=values.shape) if signed else 1
    values[3, 4] = np.nan
    image = Image(values.astype(dtype))
    np.testing.assert_array_equal(image.to_rgb(exposure=image.exposure), image.to_rgb())


def test_intensities_are_shown_as_they_are():
    values = np.array([[[0.2, 0.5, 0.9], [0.5, 2.0, -1.0]]])
    rgb = Image(values).to_rgb(exposure="rgb")
    np.testing.assert_array_equal(rgb, np.clip(values, 0, 1).astype(np.float32))
    grey = Image(values[..., 0]).to_rgb(exposure="rgb")
    np.testing.assert_array_equal(grey[..., 1], values[..., 0].astype(np.float32))
