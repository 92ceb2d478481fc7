"""Whatever an engine of xarray opens: GRIB by cfgrib, and the engines of other packages."""

from __future__ import annotations

import importlib.metadata
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...errors import FileFormatError
from ...packages import require
from ..contract import FieldInfo
from .reader import LabelledReader

if TYPE_CHECKING:
    import xarray

    from ...volume import Volume

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
        return head.startswith(_GRIB) or _engine(path) is not None

    def read(self, path: Path, fields: Any = None, **options: Any) -> Volume:
        return super().read(path, fields, group=options.pop("filter_by_keys", None), **options)

    def info(self, path: Path, **options: Any) -> tuple[FieldInfo, ...]:
        return super().info(path, group=options.pop("filter_by_keys", None), **options)

    @contextmanager
    def dataset(self, path: Path, group: Any) -> Iterator[xarray.Dataset]:
        xarray = require("xarray", "arrays", "reading by an engine of xarray")
        with open(path, "rb") as file:
            engine = "cfgrib" if file.read(len(_GRIB)) == _GRIB else _engine(path)
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


def _engine(path: Path) -> str | None:
    for entry in importlib.metadata.entry_points(group="xarray.backends"):
        try:
            if entry.load()().guess_can_open(str(path)):
                return entry.name
        except Exception:  # a broken engine takes nothing
            continue
    return None
