"""Where media jump and where surfaces without width are: panels end there."""

from __future__ import annotations

import math

import numpy as np
import pytest

import voluminous as vm
from panels import panel_of
from voluminous.backend import get_backend
from voluminous.expressions import Expression
from voluminous.media.jumps import Jump, first_jump, jumps_ahead

# Rounding of places, and of what is added up; in double the tolerance of 1e-6 counts.
EXACT = {"single": 2e-5, "double": 2e-7}
CENTER, SIGMA, LEVEL = 0.1, 0.15, 0.17


def line():
    """Return a volume in which a is the place along x, and a camera that looks along it."""
    volume = vm.Volume(vm.CartesianGrid.uniform((40, 1, 1), (-1, 1)))
    volume["a"], volume["b"] = "x", "abs(x)"
    return volume


def camera(incl=90, phi=90):
    return vm.Orthographic(incl, phi, width=0.5, resolution=1)


def seen_from_above(volume):
    """Return a camera for which a falls along the ray."""
    falling = vm.probe(volume, vm.Coefficients("a", 0), camera(), (0, 0), scheme="first-order")
    first, last = np.asarray(falling.j)[[0, -1], 0]
    return camera() if first > last else camera(phi=-90)


def shell(depth, **options):
    return vm.Gaussian("a", CENTER, SIGMA, (0.7,), depth, 1.0, **options)


def depth_between(low, high, depth):
    """Return the optical depth of the shell between two places."""
    ends = [math.erf((x - CENTER) / (SIGMA * math.sqrt(2))) for x in (low, high)]
    return depth * SIGMA * math.sqrt(math.pi / 2) * (ends[1] - ends[0])


def glow(low, high, depth):
    """Return what the shell emits and lets through between two places."""
    tau = depth_between(low, high, depth)
    return 0.7 / depth * -math.expm1(-tau), math.exp(-tau)


@pytest.mark.parametrize("precision", EXACT)
@pytest.mark.parametrize("depth", [0.1, 3.0, 40.0])
def test_a_surface_in_a_shell_is_where_it_is(depth, precision):
    """Half of the shell in front, the surface, the other half: in closed form."""
    volume, opacity = line(), 0.6
    medium = shell(depth) + vm.Isosurface("a", LEVEL, (0.2,), opacity)
    image = vm.render(volume, medium, seen_from_above(volume), precision=precision, tolerance=1e-6)
    (front, through), (back, _) = glow(LEVEL, 1, depth), glow(-1, LEVEL, depth)
    expected = front + through * (0.2 * opacity + (1 - opacity) * back)
    assert image.intensity.item() == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("precision", EXACT)
@pytest.mark.parametrize(
    ("gate", "parts"),
    [
        ("a > 0.17", [(0.17, 1)]),
        ("b < 0.17", [(-0.17, 0.17)]),
        ("(a < -0.05) or (0.1 <= a < 0.2)", [(-1, -0.05), (0.1, 0.2)]),
        ("not (a > 0.11)", [(-1, 0.11)]),
    ],
)
def test_a_shell_behind_a_gate_is_a_part_of_it(gate, parts, precision):
    volume, depth = line(), 3.0
    image = vm.render(
        volume, shell(depth, where=gate), camera(), precision=precision, tolerance=1e-6
    )
    tau = sum(depth_between(low, high, depth) for low, high in parts)
    assert image.optical_depth.item() == pytest.approx(tau, rel=EXACT[precision] * 5)


def test_the_first_of_several_surfaces_in_a_cell_hides_the_others():
    volume = vm.Volume(vm.CartesianGrid.uniform((2, 1, 1), (-1, 1)), a=[[[0.0]], [[1.0]]])
    levels, colors = [0.2, 0.6, 0.9, 0.4], [(1.0, 0, 0), (0, 1.0, 0), (0, 0, 1.0), (1.0, 1.0, 0)]
    medium = vm.Isosurface("a", level=levels, color=colors, opacity=1.0)
    above, below = seen_from_above(volume), camera(phi=-seen_from_above(volume).phi)
    for view, expected in ((above, (0, 0, 1)), (below, (1, 0, 0))):
        found = vm.render(volume, medium, view).intensity[0, 0]
        np.testing.assert_allclose(found, expected, atol=1e-6)
        lit = vm.Isosurface(
            "a", level=levels, color=colors, opacity=1.0, shading=0.5
        ) + vm.Gaussian("a", 5.0, 0.1, (1.0, 1, 1), 1.0, 1.0)
        found = vm.render(volume, lit, view).intensity[0, 0]
        np.testing.assert_allclose(found, expected, atol=1e-6)


@pytest.mark.parametrize("precision", EXACT)
def test_edges_are_counted_and_the_first_is_found(precision):
    """a = s, b = 4 (s - ½)²: at ¼ and ¾ it is a quarter."""
    rows = {"a": [[0.0], [1.0]], "b": [[1.0], [-4.0], [4.0]]}
    backend = get_backend("cpu", precision)
    panel, number = panel_of(backend, **rows), backend.opaque
    a, b = (Expression(n) for n in "ab")
    cases = [
        ([Jump(a, number(0.6)), Jump(a, number(0.3))], 2, 0.3),
        ([Jump(a, number(0.6)), Jump(b, number(0.25))], 3, 0.25),
        ([Jump(a, number(0.1)), Jump(b, number(0.25))], 3, 0.1),
        ([Jump(a, number(1.6))], 0, 1.0),
    ]
    for edges, count, place in cases:
        found, unresolved = jumps_ahead(panel, edges)
        assert found.numpy().item() == count
        assert not unresolved.numpy().item()
        first = first_jump(panel, edges).numpy().item()
        assert first == pytest.approx(place, abs=EXACT[precision])
    # Both ends and the middle show none of it.
    count, unresolved = jumps_ahead(panel, [Jump(Expression("4*a*a - 4*a"), number(-0.999))])
    assert unresolved.numpy().item() or count.numpy().item() == 2


def noise(shape, seed):
    rng = np.random.default_rng(seed)
    grid = vm.CartesianGrid.uniform(shape, (-1, 1))
    return vm.Volume(grid, **{n: rng.normal(size=shape).astype(np.float32) for n in "abc"})


def trilinear(field, places):
    """Return a field between the centres of cells on -1 … 1, as it is beyond the outermost."""
    n = len(field)
    at = np.clip((places + 1) * n / 2 - 0.5, 0, n - 1)
    low = np.minimum(at.astype(int), n - 2)
    total = 0.0
    for corner in np.ndindex(2, 2, 2):
        weight = np.prod(np.where(corner, at - low, 1 - at + low), axis=-1)
        total = total + weight * field[tuple((low + corner).T)].astype(float)
    return total


def summed(volume, pixel, view, coefficients, count=4000):
    """Return what one ray gathers, by many small steps from front to back (grey, one channel)."""
    ray = vm.probe(volume, vm.Coefficients(1, 0), view, pixel, scheme="first-order", cutoff=0)
    middles = np.asarray(ray.position)
    way = middles[-1] - middles[0]
    way /= np.linalg.norm(way)
    start = middles[0] - 0.5 * (ray.end[0] - ray.begin[0]) * way
    length = float(ray.end[-1] - ray.begin[0])
    steps = count * len(middles)
    places = start + (np.arange(steps) + 0.5)[:, None] * (length / steps) * way
    fields = {n: trilinear(volume.array(n), places) for n in "abc"}
    j, alpha = coefficients(fields)
    tau = alpha * length / steps
    front = np.exp(-np.concatenate([[0.0], np.cumsum(tau)[:-1]]))
    return float(np.sum(front * j * length / steps))


@pytest.mark.parametrize("precision", EXACT)
def test_gates_in_noise_agree_with_many_small_steps(precision):
    volume, view = noise((8, 8, 8), 3), vm.Orthographic(37, 23, width=2.0, resolution=7)

    def coefficients(fields):
        shape = np.exp(-0.5 * ((fields["a"] - 0.3) / 0.4) ** 2) / 0.3
        gate = (fields["b"] > 0) & (fields["c"] ** 2 < 1) | (fields["a"] > fields["b"])
        return shape * gate, 3.0 * shape * gate

    options = {"precision": precision, "tolerance": 1e-5}
    gate = "(b > 0) & (c*c < 1) | (a > b)"
    medium = vm.Gaussian("a", 0.3, 0.4, (1.0,), 3.0, 0.3, where=gate)
    image = vm.render(volume, medium, view, **options)
    # Steps of a 4000th of a cell are off by half of one at each jump.
    for pixel in ((3, 3), (2, 4), (5, 1)):
        exact = summed(volume, pixel, view, coefficients)
        found = image.intensity[pixel[1], pixel[0], 0]
        assert found == pytest.approx(exact, abs=5e-4)
