"""NeXus: NXdata groups on their axes."""

from __future__ import annotations

import h5py
import numpy as np
import pytest

import voluminous as vm
from contracts import ReaderContract
from voluminous.io import find_reader

pytest.importorskip("xarray")
Z, Y, X = np.arange(4) * 2.0, np.arange(3) * 0.5 - 1, np.arange(5) + 10.0
VALUES = 100 * Z[:, None, None] + 10 * Y[:, None] + X


def write(
    path, *, signal="counts", axes=("z", "y", "x"), values=VALUES, ticks=(Z, Y, X), unit="mm"
):
    with h5py.File(path, "w") as file:
        file.attrs.update(NX_class="NXroot", default="entry")
        entry = file.create_group("entry")
        entry.attrs.update(NX_class="NXentry", default="plot")
        data = entry.create_group("plot")
        data.attrs.update(NX_class="NXdata", signal=signal, axes=list(axes))
        data[signal] = values
        data[signal].attrs["units"] = "K"
        for name, values in zip(axes, ticks, strict=True):
            if name != "." and values is not None:
                data[name] = values
                data[name].attrs["units"] = unit
    return path


def expected(volume):
    x, y, z = np.meshgrid(*((e[1:] + e[:-1]) / 2 for e in volume.grid.edges), indexing="ij")
    return 100 * z + 10 * y + x


class TestContract(ReaderContract):
    @pytest.fixture
    def sample(self):
        return lambda directory: write(directory / "a.nxs")

    def reader(self, path):
        reader = find_reader(path)
        assert reader.name == "nexus"
        return reader


@pytest.mark.parametrize("ending", ["", "edges", "backwards"])
def test_axes_are_centres_or_edges_of_cells(tmp_path, ending):
    ticks, values = [Z, Y, X], VALUES
    if ending == "edges":
        ticks[0] = np.arange(5) * 2.0 - 1
    elif ending == "backwards":
        ticks[1], values = Y[::-1], VALUES[:, ::-1]
    volume = vm.open(write(tmp_path / "a.h5", ticks=ticks, values=values))
    assert volume.grid.shape == (5, 3, 4)
    assert str(volume.unit) == "mm"
    assert volume.units == {"counts": "K"}
    np.testing.assert_allclose(volume.grid.bounds, [[9.5, 14.5], [-1.25, 0.25], [-1, 7]])
    np.testing.assert_allclose(volume.array("counts"), expected(volume))


def test_the_default_is_shown_and_others_are_chosen(tmp_path):
    path = write(tmp_path / "a.h5")
    with h5py.File(path, "a") as file:
        file.copy("entry/plot", "entry/another")
        file["entry/another/counts"][:] = 7
        flat = file.create_group("entry/flat")
        flat.attrs.update(NX_class="NXdata", signal="counts")
        flat["counts"] = np.zeros((3, 3))
    np.testing.assert_allclose(vm.open(path).array("counts").max(), VALUES.max())
    assert (vm.open(path, group="entry/another").array("counts") == 7).all()
    with pytest.raises(vm.errors.UnknownNameError, match="entry/another"):
        vm.open(path, group="entry/anothr")
    with h5py.File(path, "a") as file:
        del file.attrs["default"]
    assert vm.open(path).meta["group"] == "/entry/another"


def test_older_files_and_linked_data(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        entry = file.create_group("entry")
        entry.attrs["NX_class"] = np.bytes_("NXentry")
        entry["detector/raw"] = VALUES
        data = entry.create_group("data")
        data.attrs["NX_class"] = np.bytes_("NXdata")
        data["counts"] = h5py.SoftLink("/entry/detector/raw")
        data["missing"] = entry["missing"] = h5py.ExternalLink("missing.h5", "/counts")
        data["gone"] = file["gone"] = h5py.SoftLink("/entry/gone")
        entry["detector/raw"].attrs.update(signal=1, axes=np.bytes_("z:y:x"))
        data["z"], data["y"], data["x"] = Z, Y, X
    volume = vm.open(tmp_path / "a.h5")
    np.testing.assert_allclose(volume.array("counts"), expected(volume))
