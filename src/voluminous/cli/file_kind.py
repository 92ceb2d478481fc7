"""What kind of file a command is given: a scene, an image or a volume."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from ..errors import FileFormatError, VoluminousError

_NONE: Mapping[str, Any] = MappingProxyType({})


def is_image(path: Path) -> bool:
    """Return True for an image file; content decides where volumes have the same suffix."""
    from ..image.formats import FORMATS
    from ..io import find_reader

    if not any(path.suffix.lower() in form.suffixes for form in FORMATS):
        return False
    try:
        return find_reader(path).holds_image(path)
    except VoluminousError:  # no volume has it, or there is no such file
        return True


def is_volume(path: Path, format: str | None = None, given: Mapping[str, Any] = _NONE) -> bool:
    """Return True for a file with data; False for a scene, or an image with one in it.

    The format may be among what ``--set`` gives, too.

    Raises
    ------
    VoluminousError
        If there is no such file, or nothing can be made of it.
    """
    from ..io import find_reader
    from ..io.registry import reader_for_suffix

    if format is None and (path.suffix.lower() == ".toml" or is_image(path)):
        return False
    told = given.get("format", given.get("volume.format"))
    try:
        find_reader(path, format or (told if isinstance(told, str) else None))
    except FileFormatError:
        if _is_text(path) and reader_for_suffix(path) is None:  # a scene by another name
            return False
        raise
    return True


def _is_text(path: Path) -> bool:
    if not path.is_file():
        return False
    try:
        path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        return False
    return path.stat().st_size > 0
