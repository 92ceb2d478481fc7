"""Saving of volumes to files and directories: complete or not at all."""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import InputError, unknown_name
from ..files import MissingPathError, as_path, naming_if_full, replacing
from .contract import Reader
from .guard import placed
from .registry import readers

if TYPE_CHECKING:
    from ..volume import Volume


def save(volume: Volume, path: str | Path, *, format: str | None = None, **options: Any) -> None:
    """Write a volume to a file or a directory; see `Volume.save`."""
    path = as_path(path)
    writer: Any = writer_for(path, format)
    for option in options:
        if option not in writer.write_options:
            raise unknown_name(f"{writer.name} option for writing", option, writer.write_options)
    place = _new_directory if writer.writes_directory else replacing
    with place(path) as temporary, placed(path):
        writer.write(volume, temporary, **options)


def writer_for(path: Path, format: str | None = None) -> Reader:
    """Return the writer for a file name, or for a format."""
    writers = [reader for reader in readers() if getattr(reader, "writes", False)]
    if format is not None:
        named = {reader.name: reader for reader in writers}
        if format not in named:
            raise unknown_name("format that can be written", format, named)
        return named[format]
    known: dict[str, Reader] = {}
    for reader in writers:
        for suffix in getattr(reader, "write_suffixes", ()) or reader.suffixes:
            known.setdefault(suffix, reader)  # the first with this suffix, as for reading
    fitting = [suffix for suffix in known if path.name.lower().endswith(suffix)]
    if not fitting:
        raise unknown_name("volume format", path.suffix, known)
    return known[max(fitting, key=len)]


@contextmanager
def _new_directory(path: Path) -> Iterator[Path]:
    target = Path(os.path.realpath(path))
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise InputError(f"{path} is there already; give a new name, or remove it first")
    if not target.parent.is_dir():
        raise MissingPathError(
            f"cannot save {path}: the directory {target.parent} does not exist; create it first"
        )
    temporary = target.with_name(f".{target.name[:40]}.{secrets.token_hex(6)}.part")
    temporary.mkdir()
    try:
        with naming_if_full(path):
            yield temporary
        if target.is_dir():
            target.rmdir()
        os.rename(temporary, target)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
