"""NumPy's files: NPZ, fields by their names with their grid, and NPY, one array."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from ...errors import FileFormatError
from ...units import unit_name
from ..axes import AXES, cartesian
from ..names import field_name
from ..payload import ZIP, read_exactly, stored, zip_names
from .layout import Entry
from .named_arrays import NamedArraysReader

if TYPE_CHECKING:
    from ...volume import Volume

_MAGIC = b"\x93NUMPY"
_ENDING, _UNIT = ".npy", "_unit"
# Arrays in pictures saved as NPZ.
_IMAGE = {"intensity.npy", "metadata.npy"}


def _header(
    file: IO[bytes], size: int | None, what: str, *, exact: bool = False
) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Return shape, Fortran order and type of an array; checks the bytes there are of it."""
    version = np.lib.format.read_magic(file)
    if version not in ((1, 0), (2, 0)):
        raise FileFormatError(f"expected NumPy's array format 1.0 or 2.0, got {version}")
    first = version == (1, 0)
    formats = np.lib.format
    read = formats.read_array_header_1_0 if first else formats.read_array_header_2_0
    shape, fortran, dtype = read(file)
    expected = math.prod(shape) * dtype.itemsize
    present = expected if size is None else size - file.tell()
    # Objects are refused later, by name.
    if not dtype.hasobject and (present < expected or (exact and present > expected)):
        raise FileFormatError(
            f"{what} holds {present} bytes, but shape {shape} of {dtype} takes {expected}: it is "
            "cut short or damaged"
        )
    return shape, fortran, dtype


class NPYReader(NamedArraysReader):
    """One field; its name is the file's, or the option `name`."""

    name = "npy"
    description = "a NumPy array (.npy)"
    suffixes = (".npy",)
    options = {  # noqa: RUF012 - as in Reader
        **NamedArraysReader.options,
        "name": "name of the field; by default that of the file without suffix",
    }

    def matches(self, path: Path, head: bytes) -> bool:
        return head.startswith(_MAGIC)

    @contextmanager
    def entries(
        self, path: Path, only: str | None = None, **options: Any
    ) -> Iterator[dict[str, Entry]]:
        with open(path, "rb") as file:
            shape, fortran, dtype = _header(file, path.stat().st_size, "the file")

            place = file.tell()

        def load(index: Any = ...) -> np.ndarray:
            if not fortran:
                return stored(path, place, shape, dtype, index)
            turned = index if index is ... else index[::-1]
            return np.transpose(stored(path, place, shape[::-1], dtype, turned))

        name = options.get("name") or field_name(path.stem)
        yield {name: Entry(shape, dtype, "", load, chunks=())}


class NPZReader(NamedArraysReader):
    """What ``numpy.savez(path, density=…, density_unit="g/cm3", bounds=…, unit="pc")`` writes."""

    name = "npz"
    description = "a NumPy archive (.npz)"
    suffixes = (".npz",)
    writes = True

    def matches(self, path: Path, head: bytes) -> bool:
        if not head.startswith(ZIP):
            return False
        named = path.suffix.lower() in self.suffixes
        return named or any(name.endswith(_ENDING) for name in zip_names(path))

    def holds_image(self, path: Path) -> bool:
        return zip_names(path) >= _IMAGE

    @contextmanager
    def entries(
        self, path: Path, only: str | None = None, **options: Any
    ) -> Iterator[dict[str, Entry]]:
        with zipfile.ZipFile(path) as archive:
            names = [n for n in archive.namelist() if n.endswith(_ENDING)]
            if set(names) >= _IMAGE:
                raise FileFormatError("expected a volume; this is an image: vm.Image.load reads it")
            names = names if only is None else [only + _ENDING]
            entries = {n.removesuffix(_ENDING): _entry(archive, n) for n in names}
            texts = {name: entry.text() for name, entry in entries.items() if name.endswith(_UNIT)}
            yield {n: replace(e, unit=texts.get(n + _UNIT) or "") for n, e in entries.items()}

    def write(self, volume: Volume, path: Path) -> None:
        grid = cartesian(volume)
        arrays: dict[str, Any] = dict(zip(AXES, grid.edges, strict=True))
        arrays["unit"] = unit_name(grid.unit)
        arrays |= {name: volume.array(name) for name in volume.fields}
        arrays |= {name + _UNIT: unit for name, unit in volume.units.items() if unit}
        with zipfile.ZipFile(path, "w") as archive:
            for name, values in arrays.items():
                with archive.open(name + _ENDING, "w", force_zip64=True) as file:
                    np.lib.format.write_array(file, np.asanyarray(values), allow_pickle=False)


def _entry(archive: zipfile.ZipFile, member: str) -> Entry:
    with archive.open(member) as file:
        size = archive.getinfo(member).file_size
        shape, fortran, dtype = _header(file, size, member, exact=True)

    def load(index: Any = ...) -> np.ndarray:
        with archive.open(member) as file:
            _header(file, None, member)
            if 0 in shape:
                return np.empty(shape, dtype)
            values = read_exactly(file, shape[::-1] if fortran else shape, dtype, member)
            file.read(1)  # at its end the checksum is compared
            part: np.ndarray = (values.transpose() if fortran else values)[index]
            return part

    return Entry(shape, dtype, "", load)
