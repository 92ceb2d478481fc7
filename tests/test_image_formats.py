"""Image files: what was saved comes back, nothing is left half written, damage is named."""

import contextlib
import io
import os
import re

import imagecodecs
import numpy as np
import OpenEXR
import pytest
import tifffile
from astropy import units as u
from astropy.io import fits
from astropy.wcs import WCS
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from PIL import Image as Pillow
from PIL.PngImagePlugin import PngInfo

from voluminous.errors import FileFormatError, InputError, UnknownNameError
from voluminous.files import MissingPathError
from voluminous.image import Image
from voluminous.image.formats import FORMATS, png

SUFFIXES = [".npz", ".fits", ".exr", ".tif", ".png"]
CAMERA = {"type": "orthographic", "incl": 60.0, "phi": 30.0, "center": [0.1, -0.0, 1e300]}
PROVENANCE = {"scene": 'it\'s & "quoted" – ü \\ \n &', "versions": {"voluminous": "0.1"}, "n": None}

shapes = st.tuples(st.integers(1, 5), st.integers(1, 5), st.integers(1, 5))
anything = {
    dtype: st.floats(width=8 * np.dtype(dtype).itemsize) for dtype in (np.float32, np.float64)
}


@st.composite
def images(draw, dtype, elements=None):
    rows, columns, _ = shape = draw(shapes)
    plane = draw(st.sampled_from([None, (rows, columns, 1), shape]))

    def values(top):
        inside = st.floats(0, top, width=32)
        return None if plane is None else draw(arrays(dtype, plane, elements=inside))

    step, first = st.floats(1e-3, 1e3), st.floats(-1e3, 1e3)
    return Image(
        draw(arrays(dtype, shape, elements=anything[dtype] if elements is None else elements)),
        transparency=values(1),
        optical_depth=values(1024),
        x=draw(first) + draw(step) * np.arange(columns),
        y=draw(first) + draw(step) * np.arange(rows),
        unit=draw(st.sampled_from(["", "pc", "cm", "rad", "solRad", "0.5 kpc"])),
        intensity_unit=draw(st.sampled_from(["", "erg / (s cm2 Hz sr)", "Jy / beam", "my counts"])),
        pixel_size=draw(st.sampled_from([None, (0.3, 0.7)])) if rows == columns == 1 else None,
        camera=CAMERA,
        provenance=PROVENANCE,
    )


def assert_same_bits(a, b):
    assert a.dtype == b.dtype
    assert a.shape == b.shape
    assert a.tobytes() == b.tobytes()


def assert_same_frame(loaded, saved):
    assert_same_bits(loaded.x, saved.x)
    assert_same_bits(loaded.y, saved.y)
    for name in ("unit", "pixel_size", "camera", "provenance"):
        assert getattr(loaded, name) == getattr(saved, name)


def assert_same_planes(loaded, saved):
    for name in ("transparency", "optical_depth"):
        plane, again = getattr(saved, name), getattr(loaded, name)
        assert (plane is None) == (again is None)
        if plane is not None:
            assert_same_bits(again, plane)


def roundtrip(image, folder, suffix, **options):
    path = folder / f"image{suffix}"
    image.save(path, **options)
    return Image.load(path)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("images")


def picture(shape=(5, 7, 3), dtype=np.float32, **keywords):
    return Image(np.random.default_rng(0).random(shape).astype(dtype), **keywords)


# What was saved comes back


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("suffix", [".npz", ".fits"])
@given(data=st.data())
@settings(max_examples=25, deadline=None)
def test_npz_and_fits_give_back_every_bit(folder, suffix, dtype, data):
    saved = data.draw(images(dtype))
    loaded = roundtrip(saved, folder, suffix)
    assert_same_bits(loaded.intensity, saved.intensity)
    assert_same_frame(loaded, saved)
    assert_same_planes(loaded, saved)
    assert loaded.intensity_unit == saved.intensity_unit


@pytest.mark.parametrize("suffix", [".exr", ".tif"])
@given(data=st.data())
@settings(max_examples=25, deadline=None)
def test_exr_and_tiff_give_back_every_bit_of_float32(folder, suffix, data):
    normal = st.floats(width=32, allow_subnormal=False)  # all tiny would be refused
    saved = data.draw(images(np.float32, normal))
    loaded = roundtrip(saved, folder, suffix)
    assert_same_bits(loaded.intensity, saved.intensity)
    assert_same_frame(loaded, saved)
    assert loaded.intensity_unit == saved.intensity_unit
    if suffix == ".exr":
        assert_same_planes(loaded, saved)


def test_half_floats_on_request(folder):
    saved = picture(transparency=0.25)
    loaded = roundtrip(saved, folder, ".exr", half=True)
    assert_same_bits(loaded.intensity, saved.intensity.astype("f2").astype("f4"))
    assert (loaded.transparency == 0.25).all()
    # 1 - transparency lets other programs put the image in front of another.
    layers = OpenEXR.File(str(folder / "image.exr")).channels()
    assert (layers["RGBA"].pixels[..., 3] == 0.75).all()


@pytest.mark.parametrize(
    ("suffix", "options"), [(".tif", {}), (".exr", {}), (".exr", {"half": True})]
)
@pytest.mark.parametrize("value", [1e-60, 1e60])
def test_intensities_that_would_be_lost_are_refused(folder, suffix, options, value):
    with pytest.raises(InputError, match=r"save as \.fits or \.npz"):
        Image([[0.0, value]]).save(folder / f"lost{suffix}", **options)


@pytest.mark.parametrize("bits", [8, 16])
@given(data=st.data())
@settings(max_examples=25, deadline=None)
def test_png_gives_back_what_it_shows(folder, bits, data):
    saved = data.draw(images(np.float32, st.floats(0, 2, width=32)))
    loaded = roundtrip(saved, folder, ".png", bits=bits, exposure=1)
    steps = 2**bits - 1
    shown = np.rint(saved.to_rgb(exposure=1).astype(np.float64) * steps)
    # Rounding of float32 at half steps moves a value by one step at most, and next to never.
    assert np.abs(loaded.intensity * np.float64(steps) - shown).max() <= 1
    assert_same_frame(loaded, saved)
    again = roundtrip(loaded, folder, ".png", bits=bits, exposure=1)
    assert_same_bits(again.intensity, loaded.intensity)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_texts_of_any_length_and_uneven_coordinates(folder, suffix):
    long = {"scene": "'&\" é" * 40_000, "list": list(range(1000))}
    saved = picture((2, 3, 3), x=[0, 1, 10], y=[3, -1], provenance=long)
    assert_same_frame(roundtrip(saved, folder, suffix), saved)


# Row 0 is the bottom


def bottom_red():
    values = np.zeros((2, 3, 3), np.float32)
    values[0, :, 0] = 1
    return Image(values)


def test_other_programs_see_row_0_at_the_bottom(folder):
    paths = {suffix: folder / f"bottom{suffix}" for suffix in (".png", ".tif", ".exr", ".fits")}
    for path in paths.values():
        bottom_red().save(path)
    for seen in (
        np.asarray(Pillow.open(paths[".png"])) / 255,
        tifffile.imread(paths[".tif"]),
        OpenEXR.File(str(paths[".exr"])).channels()["RGB"].pixels,
        np.moveaxis(fits.getdata(paths[".fits"])[:, ::-1], 0, -1),  # FITS begins at the bottom
    ):
        np.testing.assert_array_equal(seen[-1], [[1, 0, 0]] * 3)
        np.testing.assert_array_equal(seen[0], 0)


# Each format for other programs


@pytest.mark.parametrize(("unit", "channels"), [("pc", 1), ("rad", 3), ("AU", 1), ("", 3)])
def test_fits_wcs_gives_pixel_centres(folder, unit, channels):
    x, y = 0.3 + 0.7 * np.arange(7), -5 + 0.2 * np.arange(5)
    path = folder / "wcs.fits"
    picture((5, 7, channels), x=x, y=y, unit=unit, intensity_unit="Jy / sr").save(path)
    header = fits.getheader(path)
    wcs = WCS(header).sub(2)
    columns, rows = np.meshgrid(np.arange(7), np.arange(5))
    seen_x, seen_y = wcs.wcs_pix2world(columns, rows, 0)
    # Rounding of a sum of two numbers of order 5.
    np.testing.assert_allclose(seen_x, np.broadcast_to(x, (5, 7)), atol=4e-15)
    np.testing.assert_allclose(seen_y, np.broadcast_to(y[:, None], (5, 7)), atol=4e-15)
    assert [str(found) for found in wcs.wcs.cunit] == [unit, unit]
    assert u.Unit(header["BUNIT"]) == u.Unit("Jy / sr")


def test_fits_cards_that_were_edited_count(folder):
    path = folder / "edited.fits"
    picture(x=np.arange(7.0), y=np.arange(5.0), unit="pc", intensity_unit="Jy").save(path)
    with fits.open(path, mode="update") as hdus:
        hdus[0].header.update(CRVAL1=100.0, CUNIT1="kpc", CUNIT2="kpc", BUNIT="mJy")
    loaded = Image.load(path)
    np.testing.assert_allclose(loaded.x, 97 + np.arange(7))
    assert (loaded.unit, loaded.intensity_unit) == ("kpc", "mJy")


def test_png_alpha_looks_the_same_in_front_of_black(folder):
    # Opaque, half transparent, and light from a place that is fully transparent.
    values = np.array([[[0.5, 0.2, 0.0], [0.5, 0.2, 0.0], [0.5, 0.2, 0.0], [0.0, 0.0, 0.0]]])
    image = Image(values, transparency=np.array([[0.0, 0.4, 1.0, 1.0]]))
    path = folder / "alpha.png"
    image.save(path, transparent=True, bits=16, exposure=1)
    loaded = Image.load(path)
    # Two roundings to 16 bits.
    np.testing.assert_allclose(loaded.intensity, values, atol=2 / 65535)
    np.testing.assert_allclose(loaded.transparency[0, :, 0], [0, 0.4, 0.5, 1], atol=1 / 65535)
    assert Pillow.open(path).mode == "RGBA"


@pytest.mark.parametrize("samples", [1, 2, 3, 4])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_png_code_is_read_by_another_library(samples, dtype):
    top = np.iinfo(dtype).max
    pixels = np.random.default_rng(samples).integers(0, top, (5, 7, samples), dtype, endpoint=True)
    content = png.encode_pixels(pixels, {"key": "value"})
    np.testing.assert_array_equal(imagecodecs.png_decode(content).reshape(5, 7, samples), pixels)
    with Pillow.open(io.BytesIO(content)) as file:
        file.load()
        assert file.text == {"key": "value"}


# Files of other programs


@pytest.mark.parametrize("mode", ["1", "L", "LA", "P", "RGB", "RGBA", "I;16"])
def test_png_of_any_kind(folder, mode):
    values = np.random.default_rng(4).integers(0, 256, (5, 7, 3), np.uint8)
    path = folder / "foreign.png"
    if mode == "I;16":
        Pillow.fromarray(values[..., 0].astype(np.uint16) * 257).save(path)
    else:
        Pillow.fromarray(values).convert(mode).save(path)
    loaded = Image.load(path)
    assert loaded.channels == (3 if mode in ("P", "RGB", "RGBA") else 1)
    assert loaded.intensity.max() <= 1
    if mode in ("RGB", "RGBA", "I;16"):
        expected = values[::-1, :, : loaded.channels] / np.float32(255)
        np.testing.assert_array_equal(loaded.intensity, expected)


@pytest.mark.parametrize(
    ("dtype", "shape"), [(">f4", (5, 7)), (">f8", (2, 5, 7)), (">i2", (1, 2, 5, 7)), ("u1", (5, 7))]
)
def test_plain_fits_images(folder, dtype, shape):
    path = folder / "foreign.fits"
    data = np.random.default_rng(5).integers(0, 99, shape).astype(dtype)
    fits.PrimaryHDU(data).writeto(path, overwrite=True)
    loaded = Image.load(path)
    planes = data.reshape(-1, 5, 7)
    np.testing.assert_array_equal(loaded.intensity, np.moveaxis(planes, 0, -1))
    np.testing.assert_array_equal(loaded.x, np.arange(7))


def test_fits_images_behind_an_empty_primary_hdu_and_on_the_sky(folder):
    path = folder / "sky.fits"
    header = fits.Header()
    header.update(CTYPE1="RA---TAN", CTYPE2="DEC--TAN", CRPIX1=4.0, CRPIX2=3.0, CRVAL1=83.8)
    header.update(CRVAL2=-5.4, CDELT1=-0.01, CDELT2=0.01, CUNIT1="deg", CUNIT2="deg", BUNIT="K")
    hdu = fits.ImageHDU(np.ones((5, 7), np.float32), header)
    fits.HDUList([fits.PrimaryHDU(), hdu]).writeto(path)
    loaded = Image.load(path)
    np.testing.assert_allclose(loaded.x, -0.01 * np.arange(-3, 4))
    np.testing.assert_allclose(loaded.y, 0.01 * np.arange(-2, 3))
    assert (loaded.unit, loaded.intensity_unit) == ("deg", "K")
    assert loaded.pixel_area == pytest.approx(1e-4)


@pytest.mark.parametrize(
    "cards",
    [
        {"CD1_1": 0.7, "CD1_2": 0.7, "CD2_1": -0.7, "CD2_2": 0.7},
        {"CDELT1": -0.01, "CDELT2": 0.01, "CROTA2": 30.0},
    ],
)
def test_rotated_fits_images_have_pixel_indices(folder, cards):
    path = folder / "rotated.fits"
    hdu = fits.PrimaryHDU(np.ones((5, 7), np.float32))
    hdu.header.update(CUNIT1="deg", CUNIT2="deg", **cards)
    hdu.writeto(path, overwrite=True)
    loaded = Image.load(path)
    np.testing.assert_array_equal(loaded.x, np.arange(7))
    assert loaded.unit == ""


@pytest.mark.parametrize("dtype", [np.float32, np.float16, np.uint16])
@pytest.mark.parametrize("shape", [(5, 7), (5, 7, 3), (3, 5, 7)])
def test_plain_tiff_images(folder, dtype, shape):
    path = folder / "foreign.tif"
    data = np.random.default_rng(6).integers(0, 99, shape).astype(dtype)
    planar = {"planarconfig": "separate"} if shape[0] == 3 else {}
    kind = "rgb" if len(shape) == 3 else "minisblack"
    tifffile.imwrite(path, data, photometric=kind, **planar)
    pixels = data[..., None] if data.ndim == 2 else np.moveaxis(data, 0, -1) if planar else data
    np.testing.assert_array_equal(Image.load(path).intensity, pixels[::-1])


def test_tiff_orientation_and_alpha(folder):
    path = folder / "alpha.tif"
    data = np.random.default_rng(7).random((5, 7, 4)).astype("f4")
    options = {"photometric": "rgb", "extrasamples": ["unassalpha"]}
    tifffile.imwrite(path, data, extratags=[(274, "H", 1, 4, True)], **options)
    loaded = Image.load(path)
    np.testing.assert_array_equal(loaded.intensity, data[..., :3] * data[..., 3:])
    np.testing.assert_array_equal(loaded.transparency, np.repeat(1 - data[..., 3:], 3, axis=-1))


@pytest.mark.parametrize("names", ["RGBA", "YA", "Z", "UV", "RGBZ"])
def test_plain_exr_images(folder, names):
    layers = {name: np.random.default_rng(8).random((5, 7)).astype("f2") for name in names}
    OpenEXR.File({}, dict(layers)).write(str(folder / "foreign.exr"))
    loaded = Image.load(folder / "foreign.exr")
    shown = [n for n in names if n not in "A" and not (n == "Z" and len(names) > 1)]
    expected = np.stack([layers[n] for n in shown], axis=-1)[::-1]
    np.testing.assert_array_equal(loaded.intensity, expected)
    assert (loaded.transparency is not None) == ("A" in names)


def test_files_without_an_image(folder):
    table = fits.BinTableHDU.from_columns([fits.Column("a", "E", array=[1.0])])
    fits.HDUList([fits.PrimaryHDU(), table]).writeto(folder / "table.fits")
    with pytest.raises(FileFormatError, match="there is none"):
        Image.load(folder / "table.fits")
    np.savez(folder / "foreign.npz", density=np.eye(3))
    with pytest.raises(FileFormatError, match=r"foreign\.npz.*intensity.*density"):
        Image.load(folder / "foreign.npz")


def test_pictures_cut_by_other_programs_lose_their_coordinates(folder):
    path = folder / "cut.png"
    picture(x=np.arange(7) * 2.0, y=np.arange(5) * 2.0, unit="pc", camera=CAMERA).save(path)
    with Pillow.open(path) as file:
        text = file.text["voluminous"]
        cut = file.crop((0, 0, 3, 3))
    notes = PngInfo()
    notes.add_text("voluminous", text)
    cut.save(path, pnginfo=notes)
    loaded = Image.load(path)
    np.testing.assert_array_equal(loaded.x, [0, 1, 2])
    assert loaded.unit == ""
    assert loaded.camera == CAMERA


# Damage


def saved_bytes(folder, suffix):
    path = folder / f"whole{suffix}"
    bits = {"bits": 16} if suffix == ".png" else {}
    picture((9, 8, 3), transparency=np.full((9, 8), 0.5), unit="pc", camera=CAMERA).save(
        path, **bits
    )
    return path.read_bytes()


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_truncated_files_are_named(folder, suffix, capfd):
    whole = saved_bytes(folder, suffix)
    path = folder / f"short{suffix}"
    blocks = range(2880, len(whole), 2880) if suffix == ".fits" else ()
    # The last bytes of a file may be padding or repeat what is known; leave 16 out.
    for length in {*np.linspace(0, len(whole) - 16, 40).astype(int).tolist(), *blocks}:
        path.write_bytes(whole[:length])
        with pytest.raises(FileFormatError, match=f"short{suffix}"):
            Image.load(path)
    assert capfd.readouterr().out == ""


@pytest.mark.exhaustive
@pytest.mark.parametrize("suffix", [".npz", ".fits", ".tif", ".png"])
@given(data=st.data())
@settings(max_examples=60, deadline=None)
def test_damaged_bytes_never_raise_anything_else(folder, suffix, data):
    content = bytearray(saved_bytes(folder, suffix))
    for _ in range(data.draw(st.integers(1, 3))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    path = folder / f"damaged{suffix}"
    path.write_bytes(content)
    # Whatever else is raised fails the test; harmless damage, such as in a comment, may load.
    with contextlib.suppress(FileFormatError):
        Image.load(path)


@pytest.mark.parametrize("form", FORMATS, ids=lambda form: form.suffixes[0])
def test_other_files_under_the_suffix_are_named(folder, form):
    path = folder / f"other{form.suffixes[0]}"
    for content in (b"", b"GIF89a and so on" * 100):
        path.write_bytes(content)
        with pytest.raises(FileFormatError, match=rf"{path.name}.*{re.escape(form.name)}"):
            Image.load(path)


# Saving: whole or not at all


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("error", [OSError("disk full"), KeyboardInterrupt()])
def test_failure_while_writing_keeps_the_old_file(tmp_path, monkeypatch, suffix, error):
    path = tmp_path / f"kept{suffix}"
    picture().save(path)
    before = path.read_bytes()

    def replace(source, target):
        assert os.path.getsize(source) > 0  # written in full, but not in place
        raise error

    monkeypatch.setattr(os, "replace", replace)
    with pytest.raises(type(error)):
        Image(np.zeros((2, 2))).save(path)
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == [path.name]


def test_unknown_suffixes(tmp_path):
    for name, message in (
        ("image.pgn", "did you mean '.png'"),
        ("image", r"image formats: .*\.exr"),
    ):
        with pytest.raises(UnknownNameError, match=message):
            picture().save(tmp_path / name)
        with pytest.raises(UnknownNameError, match=message):
            Image.load(tmp_path / name)


def test_unknown_options(tmp_path):
    with pytest.raises(UnknownNameError, match="'strech'; did you mean 'stretch'"):
        picture().save(tmp_path / "image.png", strech="log")
    with pytest.raises(UnknownNameError, match="'bits'"):
        picture().save(tmp_path / "image.fits", bits=16)
    for bits in (12, [8]):
        with pytest.raises(InputError, match="bits must be 8 or 16"):
            picture().save(tmp_path / "image.png", bits=bits)
    with pytest.raises(InputError, match="transparency is known"):
        picture().save(tmp_path / "image.png", transparent=True)
    with pytest.raises(MissingPathError, match="create it first"):
        picture().save(tmp_path / "missing" / "image.png")
    assert not os.listdir(tmp_path)


def test_jpeg_holds_the_display_values(folder):
    suffix = ".jpg"
    y, x = np.mgrid[0:1:40j, 0:1:50j]
    image = Image(np.stack([x, y, 1 - x], axis=-1))
    image.save(folder / f"image{suffix}", exposure="rgb")
    again = Image.load(folder / f"image{suffix}").intensity
    np.testing.assert_allclose(again, image.intensity, atol=0.03)
    with pytest.raises(InputError, match="quality"):
        image.save(folder / f"image{suffix}", quality=0)
    with pytest.raises(UnknownNameError, match="transparent"):
        image.save(folder / f"image{suffix}", transparent=True)
    image.save(folder / f"image{suffix}", annotate={"title": "x"})
    assert Image.load(folder / f"image{suffix}").shape[0] > 40


@pytest.mark.parametrize(("suffix", "start"), [(".pdf", b"%PDF"), (".svg", b"<?xml")])
def test_pages_hold_the_picture_and_are_not_read(folder, suffix, start):
    path = folder / f"image{suffix}"
    image = Image(np.random.default_rng(1).random((20, 30, 3)), transparency=0.5)
    image.save(path, stretch="sqrt", transparent=True)
    assert path.read_bytes().startswith(start)
    plain = path.stat().st_size
    image.save(path, annotate={"title": "A title"})
    assert path.stat().st_size > plain
    with pytest.raises(FileFormatError, match="holds a page"):
        Image.load(path)
