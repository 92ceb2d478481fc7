"""Models of RADMC-3D: damage, in each kind of file, is named."""

from __future__ import annotations

import numpy as np
import pytest

import voluminous as vm
from contracts import ReaderContract
from radmc3d_directory import in_file_order, put_field, put_grid
from radmc3d_models import EVEN, layered, regular, same, spherical, tree, values


class ModelContract(ReaderContract):
    """What all readers do, for each kind of file in a directory."""

    make, encoding = regular, "text"

    @pytest.fixture
    def sample(self):
        def write(directory):
            return type(self).make(directory, type(self).encoding)

        return write

    def victims(self, path):
        return sorted(file for file in path.iterdir() if file.suffix != ".good")


def contract(make, encoding):
    return type(
        f"Test{make.__name__.title()}{encoding.title()}",
        (ModelContract,),
        {"make": staticmethod(make), "encoding": encoding},
    )


TestRegularText = contract(regular, "text")
TestTreeRecords, TestTreeBinary = contract(tree, "records"), contract(tree, "binary")
TestLayeredText, TestSphericalBinary = contract(layered, "text"), contract(spherical, "binary")


@pytest.mark.parametrize(
    ("line", "text", "told"),
    [
        (0, "3", "format number must be 1, got 3"),
        (1, "20", "grid style must be 0 to 19"),
        (3, "1", "gridinfo must be 0"),
        (5, "2 0 4", "along y must be at least 1"),
        (5, "2 2 2000000000", "z walls: expected 2000000001 numbers, after"),
        (5, "2 two 4", "line 6.*expected a whole number, got 'two'"),
        (6, "21 100 100", "21 levels deep; RADMC-3D takes 20"),
        (6, "20 3 100", "leaves, but 3 are promised"),
        (6, "20 100 -1", "nodes must not be negative"),
        (7, "nan", "x walls must be finite and increase; the one of number 1"),
        (20, "2", "expected 0 or 1, one per line"),
        (20, "10", "line 21: .*expected 0 or 1"),
        (18, "0", "the octree|refined"),
    ],
)
def test_damaged_trees(tmp_path, line, text, told):
    tree(tmp_path)
    path = tmp_path / "amr_grid.inp"
    lines = path.read_text().splitlines()
    lines[line] = text
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(vm.FileFormatError, match=told) as failure:
        vm.open(tmp_path)
    assert "amr_grid.inp" in str(failure.value)


@pytest.mark.parametrize(
    ("layers", "told"),
    [
        ([[1, 1, 1, 1, 2, 2, 2]], "parent of layer 1 must be from 0 to 0"),
        ([[0, 1, 1, 1, 2, 2, 2], [3, 1, 1, 1, 1, 1, 1]], "parent of layer 2"),
        ([[0, 0, 1, 1, 2, 2, 2]], "layer 1 begins at cell"),
        ([[0, 4, 1, 1, 2, 2, 2]], "layer 1 begins at cell"),
        ([[0, 1, 1, 1, 2, 2, 0]], "layer 1 begins at cell"),
        ([[0, 1, 1, 1, 2, 2, 2], [0, 2, 2, 2, 2, 2, 2]], "layers overlap"),
        ([[k, 1, 1, 1, 1, 1, 1] for k in range(21)], "21 levels deep"),
    ],
)
def test_damaged_layers(tmp_path, layers, told):
    put_grid(tmp_path, EVEN, layers=layers)
    cells = 192 + sum(8 * n[4] * n[5] * n[6] for n in layers)
    put_field(tmp_path, "gas_temperature", values(cells))
    with pytest.raises(vm.FileFormatError, match=told):
        vm.open(tmp_path)


def test_sizes_are_compared_before_memory_is_taken(tmp_path):
    """Layers of so many cells that they cannot be: the field's own size says so."""
    huge = 10**5
    walls = [np.array([0.0, 1, 2])] * 3
    layers = [[0, 1, 1, 1, huge, huge, huge]]
    put_grid(tmp_path, walls, layers=layers, encoding="binary")
    put_field(tmp_path, "gas_temperature", values(8))
    with pytest.raises(vm.FileFormatError, match="8 cells, but the grid has 8000000000000008"):
        vm.open(tmp_path)
    text = f"1\n{8 + 8 * huge**3}\n1.0\n"
    (tmp_path / "gas_temperature.inp").write_text(text)
    with pytest.raises(vm.FileFormatError, match="cut short"):
        vm.open(tmp_path)


def test_more_values_than_promised(tmp_path):
    regular(tmp_path)
    path = tmp_path / "gas_density.inp"
    content = path.read_text()
    path.write_text(content + "1.0\n")
    with pytest.raises(vm.FileFormatError, match=r"gas_density.inp: expected 240 .*found 241"):
        vm.open(tmp_path)
    path.write_text(content.replace("1\n240", "1\n240 cells", 1) + "\n\n")  # a remark and blanks
    same(in_file_order(vm.open(tmp_path).array("gas_density")), values(240))
