"""Shading: emission modulated by the direction of gradients, in the light of several lamps."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import voluminous as vm
from voluminous.backend import get_backend

GRID = vm.CartesianGrid.uniform(32, (-1, 1))
BALL = vm.Volume(GRID)
BALL["rad"] = "sqrt(x**2 + y**2 + z**2)"
RAMP = vm.Volume(GRID)
RAMP["a"] = "x + 2 * y + 3 * z"
CAMERA = vm.Orthographic(60, 30, width=0.5, resolution=9)
MEDIA = {
    "gaussian": lambda expr, **how: vm.Gaussian(expr, 0.6, 0.1, (1, 0.5, 0.2), 3, 0.2, **how),
    "rectangle": lambda expr, **how: vm.Rectangle(expr, 0.6, 0.2, (1, 0.5, 0.2), 3, 0.2, **how),
    "table": lambda expr, **how: vm.Table(
        expr, [0.4, 0.6, 0.8], [[0] * 3, [1, 0.5, 0.2], [0] * 3], [0, 3, 0], 0.2, **how
    ),
    "colormap": lambda expr, **how: vm.Colormap(expr, "viridis", 0, 1, 3, 0.2, **how),
    "painted": lambda expr, **how: vm.Gaussian(
        expr, 0.6, 0.1, vm.ColorBy(expr, "viridis", 0, 1), 3, 0.2, **how
    ),
}
SCHEMES = [
    {"tolerance": 1e-3},
    {"tolerance": None},
    {"scheme": "first-order"},
    {"scheme": "second-order"},
]


LIGHTS = {"head": None, "x": [(1, 0, 0)], "two": ["headlight", ((0, 0, 1), 3)]}


def lit():
    """Yield lights, media and schemes: two lights on every medium, every scheme with one medium."""
    for lights, kind, k in itertools.product(LIGHTS, MEDIA, range(len(SCHEMES))):
        usual = k in (0, 2) if lights == "two" or kind == "gaussian" else False
        usual |= lights == "two" and kind == "gaussian"
        marks = [] if usual else pytest.mark.exhaustive
        yield pytest.param(LIGHTS[lights], kind, SCHEMES[k], marks=marks, id=f"{lights}-{kind}-{k}")


@pytest.mark.each_value_once
@pytest.mark.parametrize(("lights", "kind", "how"), lit())
def test_a_linear_field_is_lit_evenly(lights, kind, how):
    """Its normal is the same everywhere: emission is multiplied with one number."""
    normal = np.array([1, 2, 3]) / 14**0.5
    view = np.array([-(0.75**0.5) * 0.5, -(0.75**0.5) * 0.75**0.5, 0.5])
    cosines = {
        None: abs(normal @ view),
        1: abs(normal[0]),
        2: 0.25 * abs(normal @ view) + 0.75 * abs(normal[2]),
    }
    cosine = cosines[len(lights) if lights else None]
    plain = vm.render(RAMP, MEDIA[kind]("a"), CAMERA, **how)
    shaded = vm.render(RAMP, MEDIA[kind]("a", shading=0.8, lights=lights), CAMERA, **how)
    expected = (0.2 + 0.8 * cosine) * plain.intensity
    np.testing.assert_allclose(
        shaded.intensity, expected, rtol=0, atol=2.1e-3 * plain.intensity.max()
    )
    np.testing.assert_allclose(shaded.optical_depth, plain.optical_depth, rtol=2e-2, atol=1e-2)


@pytest.mark.parametrize("scheme", ["post-classified", "first-order"])
def test_without_gradients_there_is_ambient_light(scheme):
    volume = vm.Volume(GRID, a=np.ones(GRID.shape))
    volume["flat"] = "0.6 + 0 * x"
    plain = vm.render(volume, MEDIA["gaussian"]("flat"), CAMERA, scheme=scheme)
    shaded = vm.render(volume, MEDIA["gaussian"]("flat", shading=0.7), CAMERA, scheme=scheme)
    np.testing.assert_allclose(shaded.intensity, 0.3 * plain.intensity, rtol=2e-3)


@pytest.mark.parametrize("width", [0.0, 0.1])
def test_isosurfaces_in_the_light_of_several_lamps(width):
    normal = np.array([1, 2, 3]) / 14**0.5
    make = {"level": 0.6, "opacity": 1, "width": width}
    lit = vm.Isosurface("a", shading=0.6, lights=[((1, 0, 0), 1), ((0, -2, 0), 3)], **make)
    found = vm.render(RAMP, lit, CAMERA).intensity
    plain = vm.render(RAMP, vm.Isosurface("a", **make), CAMERA).intensity
    factor = 0.4 + 0.6 * (0.25 * normal[0] + 0.75 * normal[1])
    np.testing.assert_allclose(found, factor * plain, atol=2e-3)
    for other in (lit, MEDIA["gaussian"]("a", shading=0.5, lights=[(1, 0, 0)])):
        assert other.replace().key() == other.key()
        assert other.replace(lights=[(0, 0, 1)]).key() != other.key()


@pytest.mark.parametrize("position", [(0.1, -3, 1), (0.1, 0.05, -0.2)], ids=["outside", "inside"])
def test_the_lamp_is_at_the_observer(position):
    camera = vm.Perspective(position, (0.5, 0.8, 0.3), fov=70, resolution=24)
    frame = camera.frame(GRID)
    u, v = np.meshgrid(*frame.coordinates())
    backend = get_backend("cpu", "double")
    ray = camera.rays(frame.traced_vectors(backend), *(backend.Float(p.ravel()) for p in (u, v)))
    way = np.stack([np.broadcast_to(np.array(d), u.size) for d in ray.direction])
    normal = np.array([1, 2, 3]) / 14**0.5
    cosine = np.abs(normal @ way / np.linalg.norm(way, axis=0)).reshape(u.shape)
    plain, shaded = (
        vm.render(RAMP, vm.Gaussian("a", 0.6, 0.4, 1.0, 0, 0.2, shading=s), camera).intensity[
            ..., 0
        ]
        for s in (0.0, 0.8)
    )
    atol = 2e-3 * plain.max()
    np.testing.assert_allclose(shaded, (0.2 + 0.8 * cosine) * plain, rtol=0, atol=atol)


def test_bad_lights_are_refused():
    for bad in (["sun"], [(0, 0, 0)], [(1, 0)], [((1, 0, 0), -1)], [], 3):
        with pytest.raises(vm.InputError, match="lights"):
            MEDIA["gaussian"]("a", shading=0.5, lights=bad)
    with pytest.raises(vm.InputError, match="lights need shading"):
        vm.Isosurface("a", 0.5, lights=[(1, 0, 0)])
    with pytest.raises(vm.InputError, match="shading"):
        vm.render(RAMP, MEDIA["gaussian"]("a", shading=0.5), CAMERA, bounds=True)
