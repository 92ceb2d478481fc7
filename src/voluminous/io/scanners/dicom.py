"""DICOM: a directory of slices, one of them, a file with many frames, or a DICOMDIR."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

from ...errors import FileFormatError, InputError, UnitsError
from ...units import parse_unit
from ..guard import by_library, reading
from ..payload import inside
from .dicom_file import is_dicom, is_mosaic, quiet, read_header, starts_dicom, take_apart
from .dicom_slices import DicomSlice, read_values, slices_of, stacked, value_type
from .voxels import VoxelReader, Voxels, times_meta

# So many files of a directory are tried: other directories are left alone quickly.
_FEW = 16
_ENDINGS = (".dcm", ".dicom", ".ima")
# Elements that must be equal in all slices of a volume.
_COMMON = ("Rows", "Columns", "BitsAllocated", "BitsStored", "PixelRepresentation")
# The class of a DICOMDIR: the table of contents of a disc or an export, which names files below.
_CONTENTS = "1.2.840.10008.1.3.10"
_MOST_FILES = 100_000

_Headers = list[tuple[Path, Any]]


class DICOMReader(VoxelReader):
    """One series: of a directory (not those below it), of a DICOMDIR, or that of a file."""

    name = "dicom"
    description = "a DICOM series (a directory, or one of its files)"
    suffixes = _ENDINGS
    packages = ("pydicom",)
    extra = "medical"
    options = {  # noqa: RUF012 - as in Reader
        **VoxelReader.options,
        "series": "which one of a directory: its number, description or SeriesInstanceUID",
        "time": "number of the time step, from 0, where several slices lie at each place",
    }

    def matches(self, path: Path, head: bytes) -> bool:
        if head:
            return starts_dicom(head)
        try:
            return path.is_dir() and any(is_dicom(file) for file in islice(_files(path), _FEW))
        except OSError:
            return False

    @by_library("pydicom")  # elements are converted when they are first asked for
    def voxels(self, path: Path, *, series: Any = None, time: int = 0) -> Voxels:
        header, found = _slices(path, series)
        slices, placement, times = stacked(found, time)
        if header.get("AnatomicalOrientationType") == "QUADRUPED":  # not a human's axes
            placement = replace(placement, space="")
        shape = (int(header.Columns), int(header.Rows), len(slices))
        dtype = value_type(header, slices)
        meta = {
            "modality": header.get("Modality"),
            "series": header.get("SeriesDescription"),
            "rescale_type": header.get("RescaleType"),
        }
        return Voxels(
            shape=shape,
            dtype=dtype,
            placement=placement,
            load=lambda _: read_values(slices, shape, dtype),
            name=str(header.get("Modality") or "dicom").lower(),
            unit=_unit(str(header.get("Units") or header.get("DoseUnits")).upper()),
            meta={name: str(value) for name, value in meta.items() if value}
            | times_meta(times, time % times),
        )


def _unit(name: str) -> str:
    """Return the unit of values by DICOM's name for it; astropy knows the gray since version 7."""
    if name == "GY":
        try:
            return str(parse_unit("Gy"))
        except UnitsError:
            return "J / kg"
    return {"BQML": "Bq / ml"}.get(name, "")


@quiet()
def _slices(path: Path, series: Any) -> tuple[Any, list[DicomSlice]]:
    """Return the first header of a series, once all agree, and the slices."""
    headers = _chosen(path, series)
    for file, header in headers:
        with reading(file, "a DICOM file"):
            take_apart(file, header)
    first_file, first = headers[0]
    for file, header in headers:
        for keyword in _COMMON:
            if header.get(keyword) != first.get(keyword):
                raise FileFormatError(
                    f"{file.name} has {keyword} {header.get(keyword)}, but {first_file.name} has "
                    f"{first.get(keyword)}: they make no volume"
                )
    if first.get("SamplesPerPixel", 1) != 1:
        raise FileFormatError("expected one value per pixel, but its pictures are coloured")
    found: list[DicomSlice] = []
    for file, header in headers:
        with reading(file, "a DICOM file"):
            found += slices_of(file, header)
    return first, found


def _files(directory: Path) -> Iterator[Path]:
    with os.scandir(directory) as entries:
        for entry in entries:
            if not entry.name.startswith(".") and entry.is_file():
                yield Path(entry.path)


def _chosen(path: Path, series: Any) -> _Headers:
    """Return the files and headers of one series."""
    header = None if path.is_dir() else read_header(path)
    if header is None or _is_contents(header):
        groups = _by_series(path, path) if header is None else _by_contents(path)
        return groups[_named(groups, series)]
    if series is not None:
        raise InputError("a file belongs to one series; give series for a directory only")
    if not _is_image(header):
        raise FileFormatError("expected a DICOM image, but there are no rows and columns of pixels")
    if is_mosaic(header) or int(header.get("NumberOfFrames") or 1) > 1:
        return [(path, header)]
    return _by_series(path.parent, path)[_uid(header)]


def _by_series(directory: Path, asked: Path) -> dict[str, _Headers]:
    """Return all images of a directory by series; files are sorted by name."""
    groups: dict[str, _Headers] = {}
    contents = None
    for file in sorted(_files(directory)):
        if is_dicom(file):
            header = read_header(file)
            contents = file if _is_contents(header) else contents
            if _is_image(header):
                groups.setdefault(_uid(header), []).append((file, header))
        elif file == asked or file.suffix.lower() in _ENDINGS:
            raise FileFormatError(f"{file.name} is named like a DICOM file, but is none")
    if not groups and contents is not None:
        return _by_contents(contents)
    if not groups:
        raise FileFormatError(f"there is no DICOM image in {directory}")
    return groups


def _by_contents(path: Path) -> dict[str, _Headers]:
    """Return the images that a DICOMDIR names, by their series."""
    records = read_header(path, "DirectoryRecordSequence").get("DirectoryRecordSequence") or ()
    names = [
        name if isinstance(name, str) else "/".join(map(str, name))
        for record in records
        if str(record.get("DirectoryRecordType", "")) == "IMAGE"
        and (name := record.get("ReferencedFileID"))
    ]
    if not 0 < len(names) <= _MOST_FILES:
        raise FileFormatError(
            f"it is a table of contents of {len(names)} images, expected 1 to {_MOST_FILES}"
        )
    groups: dict[str, _Headers] = {}
    for name in names:
        # Discs say in capitals what systems may show in small letters.
        small = not (path.parent / name).exists() and (path.parent / name.lower()).is_file()
        file = inside(path.parent, name.lower() if small else name)
        header = read_header(file)
        if _is_image(header):
            groups.setdefault(_uid(header), []).append((file, header))
    if not groups:
        raise FileFormatError("it is a table of contents of files that hold no images")
    return groups


def _named(groups: dict[str, _Headers], series: Any) -> str:
    """Return the UID of the series that is asked for by its UID, number or description."""
    names = {}
    for uid, headers in groups.items():
        number, text = (headers[0][1].get(f"Series{key}") for key in ("Number", "Description"))
        names[uid] = (uid, "" if number is None else str(number), str(text or ""))
    found = [uid for uid in groups if series is None or str(series) in names[uid]]
    if len(found) == 1:
        return found[0]
    listed = "\n".join(
        f"  series={names[uid][1]!r}: {names[uid][2]!r}, {headers[0][1].get('Modality')}, "
        f"{len(headers)} files, {uid}"
        for uid, headers in groups.items()
    )
    asked = "several series" if series is None else f"{len(found)} series {series!r}"
    raise InputError(f"there are {asked}; choose one by its number, text or UID:\n{listed}")


def _is_contents(header: Any) -> bool:
    return str(header.file_meta.get("MediaStorageSOPClassUID", "")) == _CONTENTS


def _is_image(header: Any) -> bool:
    return all(header.get(keyword) for keyword in ("Rows", "Columns", "BitsAllocated"))


def _uid(header: Any) -> str:
    return str(header.get("SeriesInstanceUID") or "")
