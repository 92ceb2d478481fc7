"""Interface of a file format. To add one, add a module here and an entry in `FORMATS`."""

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
        Possible first bytes of a file of this format.
    write : callable
        ``write(image, path, **options)``; `path` is a new file, removed again after an error.
    read : callable
        ``read(path)`` returns the keyword arguments of `Image`. It need not catch exceptions: the
        caller converts any of them to a `FileFormatError` that names the file.
    options : frozenset of str
        Names of the options that `write` takes.
    """

    name: str
    suffixes: tuple[str, ...]
    magic: tuple[bytes, ...]
    write: Callable[..., None]
    read: Callable[[Path], dict[str, Any]]
    options: frozenset[str] = field(default_factory=frozenset)
