"""Saving of volumes to files and directories: complete or not at all."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import unknown_name
from ..files import as_path, new_directory, replacing
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
    place = new_directory if writer.writes_directory else replacing
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
