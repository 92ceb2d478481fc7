"""NetCDF, classic and version 4, and GRIB."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...errors import FileFormatError, unknown_name
from ...files import url_of
from ...packages import require
from ..contract import FieldInfo
from ..guard import by_library
from ..hdf5 import check_places, filters, first_bytes, is_hdf5, is_own, opened
from ..remote import for_hdf5
from .convert import AT_ONCE, LabelledReader, decoded

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
    remote = True

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
        head = first_bytes(path, 8)
        check_places(path)
        groups = _groups(path) if is_hdf5(head) else []
        if group is not None and is_hdf5(head) and group.strip("/") not in ["", *groups]:
            raise unknown_name("group", group, groups)
        engine = "h5netcdf" if is_hdf5(head) else "scipy"
        if head.startswith(_CLASSIC[2]):
            engine = "netcdf4"
            _check_size(path)
        require(engine.replace("netcdf4", "netCDF4"), self.extra, "reading this kind of NetCDF")
        options: dict[str, Any] = {"engine": engine} | ({} if group is None else {"group": group})
        url = url_of(path)
        if engine == "scipy" and path.stat().st_size <= AT_ONCE:
            options["mmap"] = False  # else SciPy has all of the file in memory
        source = for_hdf5(url) if url else nullcontext(path)
        with by_library("xarray"), filters(), source as f, decoded(f, **options) as data:
            has_fields = any(array.ndim >= 3 for array in data.data_vars.values())
            if group is None and groups and not has_fields:
                listed = ", ".join(groups[:20]) + (", …" if len(groups) > 20 else "")
                raise FileFormatError(
                    "there is no variable of three dimensions in the outermost group; choose one "
                    f"of the groups {listed} with group={groups[0]!r}"
                )
            yield data


def _check_size(path: Path) -> None:
    """Refuse a file of 64-bit data that is cut short: netCDF4 reads zeros then."""
    import netCDF4

    with netCDF4.Dataset(path) as file:
        size = sum(v.size * v.dtype.itemsize for v in file.variables.values())
    if size > path.stat().st_size or not file.variables:
        raise FileFormatError(f"it is cut short: its variables take {size} bytes")


def _groups(path: Path) -> list[str]:
    result: list[str] = []
    with opened(path) as file:
        file.visititems(lambda place, item: result.append(place) if hasattr(item, "keys") else None)
    return result


class GRIBReader(LabelledReader):
    """Messages that make one set of fields, opened by cfgrib."""

    name = "xarray"
    description = "a GRIB file"
    suffixes = (".grib", ".grb", ".grib2", ".grb2")
    packages = ("xarray", "cfgrib")
    extra = "grib"
    options = {  # noqa: RUF012 - as in Reader
        **{key: text for key, text in LabelledReader.options.items() if key != "group"},
        "filter_by_keys": "of GRIB, which messages: {'typeOfLevel': 'isobaricInhPa'}",
    }

    def matches(self, path: Path, head: bytes) -> bool:
        return head.startswith(_GRIB)

    def read(self, path: Path, fields: Any = None, **options: Any) -> Volume:
        return super().read(path, fields, group=options.pop("filter_by_keys", None), **options)

    def info(self, path: Path, **options: Any) -> tuple[FieldInfo, ...]:
        return super().info(path, group=options.pop("filter_by_keys", None), **options)

    @contextmanager
    def dataset(self, path: Path, group: Any) -> Iterator[xarray.Dataset]:
        xarray = require("xarray", "arrays", "reading GRIB")
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
