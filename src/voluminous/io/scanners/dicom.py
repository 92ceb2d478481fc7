"""DICOM: a directory of slices, one of them, a file with many frames, or a DICOMDIR.

pydicom reads the files: only the elements in use, since parsing all takes most of the time.
"""

from __future__ import annotations

import contextlib
import logging
import os
import re
import warnings
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

from ...errors import FileFormatError, InputError, UnitsError
from ...files import check_readable
from ...packages import require
from ...units import parse_unit
from ..guard import by_library, reading
from .dicom_slices import DicomSlice, read_values, slices_of, stacked, value_type
from .voxels import VoxelReader, Voxels, times_meta

_MAGIC, _MAGIC_AT = b"DICM", 128
# So many files of a directory are tried: other directories are left alone quickly.
_FEW = 16
_ENDINGS = (".dcm", ".dicom", ".ima")
# Elements that must be equal in all slices of a volume.
_COMMON = ("Rows", "Columns", "BitsAllocated", "BitsStored", "PixelRepresentation")
# The class of a DICOMDIR: the table of contents of a disc or an export, which names files below.
_CONTENTS = "1.2.840.10008.1.3.10"
_KEYWORDS = re.findall(
    r"\w+",
    """
    AnatomicalOrientationType BitsAllocated BitsStored Columns DoseGridScaling DoseUnits
    FrameIncrementPointer GridFrameOffsetVector ImageOrientationPatient
    ImagePositionPatient ImageType InstanceNumber Modality NumberOfFrames
    PerFrameFunctionalGroupsSequence PixelRepresentation PixelSpacing RescaleIntercept
    RescaleSlope RescaleType Rows SamplesPerPixel SeriesDescription SeriesInstanceUID
    SeriesNumber SharedFunctionalGroupsSequence SliceThickness SpacingBetweenSlices
    Units
    """,
)

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
            return head[_MAGIC_AT:].startswith(_MAGIC)
        try:
            return path.is_dir() and any(map(_is_dicom, islice(_files(path), _FEW)))
        except OSError:
            return False

    @by_library("pydicom")  # elements are converted when they are first asked for
    def voxels(self, path: Path, *, series: Any = None, time: int = 0) -> Voxels:
        with _quiet():
            header, result = _slices(path, series)
        slices, placement, times = stacked(result, time)
        if header.get("AnatomicalOrientationType") == "QUADRUPED":  # not a human's axes
            placement = replace(placement, space="")
        shape = (int(header.Columns), int(header.Rows), len(slices))
        dtype = value_type(header, slices)
        meta = {
            "modality": header.get("Modality"),
            "series": header.get("SeriesDescription"),
            "rescale_type": header.get("RescaleType"),
        }

        def load(_: int) -> Any:
            with _quiet():
                return read_values(slices, shape, dtype)

        return Voxels(
            shape=shape,
            dtype=dtype,
            placement=placement,
            load=load,
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


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    logger = logging.getLogger("pydicom")
    before, logger.disabled = logger.disabled, True
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.disabled = before


def _is_dicom(path: Path) -> bool:
    with open(path, "rb") as file:
        return file.read(_MAGIC_AT + len(_MAGIC)).endswith(_MAGIC)


def _files(directory: Path) -> Iterator[Path]:
    with os.scandir(directory) as entries:
        for entry in entries:
            if not entry.name.startswith(".") and entry.is_file():
                yield Path(entry.path)


def _read_header(path: Path) -> Any:
    pydicom = require("pydicom", "medical", "reading DICOM")
    check_readable(path)
    with reading(path, "a DICOM file"), by_library("pydicom"):
        return pydicom.dcmread(path, stop_before_pixels=True, specific_tags=_KEYWORDS)


def _slices(path: Path, series: Any) -> tuple[Any, list[DicomSlice]]:
    headers = _chosen(path, series)
    first_file, first = headers[0]
    for file, header in headers:
        for keyword in _COMMON:
            if header.get(keyword) != first.get(keyword):
                raise FileFormatError(
                    f"{file.name} has {keyword} {header.get(keyword)}, but {first_file.name} has "
                    f"{first.get(keyword)}: they make no volume"
                )
    if "MOSAIC" in (first.get("ImageType") or ()):
        raise FileFormatError("it is a Siemens mosaic; convert it to NIfTI with 'dcm2niix'")
    if first.get("SamplesPerPixel", 1) != 1:
        raise FileFormatError("expected one value per pixel, but its pictures are coloured")
    result: list[DicomSlice] = []
    for file, header in headers:
        with reading(file, "a DICOM file"):
            result += slices_of(file, header)
    return first, result


def _chosen(path: Path, series: Any) -> _Headers:
    header = None if path.is_dir() else _read_header(path)
    if header is None or _is_contents(header):
        groups = _by_series(path, path) if header is None else _by_contents(path)
        return groups[_named(groups, series)]
    if series is not None:
        raise InputError("a file belongs to one series; give series for a directory only")
    if not _is_image(header):
        raise FileFormatError("expected a DICOM image, but there are no rows and columns of pixels")
    if int(header.get("NumberOfFrames") or 1) > 1:
        return [(path, header)]
    return _by_series(path.parent, path)[_uid(header)]


def _by_series(directory: Path, asked: Path) -> dict[str, _Headers]:
    files = []
    for file in sorted(_files(directory)):
        if _is_dicom(file):
            files.append(file)
        elif file == asked or file.suffix.lower() in _ENDINGS:
            raise FileFormatError(f"{file.name} is named like a DICOM file, but is none")
    headers = [(file, _read_header(file)) for file in files]
    groups = _grouped(headers)
    contents = [file for file, header in headers if _is_contents(header)]
    if not groups and contents:
        return _by_contents(contents[-1])
    if not groups:
        raise FileFormatError(f"there is no DICOM image in {directory}")
    return groups


def _by_contents(path: Path) -> dict[str, _Headers]:
    fileset = require("pydicom.fileset", "medical", "reading DICOM")
    files = [Path(item.path) for item in fileset.FileSet(path)]
    groups = _grouped([(file, _read_header(file)) for file in files])
    if not groups:
        raise FileFormatError("its table of contents names no image that is there")
    return groups


def _grouped(headers: _Headers) -> dict[str, _Headers]:
    groups: dict[str, _Headers] = {}
    for file, header in headers:
        if _is_image(header):
            groups.setdefault(_uid(header), []).append((file, header))
    return groups


def _named(groups: dict[str, _Headers], series: Any) -> str:
    names = {}
    for uid, headers in groups.items():
        number, text = (headers[0][1].get(f"Series{key}") for key in ("Number", "Description"))
        names[uid] = (uid, "" if number is None else str(number), str(text or ""))
    result = [uid for uid in groups if series is None or str(series) in names[uid]]
    if len(result) == 1:
        return result[0]
    listed = "\n".join(
        f"  series={names[uid][1]!r}: {names[uid][2]!r}, {headers[0][1].get('Modality')}, "
        f"{len(headers)} files, {uid}"
        for uid, headers in groups.items()
    )
    asked = "several series" if series is None else f"{len(result)} series {series!r}"
    raise InputError(f"there are {asked}; choose one by its number, text or UID:\n{listed}")


def _is_contents(header: Any) -> bool:
    return str(header.file_meta.get("MediaStorageSOPClassUID", "")) == _CONTENTS


def _is_image(header: Any) -> bool:
    return all(header.get(keyword) for keyword in ("Rows", "Columns", "BitsAllocated"))


def _uid(header: Any) -> str:
    return str(header.get("SeriesInstanceUID") or "")
