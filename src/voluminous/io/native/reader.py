"""Reader and writer for native files, the format of `Volume.save` for any grid.

``/grid`` defines the grid, ``/fields`` has one data set per field in the grid's cell order,
``/meta`` (JSON) and ``/wcs`` (a FITS header) hold the remaining metadata. Attributes describe the
contents in words, so that h5py suffices to read a file.
"""

from __future__ import annotations

import functools
import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import FileFormatError
from ...image.sky import table_hdus, tables_of
from ...packages import version
from ..boxes import boxes
from ..contract import Contents, ContentsReader, StoredField
from ..hdf5 import created, data_set, fixed, holds, is_own, opened, read, text, warn_of_missing
from .grids import PlainGrid, exact_name, grid_of, plain_grid

if TYPE_CHECKING:
    import h5py
    from astropy.wcs import WCS

    from ...volume import Volume

MARK = "voluminous volume"
VERSION = 1
GRID, FIELDS, META, SKY = "grid", "fields", "meta", "wcs"
TABLES = "wcs_tables"  # for a WCS with a tabulated axis (-TAB)
ABOUT = (
    "A volume: /grid says where the cells are (its attribute 'order' how they are counted), "
    "/fields/NAME holds one value per cell in 'units'. Read it with voluminous.open(path)."
)
_PACKED: dict[str, Any] = {"chunks": True, "shuffle": True, "compression": "gzip"}


@dataclass(frozen=True)
class NativeContents(Contents):
    """The contents of a file, with the sky coordinates."""

    wcs: WCS | None = None


class NativeReader(ContentsReader):
    """HDF5 with the package's mark: any grid, the fields, and metadata."""

    name = "voluminous"
    description = "a volume saved by voluminous (HDF5)"
    suffixes = (".h5", ".hdf5")
    remote = True
    writes = True
    write_options = {"compress": "True to pack the fields (gzip)"}  # noqa: RUF012 - as in Reader

    def matches(self, path: Path, head: bytes) -> bool:
        return holds(path, head, lambda file: text(file.attrs.get("format", "")) == MARK)

    def contents(self, path: Path, **options: Any) -> Contents:
        with opened(path) as file:
            if (written := file.attrs.get("version")) != VERSION:
                raise FileFormatError(
                    f"it is a volume in version {written} of the native format, expected "
                    f"{VERSION}; a newer voluminous may read it"
                )
            group, stored = _group(file, GRID), _group(file, FIELDS)
            arrays = {name: read(data_set(path, group, name)) for name in group}
            attributes = {**group.attrs, "unit": text(group.attrs.get("unit", ""))}
            grid = grid_of(PlainGrid(text(group.attrs.get("type", "")), "", arrays, attributes))
            fields = []
            for name in stored:
                item = data_set(path, stored, name)
                if item.shape != grid.shape:
                    raise FileFormatError(
                        f"{item.name} has shape {item.shape}, expected {grid.shape}, one value per "
                        "cell of the grid"
                    )
                unit, load = (
                    text(item.attrs.get("units", "")),
                    functools.partial(_field_values, path, name),
                )
                shape, dtype = item.shape, item.dtype
                part, axes = functools.partial(_field_part, path, name), range(len(shape))
                pieces = boxes(part, [shape], item.chunks or (), axes, [False for _ in axes])
                fields.append(StoredField(name, name, shape, dtype, unit, load, pieces))
            return NativeContents(fields, lambda _: grid, _meta(file), _wcs(file))

    def finish(self, volume: Volume, contents: Contents) -> None:
        assert isinstance(contents, NativeContents)
        if contents.wcs is not None:
            volume.wcs = contents.wcs

    def write(self, volume: Volume, path: Path, *, compress: bool = False) -> None:
        plain = plain_grid(volume.grid)
        with created(path) as (file, sink):
            marks = {"format": MARK, "version": VERSION, "about": ABOUT}
            _describe(file, {**marks, "written_by": f"voluminous {version()}"})
            grid = file.create_group(GRID)
            _describe(grid, {"type": plain.type, "order": plain.order, **plain.attributes})
            for name, values in plain.arrays.items():
                grid[name] = values
            _write_extras(file, volume)
            group = file.create_group(FIELDS, track_order=True)
            for name in volume.fields:
                options = _PACKED if compress else {}
                # Use a copy that does not cache values: only one field at a time is in memory.
                values = volume.with_arrays({}).array(name)
                item = group.create_dataset(name, data=values, **options)
                _describe(item, {"units": exact_name(volume.field_unit(name))})
                sink.check()


def _describe(item: Any, attributes: dict[str, Any]) -> None:
    item.attrs.update({k: fixed(v) if isinstance(v, str) else v for k, v in attributes.items()})


def _group(file: h5py.File, name: str) -> h5py.Group:
    import h5py

    item = file[name] if is_own(file, name) else None
    if not isinstance(item, h5py.Group):
        raise FileFormatError(f"expected a group /{name}")
    return item


def _field_values(path: Path, name: str) -> np.ndarray:
    with opened(path) as file:
        return read(data_set(path, file[FIELDS], name))


def _field_part(path: Path, name: str, index: tuple[slice, ...], level: int) -> np.ndarray:
    with opened(path) as file:
        item = data_set(path, file[FIELDS], name)
        warn_of_missing(item, index)
        return np.asarray(item[index])


# Metadata of a volume: plain values as JSON, the sky as a FITS header


def _write_extras(file: h5py.File, volume: Volume) -> None:
    if volume.meta:
        file[META] = fixed(json.dumps(volume.meta, default=json_value, ensure_ascii=False))
        _describe(file[META], {"about": "what was known of the data, in JSON"})
    if volume.wcs is not None:
        header, tables = header_text(volume.wcs)
        file[SKY] = fixed(header)
        about = "a FITS header with the world coordinates of the grid's axes"
        _describe(file[SKY], {"about": about})
        for (table, column), values in tables.items():
            file[f"{TABLES}/{table}/{column}"] = values


def _meta(file: h5py.File) -> dict[str, Any]:
    return known_meta(_text(file, META)) if META in file else {}


def known_meta(text: str) -> dict[str, Any]:
    """Return the metadata in a text."""
    meta = json.loads(text)
    if not isinstance(meta, dict):
        raise FileFormatError(f"/{META} must be a table in JSON, got {meta!r:.40}")
    return meta


def _text(file: h5py.File, name: str) -> str:
    import h5py

    item = file[name] if is_own(file, name) else None
    if not isinstance(item, h5py.Dataset) or h5py.check_string_dtype(item.dtype) is None:
        raise FileFormatError(f"/{name} must be a text")
    if item.shape != ():
        raise FileFormatError(f"/{name} must be one text, got an array of shape {item.shape}")
    return str(item.asstr()[()])


def json_value(value: Any) -> Any:
    """Return a JSON equivalent: lists and numbers for NumPy values, text for other objects."""
    plain = isinstance(value, (np.ndarray, np.generic)) and not hasattr(value, "unit")
    return value.tolist() if plain else str(value)


def header_text(wcs: WCS) -> tuple[str, dict[tuple[str, str], np.ndarray]]:
    """Return world coordinates as a FITS header, and the columns of tabulated axes."""
    from astropy import wcs as astropy_wcs

    # Keep all digits of a double, and all keywords.
    header = wcs.to_header(relax=astropy_wcs.WCSHDO_all | astropy_wcs.WCSHDO_P17)
    for axis, count in enumerate(wcs.pixel_shape or (), start=1):
        header[f"NAXIS{axis}"] = count
    return str(header.tostring(sep="\n")), tables_of(wcs)


def _wcs(file: h5py.File) -> WCS | None:
    if SKY not in file:
        return None
    tables = file.get(TABLES, {})
    values = {(name, title): item[()] for name in tables for title, item in tables[name].items()}
    return wcs_of(_text(file, SKY), values)


def wcs_of(header: str, tables: dict[tuple[str, str], np.ndarray]) -> WCS:
    """Return the world coordinates; inverse of `header_text`."""
    from astropy.io.fits import HDUList, Header, PrimaryHDU
    from astropy.wcs import WCS

    hdus = HDUList([PrimaryHDU(), *table_hdus(tables)])
    return WCS(Header.fromstring(header, sep="\n"), hdus if tables else None)
