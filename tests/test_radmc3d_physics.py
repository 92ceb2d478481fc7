"""Against images and spectra of the real RADMC-3D: dust, lines, free-free emission and stars.

Each reference is drawn from the model's own files by RADMC-3D's own words. Where RADMC-3D has a
defect that is not copied, the case is in one of the lists below, which say what is compared.
"""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from astropy import units as u

import radmc3d_cases
import voluminous as vm
from radmc3d_cases import case_of, reference_of, stored_model, write_model, write_settings
from reference import data_directory
from voluminous.backend import dr
from voluminous.cli import main
from voluminous.observing.cubes import at_frequencies, bands_of
from voluminous.physics.constants import CODATA, RADMC3D
from voluminous.radmc3d.olson_kunasz import OlsonKunasz
from voluminous.radmc3d.session import Session, drawn
from voluminous.radmc3d.words import request_of
from voluminous.rendering.partition import Partition
from voluminous.schemes.base import Solution, TowardsObserver
from voluminous.schemes.first_order import FirstOrder

# Cases that are drawn whenever the tests run, one or two of each kind; all others are exhaustive.
QUICK = {
    "dust_cart": ("first_face_stars", "second_obl", "second_tau", "local_proj2", "first_tausurf1"),
    "dust_octree": ("first_fluxcons", "second_obl"),
    "dust_spher2d": ("second_obl2",),
    "dust_spher3d": ("first_obl", "local_inside"),
    "external": ("first_obl", "spec_obl"),
    "extras_partition": ("first",),
    "freefree": ("first_ff_dust",),
    "line_cart": ("first_co21", "second_co21", "catch_co21", "first_lambdas"),
    "line_octree": ("second_co21",),
    "line_spher3d": ("first_obl2",),
    "spectra_cart": ("first_co21",),
    "spectra_spher2d": ("nostar", "circ_sed"),
    "star_table": ("first",),
}
# A ray from a star within a cell begins with j = α = 0 in second order (SPEC.md, 14.3); a star's
# place in the picture does not depend on posang, nor on a local observer's projection (14.14). All
# pixels but those of stars are compared.
STAR_ELSEWHERE = {
    ("dust_cart", "second_face_stars"),
    ("dust_cart", "second_obl_stars"),
    ("dust_cart", "first_posang_stars"),
    ("dust_cart", "local_proj1"),
    ("dust_octree", "second_obl"),
    ("external", "second_obl"),
    ("external", "local"),
    ("star_table", "second"),
}


def cases(*quantities: str) -> list:
    """Return a parameter for each case of these quantities; the longer ones are exhaustive."""
    chosen = []
    for name in radmc3d_cases.MODELS:
        path = data_directory() / "radmc3d_physics" / f"{name}.npz"
        if not path.is_file():
            continue
        meta = json.loads(str(np.load(path)["meta"]))
        for case in meta["cases"]:
            if case["quantity"] not in quantities:
                continue
            marks = () if case["id"] in QUICK[name] else pytest.mark.exhaustive
            chosen.append(pytest.param(name, case["id"], marks=marks, id=f"{name}-{case['id']}"))
    skip = pytest.mark.skip(reason="no radmc3d_physics; set VOLUMINOUS_TEST_DATA")
    return chosen or [pytest.param("", "", marks=skip, id="no data")]


class SmallDepths(FirstOrder):
    """First order with RADMC-3D's branch: 1 - exp(-τ) is τ up to τ = 1e-4, and wrong by τ²/2."""

    def solve(self, segment, source, carried):
        solution, carried = super().solve(segment, source, carried)
        j, _ = source.at(segment)
        depth = solution.depth
        emission = []
        for c, (jc, b) in enumerate(zip(j, solution.emission, strict=True)):
            tau = depth[c if len(depth) > 1 else 0]
            emission.append(dr.select(tau > 1e-4, b, jc * segment.length))
        return Solution(emission, solution.transparency, depth), carried


class LinesLostAtEntry(OlsonKunasz):
    """Doppler catching with RADMC-3D's defect (SPEC.md, 14.1), to compare all else with it.

    Where a ray enters the grid its lines do not emit or absorb; where it enters again, behind an
    inner cavity, they do as at the point where it left. What is carried is the state of the gas,
    and the coefficients of the lines at the end of the segment before.
    """

    def start(self, position, source):
        state = super().start(position, source)
        j, alpha = source.channels.split(state)
        return [*state, *(0.0 * v for v in (*j, *alpha))]

    def after_skip(self, position, source, carried, moved):
        count = source.channels.count
        return [*super().after_skip(position, source, carried[:count], moved), *carried[count:]]

    def solve(self, segment, source, carried):
        channels, count = source.channels, source.channels.count
        first, lines = carried[:count], carried[count:]
        solution, last = super().solve(segment, Lost(source, first, lines), first)
        all_of, others = channels.split(last), channels.split(without_gas(channels, last))
        lines = [
            a - b for p, q in zip(all_of, others, strict=True) for a, b in zip(p, q, strict=True)
        ]
        return solution, [*last, *lines]


class Lost:
    """A source, and in it the numbers, with other coefficients of lines at the first state."""

    def __init__(self, source, first, lines):
        self.source, self.first, self.lines = source, first, lines
        self.channels = self
        self.interpolate, self.steps = source.interpolate, source.channels.steps

    def split(self, values, channel=None):
        channels = self.source.channels
        if values is not self.first:
            return channels.split(values, channel)
        j, alpha = channels.split(without_gas(channels, values))
        lines, k = self.lines, len(j)
        return tuple(
            [a + b for a, b in zip(*rows, strict=True)]
            for rows in ((j, lines[:k]), (alpha, lines[k:]))
        )


def without_gas(channels, values):
    """Return a state without molecules: velocity, turbulence and temperature come before them."""
    values, first = list(values), 0
    for part in channels.lines:
        for k in range(first + 3, first + part.state_count):
            values[k] = 0.0 * values[k]
        first += part.state_count
    return values


class AsRadmc3d(Session):
    """A session that copies RADMC-3D's branch for small optical depths, and its lost lines."""

    def scheme(self):
        scheme = super().scheme().scheme
        if not self.request.second:
            scheme = SmallDepths()
        elif scheme.resolution is not None:
            scheme = LinesLostAtEntry(scheme.resolution)
        return TowardsObserver(scheme)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Give a function that returns the folder of a model, with the files of a case."""
    base = tmp_path_factory.mktemp("models")

    def written(name, case_id):
        stored, meta = stored_model(name)
        if not (base / name).is_dir():
            write_model(stored, meta, base / name)
        case = case_of(meta, case_id)
        write_settings(meta, case, base / name)
        return base / name, reference_of(stored, case), case

    return written


@pytest.fixture
def model(folder):
    """Give a function that returns reference, session and case of a model."""

    def opened(name, case_id):
        path, expected, case = folder(name, case_id)
        session = AsRadmc3d.of(request_of(case["arguments"].split()), path)
        np.testing.assert_allclose(session.frequencies, case["nu_hz"], rtol=1e-14)
        return expected, session, case

    return opened


def differences(found, expected, seen=slice(None)):
    """Return the largest difference of each channel, relative to its maximum."""
    off = np.abs(found - expected)[seen].reshape(-1, expected.shape[-1]).max(axis=0)
    peaks = np.abs(expected).max(axis=(0, 1))
    return np.where(off > 0.0, off / np.where(peaks > 0.0, peaks, 1.0), 0.0)


@pytest.mark.parametrize(("name", "case_id"), cases("intensity", "tau"))
def test_images_are_radmc3ds(name, case_id, model):
    """To 1e-7 in first order and 1e-8 in second, of the brightest pixel of each channel."""
    expected, session, case = model(name, case_id)
    image = session.result(precision="double")
    seen = np.ones(expected.shape[:2], bool)
    if (name, case_id) in STAR_ELSEWHERE:
        seen = without_stars(image, session)
    limit = 1e-8 if case["order"] == 2 else 1e-7
    assert differences(image.intensity, expected, seen).max() <= limit


def without_stars(image, session):
    """Return which pixels have no star, in the picture or in RADMC-3D's."""
    positions = np.array([star.position for star in session.model.stars]).T
    camera, grid = session.camera(), session.volume.grid
    places = [camera.project(positions, grid)[:2]]
    if session.request.local:  # RADMC-3D's are direction cosines
        eye, *axes = camera.frame(grid).vectors
        away = positions - eye[:, None]
        places.append((np.stack(axes) @ (away / np.linalg.norm(away, axis=0)))[:2])
    else:
        places.append(camera.replace(posang=0.0).project(positions, grid)[:2])
    seen = np.ones(image.shape[:2], bool)
    x, y = np.meshgrid(image.x, image.y)
    reach = 0.5000001 * np.array(image.pixel_size)  # a star may be on the edge of pixels
    for across, up in np.hstack(places).T:
        seen &= (np.abs(x - across) > reach[0]) | (np.abs(y - up) > reach[1])
    assert np.count_nonzero(~seen) <= 4 * positions.shape[1]
    return seen


@pytest.mark.parametrize(("name", "case_id"), cases("tausurf"))
def test_tau_surfaces_are_radmc3ds(name, case_id, model):
    expected, session, _ = model(name, case_id)
    found = session.result(precision="double").intensity
    reached = expected > -1e90
    np.testing.assert_array_equal(found > -1e90, reached)
    bounds = session.volume.grid.bounds
    size = float(np.max(bounds[:, 1] - bounds[:, 0]))
    assert np.abs(found - expected)[reached].max() <= 1e-10 * size


@pytest.mark.parametrize(("name", "case_id"), cases("spectrum"))
def test_spectra_are_radmc3ds(name, case_id, model):
    """To 1e-7 of each flux."""
    expected, session, _ = model(name, case_id)
    found = session.result(precision="double").flux
    # Fluxes below 1e-97 are written as 0.
    np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-97)


@pytest.mark.parametrize(
    ("name", "case_id"), [("dust_cart", "first_obl"), ("line_cart", "first_co21")]
)
def test_codatas_constants_change_little(name, case_id, model):
    """CODATA's digits in RADMC-3D's rules: 5e-4, where hν/kT is not large.

    Dust is compared at 60 micron and more, the line in the sum of its channels: a molecule is
    lighter by 0.7 %, since its weight counts atomic mass units and not protons.
    """
    expected, session, _ = model(name, case_id)
    digits = dataclasses.replace(CODATA, name="radmc3d")
    how = {**session.how(None), "constants": digits, "precision": "double"}
    found = vm.observe(session.volume, session.medium(), session.camera(), **how).intensity
    if name == "line_cart":
        found, expected = (image.sum(axis=2, keepdims=True) for image in (found, expected))
    else:
        found, expected = found[..., 2:], expected[..., 2:]
    off = differences(found, expected)
    assert np.all((off > 1e-6) & (off <= 5e-4))


def test_catching_loses_no_lines_at_the_entry():
    """In uniform gas all schemes agree: RADMC-3D loses 3/4 of the line of the first cell."""
    edges = np.linspace(0.0, 1e15, 5)
    grid = vm.CartesianGrid(edges, edges, edges, unit="cm")
    ones = np.ones(grid.shape)
    gas = vm.Volume(grid, n=1e-3 * ones / u.cm**3, v=2e4 * ones * u.cm / u.s)
    co = vm.Molecule("co", 28.0, [0.0, 3.845], [1, 3], ["0", "1"], [1], [0], [7.2e-8], [1.15271e11])
    medium = vm.Lines("n", co, temperature=20.0, velocity=("0 cm/s", "0 cm/s", "v"))
    camera = vm.Orthographic(resolution=3, width=5e14)
    velocities = vm.channels(-0.5, 0.5, 5, rest=1.15271e11)
    plain, caught = (
        vm.observe(gas, medium, camera, velocities=velocities, scheme=scheme, precision="double")
        for scheme in ("first-order", OlsonKunasz(catch_doppler_resolution=0.2))
    )
    assert plain.intensity.max() > 0.0
    np.testing.assert_allclose(caught.intensity, plain.intensity, rtol=1e-6)
    bands = bands_of(Partition(gas), medium, np.array([1.15271e11]), CODATA)
    tuned, half = at_frequencies(medium, bands), 0.5 * float(plain.optical_depth[1, 1, 2])
    first, other = (
        vm.tau_surface(gas, tuned, camera, half, scheme=scheme).depth.intensity
        for scheme in ("first-order", OlsonKunasz(catch_doppler_resolution=0.2))
    )
    assert np.all(np.isfinite(first))
    np.testing.assert_allclose(other, first, atol=1e-6 * 1e15)


@pytest.mark.parametrize("order", ["", "secondorder", "doppcatch"])
def test_lines_below_a_mirror_move_the_other_way(order, tmp_path):
    """A mirrored grid is one with both halves; RADMC-3D is off by 0.2 to 1.2 of the maximum."""
    stored, meta = stored_model("line_spher3d")
    theta, shape = stored["edges_x2"], (16, 12, 16)
    half = dict(stored)
    both = dict(stored, edges_x2=np.concatenate([theta[:7], np.pi - theta[5::-1]]))
    half["edges_x2"] = theta[:7]
    for key in ("numberdens", "gas_temperature", "gas_velocity", "microturbulence"):
        cells = np.atleast_2d(stored[key].T if key == "gas_velocity" else stored[key])
        above = cells.reshape(-1, *shape, order="F")[:, :, :6]
        below = above[:, :, ::-1].copy()
        if key == "gas_velocity":
            below[1] *= -1.0
        for into, values in ((half, above), (both, np.concatenate([above, below], axis=2))):
            flat = np.stack([one.ravel(order="F") for one in values])
            into[key] = flat.T if key == "gas_velocity" else flat.reshape(-1, flat.shape[1])
            if key in ("gas_temperature", "microturbulence"):
                into[key] = flat[0]
    words = f"image iline 2 widthkms 4 linenlam 3 incl 57.3 phi 33 npix 20 nofluxcons {order}"
    images = [
        drawn(write_model(arrays, meta, tmp_path / name), words).intensity
        for name, arrays in (("half", half), ("both", both))
    ]
    assert differences(*images).max() <= 1e-9


@pytest.mark.parametrize(("words", "name"), [("", "image.out"), ("imageunform", "image.bout")])
def test_the_command_line_writes_radmc3ds_file(words, name, folder, capsys):
    """In first order to RADMC-3D's branch for small depths: up to 5e-5 of a segment."""
    path, expected, case = folder("dust_octree", "first_fluxcons")
    code = main(["radmc3d", "--model", str(path), *case["arguments"].split(), *words.split()])
    assert code == 0
    assert "12 x 12 pixels, 2 wavelengths" in capsys.readouterr().out
    image = vm.Image.load(path / name)
    assert differences(image.intensity, expected).max() <= 2e-5
    waves = image.provenance["wavelengths_micron"]
    np.testing.assert_allclose(waves, case["wavelength_micron"], rtol=1e-14)
    camera = case["camera"]
    np.testing.assert_allclose(image.pixel_size, 2 * camera["half_size"][0] / 12, rtol=1e-12)


def test_the_command_line_writes_a_spectrum(folder):
    path, expected, case = folder("spectra_spher2d", "nostar")
    assert main(["radmc3d", "-q", "--model", str(path), *case["arguments"].split()]) == 0
    lines = (path / "spectrum.out").read_text().splitlines()
    assert lines[:3] == ["1", "5", ""]
    rows = np.array([line.split() for line in lines[3:]], dtype=float)
    np.testing.assert_allclose(rows[:, 0], 2.99792458e14 / np.array(case["nu_hz"]), rtol=1e-12)
    np.testing.assert_allclose(rows[:, 1], expected, rtol=2e-5)


@pytest.mark.parametrize(
    ("setting", "words", "message"),
    [
        ("camera_interpol_jnu = 0", "", "camera_interpol_jnu must be 1"),
        ("thermal_boundary_xl = 30", "", "thermal boundaries are drawn with one ray per pixel"),
        ("lines_mode = 3", "inclline", "not in LTE"),
        ("", "nodust", "nothing is on"),
        ("", "ilambda 99", "61 wavelengths"),
        ("", "nrrefine 3", "nrrefine 3"),
    ],
)
def test_models_that_draw_another_picture_are_refused(setting, words, message, folder, capsys):
    path, _, _ = folder("star_table", "first")
    (path / "radmc3d.inp").write_text(f"scattering_mode_max = 0\n{setting}\n")
    channels = "" if "ilambda" in words else "lambda 10"
    assert main(["radmc3d", "--model", str(path), "image", *f"{channels} {words}".split()]) == 2
    assert message in capsys.readouterr().err


def test_scattering_needs_noscat(folder, capsys, recwarn):
    """A table with κ_scat: Monte Carlo, unless noscat is given; then κ_scat does not dim.

    In Python a warning tells of it, unless the model's settings leave scattering out.
    """
    path, _, _ = folder("star_table", "first")
    (path / "radmc3d.inp").write_text("")
    table = np.loadtxt(path / "dustkappa_grain0.inp", skiprows=2)
    kept = (path / "dustkappa_grain0.inp").read_text()
    rows = "\n".join(f"{w!r} {k!r} {2 * k!r}" for w, k in table.tolist())
    (path / "dustkappa_grain0.inp").write_text(f"2\n{len(table)}\n{rows}\n")
    try:
        words = ["image", "lambda", "10", "npix", "4", "nofluxcons", "nostar"]
        assert main(["radmc3d", "--model", str(path), *words]) == 2
        assert "give noscat" in capsys.readouterr().err
        dimmed = drawn(path, " ".join(words) + " tracetau")
        plain = drawn(path, " ".join(words) + " tracetau noscat")
        assert not [one for one in recwarn if "albedo" in str(one.message)]
        model, camera = vm.open(path), vm.Orthographic(resolution=2)
        with pytest.warns(UserWarning, match="albedo of 0.67 at 10 micron"):
            vm.observe(model, vm.Dust(model), camera, wavelengths=10.0)
        recwarn.clear()
        (path / "radmc3d.inp").write_text("scattering_mode_max = 0\n")
        dust = vm.Dust(model)
        vm.observe(model, dust, camera, wavelengths=10.0)
        assert dust.scattering == "none"
        assert not [one for one in recwarn if "albedo" in str(one.message)]
    finally:
        (path / "dustkappa_grain0.inp").write_text(kept)
    np.testing.assert_allclose(dimmed.intensity, 3.0 * plain.intensity, rtol=1e-12)


@pytest.mark.parametrize(
    ("words", "wall"), [("incl 0", "zl"), ("incl 180", "zr"), ("incl 90 phi 90", "xr")]
)
def test_a_thermal_boundary_shines_through(words, wall, folder):
    """I = I₀ + B(T) exp(-τ) within the grid: light enters by the face away from the observer."""
    path, _, _ = folder("star_table", "first")
    common = f"image lambda 1000 npix 12 nofluxcons nostar {words}"
    dark, depth = (drawn(path, f"{common} {more}").intensity for more in ("", "tracetau"))
    (path / "radmc3d.inp").write_text(f"scattering_mode_max = 0\nthermal_boundary_{wall} = 30\n")
    lit = drawn(path, common).intensity
    within = np.where(depth > 0.0, RADMC3D.planck(2.99792458e11, 30.0) * np.exp(-depth), 0.0)
    assert np.any(within == 0.0)
    np.testing.assert_allclose(lit, dark + within, rtol=1e-12)
    # Whether a face is in front of the image plane, or behind it, is nothing to parallel rays.
    side = float(np.ptp(vm.open(path).grid.bounds[0]))
    for away in (-3.0 * side, 3.0 * side):
        point = {"zl": (0, 0, away), "zr": (0, 0, away), "xr": (away, 0, 0)}[wall]
        far = drawn(path, f"{common} pointau " + " ".join(str(p / 1.496e13) for p in point))
        np.testing.assert_allclose(far.intensity, lit, rtol=1e-9)  # places of rays are rounded


def test_a_column_is_the_mass_of_the_dust(folder):
    """All of the box is in the default frame; the finer the pixels, the closer the sum."""
    path, _, _ = folder("dust_cart", "first_obl")
    image = drawn(path, "image tracecolumn npix 150 incl 57 phi 33")
    volume = vm.open(path)
    density = volume.evaluate("dust_density_1 + dust_density_2")
    mass = float(np.sum(density * np.asarray(volume.grid.cell_volumes)))
    assert np.sum(image.intensity) * np.prod(image.pixel_size) == pytest.approx(mass, rel=1e-3)


@pytest.mark.parametrize(
    ("channels", "waves"), [("", [1.0]), ("lambdarange 10 1000 nlam 3", [10, 100, 1000])]
)
def test_a_column_is_written_as_an_image(folder, tmp_path, channels, waves):
    """It is the same at all wavelengths; without one the file has 1 micron."""
    path, _, _ = folder("dust_cart", "first_obl")
    words = f"image tracecolumn npix 10 {channels}".split()
    output = tmp_path / "image.out"
    assert main(["radmc3d", "--model", str(path), "-q", "-o", str(output), *words]) == 0
    image = vm.Image.load(output)
    assert image.spectral.wavelengths == pytest.approx(waves)
    expected = drawn(path, "image tracecolumn npix 10").intensity
    assert expected.max() > 0.0
    for k in range(len(waves)):
        np.testing.assert_allclose(image.intensity[:, :, k], expected[:, :, 0], rtol=1e-12)


def test_free_free_by_a_word(folder):
    """RADMC-3D knows the setting, but not the word."""
    path, expected, case = folder("freefree", "first_ff")
    (path / "radmc3d.inp").write_text("scattering_mode_max = 0\n")
    image = drawn(path, case["arguments"] + " inclfreefree")
    assert differences(image.intensity, expected).max() <= 2e-5
    with pytest.raises(vm.InputError, match="nothing is on"):
        drawn(path, case["arguments"])


def test_channels_of_files_and_numbers(folder):
    """A frequency, a global wavelength by its number, and several of these."""
    path, _, _ = folder("star_table", "first")
    (path / "camera_frequency.inp").write_text("2\n1e12\n3e11\n")
    waves = np.loadtxt(path / "wavelength_micron.inp", skiprows=1)
    (path / "color_inus.inp").write_text("1\n2\n30\n40\n")

    def frequencies(words):
        return Session.of(request_of(["image", *words.split()]), path).frequencies

    np.testing.assert_allclose(frequencies("loadlambda"), [1e12, 3e11], rtol=1e-14)
    np.testing.assert_allclose(frequencies("ilambda 30"), 2.99792458e14 / waves[29], rtol=1e-14)
    np.testing.assert_allclose(frequencies("color"), 2.99792458e14 / waves[[29, 39]], rtol=1e-14)
    np.testing.assert_allclose(frequencies("nuhz 1e11"), [1e11], rtol=1e-14)
    (path / "camera_frequency.inp").unlink()


def test_a_folder_without_a_model_is_refused(tmp_path, capsys):
    assert main(["radmc3d", "--model", str(tmp_path), "image", "lambda", "10"]) == 2
    assert "has no amr_grid.inp" in capsys.readouterr().err


def test_a_star_as_a_sphere(folder):
    """Pixels show it if their centres are within; a small one has the flux of its disc."""
    path, _, _ = folder("star_table", "first")
    (path / "radmc3d.inp").write_text("scattering_mode_max = 0\nistar_sphere = 1\n")
    size = 3.2e12 / 3.08572e18  # pixels of 1e10 cm, and a star of 1e11
    image = drawn(path, f"image lambda 5 npix 320 sizepc {size!r} nofluxcons")
    away = np.hypot(*np.meshgrid(image.x, image.y))
    bright = image.intensity[..., 0]
    star = bright > 0.5 * bright.max()
    np.testing.assert_array_equal(star, away < 1e11)
    assert np.ptp(bright[star]) <= 0.1 * bright.max()  # through cells of several densities
    small = drawn(path, f"image lambda 5 npix 3 sizepc {size!r} nofluxcons").intensity[..., 0]
    assert small[1, 1] * (3.2e12 / 3) ** 2 == pytest.approx(np.pi * 1e22 * bright.max(), rel=0.06)
