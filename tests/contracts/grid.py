"""What every grid must do."""

from __future__ import annotations

import itertools
import json
from dataclasses import dataclass

import numpy as np
import pytest

from contracts.bundle import box_limits, on_a_sphere
from voluminous.backend import dr, from_host, get_backend
from voluminous.geometry import position
from voluminous.grids.contract import BoxGrid, DualGrid, Ray

MOST_STEPS = 2000  # of one ray: a ray that hangs fails, not the machine
BESIDE = np.array(list(itertools.product((-0.5, 0.5), repeat=3)))


@dataclass
class Steps:
    """The walk of R rays in N steps: arrays (N, R), distances in the grid's unit."""

    cell: np.ndarray
    length: np.ndarray
    end: np.ndarray
    active: np.ndarray


def make_ray(backend, origins, directions, first=None, last=None):
    """Return rays of a backend from arrays (R, 3); limits are numbers or None."""
    columns = [[from_host(backend.Wide, c) for c in data.T] for data in (origins, directions)]
    limits = [None if limit is None else backend.Wide(limit) for limit in (first, last)]
    return Ray(*columns, *limits)


def walk_along(grid, backend, ray, visit=None):
    """Follow rays step by step, with NumPy looking on; `visit` is called at every step."""
    walk, steps = grid.walk(backend), []
    track, cursor = walk.enter(ray)
    skip = walk.skipper(track)
    dr.eval(track, cursor)
    while dr.any(cursor.inside):
        if skip is not None:
            cursor = skip(cursor).cursor
            dr.eval(cursor)  # or the kernels of all steps grow, and are compiled one by one
        segment, following = walk.next(track, cursor)
        dr.eval(segment, following)
        if visit is not None:
            visit(walk, track, cursor, segment)
        parts = (segment.cell, segment.length, segment.end, segment.active)
        steps.append([np.asarray(part) for part in parts])
        # As in a loop of the kernel: rays that have left stay where they are.
        cursor = dr.select(cursor.inside, following, cursor)
    cell, length, end, active = (np.array(part) for part in zip(*steps, strict=True))
    return Steps(cell, np.where(active, length, 0) * grid.scale, end * grid.scale, active)


class RaysFromAnywhere:
    """Segments lie in cells, wherever rays begin; a subclass gives the fixture ``grid``."""

    precisions = ("single", "double")

    def pytest_generate_tests(self, metafunc):
        if "backend" in metafunc.fixturenames:
            backends = [get_backend("cpu", precision) for precision in self.precisions]
            metafunc.parametrize("backend", backends, ids=self.precisions)

    def tolerance(self, grid, backend):
        """Rounding of a distance: one unit in the last place of the diagonal for every step."""
        diagonal = np.linalg.norm(np.ptp(grid.bounds, axis=1))
        # Rays begin outside, in double precision, with coordinates of that size.
        outside = 8 * np.finfo(float).eps * np.abs(grid.bounds).max()
        return 4 * np.finfo(backend.dtype).eps * diagonal + 8 * outside

    def anywhere(self, grid):
        """Rays that begin inside, outside, in gaps, on faces of cells and of the bounds."""
        rng, wide = np.random.default_rng(4), np.ptp(grid.bounds, axis=1)
        low, high = grid.bounds.T
        inside = rng.uniform(low, high, size=(48, 3))
        faces = np.where(np.eye(3, dtype=bool)[np.arange(24) % 3], low, inside[:24])
        origins = [inside, rng.uniform(low - wide, high + wide, size=(24, 3)), faces]
        if isinstance(grid, BoxGrid):
            below, above = (ends[:, :: max(grid.size // 24, 1)] for ends in grid.spans())
            axis = np.arange(below.shape[1]) % 3 == np.arange(3)[:, None]
            own = np.where(axis, below, 0.5 * (below + above))
            origins.append(position(grid.coordinates, own).T)
        origins = np.concatenate(origins)
        directions = on_a_sphere(len(origins), seed=5)
        directions[::5] = np.eye(3)[np.arange(len(directions[::5])) % 3]  # some along the axes
        return origins, directions

    @pytest.mark.each_value_once
    @pytest.mark.parametrize("kind", ["cells", "dual"])
    def test_rays_from_anywhere_have_segments_in_cells_alone(self, grid, backend, kind):
        origins, directions = self.anywhere(grid)
        walk = grid.walk(backend, kind if isinstance(grid, DualGrid) else "cells")
        if not walk.in_cells:
            pytest.skip("dual cells have numbers of their own")
        track, cursor = walk.enter(make_ray(backend, origins, directions, 0.0))
        dr.eval(track, cursor)
        entry, total = np.asarray(track.entry, float), 0.0
        rounding = 4 * self.tolerance(grid, backend)

        def check(segment, inside):
            cell, begin, end = (
                np.asarray(v) + np.zeros(len(origins), np.asarray(v).dtype)
                for v in (segment.cell, segment.begin, segment.end)
            )
            assert (cell[inside] < grid.size).all()  # in gaps too: it is gathered and scattered to
            active = np.asarray(segment.active) & np.ones(len(origins), bool)
            assert not (active & ~inside).any()
            begin, end = begin.astype(float), end.astype(float)
            middle = (entry + 0.5 * (begin + end)) * grid.scale
            assert (middle[active] > -rounding).all()
            long = active & ((end - begin) * grid.scale > rounding)
            points = (origins + middle[:, None] * directions)[long]
            near = [grid.locate(points + rounding * step) for step in BESIDE]  # along walls: either
            assert (np.array(near) == cell[long]).any(axis=0).all()
            return np.where(active, (end - begin) * grid.scale, 0)

        for _ in range(MOST_STEPS):
            inside = np.asarray(cursor.inside) & np.ones(len(origins), bool)
            if not inside.any():
                break
            segment, _ = walk.next(track, cursor)
            dr.eval(segment)
            check(segment, inside)
            segment, following = walk.step(track, cursor)
            dr.eval(segment, following)
            total = total + check(segment, inside)
            cursor = dr.select(cursor.inside, following, cursor)
            dr.eval(cursor)
        assert not inside.any()
        away = 3 * np.linalg.norm(np.ptp(grid.bounds, axis=1))
        far = make_ray(backend, origins - away * directions, directions, away)
        whole = walk_along(grid, backend, far).length.sum(axis=0)
        np.testing.assert_allclose(total, whole, rtol=0, atol=rounding * 64)


class GridContract(RaysFromAnywhere):
    """Segments join up, lie in the cells they name, and add up to the way through the domain.

    A subclass gives the fixture ``grid`` and the method ``locate``; a grid whose domain is not the
    box of its bounds also ``enter_leave``; one that single precision cannot resolve `precisions`.
    """

    def locate(self, grid, points):
        """Return the flat index of the cell of each point (n, 3), found in another way."""
        raise NotImplementedError

    def enter_leave(self, grid, origins, directions):
        """Return the distances (R,) at which lines enter and leave the domain."""
        return box_limits(grid.bounds, origins, directions)

    @pytest.fixture
    def lines(self, grid):
        """Lines through random points of the domain, into all directions, begun outside."""
        size = np.ptp(grid.bounds, axis=1)
        aims = np.random.default_rng(1).uniform(*grid.bounds.T, size=(96, 3))
        directions = on_a_sphere(len(aims), seed=2)
        return aims - 3 * np.linalg.norm(size) * directions, directions

    def test_host_side_is_told_in_plain_values(self, grid):
        assert grid.size == np.prod(grid.shape)
        assert grid.bounds.shape == (3, 2)
        assert grid.scale > 0
        assert isinstance(grid.needs_double(), bool)
        told = grid.describe()
        assert json.loads(json.dumps(told)) == told
        assert told["type"]

    def test_segments_add_up_to_the_way_through_the_domain(self, grid, backend, lines):
        steps = walk_along(grid, backend, make_ray(backend, *lines))
        enter, leave = self.enter_leave(grid, *lines)
        rounding = self.tolerance(grid, backend) * len(steps.length)
        np.testing.assert_allclose(steps.length.sum(axis=0), leave - enter, rtol=0, atol=rounding)
        assert (steps.length >= 0).all()

    @pytest.mark.each_value_once
    def test_segments_lie_in_the_cells_they_name(self, grid, backend, lines):
        origins, directions = lines
        steps = walk_along(grid, backend, make_ray(backend, *lines))
        enter, _ = self.enter_leave(grid, *lines)
        middle = enter + steps.end - 0.5 * steps.length
        # The middle of a segment shorter than rounding may be beyond its wall.
        long = steps.active & (steps.length > 4 * self.tolerance(grid, backend))
        for length, t, cell in zip(long, middle, steps.cell, strict=True):
            points = (origins + t[:, None] * directions)[length]
            np.testing.assert_array_equal(self.locate(grid, points), cell[length])

    def test_distances_grow_and_segments_join_up(self, grid, backend, lines):
        steps = walk_along(grid, backend, make_ray(backend, *lines))
        assert (np.diff(steps.active.astype(int), axis=0) <= 0).all()  # once out, always out
        begin = steps.end - steps.length
        both = steps.active[1:]
        scale = np.finfo(backend.dtype).eps * np.abs(steps.end).max()
        # A length is a difference of two distances: the sum is rounded once more.
        np.testing.assert_allclose(begin[1:][both], steps.end[:-1][both], rtol=0, atol=2 * scale)

    @pytest.mark.each_value_once
    def test_rays_stay_between_their_limits(self, grid, backend, lines):
        enter, leave = self.enter_leave(grid, *lines)
        first, last = enter + 0.2 * (leave - enter), leave - 0.3 * (leave - enter)
        whole = walk_along(grid, backend, make_ray(backend, *lines)).length.sum(axis=0)
        parts = [
            walk_along(grid, backend, make_ray(backend, *lines, *limits)).length
            for limits in ((None, first), (first, last), (last, None))
        ]
        inner = self.tolerance(grid, backend) * len(parts[1])
        np.testing.assert_allclose(parts[1].sum(axis=0), last - first, rtol=0, atol=inner)
        pieces = sum(part.sum(axis=0) for part in parts)
        np.testing.assert_allclose(pieces, whole, rtol=0, atol=3 * inner)

    def test_rays_beside_the_domain_have_no_way(self, grid, backend, lines):
        diagonal = np.linalg.norm(np.ptp(grid.bounds, axis=1))
        across = np.cross(lines[1], [0.3, 0.5, 0.8])
        far = across / np.linalg.norm(across, axis=1, keepdims=True) * 2 * diagonal
        _, cursor = grid.walk(backend).enter(make_ray(backend, lines[0] + far, lines[1]))
        assert not dr.any(cursor.inside)

    @pytest.mark.each_value_once
    def test_corners_are_an_interpolation(self, grid, backend, lines):
        eps = np.finfo(backend.dtype).eps

        def check(corners, active):
            dr.eval(corners)
            weights = np.array([np.asarray(w) + 0 * active for w in corners.weight])[:, active]
            # A fraction of a cell is known to the rounding of the distance, over the cell.
            slack = 8 * eps * sum(grid.shape) + self.tolerance(grid, backend) / self.thinnest(grid)
            np.testing.assert_allclose(weights.sum(axis=0), 1, rtol=0, atol=32 * eps)
            assert weights.min(initial=0) > -slack
            assert weights.max(initial=0) < 1 + slack

        def visit(walk, track, cursor, segment):
            active = np.asarray(segment.active)
            check(walk.entry_corners(track, cursor), active)
            check(walk.exit_corners(track, segment), active)

        walk_along(grid, backend, make_ray(backend, *lines), visit)

    def thinnest(self, grid):
        """Width of the thinnest cell, for the rounding of weights."""
        return grid.scale

    @pytest.mark.each_value_once
    def test_values_are_continuous_from_cell_to_cell(self, grid, backend, lines):
        ends = []

        def value(corners):
            dr.eval(corners)
            pairs = zip(corners.vertex, corners.weight, strict=True)
            return sum(np.asarray(weight) * _noise(np.asarray(v)) for v, weight in pairs)

        def visit(walk, track, cursor, segment):
            active = np.asarray(segment.active)
            begin = value(walk.entry_corners(track, cursor))
            if ends:
                slack = 64 * self.tolerance(grid, backend) / self.thinnest(grid)
                np.testing.assert_allclose(begin[active], ends[-1][active], rtol=0, atol=slack)
            ends.append(value(walk.exit_corners(track, segment)))

        walk_along(grid, backend, make_ray(backend, *lines), visit)


def _noise(vertex):
    """Return a number between -1 and 1 for each vertex, unlike those of its neighbours."""
    return np.sin(12.9898 * vertex.astype(float) ** 2)
