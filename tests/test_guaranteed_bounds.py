"""Guaranteed bounds: the truth, by brute force, is inside them in every pixel and channel.

The twin knows nothing of panels: it samples rays at thousands of points, with a midpoint rule. How
far off it is itself is told by the same rule with half as many points.
"""

from __future__ import annotations

import functools
import math

import numpy as np
import pytest

import voluminous as vm
from voluminous.backend import from_host, get_backend
from voluminous.errors import InputError

POINTS = 24000
TOLERANCE = 1e-3
COLOR = np.array([1.0, 0.5, 0.2])


def rays(camera, grid):
    """Return origins and directions of all pixels, as NumPy arrays (pixel, 3)."""
    frame, backend = camera.frame(grid), get_backend("cpu", "double")
    nx, ny = frame.pixels
    row, column = np.divmod(np.arange(nx * ny), nx)
    u = (column - 0.5 * (nx - 1)) * frame.pixel[0] + frame.shift[0]
    v = (row - 0.5 * (ny - 1)) * frame.pixel[1] + frame.shift[1]
    vectors = [[backend.wide(c) for c in vector] for vector in frame.vectors]
    found = camera.rays(vectors, from_host(backend.Wide, u), from_host(backend.Wide, v))
    return tuple(
        np.stack([np.broadcast_to(np.asarray(c), u.shape) for c in part], axis=-1)
        for part in (found.origin, found.direction)
    )


class Samples:
    """All fields at evenly spaced points of all rays, between the faces of the volume."""

    def __init__(self, volume, camera, points=POINTS):
        origin, direction = rays(camera, volume.grid)
        with np.errstate(divide="ignore", invalid="ignore"):
            walls = (volume.grid.bounds.T - origin[:, None]) / direction[:, None]
        first = np.nanmax(walls.min(axis=1), axis=1)
        self.length = np.maximum(np.nanmin(walls.max(axis=1), axis=1) - first, 0.0)
        f = (np.arange(points) + 0.5) / points
        t = first[:, None] + self.length[:, None] * f
        self.fields = {a: origin[:, [k]] + t * direction[:, [k]] for k, a in enumerate("xyz")}
        place = [self.fields[a] for a in "xyz"]
        for name in volume.fields:
            self.fields[name] = trilinear(volume.array(name), volume.grid.edges, place)

    def integrals(self, medium, every=1):
        """Return emission (pixel, channel) and transparency, from j and α of the fields."""
        fields = {name: values[:, every // 2 :: every] for name, values in self.fields.items()}
        j, alpha = medium(fields)
        step = self.length[:, None] / j[0].shape[1]
        depth = np.cumsum(alpha * step, axis=1)
        through = np.exp(-(depth - alpha * step))
        own = np.where(alpha > 0, -np.expm1(-alpha * step) / np.where(alpha > 0, alpha, 1), step)
        return np.stack([(c * own * through).sum(axis=1) for c in j], axis=-1), np.exp(
            -depth[:, -1]
        )


def trilinear(values, edges, place):
    """Return values between cell centres; constant beyond the outermost."""
    low, part = [], []
    for walls, x in zip(edges, place, strict=True):
        centers = 0.5 * (walls[1:] + walls[:-1])
        x = np.clip(x, centers[0], centers[-1])
        i = np.clip(np.searchsorted(centers, x) - 1, 0, len(centers) - 2)
        low.append(i)
        part.append((x - centers[i]) / (centers[i + 1] - centers[i]))
    total = 0.0
    for corner in np.ndindex(2, 2, 2):
        weight = math.prod(f if c else 1 - f for f, c in zip(part, corner, strict=True))
        total = total + weight * values[tuple(i + c for i, c in zip(low, corner, strict=True))]
    return total


def truth_of(samples, medium):
    """Return brute force, and what that may be off by."""
    truth, half = (samples.integrals(medium, every)[0] for every in (1, 2))
    # A midpoint rule converges at least linearly, with noise at jumps.
    slack = 3 * np.abs(truth - half).max() + 1e-12 * np.abs(truth).max()
    assert slack < 2 * TOLERANCE * np.abs(truth).max()  # else a test would say little
    return truth, slack


def assert_inside(image, found):
    """Compare with brute force, up to what that may be off by."""
    truth, slack = found
    truth = truth.reshape(image.shape)
    assert np.all(image.lower <= truth + slack)
    assert np.all(image.upper >= truth - slack)


def gaussian(x, center, sigma):
    return np.exp(-0.5 * ((x - center) / sigma) ** 2)


def shell(shape, color, opacity, length):
    return [c * shape / length for c in color], opacity * shape / length


def painted(x, cmap, low, high):
    import matplotlib

    position = np.linspace(0, 1, 256)
    rgb = matplotlib.colormaps[cmap](position)[:, :3]
    return [np.interp(x, low + (high - low) * position, column) for column in rgb.T]


NODES = [0.0, 1.0, 1.0, 1.5, 3.0]
COLORS = np.array([[0, 0, 0], [1, 0.5, 0], [0.2, 1, 0], [0, 1, 0], [1, 1, 1]])
OPACITIES = np.array([0, 1, 0.5, 0.1, 2])


def two_shells(f):
    first = shell(gaussian(np.log10(f["density"]), 0.2, 0.05), COLOR, 2.0, 0.3)
    second = shell(gaussian(f["density"], 1.0, 0.3), [0, 0.5, 0.8], 5.0, 0.1)
    return [a + b for a, b in zip(first[0], second[0], strict=True)], first[1] + second[1]


def tabulated(f):
    columns = [
        [np.interp(f["density"], NODES, c) for c in COLORS.T],
        np.interp(f["density"], NODES, OPACITIES),
    ]
    return [c / 0.3 for c in columns[0]], columns[1] / 0.3


def gated(f):
    gate = (f["weight"] > 0.4) * 1.0
    j, alpha = shell(gaussian(f["density"], 1.0, 0.3), COLOR, 2.0, 0.3)
    return [gate * c for c in j], gate * alpha


def colored(f):
    shape = gaussian(f["density"], 1.0, 0.2) / 0.3
    return [shape * c for c in painted(f["weight"], "viridis", 0.1, 0.9)], 3.0 * shape


X = "density"
THIN = vm.Gaussian("log10(density)", 0.2, 0.05, COLOR, 2.0, 0.3)
MEDIA = {
    "wide": (
        vm.Gaussian("density", 1.0, 3.0, COLOR, 2.0, 0.5),
        lambda f: shell(gaussian(f[X], 1.0, 3.0), COLOR, 2.0, 0.5),
    ),
    "rectangle": (
        vm.Rectangle("log(density)", 0.2, 0.3, COLOR, 2.0, 0.3),
        lambda f: shell((np.abs(np.log(f[X]) - 0.2) <= 0.3) * 1.0, COLOR, 2.0, 0.3),
    ),
    "pair": (THIN + vm.Gaussian("density", 1.0, 0.3, [0, 0.5, 0.8], 5.0, 0.1), two_shells),
    "signed": (
        vm.Coefficients(["weight - 0.5", "sin(9 * x)", "-density"], "density"),
        lambda f: ([f["weight"] - 0.5, np.sin(9 * f["x"]), -f[X]], f[X]),
    ),
    "covered": (
        vm.Coefficients(["density * weight ** 9", "(weight - 0.5) ** 3", "1 - x"], "40 * weight"),
        lambda f: (
            [f[X] * f["weight"] ** 9, (f["weight"] - 0.5) ** 3, 1 - f["x"]],
            40 * f["weight"],
        ),
    ),
    "table": (vm.Table("density", NODES, COLORS, OPACITIES, 0.3), tabulated),
    "colormap": (
        vm.Colormap("weight", "viridis", 0.1, 0.9, 0.5, 0.3),
        lambda f: (
            [0.5 * c / 0.3 for c in painted(f["weight"], "viridis", 0.1, 0.9)],
            0.5 / 0.3 + 0 * f[X],
        ),
    ),
    "gated": (vm.Gaussian("density", 1, 0.3, COLOR, 2.0, 0.3, where="weight > 0.4"), gated),
    "colored": (
        vm.Gaussian("density", 1, 0.2, vm.ColorBy("weight", "viridis", 0.1, 0.9), 3.0, 0.3),
        colored,
    ),
}


@functools.cache
def volume():
    rng = np.random.default_rng(1)
    grid = vm.CartesianGrid(*(np.linspace(-1, 1, n + 1) for n in (7, 8, 9)))
    shape = (7, 8, 9)
    return vm.Volume(grid, density=np.exp(rng.normal(size=shape)), weight=rng.random(shape))


@functools.cache
def camera():
    return vm.Orthographic(33, 41, width=1.9, resolution=9)


@functools.cache
def samples():
    return Samples(volume(), camera())


@functools.cache
def truth(name):
    return truth_of(samples(), MEDIA[name][1])


@pytest.mark.each_value_once
@pytest.mark.parametrize("name", MEDIA)
def test_the_truth_is_inside_and_the_bracket_is_narrow(name):
    medium, _ = MEDIA[name]
    image = vm.render(volume(), medium, camera(), bounds=True, tolerance=TOLERANCE)
    assert_inside(image, truth(name))
    brightest = np.abs(image.intensity).max()
    assert np.max(image.upper - image.lower) <= 1.001 * TOLERANCE * brightest
    coarse = vm.render(volume(), medium, camera(), bounds=True, max_panels=1, tolerance=TOLERANCE)
    assert_inside(coarse, truth(name))


@pytest.mark.parametrize("name", ["pair", "table"])
def test_a_spent_budget_widens_and_never_lies(name):
    medium, _ = MEDIA[name]
    gaps = []
    for budget in (1, 8, 64):
        image = vm.render(volume(), medium, camera(), bounds=True, max_panels=budget)
        assert_inside(image, truth(name))
        gaps.append(np.max(image.upper - image.lower))
    assert gaps[0] > 1.5 * gaps[1] > 4 * gaps[2]


@pytest.mark.parametrize("name", ["wide", "signed", "pair"])
def test_bounds_are_of_pixels_and_what_is_behind(name):
    """Means over sub-pixels, and backgrounds of either sign, are bounded like the rest."""
    medium, formula = MEDIA[name]
    view = vm.Orthographic(20, 30, width=1.9, resolution=6)
    fine = vm.Orthographic(20, 30, width=1.9, resolution=12)
    behind = np.array([2.0, -1.0, 0.0])
    image = vm.render(volume(), medium, view, bounds=True, samples=2, background=behind)
    emission, through = Samples(volume(), fine, 6000).integrals(formula)
    truth = (emission + through[:, None] * behind).reshape(6, 2, 6, 2, 3).mean(axis=(1, 3))
    slack = 1e-3 * np.abs(truth).max()  # of the twin, with a quarter of the points
    assert np.all(image.lower <= truth + slack)
    assert np.all(image.upper >= truth - slack)
    assert np.max(image.upper - image.lower) <= 1e-2 * np.abs(truth).max()


@pytest.mark.parametrize("opacity", [0.0, 0.3, 1.0])
def test_an_isosurface_shows_what_its_crossings_show(opacity):
    medium = vm.Isosurface("density", 1.0, COLOR, opacity)
    image = vm.render(volume(), medium, camera(), bounds=True)
    above = samples().fields["density"] >= 1.0
    crossings = np.count_nonzero(above[:, 1:] ^ above[:, :-1], axis=1)
    truth = ((1 - (1 - opacity) ** crossings)[:, None] * COLOR).reshape(image.shape)
    assert np.all(image.lower <= truth + 1e-14)
    assert np.all(image.upper >= truth - 1e-14)
    # How often a level is crossed is known exactly, unless a ray only just touches it.
    assert np.median(image.upper - image.lower) < 1e-9


def ramp(cells=6):
    grid = vm.CartesianGrid.uniform((1, 1, cells), [(0, 1), (0, 1), (0, 1)])
    volume = vm.Volume(grid)
    volume["x1"] = "z"
    return volume, vm.Orthographic(width=0.5, resolution=1)


@pytest.mark.parametrize(("sigma", "tau"), [(0.01, 0.0), (0.01, 3.0), (0.3, 1.0), (0.02, 100.0)])
def test_a_gaussian_on_a_ramp_is_exact_in_one_panel(sigma, tau):
    """x is linear and j/α constant: b = S (1 - e^{-τ}), and τ is an error function."""
    data, view = ramp()
    medium = vm.Gaussian("x1", 0.5, sigma, 1.0, tau, 1.0)
    image = vm.render(data, medium, view, bounds=True, max_panels=1)
    half = 0.5 - 1 / 12  # beyond the outermost centres x is constant
    area = sigma * math.sqrt(2 * math.pi) * math.erf(half / sigma / math.sqrt(2))
    area += math.exp(-0.5 * (half / sigma) ** 2) / 6
    truth = area if tau == 0 else -math.expm1(-tau * area) / tau
    assert image.lower.item() <= truth <= image.upper.item()
    # As close as error functions and exponentials are known, times some panels.
    assert image.upper.item() - image.lower.item() < 1e-9 * truth


def test_empty_space_is_bounded_too():
    """A small ball in a large box: most blocks are leapt over, and count in the upper bound."""
    data = vm.Volume(vm.CartesianGrid.uniform(40, (-1, 1)))
    data["d"] = "r"
    medium = vm.Gaussian("d", 0.0, 0.05, 1.0, 2.0, 0.1)
    view = vm.Orthographic(10, 20, width=1.9, resolution=12)
    image = vm.render(data, medium, view, bounds=True)

    def formula(f):
        return shell(gaussian(f["d"], 0.0, 0.05), [1.0], 2.0, 0.1)

    assert_inside(image, truth_of(Samples(data, view, 8000), formula))


def test_functions_that_cannot_be_read_have_no_bounds():
    medium = vm.Medium.from_function(lambda d: (vm.math.erf(d), d), "density", 1)
    with pytest.raises(InputError, match="nothing is known of the range"):
        vm.render(volume(), medium, camera(), bounds=True)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"bounds": 64}, "bounds=True, max_panels=64"),
        ({"bounds": True, "max_panels": 0}, "whole number from 1"),
        ({"bounds": True, "scheme": "second-order"}, "scheme='post-classified'"),
        ({"bounds": True, "antialias": "adaptive"}, "leave out antialias"),
    ],
)
def test_what_cannot_be_bounded_is_refused(options, message):
    with pytest.raises(InputError, match=message):
        vm.render(volume(), MEDIA["wide"][0], camera(), **options)
