"""OpenVDB: voxels land where its library says, with a stand-in for it where it is not there."""

import importlib
import sys
import types

import numpy as np
import pytest

import voluminous as vm
from voluminous.io.openvdb import _MAGIC as MAGIC

VALUES = np.random.default_rng(0).random((5, 4, 3), dtype=np.float32)
WIND = np.random.default_rng(1).random((3, 2, 2, 3), dtype=np.float32)
LOW = (5, -6, 7)


def library():
    """Return OpenVDB's module, or None."""
    for name in ("openvdb", "pyopenvdb"):
        try:
            return importlib.import_module(name)
        except ImportError:
            continue
    return None


class Transform:
    """Equal voxels: index times width."""

    isLinear = True

    def __init__(self, width):
        self.width = width

    def indexToWorld(self, place):
        return tuple(self.width * n for n in place)


class Grid:
    """A grid as the library's, of one array."""

    def __init__(self, name, kind, values, low, width):
        self.name, self.valueTypeName, self.values, self.low = name, kind, values, low
        self.transform = Transform(width)
        high = tuple(int(n) for n in np.add(low, values.shape[:3]) - 1)
        self.metadata = {"file_bbox_min": low, "file_bbox_max": high}

    def copyToArray(self, array, ijk):
        array[...] = 0
        start = np.subtract(self.low, ijk)
        box = tuple(slice(a, a + n) for a, n in zip(start, self.values.shape[:3], strict=True))
        array[box] = self.values


@pytest.fixture
def made(monkeypatch):
    """Return the grids that the stand-in finds in any file."""
    grids = [
        Grid("density", "float", VALUES, LOW, 0.5),
        Grid("wind", "vec3s", WIND, (6, -5, 8), 0.5),
        Grid("mask", "bool", VALUES > 0.5, LOW, 1.0),
    ]
    module = types.ModuleType("openvdb")
    module.readAllGridMetadata = lambda path: grids
    module.read = lambda path, name: next(g for g in grids if g.name == name)
    monkeypatch.setitem(sys.modules, "openvdb", module)
    return grids


@pytest.fixture
def path(made, tmp_path):
    path = tmp_path / "a.vdb"
    path.write_bytes(MAGIC)
    return path


@pytest.fixture
def real(tmp_path):
    """Return a file by the library itself."""
    vdb = library()
    if vdb is None or (isinstance(vdb, types.ModuleType) and not hasattr(vdb, "FloatGrid")):
        pytest.skip("OpenVDB's Python module is not there")
    grids = []
    for kind, name, values, low, width in (
        ("FloatGrid", "density", VALUES, LOW, 0.5),
        ("Vec3SGrid", "wind", WIND, (6, -5, 8), 0.5),
        ("BoolGrid", "mask", VALUES > 0.5, LOW, 1.0),
    ):
        grid = getattr(vdb, kind)()
        grid.copyFromArray(values, ijk=low)
        grid.name, grid.transform = name, vdb.createLinearTransform(width)
        grids.append(grid)
    path = tmp_path / "real.vdb"
    vdb.write(str(path), grids=grids)
    return path


@pytest.fixture(params=["path", "real"])
def either(request):
    return request.getfixturevalue(request.param)


def test_voxels_are_cells_around_their_places(either):
    volume = vm.open(either, "density")
    np.testing.assert_array_equal(volume.array("density"), VALUES)
    first = np.array(LOW) * 0.5
    np.testing.assert_allclose(volume.grid.bounds[:, 0], first - 0.25)
    np.testing.assert_allclose(volume.grid.bounds[:, 1], first + np.array(VALUES.shape) / 2 - 0.25)
    assert vm.open(either, {"rho": "density"}).fields == ("rho",)


def test_grids_share_the_box_of_all(either):
    volume = vm.open(either, ["density", "wind"])
    assert volume.fields == ("density", "wind_x", "wind_y", "wind_z")
    assert volume.grid.shape == (5, 4, 3)
    # Where a grid has no voxels it has its background.
    expected = np.zeros((5, 4, 3), np.float32)
    expected[1:4, 1:3, 1:3] = WIND[..., 1]
    np.testing.assert_array_equal(volume.array("wind_y"), expected)
    assert vm.open(either, "wind").grid.shape == (3, 2, 2)
    assert vm.open(either, "mask").array("mask").dtype == bool


def test_files_cut_short_are_refused(real):
    content = real.read_bytes()
    real.write_bytes(content[: len(content) // 2])
    with pytest.raises(vm.FileFormatError, match=real.name):
        vm.open(real, "density")


def test_without_the_library_it_is_said_how_to_get_it(path, monkeypatch):
    for name in ("openvdb", "pyopenvdb"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(
        vm.errors.MissingPackageError, match=r"conda install -c conda-forge openvdb"
    ):
        vm.open(path)
