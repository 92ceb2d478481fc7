"""Outlines of grids: on the known boxes, arcs and circles, and nowhere else."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import voluminous as vm
from voluminous.objects.boxes import Edges, creases, joined_edges, outline
from voluminous.scene.sections import build_objects

CIRCLE = np.linspace(0, 2 * np.pi, 9)
SHARP = {"scheme": "first-order", "precision": "double"}


def lines_of(grid, level=0, merged=True):
    """Return all polylines of a level."""
    return [line for group in outline(grid, level, merged) for line in group]


def length(lines):
    """Return how long polylines are together."""
    return sum(np.linalg.norm(np.diff(line, axis=0), axis=1).sum() for line in lines)


def unit_edges(edges):
    """Return edges as a set of those of length one: (axis, x, y, z)."""
    found = []
    for axis, start, stop in zip(edges.axis, edges.start, edges.stop, strict=True):
        for place in range(start[axis], stop):
            at = [int(c) for c in start]
            at[axis] = place
            found.append((int(axis), *at))
    return found


def nodes_around(full, axis, place):
    """Return which of the four blocks around an edge are there, as a 2 x 2 array."""
    window = [slice(c, c + 2) for c in place]  # `full` has a margin of one
    window[axis] = slice(place[axis] + 1, place[axis] + 2)
    return full[tuple(window)].squeeze(axis)


@given(st.lists(st.tuples(*[st.integers(0, 3)] * 3), min_size=1, unique=True))
def test_edges_of_a_body_are_those_that_one_can_feel(blocks):
    """An edge is where the surface turns: where a 2 x 2 pattern is not constant along an axis."""
    full = np.zeros((6, 6, 6), bool)
    full[tuple(np.array(blocks).T + 1)] = True
    expected = set()
    for axis in range(3):
        for place in np.ndindex(*[4 if a == axis else 5 for a in range(3)]):
            around = nodes_around(full, axis, place)
            turns = np.diff(around.astype(int), axis=0).any(), np.diff(around.astype(int)).any()
            if all(turns):
                expected.add((axis, *place))
    found = creases(np.array(blocks))
    assert set(unit_edges(found)) == expected
    whole = unit_edges(joined_edges(found))
    assert len(whole) == len(set(whole)) == len(expected)
    assert set(whole) == expected


@given(st.lists(st.tuples(*[st.integers(0, 2)] * 2, st.integers(0, 8), st.integers(1, 5))))
def test_lines_that_touch_or_overlap_become_one(given_lines):
    rows = np.array(given_lines, dtype=int).reshape(-1, 4)
    start = np.column_stack([rows[:, 1], np.zeros(len(rows), int), rows[:, 1]])
    start[np.arange(len(rows)), rows[:, 0]] = rows[:, 2]
    edges = Edges(rows[:, 0], start, rows[:, 2] + rows[:, 3], np.zeros(len(rows), bool))
    whole = unit_edges(joined_edges(edges))
    assert len(whole) == len(set(whole))
    assert set(whole) == set(unit_edges(edges))


def test_a_box_has_twelve_edges():
    grid = vm.CartesianGrid([0, 1, 3], [-1, 0, 2], [5, 6], unit="pc")
    lines = lines_of(grid)
    assert len(lines) == 12
    corners = {tuple(point) for line in lines for point in line}
    assert corners == {(x, y, z) for x in (0, 3) for y in (-1, 2) for z in (5, 6)}
    assert length(lines) == 4 * (3 + 3 + 1)
    assert length(lines_of(grid, merged=False)) == length(lines)


def corner_tree():
    """Two of eight cells of width 2 split that share an edge; one of them has a split child."""
    walls = [0.0, 2.0, 4.0]
    flags = [1, 1, *[0] * 8, *[0] * 7, *[0] * 2, 1, *[0] * 8, *[0] * 4]
    return vm.OctreeGrid(walls, walls, walls, flags, unit="cm")


def test_what_an_octree_refines():
    grid = corner_tree()
    assert grid.cells_per_level == (6, 15, 8)
    for merged in (True, False):
        assert len(lines_of(grid, 0, merged)) == 12
        # Two cubes with a common edge, and two pairs of edges that go on through its ends.
        first = lines_of(grid, 1, merged)
        assert length(first) == 2 * 12 * 2 - 2
        assert {tuple(p) for line in first for p in line} >= {(0, 0, 0), (4, 4, 2), (2, 2, 2)}
        second = lines_of(grid, 2, merged)
        assert {tuple(p) for line in second for p in line} == set(np.ndindex(2, 2, 2))


def tiles():
    """A domain of four tiles in a row; two of them, next to each other, are finer."""
    lower = [[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]]
    upper = [[1, 1, 1], [2, 1, 1], [3, 1, 1], [4, 1, 1]]
    return vm.PatchGrid(lower, upper, [[2] * 3, [4] * 3, [4] * 3, [2] * 3], unit="pc")


def test_patches_are_drawn_each_or_as_one():
    grid = tiles()
    each, one = lines_of(grid, 1, merged=False), lines_of(grid, 1)
    # Three squares and four lines along x; as one, two of the squares.
    assert length(each) == 3 * 4 + 4 * 2
    assert length(one) == 2 * 4 + 4 * 2
    assert {line[:, 0].tolist() == [1, 3] for line in one if np.ptp(line[:, 0])} == {True}
    # The domain, and the two coarse tiles in it.
    assert length(lines_of(grid, 0, merged=False)) == 4 * 4 + 4 * 4
    assert length(lines_of(grid, 0)) == 2 * 4 + 4 * 4


# Polygons of one degree from arc to chord are shorter by 5e-5.
ARCS = 1e-4


@pytest.mark.parametrize(
    ("grid", "expected"),
    [
        # Two circles through the poles, and the equator.
        (vm.SphericalGrid([0, 1, 2]), 3 * 2 * np.pi * 2),
        (vm.SphericalGrid([0, 2], [0, 1, 0.5 * np.pi], CIRCLE, mirror=True), 3 * 2 * np.pi * 2),
        # Circles around cones of 30 degrees and at the equator, meridians between, and spokes.
        (
            vm.SphericalGrid([1, 2], [np.pi / 6, 5 * np.pi / 6], CIRCLE),
            (2 * np.pi * 2 + 4 * 2 * np.pi / 3) * 3 + 4 * 2 * 1,
        ),
        # A wedge: half circles, an arc of one radian, and the axis.
        (vm.SphericalGrid([0, 2], [0, np.pi], [0, 1]), 2 * np.pi * 2 + 2 * 1 + 4),
        (vm.CylindricalGrid([1, 3], [0, 2 * np.pi], [-1, 1]), 2 * 2 * np.pi * 4 + 4 * 2 * 2),
        (vm.CylindricalGrid([0, 3], CIRCLE, [-1, 1]), 2 * 2 * np.pi * 3 + 4 * 2),
        (vm.CylindricalGrid([1, 3], [0, 1], [-1, 1]), 2 * 4 + 4 * 2 + 4 * 2),
    ],
)
def test_outlines_of_round_domains(grid, expected):
    lines = lines_of(grid)
    assert length(lines) == pytest.approx(expected, rel=ARCS)
    native = grid.native(np.concatenate(lines))
    for edges, values, name in zip(grid.edges, native, grid.coordinates, strict=True):
        if name != "phi":  # of points on the axis it is anything
            assert values.min() >= edges[0] - 1e-12
            assert values.max() <= edges[-1] + 1e-12


def split(chosen, children):
    """Return the flags of base cells that are split once, or not."""
    return np.concatenate([[1] + [0] * children if one else [0] for one in chosen])


def test_what_a_sphere_refines():
    """A cell across the azimuth at which circles end, and its neighbour: one body of two."""
    chosen = np.zeros((8, 4, 2), bool)  # φ, θ, r
    chosen[[7, 0], 1, 1] = True
    grid = vm.SphericalGrid(
        [1, 2, 3], np.linspace(0, np.pi, 5), CIRCLE, refined=split(chosen.ravel(), 8)
    )
    angle, sines = np.pi / 2, np.sin([np.pi / 4, np.pi / 2])
    body = (2 + 3) * (angle * sines.sum() + 2 * np.pi / 4) + 4 * 1
    between = (2 + 3) * np.pi / 4 + 2 * 1
    assert length(lines_of(grid, 1, merged=False)) == pytest.approx(body + between, rel=ARCS)
    # The line between them is drawn all the same: it is one of the four meridians.
    curved = body + (2 + 3) * np.pi / 4 + 1  # the face at θ = 45 degrees is a cone
    assert length(lines_of(grid, 1)) == pytest.approx(curved, rel=ARCS)


def seen_columns(volume, thing, row=30):
    camera = vm.Orthographic(0, 0, width=6, resolution=61)
    medium = vm.Coefficients(["0 * a", "0 * a", "0 * a"], 0)
    image = vm.render(volume, medium, camera, objects=[thing], **SHARP)
    return np.flatnonzero(image.intensity[row].max(axis=-1) > 0.6), image


def test_a_picture_of_levels_in_their_colours():
    walls = np.linspace(-2, 2, 5)
    flags = [0] * 64
    flags[21] = 1  # from -1 to 0 along all axes
    grid = vm.OctreeGrid(walls, walls, walls, split(flags, 8), unit="pc")
    volume = vm.Volume(grid, a=np.ones(grid.shape))
    pixel = {x: round((x + 3) / 6 * 61 - 0.5) for x in (-2, -1, 0, 2)}
    row = round((-0.5 + 3) / 6 * 61 - 0.5)
    colours = vm.Boxes(colors=["red", "lime"], relative=False)
    seen, image = seen_columns(volume, colours, row)
    assert seen.tolist() == list(pixel.values())
    assert (image.intensity[row, pixel[-2]] > 0).tolist() == [True, False, False]
    assert (image.intensity[row, pixel[-1]] > 0).tolist() == [False, True, False]
    seen, _ = seen_columns(volume, vm.Boxes(volume, levels=1, colors="red", relative=False), row)
    assert seen.tolist() == [pixel[-1], pixel[0]]


def test_boxes_describe_themselves():
    for thing in (vm.Boxes(levels=[0, 2], merged=False), vm.Boxes(levels=1), vm.Boxes()):
        (again,) = build_objects([thing.describe()])
        assert again.describe() == thing.describe()
    assert vm.Boxes(levels=[0, 2]).describe() == {"type": "boxes", "levels": [0, 2]}


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"levels": -1}, "whole number from 0"),
        ({"levels": [0, 1.5]}, "whole number from 0"),
        ({"merged": "yes"}, "merged must be True or False"),
        ({"width": 0}, "width must be a positive"),
        ({"levels": [3, 4]}, "has levels 0 to 2"),
        ({"colors": ["red", "lime"]}, "2, for 3 levels"),
    ],
)
def test_boxes_that_make_no_sense(options, told):
    with pytest.raises(vm.InputError, match=r"expected a vm\.Volume, or colors="):
        vm.Boxes(["red", "lime"])
    volume = vm.Volume(corner_tree(), a=np.zeros(29))
    with pytest.raises(vm.InputError, match=told):
        seen_columns(volume, vm.Boxes(**options))
