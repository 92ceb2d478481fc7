"""Reader for OpenVDB's sparse voxels: OpenVDB's library fills the bounding box of active voxels."""

from __future__ import annotations

import functools
import importlib
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from ..errors import FileFormatError, InputError, MissingPackageError
from ..memory import check_memory
from .contract import FieldInfo, Reader
from .scanners.placement import Arrangement, Placement, arranged
from .vtk.dataset import OPTIONS, DataArray, Dataset

if TYPE_CHECKING:
    from ..volume import Volume

_MAGIC = b" BDV\0\0\0\0"
# Format versions whose header `_check_whole` can read (openvdb/version.h).
_KNOWN = range(216, 300)
# Array type and number of components for each OpenVDB type name.
_TYPES = {
    "bool": ("?", 1),
    "float": ("f4", 1),
    "double": ("f8", 1),
    "int32": ("i4", 1),
    "int64": ("i8", 1),
    "vec3s": ("f4", 3),
    "vec3d": ("f8", 3),
    "vec3i": ("i4", 3),
}
_LONGEST = 200
# Bytes per cell for the walls along one axis.
_PER_LAYER = 64


class OpenVDBReader(Reader):
    """Scalar and vector grids; inactive voxels have the background value of the grid."""

    name = "vdb"
    description = "an OpenVDB file"
    suffixes = (".vdb",)
    options = OPTIONS
    packages = ("openvdb",)

    def matches(self, path: Path, head: bytes) -> bool:
        return head.startswith(_MAGIC)

    def read(self, path: Path, fields: Any = None, *, unit: Any = None, **options: Any) -> Volume:
        grids = _grids(path)
        whole = Dataset((1, 1, 1), _nowhere, [_array(path, name, g) for name, g in grids.items()])
        chosen = {array.name for array, _ in whole.chosen(fields).values()}
        shown = _dataset(path, {name: g for name, g in grids.items() if name in chosen})
        return shown.volume(fields, unit)

    def info(self, path: Path, **options: Any) -> tuple[FieldInfo, ...]:
        found: list[FieldInfo] = []
        for name, grid in _grids(path).items():
            found += _dataset(path, {name: grid}).infos()
        return tuple(found)


def _module() -> Any:
    """Return OpenVDB's Python module, which had another name before version 11."""
    for name in ("openvdb", "pyopenvdb"):
        try:
            return importlib.import_module(name)
        except ImportError:
            continue
    raise MissingPackageError(
        "reading OpenVDB files needs OpenVDB's own Python module, which is not on the Python "
        "package index; install it with\n"
        "  conda install -c conda-forge openvdb\n"
        "or, for the system's Python of Debian and Ubuntu,\n"
        "  apt install python3-openvdb"
    )


def _grids(path: Path) -> dict[str, Any]:
    grids: dict[str, Any] = {}
    with _library(path) as module:
        found = module.readAllGridMetadata(str(path))
    for number, grid in enumerate(found):
        if grid.valueTypeName in _TYPES:
            grids.setdefault(grid.name or f"grid_{number}", grid)
    if not grids:
        raise FileFormatError("expected grids of numbers or vectors, there are none")
    return grids


def _dataset(path: Path, grids: dict[str, Any]) -> Dataset:
    steps = {name: _steps(grid) for name, grid in grids.items()}
    first = next(iter(steps.values()))
    if not all(np.allclose(first, other, rtol=1e-6, atol=0) for other in steps.values()):
        listed = ", ".join(f"{n} {np.linalg.norm(s[1:], axis=1)}" for n, s in steps.items())
        raise InputError(
            f"the grids have voxels of different sizes or at different places ({listed}); choose "
            "some of one kind with fields=[…]"
        )
    boxes = [_box(path, name, grid) for name, grid in grids.items()]
    low = np.min([box[0] for box in boxes], axis=0)
    points = tuple(int(n) for n in np.max([box[1] for box in boxes], axis=0) - low + 1)
    check_memory(_PER_LAYER * sum(points), "the walls of the voxels", "is the file damaged?")
    origin = first[0] + low @ first[1:]

    def arrange(at: str, unit: Any) -> Arrangement:
        return arranged(points, Placement(origin, first[1:], unit))

    arrays = [_array(path, name, grid, low, points) for name, grid in grids.items()]
    return Dataset(points, arrange, arrays)


def _steps(grid: Any) -> np.ndarray:
    """Return the position of voxel (0, 0, 0) and the steps along the indices, shape (4, 3)."""
    transform = grid.transform
    if not transform.isLinear:
        raise InputError(
            f"grid {grid.name!r} has voxels of different sizes (a frustum): resample it to equal "
            "voxels first"
        )
    places = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    corners = np.array([transform.indexToWorld(place) for place in places], float)
    return np.concatenate([corners[:1], corners[1:] - corners[0]])


def _box(path: Path, name: str, grid: Any) -> tuple[Any, Any]:
    """Return the first and last index of the active voxels."""
    meta = grid.metadata
    if "file_bbox_min" in meta and "file_bbox_max" in meta:
        low, high = meta["file_bbox_min"], meta["file_bbox_max"]
    else:
        low, high = _voxels(path, name).evalActiveVoxelBoundingBox()
    if any(a > b for a, b in zip(low, high, strict=True)):
        raise InputError(f"grid {name!r} is empty: no voxel of it is set; choose others")
    return low, high


def _array(path: Path, name: str, grid: Any, low: Any = (0, 0, 0), points: Any = ()) -> DataArray:
    dtype, components = _TYPES[grid.valueTypeName]
    load = functools.partial(_load, path, name, tuple(int(n) for n in low), points)
    return DataArray(name, "", components, np.dtype(dtype), load)


def _load(path: Path, name: str, low: tuple[int, ...], points: tuple[int, ...]) -> np.ndarray:
    grid = _voxels(path, name)
    dtype, components = _TYPES[grid.valueTypeName]
    values = np.empty(points if components == 1 else (*points, components), dtype)
    grid.copyToArray(values, ijk=low)
    return values.reshape(*points, components).transpose(2, 1, 0, 3)


def _voxels(path: Path, name: str) -> Any:
    with _library(path) as module:
        return module.read(str(path), name)


@contextmanager
def _library(path: Path) -> Iterator[Any]:
    """Yield the library; shorten its errors, which may quote gigabytes of a damaged file."""
    module = _module()
    try:
        _check_whole(path)
    except struct.error as error:
        raise FileFormatError("it is cut short within its header") from error
    try:
        yield module
    except (Exception, MemoryError) as error:
        message = str(next(iter(error.args), ""))[:_LONGEST]
        raise FileFormatError(
            f"OpenVDB cannot read it ({type(error).__name__}: {message})"
        ) from None


def _nowhere(at: str, unit: Any) -> Arrangement:
    raise AssertionError("fields are only chosen among these arrays")


def _check_whole(path: Path) -> None:
    """Follow the grid offsets to detect a truncated file, which misleads the library."""

    def take(format: str) -> int:
        (number,) = struct.unpack(format, file.read(struct.calcsize(format)))
        return int(number)

    def skip_texts(file: IO[bytes], count: int) -> None:
        for _ in range(count):
            file.seek(take("<I"), 1)

    size = path.stat().st_size
    with open(path, "rb") as file:
        file.seek(len(_MAGIC))
        version = take("<I")
        file.seek(8, 1)  # version of the library
        if version not in _KNOWN or not take("<B"):  # a stream has no offsets
            return
        file.seek(36, 1)  # an identifier
        for _ in range(take("<I")):
            skip_texts(file, 3)  # name, type and value of a metadata entry
            if file.tell() > size:
                break
        for number in range(take("<I")):
            skip_texts(file, 3)  # name, type, and grid with shared voxels
            file.seek(16, 1)
            end = take("<q")
            if not file.tell() <= end <= size:
                raise FileFormatError(
                    f"grid {number} ends at byte {end}, but the file has {size} bytes: it is cut "
                    "short or damaged"
                )
            file.seek(end)
