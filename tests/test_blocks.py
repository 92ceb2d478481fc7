"""Blocks of one shape, as codes with block-structured refinement write: rays stay within them."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import voluminous as vm

CAMERAS = {
    "oblique": vm.Orthographic(50, 20, 10, resolution=(23, 19)),
    "along z": vm.Orthographic(0, 0, resolution=24),
    "from below": vm.Orthographic(133, -70, resolution=16),
    "inside": vm.Perspective((0.11, 0.5, 0.3), (1.7, 1.1, 0.9), 80, resolution=17),
}


def blocks(seed, shape, ratio, roots=(2, 3, 1), levels=3):
    """Return a grid of blocks, each of them divided at random into ratio³ of the same shape."""
    rng = np.random.default_rng(seed)
    todo = [(np.array(k, float), 1.0, 0) for k in itertools.product(*map(range, roots))]
    lower, upper = [], []
    while todo:
        corner, size, level = todo.pop()
        if level + 1 < levels and rng.random() < (0.7, 0.35)[level]:
            part = size / ratio
            steps = itertools.product(range(ratio), repeat=3)
            todo += [(corner + part * np.array(step), part, level + 1) for step in steps]
        else:
            lower.append(corner)
            upper.append(corner + size)
    return vm.PatchGrid(lower, upper, shape)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("precision", ["single"])
def test_lengths_add_up_to_chords(seed, precision):
    grid = blocks(seed, (3, 2, 4), 2)
    volume = vm.Volume(grid, f=np.ones(grid.size))
    rng = np.random.default_rng(seed)
    for _ in range(5):
        incl, phi = np.degrees(np.arccos(rng.uniform(-1, 1))), rng.uniform(0, 360)
        camera = vm.Orthographic(incl, phi, resolution=40)
        whole = vm.CartesianGrid([0, 2], [0, 3], [0, 1])
        one = vm.Volume(whole, f=np.ones(whole.shape))
        chord, found = (
            vm.render(v, vm.Coefficients("0", "f"), camera, scheme="first-order", precision=p)
            for v, p in ((one, "double"), (volume, precision))
        )
        most = 2e-6 if precision == "single" else 1e-12
        np.testing.assert_allclose(found.optical_depth, chord.optical_depth, atol=most * 3.8)


@pytest.mark.parametrize("change", ["shape", "lattice", "hidden"])
def test_other_patches_have_no_such_rule(change):
    lower = np.array([[0, 0, 0], [4, 0, 0]])
    upper, shape = lower + 4, [[4, 4, 4], [4, 4, 4]]
    if change == "shape":
        upper, shape = [[4, 4, 4], [6, 4, 4]], [[4, 4, 4], [2, 4, 4]]
    if change == "lattice":
        lower, upper = [[0, 0, 0], [6, 0, 0], [4, 0, 0]], [[4, 4, 4], [10, 4, 4], [8, 4, 4]]
        shape = [[4, 4, 4]] * 3
    if change == "hidden":
        lower, upper = [[0, 0, 0], [1, 1, 1]], [[4, 4, 4], [3, 3, 3]]
    grid = vm.PatchGrid(lower, upper, shape)
    from voluminous.backend import get_backend

    traced = grid.tree.numbering.traced(grid.tree, get_backend("cpu", "single"))
    assert traced.blocks is None
    volume = vm.Volume(grid, f=np.ones(grid.size))
    depth = vm.render(
        volume,
        vm.Coefficients("0", "1"),
        vm.Orthographic(90, 0, resolution=4),
        scheme="first-order",
    ).optical_depth
    np.testing.assert_allclose(depth.max(), 4, rtol=1e-6)
