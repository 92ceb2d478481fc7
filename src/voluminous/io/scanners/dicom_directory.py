"""DICOMDIR: the table of contents of a disc, or of an export, which names files below it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ...errors import FileFormatError, InputError
from ..payload import inside
from .dicom_file import read_parts

_CLASS = "1.2.840.10008.1.3.10"
_MOST_FILES = 100_000


def is_directory(head: Any) -> bool:
    """Return True for the head of a table of contents."""
    return str(head.file_meta.get("MediaStorageSOPClassUID", "")) == _CLASS


def images_named(path: Path) -> list[Path]:
    """Return the files of images that a table of contents names.

    Raises
    ------
    FileFormatError
        If it names none, too many, or one elsewhere.
    InputError
        If one is not there.
    """
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
