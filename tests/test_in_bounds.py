"""No kernel reads beyond its arrays: what lies there is anything, or the end of the process."""

from __future__ import annotations

import numpy as np
import pytest

import voluminous as vm
from test_any_grid_derivatives import patches
from voluminous.backend import dr

AXIS = np.linspace(-1.0, 1.0, 4)


def uneven_octree():
    """Return leaves of three levels."""
    return vm.OctreeGrid.from_function(
        AXIS, AXIS, AXIS, lambda x, y, z, size: x * x + y * y + z * z < 4 * size * size, 3
    )


THETA, PHI = np.linspace(0, np.pi, 3), np.linspace(0, 2 * np.pi, 5)
# The first base cell is split, and its first child again.
SPLIT = [1, 1, *[0] * 15, *[0] * 15]
GRIDS = {
    "rectilinear": lambda: vm.CartesianGrid(AXIS**3, AXIS, AXIS),
    "octree": uneven_octree,
    "patches": patches,
    "wedge": lambda: vm.SphericalGrid([0, 0.5, 1], np.linspace(0.5, 2, 4), np.linspace(0, 2, 4)),
    "refined": lambda: vm.SphericalGrid([0.2, 0.5, 1], THETA, PHI, refined=SPLIT),
}
INSIDE = vm.Perspective([0.3, 0.2, 0.1], [0.0, 0.0, 0.0], fov=90, resolution=8)


def noise(kind):
    """Return a volume with a field between 0 and 1."""
    grid = GRIDS[kind]()
    return vm.Volume(grid, a=np.random.default_rng(2).random(grid.shape))


@pytest.fixture
def in_bounds(capfd):
    """Let Dr.Jit look at every gather, and fail if one was beyond its array."""
    with dr.scoped_set_flag(dr.JitFlag.Debug, True):
        yield
    told = [line for line in "".join(capfd.readouterr()).splitlines() if "out-of-bounds" in line]
    assert not told, told[:3]


@pytest.mark.each_value_once
@pytest.mark.usefixtures("in_bounds")
@pytest.mark.parametrize("scheme", ["first-order", "second-order", "post-classified"])
@pytest.mark.parametrize("kind", GRIDS)
def test_pictures(kind, scheme):
    image = vm.render(noise(kind), vm.Coefficients("a", "2 * a"), INSIDE, scheme=scheme)
    assert np.isfinite(image.intensity).all()


@pytest.mark.usefixtures("in_bounds")
@pytest.mark.parametrize("kind", GRIDS)
def test_derivatives(kind):
    assert np.isfinite(noise(kind).evaluate("laplacian(a)")).all()


@pytest.mark.usefixtures("in_bounds")
def test_tables_of_what_ends_on_the_way():
    """From a value on to none: of the logarithm of what falls below zero."""
    values = np.linspace(-1, 1, 27).reshape(3, 3, 3)
    volume = vm.Volume(vm.CartesianGrid(AXIS, AXIS, AXIS), a=values)
    table = vm.Table("log10(a)", [-2, -1, 0], [0, 1, 2], [0, 1, 2], 1.0)
    with pytest.raises(vm.InputError, match="not finite"):
        vm.render(volume, table, INSIDE)
