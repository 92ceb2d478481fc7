"""Annotations: true to the geometry, and the picture's pixels what they were."""

import io

import numpy as np
import pytest
from astropy import units as u
from PIL import Image as Pillow

import voluminous as vm
from voluminous.errors import InputError, UnknownNameError
from voluminous.image.annotate.marks import compass_arrows, time_text, triad_arrows
from voluminous.image.lengths import bar_length
from voluminous.image.scales import FieldValues, counts, of_medium, quantity_name

ALL_OFF = {"scale_bar": False, "triad": False, "compass": False, "color_bar": False, "time": False}
SEEN = {"type": "orthographic", "incl": 60.0, "phi": 30.0, "posang": 0.0}


def picture(nx=90, ny=60, width=9.0, unit="pc", channels=3, dark=False, **known):
    values = np.random.default_rng(1).random((ny, nx, channels))
    x, y = (np.arange(n) * width / nx for n in (nx, ny))
    return vm.Image(0.0 * values if dark else values, x=x, y=y, unit=unit, **known)


def plain_pixels(image, **options):
    """What `save` writes, row 0 at the bottom."""
    from voluminous.image.formats.png import encode

    return np.asarray(Pillow.open(io.BytesIO(encode(image, **options))))[::-1]


def drawn(annotated, gid):
    return [a for a in annotated.figure.findobj() if a.get_gid() == gid]


@pytest.fixture(scope="module")
def core():
    volume = vm.models.prestellar_core(16)
    volume.meta |= {"time": 3.15576e13, "time_unit": "s"}
    medium = vm.Gaussian("log10(density)", 3.5, 0.1, (0.2, 0.4, 0.8), 0.1, 2.5e16 * u.cm)
    image = vm.render(volume, medium, vm.Orthographic(60, 30, resolution=200), tolerance=None)
    return volume, medium, image


@pytest.mark.parametrize("shape", [(90, 60), (41, 103), (1, 1)])
@pytest.mark.parametrize(
    "options", [{}, {"stretch": "sqrt"}, {"channels": 1}, {"transparent": True}]
)
def test_nothing_drawn_leaves_what_save_writes(shape, options):
    transparency = np.random.default_rng(2).random(shape[::-1])
    image = picture(*shape, transparency=transparency)
    plain = plain_pixels(image, **options)
    found = image.annotate(**ALL_OFF, **options).rgba
    assert np.array_equal(found[..., : plain.shape[-1]], plain)
    assert options.get("transparent") or (found[..., 3] == 255).all()


@pytest.mark.parametrize("paper", ["black", "white", "none"])
def test_pixels_beside_the_annotations_are_unchanged(core, paper):
    volume, _, image = core
    found = image.annotate(volume=volume, ticks=True, title="A core", paper=paper)
    plain = plain_pixels(image)
    assert found.picture.shape[:2] == plain.shape[:2]
    same = (found.picture[..., :3] == plain).all(axis=-1)
    # Everything in the picture stands in three of its corners.
    assert same[60:-30].all()
    assert same[:, 90:140].all()
    assert not same.all()
    left, _, bottom, _ = found.box
    corner = found.rgba[0, 0]
    assert min(left, bottom) > 0
    expected = {"black": (0, 0, 0, 255), "white": (255, 255, 255, 255), "none": (0, 0, 0, 0)}
    assert tuple(corner) == expected[paper]


@pytest.mark.parametrize("nx", [100, 250])
def test_scale_bar_is_as_long_as_it_says(nx):
    # 9 units over nx pixels; 2 is the longest round length below a quarter of that.
    image = picture(nx, nx, 9.0, dark=True)
    found = image.annotate(**{**ALL_OFF, "scale_bar": True})
    (bar,) = drawn(found, "scale-bar")
    expected = 2.0 / 9.0 * nx
    assert bar.get_width() == pytest.approx(expected)
    # The same by counting bright pixels of its lowest row: those at its end may be half covered.
    row = found.picture[int(bar.get_y()), :, 0]
    assert (row > 200).sum() == pytest.approx(expected, abs=1.0)
    found = image.annotate(**{**ALL_OFF, "scale_bar": "200000 au"})
    (bar,) = drawn(found, "scale-bar")
    assert bar.get_width() == pytest.approx((2e5 * u.au).to_value("pc") * nx / 9.0)
    assert "200000 au" in [t.get_text() for t in found.figure.texts]


@pytest.mark.parametrize(
    ("longest", "unit", "text"),
    [
        (0.3, "pc", "0.2 pc"),
        (0.03, "pc", "5000 au"),
        (6e21, "cm", "1 kpc"),
        (12.0, "R_sun", "10 R_sun"),
        (4e-6, "rad", "500 mas"),
        (0.02, "deg", "1′"),
        (3.0, "", "2"),
        (2e8, "", r"$2\times 10^{8}$"),
    ],
)
def test_bars_have_sensible_units(longest, unit, text):
    length, found = bar_length(longest, unit)
    assert found.replace(r"R$_\odot$", "R_sun") == text
    assert 0.3 * longest < length <= longest


def test_wide_perspectives_have_no_scale_bar_by_themselves():
    wide = picture(90, 60, 0.9, unit="rad")
    assert not drawn(wide.annotate(color_bar=False), "scale-bar")
    assert drawn(wide.annotate(color_bar=False, scale_bar=10 * u.deg), "scale-bar")


@pytest.mark.parametrize("angles", [(0, 0, 0), (60, 30, 0), (90, 90, 20), (123, -77, 200)])
def test_the_triad_shows_where_the_camera_sees_the_axes(angles):
    camera = vm.Orthographic(*angles)
    grid = vm.CartesianGrid.uniform(2, (-1, 1))
    across, up, depth = camera.project(np.eye(3), grid)
    for k, arrow in enumerate(triad_arrows(picture(camera=camera.describe()))):
        assert (arrow.across, arrow.up) == pytest.approx((across[k], up[k]), abs=1e-12)
        assert arrow.towards == (depth[k] < 0) or abs(depth[k]) < 1e-12


def test_no_triad_without_a_known_camera():
    for camera in (None, {"type": "all-sky"}, {"type": "orthographic"}):
        assert triad_arrows(picture(camera=camera)) == []


@pytest.mark.parametrize("look", [{}, {"up": (1, 1, 0)}, {"posang": 33.0}])
def test_the_triad_of_a_perspective_is_that_at_its_target(look):
    camera = vm.Perspective((3 * u.pc, -4 * u.pc, "5 pc"), (0, "1 pc", 0), 20, **look)
    grid = vm.CartesianGrid.uniform(2, (-1, 1), unit="pc")
    step = 1e-6  # first order: what the target's surroundings do on the screen, times the distance
    points = np.array([0.0, 1.0, 0.0])[:, None] + step * np.eye(3)
    across, up, _ = camera.project(points, grid)
    scale = np.sqrt(9 + 25 + 25) / step
    for k, arrow in enumerate(triad_arrows(picture(camera=camera.describe()))):
        assert (arrow.across, arrow.up) == pytest.approx(
            (scale * across[k], scale * up[k]), abs=1e-5
        )


def test_north_and_east():
    for angle in (0, 25, 190):
        image = picture().on_sky(distance="140 pc", position=(84.0, -5.0), posang=angle)
        north, east = compass_arrows(image)
        turned = np.deg2rad(angle)
        assert (north.across, north.up) == pytest.approx((np.sin(turned), np.cos(turned)))
        assert (east.across, east.up) == pytest.approx((-np.cos(turned), np.sin(turned)))
    assert compass_arrows(picture()) == []


def test_ink_can_be_read_on_the_picture_and_letters_grow_with_it():
    for dark, n in ((True, 400), (False, 800)):
        image = vm.Image(np.full((n, n, 3), 0.0 if dark else 1.0))
        found = image.annotate(**{**ALL_OFF, "scale_bar": True})
        (bar,) = drawn(found, "scale-bar")
        assert (np.mean(bar.get_facecolor()[:3]) > 0.5) == dark
        assert found.figure.texts[0].get_fontsize() == pytest.approx(0.026 * n)


@pytest.mark.parametrize(
    ("time", "text"),
    [(True, "t = 1 Myr"), (False, ""), ("later", "later"), (2.5, "t = 2.5"), (3 * u.d, "t = 3 d")],
)
def test_time_stamps(core, time, text):
    assert time_text(time, core[0]) == text


def bars(medium):
    return [bar for feature in medium.known_features() for bar in feature.color_bars()]


def test_bars_of_shells_have_their_colours_at_their_centres():
    colors = ((0.1, 0.2, 0.4), (3.0, 1.5, 0.0))
    shells = [vm.Gaussian("x", c, 0.05, h, 0.1, 1.0) for c, h in zip((2, 3), colors, strict=True)]
    (scale,) = of_medium(bars(sum(shells)), {})
    for center, color in zip((2, 3), colors, strict=True):
        shown = np.array(scale.colormap(scale.norm(center)))
        # Each as bright as can be; the middle of an entry is a hundredth of a width off.
        assert shown == pytest.approx([*np.array(color) / max(color), 1.0], abs=5e-3)
    assert scale.colormap(scale.norm(2.5))[3] < 1e-6


def test_bars_of_surfaces():
    surfaces = vm.Isosurface("x", level=[1, 2] * u.K, color=[(1, 0, 0), (0, 1, 0)])
    (scale,) = of_medium(bars(surfaces), {})
    assert scale.label == "x [K]"
    assert scale.colormap(scale.norm(2.0))[1] > 0.99


def test_bars_of_colormaps_tables_and_colours_by_another_field():
    from matplotlib import colormaps

    medium = vm.Colormap("x", "viridis", 1, 100, 0.3, 1.0, norm="log")
    (scale,) = of_medium(bars(medium), {})
    assert scale.colormap(scale.norm(10.0))[:3] == pytest.approx(
        colormaps["viridis"](0.5)[:3],
        abs=0.01,  # neighbouring entries of the map
    )
    by = vm.ColorBy("temperature", "inferno", 10 * u.K, 100 * u.K)
    shell, colors = of_medium(bars(vm.Gaussian("x", 1, 0.1, by, 0.1, 1.0)), {})
    assert (shell.label, colors.label) == ("x", "temperature [K]")
    table = vm.Table("x", [0, 1, 4], [(0, 0), (1, 0), (0, 2)], [0.1, 0.1, 0.1], 1.0)
    (scale,) = of_medium(bars(table), {"mix": [(1, 0, 0), (0, 0, 1)]})
    assert scale.colormap(1.0)[:3] == pytest.approx((0, 0, 1), abs=0.01)
    assert of_medium(bars(vm.Coefficients(["x", "y", "x"], "x")), {}) == []


def test_histograms_count_the_cells(core):
    volume, medium, image = core
    fields = FieldValues(volume)
    (scale,) = of_medium(bars(medium), {}, fields.span)
    found = counts(scale, image, fields, 0)
    values = np.log10(np.asarray(volume.array("density"), dtype=float)).ravel()
    expected, _ = np.histogram(values, len(found), (scale.norm.vmin, scale.norm.vmax))
    # Logarithms in float32 put a few values into the bin beside theirs.
    assert np.abs(np.expm1(found * np.log1p(expected.max())) - expected).sum() < 0.02 * values.size


def test_the_bar_of_one_channel_tells_its_values():
    image = picture(60, 40, channels=1, intensity_unit="g / cm2", provenance={"quantity": "rho"})
    found = image.annotate(colormap="viridis", vmin=0.0, vmax=0.5)
    (bar,) = drawn(found, "color-bar")
    assert bar.get_ylim() == (0.0, 0.5)
    assert bar.get_ylabel() == "column, rho [g cm⁻²]"
    assert drawn(found, "histogram")
    assert quantity_name(picture()) == "intensity"


def test_saving(core, tmp_path):
    volume, _, image = core
    image.save(tmp_path / "a.png", annotate={"title": "A core", "volume": volume})
    image.annotate(title="A core", volume=volume).save(tmp_path / "b.png")
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    again = vm.Image.load(tmp_path / "a.png")
    assert again.provenance == image.provenance
    (bar,) = drawn(again.annotate(), "color-bar")
    assert bar.get_ylabel() == "log10(density), density in cm⁻³"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"scale_bar": 100 * u.pc}, "up to 9 pc"),
        ({"scale_bar": "long"}, "such as '100 au'"),
        ({"scale_bar": np.nan}, "scale_bar must be finite"),
        ({"font_size": "large"}, "positive number of pixels, got 'large'"),
        ({"volume": 3}, "volume must be a volume, got int"),
        ({"paper": "no colour"}, "paper must be"),
        ({"time": []}, "time must be"),
    ],
)
def test_options_that_cannot_be(options, message):
    with pytest.raises(InputError, match=message):
        picture().annotate(**options)


def test_unknown_options_and_formats(tmp_path):
    with pytest.raises(UnknownNameError, match="scale_bar"):
        picture().annotate(scalebar=True)
    with pytest.raises(UnknownNameError, match="png"):
        picture().annotate().save(tmp_path / "a.jpg")
    with pytest.raises(InputError, match="8 bits"):
        picture().save(tmp_path / "a.png", annotate=True, bits=16)
    with pytest.raises(InputError, match="True or a dict"):
        picture().save(tmp_path / "a.png", annotate="yes")


def letters_of(volume, **angles):
    camera = vm.Orthographic(**angles, resolution=40)
    image = vm.project(volume, "a", camera, how="max")
    return [text.get_text() for text in drawn(image.annotate(color_bar=False), "letters")][::2]


def test_letters_say_which_side_of_the_patient_is_where():
    volume = vm.Volume(vm.CartesianGrid.uniform(4, (-1, 1)), a=np.ones((4, 4, 4)))
    assert letters_of(volume, incl=90) == []
    volume.meta["orientation"] = "LPS"
    # Right, left, upper, lower: from the front the patient's left is at the right.
    assert letters_of(volume, incl=90) == ["L", "R", "S", "I"]
    assert letters_of(volume, incl=90, posang=90)[::2] == ["I", "L"]
    assert letters_of(volume, incl=90, phi=-40)[0] == "LP"  # 40° from L, 50° from P
    # Cells that are turned by 30° about z: x is between left and back.
    c, s = np.cos(np.pi / 6), 0.5
    volume.meta["direction"] = [[c, -s, 0], [s, c, 0], [0, 0, 1]]
    assert letters_of(volume, incl=90)[:2] == ["LP", "RA"]
    volume.meta["orientation"] = "LPX"
    assert letters_of(volume, incl=90) == []


def test_measures_are_lines_on_the_image_plane():
    image = picture(90, 60, 9.0)
    left, right, bottom, top = image.extent
    found = image.annotate(**ALL_OFF, measures=[([[left, bottom], [right, top]], "10 pc")])
    line, *words = drawn(found, "measures")
    np.testing.assert_allclose(line.get_xydata(), [[0, 0], [90, 60]], atol=1e-9)
    assert {text.get_text() for text in words} == {"10 pc"}
