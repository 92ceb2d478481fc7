"""NPZ: fields by their names, with edges ``x, y, z`` or ``bounds``, ``unit``, ``<field>_unit``."""

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
from ..names import field_name
from ..payload import ZIP, read_exactly, zip_names
from .layout import AXES, Entry, text_in
from .named_arrays import NamedArraysReader

if TYPE_CHECKING:
    from ...volume import Volume


MAGIC = b"\x93NUMPY"


def header(file: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Return shape, Fortran order and type of the array at the beginning of a file."""
    version = np.lib.format.read_magic(file)
    if version == (1, 0):
        return np.lib.format.read_array_header_1_0(file)
    if version == (2, 0):
        return np.lib.format.read_array_header_2_0(file)
    raise FileFormatError(f"expected NumPy's array format 1.0 or 2.0, got {version}")


_ENDING = ".npy"
_UNIT = "_unit"
# What pictures saved as NPZ have in them.
_IMAGE = {"intensity.npy", "metadata.npy"}


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
            found = {n.removesuffix(_ENDING): _entry(archive, n) for n in names}
            yield {
                name: replace(entry, unit=text_in(found.get(name + _UNIT)) or "")
                for name, entry in found.items()
            }

    def write(self, volume: Volume, path: Path) -> None:
        from ..axes import cartesian

        grid = cartesian(volume)
        arrays: dict[str, Any] = dict(zip(AXES, grid.edges, strict=True))
        arrays["unit"] = unit_name(grid.unit)
        for name in volume.fields:
            arrays[name] = volume.array(name)
        arrays |= {name + _UNIT: unit for name, unit in volume.units.items() if unit}
        with zipfile.ZipFile(path, "w") as archive:
            for name, values in arrays.items():
                with archive.open(name + _ENDING, "w", force_zip64=True) as file:
                    np.lib.format.write_array(file, np.asanyarray(values), allow_pickle=False)


def _entry(archive: zipfile.ZipFile, member: str) -> Entry:
    with archive.open(member) as file:
        shape, fortran, dtype = header(file)
        _check_length(member, archive.getinfo(member).file_size - file.tell(), shape, dtype)

    def load(index: Any = ...) -> np.ndarray:
        with archive.open(member) as file:
            header(file)
            if 0 in shape:
                return np.empty(shape, dtype)
            values = read_exactly(file, shape[::-1] if fortran else shape, dtype, member)
            file.read(1)  # at its end the checksum is compared
            return (values.transpose() if fortran else values)[index]

    return Entry(shape, dtype, "", load)


def _check_length(member: str, found: int, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
    """Check that a member unpacks to what its head announces, before memory is taken."""
    expected = math.prod(shape) * dtype.itemsize
    if not dtype.hasobject and found != expected:
        raise FileFormatError(
            f"{member} holds {found} bytes, but shape {shape} of {dtype} takes {expected}"
        )


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
        return head.startswith(MAGIC)

    @contextmanager
    def entries(
        self, path: Path, only: str | None = None, **options: Any
    ) -> Iterator[dict[str, Entry]]:
        with open(path, "rb") as file:
            shape, fortran, dtype = header(file)
            _npy_check_length(path, file.tell(), shape, dtype)

        def load(index: Any = ...) -> np.ndarray:
            values: np.ndarray = np.load(path, mmap_mode="r", allow_pickle=False)[index]
            return values

        # A volume copies what lies in another order, or in foreign bytes.
        mapped = not fortran and dtype.isnative
        yield {options.get("name") or field_name(path.stem): Entry(shape, dtype, "", load, mapped)}


def _npy_check_length(path: Path, start: int, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
    if dtype.hasobject:  # refused later, by name
        return
    expected = start + dtype.itemsize * int(np.prod(shape, dtype=object))
    found = path.stat().st_size
    if found < expected:
        raise FileFormatError(
            f"the file is cut short: {found} bytes, but shape {shape} of {dtype} takes {expected}"
        )
