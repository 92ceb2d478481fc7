"""PLUTO's HDF5 files of static grids: the kind of grid follows from where its nodes are."""

from __future__ import annotations

import h5py
import numpy as np
import pytest

import voluminous as vm
from contracts import ReaderContract
from voluminous.io import find_reader

LOG = np.geomspace(1, 4, 6)
GRIDS = {
    "cartesian": (np.linspace(-1, 1, 5), np.linspace(0, 3, 4), np.geomspace(1, 2, 6)),
    "cylindrical": (LOG, np.linspace(0, 2 * np.pi, 9), np.linspace(-1, 1, 4)),
    "spherical": (LOG, np.linspace(0, np.pi, 5), np.linspace(0, 2 * np.pi, 9)),
    "wedge": (np.linspace(0, 2, 5), np.linspace(0.5, 2, 4), np.linspace(0.2, 1, 3)),
}


def cartesian(kind, a, b, c):
    if kind == "cartesian":
        return a, b, c
    if kind == "cylindrical":
        return a * np.cos(b), a * np.sin(b), c
    return a * np.sin(b) * np.cos(c), a * np.sin(b) * np.sin(c), a * np.cos(b)


def write(path, kind="spherical", step=3, dtype="f8"):
    edges = GRIDS[kind]
    middles = [(e[1:] + e[:-1]) / 2 for e in edges]
    with h5py.File(path, "w") as file:
        for group, ticks in (("node_coords", edges), ("cell_coords", middles)):
            points = cartesian(kind, *np.meshgrid(*ticks, indexing="ij"))
            for name, values in zip("XYZ", points, strict=True):
                file[f"{group}/{name}"] = values.T.astype("f4")
        a, b, c = np.meshgrid(*middles, indexing="ij")
        file.create_group(f"Timestep_{step}").attrs["Time"] = 2.5
        for k, name in enumerate(("rho", "vx1", "vx2", "vx3", "prs", "tr1")):
            file[f"Timestep_{step}/vars/{name}"] = ((k + 1) * (a + 10 * b + 100 * c)).T.astype(
                dtype
            )
        file[f"Timestep_{step}/stag_vars/Bx1s"] = np.zeros(3)
    return path


class TestContract(ReaderContract):
    @pytest.fixture
    def sample(self):
        return lambda directory: write(directory / "data.0003.dbl.h5")

    def reader(self, path):
        reader = find_reader(path)
        assert reader.name == "pluto"
        return reader


@pytest.mark.parametrize("kind", GRIDS)
def test_grids_and_values(tmp_path, kind):
    volume = vm.open(write(tmp_path / "data.0003.flt.h5", kind, dtype="f4"))
    name = "spherical" if kind == "wedge" else kind
    assert type(volume.grid).__name__ == f"{name.title()}Grid"
    for found, edges in zip(volume.grid.edges, GRIDS[kind], strict=True):
        np.testing.assert_allclose(found, edges, atol=1e-6)
    a, b, c = np.meshgrid(*((e[1:] + e[:-1]) / 2 for e in GRIDS[kind]), indexing="ij")
    np.testing.assert_allclose(volume.array("density"), a + 10 * b + 100 * c, rtol=1e-6)
    components = {"cartesian": "xyz", "cylindrical": ("R", "phi", "z")}
    second = components.get(kind, ("r", "theta", "phi"))[1]
    np.testing.assert_allclose(
        volume.array(f"velocity_{second}"), 3 * (a + 10 * b + 100 * c), rtol=1e-6
    )
    assert {"pressure", "tr1"} < set(volume.fields)
    assert volume.meta["time"] == 2.5
    assert volume.array("density").dtype == np.float32


def test_units_of_the_code(tmp_path):
    path = write(tmp_path / "data.0003.dbl.h5")
    volume = vm.open(path, length_unit="2 au", velocity_unit="1 km/s", density_unit="1e-20 g/cm3")
    assert str(volume.unit) == "AU"
    np.testing.assert_allclose(volume.grid.edges[0], 2 * LOG, rtol=1e-6)
    plain = vm.open(path)
    np.testing.assert_allclose(volume.array("density"), 1e-20 * plain.array("density"))
    assert volume.units["pressure"] == "erg / cm3"
    assert volume.meta["time_unit"] == "s"


def test_what_is_no_such_grid_is_said(tmp_path):
    path = write(tmp_path / "data.0003.dbl.h5")
    with h5py.File(path, "a") as file:
        file["node_coords/X"][...] += np.arange(file["node_coords/X"].size).reshape(9, 5, 6) % 7
    with pytest.raises(vm.InputError, match="no Cartesian, polar or spherical grid"):
        vm.open(path)
    with h5py.File(path, "a") as file:
        for name in "XYZ":
            del file[f"node_coords/{name}"]
            file[f"node_coords/{name}"] = np.zeros((3, 4))
    with pytest.raises(vm.InputError, match="2 dimensions, expected 3"):
        vm.open(path)
