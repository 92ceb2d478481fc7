"""NetCDF, classic and version 4, and whatever another engine of xarray opens (GRIB by cfgrib)."""

from __future__ import annotations

import importlib.metadata
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...errors import FileFormatError, MissingPackageError, unknown_name
from ...packages import is_installed, require
from ..contract import FieldInfo
from ..guard import by_library
from ..hdf5 import filters, is_hdf5, is_own, opened
from .convert import LabelledReader

if TYPE_CHECKING:
    import xarray

    from ...volume import Volume

_CLASSIC = (b"CDF\x01", b"CDF\x02", b"CDF\x05")
# What the libraries write beside each dimension.
_DIMENSION_MARKS = {"_Netcdf4Dimid", "_Netcdf4Coordinates"}
_GRIB = b"GRIB"


class NetCDFReader(LabelledReader):
    """NetCDF by the CF conventions."""

    name = "netcdf"
    description = "a NetCDF file"
    suffixes = (".nc", ".nc4", ".cdf", ".netcdf")

    def matches(self, path: Path, head: bytes) -> bool:
        if not is_hdf5(head):
            return head.startswith(_CLASSIC)
        try:
            with opened(path) as file:
                items = [file[name] for name in file if is_own(file, name)]
                marked = any(_DIMENSION_MARKS & item.attrs.keys() for item in items)
                return "_NCProperties" in file.attrs or marked
        except (OSError, RuntimeError, KeyError, ValueError):
            return path.suffix.lower() in self.suffixes  # too damaged to look into

    @contextmanager
    def dataset(self, path: Path, group: str | None) -> Iterator[xarray.Dataset]:
        xarray = require("xarray", self.extra, "reading NetCDF")
        with open(path, "rb") as file:
            head = file.read(8)
        groups = _groups(path) if is_hdf5(head) else []
        if group is not None and is_hdf5(head) and group.strip("/") not in ["", *groups]:
            raise unknown_name("group", group, groups)
        engine = _engine(head)
        if engine == "netcdf4" and not is_hdf5(head):
            _check_size(path)
        # Memory is taken by the volume only: xarray would keep what it reads beside it.
        options: dict[str, Any] = {"engine": engine, "cache": False}
        options |= {} if group is None else {"group": group}
        with by_library("xarray"), filters(), _decoded(xarray, path, options) as data:
            has_fields = any(array.ndim >= 3 for array in data.data_vars.values())
            if group is None and groups and not has_fields:
                listed = ", ".join(groups[:20]) + (", …" if len(groups) > 20 else "")
                raise FileFormatError(
                    "there is no variable of three dimensions in the outermost group; choose one "
                    f"of the groups {listed} with group={groups[0]!r}"
                )
            yield data


def _decoded(xarray: Any, path: Path, options: dict[str, Any]) -> Any:
    try:
        return xarray.open_dataset(path, decode_timedelta=False, **options)
    except (ValueError, OverflowError, ImportError):
        return xarray.open_dataset(path, decode_times=False, **options)


def _engine(head: bytes) -> str:
    """Return what opens a file that starts so."""
    able = {"h5netcdf": "h5netcdf", "netcdf4": "netCDF4"}
    if not is_hdf5(head):
        newest = head.startswith(_CLASSIC[2])
        able = {"netcdf4": "netCDF4"} if newest else {"scipy": "scipy", "netcdf4": "netCDF4"}
    for engine, module in able.items():
        if is_installed(module):
            return engine
    advice = next(iter(able.values()))
    raise MissingPackageError(
        f"reading this kind of NetCDF needs the package {advice!r}; install it with\n"
        f"  pip install {advice}"
    )


def _check_size(path: Path) -> None:
    """Refuse a classic file that is cut short: netCDF4 reads zeros then, scipy raises.

    The header is not counted: the loss of so many bytes at the end is not noticed.
    """
    import netCDF4

    with netCDF4.Dataset(path) as file:
        size = sum(v.size * v.dtype.itemsize for v in file.variables.values())
    if size > path.stat().st_size or not file.variables:
        raise FileFormatError(f"it is cut short: its variables take {size} bytes")


def _groups(path: Path) -> list[str]:
    found: list[str] = []
    with opened(path) as file:
        file.visititems(lambda place, item: found.append(place) if hasattr(item, "keys") else None)
    return found


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
        return head.startswith(_GRIB) or _other_engine(path) is not None

    def read(self, path: Path, fields: Any = None, **options: Any) -> Volume:
        return super().read(path, fields, group=options.pop("filter_by_keys", None), **options)

    def info(self, path: Path, **options: Any) -> tuple[FieldInfo, ...]:
        return super().info(path, group=options.pop("filter_by_keys", None), **options)

    @contextmanager
    def dataset(self, path: Path, group: Any) -> Iterator[xarray.Dataset]:
        xarray = require("xarray", "arrays", "reading by an engine of xarray")
        with open(path, "rb") as file:
            is_grib = file.read(len(_GRIB)) == _GRIB
        if not is_grib:
            with xarray.open_dataset(path, engine=_other_engine(path), cache=False) as data:
                yield data
            return
        cfgrib = require("cfgrib", "grib", "reading GRIB")
        options = {"indexpath": "", "filter_by_keys": dict(group or {}), "errors": "raise"}
        try:
            data = xarray.open_dataset(
                path, engine="cfgrib", cache=False, decode_timedelta=False, **options
            )
        except cfgrib.DatasetBuildError as error:
            raise FileFormatError(
                f"its messages make no single set of fields ({error}); choose some with "
                "filter_by_keys={'typeOfLevel': 'isobaricInhPa'}, for example"
            ) from error
        with data:
            yield data


def _other_engine(path: Path) -> str | None:
    for entry in importlib.metadata.entry_points(group="xarray.backends"):
        try:
            if entry.load()().guess_can_open(str(path)):
                return entry.name
        except Exception:  # a broken engine takes nothing
            continue
    return None
