"""NetCDF, classic and version 4."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...errors import FileFormatError, MissingPackageError, unknown_name
from ...packages import is_installed, require
from ..hdf5 import filters, is_hdf5, opened
from .classic import check_length
from .reader import LabelledReader

if TYPE_CHECKING:
    import xarray

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
    """Return what opens a file.

    Raises
    ------
    MissingPackageError
        If nothing does.
    """
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
