"""FITS cubes: values and places are those that astropy tells, for all kinds of headers."""

from __future__ import annotations

import sys
import types

import numpy as np
import pytest
from astropy import units as u
from astropy.io import fits
from astropy.wcs import WCS

import reference
import voluminous as vm
from contracts import ReaderContract
from voluminous.cli.data import is_image
from voluminous.image.fits_header import lenient_unit

REST = 110.2013541e9
SKY = {
    "CTYPE1": "RA---TAN",
    "CTYPE2": "DEC--TAN",
    "CRVAL1": 51.3,
    "CRVAL2": 30.6,
    "CRPIX1": 4.0,
    "CRPIX2": 3.0,
    "CDELT1": -0.01,
    "CDELT2": 0.01,
}
VELOCITY = {"CTYPE3": "VRAD", "CRVAL3": -2e3, "CDELT3": 250.0, "CRPIX3": 2.0, "CUNIT3": "m/s"}
FREQUENCY = {"CTYPE3": "FREQ", "CRVAL3": REST, "CDELT3": -9e4, "CRPIX3": 2.0, "CUNIT3": "Hz"}
SHAPE = (10, 9, 8)  # 720 values: the data end where a block ends, and any cut loses some


def header(*parts, **cards):
    made = fits.Header()
    for part in (*parts, cards):
        for key, value in part.items():
            made[key] = value
    return made


def numbers(shape=SHAPE, dtype=np.float32):
    return np.random.default_rng(5).normal(size=shape).astype(dtype)


def written(path, data=None, cards=None, **more):
    data = numbers() if data is None else data
    fits.PrimaryHDU(data, header(SKY, VELOCITY) if cards is None else cards).writeto(path, **more)
    return path


def sky_of_cells(volume):
    """Return longitude, latitude and third coordinate of all cells, from the volume's WCS."""
    index = np.indices(volume.grid.shape).reshape(3, -1).T
    return volume.wcs.wcs_pix2world(index, 0)


class TestPlain(ReaderContract):
    @pytest.fixture
    def sample(self):
        return lambda folder: written(folder / "cube.fits", overwrite=True)


class TestCompressedTiles(ReaderContract):
    cuts = (0.0, 0.3, 0.6)

    @pytest.fixture
    def sample(self):
        def make(folder):
            whole = (100 * numbers()).astype(np.int32)
            hdu = fits.CompImageHDU(whole, header(SKY, VELOCITY), compression_type="RICE_1")
            path = folder / "cube.fits"
            fits.HDUList([fits.PrimaryHDU(), hdu]).writeto(path, overwrite=True)
            # The blocks of a table are filled up with zeros, which may be cut without loss.
            return path

        return make


def several(folder):
    """Write three cubes into one file."""
    cards = header(SKY, FREQUENCY, RESTFRQ=REST, BUNIT="Jy/beam")
    hdus = [
        fits.PrimaryHDU(),
        fits.ImageHDU(numbers(), cards, name="SCI"),
        fits.ImageHDU(numbers(dtype=np.int32), cards, name="DQ"),
        fits.ImageHDU(numbers(dtype=np.float64), cards, name="ERR"),
    ]
    path = folder / "several.fits"
    fits.HDUList(hdus).writeto(path, overwrite=True)
    return path


@pytest.mark.parametrize("dtype", ["u1", "i1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8"])
@pytest.mark.parametrize("suffix", [".fits", ".fits.gz"])
def test_every_type_comes_back_as_it_was(tmp_path, dtype, suffix):
    data = (50 + 20 * numbers((4, 3, 5))).astype(dtype)
    volume = vm.open(written(tmp_path / f"cube{suffix}", data, header()))
    assert volume.array("intensity").dtype == np.dtype(dtype)
    np.testing.assert_array_equal(volume.array("intensity"), data.T)


@pytest.mark.parametrize("dtype", ["i2", "i4", "u1"])
@pytest.mark.parametrize("scale", [(1.0, 0.0), (0.5, 3.0)])
@pytest.mark.parametrize("missing", [True, False])
def test_scaled_and_blank_integers_are_what_astropy_makes_of_them(tmp_path, dtype, scale, missing):
    stored = np.arange(60).reshape(3, 4, 5).astype(dtype)
    hdu = fits.PrimaryHDU(stored)
    hdu.header["BLANK"] = 7 if missing else 99
    hdu.header["BSCALE"], hdu.header["BZERO"] = scale
    hdu.writeto(tmp_path / "cube.fits")
    found = vm.open(tmp_path / "cube.fits").array("intensity")
    expected = fits.getdata(tmp_path / "cube.fits").T
    np.testing.assert_array_equal(found, expected)
    assert np.isnan(found).sum() == missing
    assert found.dtype.kind == "f"  # whether or not a number is missing


@pytest.mark.parametrize(
    ("text", "unit"),
    [
        ("K (Ta*)", u.K),
        ("JY/BEAM", u.Jy / u.beam),
        ("JY/BEAM.KM/S", u.Jy / u.beam * u.km / u.s),
        ("km/s", u.km / u.s),
        ("      HZ", u.Hz),
        ("10**(-20)*erg/s/cm**2/Angstrom", 1e-20 * u.erg / u.s / u.cm**2 / u.AA),
        ("counts", u.ct),
        ("", None),
        ("UNKNOWN", None),
        ("(((", None),
    ],
)
def test_units_are_read_as_they_are_meant(text, unit):
    found = lenient_unit(text)
    assert (found is None) == (unit is None)
    if unit is not None:
        assert (1 * found).to_value(unit) == pytest.approx(1, rel=1e-12)


def turned(angle, flip=1.0):
    """Return the matrix of an image whose y axis has a position angle."""
    c, s = np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))
    step = 0.01
    return {
        "CTYPE1": "RA---TAN",
        "CTYPE2": "DEC--TAN",
        "CRVAL1": 51.3,
        "CRVAL2": 30.6,
        "CRPIX1": 4.0,
        "CRPIX2": 3.0,
        "CD1_1": -flip * step * c,
        "CD1_2": step * s,
        "CD2_1": flip * step * s,
        "CD2_2": step * c,
        "CD3_3": 250.0,
        **{key: value for key, value in VELOCITY.items() if not key.startswith("CDELT")},
    }


HEADERS = {
    "usual": header(SKY, VELOCITY),
    "east to the right": header(SKY, VELOCITY, CDELT1=0.01),
    "south up": header(SKY, VELOCITY, CDELT2=-0.01),
    "both": header(SKY, VELOCITY, CDELT1=0.01, CDELT2=-0.01),
    "falling velocity": header(SKY, VELOCITY, CDELT3=-250.0),
    "frequency": header(SKY, FREQUENCY, RESTFRQ=REST),
    "galactic": header(SKY, VELOCITY, CTYPE1="GLON-CAR", CTYPE2="GLAT-CAR", CRVAL2=0.0),
    "velocity first": header(
        {f"{key[:-1]}{(int(key[-1]) % 3) + 1}": v for key, v in {**SKY, **VELOCITY}.items()}
    ),
    "latitude first": header(
        {f"{k[:-1]}{dict(zip('123', '213', strict=True))[k[-1]]}": v for k, v in SKY.items()},
        VELOCITY,
    ),
    **{f"turned by {a}": header(turned(a)) for a in (20, -40, 70, 90, 130, 180, -90)},
    **{f"turned by {a}, mirrored": header(turned(a, -1.0)) for a in (20, 90, 200)},
    "crota": header(SKY, VELOCITY, CROTA2=25.0),
}


@pytest.mark.parametrize("name", HEADERS)
def test_each_cell_has_its_value_and_its_place(tmp_path, name):
    data = numbers((6, 7, 8))
    path = written(tmp_path / "cube.fits", data, HEADERS[name])
    volume = vm.open(path)
    # Each value is unique: where it is in the file, and where astropy sees it there.
    order = np.argsort(data, axis=None)[
        np.argsort(np.argsort(volume.array("intensity"), axis=None))
    ]
    pixels = np.stack(np.unravel_index(order, data.shape), axis=-1)[:, ::-1]
    wcs = WCS(fits.getheader(path))
    expected = wcs.wcs_pix2world(pixels, 0)
    lng, lat, spec = wcs.wcs.lng, wcs.wcs.lat, wcs.wcs.spec
    found = sky_of_cells(volume)
    # Pixels are 0.01 degrees, 250 m/s: far above rounding.
    np.testing.assert_allclose(found[:, :2], expected[:, [lng, lat]], rtol=0, atol=1e-9)
    velocity = expected[:, spec]
    if name == "frequency":
        velocity = (velocity * u.Hz).to_value(u.m / u.s, u.doppler_radio(REST * u.Hz))
    np.testing.assert_allclose(found[:, 2], velocity, rtol=0, atol=1e-4)
    np.testing.assert_allclose(volume.array("velocity").ravel(), velocity / 1e3, rtol=0, atol=1e-5)


def test_the_grid_is_centred_in_arcseconds_and_as_deep_as_wide(tmp_path):
    volume = vm.open(written(tmp_path / "cube.fits", numbers((6, 7, 8))))
    np.testing.assert_allclose(volume.grid.bounds, [(-144, 144), (-126, 126), (-144, 144)])
    assert (volume.unit, volume.grid.is_uniform) == (u.arcsec, True)
    deep = vm.open(tmp_path / "cube.fits", depth="1 arcmin")
    np.testing.assert_allclose(deep.grid.bounds[2], (-30, 30))
    scaled = vm.open(tmp_path / "cube.fits", spectral_scale=100.0)  # arcsec per km/s: 1.5 km/s
    np.testing.assert_allclose(scaled.grid.bounds[2], (-75, 75))
    wide = vm.open(tmp_path / "cube.fits", unit="deg", spectral_scale="0.1 deg s / km")
    np.testing.assert_allclose(wide.grid.bounds[2], (-0.075, 0.075))
    for wrong in (0, -1, "deep", (1, 2), np.inf):
        with pytest.raises(vm.InputError, match="depth must be"):
            vm.open(tmp_path / "cube.fits", depth=wrong)
    with pytest.raises(vm.InputError, match="not both"):
        vm.open(tmp_path / "cube.fits", depth=1, spectral_scale=1)
    with pytest.raises(vm.UnitsError):
        vm.open(tmp_path / "cube.fits", unit="pc")


@pytest.mark.parametrize(
    ("cards", "name", "unit", "first"),
    [
        (VELOCITY, "velocity", "km / s", -2.25),
        ({**VELOCITY, "CTYPE3": "VELO-LSR"}, "velocity", "km / s", -2.25),
        (FREQUENCY, "frequency", "GHz", (REST - 4 * 9e4) / 1e9),
        (
            {"CTYPE3": "WAVE", "CRVAL3": 2e-6, "CDELT3": 1e-9, "CRPIX3": 1.0, "CUNIT3": "m"},
            "wavelength",
            "um",
            2.0,
        ),
        (
            {"CTYPE3": "DISTANCE", "CDELT3": 5.0, "CRPIX3": 0.5, "CUNIT3": "pc"},
            "distance",
            "pc",
            2.5,
        ),
        ({"CTYPE3": "STOKES", "CDELT3": 1.0, "CRVAL3": 1.0, "CRPIX3": 1.0}, "stokes", "", 1.0),
    ],
)
def test_the_third_axis_is_a_field_in_a_unit_people_read(tmp_path, cards, name, unit, first):
    volume = vm.open(written(tmp_path / "cube.fits", numbers((6, 7, 8)), header(SKY, cards)))
    assert volume.fields == ("intensity", name)
    assert volume.units[name] == unit
    if first is not None:
        assert volume.array(name)[0, 0, 0] == pytest.approx(first, rel=1e-6)


DOPPLER = {
    "radio": u.doppler_radio(REST * u.Hz),
    "optical": u.doppler_optical(REST * u.Hz),
    "relativistic": u.doppler_relativistic(REST * u.Hz),
}


@pytest.mark.parametrize("convention", DOPPLER)
@pytest.mark.parametrize("rest", [True, False])
def test_doppler_conventions_are_those_of_astropy(tmp_path, convention, rest):
    # Steps of 1 GHz: conventions differ, and cells are not equally wide.
    cards = header(SKY, FREQUENCY, CDELT3=1e9, **({"RESTFRQ": REST} if rest else {}))
    path = written(tmp_path / "cube.fits", numbers((6, 7, 8)), cards)
    options = {} if rest else {"rest": f"{REST} Hz"}
    volume = vm.open(path, velocity=convention, **options)
    frequency = (REST + 1e9 * (np.arange(6) - 1)) * u.Hz
    expected = frequency.to_value(u.km / u.s, DOPPLER[convention])[::-1]
    np.testing.assert_allclose(volume.array("velocity")[0, 0], expected, rtol=1e-6, atol=1e-3)
    edges = (REST + 1e9 * (np.arange(7) - 1.5)) * u.Hz
    edges = edges.to_value(u.km / u.s, DOPPLER[convention])[::-1]
    deep = (edges - edges[0]) / np.ptp(edges) * np.ptp(volume.grid.edges[2])
    np.testing.assert_allclose(volume.grid.edges[2] - volume.grid.edges[2][0], deep, atol=1e-6)
    assert volume.grid.is_uniform == (convention == "radio")


@pytest.mark.parametrize(
    "cards",
    [
        {**SKY, **VELOCITY, "PC1_3": 0.5},  # the sky turns with velocity
        {"CTYPE1": "X", "CTYPE2": "Y", "CTYPE3": "Z", "PC1_2": 0.5, "CDELT1": 1.0},
        {**SKY, **VELOCITY, "CDELT3": 0.0},
        {**SKY, **VELOCITY, "CTYPE2": "DEC--SIN"},
        {**SKY, **VELOCITY, "CTYPE1": "RA---XYZ", "CTYPE2": "DEC--XYZ"},
        {"CUNIT1": "pc", "CUNIT2": "s", "CDELT1": 1.0},
    ],
)
def test_coordinates_that_no_grid_has_are_refused_and_can_be_left(tmp_path, cards):
    path = written(tmp_path / "cube.fits", cards=header(cards))
    with pytest.raises(vm.FileFormatError, match="wcs=False") as failure:
        vm.open(path)
    assert str(path) in str(failure.value)
    assert vm.open(path, wcs=False).unit is None


STEPS = {
    "CDELT": {"CDELT1": -0.01, "CDELT2": 0.01},
    "CD": {"CD1_1": -0.01, "CD2_2": 0.01},
    "PC": {"CDELT1": -0.02, "CDELT2": 0.02, "PC1_1": 0.5, "PC2_2": 0.5},
    "old PC": {"CDELT1": -0.02, "CDELT2": 0.02, "PC001001": 0.5, "PC002002": 0.5},
    "PC and CD": {"CD1_1": -0.01, "CD2_2": 0.01, "PC1_1": 1.0, "CDELT1": -0.01, "CDELT2": 0.01},
}
THIRD_STEPS = {
    "CDELT": {"CDELT3": 250.0},
    "CD": {"CD3_3": 250.0},
    "both": {"CDELT3": 500.0, "CD3_3": 250.0},
    "PC": {"CDELT3": 125.0, "PC3_3": 2.0},
    "CD of zero": {"CDELT3": 250.0, "CD3_1": 0.0, "CD3_3": 0.0},
}


@pytest.mark.parametrize("third", THIRD_STEPS)
@pytest.mark.parametrize("sky", STEPS)
def test_each_axis_has_the_step_of_its_own_cards(tmp_path, sky, third):
    start = {key: v for key, v in {**SKY, **VELOCITY}.items() if not key.startswith("CDELT")}
    mixed = header(start, STEPS[sky], THIRD_STEPS[third])
    if third == "both" and ("PC" in sky):
        mixed["CDELT3"] = 250.0  # of PC and CD cards the standard prefers neither
    one = vm.open(written(tmp_path / "mixed.fits", cards=mixed))
    two = vm.open(written(tmp_path / "plain.fits", cards=header(SKY, VELOCITY)))
    np.testing.assert_allclose(sky_of_cells(one), sky_of_cells(two), rtol=1e-12)
    np.testing.assert_allclose(one.array("velocity"), two.array("velocity"), rtol=1e-6)


def skirt(path, centers, unit):
    """Write a cube as SKIRT does, in whose header the third axis has a unit only."""
    cards = header({"CUNIT1": "pc", "CUNIT2": "pc", "CUNIT3": unit, "CTYPE1": " ", "CTYPE2": " "})
    for k in (1, 2):
        cards[f"CRPIX{k}"], cards[f"CRVAL{k}"], cards[f"CDELT{k}"] = 1.0, 0.0, 2.0
    data = numbers((len(centers), 4, 5))
    column = fits.Column("GRID_POINTS", "E16.9", unit=unit, array=np.array(centers))
    table = fits.TableHDU.from_columns([column], name="Z-axis coordinate values")
    fits.HDUList([fits.PrimaryHDU(data, cards), table]).writeto(path, overwrite=True)
    return data


@pytest.mark.parametrize(
    ("name", "unit", "shown"),
    [
        ("wavelength", "micron", "um"),
        ("frequency", "GHz", "GHz"),
        ("energy", "eV", "eV"),
        ("zval", "1", ""),
    ],
)
@pytest.mark.parametrize("centers", [[1.0, 2.0, 4.0, 8.0], [8.0, 4.0, 2.0, 1.0]])
def test_skirt_has_the_third_axis_in_a_table(tmp_path, name, unit, shown, centers):
    path = tmp_path / "cube.fits"
    data = skirt(path, centers, unit)
    volume = vm.open(path, depth="6.5 pc")
    assert volume.unit == "pc"
    assert volume.units[name] == shown
    np.testing.assert_allclose(volume.array(name)[0, 0], [1, 2, 4, 8])
    # Cells end midway between centres: 0.5, 1.5, 3, 6, 10 of the axis over 6.5 pc.
    edges = np.array([0.5, 1.5, 3, 6, 10]) * 6.5 / 9.5
    np.testing.assert_allclose(np.diff(volume.grid.edges[2]), np.diff(edges))
    order = np.argsort(centers)
    np.testing.assert_array_equal(volume.array("intensity"), data[order].T)
    for copy in (tmp_path / "copy.fits", tmp_path / "copy.h5"):
        volume.save(copy)
        again = vm.open(copy)
        np.testing.assert_array_equal(again.array("intensity"), data[order].T)
        np.testing.assert_allclose(again.array(name), volume.array(name))
        np.testing.assert_allclose(again.grid.edges[2], volume.grid.edges[2])
        np.testing.assert_allclose(
            again.wcs.wcs_pix2world([[0, 0, 2]], 0)[0, 2], 4 * 1.0, rtol=1e-6
        )


def tabled(path, centers, index=None, **cards):
    """Write a cube with a ``-TAB`` axis of FITS paper III, section 6."""
    third = {"CTYPE3": "WAVE-TAB", "CRVAL3": 1.0, "CRPIX3": 1.0, "CDELT3": 1.0, "CUNIT3": "um"}
    third |= {"PS3_0": "WCS-TABLE", "PS3_1": "WAVELENGTH", "PV3_1": 1, "PV3_2": 1, "PV3_3": 1}
    n = len(centers)
    columns = [
        fits.Column("WAVELENGTH", f"{n}D", dim=f"(1,{n})", array=np.reshape(centers, (1, n, 1)))
    ]
    if index is not None:
        third["PS3_2"] = "INDEX"
        columns.append(fits.Column("INDEX", f"{n}D", array=np.reshape(index, (1, n))))
    hdus = [fits.PrimaryHDU(numbers((5, 4, 6)), header(SKY, third, cards))]
    hdus.append(fits.BinTableHDU.from_columns(columns, name="WCS-TABLE"))
    fits.HDUList(hdus).writeto(path, overwrite=True)
    with fits.open(path) as opened:
        return WCS(opened[0].header, opened)


@pytest.mark.parametrize("falling", [False, True])
@pytest.mark.parametrize("index", [None, [0.0, 1.0, 2.0, 4.0, 8.0]])
def test_tables_of_the_standard(tmp_path, falling, index):
    centers = [1.0, 2.0, 4.0, 8.0, 16.0][:: -1 if falling else 1]
    cards = {} if index is None else {"CRVAL3": 0.0, "CDELT3": 2.0}
    wcs = tabled(tmp_path / "cube.fits", centers, index, **cards)
    expected = np.sort(wcs.wcs_pix2world([[0, 0, k] for k in range(5)], 0)[:, 2])
    volume = vm.open(tmp_path / "cube.fits")
    np.testing.assert_allclose(volume.array("wavelength")[0, 0], expected)
    assert volume.units["wavelength"] == "um"
    values = numbers((5, 4, 6))[:: -1 if falling else 1].T
    np.testing.assert_array_equal(volume.array("intensity"), values)
    medium = vm.Gaussian("intensity", 1.0, 0.5, "red", 0.5)
    slit = vm.render(volume, medium, vm.Orthographic(incl=90, resolution=64))
    third = slit.wcs.wcs_pix2world([[0, 0], [0, slit.shape[0] - 1]], 0)[:, 1] * 1e6
    assert third.min() < expected[0]  # the whole axis is in the picture
    assert third.max() > expected[-1]
    for copy in (tmp_path / "copy.fits", tmp_path / "copy.h5"):
        volume.save(copy)
        again = vm.open(copy)
        np.testing.assert_allclose(again.array("wavelength"), volume.array("wavelength"))
        np.testing.assert_allclose(sky_of_cells(again), sky_of_cells(volume))


def test_axes_of_one_pixel_are_dropped(tmp_path):
    """As CASA exports them: RA, Dec, Stokes, frequency; and as others do, frequency first."""
    data = numbers((6, 7, 8))
    stokes = {"CTYPE3": "STOKES", "CRVAL3": 1.0, "CDELT3": 1.0, "CRPIX3": 1.0}
    fourth = {f"{key[:-1]}4": value for key, value in FREQUENCY.items()}
    casa = header(SKY, stokes, fourth, RESTFRQ=REST, BUNIT="Jy/beam", BTYPE="Intensity")
    one = vm.open(written(tmp_path / "casa.fits", data[:, None], casa))
    last = {f"{key[:-1]}4": value for key, value in stokes.items()}
    other = header(SKY, FREQUENCY, last, RESTFRQ=REST)
    two = vm.open(written(tmp_path / "other.fits", data[None], other))
    plain = vm.open(written(tmp_path / "plain.fits", data, header(SKY, FREQUENCY, RESTFRQ=REST)))
    for volume in (one, two):
        np.testing.assert_array_equal(volume.array("intensity"), plain.array("intensity"))
        np.testing.assert_array_equal(volume.array("velocity"), plain.array("velocity"))
        np.testing.assert_allclose(sky_of_cells(volume), sky_of_cells(plain), rtol=1e-12)
    assert one.units["intensity"] == "Jy / beam"


def test_of_four_axes_one_is_chosen(tmp_path):
    data = numbers((4, 6, 7, 8))
    fourth = {"CTYPE4": "STOKES", "CRVAL4": 1.0, "CDELT4": 1.0, "CRPIX4": 1.0}
    path = written(tmp_path / "stokes.fits", data, header(SKY, VELOCITY, fourth))
    np.testing.assert_array_equal(vm.open(path).array("intensity"), data[0].T)
    np.testing.assert_array_equal(vm.open(path, plane=2).array("intensity"), data[2].T)
    for wrong in (4, -1, (0, 0), "Q", 1.5):
        with pytest.raises(vm.InputError, match="plane"):
            vm.open(path, plane=wrong)
    cards = header(SKY, VELOCITY, fourth, CTYPE4="TIME")
    path = written(tmp_path / "time.fits", data, cards)
    with pytest.raises(vm.InputError, match="plane=0 … along TIME of 4"):
        vm.open(path)
    np.testing.assert_array_equal(vm.open(path, plane=3).array("intensity"), data[3].T)


def test_cubes_of_one_file_are_fields(tmp_path):
    sample = several(tmp_path)
    volume = vm.open(sample)
    assert volume.fields == ("sci", "dq", "err", "velocity")
    assert [volume.array(n).dtype for n in ("sci", "dq", "err")] == ["f4", "i4", "f8"]
    assert vm.open(sample, hdu="err").fields == ("err", "velocity")
    assert vm.open(sample, hdu=2).fields == ("dq", "velocity")
    assert vm.open(sample, ["ERR"]).fields == ("err",)
    with pytest.raises(vm.errors.UnknownNameError, match="SCI"):
        vm.open(sample, hdu="SCII")


def test_pictures_are_told_from_cubes_by_content(tmp_path):
    cube, picture, flat = (tmp_path / name for name in ("cube.fits", "picture.fits", "flat.fits"))
    written(cube)
    vm.Image(np.ones((4, 5, 3))).save(picture)
    fits.writeto(flat, np.ones((4, 5)))
    assert [is_image(path) for path in (cube, picture, flat)] == [False, True, True]
    assert vm.Image.load(flat).shape == (4, 5, 1)
    for path in (picture, flat):
        with pytest.raises(vm.FileFormatError, match=r"vm\.Image\.load reads"):
            vm.open(path)
    (tmp_path / "empty.fits").write_bytes(b"")
    assert is_image(tmp_path / "no_such_file.fits")
    for content in (b"", b"SIMPLE  =", b"\x1f\x8b\x08 no gzip"):
        (tmp_path / "empty.fits").write_bytes(content)
        is_image(tmp_path / "empty.fits")  # does not raise


# Writing


@pytest.mark.parametrize("name", ["usual", "frequency", "turned by -40", "galactic"])
def test_a_cube_on_the_sky_is_written_with_its_sky(tmp_path, name):
    path = written(tmp_path / "cube.fits", numbers((6, 7, 8)), HEADERS[name])
    volume = vm.open(path, depth=100)
    volume.save(tmp_path / "again.fits")
    again = vm.open(tmp_path / "again.fits")
    assert again.fields == volume.fields
    assert again.units == volume.units
    np.testing.assert_array_equal(again.array("intensity"), volume.array("intensity"))
    np.testing.assert_allclose(again.array("velocity"), volume.array("velocity"), atol=1e-4)
    np.testing.assert_allclose(sky_of_cells(again), sky_of_cells(volume), rtol=1e-9, atol=1e-3)
    for mine, theirs in zip(again.grid.edges, volume.grid.edges, strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=1e-9, atol=1e-6)


def test_a_volume_is_written_as_a_linear_cube(tmp_path):
    grid = vm.CartesianGrid.uniform((3, 4, 5), ((-1, 2), (0, 8), (10, 11)), unit="pc")
    rng = np.random.default_rng(1)
    volume = vm.Volume(grid, T=rng.random(grid.shape), flag=rng.random(grid.shape) > 0.5)
    volume["Ion_x"] = rng.integers(0, 60000, grid.shape).astype(np.uint16)
    volume.set_unit("T", "K")
    volume.meta["object"] = "nothing"
    volume.save(tmp_path / "cube.fits")
    again = vm.open(tmp_path / "cube.fits")
    assert again.fields == ("T", "flag", "Ion_x")
    assert (again.unit, again.units["T"], again.meta["object"]) == (u.pc, "K", "nothing")
    np.testing.assert_allclose(again.grid.bounds, grid.bounds)
    for name in volume.fields:
        np.testing.assert_array_equal(again.array(name), volume.array(name))
    with fits.open(tmp_path / "cube.fits") as hdus:
        hdus.verify("exception")
        assert WCS(hdus[0].header).wcs_pix2world([[0, 0, 0]], 0).tolist() == [[-0.5, 1.0, 10.1]]


@pytest.mark.parametrize(
    ("key", "old", "new"),
    [
        *(("NAXIS1", 8, new) for new in (8000000, -8, 0, 8.5)),
        ("NAXIS", 3, 3000),
        *(("BITPIX", -32, new) for new in (-31, -16)),
    ],
)
def test_headers_that_cannot_be_true(tmp_path, key, old, new):
    path = written(tmp_path / "cube.fits")
    content = path.read_bytes()
    cards = [f"{key:8s}= {value:>20}".encode() for value in (old, new)]
    assert cards[0] in content
    path.write_bytes(content.replace(*cards))
    with pytest.raises(vm.FileFormatError) as failure:
        vm.open(path)
    assert str(path) in str(failure.value)


@pytest.fixture
def l1448():
    path = reference.data_directory() / "data/fits_l1448_13co/l1448_13co.fits"
    if not path.is_file():
        pytest.skip(f"no {path}; set VOLUMINOUS_TEST_DATA")
    return path


def test_l1448_cell_by_cell(l1448):
    volume = vm.open(l1448)
    with fits.open(l1448) as hdus:
        data, wcs = hdus[0].data, WCS(hdus[0].header)
    np.testing.assert_array_equal(volume.array("intensity"), data.T)
    index = np.indices(volume.grid.shape).reshape(3, -1).T
    expected = wcs.wcs_pix2world(index, 0)
    np.testing.assert_array_equal(sky_of_cells(volume), expected)
    np.testing.assert_allclose(
        volume.array("velocity").ravel(), expected[:, 2] / 1e3, rtol=0, atol=1e-6
    )
    # 105 pixels of 0.006388889 degrees, which are 23 arcsec.
    np.testing.assert_allclose(volume.grid.bounds[:2], [(-1207.5, 1207.5)] * 2, atol=1e-3)


# Headers as other programs write them: both doors read them alike.

LINE = 230.538e9
SI = {"km / s": 1e3, "GHz": 1e9, "um": 1e-6, "keV": (1 * u.keV).to_value("J"), "Angstrom": 1e-10}


def third(kind, value, step, unit=None, **more):
    cards = {"CTYPE3": kind, "CRVAL3": value, "CDELT3": step, "CRPIX3": 1.0}
    return header(SKY, cards, {} if unit is None else {"CUNIT3": unit}, more)


def of_frequency(nu):
    return nu


def of_energy(energy):
    return (energy * u.J).to_value(u.Hz, u.spectral())


def of_wavelength(wavelength):
    return (wavelength * u.m).to_value(u.Hz, u.spectral())


def of_radio(v):
    return (v * u.m / u.s).to_value(u.Hz, u.doppler_radio(LINE * u.Hz))


def of_optical(v):
    return (v * u.m / u.s).to_value(u.Hz, u.doppler_optical(LINE * u.Hz))


def of_relativistic(v):
    return (v * u.m / u.s).to_value(u.Hz, u.doppler_relativistic(LINE * u.Hz))


V = np.arange(6) * 1e5 - 2e5
STEPS_UP = np.arange(6)
IN_THE_WILD = {
    "AIPS, radio": (third("VELO-LSR", -2e5, 1e5, "M/S", RESTFREQ=LINE, VELREF=257), V, of_radio),
    "AIPS, optical": (third("VELO-HEL", -2e5, 1e5, RESTFREQ=LINE, VELREF=2), V, of_optical),
    # Even in frequency: v = c (ν₀/ν - 1) with dν at the reference as dv says.
    "AIPS, FELO": (third("FELO-HEL", 0.0, 1e5, "m/s", RESTFREQ=LINE), None, None),
    "GILDAS": (third("VELOCITY", -2e5, 1e5, "m/s", RESTFREQ=LINE), V, of_relativistic),
    "capitals": (third("vrad", -200.0, 100.0, "KM/S", RESTFRQ=LINE), V, of_radio),
    "wavelength at rest": (
        third("VOPT", -2e5, 1e5, "m/s", RESTWAV=299792458 / LINE),
        V,
        of_optical,
    ),
    "log of frequencies": (
        third("FREQ-LOG", 1e12, 1e11, "Hz"),
        1e12 * np.exp(0.1 * STEPS_UP),
        of_frequency,
    ),
    "log of wavelengths": (
        third("WAVE-LOG", 500.0, 5.0, "nm"),
        5e-7 * np.exp(0.01 * STEPS_UP),
        of_wavelength,
    ),
    "LAMBDA": (third("LAMBDA", 5000.0, 2.0, "ANGSTROM"), 5e-7 + 2e-10 * STEPS_UP, of_wavelength),
    "LINEAR": (third("LINEAR", 5000.0, 2.0, "Angstrom"), 5e-7 + 2e-10 * STEPS_UP, of_wavelength),
    "energies": (third("ENER", 0.5, 0.1, "keV"), (0.5 + 0.1 * STEPS_UP) * SI["keV"], of_energy),
    "eROSITA": (third("", 0.5, 0.1, "keV"), (0.5 + 0.1 * STEPS_UP) * SI["keV"], of_energy),
    "falling": (third("FREQ", LINE, -1e7, "HERTZ"), LINE - 1e7 * STEPS_UP, of_frequency),
    "CD cards": (
        header(
            {k: v for k, v in SKY.items() if not k.startswith("CDELT")},
            {"CD1_1": -0.01, "CD2_2": 0.01},
            {"CTYPE3": "VRAD", "CRVAL3": -2e5, "CDELT3": 1e5, "CRPIX3": 1.0, "RESTFRQ": LINE},
        ),
        V,
        of_radio,
    ),
    "PC cards": (third("VRAD", -2e5, 5e4, "m/s", PC3_3=2.0, RESTFRQ=LINE), V, of_radio),
    "old PC": (third("VRAD", -2e5, 5e4, "m/s", PC003003=2.0, RESTFRQ=LINE), V, of_radio),
}


@pytest.mark.parametrize("name", IN_THE_WILD)
def test_pictures_and_volumes_read_a_header_alike(tmp_path, name):
    cards, values, to_hertz = IN_THE_WILD[name]
    cards["BUNIT"], cards["CUNIT1"], cards["CUNIT2"] = "JY/BEAM", "DEGREE", "degrees"
    cards["BMAJ"], cards["BMIN"] = 0.02, 0.01
    data = numbers((6, 7, 8))
    path = written(tmp_path / "cube.fits", data, cards)
    cube = vm.Image.load(path)
    assert isinstance(cube, vm.Cube)
    np.testing.assert_array_equal(cube.intensity, np.moveaxis(data, 0, -1))
    assert (u.Unit(cube.intensity_unit), cube.unit) == (u.Jy / u.beam, "deg")
    np.testing.assert_allclose(cube.x, -0.01 * (np.arange(8) - 3), atol=1e-15)
    assert cube.wcs.has_celestial
    if values is None:  # even in frequency: dν = -ν₀ dv / c where v = 0
        expected = LINE * (1 - 1e5 / 299792458 * STEPS_UP)
    else:
        expected = to_hertz(values)
    if cube.spectral.rest is None:
        assert cube.spectral.kind in ("frequency", "wavelength")
    # wcslib's Planck constant and electronvolt are those of 1986: 9e-7 from today's.
    exact = 1e-6 if to_hertz is of_energy else 1e-9
    np.testing.assert_allclose(cube.spectral.frequencies, expected, rtol=exact)
    area = np.pi / (4 * np.log(2)) * np.deg2rad(0.02) * np.deg2rad(0.01)
    np.testing.assert_allclose(cube.to("Jy / sr").intensity, cube.intensity / area, rtol=1e-6)
    cube.save(tmp_path / "again.fits")
    again = vm.Image.load(tmp_path / "again.fits")
    assert (again.spectral, again.provenance) == (cube.spectral, cube.provenance)
    volume = vm.open(path)
    assert (volume.grid.shape, volume.units["intensity"]) == ((8, 7, 6), "Jy / beam")
    if values is not None and not name.startswith(("log", "falling")):
        field = next(f for f in volume.fields if f != "intensity")
        seen = volume.array(field)[0, 0] * SI[volume.units[field]]
        np.testing.assert_allclose(seen, values, rtol=1e-6, atol=1e-2 * np.abs(values).max() * 1e-4)


def test_wavelengths_in_air_become_those_in_vacuum(tmp_path):
    cube = vm.Image.load(
        written(tmp_path / "a.fits", numbers((6, 7, 8)), third("AWAV", 5000, 2, "Angstrom"))
    )
    # Refraction of air by Edlen (1953), at the wavenumber 2 / micron.
    index = 1 + 6.4328e-5 + 2.94981e-2 / (146 - 2**2) + 2.5540e-4 / (41 - 2**2)
    assert cube.spectral.kind == "wavelength"
    assert cube.spectral.wavelengths[0] == pytest.approx(0.5 * index, rel=1e-7)


@pytest.mark.parametrize(
    ("cards", "message"),
    [
        (third("FELO-HEL", 0, 1e3, "m/s"), "rest"),
        (third("ZOPT", 0.1, 1e-3), "RESTFRQ"),
        (third("WAVE", 3.5, 1e-4, "log(Angstrom)"), "no known unit"),
        (third("WAVE", 3.5, 1e-4, **{"DC-FLAG": 1}), "logarithms"),
        (third("VRAD", 0, 1e3, CASAMBM=True), "BEAMS"),
    ],
)
def test_a_spectrum_that_cannot_be_read_is_refused(tmp_path, cards, message):
    path = written(tmp_path / "cube.fits", numbers((6, 7, 8)), cards)
    with pytest.raises(vm.FileFormatError, match=message):
        vm.Image.load(path)


def test_what_is_no_spectrum_and_a_damaged_sky_are_told(tmp_path):
    path = written(tmp_path / "a.fits", numbers((6, 7, 8)), third("FARDEPTH", -10, 5, "rad/m2"))
    with pytest.warns(UserWarning, match="FARDEPTH is no spectrum"):
        assert vm.Image.load(path).channels == 6
    wrong = header(SKY, CTYPE1="RA---XYZ", CTYPE2="DEC--XYZ")
    with pytest.warns(UserWarning, match="world coordinates cannot be used"):
        assert vm.Image.load(written(tmp_path / "b.fits", numbers((7, 8)), wrong)).wcs is None


def test_axes_of_a_cube_may_come_in_any_order(tmp_path):
    data = numbers((6, 7, 8))
    usual = vm.Image.load(written(tmp_path / "a.fits", data, header(SKY, VELOCITY)))
    for name, axes in (("velocity first", (1, 2, 0)), ("latitude first", (0, 2, 1))):
        path = written(tmp_path / f"{name}.fits", data.transpose(axes), HEADERS[name])
        cube = vm.Image.load(path)
        np.testing.assert_array_equal(cube.intensity, usual.intensity)
        np.testing.assert_array_equal(cube.spectral.velocities, usual.spectral.velocities)
        np.testing.assert_array_equal(cube.x, usual.x)
        assert cube.wcs.wcs.crval[0] == 51.3


@pytest.mark.parametrize("name", ["cube.fits.gz", "cube.fits.fz"])
def test_packed_pictures(tmp_path, name):
    data = numbers((6, 7, 8))
    cards = header(SKY, VELOCITY, BUNIT="K (Ta*)")
    if name.endswith("fz"):
        hdu = fits.CompImageHDU(data, cards, compression_type="GZIP_1", quantize_level=0)
        fits.HDUList([fits.PrimaryHDU(), hdu]).writeto(tmp_path / name)
    else:
        written(tmp_path / name, data, cards)
    cube = vm.Image.load(tmp_path / name)
    np.testing.assert_array_equal(cube.intensity, np.moveaxis(data, 0, -1))
    assert (cube.intensity_unit, cube.spectral.kind) == ("K", "velocity")
    assert vm.open(tmp_path / name).units["intensity"] == "K"


def test_each_plane_keeps_the_beam_that_casa_gives_it(tmp_path):
    data, major = np.abs(numbers((4, 7, 8))), np.array([3.0, 3.5, 4.0, 5.0])
    columns = [
        fits.Column(name, kind, unit=unit, array=values[::-1])  # in any order
        for name, kind, unit, values in (
            ("BMAJ", "D", "arcsec", major),
            ("BMIN", "D", "arcsec", np.full(4, 2.0)),
            ("BPA", "D", "deg", np.full(4, 10.0)),
            ("CHAN", "J", "", np.arange(4)),
            ("POL", "J", "", np.zeros(4)),
        )
    ]
    cards = third("FREQ", LINE, 1e9, "Hz", CASAMBM=True, BUNIT="Jy/beam", RESTFRQ=LINE)
    table = fits.BinTableHDU.from_columns(columns, name="BEAMS")
    fits.HDUList([fits.PrimaryHDU(data, cards), table]).writeto(tmp_path / "casa.fits")
    cube = vm.Image.load(tmp_path / "casa.fits")
    areas = np.pi / (4 * np.log(2)) * np.deg2rad(major / 3600) * np.deg2rad(2 / 3600)
    planes = np.moveaxis(data, 0, -1)
    np.testing.assert_allclose(cube.to("Jy / sr").intensity, planes / areas, rtol=1e-6)
    nu = LINE + 1e9 * np.arange(4)
    kelvin = planes / areas * 1e-26 * 299792458**2 / (2 * 1.380649e-23 * nu**2)
    np.testing.assert_allclose(cube.to("K").intensity, kelvin, rtol=1e-6)
    pixel = np.deg2rad(0.01) ** 2
    np.testing.assert_allclose(cube.total().flux, data.sum((1, 2)) / areas * pixel, rtol=1e-6)
    cube.save(tmp_path / "again.fits")
    assert vm.Image.load(tmp_path / "again.fits").provenance == cube.provenance
    with pytest.raises(vm.InputError, match="a beam for each channel"):
        cube.convolve(10 * u.arcsec)
    with pytest.raises(vm.UnitsError, match="per beam needs to know which"):
        cube.channel_maps(2).to("K")  # of planes with several beams


def test_beams_of_plain_images_and_of_aips(tmp_path):
    cards = header(SKY, BUNIT="JY/BEAM", BMAJ=0.02, BMIN=0.01)
    one = vm.Image.load(written(tmp_path / "a.fits", numbers((7, 8)), cards))
    cards = header(SKY, BUNIT="JY/BEAM")
    cards["HISTORY"] = "AIPS   CLEAN BMAJ=  2.0000E-02 BMIN=  1.0000E-02 BPA=   0.00"
    two = vm.Image.load(written(tmp_path / "b.fits", numbers((7, 8)), cards))
    area = np.pi / (4 * np.log(2)) * np.deg2rad(0.02) * np.deg2rad(0.01)
    for image in (one, two):
        np.testing.assert_allclose(
            image.to("Jy / sr").intensity[..., 0], numbers((7, 8)) / area, rtol=1e-6
        )


def test_images_of_casa_are_pictures_too(tmp_path, monkeypatch):
    class Table:
        """python-casacore's image, of which only the export is used."""

        def __init__(self, path):
            assert path.endswith("a.image")

        def tofits(self, path, velocity):
            written(path, numbers((6, 7, 8)), header(SKY, VELOCITY))

    casacore = types.ModuleType("casacore.images")
    casacore.image = Table
    monkeypatch.setitem(sys.modules, "casacore", types.ModuleType("casacore"))
    monkeypatch.setitem(sys.modules, "casacore.images", casacore)
    folder = tmp_path / "a.image"
    folder.mkdir()
    (folder / "table.dat").write_bytes(b"\0")
    (folder / "table.info").write_text("Type = Image\nSubType = \n")
    assert vm.Image.load(folder).spectral.kind == "velocity"
    assert vm.open(folder).units["velocity"] == "km / s"


def test_l1448_as_a_cube(l1448):
    cube, volume = vm.Image.load(l1448), vm.open(l1448)
    np.testing.assert_array_equal(cube.intensity.transpose(1, 0, 2), volume.array("intensity"))
    np.testing.assert_allclose(
        cube.spectral.velocities, volume.array("velocity")[0, 0], rtol=0, atol=1e-6
    )
