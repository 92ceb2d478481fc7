"""What yt cannot know: it takes seconds to import, which are not spent on a letter or a photo."""

from __future__ import annotations

import codecs
import importlib.metadata
from pathlib import Path

# The formats among those of yt 4 that are text, by their names, or by their first bytes.
_TEXT_SUFFIXES = (".parameter", ".hierarchy", ".block_list", ".vtk")
_TEXT_STARTS = (b"# SDF", b"# vtk DataFile")
_RAMSES = "info_"
# How pictures, documents, archives and programs start, none of which is any of yt's formats.
_STRANGERS = (
    *(b"\x89PNG", b"\xff\xd8\xff", b"GIF8", b"RIFF", b"II*\0", b"MM\0*", b"%PDF", b"PK\x03\x04"),
    *(b"\x7fELF", b"\x1f\x8b", b"BZh", b"\xfd7zXZ", b"7z\xbc\xaf", b"OggS", b"SQLite format 3"),
)
_GROUP = "yt.frontends"


def may_be_of_yt(path: Path, head: bytes) -> bool:
    """Return False for what none of yt's formats can be, without importing yt.

    Parameters
    ----------
    path : Path
        A file or directory.
    head : bytes
        The first bytes of a file.
    """
    if importlib.metadata.entry_points(group=_GROUP):
        return True  # other packages have taught yt formats of which nothing is known
    if path.is_dir():
        return _may_be_directory(path)
    if head.startswith(_STRANGERS):
        return False
    return not is_text(head) or _may_be_text(path, head)


def is_text(head: bytes) -> bool:
    """Return True for UTF-8 that people and programs read, though it may end within a letter."""
    try:
        text = codecs.getincrementaldecoder("utf-8")().decode(head)
    except UnicodeDecodeError:
        return False
    return all(letter.isprintable() or letter.isspace() for letter in text)


def _may_be_text(path: Path, head: bytes) -> bool:
    named = path.suffix in _TEXT_SUFFIXES or path.name.startswith(_RAMSES)
    described = path.with_name(f"{path.name}.hierarchy").exists()
    return named or described or head.startswith(_TEXT_STARTS)


def _may_be_directory(path: Path) -> bool:
    """Return True for plotfiles of AMReX, outputs of RAMSES, and pieces of snapshots of Gadget."""
    names = [entry.name for entry in path.iterdir()]
    return any(n == "Header" or n.startswith(_RAMSES) or ".0" in n for n in names)
