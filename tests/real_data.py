"""Small real data sets as volumes, read with as little code as each format allows.

The data is not part of the repository. It is looked for in ``data`` of the directory named by the
environment variable ``VOLUMINOUS_TEST_DATA`` (default: ``shared`` beside the repository), where a
``PROVENANCE.md`` in each folder says what it is. No reader of the package is used: these functions
also serve to check those.
"""

from __future__ import annotations

import base64
import bz2
import gzip
import io
import re
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import voluminous as vm
from reference import data_directory


def volumes() -> dict[str, Callable[[], vm.Volume]]:
    """Return, by name, functions that read the data sets that are there."""
    root = data_directory() / "data"
    return {
        name: lambda read=read, path=root / path: read(path)
        for name, (path, read) in _SOURCES.items()
        if (root / path).is_file()
    }


def names() -> list[str]:
    """Return all names there may be: what tests are parametrised with."""
    return list(_SOURCES)


def load(name: str) -> vm.Volume:
    """Return one volume, or skip the calling test if its data is absent."""
    found = volumes()
    if name not in found:
        pytest.skip(f"no {name} in {data_directory() / 'data'}; set VOLUMINOUS_TEST_DATA")
    return found[name]()


def cranium(path: Path) -> vm.Volume:
    """Return a head CT in Hounsfield units, 256 x 256 x 108; lengths in mm."""
    return _ct(path, (108, 256, 256), (0.957, 0.957, 1.5))


def headsq(path: Path) -> vm.Volume:
    """Return VTK's head CT, 64 x 64 x 93; lengths in mm."""
    return _ct(path, (93, 64, 64), (3.2, 3.2, 1.5))


def stent(path: Path) -> vm.Volume:
    """Return the CT of a stent graft, 128 x 128 x 256; lengths in mm."""
    values = np.load(path)["arr_0"].transpose()
    return vm.Volume(_boxes(values.shape, (1.0, 1.0, 1.0), "mm"), ct=values)


def hydrogen(path: Path) -> vm.Volume:
    """Return the probability density of a hydrogen orbital, 64^3 (VTK XML, blocks of zlib)."""
    text = re.search(r"<DataArray[^>]*>\s*(\S+)", path.read_text()).group(1)
    head = struct.unpack_from("<3I", base64.b64decode(text[:16]))
    length = 4 * (3 + head[0])
    encoded = 4 * ((length + 2) // 3)
    sizes = np.frombuffer(base64.b64decode(text[:encoded]), np.uint32, offset=12)
    packed = base64.b64decode(text[encoded:])
    ends = np.cumsum(sizes)
    blocks = [zlib.decompress(packed[e - n : e]) for e, n in zip(ends, sizes, strict=True)]
    values = np.frombuffer(b"".join(blocks), np.float32).reshape(64, 64, 64).transpose()
    return vm.Volume(_boxes(values.shape, (1.0, 1.0, 1.0)), probability_density=values)


def frog(path: Path) -> vm.Volume:
    """Return the labels of a frog's tissues, 500 x 470 x 136."""
    packed = zlib.decompress(path.read_bytes())
    values = np.frombuffer(packed, np.uint8).reshape(136, 470, 500).transpose()
    return vm.Volume(_boxes(values.shape, (1.0, 1.0, 1.5)), tissue=values)


def streams(path: Path) -> vm.Volume:
    """Return stellar streams in energy and angular momenta, 128^3 bytes."""
    values = np.load(io.BytesIO(bz2.decompress(path.read_bytes())))
    return vm.Volume(_boxes(values.shape, (1.0, 1.0, 1.0)), counts=values)


def spectral_cube(path: Path) -> vm.Volume:
    """Return a 13CO cube, (right ascension, declination, velocity) = 105 x 105 x 53."""
    from astropy.io import fits

    values = fits.getdata(path).astype(np.float32).transpose()
    return vm.Volume(_boxes(values.shape, (1.0, 1.0, 1.0)), brightness=values)


def carotid(path: Path) -> vm.Volume:
    """Return the blood's speed and velocity in carotid arteries, 76 x 49 x 45."""
    data, shape = path.read_bytes(), (45, 49, 76)
    count = int(np.prod(shape))

    def after(line: bytes, columns: int) -> np.ndarray:
        start = data.index(line) + len(line)
        return np.frombuffer(data, ">f4", count * columns, start).astype(np.float32)

    speed = after(b"LOOKUP_TABLE default\n", 1).reshape(shape).transpose()
    vectors = after(b"VECTORS vectors float\n", 3).reshape(*shape, 3)
    fields = {f"velocity_{a}": vectors[..., k].transpose() for k, a in enumerate("xyz")}
    return vm.Volume(_boxes(speed.shape, (1.0, 1.0, 1.0)), {"speed": speed, **fields})


def athena(path: Path) -> vm.Volume:
    """Return an Athena++ snapshot on a uniform grid of its level 1: finer blocks are averaged."""
    import h5py

    with h5py.File(path) as file:
        names = [name.decode() for name in file.attrs["VariableNames"]]
        levels, places = file["Levels"][:], file["LogicalLocations"][:]
        root, data = file.attrs["RootGridSize"], file["prim"][:]
        bounds = [file.attrs[f"RootGridX{a}"][:2] for a in (1, 2, 3)]
    out = np.zeros((len(names), *(2 * root[::-1])), np.float32)
    for block in range(len(levels)):
        _put(out, data[:, block], int(levels[block]), places[block])
    grid = vm.CartesianGrid.uniform(2 * root, bounds)
    return vm.Volume(grid, {n: v.transpose() for n, v in zip(names, out, strict=True)})


def minihalo(path: Path) -> vm.Volume:
    """Return the middle of an Enzo snapshot, 64^3 cells of its level 4; units of the box."""
    import h5py

    low, cells = 0.625, 64
    width = 0.25 / cells
    centers = low + width * (np.arange(cells) + 0.5)
    out = {name: np.zeros((cells,) * 3, np.float32) for name in ("Density", "Temperature")}
    with h5py.File(path.with_name(path.name.replace("hierarchy", "cpu0000"))) as file:
        for number, left, right in _enzo_grids(path.read_text()):
            for name, values in out.items():
                data = file[f"Grid{number:08d}/{name}"][:].transpose()
                _sample(values, centers, data, left, right)
    return vm.Volume(vm.CartesianGrid.uniform(cells, (low, low + 0.25)), out)


def _ct(path: Path, shape: tuple[int, int, int], spacing: tuple[float, ...]) -> vm.Volume:
    values = np.frombuffer(gzip.decompress(path.read_bytes()), "<i2").reshape(shape).transpose()
    return vm.Volume(_boxes(values.shape, spacing, "mm"), ct=values)


def _boxes(shape: tuple[int, ...], spacing: tuple[float, ...], unit: str = "") -> vm.CartesianGrid:
    limits = [(0.0, n * d) for n, d in zip(shape, spacing, strict=True)]
    return vm.CartesianGrid.uniform(shape, limits, unit=unit)


def _put(out: np.ndarray, block: np.ndarray, level: int, place: np.ndarray) -> None:
    """Write a block (variable, z, y, x) into cells of level 1."""
    if level < 1:
        for axis in (1, 2, 3):
            block = np.repeat(block, 2, axis=axis)
    else:
        step = 2 ** (level - 1)
        nv, nz, ny, nx = block.shape
        parts = (nv, nz // step, step, ny // step, step, nx // step, step)
        block = block.reshape(parts).mean(axis=(2, 4, 6))
    first = [int(p) * n for p, n in zip(place[::-1], block.shape[1:], strict=True)]
    cells = tuple(slice(a, a + n) for a, n in zip(first, block.shape[1:], strict=True))
    out[(slice(None), *cells)] = block


def _enzo_grids(text: str) -> list[tuple[int, np.ndarray, np.ndarray]]:
    """Return number, left and right edge of all grids, coarse ones first."""
    found = re.findall(
        r"Grid = (\d+)\s.*?GridLeftEdge\s*= ([^\n]*)\n\s*GridRightEdge\s*= ([^\n]*)", text, re.S
    )
    numbers = [
        (int(n), np.array(a.split(), float), np.array(b.split(), float)) for n, a, b in found
    ]
    return sorted(numbers, key=lambda grid: -float(np.prod(grid[2] - grid[1])))


def _sample(
    out: np.ndarray, centers: np.ndarray, data: np.ndarray, left: np.ndarray, right: np.ndarray
) -> None:
    """Write the cells of a patch that contain the centres."""
    inside = [
        np.flatnonzero((centers > a) & (centers < b)) for a, b in zip(left, right, strict=True)
    ]
    cells = [
        ((centers[i] - a) / (b - a) * n).astype(int)
        for i, a, b, n in zip(inside, left, right, data.shape, strict=True)
    ]
    out[np.ix_(*inside)] = data[np.ix_(*cells)]


_SOURCES: dict[str, tuple[str, Callable[[Path], vm.Volume]]] = {
    "cranium": ("medical/cranium_ct_108x256x256_int16le.raw.gz", cranium),
    "headsq": ("medical/headsq_93x64x64_int16le.raw.gz", headsq),
    "stent": ("medical/stent_ct.npz", stent),
    "hydrogen": ("classic_small/hydrogen.vti", hydrogen),
    "frog": ("classic_small/frogtissue.zraw", frog),
    "streams": ("cosmo_grids/hdz2000.npy.bz2", streams),
    "l1448": ("fits_l1448_13co/l1448_13co.fits", spectral_cube),
    "carotid": ("vector_fields/carotid.vtk", carotid),
    "turb_collapse": ("athena_turb_collapse/TurbCollapse_t1.607.athdf", athena),
    "disc_outflow": ("athena_disc_outflow/DiskOutflow_t0.20.athdf", athena),
    "minihalo": ("enzo_minihalo/moving7_0010.hierarchy", minihalo),
}
