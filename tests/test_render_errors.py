"""What cannot be rendered is refused beforehand, with the reason and the remedy."""

from __future__ import annotations

import contextlib
import re
import sys

import numpy as np
import pytest

import voluminous as vm
from voluminous.media import Medium

GRID = vm.CartesianGrid.uniform((3, 4, 5), (-1, 1))
CAMERA = vm.Orthographic(30, 40, resolution=8)
MEDIUM = vm.Coefficients("density", "density")


@pytest.fixture
def volume():
    return vm.Volume(GRID, density=np.ones(GRID.shape))


def refused(error, told, *arguments, **options):
    """Assert that a render raises an error that tells something."""
    with pytest.raises(error, match=told):
        vm.render(*arguments, **options)


def test_wrong_things_in_wrong_places(volume):
    refused(vm.InputError, "a vm.Volume first, got ndarray", np.ones(3), MEDIUM, CAMERA)
    refused(vm.InputError, "a medium .* second, got str", volume, "density", CAMERA)
    refused(vm.InputError, "a camera .* got int", volume, MEDIUM, 3)
    refused(vm.InputError, "a medium .* got Orthographic", volume, CAMERA, MEDIUM)


SAMPLES, CUTOFF = (
    "samples must be a whole number",
    "cutoff is the transparency at which a ray stops",
)
REFUSED = [
    ({"scheme": "second"}, "unknown scheme 'second'.*did you mean 'second-order'"),
    ({"device": "cup"}, "unknown device 'cup'.*did you mean 'cpu'"),
    ({"precision": "duble"}, "unknown precision 'duble'.*did you mean 'double'"),
    ({"antialias": "flux"}, "unknown antialias 'flux'"),
    ({"background": [1.0, 2.0]}, r"1 numbers .* got shape \(2,\)"),
    ({"background": np.ones((8, 7))}, r"shape \(8, 8\) or \(8, 8, 1\); got shape \(8, 7\)"),
    ({"background": np.ones((8, 8, 3))}, r"got shape \(8, 8, 3\)"),
    ({"background": np.nan}, "background must be finite"),
    ({"background": "blue"}, "must be numbers"),
    *(({"cutoff": cutoff}, CUTOFF) for cutoff in (-0.1, 1.0, 2, np.nan, "low", True + 1)),
    *(({"samples": n}, SAMPLES) for n in (0, -1, 1.5, True, 10**6, None, (2, 2))),
    ({"samples": "flux-conserving"}, "antialias='adaptive' takes more rays"),
    ({"samples": 2, "antialias": "adaptive"}, "not both"),
]


@pytest.mark.parametrize(("options", "told"), REFUSED)
def test_options_that_make_no_sense(volume, options, told):
    error = vm.errors.UnknownNameError if told.startswith("unknown") else vm.InputError
    refused(error, told, volume, MEDIUM, CAMERA, **options)
    assert issubclass(error, (KeyError, ValueError))


def test_unknown_fields_name_the_nearest(volume):
    for medium in (
        vm.Coefficients("densty", "density"),
        vm.Coefficients("density", ["log10(densty)"]),
        vm.Gaussian("densty", 1, 1, 1, 1, 1),
        MEDIUM + vm.Gaussian("densty", 1, 1, 1, 1, 1),
        vm.Medium.from_function(lambda d: (d, d), ["densty"], 1),
    ):
        refused(
            vm.errors.UnknownNameError, "'densty'.*did you mean 'density'", volume, medium, CAMERA
        )


SCHEMES = ["first-order", "second-order"]


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("expression", ["log10(density)", "sqrt(density - 0.5)", "1 / density"])
def test_coefficients_that_are_not_finite_name_their_first_cell(volume, scheme, expression):
    density = np.ones(GRID.shape)
    density[1, 2, 3] = density[2, 0, 0] = 0.0
    volume["density"] = density
    medium = vm.Coefficients(expression, "density")
    told = r"cannot be used in 2 cells.*first is \(1, 2, 3\).*where density = 0"
    refused(vm.InputError, told, volume, medium, CAMERA, scheme=scheme)
    refused(ValueError, "clip the fields", volume, medium, CAMERA, scheme=scheme)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_negative_extinction_is_refused_and_negative_emissivity_is_not(volume, scheme):
    medium = vm.Coefficients("density", ["0.5 - x"])
    refused(
        vm.InputError, "extinction of channel 0 is -0.166", volume, medium, CAMERA, scheme=scheme
    )
    signed = vm.render(volume, vm.Coefficients("-density", "0*x"), CAMERA, scheme=scheme)
    assert signed.intensity.min() < -1


def test_a_medium_evaluated_on_the_ray_is_looked_at_afterwards(volume, monkeypatch):
    monkeypatch.setattr("voluminous.rendering.sources.table.fits", lambda needed: False)
    for medium in (vm.Coefficients("density", "0.5 - x"), vm.Coefficients("log(x)", "density")):
        told = "not finite: .* or a negative extinction"
        refused(vm.InputError, told, volume, medium, CAMERA, scheme="first-order")


def test_flux_conservation_of_far_too_large_pixels(volume):
    camera = vm.Orthographic(width=1e6, resolution=2)
    told = "needs .* rays per pixel here"
    refused(vm.InputError, told, volume, MEDIUM, camera, antialias="radmc3d")


def test_memory_is_asked_for_beforehand(volume, monkeypatch):
    monkeypatch.setattr("voluminous.memory.available_memory", lambda: 1000)
    with pytest.raises(vm.errors.MemoryNeededError, match="scheme 'second-order' needs") as caught:
        vm.render(volume, MEDIUM, CAMERA, scheme="second-order")
    needed, free = map(int, re.findall(r"(\d+) bytes", str(caught.value)))
    # Two numbers of four bytes at each of 4 x 5 x 6 vertices, and what classifying takes.
    assert needed >= 2 * 4 * 4 * 5 * 6
    assert free == 1000
    assert "first-order" in str(caught.value)
    assert isinstance(caught.value, MemoryError)
    # First order does without a table.
    assert vm.render(volume, MEDIUM, CAMERA, scheme="first-order").intensity.max() > 0


@pytest.mark.parametrize(
    ("function", "told"),
    [
        (lambda d: d, r"must return \(emissivity, extinction\), got"),
        (lambda d: None, r"must return \(emissivity, extinction\), got NoneType"),
        (lambda d: (d, d, d), r"must return \(emissivity, extinction\)"),
        (lambda d: ([d, d], d), "returned 2 values of emissivity, expected 1"),
        (lambda d: (d, [d, d]), "returned 2 values of extinction, expected 1"),
    ],
)
def test_functions_that_return_something_else(volume, function, told):
    medium = vm.Medium.from_function(function, ["density"], channels=1)
    refused(vm.InputError, told, volume, medium, CAMERA)


def test_functions_that_fail_raise_their_own_error(volume):
    medium = vm.Medium.from_function(lambda d: 1 / 0, ["density"], channels=1)
    refused(ZeroDivisionError, "division", volume, medium, CAMERA)


class Fails(Medium):
    """A medium whose coefficients cannot be traced."""

    channels, grey, names = 1, True, ("density",)

    def __init__(self, error):
        self.error = error

    def ranges(self, fields, context):
        return MEDIUM.ranges(fields, context)

    def coefficients(self, fields, context):
        raise self.error

    def key(self):
        return None


@pytest.mark.parametrize("scheme", ["first-order", "second-order", "post-classified"])
@pytest.mark.parametrize(
    "error", [KeyboardInterrupt, SystemExit, ValueError, vm.InputError, RuntimeError]
)
def test_what_is_raised_while_a_kernel_is_traced_is_raised(volume, scheme, error):
    """Dr.Jit wraps it in a RuntimeError for each loop that is being recorded."""
    raised, cause = error("stop"), OSError("why")
    raised.__cause__ = cause
    with pytest.raises(error, match="stop") as caught:
        vm.render(volume, Fails(raised), CAMERA, scheme=scheme)
    assert caught.value is raised
    assert raised.__cause__ is cause


SHELL = vm.Gaussian("density", 0.5, 0.1, (1, 0.5, 0.2), 0.5, 0.1)
POINTS = np.random.default_rng(2).random((60, 3))
CURVED = vm.SphericalGrid(np.linspace(0.2, 1, 5), np.linspace(0, 3, 5), np.linspace(0, 6, 5))
VERBS = {
    "render": lambda v: vm.render(v, SHELL, CAMERA).intensity,
    "second order": lambda v: vm.render(v, MEDIUM, CAMERA, scheme="second-order").intensity,
    "bounds": lambda v: vm.render(v, SHELL, CAMERA, bounds=True).upper,
    "in pieces": lambda v: vm.render(v, SHELL, CAMERA, memory="1 GiB").intensity,
    "fluxes": lambda v: vm.render(v, MEDIUM, CAMERA, antialias="radmc3d").intensity,
    "column": lambda v: vm.column(v, "density", CAMERA).intensity,
    "exact column": lambda v: vm.column(v, "density", CAMERA, method="exact").intensity,
    "maximum": lambda v: vm.project(v, "density", CAMERA, "max").intensity,
    "probe": lambda v: np.array([vm.probe(v, MEDIUM, CAMERA, (4, 4)).tau]),
}
KINDS = {
    "uniform": lambda: filled(vm.CartesianGrid.uniform(6, (0, 1))),
    "particles": lambda: vm.Volume.from_particles(POINTS, np.ones(60)),
    "spherical": lambda: filled(CURVED),
}


def filled(grid):
    return vm.Volume(grid, density=np.random.default_rng(1).random(grid.shape) + 0.1)


@contextlib.contextmanager
def interrupted(moment=sys.maxsize):
    """Press Ctrl-C when a number of functions have been called; count them."""
    calls = [0]

    def profile(frame, event, argument):
        # What a generator that is closed raises is lost in Python.
        calls[0] += event == "call" and frame.f_code.co_name != "<genexpr>"
        if calls[0] == moment:
            sys.setprofile(None)
            raise KeyboardInterrupt

    sys.setprofile(profile)
    try:
        yield calls
    finally:
        sys.setprofile(None)


def check_interrupts(verb, kind, count):
    expected, volume = VERBS[verb](KINDS[kind]()), KINDS[kind]()
    with interrupted() as calls:
        VERBS[verb](volume)
    # Not the last ones: how many there are depends on what is in caches.
    for moment in np.linspace(1, 0.9 * calls[0], count).astype(int):
        volume = KINDS[kind]()
        with pytest.raises(KeyboardInterrupt), interrupted(moment):
            VERBS[verb](volume)
        np.testing.assert_array_equal(VERBS[verb](volume), expected)


@pytest.mark.parametrize("verb", VERBS)
def test_ctrl_c_takes_effect_at_any_moment_and_the_next_picture_is_right(verb):
    check_interrupts(verb, "uniform", 20)


@pytest.mark.parametrize("kind", ["particles", "spherical"])
def test_ctrl_c_takes_effect_where_grids_need_loops_of_their_own(kind):
    check_interrupts("render", kind, 20)


@pytest.mark.exhaustive
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("verb", VERBS)
def test_ctrl_c_at_many_moments(verb, kind):
    if kind == "spherical" and verb in ("in pieces", "exact column"):
        pytest.skip("refused on such a grid")
    check_interrupts(verb, kind, 100)


def test_progress_may_cancel_and_the_next_render_is_unharmed(volume):
    class Enough(Exception):
        """Raised by whoever watches."""

    def stop(done, total):
        raise Enough

    refused(Enough, None, volume, MEDIUM, CAMERA, progress=stop)
    assert vm.render(volume, MEDIUM, CAMERA).intensity.max() > 0


def test_progress_ends_with_everything(volume):
    reports = []
    vm.render(volume, MEDIUM, CAMERA, samples=2, progress=lambda *report: reports.append(report))
    done, total = reports[-1]
    assert done == total > 0
    fractions = [d / t for d, t in reports]
    assert fractions == sorted(fractions)


def test_ratios_are_finite_beside_a_vacuum():
    # Beside a vacuum both fields fall to zero in one place; rounding lets the lower one be first.
    rng = np.random.default_rng(5)
    n, t = rng.random((2, 12, 12, 12)).astype(np.float32)
    n[(hole := rng.random(n.shape) < 0.5)] = 0
    t[hole] = 0
    volume = vm.Volume(vm.CartesianGrid.uniform(12, (-1, 1)), n=n, t=t)
    medium = vm.Coefficients("where(n > 0, n / t, 0)", 0.1)
    camera = vm.Orthographic(33, 21, resolution=64)
    image = vm.render(volume, medium, camera)
    assert np.isfinite(image.intensity).all()
    double = vm.render(volume, medium, camera, precision="double")
    top = double.intensity.max()
    assert np.quantile(np.abs(image.intensity - double.intensity), 0.99) < 1e-3 * top


AROUND = {
    "x": (vm.CylindricalGrid([0, 1, 2], [0, 2 * np.pi], [-1, 1]), r"volume\.unfolded\(phi=64\)"),
    "phi": (vm.SphericalGrid([1, 2], [0.5, 1.0, 2.0]), r"volume\.unfolded\(phi=64\)"),
    "theta": (vm.SphericalGrid([1, 2]), r"volume\.unfolded\(phi=64\)"),
    "z": (
        vm.SphericalGrid([1, 2], [0.5, np.pi / 2], np.linspace(0, 6.28, 9), mirror=True),
        r"volume\.unfolded\(\)",
    ),
}


@pytest.mark.parametrize("scheme", ["first-order", "second-order"])
@pytest.mark.parametrize("name", AROUND)
def test_coordinates_that_differ_within_cells_need_a_scheme_that_knows_places(name, scheme):
    grid, advice = AROUND[name]
    medium = vm.Coefficients("a", 0.1) + vm.Gaussian("a", 1, 1, (1,), 0.1, where=f"{name} > 0.7")
    told = f"'{name}' differs within a cell .* use scheme='post-classified'.*{advice}"
    refused(vm.InputError, told, vm.Volume(grid, a="1"), medium, CAMERA, scheme=scheme)


def test_a_disc_of_cells_all_around_is_cut_open_where_places_are_known():
    disc = vm.Volume(vm.CylindricalGrid([0, 1, 2], [0, 2 * np.pi], [-1, 1]), a="1")
    medium = vm.Coefficients("where(x > 0, a, 0)", 0)
    camera = vm.Orthographic(0, 0, width=3.9, resolution=40)
    image = vm.render(disc, medium, camera)
    # Through the disc, which is 2 thick, on one side.
    inside = np.hypot(*np.meshgrid(image.x, image.y)) < 1.9
    right = np.broadcast_to(image.x > 0, inside.shape)
    seen = image.intensity[..., 0]
    np.testing.assert_allclose(seen[inside & right], 2.0, rtol=1e-3)
    assert (seen[inside & ~right] == 0).all()
    for scheme in ("first-order", "post-classified"):
        whole = vm.render(disc.unfolded(phi=64), medium, camera, scheme=scheme)
        # Cells whose middle is just beyond count as wholes there.
        assert abs(whole.intensity.mean() / image.intensity.mean() - 1) < 0.02


@pytest.mark.parametrize(
    "medium",
    [
        vm.Coefficients("1", "-d"),
        vm.Medium.from_function(lambda d: (np.sin(d), -d), fields=["d"], channels=1),
        vm.Coefficients("1", "0.2 - d"),
    ],
)
def test_negative_extinctions_are_refused_before_long(medium):
    # Panels were halved 14 times wherever there is one: it took minutes.
    volume = vm.Volume(vm.CartesianGrid.uniform(16, (-1, 1)), d="exp(-r*r/0.1)")
    camera = vm.Orthographic(60, 30, resolution=20)
    refused(vm.InputError, "not finite.* or a negative extinction", volume, medium, camera)
