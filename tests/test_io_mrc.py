"""MRC and CCP4 maps: modes, axes in any order, origins, stacks."""

from __future__ import annotations

import numpy as np
import pytest

import voluminous as vm
from contracts import ReaderContract
from scanner_files import check_places

mrcfile = pytest.importorskip("mrcfile")
VALUES = np.arange(60).reshape(5, 4, 3)  # sections, rows, columns


FLOATS = VALUES.astype(np.float32)


def write_mrc(path, values=FLOATS, width=1.5, order="<", **fields):
    with mrcfile.new(path, overwrite=True) as file:
        file.set_data(values)
        file.voxel_size = width
        for name, value in fields.items():
            file.header[name] = value
    if order == ">":
        with mrcfile.open(path) as file:
            head, data = file.header.copy(), file.data.copy()
        swapped = head.view(head.dtype.newbyteorder(">")).byteswap()
        swapped["machst"] = [0x11, 0x11, 0, 0]
        path.write_bytes(swapped.tobytes() + data.astype(data.dtype.newbyteorder(">")).tobytes())
    return path


def test_axes_in_another_order_and_the_number_of_the_first_voxel(tmp_path):
    # Columns run along z, rows along x, sections along y.
    fields = {"mapc": 3, "mapr": 1, "maps": 2, "nxstart": 7, "nystart": -8, "nzstart": 9}
    path = write_mrc(tmp_path / "a.ccp4", **fields)
    with mrcfile.open(path, mode="r+", permissive=True) as file:
        file.header.mx, file.header.my, file.header.mz = 10, 20, 40
        file.header.cella = (10.0, 40.0, 120.0)  # voxels of 1, 2 and 3 Angstrom
    steps = np.array([[0, 0, 3], [1, 0, 0], [0, 2, 0]])
    origin = np.array([-8.0, 18.0, 21.0])
    check_places(vm.open(path), VALUES.transpose().astype(np.float32), origin, steps)
    with mrcfile.open(path, mode="r+", permissive=True) as file:
        file.header.origin = (100.0, 200.0, 300.0)
    origin = np.array([100.0, 200.0, 300.0])
    check_places(vm.open(path), VALUES.transpose().astype(np.float32), origin, steps)


def test_volumes_of_a_stack_are_chosen(tmp_path):
    values = np.stack([VALUES, VALUES + 100]).astype(np.int16)
    with mrcfile.new(tmp_path / "a.mrc") as file:
        file.set_data(values)
        file.voxel_size = 2.0
    volume = vm.open(tmp_path / "a.mrc", time=1)
    assert volume.meta["times"] == 2
    check_places(volume, values[1].transpose(), np.zeros(3), np.eye(3) * 2)


@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("dtype", [np.int16, np.float32])
def test_files_without_the_mark(tmp_path, dtype, order):
    """Before 2000 there were the numbers of an origin in its place, and no word on byte order."""
    path = write_mrc(tmp_path / "a.mrc", VALUES.astype(dtype), order=order)
    content = bytearray(path.read_bytes())
    content[196:220] = np.array([0, 0, 0, 1, 2, 3], f"{order}f4").tobytes()
    path.write_bytes(content)
    check_places(vm.open(path), VALUES.transpose(), np.zeros(3), np.eye(3) * 1.5)
    content[208:216] = bytes(8)  # left out by a program of today
    path.write_bytes(content)
    check_places(vm.open(path), VALUES.transpose(), np.zeros(3), np.eye(3) * 1.5)
    path.write_bytes(content + b"more")
    with pytest.raises(vm.FileFormatError, match="is named like an MRC"):
        vm.open(path)


class TestMRC(ReaderContract):
    """Recognised by its word."""

    @pytest.fixture
    def sample(self):
        return lambda directory: write_mrc(directory / "map.mrc")
