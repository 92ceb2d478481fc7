"""What was traced for one picture serves the next, bit for bit, where nothing else differs."""

from __future__ import annotations

import threading

import numpy as np
import pytest

import voluminous as vm
from voluminous.cameras.orthographic import Orthographic
from voluminous.rendering import tracer as kept
from voluminous.schemes.first_order import FirstOrder

AXIS = np.linspace(-1, 1, 5)
VIEWS = [(60, 30), (20, 70), (80, -40)]
GRIDS = {
    "cartesian": lambda: vm.CartesianGrid.uniform(12, (-1, 1)),
    "octree": lambda: vm.OctreeGrid.from_function(*[AXIS] * 3, lambda x, y, z, size: x > y, 2),
    "spherical": lambda: vm.SphericalGrid(
        np.linspace(0.1, 1, 9), np.linspace(0, np.pi, 7), np.linspace(0, 2 * np.pi, 9)
    ),
}
MEDIA = {
    "shell": vm.Gaussian("a", 0.5, 0.05, (1, 0.5), 0.3, 0.1),
    "coefficients": vm.Coefficients(["a", "b"], "3*a*b"),
    "coloured": vm.Isosurface("b", [0.3, 0.6], "viridis", 0.4, width=0.1, shading=True)
    + vm.Gaussian("a", 0.6, 0.2, vm.ColorBy("b", "magma", 0, 1), 0.2, 0.1, where="b > 0.2"),
    "function": vm.Medium.from_function(lambda a: (a * a, 0.5 * a), ["a"], channels=1),
}


def noise(grid, seed=1):
    """Return a volume with two fields between 0 and 1."""
    generator = np.random.default_rng(seed)
    return vm.Volume(grid, a=generator.random(grid.shape), b=generator.random(grid.shape))


def seen(volume, medium, incl=60, phi=30, camera=vm.Orthographic, **options):
    """Return the planes of a picture."""
    camera = camera(incl, phi, width=2.5, resolution=(20, 17))
    image = vm.render(volume, medium, camera, device="cpu", **options)
    planes = (image.intensity, image.transparency, image.optical_depth, image.error)
    return [None if p is None else np.array(p) for p in planes]


def same(found, expected):
    """Assert that pictures are the same, bit for bit."""
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.fixture
def launches(monkeypatch):
    """Return a list that grows whenever something is drawn without tracing it."""
    drawn, plain = [], kept.KernelCache.draw

    def draw(self, tracer, batch, rows):
        cached = plain(self, tracer, batch, rows)
        drawn.extend([len(batch.lanes.target)] * cached)
        return cached

    monkeypatch.setattr(kept.KernelCache, "draw", draw)
    return drawn


OPTIONS = {
    "first order": {"scheme": "first-order"},
    "second order": {"scheme": "second-order", "samples": 2},
    "one panel": {"tolerance": None, "background": 0.3},
    "default": {"antialias": "adaptive", "tolerance": 1e-2},
    "double": {"precision": "double", "tolerance": None},
}
SCENES = [
    *(("cartesian", "shell", options) for options in OPTIONS),
    *(("octree", "shell", options) for options in list(OPTIONS)[:3]),
    *(("spherical", "shell", options) for options in list(OPTIONS)[:3]),
    *(("cartesian", medium, "one panel") for medium in list(MEDIA)[1:]),
    ("cartesian", "function", "default"),
    ("octree", "coefficients", "second order"),
]


@pytest.mark.parametrize("scene", SCENES, ids=" ".join)
def test_a_turned_camera_sees_what_it_sees_at_first(scene, launches):
    grid, medium, options = scene[0], scene[1], OPTIONS[scene[2]]
    volume, medium = noise(GRIDS[grid]()), MEDIA[medium]
    turned = [seen(volume, medium, *view, **options) for view in VIEWS]
    assert launches or medium.key() is None
    for view, found in zip(VIEWS, turned, strict=True):
        volume.tables.clear()
        same(found, seen(volume, medium, *view, **options))


@pytest.mark.parametrize("tolerance", [None, 1e-3])
def test_no_other_kernel_is_compiled(tolerance, kernels):
    volume = noise(GRIDS["cartesian"]())
    first, second, third = (
        kernels(seen, volume, MEDIA["shell"], *view, tolerance=tolerance) for view in VIEWS
    )
    assert second <= first
    assert third <= first


CHANGES = [
    {"medium": vm.Gaussian("a", 0.5, 0.05, (1, 0.2), 0.3, 0.1)},
    {"medium": vm.Gaussian("a", 0.4, 0.05, (1, 0.5), 0.3, 0.1)},
    {"tolerance": 1e-4},
    {"cutoff": 0.0},
    {"background": 7.0},
    {"precision": "double"},
    {"scheme": "first-order"},
]


@pytest.mark.parametrize("changed", CHANGES, ids=str)
def test_what_else_changes_is_seen(changed):
    volume = noise(GRIDS["cartesian"]())
    for view in VIEWS:
        seen(volume, MEDIA["shell"], *view)
    options = {"medium": MEDIA["shell"], **changed}
    found = seen(volume, **options)
    volume.tables.clear()
    same(found, seen(volume, **options))


class Brighter(FirstOrder):
    """A scheme of somebody's own, which reads a number that may change."""

    factor = 1.0

    def solve(self, *arguments):
        """Return the solution with more light."""
        found, carried = super().solve(*arguments)
        found.emission = [e * Brighter.factor for e in found.emission]
        return found, carried


class Nearer(Orthographic):
    """A camera of somebody's own, which does."""

    factor = 1.0

    def rays(self, vectors, u, v):
        """Return rays nearer to each other."""
        return super().rays(vectors, u * Nearer.factor, v * Nearer.factor)


def test_schemes_and_cameras_of_others_are_traced_every_time(monkeypatch):
    volume, medium = noise(GRIDS["cartesian"]()), MEDIA["shell"]
    for _ in range(3):
        plain = seen(volume, medium, scheme=Brighter())
        flat = seen(volume, medium, camera=Nearer)
    monkeypatch.setattr(Brighter, "factor", 2.0)
    monkeypatch.setattr(Nearer, "factor", 0.5)
    np.testing.assert_allclose(seen(volume, medium, scheme=Brighter())[0], 2 * plain[0], rtol=1e-6)
    closer = seen(volume, medium, camera=Nearer)
    assert not np.array_equal(closer[0], flat[0])
    image = vm.render(volume, medium, vm.Orthographic(60, 30, width=1.25, resolution=(20, 17)))
    np.testing.assert_allclose(closer[0], image.intensity, rtol=1e-4, atol=1e-5)


def test_two_threads_draw_the_same_volume():
    volume, medium = noise(GRIDS["cartesian"]()), MEDIA["shell"]
    views = [(incl, phi) for incl in (10, 60, 100) for phi in (0, 50, 200, 310)]
    expected = {view: seen(volume, medium, *view, tolerance=None) for view in views}
    found = {}

    def draw(own):
        for view in own:
            found[view] = seen(volume, medium, *view, tolerance=None)

    threads = [threading.Thread(target=draw, args=(views[k::2] * 3,)) for k in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for view in views:
        same(found[view], expected[view])


def test_of_many_batches_the_latest_are_kept(launches):
    volume = noise(GRIDS["cartesian"]())
    for n in (*range(8, 168, 16), 152, 8, 8):
        camera = vm.Orthographic(width=2.5, resolution=n)
        vm.render(volume, MEDIA["shell"], camera, tolerance=None)
    # Lanes come in tiles of 16 x 16 pixels. The first two of ten sizes were dropped.
    assert launches == [160 * 160, 16 * 16]
