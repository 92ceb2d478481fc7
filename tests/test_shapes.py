"""Regions and apertures as texts: the same as those that Python makes."""

from __future__ import annotations

import contextlib

import numpy as np
import pytest
from astropy import units as u
from hypothesis import assume, given
from hypothesis import strategies as st
from matplotlib.path import Path

import voluminous as vm
from voluminous.measuring.shapes import aperture_weights, polygon_of
from voluminous.regions import Box, Cylinder, DoubleCone, Sphere, region_of

POINTS = np.random.default_rng(0).uniform(-2, 2, (3, 4000))
BALL, CUBE = Sphere((0, 0, 0.5), 1.5), Box((-1, -1, -1), (2, 1, 1))


@pytest.mark.parametrize(
    ("text", "region"),
    [
        ("sphere((0, 0, 0.5), 1.5)", BALL),
        ("sphere(radius=1500*mpc, center=[0, 0, '0.5 pc'])", BALL),
        ("box((-1, -1, -1), (2, 1, 1) pc)", CUBE),
        ("cylinder((0, 0, -1 pc), (0, 1, 1), 1)", Cylinder((0, 0, -1), (0, 1, 1), 1)),
        ("cone((0, 0, 0), (0, 1, 1), 40)", DoubleCone((0, 0, 0), (0, 1, 1), 40, side="up")),
        (
            "doublecone((0,0,0), (0,1,1), opening=0.5 rad, height=1e3 mpc, side=down)",
            DoubleCone((0, 0, 0), (0, 1, 1), 0.5 * u.rad, 1, side="down"),
        ),
        ("double_cone((0, 0, 0), (0, 0, -1), 40)", DoubleCone((0, 0, 0), (0, 0, 1), 40)),
        ("~sphere((0, 0, 0.5), 1.5)", ~BALL),
        ("sphere((0, 0, 0.5), 1.5) & ~box((-1, -1, -1), (2, 1, 1))", BALL & ~CUBE),
        ("sphere((0, 0, 0.5), 1.5) and not box((-1, -1, -1), (2, 1, 1))", BALL & ~CUBE),
        (
            "sphere((2, 0, 0), 1) | sphere((0, 0, 0.5), 1.5)\n & (box((-1, -1, -1), (2, 1, 1)))",
            Sphere((2, 0, 0), 1) | (BALL & CUBE),
        ),
        (
            "sphere((2, 0, 0), 1) or sphere((0, 0, 0.5), 1.5) or box((-1, -1, -1), (2, 1, 1))",
            Sphere((2, 0, 0), 1) | BALL | CUBE,
        ),
    ],
)
def test_texts_are_regions(text, region):
    inside = region_of(text).inside(POINTS, u.pc)
    assert 0 < inside.sum() < inside.size
    np.testing.assert_array_equal(inside, region.inside(POINTS, u.pc))


@pytest.mark.parametrize(
    ("text", "polygon"),
    [
        ("rectangle((-1, -2), (3, 4))", [(-1, -2), (3, -2), (3, 4), (-1, 4)]),
        ("polygon((0, 0), (1 kpc, 0), (1, 1))", [(0, 0), (1e3, 0), (1, 1)]),
    ],
)
def test_texts_are_polygons(text, polygon):
    np.testing.assert_allclose(polygon_of(text, u.pc), polygon, rtol=1e-15)


def test_a_circle_has_the_area_of_a_circle():
    x, y = polygon_of("circle((1, 2) pc, 5e2 mpc)", u.pc).T
    area = 0.5 * abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))
    assert area == pytest.approx(np.pi * 0.25, rel=1e-12)
    np.testing.assert_allclose(np.hypot(x - 1, y - 2), 0.5, rtol=1.1e-4)


@given(
    corners=st.lists(st.tuples(*[st.integers(-30, 30).map(lambda k: k / 10)] * 2), min_size=3),
    pixels=st.tuples(*[st.integers(1, 9)] * 2),
)
def test_pixels_that_a_polygon_cuts_count_by_their_points(corners, pixels):
    """The twin looks at 16 x 16 points of all pixels; the frame is 4 wide, about (0.1, -0.2)."""
    camera = vm.Orthographic(width=(4, 4), resolution=pixels, shift=(0.1, -0.2))
    frame = camera.frame(vm.CartesianGrid.uniform(2, (-1, 1)))
    nx, ny = pixels
    assume((len(corners), 2) != (ny, nx))  # would be a number per pixel
    corners = np.add(corners, (0.0013, 0.0027))  # no side goes along points
    x, y = (
        shift + 4 * ((np.arange(16 * n) + 0.5) / (16 * n) - 0.5)
        for n, shift in zip(pixels, (0.1, -0.2), strict=True)
    )
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    inside = Path(corners).contains_points(points).reshape(ny, 16, nx, 16)
    found = aperture_weights(corners, frame, None)
    # A point on a side is inside or not by rounding.
    np.testing.assert_allclose(found, inside.mean(axis=(1, 3)), atol=16.5 / 256)


def test_measuring_takes_texts():
    grid = vm.CartesianGrid.uniform(12, (-1, 1), unit="pc")
    volume = vm.Volume(grid, density=np.random.default_rng(1).random(grid.shape))
    ball = vm.measure(volume, "density", clip="sphere((0, 0, 0), 0.7 pc)")
    assert ball["density"] == vm.measure(volume, "density", clip=Sphere((0, 0, 0), 0.7))["density"]
    camera = vm.Orthographic(30, 40, resolution=30)
    corners = [(-0.5, -0.4), (0.6, -0.4), (0.6, 0.2), (-0.5, 0.2)]
    text = "rectangle((-0.5, -0.4), (0.6, 0.2))"
    found, expected = (
        vm.measure(volume, "density", camera=camera, aperture=part) for part in (text, corners)
    )
    assert found["density"] == expected["density"]


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "region ''"),
        ("sphere", "expected shapes, combined by"),
        ("sphere((0, 0, 0), 1", "'\\(' was never closed"),
        ("sphere((0, 0, 0), 1) + sphere((0, 0, 0), 1)", "combined by &, \\| and ~"),
        ("sphere((0, 0, 0))", "missing 1 required positional argument: 'radius'"),
        ("sphere(0, 0, 0, 1)", "points are in parentheses"),
        ("sphere((0, 0, 0), -1 pc)", "radius must be positive"),
        ("sphere((0, 0, 0), 2 parsecs)", "'parsecs' is not a unit"),
        ("sphere((0, 0, 0), 1 km/s)", "region"),
        ("sphere(*x)", "region"),
        ("doublecone((0, 0, 0), (0, 0, 1), 40, side=left)", "'both', 'up' or 'down'"),
        ("~" * 2000 + "sphere((0, 0, 0), 1)", "region"),
        ("(" * 5000, "region"),
        ("a" * 20000, "expected 10000 at most"),
        ("sphere((0, 0, 0), '\0')", "region"),
        ("np.sphere((0, 0, 0), 1)", "expected shapes"),
    ],
)
def test_texts_that_are_no_regions(text, told):
    with pytest.raises(vm.InputError, match=told):
        region_of(text)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("spere((0, 0, 0), 1)", "unknown region 'spere'; did you mean 'sphere'"),
        ("__import__('os')", "unknown region '__import__'"),
        ("sphere((0, 0, 0), raduis=1)", "did you mean 'radius'"),
    ],
)
def test_unknown_names_tell_the_nearest(text, told):
    with pytest.raises(vm.errors.UnknownNameError, match=told):
        region_of(text)


def test_corners_without_a_unit_are_compared_in_that_of_the_volume():
    mixed = Box((1, 1, 1), (2, 2, 2) * u.pc)
    assert mixed.inside(np.full((3, 1), 1.5), u.pc).all()
    with pytest.raises(vm.InputError, match="low must be below high"):
        mixed.inside(np.full((3, 1), 1.5), u.kpc)


PARTS = [
    "sphere",
    "box",
    "(",
    ")",
    ",",
    " ",
    "0",
    "1.5",
    "pc",
    "~",
    "&",
    "|",
    "-",
    "=",
    "and",
    "e1",
]


@given(st.lists(st.sampled_from(PARTS), max_size=20).map("".join) | st.text(max_size=40))
def test_whatever_is_written_is_a_region_or_an_error(text):
    for read in (region_of, lambda text: polygon_of(text, u.pc)):
        with contextlib.suppress(vm.InputError, vm.errors.UnknownNameError):
            read(text)
