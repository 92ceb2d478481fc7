"""The particles of one type in a snapshot of one file or several."""

from __future__ import annotations

import functools
import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...errors import FileFormatError, unknown_name
from ..hdf5 import data_set, data_sets, opened, read
from .attributes import number
from .columns import Column, with_unit
from .gadget_header import TYPES, files_of, first_file, read_header
from .gadget_kernel import kernel_of
from .names import common_name

# What is not averaged over cells: it makes the density, or tells particles apart.
_NO_FIELDS = ("coordinates", "mass", "density", "volume")
_IDENTITY = re.compile(r"IDs?(?![a-z])")
_AXES = "xyz"
_WIDEST = 64


class Item(NamedTuple):
    """What is known of a data set of all files."""

    shape: tuple[int, ...]
    dtype: Any
    attributes: dict[str, Any]


class Snapshot:
    """Particles of one type.

    Parameters
    ----------
    path : Path
        The file, one of several, or the directory that these are in.
    particle_type : int or str
    units : tuple of three
        The code's units of length, mass and velocity, None where the file tells.

    Attributes
    ----------
    header : Header
    group : str
        Where the particles are in the file.
    data : dict
        Common name → name of the data set.
    left_out : dict
        Why what else is beside the particles can be no field.
    kernel : tuple
        Name of the kernel, and the radius of its support in the file's lengths.

    Raises
    ------
    FileFormatError
        If header and data are at odds.
    UnknownNameError
        If there are no such particles.
    """

    def __init__(self, path: Path, particle_type: Any, units: tuple[Any, Any, Any]) -> None:
        path = first_file(path)
        with opened(path) as file:
            self.header = read_header(file, units)
            number_of_files = number(file["Header"].attrs, "NumFilesPerSnapshot") or 1
            self.kernel = kernel_of(file)
            kind = TYPES.get(particle_type, particle_type)
            self.group, types = f"PartType{kind}", [k for k in file if k.startswith("PartType")]
        self.kind = int(kind) if str(kind).isdigit() else -1
        self.files: list[tuple[Path, int]] = []
        for piece in files_of(path, int(number_of_files)):
            self._add(piece)
        if not self.files:
            raise unknown_name("particle type", str(particle_type), {*types, *TYPES} - {self.group})
        self._describe()

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

    def _describe(self) -> None:
        path, count = self.files[0]
        self.data: dict[str, str] = {}
        self.items: dict[str, Item] = {}
        with opened(path) as file:
            found, self.left_out = data_sets(path, file[self.group])
            for name, item in found.items():
                common = common_name(name)
                rows, *width = item.shape or (0,)
                if common in (*_NO_FIELDS, "smoothing_length"):
                    self._check_length(name, item.shape, count)
                elif rows != count or len(width) > 1 or max(width, default=1) > _WIDEST:
                    self.left_out[name] = f"shape {item.shape}, columns are at most {_WIDEST}"
                    continue
                self.data[common] = name
                shape = (self.size, *item.shape[1:])
                self.items[name] = Item(shape, item.dtype, dict(item.attrs))

    def _check_length(self, name: str, shape: tuple[int, ...], count: int) -> None:
        if not shape or shape[0] != count:
            raise FileFormatError(
                f"{self.group}/{name} has shape {shape}, expected one row for each of {count} "
                "particles"
            )

    @property
    def size(self) -> int:
        """Number of particles."""
        return sum(count for _, count in self.files)

    def place(self, common: str) -> str:
        """Return where a property is in the file."""
        return f"{self.group}/{self.data[common]}"

    def values(self, name: str, factor: float = 1.0, column: int | None = None) -> np.ndarray:
        """Return a data set of all files, or a column of it, times a factor: float64."""
        parts = []
        for path, count in self.files:
            with opened(path) as file:
                item = data_set(path, file[self.group], name)
                self._check_length(name, item.shape, count)
                parts.append(read(item, column))
        return np.concatenate(parts).astype(np.float64) * factor

    def scaled(self, common: str) -> Any:
        """Return a property by its common name: a Quantity, or plain if units are not known."""
        name = self.data[common]
        factor, unit = self.header.units.of(common, self.items[name].attributes)
        return with_unit(self.values(name, factor), unit)

    def box(self) -> Any:
        """Return the widths of the box as `scaled` gives coordinates; None if there is no box."""
        if self.header.box is None:
            return None
        attributes = self.items[self.data["coordinates"]].attributes
        factor, unit = self.header.units.of("coordinates", attributes)
        return with_unit(self.header.box * factor, unit)

    def masses(self) -> Any:
        """Return masses, which the header may tell for all."""
        if "mass" in self.data:
            return self.scaled("mass")
        same = self.header.masses[self.kind] if self.kind < len(self.header.masses) else 0.0
        if not same > 0:
            raise FileFormatError(f"there are neither {self.group}/Masses nor one in the MassTable")
        factor, unit = self.header.units.of("mass", {})
        return with_unit(np.full(self.size, same * factor), unit)

    def columns(self) -> list[Column]:
        """Return what can be fields: one for each column of a data set."""
        found: list[Column] = []
        for common, name in self.data.items():
            item = self.items[name]
            if common not in _NO_FIELDS and not _IDENTITY.search(name):
                found += self._columns_of(common, name, item)
        return found

    def _columns_of(self, common: str, name: str, item: Item) -> list[Column]:
        factor, unit = self.header.units.of(common, item.attributes)
        width = item.shape[1] if len(item.shape) == 2 else 0
        columns = [None] if len(item.shape) == 1 else list(range(width))
        endings = _AXES if width == 3 else [str(k) for k in columns]
        return [
            Column(
                common if k is None else f"{common}_{endings[k]}",
                f"{self.group}/{name}" + ("" if k is None else f"[{k}]"),
                item.shape,
                str(item.dtype),
                functools.partial(self.values, name, factor, k),
                unit,
            )
            for k in columns
        ]
