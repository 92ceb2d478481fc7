"""Rays that no camera sends: from stars, lamps, cells; from outside and from within a volume."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

import voluminous as vm
from contracts.scheme import both_ways
from voluminous.rendering.options import RenderOptions
from voluminous.rendering.prepare import prepare, prepare_rays
from voluminous.rendering.run import make_tracer
from voluminous.rendering.tracer import Marcher

J, ALPHA = 0.7, 1.3
OPTIONS = {"default": {}, **{name: {"scheme": name} for name in ("first-order", "second-order")}}
OPTIONS["backward"] = {"scheme": both_ways("first-order")[1]}
WALLS = np.linspace(-0.5, 0.5, 3)
GRIDS = {
    "Cartesian": vm.models.uniform_slab(J, ALPHA).grid,
    "octree": vm.OctreeGrid.from_function(WALLS, WALLS, WALLS + 0.5, lambda x, *_: x < 0.1, 3),
}
CAMERAS = {
    "outside": vm.Orthographic(60, 30, width=2.0, resolution=(9, 7)),
    "inside": vm.Perspective((0.4, 0.3, -0.2), (0, 0, 0), resolution=(9, 7)),
}


def traced(volume, medium, origin, direction, **options):
    """Return intensity, transparency and optical depth along each ray."""
    job, _ = prepare_rays(volume, medium, RenderOptions(**options), rays=len(origin))
    tracer = Marcher(job, job.source(), 0.0)
    if job.controlled:
        tracer.allow(1e-4, 1e-4, 0.1)
    paths = tracer.along(origin, direction)
    (intensity,) = tracer.source.channels.intensity([row[None] for row in paths.emission])
    return intensity[:, 0], paths.transparency[0], paths.depth[0]


def check_uniform(grid, origin, direction, lengths, name):
    volume, depth = vm.Volume(grid, j=np.full(grid.shape, J)), ALPHA * lengths
    medium = vm.Coefficients("j", f"{ALPHA / J} * j")
    found = traced(volume, medium, origin, direction, **OPTIONS[name])
    assert_allclose(found, [J / ALPHA * -np.expm1(-depth), np.exp(-depth), depth], atol=2e-5)


@pytest.mark.parametrize("name", OPTIONS)
@pytest.mark.parametrize("kind", GRIDS)
def test_in_every_direction_from_everywhere(kind, name):
    random = np.random.default_rng(1)
    origin, direction = random.uniform(-1, 1, (300, 3)), random.normal(size=(300, 3))
    origin[:60] *= 0.5  # inside; some of them on faces, edges and corners
    origin[:10, 0], origin[5:10, 1], origin[10:15] = 0.5, 0.5, (0.5, -0.5, 0.5)
    direction[80:86] = np.array([*np.eye(3), *-np.eye(3)]) + 1e-300  # along the axes
    walls = np.sort((np.array([[[-0.5]], [[0.5]]]) - origin) / direction, axis=0)
    first, last = np.maximum(walls[0].max(axis=1), 0.0), walls[1].min(axis=1)
    lengths = np.maximum(last - first, 0.0) * np.linalg.norm(direction, axis=1)
    check_uniform(GRIDS[kind], origin + np.array([0, 0, 0.5]), direction, lengths, name)


@pytest.mark.parametrize("name", ["default", "first-order"])
def test_from_the_star_in_the_hole_of_a_shell(name):
    directions, radii = np.random.default_rng(2).normal(size=(50, 3)), np.linspace(1, 2, 5)
    check_uniform(vm.SphericalGrid(radii), np.zeros((50, 3)), directions, np.ones(50), name)


@pytest.mark.parametrize("name", ["default", "first-order"])
@pytest.mark.parametrize("where", CAMERAS)
def test_a_cameras_rays_see_its_picture(where, name):
    sphere, medium = vm.models.sphere(16), vm.Coefficients("1.5 * inside", "inside")
    tracer = make_tracer(prepare(sphere, medium, CAMERAS[where], RenderOptions())[0], 0.0)
    ray = tracer.ray_through(np.arange(63), *np.zeros((2, 63)))
    every = np.broadcast_arrays(*map(np.asarray, ray.origin + ray.direction), np.zeros(63))
    origin, direction = np.stack(every[:3], -1), np.stack(every[3:6], -1)
    origin = origin - (5.0 if where == "outside" else 0.0) * direction  # those have no beginning
    image = vm.render(sphere, medium, CAMERAS[where], **OPTIONS[name])
    found = traced(sphere, medium, origin, direction, **OPTIONS[name])
    seen = image.intensity[..., 0].ravel(), image.transparency[..., 0].ravel()
    assert_allclose(found[:2], seen, atol=1e-3 if name == "default" else 1e-5)
