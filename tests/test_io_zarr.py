"""Zarr of both versions, in directories and ZIP files: plain, with names, and of microscopes."""

from __future__ import annotations

import functools
import shutil
import threading
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pytest
from astropy import units as u

import voluminous as vm
from contracts import ReaderContract
from voluminous.cli import main
from voluminous.io import find_reader

zarr = pytest.importorskip("zarr", "3")
xr = pytest.importorskip("xarray")

RHO = np.arange(24, dtype=np.uint16).reshape(2, 3, 4)
TIMES, CHANNELS = 2, 3
CELLS = np.random.default_rng(0).integers(0, 255, (TIMES, CHANNELS, 4, 6, 8)).astype(np.uint8)


@pytest.fixture(params=[2, 3])
def version(request):
    return request.param


def group_at(path, version):
    return zarr.open_group(str(path), mode="w", zarr_format=version)


def put(group, name, values, **options):
    array = group.create_array(name, shape=values.shape, dtype=values.dtype, **options)
    array[...] = values
    return array


CHANNELS = [
    {"label": "DAPI", "color": "0000FF", "window": {"min": 0, "max": 9, "start": 1, "end": 5}},
    {"label": "GFP 2", "color": "00ff00"},
]


def plain(path, version):
    array = put(group_at(path, version), "gas/rho", RHO, chunks=(1, 2, 2))
    array.attrs["units"] = "g/cm3"
    return path


def microscope(path, version):
    """Write an image of two levels, half a micrometre deep voxels, as the specification says."""
    group, levels = group_at(path, version), []
    for k in range(2):
        f = 2**k
        put(group, str(k), CELLS[:, :, ::f, ::f, ::f], chunks=(1, 1, 2, 4, 4))
        scale = [1, 1, 500.0 * f, 0.25 * f, 0.25 * f]
        shift = [0, 0, 250.0 * (f - 1), 0.125 * (f - 1), 0.125 * (f - 1)]
        steps = [{"type": "scale", "scale": scale}, {"type": "translation", "translation": shift}]
        levels.append({"path": str(k), "coordinateTransformations": steps})
    units = {"z": "nanometer", "y": "micrometer", "x": "micrometer"}
    axes = [{"name": "t", "type": "time"}, {"name": "c", "type": "channel"}]
    axes += [{"name": a, "type": "space", "unit": unit} for a, unit in units.items()]
    told = {
        "multiscales": [{"axes": axes, "datasets": levels}],
        "omero": {"channels": [*CHANNELS, {"color": "no colour", "window": {"start": "low"}}]},
    }
    group.attrs.update({"ome": {"version": "0.5", **told}} if version == 3 else told)
    return path


def zipped(path):
    return shutil.make_archive(str(path), "zip", path)


def test_plain_arrays(tmp_path, version):
    path = plain(tmp_path / "a.zarr", version)
    for place in (path, zipped(path)):
        volume = vm.open(place, spacing=2, unit="pc")
        assert volume.fields == ("rho",)
        assert volume.units["rho"] == "g / cm3"
        assert volume.array("rho").dtype == np.uint16
        np.testing.assert_array_equal(volume.array("rho"), RHO)
        assert volume.grid.bounds.tolist() == [[0, 4], [0, 6], [0, 8]]
    assert find_reader(path).name == "zarr"


def test_names_of_dimensions(tmp_path, version):
    path = tmp_path / "a.zarr"
    coords = {"z": ("z", [3.0, 1.0], {"units": "km"})}
    coords |= {a: (a, np.arange(float(n)), {"units": "m"}) for a, n in (("y", 3), ("x", 4))}
    data = xr.Dataset({"rho": (("z", "y", "x"), RHO)}, coords)
    for consolidated in (True, False):
        data.to_zarr(path, mode="w", consolidated=consolidated, zarr_format=version)
        assert find_reader(path).name == "zarr-xarray"
        for place in (path, zipped(path)):
            volume = vm.open(place)
            np.testing.assert_array_equal(volume.array("rho"), RHO.T[:, :, ::-1])
            assert volume.grid.unit == u.m
            np.testing.assert_allclose(volume.grid.bounds[2], [0, 4000])


@pytest.fixture
def served(tmp_path):
    """Give the address of a local server of the files in the directory."""
    handler = functools.partial(SimpleHTTPRequestHandler, directory=tmp_path)
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


def test_over_http(tmp_path, served, capsys):
    pytest.importorskip("aiohttp")
    plain(tmp_path / "plain.zarr", 3)
    microscope(tmp_path / "cells.ome.zarr", 2)
    data = xr.Dataset({"T": (("z", "y", "x"), RHO)}, {"x": ("x", np.arange(4.0), {"units": "km"})})
    data.to_zarr(tmp_path / "named.zarr", zarr_format=2)
    volume = vm.open(f"{served}/plain.zarr", spacing=2, unit="pc")
    np.testing.assert_array_equal(volume.array("rho"), RHO)
    assert volume.units["rho"] == "g / cm3"
    np.testing.assert_array_equal(vm.open(f"{served}/named.zarr").array("T"), RHO.T)
    cells = vm.open(f"{served}/cells.ome.zarr", time=1, level=1)
    np.testing.assert_array_equal(cells.array("DAPI"), CELLS[1, 0, ::2, ::2, ::2].T)
    assert cells.unit == u.um
    scene = tmp_path / "sub" / "scene.toml"
    scene.parent.mkdir()
    medium = '[[medium]]\ntype = "coefficients"\nemissivity = "rho"\nextinction = 0\n'
    scene.write_text(f'[volume]\npath = "{served}/plain.zarr"\n{medium}')
    np.testing.assert_array_equal(vm.Scene.load(scene).volume().array("rho"), RHO)
    assert main(["info", f"{served}/plain.zarr"]) == 0
    first = capsys.readouterr().out.splitlines()[0]
    assert first.startswith(f"{served}/plain.zarr: ")
    assert "bytes" not in first
    with pytest.raises(vm.FileFormatError, match=f"{served}/none.zarr"):
        vm.open(f"{served}/none.zarr")


def test_channels_times_and_sizes(tmp_path, version):
    path = microscope(tmp_path / "a.ome.zarr", version)
    assert find_reader(path).name == "ome-zarr"
    for place in (path, zipped(path)):
        volume = vm.open(place, time=1)
        assert volume.fields == ("DAPI", "GFP_2", "channel_2")
        assert volume.meta["y_down"] is True
        assert volume.meta["channels"] == {
            "DAPI": {"label": "DAPI", "color": [0, 0, 1], "window": [1, 5]},
            "GFP_2": {"label": "GFP 2", "color": [0, 1, 0]},
            "channel_2": {},
        }
        np.testing.assert_array_equal(volume.array("GFP_2"), CELLS[1, 1].T)
        assert volume.array("GFP_2").dtype == np.uint8
        assert volume.unit == u.um
        # Micrometres along x and y, nanometres along z; the first centre is at 0.
        np.testing.assert_allclose(
            volume.grid.bounds, [[-0.125, 1.875], [-0.125, 1.375], [-0.25, 1.75]]
        )
    assert vm.open(path, time=0, channel=2).fields == ("channel_2",)
    assert [f.name for f in find_reader(path).info(path)] == ["DAPI", "GFP_2", "channel_2"]


class _Contract(ReaderContract):
    def victims(self, path):
        """Return what describes the store, and its pieces: a piece that is not there is zeros."""
        return sorted(p for p in path.rglob("*") if p.is_file())

    def test_cut_short(self, path):
        # A store without one of its descriptions is another store, perhaps a sound one.
        told = [v for v in self.victims(path) if v.name in (".zarray", "zarr.json")]
        for victim in told:
            content = victim.read_bytes()
            for part in (0.0, 0.3, 0.9):
                victim.write_bytes(content[: int(part * len(content))])
                with pytest.raises(vm.FileFormatError, match=path.name):
                    vm.open(path, **self.options)
            victim.write_bytes(content)


class TestMicroscope(_Contract):
    options: dict = {"time": 0}  # noqa: RUF012

    @pytest.fixture
    def sample(self):
        return lambda directory: microscope(directory / "a.ome.zarr", 3)
