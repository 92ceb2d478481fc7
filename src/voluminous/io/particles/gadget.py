"""Reader for HDF5 snapshots of Gadget, AREPO, GIZMO and SWIFT."""

from __future__ import annotations

import functools
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import FileFormatError, InputError, unknown_name
from ..contract import StoredField
from ..hdf5 import MAGIC, data_set, data_sets, holds, opened, read, text
from ..payload import inside
from .common import (
    DENSITY_UNIT,
    OPTIONS,
    ParticleFile,
    ParticleReader,
    common_name,
    number,
    with_unit,
)
from .gadget_units import GadgetHeader

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


class GadgetSnapshot(ParticleFile):
    """The particles of one type in a file, several files, or a directory of files."""

    def __init__(self, path: Path, particle_type: Any = 0, **units: Any) -> None:
        path = _first_file(path)
        kind = TYPES.get(particle_type, particle_type)
        self.group, self.kind = f"PartType{kind}", int(kind) if str(kind).isdigit() else -1
        with opened(path) as file:
            self.header = GadgetHeader(file, units)
            count = number(file["Header"].attrs, "NumFilesPerSnapshot") or 1
            self.kernel = _kernel(file)  # name, and support radius in the file's lengths
            types = {k for k in file if k.startswith("PartType")}
        self.files: list[tuple[Path, int]] = []  # with their numbers of particles
        for piece in _files_of(path, int(count)):
            if size := self._size_of(piece):
                self.files.append((piece, size))
        if not self.files:
            raise unknown_name("particle type", str(particle_type), {*types, *TYPES} - {self.group})
        self.size = sum(count for _, count in self.files)
        self.data: dict[str, str] = {}  # common name -> name of the data set
        self.attributes: dict[str, dict[str, Any]] = {}
        columns: list[StoredField] = []
        places: dict[str, tuple[str, tuple[int, ...], np.dtype]] = {}
        path, count = self.files[0]
        with opened(path) as file:
            items, left_out = data_sets(path, file[self.group])
            for name, item in items.items():
                common, shape = common_name(name), (self.size, *item.shape[1:])
                if common in (*_NO_FIELDS, "smoothing_length"):
                    self._check_length(name, item.shape, count)
                elif (
                    item.shape[:1] != (count,)
                    or item.ndim > 2
                    or max(shape[1:], default=1) > _WIDEST
                ):
                    left_out[name] = f"shape {item.shape}, columns are at most {_WIDEST}"
                    continue
                self.data[common], self.attributes[common] = name, dict(item.attrs)
                places[common] = f"{self.group}/{name}", shape, item.dtype
        for common, place in places.items():
            if common not in _NO_FIELDS and not _IDENTITY.search(self.data[common]):
                columns += self._columns_of(common, *place)
        of_masses = "Header/MassTable", self.header.masses.shape, np.dtype("f8")
        place = places.get("density", places.get("mass", of_masses))
        unit = DENSITY_UNIT if self.header.known else ""
        self.fields = [StoredField("density", *place, unit, self.masses), *columns]
        self.meta = self.header.meta | ({"left_out": left_out} if left_out else {})

    def _size_of(self, path: Path) -> int:
        with opened(path) as file:
            if self.group not in file or "Coordinates" not in file[self.group]:
                return 0
            shape = data_set(path, file[self.group], "Coordinates").shape
            counts = np.ravel(file["Header"].attrs.get("NumPart_ThisFile", []))
        if len(shape) != 2 or shape[1] != 3:
            raise FileFormatError(f"{self.group}/Coordinates have shape {shape}, expected (n, 3)")
        if self.kind < len(counts) and int(counts[self.kind]) != shape[0]:
            raise FileFormatError(
                f"{path.name}: Header/NumPart_ThisFile tells of {counts[self.kind]} particles, but "
                f"{self.group}/Coordinates has {shape[0]}"
            )
        return int(shape[0])

    def _columns_of(
        self, common: str, place: str, shape: tuple[int, ...], dtype: np.dtype
    ) -> list[StoredField]:
        factor, unit = self.header.of(common, self.attributes[common])
        load = functools.partial(self._values, common, factor)
        if len(shape) == 1:
            return [StoredField(common, place, shape, dtype, unit, load)]
        endings = "xyz" if shape[1] == 3 else map(str, range(shape[1]))
        return [
            StoredField(
                f"{common}_{ending}",
                f"{place}[{k}]",
                shape,
                dtype,
                unit,
                functools.partial(load, k),
            )
            for k, ending in enumerate(endings)
        ]

    def _check_length(self, name: str, shape: tuple[int, ...], count: int) -> None:
        if not shape or shape[0] != count:
            raise FileFormatError(
                f"{self.group}/{name} has shape {shape}, expected one row for each of {count} "
                "particles"
            )

    def _values(self, common: str, factor: float, column: int | None = None) -> np.ndarray:
        """Return a data set (or one of its columns) of all files times a factor, as float64."""
        name, parts = self.data[common], []
        for path, count in self.files:
            with opened(path) as file:
                item = data_set(path, file[self.group], name)
                self._check_length(name, item.shape, count)
                parts.append(read(item, column))
        return np.concatenate(parts).astype(np.float64) * factor

    def _scaled(self, common: str) -> Any:
        factor, unit = self.header.of(common, self.attributes[common])
        return with_unit(self._values(common, factor), unit)

    def points(self) -> Any:
        return self._scaled("coordinates")

    def masses(self) -> Any:
        if "mass" in self.data:
            return self._scaled("mass")
        same = self.header.masses[self.kind] if self.kind < len(self.header.masses) else 0.0
        if not same > 0:
            raise FileFormatError(f"there are neither {self.group}/Masses nor one in the MassTable")
        factor, unit = self.header.of("mass", {})
        return with_unit(np.full(self.size, same * factor), unit)

    def sizes(self) -> dict[str, Any]:
        if "smoothing_length" in self.data:
            from ...particles import get_kernel

            name, radius = self.kernel
            h = self._scaled("smoothing_length") * (radius / get_kernel(name).support)
            return {"smoothing_length": h, "kernel": name}
        known = (common for common in ("volume", "density") if common in self.data)
        return {common: self._scaled(common) for common in list(known)[:1]}

    def domain(self, points: Any, sizes: Mapping[str, Any]) -> dict[str, Any]:
        if self.header.box is None:
            return {}
        factor, unit = self.header.of("coordinates", self.attributes["coordinates"])
        box = with_unit(self.header.box * factor, unit)
        fitting = bool(((points >= 0 * box) & (points <= box)).all())
        if not fitting or not (self.header.periodic or {"volume", "density"} & sizes.keys()):
            return {}
        return {"bounds": [[0 * b, b] for b in box], "periodic": self.header.periodic}


def _first_file(path: Path) -> Path:
    """Return the first file of a snapshot directory; a file is returned unchanged."""
    if not path.is_dir():
        return path
    first = [*path.glob("*.0.hdf5"), *path.glob("*.0.h5")]
    return first[0] if len(first) == 1 else path


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
    name = text(scheme.get("Kernel function", b"")).lower()
    return next((kernel for word, kernel in _SWIFT.items() if word in name), _GADGET)
