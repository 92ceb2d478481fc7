"""What must change nothing: splitting cells, units, rotations, directions, threads, tables."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import voluminous as vm
from contracts.scheme import both_ways, coloured, random_volume
from voluminous.backend import dr
from voluminous.schemes import SCHEMES

EDGES = [np.array(e) for e in ([-1.0, -0.3, 0.1, 0.8, 2.0], [0.0, 0.5, 0.75, 3.0], [-2.0, -1, 1])]
OBLIQUE = vm.Orthographic(57, 213, 31, width=4.0, resolution=(15, 12))
INSIDE = vm.Perspective((0.2, 0.9, -0.4), (1, 2, 0.3), 100, resolution=12, projection="spherical")
DOUBLE = {"precision": "double", "cutoff": 0}


def assert_same(one, other, rtol=1e-12, names=("intensity", "transparency", "optical_depth")):
    """Assert that two images agree relative to their maxima."""
    for name in names:
        expected = getattr(one, name)
        found = getattr(other, name)
        np.testing.assert_allclose(found, expected, rtol=0, atol=rtol * np.abs(expected).max())


def fields_of(volume):
    return {name: volume.array(name) for name in volume.fields}


@pytest.mark.parametrize("camera", [OBLIQUE, INSIDE])
def test_splitting_cells_changes_nothing(camera):
    volume = random_volume()
    halves = [np.sort(np.append(e, 0.5 * (e[1:] + e[:-1]))) for e in EDGES]
    split = {k: v.repeat(2, 0).repeat(2, 1).repeat(2, 2) for k, v in fields_of(volume).items()}
    finer = vm.Volume(vm.CartesianGrid(*halves), split)
    options = {"scheme": "first-order", "background": 1.0, **DOUBLE}
    # Twice the segments, the same medium along each ray.
    assert_same(*(vm.render(v, coloured(), camera, **options) for v in (volume, finer)))


# The rotations of a cube: axis i of the new volume is axis order[i] of the old, flipped or not.
ROTATIONS = [
    (order, flips)
    for order, flips in itertools.product(
        itertools.permutations(range(3)), itertools.product((1, -1), repeat=3)
    )
    if np.linalg.det(np.eye(3)[list(order)] * np.array(flips)[:, None]) > 0
]


@pytest.mark.parametrize("scheme", ["first-order", "second-order"])
def test_rotating_volume_and_camera_changes_nothing(scheme):
    volume = random_volume()
    view, up, eye = (
        np.array([0.5, -0.7, 0.3]),
        np.array([0.1, 0.2, 0.9]),
        np.array([0.2, 0.9, -0.4]),
    )
    pixels = {"resolution": (15, 12)}

    def pictures(volume, turn):
        far = vm.Orthographic.looking(turn(view), turn(up), width=4.0, center=turn(eye), **pixels)
        near = vm.Perspective.looking(turn(eye), turn(view), fov=100, up=turn(up), **pixels)
        return [vm.render(volume, coloured(), c, scheme=scheme, **DOUBLE) for c in (far, near)]

    expected = pictures(volume, lambda vector: vector)
    assert len(ROTATIONS) == 24
    for order, flips in ROTATIONS[1::4]:
        edges = [np.sort(f * EDGES[a]) for a, f in zip(order, flips, strict=True)]
        backwards = tuple(slice(None, None, f) for f in flips)
        fields = {k: v.transpose(order)[backwards] for k, v in fields_of(volume).items()}
        turned = vm.Volume(vm.CartesianGrid(*edges), fields)
        found = pictures(turned, lambda v, o=order, f=flips: v[list(o)] * f)
        for one, other in zip(expected, found, strict=True):
            assert_same(one, other, 1e-11)  # angles are found again, to rounding


@pytest.mark.parametrize("scheme", ["first-order", "second-order", "olson-kunasz"])
@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("camera", [OBLIQUE, INSIDE])
def test_directions_of_the_fold_change_nothing(scheme, precision, camera):
    images = [
        vm.render(
            random_volume(),
            coloured(),
            camera,
            scheme=one,
            precision=precision,
            cutoff=0,
            background=[0.5, 2.0],
        )
        for one in both_ways(scheme)
    ]
    # Distances count from the other end: in single precision walls are met 1e-6 elsewhere.
    assert_same(*images, 2e-5 if precision == "single" else 1e-12)


@pytest.fixture
def threads():
    """Return a function that sets the number of threads, for this test."""
    before = dr.thread_count()
    yield dr.set_thread_count
    dr.set_thread_count(before)


@pytest.mark.parametrize("scheme", sorted(SCHEMES))
@pytest.mark.parametrize("precision", ["single", "double"])
def test_number_of_threads_changes_no_bit(scheme, precision, threads):
    pictures = []
    for count in (0, 1, 2):  # none: the calling thread alone
        threads(count)
        # Coefficients down to far below the smallest normal number.
        grid = vm.CartesianGrid.uniform(24, (-1, 1))
        volume = vm.Volume(grid)
        volume["f"] = "x + 2*y - z"
        medium = vm.Gaussian("f", 0, 0.02, (1.0, 0.3), 3.0, 1.0)
        camera = vm.Orthographic(20, 30, resolution=40)
        image = vm.render(volume, medium, camera, scheme=scheme, precision=precision)
        pictures.append((image.intensity, image.optical_depth))
    for picture in pictures[1:]:
        np.testing.assert_array_equal(picture, pictures[0])
