"""Sizes of files, in words."""

from __future__ import annotations

from pathlib import Path


def bytes_of(path: Path) -> int:
    """Return the size of a file, or of all files in a directory."""
    files = path.rglob("*") if path.is_dir() else [path]
    return sum(file.stat().st_size for file in files if file.is_file())


def in_bytes(size: float) -> str:
    """Return a number of bytes in words.

    Examples
    --------
    >>> in_bytes(1000), in_bytes(3 << 20)
    ('1000 bytes', '3 MiB')
    """
    for unit in ("bytes", "KiB", "MiB", "GiB"):
        if size < 1024 or unit == "GiB":
            break
        size /= 1024
    return f"{size:.4g} {unit}"
