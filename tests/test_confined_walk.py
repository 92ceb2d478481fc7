"""Walks confined to boxes of cells: the boxes of a volume add up to its picture."""

from __future__ import annotations

import copy
import itertools

import numpy as np
import pytest

import voluminous as vm
from voluminous.backend import dr, from_host, get_backend
from voluminous.errors import InputError
from voluminous.grids.contract import CellBox
from voluminous.rendering.march import RayState, hand_on, march
from voluminous.rendering.options import RenderOptions
from voluminous.rendering.pixels import PixelOrder
from voluminous.rendering.prepare import prepare
from voluminous.rendering.run import make_tracer
from voluminous.rendering.sources.corner_layouts import lattices_of
from voluminous.schemes.base import Skipping

SHAPE = (9, 7, 8)
UNIFORM = vm.CartesianGrid.uniform(SHAPE, [(-1, 1), (-0.8, 0.9), (-1.1, 1)])
UNEVEN = vm.CartesianGrid(*(np.sort(np.random.default_rng(n).uniform(-1, 1, n + 1)) for n in SHAPE))
CAMERAS = {
    "oblique": vm.Orthographic(35, 50, 20, width=4, resolution=24),
    "face-on": vm.Orthographic(0, 0, width=2.6, resolution=24),
    "along x": vm.Orthographic(90, 90, width=2.6, resolution=24),
    "along the diagonal": vm.Orthographic(
        np.degrees(np.arccos(3**-0.5)), 45, width=4, resolution=24
    ),
    "from outside": vm.Perspective((3, 1, 2), (0, 0, 0), 50, resolution=24),
    "from inside": vm.Perspective((0.1, 0.05, 0.02), (1, 1, 0.3), 80, resolution=24),
}


def boxes(shape, cuts):
    """Return boxes that part a grid at `cuts` along each axis, each with its place among others."""
    walls = [[0, *cut, n] for cut, n in zip(cuts, shape, strict=True)]
    parts = [list(itertools.pairwise(w)) for w in walls]
    for place in itertools.product(*(range(len(p)) for p in parts)):
        ends = [parts[a][k] for a, k in enumerate(place)]
        yield place, CellBox(tuple(e[0] for e in ends), tuple(e[1] for e in ends))


def along(direction, order):
    """Sort boxes along a ray that runs in a direction, octant by octant."""
    signs = np.where(np.asarray(direction) < 0, -1, 1)
    return sorted(order, key=lambda part: tuple(signs * part[0]))


def drawing_of(volume, medium, camera, scheme, tolerance):
    options = RenderOptions(scheme=scheme, tolerance=tolerance, cutoff=0, device="cpu")
    job, _ = prepare(volume, medium, camera, options)
    drawing = make_tracer(job, 0.0)
    if job.controlled:
        drawing.allow(1e-3, 1e-3, 0.05)
    return drawing


def path_of(state):
    return np.array([np.asarray(n) for n in (*state.path.emission, *state.path.transparency)])


def pictures(grid, camera, scheme, tolerance, cuts):
    """Return what rays gather in the whole volume, and in its boxes one after another."""
    values = np.random.default_rng(5).uniform(0, 1, grid.shape).astype(np.float32)
    values[0, 0, 0], values[-1, -1, -1] = 0, 1
    volume, medium = (
        vm.Volume(grid, a=values),
        vm.Gaussian("a", 0.5, 0.2, (1, 0.5, 0.2), opacity=0.4),
    )
    whole = drawing_of(volume, medium, camera, scheme, tolerance)
    whole.source.skipping, walk = Skipping(), grid.walk(whole.backend, whole.job.walk_kind)
    count = int(np.prod(whole.job.frame.pixels))
    ray = whole.ray(PixelOrder(whole.job.frame.pixels).lanes(0, count, whole.backend))
    before = RayState(whole.nothing())
    reference = march(walk, whole.limited(whole.source), whole.scheme, ray, before, None, False)
    held = CellBox.with_ghosts.fget if whole.job.walk_kind == "dual" else cells_of
    octants = np.array(np.broadcast_arrays(*(np.asarray(d) < 0 for d in ray.direction)))
    octants = np.broadcast_to(octants, (3, count))
    found = path_of(reference) * np.nan
    for octant in np.unique(octants, axis=1).T:
        state = RayState(whole.nothing())
        for _, box in along(np.where(octant, -1, 1), boxes(grid.shape, cuts)):
            source = part_of(whole.source, values, held(box), grid)
            walk = grid.walk(whole.backend, whole.job.walk_kind, box)
            _, cursor = walk.enter(ray)
            after = march(walk, whole.limited(source), whole.scheme, ray, state, None, False)
            state = hand_on(state, cursor.inside, after)
            dr.eval(state)
        mine = (octants == octant[:, None]).all(axis=0)
        found[:, mine] = path_of(state)[:, mine]
    return path_of(reference), found


def cells_of(box):
    return tuple(slice(a, b) for a, b in zip(box.low, box.high, strict=True))


def part_of(source, values, where, grid):
    """Return the source of a whole volume with the data of a box."""
    part = copy.copy(source)
    if hasattr(source, "lattices"):
        part.lattices = {"a": lattices_of(grid, [values[where]], source.backend)[0]}
    else:
        part.packets = [
            from_host(type(data), np.asarray(data).reshape(*grid.shape, width)[where].ravel())
            for data, width in zip(source.packets, source.widths, strict=True)
        ]
    return part


@pytest.mark.each_value_once
@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
@pytest.mark.parametrize("grid", [UNIFORM, UNEVEN], ids=["uniform", "uneven"])
def test_boxes_add_up_to_the_whole(grid, camera):
    for cuts in ([(4,), (3,), (4,)], [(1, 5), (2,), (7,)]):
        whole, found = pictures(grid, camera, "first-order", None, cuts)
        np.testing.assert_array_equal(found, whole)
        assert whole.max() > 0


@pytest.mark.parametrize("tolerance", [None, 1e-3])
def test_boxes_with_a_ghost_layer_add_up_on_interpolated_fields(tolerance):
    for camera in ("oblique", "along x", "from inside"):
        cuts = [(4,), (3,), (1, 4)]
        whole, found = pictures(UNIFORM, CAMERAS[camera], "post-classified", tolerance, cuts)
        np.testing.assert_array_equal(found, whole)
        assert whole.max() > 0


def test_other_walks_and_grids_refuse_a_box():
    backend = get_backend("cpu", "single")
    box = CellBox((0, 0, 0), (1, 1, 1))
    octree = vm.OctreeGrid([0, 1, 2], [0, 1], [0, 1])
    spherical = vm.SphericalGrid([0, 1, 2])
    for grid, kind in ((UNIFORM, "coarse"), (octree, "cells"), (spherical, "dual")):
        with pytest.raises(InputError, match="cannot be confined"):
            grid.walk(backend, kind, box)
    with pytest.raises(InputError, match="low < high"):
        UNIFORM.walk(backend, "cells", CellBox((0, 0, 0), (10, 1, 1)))
