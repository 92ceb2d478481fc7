"""What is in a ZIP file, asked of any file."""

from __future__ import annotations

import zipfile
from pathlib import Path

# How they start: with a file in them, or empty.
ZIP = (b"PK\x03\x04", b"PK\x05\x06")


def zip_names(path: Path) -> frozenset[str]:
    """Return the names in a ZIP file; none if it is no ZIP file, or too damaged to tell."""
    try:
        with zipfile.ZipFile(path) as archive:
            return frozenset(archive.namelist())
    except Exception:  # of damaged ones it raises nearly anything, NotImplementedError too
        return frozenset()
