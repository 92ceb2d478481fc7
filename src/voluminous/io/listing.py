"""What a directory holds that can be opened, for those who gave the directory itself."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from itertools import islice
from pathlib import Path

from ..errors import InputError
from .contract import Reader

# Entries that are looked at: a directory may hold a million.
_LOOKED_AT, _LISTED = 256, 8


def openable(directory: Path, find: Callable[[Path], Reader | None]) -> str:
    """Return lines that name what can be opened in a directory; none if there is nothing.

    Parameters
    ----------
    directory : Path
        It is not looked into the directories in it more than their readers do.
    find : callable
        Returns the reader for a path, or None.
    """
    found = []
    try:
        for entry in sorted(islice(directory.iterdir(), _LOOKED_AT)):
            with contextlib.suppress(OSError, InputError):
                reader = None if entry.name.startswith(".") else find(entry)
                found += [] if reader is None else [f"  {entry}: {reader.description}"]
    except OSError:  # a directory that must not be read
        return ""
    more = [] if len(found) <= _LISTED else [f"  … and {len(found) - _LISTED} more"]
    return "\n".join(found[:_LISTED] + more)
