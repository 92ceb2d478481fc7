"""Cubes: closed forms of moments, fluxes, temperatures and cuts, and files of other programs."""

import tracemalloc
import warnings

import numpy as np
import pytest
from astropy import constants
from astropy import units as u
from astropy.io import fits
from astropy.wcs import WCS

import voluminous as vm
from voluminous.errors import InputError, UnitsError
from voluminous.image import SpectralAxis
from voluminous.image.conversion import fits_beam

CO = 230.538 * u.GHz
# A Gaussian spot on the plane (au) and a Gaussian line that shifts across it (km/s).
SIDE, SPOT, WIDTH, SHEAR = 10.0, 60.0, 0.6, 0.01


def gaussian(nx=41, ny=31, axis=None, dtype=np.float64, **known):
    axis = vm.channels(-6, 6, 61, line="CO 2-1", rest=CO) if axis is None else axis
    x, y = ((np.arange(n) - 0.5 * (n - 1)) * SIDE for n in (nx, ny))
    spot = np.exp(-0.5 * (x**2 + y[:, None] ** 2) / SPOT**2)
    line = np.exp(-0.5 * ((axis.velocities - SHEAR * x[:, None]) / WIDTH) ** 2)
    known = {"intensity_unit": "Jy / sr", "distance": 100 * u.pc, **known}
    values = (spot[..., None] * line).astype(dtype)
    return vm.Cube(values, spectral=axis, x=x, y=y, unit="au", **known)


# The axis.


def test_channels_are_those_of_radio_astronomy():
    axis = vm.channels(-5 * u.km / u.s, 5000 * u.m / u.s, 40, line="CO 2-1", rest=CO)
    # RADMC-3D's: nu_i = nu0 (1 - (2 i / (n - 1) - 1) w / c), from blue to red.
    i = np.arange(40)
    expected = 230.538e9 * (1 - (2 * i / 39 - 1) * 5e5 / 2.99792458e10)
    assert axis.frequencies == pytest.approx(expected, rel=1e-15)  # rounding
    assert axis.velocities[[0, -1]].tolist() == [-5, 5]
    radio = (axis.frequencies * u.Hz).to(u.km / u.s, u.doppler_radio(CO)).value
    assert axis.velocities == pytest.approx(radio, abs=1e-9)  # rounding of 1 - v / c
    assert vm.channels(1, 3, 1, rest=CO).velocities.tolist() == [2]


def test_an_axis_in_one_kind_is_the_same_in_the_others():
    axis = vm.channels(-20, 30, 7, rest=CO)
    for kind, unit in (("frequency", "Hz"), ("wavelength", "micron")):
        other = SpectralAxis(axis.places(kind), unit, rest=CO)
        assert other.kind == kind
        assert other.velocities == pytest.approx(axis.velocities, abs=1e-9)
    assert SpectralAxis([0.87, 1.3] * u.mm).wavelengths == pytest.approx([870, 1300], rel=1e-15)
    assert SpectralAxis([1.0], rest=1.3 * u.mm).rest == pytest.approx(230.6096e9, rel=1e-6)
    assert SpectralAxis(**axis.describe()) == axis


@pytest.mark.parametrize(
    ("values", "options", "message"),
    [
        ([1.0, np.nan], {}, "one finite number"),
        ([0.0], {}, "are positive"),
        ([3e5], {"unit": "km / s"}, "below that of light"),
        ([1.0], {"unit": "K"}, "unit K"),
        ([1.0], {"rest": -1.0}, "positive frequency"),
    ],
)
def test_axes_that_cannot_be(values, options, message):
    with pytest.raises(InputError, match=message):
        SpectralAxis(values, **options)


def test_velocities_without_a_rest_frequency_are_no_frequencies():
    cube = gaussian(axis=None).replace(spectral=vm.channels(-6, 6, 61, line="CO 2-1"))
    with pytest.raises(InputError, match="the line CO 2-1"):
        cube.to("K")
    assert cube.at_rest(CO).to("K").intensity_unit == "K"


def test_a_cube_stays_one():
    cube = gaussian()
    same = cube.replace(camera={"type": "orthographic"}).to("mJy / sr").to("arcsec")
    assert isinstance(same, vm.Cube)
    assert (same.spectral, same.distance) == (cube.spectral, cube.distance)
    assert same.x == pytest.approx(cube.x / 100, rel=1e-12)
    assert same.to("au").x == pytest.approx(cube.x, rel=1e-12)
    with pytest.raises(InputError, match="61 places"):
        vm.Cube(np.ones((3, 4, 2)), spectral=cube.spectral)


# Units.


def test_a_jansky_per_beam_is_so_many_kelvin():
    cube = gaussian().replace(intensity_unit="Jy / beam")
    kelvin = cube.to("K", beam=1 * u.arcsec)
    nu = cube.spectral.frequencies * u.Hz
    area = np.pi / (4 * np.log(2)) * u.arcsec**2
    jy = (1 * u.Jy / area).to(u.erg / u.s / u.cm**2 / u.Hz / u.sr, u.dimensionless_angles())
    factor = (jy.value * u.erg / u.cm**2 * constants.c**2 / (2 * constants.k_B * nu**2)).to_value(
        u.K
    )
    assert kelvin.intensity == pytest.approx(cube.intensity * factor, rel=1e-12)
    # The rule of thumb has four digits: 1.222e6 / (GHz² arcsec²).
    assert factor[30] == pytest.approx(1.222e6 / 230.538**2, rel=3e-4)
    again = kelvin.to("Jy / beam", beam=1 * u.arcsec)
    assert again.intensity == pytest.approx(cube.intensity, rel=1e-12)


def test_pixels_of_a_distant_plane_are_solid_angles():
    cube = gaussian()
    pixel = (0.1 * u.arcsec.to("rad")) ** 2  # 10 au at 100 pc
    assert cube.to("mJy / pixel").intensity == pytest.approx(1e3 * pixel * cube.intensity, rel=1e-9)
    beam = 2 * np.pi * 0.5 * 0.3 * u.arcsec.to("rad") ** 2 / (8 * np.log(2))
    smooth = cube.convolve((0.5 * u.arcsec, 0.3 * u.arcsec, 20))
    assert smooth.to("Jy / beam").intensity == pytest.approx(beam * smooth.intensity, rel=1e-9)
    assert np.array(fits_beam(smooth)) * (3600, 3600, 1) == pytest.approx((0.5, 0.3, 20))
    with pytest.raises(UnitsError, match="how far the image is"):
        cube.replace(distance=None).to("Jy / pix")
    with pytest.raises(UnitsError, match=r"vm\.Cube"):
        vm.Image(np.ones((2, 2)), intensity_unit="Jy / sr").to("K")


def test_a_beam_turns_with_the_plane():
    smooth = gaussian().convolve((0.5 * u.arcsec, 0.3 * u.arcsec, 20))
    turned = smooth.on_sky(position=(30, 10), posang=25)
    assert np.array(fits_beam(turned)) * (3600, 3600, 1) == pytest.approx((0.5, 0.3, 45))
    per_beam = smooth.to("Jy / beam").intensity
    for other in (turned, smooth.to("K"), smooth.to("arcsec"), smooth.to("arcsec").to("pc")):
        assert other.to("Jy / beam").intensity == pytest.approx(per_beam, rel=1e-6)


def test_errors_and_tiny_intensities_are_converted():
    cube = gaussian(dtype=np.float32)
    tiny = cube.replace(
        intensity=cube.intensity * np.float32(1e-36), error=np.full((31, 41), 1e-38)
    )
    small = tiny.to("erg / (s cm2 Hz sr)")  # 1e-59: single precision underflows
    assert small.intensity.dtype == np.float64
    assert small.intensity.max() == pytest.approx(1e-59, rel=1e-6)
    kelvin = tiny.to("K")
    # 1 % of the maximum stays 1 %.
    assert kelvin.error.max() == pytest.approx(0.01 * kelvin.intensity.max(), rel=1e-6)


# Moments and fluxes. Sums over channels of a Gaussian with Δv = σ / 3 are exact to rounding; the
# tails beyond the band, at least 6 σ away, are 2e-8 of it.


@pytest.mark.parametrize("kind", ["velocity", "frequency", "wavelength"])
def test_moments_of_a_gaussian_line(kind):
    cube = gaussian()
    if kind != "velocity":
        unit = {"frequency": "Hz", "wavelength": "micron"}[kind]
        axis = SpectralAxis(cube.spectral.places(kind), unit, rest=CO)
        cube = cube.replace(spectral=axis)
    area, mean, width = (cube.moment(k) for k in range(3))
    spot = np.exp(-0.5 * (cube.x**2 + cube.y[:, None] ** 2) / SPOT**2)
    expected = spot * WIDTH * np.sqrt(2 * np.pi)
    assert area.intensity[..., 0] == pytest.approx(expected, rel=1e-6)
    assert mean.intensity[..., 0] == pytest.approx(
        np.broadcast_to(SHEAR * cube.x, spot.shape), abs=1e-6
    )
    assert width.intensity == pytest.approx(WIDTH, abs=1e-5)
    assert (area.intensity_unit, mean.intensity_unit) == ("Jy km / (s sr)", "km / s")
    assert area.distance == cube.distance
    assert not isinstance(area, vm.Cube)


def test_a_threshold_masks_channels_and_nothing_is_nan():
    cube = gaussian()
    values = cube.intensity.copy()
    values[0, 0] = 0.0
    values[1, 1, :] = np.nan
    holes = cube.replace(intensity=values)
    assert holes.moment(0).intensity[0, 0, 0] == 0.0
    assert np.isnan(holes.moment(0).intensity[1, 1, 0])
    assert np.isnan(holes.moment(1).intensity[[0, 1], [0, 1], 0]).all()
    mask = cube.intensity >= 0.5
    step = 0.2
    area = cube.moment(0, threshold=500 * u.mJy / u.sr).intensity[..., 0]
    expected = np.where(mask.any(axis=-1), (cube.intensity * mask).sum(axis=-1) * step, np.nan)
    assert area == pytest.approx(expected, rel=1e-12, nan_ok=True)


def test_uneven_channels_have_widths_of_their_own():
    v = np.sinh(np.linspace(-2.5, 2.5, 301))
    cube = gaussian(axis=SpectralAxis(v, "km / s", rest=CO))
    area = cube.moment(0).intensity[15, 20, 0]
    assert area == pytest.approx(WIDTH * np.sqrt(2 * np.pi), rel=1e-3)  # midpoint rule, uneven
    with pytest.raises(InputError, match="two channels or more"):
        cube.replace(intensity=cube.intensity[..., :1], spectral=vm.channels(0, 0, 1)).moment(0)


def test_the_flux_of_a_cube_is_that_of_its_moment():
    cube = gaussian()
    spectrum = cube.total()
    area = cube.moment(0).to("Jy km / (s pix)")
    assert spectrum.flux.sum() * 0.2 == pytest.approx(area.intensity.sum(), rel=1e-12)
    for other in (cube.to("K"), cube.to("mJy / pixel")):
        assert other.total().flux == pytest.approx(spectrum.flux, rel=1e-12)
    smooth = cube.convolve(0.3 * u.arcsec).to("Jy/beam")
    # The beam carries a little of the spot over the edges, 2.6 σ away.
    assert smooth.total().flux[30] == pytest.approx(spectrum.flux[30], rel=5e-3)


def test_the_spectrum_of_a_pixel():
    cube = gaussian()
    for place in ((50, -20), (0.5 * u.arcsec, -0.2 * u.arcsec), (50 * u.au, "-20 au")):
        assert np.array_equal(cube.spectrum_at(*place).flux, cube.intensity[13, 25])
    assert np.array_equal(cube.spectrum_at(25, 13, pixel=True).flux, cube.intensity[13, 25])
    for x, options in ((500, {}), (41, {"pixel": True}), (0.5, {"pixel": True})):
        with pytest.raises(InputError, match="no pixel"):
            cube.spectrum_at(x, 0, **options)


def test_a_continuum_is_subtracted():
    cube = gaussian()
    v = cube.spectral.velocities
    for order, continuum in ((0, 3.0 + 0 * v), (1, 3.0 + 0.1 * v)):
        both = cube.replace(intensity=cube.intensity + continuum)
        free = [slice(0, 12), slice(49, None)]  # the line reaches 3 km/s, at 0.01 of its peak
        line = both.subtract_continuum(free, order=order)
        assert line.intensity == pytest.approx(cube.intensity, abs=5e-3)
        flat = both.replace(intensity=np.broadcast_to(continuum, cube.shape))
        assert flat.subtract_continuum(np.abs(v) > 4, order=order).intensity == pytest.approx(
            0, abs=1e-12
        )
    with pytest.raises(InputError, match="more channels"):
        cube.subtract_continuum([3], order=1)
    with pytest.raises(InputError, match="slices, a mask or numbers"):
        cube.subtract_continuum("all")


def test_channel_maps_are_means():
    cube = gaussian()
    maps = cube.channel_maps(20)
    assert maps.channels == 20
    assert maps.intensity[..., 7] == pytest.approx(cube.intensity[..., 21:24].mean(axis=-1))
    assert maps.spectral.velocities[7] == pytest.approx(cube.spectral.velocities[22])
    assert maps.spectral.rest == cube.spectral.rest
    assert cube.channel_maps(61) is cube


def test_plots_have_a_panel_for_each_channel():
    cube = gaussian().convolve(0.5 * u.arcsec)
    panels = cube.channel_maps(6).plot(scale_bar=True)
    assert [panel.texts[0].get_text() for panel in panels[::5]] == ["−4.6 km/s", "+4.4 km/s"]
    assert len({panel.images[0].norm for panel in panels}) == 1
    assert panels[3].get_xlabel() == "x [″]"
    assert cube.plot(channels=3).images[0].get_array().shape == (31, 41)
    assert len(vm.plot_row([cube, cube])) == 2  # in colours
    with pytest.raises(InputError, match="one axes for each"):
        cube.plot(ax=[panels[0]])


def test_what_recedes_is_red():
    cube = gaussian()
    left, right = cube.to_rgb()[15, [12, 28]]  # approaching and receding by 0.8 km/s
    assert left[2] > 2 * left[0]
    assert right == pytest.approx(left[::-1], abs=1e-6)
    total = cube.in_colors().intensity.sum(axis=(0, 1))
    assert total == pytest.approx(total.mean(), rel=1e-9)  # grey
    assert np.array_equal(cube.to_rgb(channels=30), vm.Image(cube.intensity[..., 30]).to_rgb())
    assert cube.to_rgb(exposure=cube.exposure) == pytest.approx(cube.to_rgb())
    left, right = cube.moment(1).to_rgb(vmin=-5, vmax=5)[15, [12, 28]]
    assert left[2] > left[0]
    assert right[0] > right[2]


# Cuts.


def test_a_cut_along_a_row_is_the_row():
    cube = gaussian()
    cut = cube.position_velocity((-205, 20), (205, 20))
    assert cut.intensity[..., 0] == pytest.approx(cube.intensity[17].T, abs=1e-12)
    assert list(cut.wcs.wcs.ctype) == ["OFFSET", "VRAD"]
    offset, velocity = cut.wcs.wcs_pix2world([[0, 0], [40, 60]], 0).T
    assert offset == pytest.approx([0.05, 4.05])  # arcsec from the edge: pixels of 0.1
    assert velocity == pytest.approx([-6000, 6000])
    back = cube.position_velocity((2.05 * u.arcsec, 20 * u.au), (-205, 20))
    assert back.intensity[:, ::-1] == pytest.approx(cut.intensity, abs=1e-9)


def test_a_slanted_cut_and_a_wide_one():
    cube = gaussian()
    cut = cube.position_velocity((-150, -100), (0, 0), (150, -100))
    offset = (np.arange(cut.shape[1]) + 0.5) * SIDE
    assert cut.shape[1] == 36
    along = np.abs(offset - np.hypot(150, 100))
    x = (offset - np.hypot(150, 100)) * 150 / np.hypot(150, 100)
    v = cube.spectral.velocities[:, None]
    expected = np.exp(-0.5 * along**2 / SPOT**2 - 0.5 * ((v - SHEAR * x) / WIDTH) ** 2)
    # Linear interpolation: (side / σ)² / 8 in each direction, and (shear side / σ)² / 8.
    assert cut.intensity[..., 0] == pytest.approx(expected, abs=0.012)
    wide = cube.position_velocity((-205, 0), (205, 0), width=310)
    assert wide.intensity[..., 0] == pytest.approx(
        cube.intensity.mean(axis=0).T, rel=0.02, abs=2e-3
    )
    outside = cube.position_velocity((0, 0), (400, 0))
    assert np.isnan(outside.intensity[:, -1]).all()
    for points in (((0, 0),), ((0, 0), (0, 0)), ((0, 0), (1, 0)), (3, 4)):
        with pytest.raises(InputError):
            cube.position_velocity(*points)


# Files.


@pytest.mark.parametrize("suffix", [".fits", ".npz", ".tif", ".exr"])
def test_files_keep_cubes(tmp_path, suffix):
    cube = gaussian(dtype=np.float32).convolve(0.5 * u.arcsec)
    cube.save(tmp_path / f"a{suffix}")
    again = vm.Image.load(tmp_path / f"a{suffix}")
    assert isinstance(again, vm.Cube)
    assert np.array_equal(again.intensity, cube.intensity)
    assert (again.spectral, again.distance, again.unit) == (cube.spectral, cube.distance, "au")
    assert again.moment(1).wcs is None


@pytest.mark.parametrize(
    ("axis", "kind", "unit"),
    [
        (vm.channels(-6, 6, 13, line="CO 2-1", rest=CO), "VRAD", "m/s"),
        (SpectralAxis(np.linspace(230.5, 230.6, 5), "GHz", rest=CO), "FREQ", "Hz"),
        (SpectralAxis(np.linspace(3, 1, 5), "mm"), "WAVE", "m"),
    ],
)
def test_other_programs_read_the_axes(tmp_path, axis, kind, unit):
    values = np.random.default_rng(3).random((5, 4, len(axis)))
    cube = vm.Cube(
        values, spectral=axis, unit="au", distance=140 * u.pc, intensity_unit="Jy / sr"
    ).convolve(0.01 * u.arcsec)
    cube.to("Jy / beam").save(tmp_path / "a.fits", position=(83.8, -5.4))
    with fits.open(tmp_path / "a.fits") as hdus:
        hdus.verify("exception")
        header, data = hdus[0].header, hdus[0].data
    assert data.shape == (len(axis), 5, 4)
    assert header["BUNIT"] == "Jy/beam"
    assert (header["CTYPE3"], header["CUNIT3"]) == (kind, unit)
    assert header["BMAJ"] * 3600 == pytest.approx(0.01)
    wcs = WCS(header)
    assert wcs.has_celestial
    seen = wcs.spectral.wcs_pix2world(np.arange(len(axis))[:, None], 0)[:, 0]
    factor = {"VRAD": 1e3, "FREQ": 1.0, "WAVE": 1e-6}[kind]
    assert seen == pytest.approx(factor * axis.places(axis.kind), rel=1e-12)
    if axis.rest is not None:
        assert wcs.wcs.restfrq == pytest.approx(axis.rest, rel=1e-12)
        assert header["SPECSYS"] == "SOURCE"
    volume = vm.open(tmp_path / "a.fits")
    assert volume.grid.shape == (4, 5, len(axis))
    name = "wavelength" if kind == "WAVE" else "velocity"
    third = np.unique(volume[name].to_value("um" if kind == "WAVE" else "km/s"))
    places = np.sort(axis.wavelengths if kind == "WAVE" else axis.velocities)
    assert third == pytest.approx(places, rel=1e-5, abs=1e-5)  # a field in single precision


def test_without_a_position_files_have_offsets(tmp_path):
    gaussian().save(tmp_path / "a.fits")
    wcs = WCS(fits.getheader(tmp_path / "a.fits"))
    ra, dec, v = wcs.wcs_pix2world([[30, 15, 60]], 0)[0]
    assert (ra, dec) == pytest.approx((360 - 1 / 3600, 0), abs=1e-12)
    assert v == pytest.approx(6000)
    assert vm.Image.load(tmp_path / "a.fits").wcs is None


def test_uneven_and_single_channels_in_files(tmp_path):
    values = np.random.default_rng(3).random((5, 4, 3))
    for some, places in ((slice(None), [3, 0.87, 1.3]), (slice(0, 1), [1.3])):
        cube = vm.Cube(values[..., some], spectral=places * u.mm, unit="au", distance=1 * u.kpc)
        cube.save(tmp_path / "a.fits")
        again = vm.Image.load(tmp_path / "a.fits")
        assert again.spectral == cube.spectral
        assert np.array_equal(again.intensity, cube.intensity)
    cube = vm.Cube(values, spectral=[0.87, 1.3, 3] * u.mm, unit="au", distance=1 * u.kpc)
    cube.save(tmp_path / "a.fits")
    with fits.open(tmp_path / "a.fits") as hdus:
        places = hdus["Z-axis coordinate values"].data.field(0)
        assert places == pytest.approx([870, 1300, 3000], rel=1e-15)
        assert hdus["Z-axis coordinate values"].columns[0].unit == "um"
        del hdus["SPECTRAL"], hdus[0].header["VOLMETA"]
        hdus.writeto(tmp_path / "skirt.fits")
    assert vm.Image.load(tmp_path / "skirt.fits").spectral.wavelengths.tolist() == [870, 1300, 3000]
    third = vm.open(tmp_path / "a.fits")["wavelength"]
    assert np.unique(third.to_value("um")) == pytest.approx([870, 1300, 3000])


def test_cards_that_were_edited_are_believed(tmp_path):
    gaussian().save(tmp_path / "a.fits")
    with fits.open(tmp_path / "a.fits", mode="update") as hdus:
        hdus[0].header["CRVAL3"] += 1000.0
        hdus[0].header["RESTFRQ"] = 220.4e9
    again = vm.Image.load(tmp_path / "a.fits")
    assert again.spectral.velocities == pytest.approx(np.linspace(-5, 7, 61))
    assert again.spectral.rest == 220.4e9


@pytest.mark.parametrize(
    ("kind", "unit", "value", "step"),
    [("FREQ", "Hz", 230.6e9, -2e6), ("VOPT", "m/s", -3000, 2000), ("VRAD", "km/s", -3, 2)],
)
def test_cubes_of_telescopes(tmp_path, kind, unit, value, step):
    axes = {"CTYPE1": "RA---SIN", "CTYPE2": "DEC--SIN", "CTYPE3": "STOKES", "CTYPE4": kind}
    header = fits.Header(axes)
    for k, (at, by) in enumerate(((10, -1e-4), (20, 1e-4), (1, 1), (value, step)), start=1):
        header[f"CRVAL{k}"], header[f"CDELT{k}"], header[f"CRPIX{k}"] = at, by, 1.0
    cards = {"CUNIT1": "deg", "CUNIT2": "deg", "CUNIT4": unit, "RESTFRQ": CO.to_value("Hz")}
    cards |= {"BUNIT": "Jy/beam", "BMAJ": 3e-4, "BMIN": 2e-4, "BPA": 10.0, "SPECSYS": "LSRK"}
    header.update(cards)
    data = np.random.default_rng(1).random((4, 1, 6, 5), dtype=np.float32)
    fits.writeto(tmp_path / "alma.fits", data, header)
    cube = vm.Image.load(tmp_path / "alma.fits")
    assert isinstance(cube, vm.Cube)
    assert np.array_equal(cube.intensity, np.moveaxis(data[:, 0], 0, -1))
    assert cube.spectral.frame == "LSRK"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        world = WCS(fits.getheader(tmp_path / "alma.fits")).spectral.pixel_to_world(np.arange(4))
    nu = world.to(
        u.Hz, doppler_rest=CO, doppler_convention="radio" if kind != "VOPT" else "optical"
    )
    assert cube.spectral.frequencies == pytest.approx(nu.value, rel=1e-9)
    area = np.pi / (4 * np.log(2)) * np.deg2rad(3e-4) * np.deg2rad(2e-4)
    assert cube.to("Jy / sr").intensity == pytest.approx(cube.intensity / area, rel=1e-6)


def test_velocities_of_telescopes_without_a_rest_frequency(tmp_path):
    header = fits.Header({"CTYPE1": "RA---SFL", "CTYPE2": "DEC--SFL", "CTYPE3": "VOPT"})
    for k, (at, by) in enumerate(((10, -1e-4), (20, 1e-4), (-2000, 500)), start=1):
        header[f"CRVAL{k}"], header[f"CDELT{k}"], header[f"CRPIX{k}"] = at, by, 1.0
    header["CUNIT3"] = "m/s"
    fits.writeto(tmp_path / "a.fits", np.ones((5, 3, 2)), header)
    cube = vm.Image.load(tmp_path / "a.fits")
    assert cube.spectral.velocities == pytest.approx([-2, -1.5, -1, -0.5, 0], abs=1e-12)
    assert cube.moment(1).intensity == pytest.approx(-1)


def test_images_of_radmc3d_are_cubes(tmp_path):
    values = np.random.default_rng(5).random((3, 4, 2))
    cube = vm.Cube(values, spectral=[870, 1300], unit="cm", intensity_unit="erg / (s cm2 Hz sr)")
    cube.save(tmp_path / "image.bout")
    again = vm.Image.load(tmp_path / "image.bout")
    assert isinstance(again, vm.Cube)
    assert np.array_equal(again.intensity, values)
    assert again.spectral.wavelengths.tolist() == [870, 1300]


def test_moments_and_files_hold_no_second_cube(tmp_path):
    axis = vm.channels(-6, 6, 400, rest=CO)
    cube = vm.Cube(np.ones((256, 256, 400), np.float32), spectral=axis, unit="au")
    vm.Cube(np.ones((2, 2, 400)), spectral=axis, unit="au").moment(2)  # imports
    vm.Cube(np.ones((2, 2, 2)), spectral=[1, 2]).save(tmp_path / "first.fits")  # imports
    tracemalloc.start()
    for work in (cube.moment, lambda _: cube.save(tmp_path / "a.fits")):
        tracemalloc.reset_peak()
        before = tracemalloc.get_traced_memory()[0]
        work(2)
        assert tracemalloc.get_traced_memory()[1] - before < 0.2 * cube.intensity.nbytes
    tracemalloc.stop()


def test_optical_depths_that_wait_are_not_drawn_for_a_file(tmp_path):
    cube = vm.Cube(np.ones((2, 3, 4)), spectral=[1, 2, 3, 4], optical_depth=lambda: 1 / 0)
    for suffix in (".fits", ".npz", ".exr"):
        cube.save(tmp_path / f"a{suffix}")
        assert vm.Image.load(tmp_path / f"a{suffix}").optical_depth is None


def test_a_beam_narrower_than_a_pixel_is_refused():
    """In both directions, whatever its unit; what is as wide as a pixel is drawn."""
    cube = gaussian()
    pixel = cube.pixel_size[0]
    for beam in (0.9 * pixel, (30 * pixel, 0.5 * pixel), 1e-5 * u.arcsec):
        with pytest.raises(vm.InputError, match=r"pixels wide.*resolution="):
            cube.convolve(beam)
    assert cube.convolve(pixel).provenance["beam"]["major"] == pytest.approx(pixel)


@pytest.mark.parametrize("length", ["100 au", 100 * u.au, 100.0, 1 * u.arcsec])
def test_a_scale_bar_of_a_given_length(length):
    """Of pictures, rows, and channel maps (in arcsec); angles follow from the distance."""
    cube = gaussian()
    drawn = [(cube.plot(channels=0, scale_bar=length), 100.0)]
    if isinstance(length, str):  # channel maps take a second
        drawn.append((cube.plot(scale_bar=length)[-1], 1.0))
        drawn.append((vm.plot_row([cube], scale_bar=length)[0], 100.0))
        for wrong, told in (("1e9 au", "length up to"), ("long", "such as '100 au'"), ("3 K", "K")):
            with pytest.raises(vm.VoluminousError, match=told):
                cube.plot(channels=0, scale_bar=wrong)
    for axes, long in drawn:
        (bar,) = axes.findobj(lambda artist: artist.get_gid() == "scale-bar")
        assert np.ptp(bar.get_xdata()) == pytest.approx(long)


@pytest.mark.parametrize(
    ("use", "told"),
    [
        (lambda cube: cube.total(beam=1 * u.arcsec), "per beam"),
        (lambda cube: cube.to("K", beam=1 * u.arcsec), "per beam"),
        (lambda cube: cube.moment(True), "0, 1 or 2"),
        (lambda cube: cube.moment(1.5), "0, 1 or 2"),
        (lambda cube: cube.position_velocity((0, 0), (500, 0), width=[1, 2]), "one number"),
        (lambda cube: cube.position_velocity((0, 0), (500, 0), width=1e9), "at most"),
        (lambda cube: cube.position_velocity((1e6, 0), (1e6 + 100, 0)), "does not meet"),
        (lambda cube: cube.spectrum_at([0, 1], 0), "one number"),
        (lambda cube: cube.spectrum_at("one", 0, pixel=True), "x must be"),
    ],
)
def test_arguments_are_obeyed_or_refused(use, told):
    with pytest.raises(vm.VoluminousError, match=told):
        use(gaussian())
