"""What a file format has to offer. A new one is one file beside this and one entry in the list."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Format:
    """A file format for images.

    Parameters
    ----------
    name : str
        For messages, with an article: "a PNG image".
    suffixes : tuple of str
        Lower case, with the dot.
    magic : tuple of bytes
        What a file of this format can start with.
    write : callable
        ``write(image, path, **options)``; `path` is a new file, removed again after an error.
    read : callable
        ``read(path)`` gives the keyword arguments of `Image`. It need not guard itself: whatever
        it raises becomes a `FileFormatError` that names the file.
    options : frozenset of str
        Names of the options that `write` takes.
    """

    name: str
    suffixes: tuple[str, ...]
    magic: tuple[bytes, ...]
    write: Callable[..., None]
    read: Callable[[Path], dict[str, Any]]
    options: frozenset[str] = field(default_factory=frozenset)
