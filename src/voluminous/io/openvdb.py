"""Reader for OpenVDB's sparse voxels: OpenVDB's library fills the bounding box of active voxels."""

from __future__ import annotations

import importlib
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import FileFormatError, InputError, MissingPackageError
from ..memory import check_memory
from .contract import FieldInfo, Reader
from .guard import by_library
from .scanners.placement import Arrangement, Placement, arranged
from .vtk.dataset import OPTIONS, DataArray, Dataset, Uneven

if TYPE_CHECKING:
    from ..volume import Volume

_MAGIC = b" BDV\0\0\0\0"
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
        arrays = [_array(path, name, grid, (0, 0, 0), ()) for name, grid in grids.items()]
        chosen = Dataset((1, 1, 1), Uneven(()), arrays).chosen(fields).values()
        names = {array.name for array, _ in chosen}
        chosen_grids = {name: grid for name, grid in grids.items() if name in names}
        return _dataset(path, chosen_grids).volume(fields, unit)

    def info(self, path: Path, **options: Any) -> tuple[FieldInfo, ...]:
        grids = _grids(path).items()
        return tuple(f for name, grid in grids for f in _dataset(path, {name: grid}).infos())


def _module() -> Any:
    """Return OpenVDB's Python module, which had another name before version 11."""
    for name in ("openvdb", "pyopenvdb"):
        with suppress(ImportError):
            return importlib.import_module(name)
    raise MissingPackageError(
        "reading OpenVDB files needs OpenVDB's own Python module, which is not on the Python "
        "package index; install it with\n"
        "  conda install -c conda-forge openvdb\n"
        "or, for the system's Python of Debian and Ubuntu,\n"
        "  apt install python3-openvdb"
    )


def _grids(path: Path) -> dict[str, Any]:
    module = _module()
    grids: dict[str, Any] = {}
    with by_library("OpenVDB"):
        for number, grid in enumerate(module.readAllGridMetadata(str(path))):
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
    boxes = np.array([_box(path, name, grid) for name, grid in grids.items()])
    low = boxes[:, 0].min(axis=0)
    points = tuple(int(n) for n in boxes[:, 1].max(axis=0) - low + 1)
    check_memory(_PER_LAYER * sum(points), "the walls of the voxels", "is the file damaged?")

    def arrange(at: str, unit: Any) -> Arrangement:
        return arranged(points, Placement(first[0] + low @ first[1:], first[1:], unit))

    start = tuple(int(n) for n in low)
    arrays = [_array(path, name, grid, start, points) for name, grid in grids.items()]
    return Dataset(points, arrange, arrays)


def _steps(grid: Any) -> np.ndarray:
    """Return the position of voxel (0, 0, 0) and the steps along the indices, shape (4, 3)."""
    if not grid.transform.isLinear:
        raise InputError(
            f"grid {grid.name!r} has voxels of different sizes (a frustum): resample it to equal "
            "voxels first"
        )
    places = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    corners = np.array([grid.transform.indexToWorld(place) for place in places], float)
    return np.concatenate([corners[:1], corners[1:] - corners[0]])


def _box(path: Path, name: str, grid: Any) -> tuple[Any, Any]:
    low, high = (grid.metadata.get(f"file_bbox_{end}") for end in ("min", "max"))
    if low is None or high is None:
        low, high = _voxels(path, name).evalActiveVoxelBoundingBox()
    if any(a > b for a, b in zip(low, high, strict=True)):
        raise InputError(f"grid {name!r} is empty: no voxel of it is set; choose others")
    return low, high


def _array(path: Path, name: str, grid: Any, low: Any, points: Any) -> DataArray:
    dtype, components = _TYPES[grid.valueTypeName]

    def load() -> np.ndarray:
        values = np.empty(points if components == 1 else (*points, components), dtype)
        _voxels(path, name).copyToArray(values, ijk=low)
        return np.asarray(values.reshape(*points, components).transpose(2, 1, 0, 3))

    return DataArray(name, "", components, np.dtype(dtype), load)


def _voxels(path: Path, name: str) -> Any:
    with by_library("OpenVDB"):
        return _module().read(str(path), name)
