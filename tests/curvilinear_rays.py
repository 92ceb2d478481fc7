"""What tests of spherical and cylindrical grids share: the contract, sums along rays, bad rays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

import voluminous as vm
from contracts import GridContract
from contracts.grid import make_ray, walk_along
from contracts.scheme import both_ways
from twin.curvilinear import Frame, chord, way_inside
from voluminous.backend import dr

FAR = (-1e9, 1e9)
MOST_STEPS = 100_000  # of one ray: a ray that hangs fails, not the machine


def arrival(grid, origins, directions):
    """Return the distances (R,) at which lines enter and leave the surface around a domain."""
    return [t.astype(float) for t in chord(Frame.of(grid), origins, directions)]


class CurvilinearContract(GridContract):
    """Distances count from the outermost surface; in gaps there are no segments."""

    def locate(self, grid, points):
        return Frame.of(grid).cells(points)

    def enter_leave(self, grid, origins, directions):
        return arrival(grid, origins, directions)

    def thinnest(self, grid):
        """Width of the thinnest cell where rays of the contract come: they rarely meet the axis."""
        return 0.05 * min(w.min() for w in grid.cell_sizes())

    def test_segments_add_up_to_the_way_through_the_domain(self, grid, backend, lines):
        steps = walk_along(grid, backend, make_ray(backend, *lines))
        rounding = self.tolerance(grid, backend) * len(steps.length)
        expected = way_inside(Frame.of(grid), *lines)
        np.testing.assert_allclose(steps.length.sum(axis=0), expected, rtol=0, atol=rounding)
        assert (steps.length >= 0).all()

    def test_distances_grow_and_segments_join_up(self, grid, backend, lines):
        steps = walk_along(grid, backend, make_ray(backend, *lines))
        assert (np.diff(steps.active.astype(int), axis=0) <= 0).all()  # once out, always out
        begin, both = steps.end - steps.length, steps.active[1:]
        slack = 2 * np.finfo(backend.dtype).eps * np.abs(steps.end).max()
        before = steps.end[:-1]
        joined = np.abs(begin[1:] - before) <= slack
        apart, ray = np.nonzero(both & ~joined)  # by a gap
        assert (begin[1:][apart, ray] > before[apart, ray]).all()
        assert self._in_no_cell(grid, lines, ray, 0.5 * (begin[1:] + before)[apart, ray]).all()
        assert (np.diff(np.where(steps.active, steps.end, 1e30), axis=0)[both] >= 0).all()

    def _in_no_cell(self, grid, lines, ray, t):
        """Return whether points of rays, so far from where they arrive, are in no cell."""
        origins, directions = lines
        t = t + arrival(grid, *lines)[0][ray]
        return Frame.of(grid).cells(origins[ray] + t[:, None] * directions[ray]) < 0

    def test_rays_stay_between_their_limits(self, grid, backend, lines):
        enter, leave = arrival(grid, *lines)
        first, last = enter + 0.2 * (leave - enter), leave - 0.3 * (leave - enter)
        for limits in ((None, first), (first, last), (last, None)):
            ends = [
                np.full(len(enter), f) if e is None else e for e, f in zip(limits, FAR, strict=True)
            ]
            steps = walk_along(grid, backend, make_ray(backend, *lines, *limits))
            expected = way_inside(Frame.of(grid), *lines, *ends)
            slack = self.tolerance(grid, backend) * len(steps.length)
            np.testing.assert_allclose(steps.length.sum(axis=0), expected, rtol=0, atol=slack)

    def test_values_are_continuous_from_cell_to_cell(self, grid, backend, lines):
        frame, ends, shape = Frame.of(grid), [], [n + 1 for n in grid.shape]

        def value(corners):
            dr.eval(corners)
            total = 0
            for vertex, weight in zip(corners.vertex, corners.weight, strict=True):
                vertex = np.asarray(vertex) % grid.vertex_count  # rays that have left: any
                index = list(np.unravel_index(vertex, shape))
                if frame.periodic:  # the last vertices are the first
                    index[frame.phi_axis] %= shape[frame.phi_axis] - 1
                number = np.ravel_multi_index(index, shape)
                total += np.asarray(weight) * np.sin(12.9898 * number.astype(float) ** 2)
            return total

        last = [None]

        def visit(walk, track, cursor, segment):
            begin = value(walk.entry_corners(track, cursor))
            if ends:  # but for gaps
                active = np.asarray(segment.active) & (np.asarray(segment.begin) == last[0])
                slack = 64 * self.tolerance(grid, backend) / self.thinnest(grid)
                np.testing.assert_allclose(begin[active], ends[-1][active], rtol=0, atol=slack)
            ends.append(value(walk.exit_corners(track, segment)))
            last[0] = np.asarray(segment.end)

        walk_along(grid, backend, make_ray(backend, *lines), visit)

    def test_interpolation_is_exact_for_own_coordinates(self, grid, backend, lines):
        """Values that are linear in r, theta, phi come out, where rays are."""
        frame, (origins, directions) = Frame.of(grid), lines
        mesh = np.stack(np.meshgrid(*grid.edges, indexing="ij"), axis=-1).reshape(-1, 3)
        enter, _ = arrival(grid, *lines)
        smooth = [a for a in range(3) if not (a == frame.phi_axis and frame.periodic)]
        size = np.maximum(np.abs(mesh).max(axis=0), 1)

        def check(corners, t, active):
            dr.eval(corners)
            found = sum(
                np.asarray(w)[:, None] * mesh[np.where(active, np.asarray(v), 0)]
                for v, w in zip(corners.vertex, corners.weight, strict=True)
            )
            expected = frame.coordinates(origins + (enter + t * grid.scale)[:, None] * directions)
            slack = 256 * self.tolerance(grid, backend) / self.thinnest(grid)
            off = np.abs(found - expected)
            angle = off[:, frame.phi_axis]
            off[:, frame.phi_axis] = np.minimum(angle, np.abs(2 * np.pi - angle))
            off = (off / size)[active][:, smooth]
            assert off.max(initial=0) < slack

        def visit(walk, track, cursor, segment):
            active = np.asarray(segment.active)
            check(walk.entry_corners(track, cursor), np.asarray(cursor.t - track.arrive), active)
            check(walk.exit_corners(track, segment), np.asarray(segment.end), active)

        walk_along(grid, backend, make_ray(backend, *lines), visit)


@dataclass
class Sums:
    """Sums over the segments of each ray."""

    length: np.ndarray
    steps: np.ndarray
    shortest: np.ndarray


def sums(grid, backend, origins, directions, first=None, last=None):
    """Follow rays to their ends in one kernel."""
    walk = grid.walk(backend)
    track, cursor = walk.enter(make_ray(backend, origins, directions, first, last))
    Float, UInt = backend.Float, backend.UInt

    def going_on(cursor, length, steps, shortest):
        return cursor.inside & (steps < MOST_STEPS)

    def step(cursor, length, steps, shortest):
        segment, following = walk.step(track, cursor)
        return following, length + segment.length, steps + 1, dr.minimum(shortest, segment.length)

    _, length, steps, shortest = dr.while_loop(
        (cursor, Float(0), UInt(0), Float(np.inf)), going_on, step
    )
    values = [np.broadcast_to(np.asarray(v), len(origins)) for v in (length, steps, shortest)]
    return Sums(values[0] * grid.scale, values[1], values[2])


def check_adversarial(grid, backend, origins, directions):
    """Rays that hit walls, edges and vertices neither hang nor leak."""
    found = sums(grid, backend, origins, directions)
    assert found.steps.max() < MOST_STEPS
    assert found.shortest.min() >= 0
    frame, (enter, leave) = Frame.of(grid), arrival(grid, origins, directions)
    size = np.linalg.norm(np.ptp(grid.bounds, axis=1))
    rounding = 64 * np.finfo(backend.dtype).eps
    # What grazes a surface gains or loses a chord of the root of the rounding.
    slack = 2 * np.sqrt(rounding) * size
    assert (found.length <= size + slack).all()
    # A ray within the wall between cells and nothing may be on either side.
    clear = ~_within_the_border(frame, origins, directions, enter, leave, 100 * rounding)
    assert clear.mean() > 0.2
    expected = way_inside(frame, origins, directions)
    np.testing.assert_allclose(found.length[clear], expected[clear].astype(float), atol=slack)


def _within_the_border(frame, origins, directions, enter, leave, rounding):
    """Return the rays (R,) that run along the outermost cones, half planes or planes."""
    part = (np.arange(40) + 0.5) / 40
    t = enter[:, None] + part * (leave - enter)[:, None]
    points = origins[:, None] + t[..., None] * directions[:, None]
    own = frame.coordinates(points)
    # On the axis there is no azimuth, near it a rounded one.
    across = np.hypot(points[..., 0], points[..., 1]) / frame.edges[0][-1]
    near = (across < rounding) & (not frame.periodic)
    for axis, edges in enumerate(frame.edges):
        round_sphere = axis == 0 and frame.system == "spherical"
        closed = round_sphere or (axis == frame.phi_axis and frame.periodic)
        polar = frame.system == "spherical" and axis == 1
        nowhere = [0, np.pi, *[np.pi / 2] * frame.mirror] if polar else []
        for border in [] if closed else np.setdiff1d(edges[[0, -1]], nowhere):
            off = np.abs(own[..., axis] - border)
            least = rounding * max(1, np.abs(edges).max())
            if axis == frame.phi_axis:
                least = rounding / np.maximum(across, rounding)
                off = np.minimum(off, np.abs(2 * np.pi - off))
            near |= off < least
    return near.mean(axis=1) > 0.05


def adversarial_rays(grid, reach):
    """Return rays through, along and between the vertices of a grid, begun outside."""
    rng = np.random.default_rng(0)
    mesh = np.meshgrid(*grid.edges, indexing="ij")
    vertices = grid.position(np.stack([m.ravel() for m in mesh])).T
    vertices = vertices[rng.permutation(len(vertices))[:400]]
    pairs = vertices[rng.integers(len(vertices), size=(600, 2))]
    special = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [1, 0, 1], [1, 1, 1]], float)
    special = np.concatenate([special, -special])
    aims = [pairs[:, 0], vertices, np.zeros((len(special), 3))]
    ways = [
        pairs[:, 1] - pairs[:, 0],
        special[rng.integers(len(special), size=len(vertices))],
        special,
    ]
    # In the midplane, along cones (through the centre), and tangent to spheres and cylinders.
    flat = vertices * [1, 1, 0]
    aims += [flat, flat, vertices, vertices]
    ways += [rng.normal(size=flat.shape) * [1, 1, 0], np.cross(flat, [0, 0, 1.0])]
    ways += [vertices, np.cross(vertices, rng.normal(size=vertices.shape))]
    aim, way = np.concatenate(aims), np.concatenate(ways)
    length = np.linalg.norm(way, axis=1)
    aim, way = aim[length > 0], way[length > 0] / length[length > 0, None]
    return aim - reach * way, way


@pytest.fixture(params=("single", "double"))
def precision(request):
    """Both precisions."""
    return request.param


def check_ends_inside_cells(grid, precision):
    """Run towards an observer in a cell, a ray gathers what one that starts there does."""
    volume = vm.Volume(grid, a=np.random.default_rng(1).random(grid.shape))
    camera = vm.Perspective([3.1, 1.7, -1.3], [9, 4, 0], fov=70, resolution=12)
    medium, options = vm.Coefficients(0, "a"), {"precision": precision}
    depths = [
        vm.render(volume, medium, camera, scheme=scheme, **options).optical_depth
        for scheme in both_ways("second-order")
    ]
    tolerance = 1e-12 if precision == "double" else 1e-5
    np.testing.assert_allclose(*depths, rtol=0, atol=tolerance * depths[0].max())
