"""Meshes and rarer formats by PyVista: resampled where asked, linear fields exactly."""

import numpy as np
import pytest

import voluminous as vm

pv = pytest.importorskip("pyvista")

SLOPES = np.array([1.0, 10.0, 100.0])


def mesh():
    """Return tetrahedra in a box of 4 x 2 x 1, with values linear in the place."""
    box = pv.ImageData(dimensions=(5, 3, 3), spacing=(1, 1, 0.5), origin=(1, 2, 3))
    box["f"] = box.points @ SLOPES
    box["n"] = np.arange(box.n_points, dtype=np.int32)
    made = box.to_tetrahedra()
    made.point_data["f"] = made.points @ SLOPES
    made.cell_data["level"] = np.full(made.n_cells, 3, np.int32)
    made.cell_data["f"] = np.full(made.n_cells, 7.0)
    return made


def check(volume, shape):
    assert volume.grid.shape == shape
    np.testing.assert_allclose(volume.grid.bounds, [[1, 5], [2, 4], [3, 4]], rtol=1e-6)
    centers = [(e[1:] + e[:-1]) / 2 for e in volume.grid.edges]
    x, y, z = np.meshgrid(*centers, indexing="ij")
    np.testing.assert_allclose(volume.array("f"), x + 10 * y + 100 * z, rtol=1e-5)


@pytest.mark.parametrize(("resolution", "shape"), [(8, (8, 4, 2)), ((3, 4, 5), (3, 4, 5))])
def test_meshes_are_resampled_if_a_resolution_is_given(tmp_path, resolution, shape):
    made = mesh()
    for path in (tmp_path / "a.vtu", tmp_path / "a.vtk"):
        made.save(path)
        with pytest.raises(vm.InputError, match=r"give resolution=64"):
            vm.open(path)
        volume = vm.open(path, resolution=resolution)
        check(volume, shape)
        assert (volume.array("f_cell") == 7).all()
        assert (volume.array("level") == 3).all()
    check(vm.Volume.from_pyvista(made, resolution=resolution), shape)
    pv.MultiBlock({"a": made}).save(tmp_path / "a.vtm")
    check(vm.open(tmp_path / "a.vtm", resolution=resolution), shape)


@pytest.mark.parametrize(
    ("axes", "edges"),
    [
        ((" 2 1 0 0", " 3 0 2 0", " 4 0 0 3"), ((0.5, 1.5, 2.5), (1, 3, 5, 7))),
        ((" 2 0 2 0", " 3 1 0 0", " 4 0 0 3"), ((0.5, 1.5, 2.5, 3.5), (1, 3, 5))),
    ],
)
def test_voxels_of_gaussian_cubes_are_where_the_head_says(tmp_path, axes, edges):
    path = tmp_path / "a.cube"
    head = "\n".join(("t", "d", " 1 1 2 3", *axes, " 1 1 0 0 0", ""))
    path.write_text(head + "\n".join(f" {n}.0" for n in range(24)) + "\n")
    volume = vm.open(path)
    for found, right in zip(volume.grid.edges, (*edges, np.arange(1.5, 14, 3)), strict=True):
        np.testing.assert_allclose(found, right)
    values = np.arange(24).reshape(2, 3, 4)
    assert volume.fields == ("d",)
    right = values if len(edges[0]) == 3 else values.transpose(1, 0, 2)
    np.testing.assert_array_equal(volume.array(volume.fields[0]), right)


@pytest.mark.parametrize("name", ["a.dem", "a.segy", "a.neu"])
def test_what_vtk_crashes_on_is_an_error(tmp_path, name):
    (tmp_path / name).write_bytes(b"1 2 3 4 5\n" * 300)
    with pytest.raises(vm.FileFormatError, match="VTK crashes on it"):
        vm.open(tmp_path / name, resolution=4)
