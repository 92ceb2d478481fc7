"""Reader for HDF5 snapshots of Gadget, AREPO, GIZMO and SWIFT."""

from __future__ import annotations

import functools
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ...errors import FileFormatError, InputError, unknown_name
from ..contract import FieldInfo
from ..hdf5 import MAGIC, data_set, data_sets, holds, opened, read
from ..payload import inside
from .common import (
    DENSITY_UNIT,
    OPTIONS,
    ParticleColumn,
    ParticleFile,
    ParticleReader,
    common_name,
    number,
    with_unit,
)
from .gadget_units import read_header

if TYPE_CHECKING:
    import h5py

# Particle types by name, in the numbering of most codes.
TYPES = {"gas": 0, "dark_matter": 1, "disk": 2, "bulge": 3, "stars": 4, "black_holes": 5}
# Not averaged over cells: these set positions and density, or identify particles.
_NO_FIELDS = ("coordinates", "mass", "density", "volume")
_IDENTITY = re.compile(r"IDs?(?![a-z])")
_WIDEST = 64
_SEVERAL = re.compile(r"\.\d+(?=\.(hdf5|h5)$)")
_MOST_FILES = 1 << 16
# SWIFT's smoothing length is twice the standard deviation of the kernel; the support radius in
# units of it is Γ of Dehnen & Aly (2012, MNRAS 425, 1068), table 1.
_SWIFT = {
    **dict.fromkeys(("m4", "cubic"), ("cubic", 1.825742)),
    **dict.fromkeys(("m5", "quartic"), ("quartic", 2.018932)),
    **dict.fromkeys(("m6", "quintic"), ("quintic", 2.195775)),
    **dict.fromkeys(("wendland c2", "wendland-c2"), ("wendland-c2", 1.936492)),
    **dict.fromkeys(("wendland c4", "wendland-c4"), ("wendland-c4", 2.207940)),
    **dict.fromkeys(("wendland c6", "wendland-c6"), ("wendland-c6", 2.449490)),
}
# Gadget, GIZMO and AREPO write the support radius; the kernel is the cubic spline.
_GADGET = ("cubic", 1.0)


class GadgetReader(ParticleReader):
    """Reader of one particle type, deposited on an octree.

    Particles with smoothing lengths are smoothed by the code's kernel. Without them, particles with
    volumes or densities are mesh cells; all others get estimated smoothing lengths.
    """

    name = "gadget"
    description = "a snapshot of Gadget, AREPO, GIZMO or SWIFT (HDF5)"
    suffixes = (".hdf5",)
    opening = ("particle_type", "length_unit", "mass_unit", "velocity_unit")
    options = {  # noqa: RUF012 - as in Reader
        **OPTIONS,
        "particle_type": "0 or 'gas' (by default), 1 or 'dark_matter', 4 or 'stars' …",
        "length_unit": "the code's unit of length, where the file does not tell",
        "mass_unit": "the code's unit of mass",
        "velocity_unit": "the code's unit of velocity",
    }

    def matches(self, path: Path, head: bytes) -> bool:
        first = _first_file(path)
        types = {f"PartType{k}" for k in range(7)}
        start = head if first == path else MAGIC
        return holds(first, start, lambda file: "Header" in file and types & set(file))

    def particles(self, path: Path, **options: Any) -> GadgetSnapshot:
        return GadgetSnapshot(path, **options)


class GadgetItem(NamedTuple):
    """A data set, concatenated over all files."""

    shape: tuple[int, ...]
    dtype: Any
    attributes: dict[str, Any]


class GadgetSnapshot(ParticleFile):
    """The particles of one type in a file, several files, or a directory of files."""

    def __init__(
        self,
        path: Path,
        particle_type: Any = 0,
        length_unit: Any = None,
        mass_unit: Any = None,
        velocity_unit: Any = None,
    ) -> None:
        path = _first_file(path)
        with opened(path) as file:
            self.header = read_header(file, (length_unit, mass_unit, velocity_unit))
            count = number(file["Header"].attrs, "NumFilesPerSnapshot") or 1
            self.kernel = _kernel(file)  # name, and support radius in the file's lengths
            kind = TYPES.get(particle_type, particle_type)
            self.group, types = f"PartType{kind}", [k for k in file if k.startswith("PartType")]
        self.kind = int(kind) if str(kind).isdigit() else -1
        self.files: list[tuple[Path, int]] = []
        for piece in _files_of(path, int(count)):
            self._add(piece)
        if not self.files:
            raise unknown_name("particle type", str(particle_type), {*types, *TYPES} - {self.group})
        self.size = sum(count for _, count in self.files)
        self.data: dict[str, str] = {}  # common name -> name of the data set
        self.items: dict[str, GadgetItem] = {}
        left_out = self._describe()
        self.meta = self.header.meta | ({"left_out": left_out} if left_out else {})
        self.density = self._density()

    def _add(self, path: Path) -> None:
        with opened(path) as file:
            if self.group not in file or "Coordinates" not in file[self.group]:
                return
            shape = data_set(path, file[self.group], "Coordinates").shape
            counts = np.ravel(file["Header"].attrs.get("NumPart_ThisFile", []))
        if len(shape) != 2 or shape[1] != 3:
            raise FileFormatError(f"{self.group}/Coordinates have shape {shape}, expected (n, 3)")
        if self.kind < len(counts) and int(counts[self.kind]) != shape[0]:
            raise FileFormatError(
                f"{path.name}: Header/NumPart_ThisFile tells of {counts[self.kind]} particles, but "
                f"{self.group}/Coordinates has {shape[0]}"
            )
        if shape[0]:
            self.files.append((path, shape[0]))

    def _describe(self) -> dict[str, str]:
        """Register all data sets; return the reasons why the others cannot be fields."""
        path, count = self.files[0]
        with opened(path) as file:
            found, left_out = data_sets(path, file[self.group])
            for name, item in found.items():
                common = common_name(name)
                rows, *width = item.shape or (0,)
                if common in (*_NO_FIELDS, "smoothing_length"):
                    self._check_length(name, item.shape, count)
                elif rows != count or len(width) > 1 or max(width, default=1) > _WIDEST:
                    left_out[name] = f"shape {item.shape}, columns are at most {_WIDEST}"
                    continue
                self.data[common] = name
                shape = (self.size, *item.shape[1:])
                self.items[name] = GadgetItem(shape, item.dtype, dict(item.attrs))
        return left_out

    def _check_length(self, name: str, shape: tuple[int, ...], count: int) -> None:
        if not shape or shape[0] != count:
            raise FileFormatError(
                f"{self.group}/{name} has shape {shape}, expected one row for each of {count} "
                "particles"
            )

    def _density(self) -> FieldInfo:
        unit = DENSITY_UNIT if self.header.units.known else ""
        for common in ("density", "mass"):
            if common in self.data:
                name = self.data[common]
                shape, dtype = self.items[name].shape, str(self.items[name].dtype)
                return FieldInfo("density", f"{self.group}/{name}", shape, dtype, unit)
        shape = self.header.masses.shape
        return FieldInfo("density", "Header/MassTable", shape, "float64", unit)

    def _values(self, name: str, factor: float = 1.0, column: int | None = None) -> np.ndarray:
        """Return a data set (or one of its columns) of all files times a factor, as float64."""
        parts = []
        for path, count in self.files:
            with opened(path) as file:
                item = data_set(path, file[self.group], name)
                self._check_length(name, item.shape, count)
                parts.append(read(item, column))
        return np.concatenate(parts).astype(np.float64) * factor

    def _scaled(self, common: str) -> Any:
        name = self.data[common]
        factor, unit = self.header.units.of(common, self.items[name].attributes)
        return with_unit(self._values(name, factor), unit)

    def points(self) -> Any:
        return self._scaled("coordinates")

    def masses(self) -> Any:
        if "mass" in self.data:
            return self._scaled("mass")
        same = self.header.masses[self.kind] if self.kind < len(self.header.masses) else 0.0
        if not same > 0:
            raise FileFormatError(f"there are neither {self.group}/Masses nor one in the MassTable")
        factor, unit = self.header.units.of("mass", {})
        return with_unit(np.full(self.size, same * factor), unit)

    def sizes(self) -> dict[str, Any]:
        if "smoothing_length" in self.data:
            from ...particles import get_kernel

            name, radius = self.kernel
            h = self._scaled("smoothing_length") * (radius / get_kernel(name).support)
            return {"smoothing_length": h, "kernel": name}
        for common in ("volume", "density"):
            if common in self.data:
                return {common: self._scaled(common)}
        return {}

    def domain(self, points: Any, sizes: Mapping[str, Any]) -> dict[str, Any]:
        if self.header.box is None:
            return {}
        attributes = self.items[self.data["coordinates"]].attributes
        factor, unit = self.header.units.of("coordinates", attributes)
        box = with_unit(self.header.box * factor, unit)
        fitting = bool(((points >= 0 * box) & (points <= box)).all())
        if not fitting or not (self.header.periodic or {"volume", "density"} & sizes.keys()):
            return {}
        return {"bounds": [[0 * b, b] for b in box], "periodic": self.header.periodic}

    def columns(self) -> list[ParticleColumn]:
        found: list[ParticleColumn] = []
        for common, name in self.data.items():
            if common not in _NO_FIELDS and not _IDENTITY.search(name):
                found += self._columns_of(common, name, self.items[name])
        return found

    def _columns_of(self, common: str, name: str, item: GadgetItem) -> list[ParticleColumn]:
        factor, unit = self.header.units.of(common, item.attributes)
        width = item.shape[1] if len(item.shape) == 2 else 0
        columns = [None] if len(item.shape) == 1 else list(range(width))
        endings = "xyz" if width == 3 else [str(k) for k in columns]
        found = []
        for k in columns:
            field = common if k is None else f"{common}_{endings[k]}"
            place = f"{self.group}/{name}" + ("" if k is None else f"[{k}]")
            info = FieldInfo(field, place, item.shape, str(item.dtype), unit)
            found.append(ParticleColumn(info, functools.partial(self._values, name, factor, k)))
        return found


def _first_file(path: Path) -> Path:
    """Return the first file of a snapshot directory; a file is returned unchanged."""
    if not path.is_dir():
        return path
    found = [*path.glob("*.0.hdf5"), *path.glob("*.0.h5")]
    return found[0] if len(found) == 1 else path


def _files_of(path: Path, count: int) -> list[Path]:
    if count == 1:
        return [path]
    if not 1 < count <= _MOST_FILES or not _SEVERAL.search(path.name):
        raise InputError(
            f"it says it is one of {count} files, which should be named like snapshot_000.0.hdf5"
        )
    return [inside(path.parent, _SEVERAL.sub(f".{k}", path.name)) for k in range(count)]


def _kernel(file: h5py.File) -> tuple[str, float]:
    scheme = file["HydroScheme"].attrs if "HydroScheme" in file else {}
    value = np.ravel(scheme.get("Kernel function", b""))[0]
    text = (value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)).lower()
    return next((found for word, found in _SWIFT.items() if word in text), _GADGET)
