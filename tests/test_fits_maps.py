"""Pictures on the sky: FITS headers and beams, against spherical trigonometry and closed forms."""

import numpy as np
import pytest
from astropy import units as u
from astropy.coordinates import SkyCoord
from astropy.io import fits

import voluminous as vm
from voluminous.errors import InputError, UnitsError
from voluminous.image.conversion import fits_beam
from voluminous.image.scales import quantity_name

HERE = SkyCoord(83.8, -5.4, unit="deg")


def plane(values=None, nx=41, ny=31, step=(2.0, 2.0), unit="au", **known):
    values = np.zeros((ny, nx)) if values is None else values
    ny, nx = values.shape[:2]
    x, y = ((np.arange(n) - 0.5 * (n - 1)) * s for n, s in zip((nx, ny), step, strict=True))
    return vm.Image(values, x=x, y=y, unit=unit, **{"intensity_unit": "Jy / sr", **known})


def spot(nx=41, ny=31, **known):
    values = np.zeros((ny, nx))
    values[ny // 2, nx // 2] = 1.0
    return plane(values, **known)


@pytest.mark.parametrize("angle", [0.0, 37.0, -120.0])
@pytest.mark.parametrize("step", [(1e5, 1e5), (5e4, 2e5)])
def test_places_on_the_plane_are_seen_where_trigonometry_says(angle, step):
    # A plane at a distance: the angle from its middle is atan(r / d), its direction that on it.
    image = plane(step=step).on_sky(distance=140 * u.pc, position=HERE, posang=angle)
    columns, rows = np.array([3, 20, 40, 11]), np.array([29, 15, 0, 7])
    x, y = image.x[columns] * u.au, image.y[rows] * u.au
    expected = HERE.directional_offset_by(
        angle * u.deg + np.arctan2(-x, y), np.arctan(np.hypot(x, y) / (140 * u.pc))
    )
    found = image.wcs.pixel_to_world(columns, rows)
    assert found.separation(expected).to_value("arcsec").max() < 1e-6  # rounding of degrees


@pytest.mark.parametrize(("projection", "kind"), [("flat", "TAN"), ("spherical", "ARC")])
def test_perspective_pictures_are_measured_in_angles(projection, kind):
    camera = vm.Perspective((0, -9, 0), (0, 0, 0), 60, projection=projection, resolution=(41, 21))
    frame = camera.frame(vm.CartesianGrid.uniform(2, (-1, 1)))
    x, y = frame.coordinates()
    image = vm.Image(np.ones((21, 41)), x=x, y=y, unit="rad", camera=camera.describe())
    sky = image.on_sky(position=HERE)
    assert sky.wcs.wcs.ctype[0] == f"RA---{kind}"
    off = np.hypot(x[3], y[17])
    angle = np.arctan(off) if projection == "flat" else off
    found = sky.wcs.pixel_to_world(3, 17).separation(HERE).rad
    assert found == pytest.approx(angle, rel=1e-9)
    with pytest.raises(InputError, match="leave distance"):
        image.on_sky(distance=3 * u.pc, position=HERE)


def test_files_keep_sky_plane_and_camera(tmp_path):
    image = plane(np.random.default_rng(1).random((4, 6)), camera={"type": "orthographic"})
    image.save(tmp_path / "a.fits", distance=140 * u.pc, position=HERE, posang=20)
    again = vm.Image.load(tmp_path / "a.fits")
    assert np.array_equal(again.intensity, image.intensity)
    assert np.array_equal(again.x, image.x)
    assert (again.unit, again.camera) == (image.unit, image.camera)
    assert again.wcs.pixel_to_world(2.5, 1.5).separation(HERE).arcsec < 1e-6
    assert fits.getheader(tmp_path / "a.fits")["BUNIT"] == "Jy sr-1"


@pytest.mark.parametrize("step", [(2.0, 2.0), (1.0, 3.0)])
@pytest.mark.parametrize("beam", [(12.0, 12.0, 0.0), (20.0, 9.0, 25.0)])
def test_a_point_becomes_the_beam(step, beam):
    image = spot(101, 81, step=step).convolve((beam[0] * u.au, beam[1] * u.au, beam[2]))
    major, minor, angle = beam
    x, y = np.meshgrid(image.x, image.y)
    turned = np.deg2rad(angle)  # from up to the left
    along = y * np.cos(turned) - x * np.sin(turned)
    across = x * np.cos(turned) + y * np.sin(turned)
    expected = np.exp(-4 * np.log(2) * ((along / major) ** 2 + (across / minor) ** 2))
    expected *= 4 * np.log(2) / np.pi / (major * minor) * step[0] * step[1]
    # A mean over pixels that are at most 0.8 standard deviations wide, in place of their middle:
    # (0.8)² / 24 = 3 % of the peak.
    found = image.intensity[..., 0]
    assert np.abs(found - expected).max() < 0.03 * expected.max()
    assert found.sum() == pytest.approx(1.0, abs=1e-6)
    assert found.min() >= 0


def test_beams_on_the_plane_and_on_the_sky_are_the_same():
    image = spot().on_sky(distance=140 * u.pc, position=HERE, posang=70)
    on_sky = image.convolve((0.15 * u.arcsec, 0.1 * u.arcsec, 80))
    on_plane = image.convolve(((21 * u.au), 14 * u.au, 10))  # up is at 70 degrees
    assert on_sky.intensity == pytest.approx(on_plane.intensity, abs=1e-12)
    for found in (on_sky, on_plane):
        assert np.array(fits_beam(found)) * (3600, 3600, 1) == pytest.approx((0.15, 0.1, 80))
        header = found.to_hdu().header
        assert header["BMAJ"] * 3600 == pytest.approx(0.15)


def test_measured_columns_are_convolved_and_means_are_not():
    grid = vm.CartesianGrid.uniform(8, (-1, 1), unit="pc")
    volume = vm.Volume(grid, rho=np.arange(512.0).reshape(8, 8, 8), velocity_x=np.ones((8, 8, 8)))
    volume["velocity_y"] = volume["velocity_z"] = volume["velocity_x"]
    camera = vm.Orthographic(20, 30, resolution=24)
    lines = vm.moments(volume, "rho", camera, velocity="velocity")
    seen = vm.measure(volume, "rho", camera=camera, maps=True).maps["rho"]
    for column in (vm.column(volume, "rho", camera), lines.column, seen):
        smooth = column.convolve(0.3 * u.pc)
        # The kernel keeps the sum but for what is spread over the edges.
        assert smooth.intensity.sum() == pytest.approx(column.intensity.sum(), rel=0.02)
    mean = vm.column(volume, "rho", camera, weight="rho")
    for other in (mean, lines.mean, vm.project(volume, "rho", camera)):
        with pytest.raises(InputError, match="cannot be convolved"):
            other.convolve(0.3 * u.pc)
    assert [quantity_name(image) for image in (seen, mean, lines.column)] == [
        "column of rho",
        "mean of rho",
        "column, rho",
    ]


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"position": HERE}, InputError, "distance="),
        ({"distance": 3 * u.pc}, InputError, "position="),
        ({"distance": -3 * u.pc, "position": HERE}, InputError, "positive"),
        ({"distance": 3 * u.pc, "position": "nowhere"}, InputError, "SkyCoord"),
        ({"distance": 3 * u.pc, "position": (1, 2, 3)}, InputError, "SkyCoord"),
        ({"posang": 30}, InputError, "distance=.* and position="),
    ],
)
def test_places_that_cannot_be(options, error, message):
    with pytest.raises(error, match=message):
        plane().to_hdu(**options)


@pytest.mark.parametrize(
    ("known", "unit", "beam", "message"),
    [
        ({"intensity_unit": ""}, "Jy/beam", 1 * u.arcsec, "have no unit"),
        ({"intensity_unit": "g / cm2"}, "Jy/beam", 1 * u.arcsec, "cannot be converted"),
        ({}, "Jy/beam", None, "give beam="),
        ({}, "Jy/beam", 4 * u.au, "on_sky"),
        ({}, "no unit", None, "not a unit"),
    ],
)
def test_units_that_cannot_be(known, unit, beam, message):
    with pytest.raises(UnitsError, match=message):
        spot(**known).to(unit, beam=beam)
