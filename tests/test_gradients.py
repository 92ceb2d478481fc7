"""Pictures can be differentiated: by numbers of media, by coefficients, and by a camera."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import voluminous as vm
from contracts.scheme import both_ways
from voluminous.backend import dr, functions, get_backend
from voluminous.errors import InputError
from voluminous.expressions import DrjitOps
from voluminous.rendering.options import RenderOptions
from voluminous.rendering.pixels import whole_picture
from voluminous.rendering.prepare import prepare
from voluminous.rendering.replay import gradient, tracer_like
from voluminous.rendering.run import make_tracer, run
from voluminous.rendering.tracer import exhausted

AXIS = np.linspace(-1, 1, 5)
GRIDS = {
    # With room for empty blocks.
    "uniform": lambda: vm.CartesianGrid.uniform(16, (-1, 1)),
    "octree": lambda: vm.OctreeGrid.from_function(*[AXIS] * 3, lambda x, y, z, size: x > y, 2),
    "spherical": lambda: vm.SphericalGrid(
        np.linspace(0.1, 1, 9), np.linspace(0, np.pi, 7), np.linspace(0, 2 * np.pi, 9)
    ),
}
SCHEMES = ["first-order", "second-order", "pre-integrated", "post-classified"]


def pairs(schemes):
    """Return grids with schemes: each with one, and in exhaustive runs with all."""
    usual = {*zip(GRIDS, itertools.cycle(schemes)), ("uniform", schemes[-1])}
    rest = pytest.mark.exhaustive
    both = itertools.product(GRIDS, schemes)
    return [pytest.param(*one, marks=[] if one in usual else rest) for one in both]


MEDIUM = vm.Gaussian("log10(a)", -0.3, 0.2, (1.0, 1.0), 0.7, 0.1)
# Rays are in no wall of a cell, where derivatives differ on both sides.
CAMERA = vm.Orthographic(57, 31, width=2.47, resolution=12)
WEIGHTS = np.random.default_rng(1).uniform(-1, 1, (12, 12, 2))


def shells(p):
    """Return two shells, the second of which is opaque."""
    first = vm.Gaussian("log10(a)", p[0], p[1], (p[2], 0.5), p[3], 0.3)
    return first + vm.Gaussian("log10(a)", p[4], p[5], (0.21, p[6]), p[7], 0.12)


def dust(p):
    """Return a dust whose emissivity and extinction are powers, with a wide range of both."""
    emissivity, extinction = [f"{p[0]!r}*a**2", f"{p[1]!r}*a"], [f"{p[2]!r}*a", f"{p[3]!r}*a"]
    return vm.Coefficients(emissivity, extinction)


def equals(p):
    """Return a shell and a dust with a parameter, and constants, of 0.3."""
    shell = vm.Gaussian("a + 0.3", p[0], p[1], (p[2], 0.3), 0.3, 0.3)
    return shell + vm.Coefficients([f"{p[3]!r}*a", "0.3*a"], "0.3*a*a")


MEDIA = {
    "equal numbers": (equals, [0.61, 0.31, 0.32, 0.3]),
    "shells": (shells, [-0.3, 0.2, 1.1, 0.7, -0.6, 0.1, 0.9, 4.7]),
    "dust": (dust, [2.5, 1.5, 0.7, 0.4]),
    "thick dust": (dust, [2.5, 1.5, 17.0, 40.0]),
}


def ball(grid, *, hidden=0):
    """Return a volume with a smooth ball around a point beside the centre, and empty corners."""
    x, y, z = grid.cell_centers(0, grid.size)
    values = 0.9 * np.exp(-5 * ((x - 0.1) ** 2 + (y + 0.2) ** 2 + z**2)) + 1e-3
    values *= 1 + 0.3 * np.sin(7 * x + 3 * y) * np.cos(5 * z)
    values[:hidden:7] = np.nan
    return vm.Volume(grid, a=values.reshape(grid.shape))


def job_of(
    volume, medium, scheme, precision="double", derivatives=True, camera=CAMERA, tolerance=1e-8
):
    """Return a job; pictures of the default scheme jump by a part of the tolerance.

    That is where other panels are accepted.
    """
    options = {"cutoff": 0.0, "precision": precision, "tolerance": tolerance, "scheme": scheme}
    options = RenderOptions(**options, device="cpu")
    return prepare(volume, medium, camera, options, derivatives=derivatives)[0]


def picture(job, drawn=None):
    """Return the intensities of a job; with the limits of one that was drawn, if there are any."""
    tracer = tracer_like(job, drawn)
    nx, ny = job.frame.pixels
    emission = [np.array(row).reshape(ny, nx) for row in exhausted(tracer.batches()).emission]
    return tracer.source.channels.intensity(emission)


def limits_of(job):
    """Return a source with the limits with which kernels draw most pixels, if there are any."""
    return run(job, 0.0).tracer if job.controlled else None


def central(f, x, step):
    """Return the central difference of f at x, exact to the step's square."""
    return (f(x + step) - f(x - step)) / (2 * step)


def check_gradient(volume, name, scheme, precision="double", rtol=1e-5):
    """Compare the gradient by every parameter of a medium with differences of plain pictures."""
    make, parameters = MEDIA[name]

    def numbers(p):
        return np.array([value for _, value, *_ in replayed(p)[1].numbers])

    def replayed(p):
        return gradient(job_of(volume, make(p), scheme, precision), WEIGHTS)

    intensity, tape = replayed(parameters)
    by_number = np.array([dr.grad(number)[0] for number in tape.numbers.values()])
    # The default scheme takes the same tolerance for all: panels are then equal, but for a few.
    limits = limits_of(job_of(volume, make(parameters), scheme))
    derivatives = limits is not None  # parts of sums have one tolerance, or one each

    def loss(p):
        job = job_of(volume, make(p), scheme, derivatives=derivatives)
        return float(np.sum(picture(job, limits) * WEIGHTS))

    expected = loss(parameters)
    np.testing.assert_allclose(np.sum(intensity * WEIGHTS), expected, rtol=rtol, atol=rtol)
    for k in range(len(parameters)):

        def at(value, k=k):
            return [value if i == k else old for i, old in enumerate(parameters)]

        # Pictures jump by 1e-9, where a shell is too faint: small steps would show that. Those of
        # the default scheme jump by its tolerance, where other panels are accepted: large ones do.
        step = 1e-6 if limits else 1e-4 * max(1.0, abs(parameters[k]))
        by_parameter = central(lambda x: numbers(at(x)), parameters[k], step)
        expected = central(lambda x: loss(at(x)), parameters[k], step)
        size = np.sum(np.abs(by_number * by_parameter))
        np.testing.assert_allclose(by_number @ by_parameter, expected, rtol=0, atol=rtol * size)


@pytest.mark.each_value_once
@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("name", MEDIA)
def test_gradients_of_numbers_agree_with_differences(name, scheme):
    grid = vm.CartesianGrid.uniform(8, (-1, 1))
    volume = vm.Volume(grid, a=np.random.default_rng(0).uniform(0.1, 1, grid.shape))
    check_gradient(volume, name, scheme)
    if scheme != "post-classified":  # pictures in single precision have other panels
        # The pictures themselves differ by 1e-6.
        check_gradient(volume, name, scheme, "single", 2e-5)


def test_gradients_of_the_default_scheme_are_right_in_single_precision():
    """Its panels are others there; both are right to the tolerance."""
    volume, (make, parameters) = ball(GRIDS["uniform"]()), MEDIA["shells"]
    found = []
    for precision in ("single", "double"):
        job = job_of(volume, make(parameters), "post-classified", precision, tolerance=1e-5)
        tape = gradient(job, WEIGHTS)[1]
        by: dict[float, float] = {}
        for (_, value, *_), number in tape.numbers.items():
            by[value] = by.get(value, 0.0) + dr.grad(number)[0]
        found.append(by)
    single, double = ([by[v] for v in found[1]] for by in found)
    np.testing.assert_allclose(single, double, rtol=0, atol=3e-3 * np.max(np.abs(double)))


def test_forward_derivatives_by_numbers_of_media_are_refused():
    """What a loop uses besides its state has none: they would be zero."""
    job = job_of(ball(GRIDS["uniform"]()), MEDIUM, "first-order")
    _, tape = gradient(job, WEIGHTS)
    assert all(map(dr.grad_enabled, tape.numbers.values()))
    with pytest.raises(InputError, match="forward mode"):
        light(make_tracer(job, 0.0))


def test_kernels_with_derivatives_are_kept():
    volume = ball(GRIDS["uniform"]())
    first, again = (make_tracer(job_of(volume, MEDIUM, "first-order"), 0.0) for _ in range(2))
    assert first.kernels is again.kernels is not None


def test_gradients_by_places_of_jumps_are_refused():
    """The default scheme ends its panels there."""
    volume = ball(GRIDS["uniform"]())
    job = job_of(volume, vm.Rectangle("a", 0.5, 0.2, (1, 1), 1, 0.1), "post-classified")
    with pytest.raises(InputError, match="pre-integrated"):
        gradient(job, WEIGHTS)


def test_gradients_along_rays_towards_the_observer_are_refused():
    """What is in front of a segment is then unknown."""
    job = job_of(ball(GRIDS["uniform"]()), MEDIUM, both_ways("first-order")[1])
    with pytest.raises(InputError, match="run to the observer"):
        gradient(job, WEIGHTS)


@pytest.mark.parametrize(("grid", "scheme"), pairs(SCHEMES))
def test_gradients_agree_on_every_kind_of_grid(grid, scheme):
    """Also where blocks are empty, steps are wide, levels jump, and cells have no value."""
    grid = GRIDS[grid]()
    for hidden in (0, grid.size):
        check_gradient(ball(grid, hidden=hidden), "shells", scheme, rtol=1e-4)


def light(tracer):
    """Return the light of all pixels."""
    lanes = whole_picture(tracer.job.frame.pixels, tracer.backend)
    path = tracer.march(tracer.ray(lanes)).path
    return dr.sum(sum(dr.select(lanes.there, n, 0.0) for n in path.emission))


CAMERAS = {
    "inclination": lambda x: vm.Orthographic(57 + x, 31, width=2.47, resolution=12),
    "azimuth": lambda x: vm.Orthographic(57, 31 + x, width=2.47, resolution=12),
    "width": lambda x: vm.Orthographic(57, 31, width=2.47 + x, resolution=12),
    "place": lambda x: vm.Perspective((2.1 + x, 1.3, 0.9), (0, 0.1, 0), 50, resolution=12),
}


@pytest.mark.parametrize(("grid", "scheme"), pairs(SCHEMES))
def test_the_light_of_a_picture_has_a_derivative_by_the_camera(grid, scheme):
    """In forward mode, by everything that rays follow from."""
    volume, medium = ball(GRIDS[grid]()), shells(MEDIA["shells"][1])
    # The default scheme's kernels take 5 s each to compile.
    names = ["azimuth"] if scheme == "post-classified" else CAMERAS
    for make in map(CAMERAS.get, names):

        def numbers(x, make=make):
            frame = make(x).frame(volume.grid)
            return np.array([*frame.vectors.reshape(-1), *frame.pixel, *frame.shift])

        job = job_of(volume, medium, scheme, camera=make(0.0))
        limits = limits_of(job)

        def plain(x, make=make, limits=limits):
            derivatives = limits is not None
            job = job_of(volume, medium, scheme, derivatives=derivatives, camera=make(x))
            return np.sum(picture(job, limits))

        tracer = tracer_like(job, limits)
        Wide, step = tracer.backend.Wide, 1e-5
        x = Wide(0.0)
        dr.enable_grad(x)
        *flat, dx, dy, left, low = [
            float(slope) * x + float(value)
            for value, slope in zip(numbers(0.0), central(numbers, 0.0, step), strict=True)
        ]
        tracer.vectors = [flat[k : k + 3] for k in range(0, len(flat), 3)]
        tracer.places = [[dx, left], [dy, low]]
        total = light(tracer) * tracer.source.channels.unit
        dr.forward(x)
        expected = central(plain, 0.0, step)
        # Rays that enter other cells make kinks; the cubics of curved cells jump by their error.
        np.testing.assert_allclose(dr.grad(total)[0], expected, rtol=1e-3, atol=1e-5)


@pytest.mark.parametrize(("grid", "scheme"), pairs(SCHEMES[:2]))
def test_the_light_of_a_picture_has_a_derivative_by_its_coefficients(grid, scheme):
    grid = GRIDS[grid]()
    volume = vm.Volume(grid, a=np.random.default_rng(0).uniform(0.1, 1, grid.shape))

    def at(factor):
        tracer = make_tracer(job_of(volume, MEDIUM, scheme), 0.0)
        tracer.source.packets = [packet * factor for packet in tracer.source.packets]
        return light(tracer)

    Float = get_backend("cpu", "double", derivatives=True).Float
    factor = Float(1.0)
    dr.enable_grad(factor)
    total = at(factor)
    dr.forward(factor)
    found = dr.grad(total)[0]
    expected = central(lambda x: at(Float(x))[0], 1.0, 1e-5)
    np.testing.assert_allclose(found, expected, rtol=1e-6)


@pytest.mark.parametrize(("grid", "scheme"), pairs(SCHEMES))
def test_pictures_with_and_without_derivatives_share_nothing(grid, scheme):
    """What is kept with volume and grid depends on the kind of arrays."""
    volume = ball(GRIDS[grid]())
    options = {"scheme": scheme, "precision": "double", "cutoff": 0.0}
    plain = vm.render(volume, MEDIUM, CAMERA, **options)
    recorded = run(job_of(volume, MEDIUM, scheme), 0.0).emission
    np.testing.assert_allclose(recorded, plain.intensity, atol=1e-3 * plain.intensity.max())
    again = vm.render(volume, MEDIUM, CAMERA, **options)
    np.testing.assert_array_equal(again.intensity, plain.intensity)


def log10(x):
    return DrjitOps(type(x)).log10(x)


def power(x):
    return DrjitOps(type(x)).power(x, type(x)(1.7))


# Functions of one argument, their derivatives, and where.
UP = np.array([1e-6, 0.1, 0.34, 0.36, 0.5, 3.0, 30.0])
FUNCTIONS = {
    "attenuation": (lambda x: functions.attenuation(x)[0], lambda x: -np.exp(-x), UP),
    "mean transparency": (
        lambda x: functions.attenuation(x)[1],
        lambda x: np.where(x < 1e-3, -0.5 + x / 3, (np.exp(-x) * (1 + x) - 1) / x**2),
        UP,
    ),
    "thin attenuation": (
        lambda x: functions.thin_attenuation(x)[0],
        lambda x: -np.exp(-x),
        UP[UP < functions.THIN],
    ),
    "decay": (functions.decay, lambda x: -np.exp(-x), UP),
    "logarithm": (log10, lambda x: 1 / (x * np.log(10)), np.array([1e-30, 0.3, 1.0, 7.0, 1e20])),
    "power": (power, lambda x: 1.7 * x**0.7, UP),
    "horner": (lambda x: functions.horner(x, [1.0, 2.0, 3.0]), lambda x: 2 + 6 * x, UP),
    "polynomial": (lambda x: functions.polynomial(x, [1.0, 2.0, 3.0]), lambda x: 2 + 6 * x, UP),
    "unit interval": (functions.unit_interval, lambda x: 1.0 * (x < 1), UP),
    "sharp angle": (
        lambda x: functions.sharp_angle(x, 0.0 * x + 1.0, dr.sqrt(1.0 + x * x)),
        lambda x: 1 / (1 + x * x),
        np.array([-0.9, -0.1, 0.2, 0.99]),
    ),
    "flush subnormal": (functions.flush_subnormal, lambda x: np.ones_like(x), UP),
}


@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions_have_derivatives(name, precision):
    """Those by bits and by fits, too: to a few roundings, and to the fits' 1e-6."""
    function, derivative, places = FUNCTIONS[name]
    x = get_backend("cpu", precision, derivatives=True).Float(places)
    dr.enable_grad(x)
    y = function(x)
    dr.forward(x)
    expected = derivative(np.asarray(dr.detach(x), np.float64))
    rtol = 3e-5 if precision == "single" else 1e-12
    np.testing.assert_allclose(dr.grad(y), expected, rtol=rtol, atol=1e-36)


def test_logarithms_by_bits_have_derivatives():
    Float = get_backend("cpu", "single", derivatives=True).Float
    x = Float([1e-30, 0.3, 1.0, 7.0, 1e20])
    dr.enable_grad(x)
    n, rest = functions.split_log(x)
    dr.forward(x)
    np.testing.assert_allclose(np.array(dr.grad(rest)) * np.array(x), 1.0, rtol=1e-6)
    np.testing.assert_allclose(n * np.log(2) + rest, np.log(np.array(x)), rtol=1e-6)
