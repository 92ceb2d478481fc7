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
from .dicom_file import is_dicom, is_mosaic, quiet, read_head, read_parts, starts_dicom, take_apart
from .dicom_slices import Frame, frames_of, read_values, stacked, value_type
from .voxels import VoxelReader, Voxels

_CLASS = "1.2.840.10008.1.3.10"
_MOST_FILES = 100_000


def is_directory(head: Any) -> bool:
    """Return True for the head of a table of contents."""
    return str(head.file_meta.get("MediaStorageSOPClassUID", "")) == _CLASS


def images_named(path: Path) -> list[Path]:
    """Return the files of images that a table of contents names."""
    records = read_parts(path, "DirectoryRecordSequence").get("DirectoryRecordSequence") or ()
    found = [_file(path.parent, name) for name in _names(records)]
    if not 0 < len(found) <= _MOST_FILES:
        raise FileFormatError(
            f"it is a table of contents of {len(found)} images, expected 1 to {_MOST_FILES}"
        )
    return found


def _names(records: Any) -> Iterator[str]:
    for record in records:
        name = record.get("ReferencedFileID")
        if name and str(record.get("DirectoryRecordType", "")) == "IMAGE":
            yield name if isinstance(name, str) else "/".join(map(str, name))


def _file(directory: Path, name: str) -> Path:
    """Return a file's path; discs say in capitals what systems may show in small letters."""
    try:
        return inside(directory, name)
    except FileFormatError:
        raise
    except InputError:
        if not (directory / name.lower()).is_file():
            raise
    return inside(directory, name.lower())


# So many files of a directory are looked at: other directories are left alone quickly.
_FEW = 16
_ENDINGS = (".dcm", ".dicom", ".ima")
_UNITS = {"BQML": "Bq / ml", "GY": "Gy"}
# What all slices of a volume must agree in.
_COMMON = ("Rows", "Columns", "BitsAllocated", "BitsStored", "PixelRepresentation")

_Heads = list[tuple[Path, Any]]


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
        head, frames = _frames(path, series)
        slices, placement, times = stacked(frames, time)
        if head.get("AnatomicalOrientationType") == "QUADRUPED":  # not a human's axes
            placement = replace(placement, space="")
        shape = (int(head.Columns), int(head.Rows), len(slices))
        dtype = value_type(head, slices)
        return Voxels(
            shape=shape,
            dtype=dtype,
            placement=placement,
            load=lambda _: read_values(slices, shape, dtype),
            name=str(head.get("Modality") or "dicom").lower(),
            unit=_unit(str(head.get("Units") or head.get("DoseUnits")).upper()),
            meta=_meta(head) | ({} if times == 1 else {"times": times, "time_step": time % times}),
        )


def _unit(name: str) -> str:
    """Return the unit of values by DICOM's name for it; astropy knows the gray since version 7."""
    unit = _UNITS.get(name, "")
    if unit == "Gy":
        try:
            parse_unit(unit)
        except UnitsError:
            return "J / kg"
    return unit


@quiet()
def _frames(path: Path, series: Any) -> tuple[Any, list[Frame]]:
    heads = _chosen(path, series)
    for file, head in heads:
        with reading(file, "a DICOM file"):
            take_apart(file, head)
    common = _common_head(heads)
    frames: list[Frame] = []
    for file, head in heads:
        with reading(file, "a DICOM file"):
            frames += frames_of(file, head)
    return common, frames


def _files(directory: Path) -> Iterator[Path]:
    with os.scandir(directory) as entries:
        for entry in entries:
            if not entry.name.startswith(".") and entry.is_file():
                yield Path(entry.path)


def _chosen(path: Path, series: Any) -> _Heads:
    """Return the files and heads of one series."""
    head = None if path.is_dir() else read_head(path)
    if head is None or is_directory(head):
        groups = _by_series(path, path) if head is None else _of_contents(path)
        return groups[_named(groups, series)]
    if series is not None:
        raise InputError("a file tells its series; give series for a directory only")
    if not _is_image(head):
        raise FileFormatError("expected a DICOM image, but there are no rows and columns of pixels")
    if is_mosaic(head) or int(head.get("NumberOfFrames") or 1) > 1:
        return [(path, head)]
    return _by_series(path.parent, path)[_uid(head)]


def _by_series(directory: Path, asked: Path) -> dict[str, _Heads]:
    """Return all images of a directory by their series, files in the order of their names."""
    groups: dict[str, _Heads] = {}
    contents = None
    for file in sorted(_files(directory)):
        if is_dicom(file):
            head = read_head(file)
            contents = file if is_directory(head) else contents
            if _is_image(head):
                groups.setdefault(_uid(head), []).append((file, head))
        elif file == asked or file.suffix.lower() in _ENDINGS:
            raise FileFormatError(f"{file.name} is named like a DICOM file, but is none")
    if not groups and contents is not None:
        return _of_contents(contents)
    if not groups:
        raise FileFormatError(f"there is no DICOM image in {directory}")
    return groups


def _of_contents(path: Path) -> dict[str, _Heads]:
    groups: dict[str, _Heads] = {}
    for file in images_named(path):
        head = read_head(file)
        if _is_image(head):
            groups.setdefault(_uid(head), []).append((file, head))
    if not groups:
        raise FileFormatError("it is a table of contents of files that hold no images")
    return groups


def _named(groups: dict[str, _Heads], series: Any) -> str:
    names = {uid: _dicom_names(uid, heads[0][1]) for uid, heads in groups.items()}
    found = [uid for uid in groups if series is None or str(series) in names[uid]]
    if len(found) == 1:
        return found[0]
    listed = "\n".join(
        f"  series={names[uid][1]!r}: {names[uid][2]!r}, {heads[0][1].get('Modality')}, "
        f"{len(heads)} files, {uid}"
        for uid, heads in groups.items()
    )
    asked = "several series" if series is None else f"{len(found)} series {series!r}"
    raise InputError(f"there are {asked}; choose one by its number, text or UID:\n{listed}")


def _dicom_names(uid: str, head: Any) -> tuple[str, str, str]:
    number, text = head.get("SeriesNumber"), head.get("SeriesDescription")
    return uid, "" if number is None else str(number), str(text or "")


def _common_head(heads: _Heads) -> Any:
    """Return the first head, once all agree."""
    file, first = heads[0]
    for other, head in heads:
        for keyword in _COMMON:
            if head.get(keyword) != first.get(keyword):
                raise FileFormatError(
                    f"{other.name} has {keyword} {head.get(keyword)}, but {file.name} has "
                    f"{first.get(keyword)}: they make no volume"
                )
    if first.get("SamplesPerPixel", 1) != 1:
        raise FileFormatError("expected one value per pixel, but its pictures are coloured")
    return first


def _is_image(head: Any) -> bool:
    return all(head.get(keyword) for keyword in ("Rows", "Columns", "BitsAllocated"))


def _uid(head: Any) -> str:
    return str(head.get("SeriesInstanceUID") or "")


def _meta(head: Any) -> dict[str, Any]:
    told = {
        "modality": head.get("Modality"),
        "series": head.get("SeriesDescription"),
        "rescale_type": head.get("RescaleType"),
    }
    return {name: str(value) for name, value in told.items() if value}
