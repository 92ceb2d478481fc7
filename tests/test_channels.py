"""Spectra: many channels are drawn in blocks, each channel with its own unit and tolerance."""

from __future__ import annotations

import json

import numpy as np
import pytest

import voluminous as vm
from contracts.scheme import both_ways
from reference import data_directory
from voluminous.drawing.api import in_steps
from voluminous.media.contract import MediumSample
from voluminous.rendering.options import RenderOptions

CAMERA = vm.Orthographic(30, 40, resolution=20)
SCHEMES = ["first-order", "second-order", "olson-kunasz", "pre-integrated"]


@pytest.fixture(scope="module")
def volume() -> vm.Volume:
    rng = np.random.default_rng(3)
    edges = np.linspace(-1.0, 1.0, 9)
    density, temperature = (rng.uniform(low, high, (8, 8, 8)) for low, high in ((0, 2), (10, 60)))
    return vm.Volume(vm.CartesianGrid(edges, edges, edges), rho=density, T=temperature)


def dust(count: int, *, grey: bool = False, sizes: np.ndarray | None = None) -> vm.Coefficients:
    """Return dust at some wavelengths: Planck's law times an opacity that grows with frequency."""
    opacity = np.linspace(0.2, 1.5, count)
    sizes = opacity if sizes is None else sizes
    rows = zip(sizes, np.linspace(5.0, 90.0, count), strict=True)
    emissivity = [f"{float(a)!r} * rho / (exp({float(b)!r} / T) - 1)" for a, b in rows]
    return vm.Coefficients(emissivity, "rho" if grey else [f"{float(k)!r} * rho" for k in opacity])


def alone(medium: vm.Coefficients, channel: int) -> vm.Coefficients:
    own = 0 if medium.grey else channel
    return vm.Coefficients(medium.emissivity[channel], medium.extinction[own])


class Black(vm.Medium):
    """A medium of which nothing is known but its coefficients."""

    names, grey = ("rho", "T"), False

    def __init__(self, channels: int, size: float = 1.0) -> None:
        self.channels, self.size = channels, size

    def coefficients(self, fields, context) -> MediumSample:
        rho, T = fields["rho"], fields["T"]
        opacity = [context.number(0.5 + c / self.channels) for c in range(self.channels)]
        return MediumSample(
            [context.number(self.size) * k * rho * context.ops.sqrt(T) for k in opacity],
            [k * rho for k in opacity],
        )

    def key(self):
        return ("Black", self.channels, self.size)


# --- blocks ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("grey", [False, True])
@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_channel_among_many_is_what_it_is_alone(scheme, grey, volume):
    """Blocks are of 16 channels or 5; 19 do not fill theirs. Bits of one channel are its own.

    First order evaluates many channels on the ray in the precision of the picture, and one in
    double precision beforehand.
    """
    medium = dust(19, grey=grey)
    options = {"scheme": scheme, "cutoff": 0.0}
    image = vm.render(volume, medium, CAMERA, **options)
    assert image.intensity.shape == (20, 20, 19)
    close = 2e-6 if scheme == "first-order" else 2e-7
    for channel in (0, 8, 9, 18):
        one = vm.render(volume, alone(medium, channel), CAMERA, **options)
        for values, expected in (
            (image.intensity[..., channel], one.intensity[..., 0]),
            (image.transparency[..., channel], one.transparency[..., 0]),
            (image.optical_depth[..., channel], one.optical_depth[..., 0]),
        ):
            np.testing.assert_allclose(values, expected, rtol=0, atol=close * expected.max())


@pytest.mark.parametrize(
    ("scheme", "size"), [(s, 14) for s in SCHEMES[::3]] + [("second-order", 5)]
)
def test_blocks_share_their_kernels(scheme, size, volume, kernels):
    def draw(count: int) -> None:
        volume.tables.clear()
        vm.render(volume, dust(count), CAMERA, scheme=scheme)

    assert kernels(draw, 4 * size) == kernels(draw, 3 * size)


def test_blocks_of_the_default_scheme_share_their_kernels(volume, kernels):
    def draw(count: int) -> None:
        volume.tables.clear()
        vm.render(volume, Black(count), CAMERA)

    assert kernels(draw, 48) == kernels(draw, 32)


@pytest.mark.parametrize("scheme", ["first-order", "pre-integrated", "post-classified"])
def test_any_medium_can_have_many_channels(scheme, volume):
    """Also in a sum; an emission is linear in the emissivity."""
    medium = Black(40)
    image = vm.render(volume, medium, CAMERA, scheme=scheme)
    twice = vm.render(volume, medium + dust(40, sizes=np.zeros(40)), CAMERA, scheme=scheme)
    assert image.intensity.shape == twice.intensity.shape == (20, 20, 40)
    assert np.all(twice.intensity <= image.intensity * (1.0 + 1e-3))
    middle = vm.render(
        volume, vm.Coefficients("sqrt(T) * rho", "rho"), CAMERA, scheme=scheme
    )  # channel 20: an opacity of one
    peak = middle.intensity.max()
    np.testing.assert_allclose(
        image.intensity[..., 20], middle.intensity[..., 0], rtol=0, atol=2e-3 * peak
    )


def test_colours_of_one_picture_in_many_channels(volume):
    """A table of 20 colours: the same as a shell of each colour alone."""
    colors = np.random.default_rng(1).uniform(0.1, 1.0, 20)
    options = {"scheme": "first-order", "cutoff": 0.0}
    image, one = (
        vm.render(
            volume, vm.Table("T", [20, 30, 50], heights, [0, 0.4, 0.2], 1.0), CAMERA, **options
        )
        for heights in (
            np.outer([0.0, 1.0, 0.5], colors),
            np.array([0.0, 1.0, 0.5])[:, None],
        )
    )
    expected = one.intensity * colors.astype(np.float32)
    np.testing.assert_allclose(image.intensity, expected, rtol=2e-6, atol=1e-6 * expected.max())


def test_directions_and_cutoffs_agree(volume):
    """The default cut-off costs less than 1e-4 of the intensity gathered, of each channel."""
    medium = dust(20)
    whole = vm.render(volume, medium, CAMERA, scheme="second-order", cutoff=0.0)
    short, back = (
        vm.render(volume, medium, CAMERA, scheme=one) for one in both_ways("second-order")
    )
    peaks = whole.intensity.max(axis=(0, 1))
    assert np.all(np.abs(back.intensity - whole.intensity) <= 1e-6 * peaks)
    assert np.all(np.abs(short.intensity - whole.intensity) <= 1e-4 * peaks)
    np.testing.assert_allclose(short.optical_depth, whole.optical_depth, rtol=1e-5)


def test_samples_and_backgrounds(volume):
    medium, behind = dust(20), np.linspace(0.0, 1.0, 20)
    image, dark = (
        vm.render(volume, medium, CAMERA, scheme="first-order", samples=2, cutoff=0.0, background=b)
        for b in (behind, 0.0)
    )
    expected = dark.intensity + dark.transparency * behind
    np.testing.assert_allclose(image.intensity, expected, rtol=1e-5)


def test_stars_shine_through_each_channel(volume):
    """A star behind the centre is as bright as what its ray lets through of its flux."""
    flux = np.linspace(1.0, 2.0, 20)
    medium = dust(20, sizes=np.zeros(20))
    star = vm.Stars([(0.0, 0.0, 0.0)], [flux.tolist()], radii=0.3)
    options = {"scheme": "first-order", "cutoff": 0.0}
    one = vm.render(volume, medium, CAMERA, objects=star, **options)
    for channel in (0, 10, 19):
        ray = star.replace(colors=[[float(flux[channel])]])
        alike = vm.render(volume, alone(medium, channel), CAMERA, objects=ray, **options)
        np.testing.assert_allclose(
            one.intensity[..., channel], alike.intensity[..., 0], rtol=1e-5, atol=1e-6
        )
    assert one.intensity.max() > 0.0


def test_more_rays_at_the_same_pixels_for_all_channels(volume):
    """Until the means of a pixel change by less than the tolerance; single rays are off by 0.3."""
    camera, medium = vm.Orthographic(30, 40, resolution=8), Black(20)
    options = {"scheme": "first-order", "cutoff": 0.0}
    image = vm.render(volume, medium, camera, antialias="adaptive", tolerance=0.02, **options)
    fine = vm.render(volume, medium, camera, samples=24, **options)
    off = np.abs(image.intensity - fine.intensity).max(axis=(0, 1))
    assert np.all(off <= 0.06 * fine.intensity.max(axis=(0, 1)))


def test_a_ray_is_probed_in_all_channels(volume):
    for scheme in ("second-order", "pre-integrated"):
        image = vm.render(volume, dust(20), CAMERA, scheme=scheme)
        found = vm.probe(volume, dust(20), CAMERA, (11, 8), scheme=scheme)
        assert found.j.shape == (len(found.begin), 20)
        np.testing.assert_allclose(found.intensity, image.intensity[8, 11], rtol=1e-6)
        np.testing.assert_allclose(found.gathered[-1], found.intensity, rtol=1e-5)
    image = vm.render(volume, Black(20), CAMERA, tolerance=1e-3)
    found = vm.probe(volume, Black(20), CAMERA, (11, 8))
    np.testing.assert_allclose(found.intensity, image.intensity[8, 11], rtol=1e-6)


def test_batches_show_all_channels_and_progress_ends(volume):
    told = []
    steps = in_steps(
        volume,
        dust(20),
        CAMERA,
        RenderOptions(scheme="first-order", progress=lambda *a: told.append(a)),
        seconds=1.0,
    )
    seen = np.full((400, 20), np.nan)
    while True:
        try:
            pixel, intensity, _ = next(steps)
        except StopIteration as end:
            image = end.value
            break
        seen[pixel] = intensity
    np.testing.assert_array_equal(seen.reshape(20, 20, 20), image.intensity)
    assert told[-1][0] == told[-1][1]


def test_bounds_hold_in_all_channels(volume):
    camera = vm.Orthographic(30, 40, resolution=3)
    medium = vm.Coefficients([f"{k} * rho" for k in range(1, 13)], "rho")
    image = vm.render(volume, medium, camera, bounds=True, max_panels=16)
    assert image.lower.shape == image.upper.shape == (3, 3, 12)
    ratio = np.arange(1, 13)  # to the tolerance: blocks are divided until each is
    expected = np.broadcast_to(image.upper[..., :1], image.upper.shape)
    np.testing.assert_allclose(image.upper / ratio, expected, rtol=2e-3, atol=1e-280)
    assert np.all(image.lower <= image.upper)
    exact = vm.render(volume, medium, camera, tolerance=1e-6)
    slack = 1e-6 * exact.intensity.max(axis=(0, 1))
    assert np.all(image.lower <= exact.intensity + slack)
    assert np.all(exact.intensity <= image.upper + slack)


# --- a unit and a tolerance of each channel -------------------------------------------------------

FAINT = np.array([1e-14, 3e-44, 1e-20])


@pytest.mark.parametrize("scheme", [*SCHEMES, "post-classified"])
def test_single_precision_holds_channels_far_fainter_than_others(scheme, volume):
    """The second channel's peak, near 1e-42, is below what single precision can hold."""
    medium = dust(3, sizes=FAINT)
    image, exact = (
        vm.render(volume, medium, CAMERA, scheme=scheme, precision=precision, tolerance=1e-4)
        for precision in ("single", "double")
    )
    peaks = exact.intensity.max(axis=(0, 1))
    assert peaks[1] < 1e-42 < 1e-16 < peaks[0]
    allowed = 1e-4 if scheme == "post-classified" else 1e-5
    assert np.all(np.abs(image.intensity - exact.intensity) <= allowed * peaks)


def test_units_are_found_where_bounds_are_not_known(volume):
    """Of a medium without ranges: the same picture, 1e-43 times as bright."""
    images = [
        vm.render(volume, Black(20, size), CAMERA, scheme="first-order").intensity
        for size in (1.0, 1e-43)
    ]
    np.testing.assert_allclose(images[1], 1e-43 * images[0].astype(np.float64), rtol=1e-5)


@pytest.mark.parametrize("background", [0.0, 1e-5])
def test_the_tolerance_is_relative_to_the_peak_of_each_channel(background, volume):
    """From one channel to the next the brightness falls by ten; `error` holds for each of them."""
    sizes = 10.0 ** -np.arange(12.0)
    medium = dust(12, sizes=sizes)
    image, exact = (
        vm.render(volume, medium, CAMERA, tolerance=tolerance, background=background, **options)
        for tolerance, options in ((1e-2, {}), (1e-6, {"precision": "double"}))
    )
    peaks = exact.intensity.max(axis=(0, 1))
    off = np.abs(image.intensity - exact.intensity) / peaks
    told = image.error / peaks.max()
    assert off.max() <= 1e-2
    assert np.all(told <= 1.1e-2)  # rounding is added to what is within the tolerance
    assert np.mean(off.max(axis=2) <= told) >= 0.98


def test_colours_share_a_tolerance(volume):
    """The error of a picture's colours is a fraction of the brightest of them."""
    media = [vm.Gaussian("T", 30.0, 4.0, color, 0.5, 1.0) for color in ((1.0, 1e-3), (1.0, 1.0))]
    images = [vm.render(volume, medium + medium, CAMERA) for medium in media]
    np.testing.assert_array_equal(images[0].error, images[1].error)


# --- RADMC-3D -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "scheme", "close"),
    [("first_obl", "first-order", 3e-6), ("second_obl", "olson-kunasz", 6e-9)],
)
def test_dust_of_radmc3d(name, scheme, close):
    """Five wavelengths, of which the first is 1e-29 times as bright as the brightest.

    Optical depths below 1e-5 are RADMC-3D's own, less accurate, branch of first order.
    """
    path = data_directory() / "radmc3d_physics" / "dust_cart.npz"
    if not path.is_file():
        pytest.skip(f"no {path}")
    data = np.load(path)
    meta = json.loads(str(data["meta"]))
    (case,) = [case for case in meta["cases"] if case["id"] == name]
    edges = [data[f"edges_x{k}"] for k in (1, 2, 3)]
    shape = tuple(len(e) - 1 for e in edges)
    fields = {
        f"{name}{s}": values.astype(np.float64).reshape(shape, order="F")
        for name, key in (("rho", "dust_density"), ("T", "dust_temperature"))
        for s, values in enumerate(data[key])
    }
    volume = vm.Volume(vm.CartesianGrid(*edges), **fields)
    emissivity, extinction = [], []
    for nu in case["nu_hz"]:
        alpha = []
        for s in range(2):
            table = data[f"kappa_{s}"]
            frequency = 2.9979e14 / table[::-1, 0]  # sic: the camera's are of another c
            kappa = float(np.interp(nu, frequency, table[::-1, 1]))
            alpha.append(f"{kappa!r} * rho{s}")
        planck = [
            f"{1.47455e-47 * nu**3!r} / (exp({4.7989e-11 * nu!r} / T{s}) - 1)" for s in range(2)
        ]
        extinction.append(" + ".join(alpha))
        emissivity.append(" + ".join(f"{a} * {b}" for a, b in zip(alpha, planck, strict=True)))
    camera = case["camera"]
    width = 2.0 * camera["half_size"][0]
    view = vm.Orthographic(
        camera["incl"], camera["phi"], width=width, resolution=camera["nx"], center=(0, 0, 0)
    )
    medium = vm.Coefficients(emissivity, extinction)
    reference = data[f"img_{name}"]
    peaks = reference.max(axis=(0, 1))
    for precision, limit in (("double", close), ("single", 1e-5)):
        image = vm.render(volume, medium, view, scheme=scheme, precision=precision, cutoff=0.0)
        off = np.abs(image.intensity - reference).max(axis=(0, 1)) / peaks
        assert np.all(off <= limit), off


def test_single_precision_is_not_taken_where_few_cells_are_out_of_its_range():
    """The square of 1e25 is, in one of 17 576 cells; what follows is not."""
    edges = np.linspace(0.0, 1.0, 27)
    rho = np.ones((26, 26, 26))
    rho[3, 4, 6] = 1e25  # which a sample of 4096 cells misses
    grid = vm.CartesianGrid(edges, edges, edges)
    light = "rho / (1e25 * (1 + rho**2 * 1e-30 * 1e-20))"  # 1 / 2 there, and 0 if it overflows
    medium = vm.Coefficients([f"{k} * {light}" for k in range(1, 20)], "0")
    view = vm.Orthographic(resolution=26, incl=0)
    image, exact = (
        vm.render(vm.Volume(grid, rho=rho), medium, view, scheme="first-order", precision=precision)
        for precision in ("single", "double")
    )
    assert exact.intensity.max() > 0.1
    np.testing.assert_allclose(image.intensity, exact.intensity, rtol=1e-6, atol=1e-20)


def test_a_picture_is_cancelled_between_blocks(volume):
    """A picture of three blocks, all of whose rays are one batch, ends after the first of them."""
    told = []

    def cancel(done: int, total: int) -> None:
        told.append(done)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        vm.render(volume, dust(40), CAMERA, scheme="first-order", progress=cancel)
    assert told == [0]


def test_empty_leaves_are_left_out_of_the_walk():
    """A ball in a twentieth of the leaves of an octree: its channels are those drawn alone."""
    edges = np.linspace(-1.0, 1.0, 5)
    grid = vm.OctreeGrid.from_function(
        edges, edges, edges, lambda x, y, z, size: x**2 + y**2 + z**2 < 1.0, 3
    )
    x, y, z = grid.cell_centers(0, grid.size)
    rho = np.maximum(0.0, 0.04 - (x**2 + y**2 + z**2)).reshape(grid.shape)
    assert 0 < np.mean(rho > 0.0) < 0.05
    volume = vm.Volume(grid, rho=rho)
    medium = vm.Coefficients(
        [f"{k} * rho" for k in range(1, 20)], [f"{k / 3} * rho" for k in range(1, 20)]
    )
    camera = vm.Orthographic(30, 40, width=0.6, resolution=20)
    image = vm.render(volume, medium, camera, scheme="first-order", cutoff=0.0)
    for channel in (0, 18):
        one = vm.render(volume, alone(medium, channel), camera, scheme="first-order", cutoff=0.0)
        peak = one.intensity.max()
        assert peak > 0.0
        np.testing.assert_allclose(
            image.intensity[..., channel], one.intensity[..., 0], rtol=0, atol=2e-6 * peak
        )
