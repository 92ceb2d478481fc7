"""Is an OpenVDB file all there? Asked before its library, which a file cut short leads astray."""

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
from .vtk.dataset import OPTIONS, Array, Dataset, chosen_arrays, infos, volume_of

if TYPE_CHECKING:
    from ..volume import Volume


MAGIC = b" BDV\0\0\0\0"
# File versions whose head is as below (openvdb/version.h): since grids may share voxels.
_KNOWN = range(216, 300)
_UUID = 36
_MOST = 1 << 16


def check_whole(path: Path) -> None:
    """Follow the places that the file tells of its grids."""
    size = path.stat().st_size
    with open(path, "rb") as file:
        _take(file, len(MAGIC))
        version = _number(file)
        _take(file, 8)  # version of the library
        if version not in _KNOWN or _take(file, 1) == b"\0":  # a stream tells no places
            return
        _take(file, _UUID)
        for _ in range(_count(file, "remarks")):
            for _ in range(3):  # name, type, value
                _text(file)
        for number in range(_count(file, "grids")):
            for _ in range(3):  # name, type, grid that it shares voxels with
                _text(file)
            _, _, end = struct.unpack("<3q", _take(file, 24))
            if not file.tell() <= end <= size:
                raise FileFormatError(
                    f"grid {number} ends at byte {end}, but the file has {size} bytes: it is cut "
                    "short or damaged"
                )
            file.seek(end)


def _count(file: IO[bytes], what: str) -> int:
    count = _number(file)
    if count > _MOST:
        raise FileFormatError(f"byte {file.tell()}: {count} {what} are announced")
    return count


def _number(file: IO[bytes]) -> int:
    return int.from_bytes(_take(file, 4), "little")


def _text(file: IO[bytes]) -> None:
    length = _number(file)
    if length > _MOST:
        raise FileFormatError(f"byte {file.tell()}: a name of {length} bytes is announced")
    _take(file, length)


def _take(file: IO[bytes], size: int) -> bytes:
    data = file.read(size)
    if len(data) < size:
        raise FileFormatError(f"cut short in its head, at byte {file.tell()}")
    return data


# OpenVDB's names of types, as types of arrays and components.
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
# Bytes for the walls of a cell along one axis.
_PER_LAYER = 64


class OpenVDBReader(Reader):
    """Grids of numbers and vectors; voxels that are not set have the grid's background."""

    name = "vdb"
    description = "an OpenVDB file"
    suffixes = (".vdb",)
    options = OPTIONS
    packages = ("openvdb",)

    def matches(self, path: Path, head: bytes) -> bool:
        return head.startswith(MAGIC)

    def read(self, path: Path, fields: Any = None, **options: Any) -> Volume:
        grids = _grids(path)
        told = Dataset((1, 1, 1), _nowhere, [_array(path, name, g) for name, g in grids.items()])
        chosen = {array.name for array, _ in chosen_arrays(told, fields).values()}
        shown = _dataset(path, {name: g for name, g in grids.items() if name in chosen})
        return volume_of(shown, fields, **options)

    def info(self, path: Path, **options: Any) -> tuple[FieldInfo, ...]:
        found: list[FieldInfo] = []
        for name, grid in _grids(path).items():
            found += infos(_dataset(path, {name: grid}))
        return tuple(found)


def _module() -> Any:
    """Return OpenVDB's module for Python, which had another name before version 11."""
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
    module = _module()
    check_whole(path)
    grids: dict[str, Any] = {}
    with _explained():
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
    place = Placement(first[0] + low @ first[1:], first[1:])

    def arrange(at: str, unit: Any) -> Arrangement:
        return arranged(points, Placement(place.origin, place.steps, unit))

    arrays = [_array(path, name, grid, low, points) for name, grid in grids.items()]
    return Dataset(points, arrange, arrays)


def _steps(grid: Any) -> np.ndarray:
    """Return where voxel (0, 0, 0) is, and the steps along the three indices: shape (4, 3)."""
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
    told = grid.metadata
    if "file_bbox_min" in told and "file_bbox_max" in told:
        low, high = told["file_bbox_min"], told["file_bbox_max"]
    else:
        low, high = _voxels(path, name).evalActiveVoxelBoundingBox()
    if any(a > b for a, b in zip(low, high, strict=True)):
        raise InputError(f"grid {name!r} is empty: no voxel of it is set; choose others")
    return low, high


def _array(path: Path, name: str, grid: Any, low: Any = (0, 0, 0), points: Any = ()) -> Array:
    dtype, components = _TYPES[grid.valueTypeName]
    load = functools.partial(_load, path, name, tuple(int(n) for n in low), points)
    return Array(name, "", components, np.dtype(dtype), load)


def _load(path: Path, name: str, low: tuple[int, ...], points: tuple[int, ...]) -> np.ndarray:
    grid = _voxels(path, name)
    dtype, components = _TYPES[grid.valueTypeName]
    shape = points if components == 1 else (*points, components)
    values = np.empty(shape, dtype)
    grid.copyToArray(values, ijk=low)
    return values.reshape(*points, components).transpose(2, 1, 0, 3)


def _voxels(path: Path, name: str) -> Any:
    module = _module()
    check_whole(path)
    with _explained():
        return module.read(str(path), name)


@contextmanager
def _explained() -> Iterator[None]:
    """Shorten what the library says of a damaged file: it may quote gigabytes of it."""
    try:
        yield
    except (Exception, MemoryError) as error:
        text = next(iter(error.args), "")
        raise FileFormatError(
            f"OpenVDB cannot read it ({type(error).__name__}: {str(text)[:_LONGEST]})"
        ) from None


def _nowhere(at: str, unit: Any) -> Arrangement:
    raise AssertionError("fields are only chosen among these arrays")
