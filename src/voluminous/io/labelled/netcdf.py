"""Is a classic NetCDF file as long as its header says? Libraries read zeros where it is not.

The header is described in the NetCDF Classic Format Specification,
https://docs.unidata.ucar.edu/nug/current/file_format_specifications.html.
"""

from __future__ import annotations

import importlib.metadata
import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from ...errors import FileFormatError, MissingPackageError, unknown_name
from ...packages import is_installed, require
from ..contract import FieldInfo
from ..hdf5 import filters, is_hdf5, opened
from .convert import LabelledReader

if TYPE_CHECKING:
    import xarray

    from ...volume import Volume


# Bytes of a value by the number of its type.
_SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 4, 6: 8, 7: 1, 8: 2, 9: 4, 10: 8, 11: 8}
_DIMENSIONS, _VARIABLES, _ATTRIBUTES = 10, 11, 12
# Dimensions of a variable; more are damage.
_MOST = 1024


@dataclass
class _Variable:
    name: str
    begin: int
    size: int  # bytes, of one record where it has records
    records: bool


def check_length(path: Path) -> None:
    """Check that all variables lie within the file."""
    found = path.stat().st_size
    with open(path, "rb") as file:
        header = _Header(file, found)
        records, variables = header.read()
    sizes = [variable.size for variable in variables if variable.records]
    # A lone variable with records is not padded to four bytes.
    step = sum(_padded(size) for size in sizes) if len(sizes) > 1 else sum(sizes)
    for variable in variables:
        repeats = (records - 1) * step if variable.records else 0
        expected = variable.begin + repeats + variable.size
        if expected > found and not (variable.records and records < 1):
            raise FileFormatError(
                f"it is cut short: {found} bytes, but {variable.name!r} ends at byte {expected}"
            )


class _Header:
    """Reads numbers and lists one after the other, never beyond the file's end."""

    def __init__(self, file: IO[bytes], size: int) -> None:
        self.file, self.size = file, size
        version = file.read(4)[3]
        self.count = 8 if version == 5 else 4
        self.offset = 4 if version == 1 else 8

    def read(self) -> tuple[int, list[_Variable]]:
        records = self.number(self.count)
        records = 0 if records == 256**self.count - 1 else records
        lengths = [self.dimension() for _ in range(self.list_of(_DIMENSIONS))]
        self.attributes()
        count = self.list_of(_VARIABLES)
        return records, [self.variable(lengths) for _ in range(count)]

    def number(self, size: int) -> int:
        data = self.file.read(size)
        if len(data) < size:
            raise FileFormatError(f"its header is cut short at byte {self.file.tell()}")
        return int.from_bytes(data, "big")

    def skip(self, size: int) -> None:
        if self.file.tell() + size > self.size:
            raise FileFormatError(
                f"{size} bytes from byte {self.file.tell()} on do not fit into its {self.size}"
            )
        self.file.seek(size, 1)

    def list_of(self, kind: int) -> int:
        found, length = self.number(4), self.number(self.count)
        if found not in (0, kind) or (found == 0 and length):
            raise FileFormatError(
                f"expected a list of kind {kind} at byte {self.file.tell()}, got {found}"
            )
        return length

    def name(self) -> str:
        length = self.number(self.count)
        self.skip(0 if length <= self.size else length)
        text = self.file.read(length).decode("utf-8", "replace")
        self.skip(_padded(length) - length)
        return text

    def dimension(self) -> int:
        self.name()
        return self.number(self.count)

    def attributes(self) -> None:
        for _ in range(self.list_of(_ATTRIBUTES)):
            self.name()
            size = self.type_size()
            self.skip(_padded(size * self.number(self.count)))

    def type_size(self) -> int:
        kind = self.number(4)
        if kind not in _SIZES:
            raise FileFormatError(f"unknown type {kind} at byte {self.file.tell()}")
        return _SIZES[kind]

    def variable(self, lengths: list[int]) -> _Variable:
        name, count = self.name(), self.number(self.count)
        if count > _MOST:
            raise FileFormatError(f"{name!r} has {count} dimensions, expected at most {_MOST}")
        numbers = [self.number(self.count) for _ in range(count)]
        if any(number >= len(lengths) for number in numbers):
            raise FileFormatError(f"{name!r} has dimensions that there are not")
        self.attributes()
        size = self.type_size()
        self.skip(self.count)  # its size once more, wrong where it is large
        shape = [lengths[number] for number in numbers]
        records = bool(shape) and shape[0] == 0
        values = math.prod(shape[1:] if records else shape)
        return _Variable(name, self.number(self.offset), values * size, records)


def _padded(size: int) -> int:
    return -(-size // 4) * 4


_CLASSIC = (b"CDF\x01", b"CDF\x02", b"CDF\x05")
# What the libraries write into the root of their files, or beside each dimension.
_MARKS = {"_NCProperties"}
_DIMENSION_MARKS = {"_Netcdf4Dimid", "_Netcdf4Coordinates"}


class NetCDFReader(LabelledReader):
    """NetCDF by the CF conventions."""

    name = "netcdf"
    description = "a NetCDF file"
    suffixes = (".nc", ".nc4", ".cdf", ".netcdf")

    def matches(self, path: Path, head: bytes) -> bool:
        if not is_hdf5(head):
            return head.startswith(_CLASSIC)
        marked = _is_netcdf4(path)
        # What is so damaged that it cannot be told is what it is called.
        return path.suffix.lower() in self.suffixes if marked is None else marked

    @contextmanager
    def dataset(self, path: Path, group: str | None) -> Iterator[xarray.Dataset]:
        xarray = require("xarray", self.extra, "reading NetCDF")
        with open(path, "rb") as file:
            head = file.read(8)
        if head.startswith(_CLASSIC):
            check_length(path)
        elif group is not None:
            _check_group(path, group)
        # Memory is taken by the volume only: xarray would keep what it reads beside it.
        options: dict[str, Any] = {"engine": _engine(head), "cache": False}
        options |= {} if group is None else {"group": group}
        with filters(), _decoded(xarray, path, options) as data:
            if group is None and not _has_fields(data) and is_hdf5(head):
                _tell_groups(path)
            yield data


def _decoded(xarray: Any, path: Path, options: dict[str, Any]) -> Any:
    try:
        return xarray.open_dataset(path, decode_timedelta=False, **options)
    except (ValueError, OverflowError, ImportError):
        return xarray.open_dataset(path, decode_times=False, **options)


def _engine(head: bytes) -> str:
    """Return what opens a file."""
    if is_hdf5(head):
        able, advice = ["h5netcdf", "netcdf4"], "h5netcdf"
    elif head.startswith(_CLASSIC[2]):
        able, advice = ["netcdf4"], "netCDF4"
    else:
        able, advice = ["scipy", "netcdf4"], "scipy"
    modules = {"netcdf4": "netCDF4"}
    for engine in able:
        if is_installed(modules.get(engine, engine)):
            return engine
    raise MissingPackageError(
        f"reading this kind of NetCDF needs the package {advice!r}; install it with\n"
        f"  pip install {advice}"
    )


def _is_netcdf4(path: Path) -> bool | None:
    """Return whether an HDF5 file has the marks of NetCDF-4; None if it cannot be opened."""
    import h5py

    try:
        with opened(path) as file:
            if _MARKS & file.attrs.keys():
                return True
            # Links may lead to other files, which are none of our business.
            links = ((name, file.get(name, getlink=True)) for name in file)
            own = [name for name, link in links if isinstance(link, h5py.HardLink)]
            return any(_DIMENSION_MARKS & file[name].attrs.keys() for name in own)
    except (OSError, RuntimeError, KeyError, ValueError):
        return None


def _has_fields(data: xarray.Dataset) -> bool:
    return any(array.ndim >= 3 for array in data.data_vars.values())


def _groups(path: Path) -> list[str]:

    found: list[str] = []
    with opened(path) as file:
        file.visititems(lambda place, item: found.append(place) if hasattr(item, "keys") else None)
    return found


def _tell_groups(path: Path) -> None:
    groups = _groups(path)
    if groups:
        listed = ", ".join(groups[:20]) + (", …" if len(groups) > 20 else "")
        raise FileFormatError(
            f"there is no variable of three dimensions in the outermost group; choose one of the "
            f"groups {listed} with group={groups[0]!r}"
        )


def _check_group(path: Path, group: str) -> None:
    groups = _groups(path)
    if group.strip("/") and group.strip("/") not in groups:
        raise unknown_name("group", group, groups)


_GRIB = b"GRIB"


class EngineReader(LabelledReader):
    """Files that no other reader takes, and an engine of xarray does."""

    name = "xarray"
    description = "a file of GRIB or of another engine of xarray"
    suffixes = (".grib", ".grb", ".grib2", ".grb2")
    packages = ("xarray", "cfgrib")
    extra = "grib"
    options = {  # noqa: RUF012 - as in Reader
        **{key: text for key, text in LabelledReader.options.items() if key != "group"},
        "filter_by_keys": "of GRIB, which messages: {'typeOfLevel': 'isobaricInhPa'}",
    }

    def matches(self, path: Path, head: bytes) -> bool:
        return head.startswith(_GRIB) or _engines_engine(path) is not None

    def read(self, path: Path, fields: Any = None, **options: Any) -> Volume:
        return super().read(path, fields, group=options.pop("filter_by_keys", None), **options)

    def info(self, path: Path, **options: Any) -> tuple[FieldInfo, ...]:
        return super().info(path, group=options.pop("filter_by_keys", None), **options)

    @contextmanager
    def dataset(self, path: Path, group: Any) -> Iterator[xarray.Dataset]:
        xarray = require("xarray", "arrays", "reading by an engine of xarray")
        with open(path, "rb") as file:
            engine = "cfgrib" if file.read(len(_GRIB)) == _GRIB else _engines_engine(path)
        grib = engine == "cfgrib"
        options: dict[str, Any] = {"engine": engine, "cache": False}
        if grib:
            cfgrib = require("cfgrib", "grib", "reading GRIB")
            options["decode_timedelta"] = False
            options |= {"indexpath": "", "filter_by_keys": dict(group or {}), "errors": "raise"}
        try:
            data = xarray.open_dataset(path, **options)
        except Exception as error:
            if grib and isinstance(error, cfgrib.DatasetBuildError):
                raise FileFormatError(
                    f"its messages make no single set of fields ({error}); choose some with "
                    "filter_by_keys={'typeOfLevel': 'isobaricInhPa'}, for example"
                ) from error
            raise
        with data:
            yield data


def _engines_engine(path: Path) -> str | None:
    for entry in importlib.metadata.entry_points(group="xarray.backends"):
        try:
            if entry.load()().guess_can_open(str(path)):
                return entry.name
        except Exception:  # a broken engine takes nothing
            continue
    return None
