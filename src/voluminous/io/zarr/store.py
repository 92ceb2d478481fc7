"""What is in a Zarr store, from its JSON alone: the library is not needed to look.

Version 2 (https://zarr-specs.readthedocs.io/en/latest/v2/v2.0.html) has files ``.zgroup``,
``.zarray`` and ``.zattrs``, version 3 has ``zarr.json``.
"""

from __future__ import annotations

import json
import math
import zipfile
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from ...errors import FileFormatError, VoluminousError
from ...memory import check_memory
from ...packages import require
from ..archives import ZIP, zip_names

_NODES = ("zarr.json", ".zarray", ".zgroup")
# Much longer descriptions, deeper groups and more arrays are damage or mischief.
_LONGEST, _DEEPEST, _MOST = 16 << 20, 16, 10_000


class Store(Protocol):
    """Files by names with slashes."""

    def text(self, name: str) -> bytes | None:
        """Return the content of a file, None if it is not there."""

    def children(self, name: str) -> list[str]:
        """Return the names of what a directory holds that may be a node."""


class DirectoryStore:
    """A directory."""

    def __init__(self, root: Path) -> None:
        self.root = root

    def text(self, name: str) -> bytes | None:
        """Return the content of a file, None if it is not there."""
        path = self.root / name
        if not path.is_file():
            return None
        _check_length(name, path.stat().st_size)
        return path.read_bytes()

    def children(self, name: str) -> list[str]:
        """Return the names of directories in one."""
        path = self.root / name
        return sorted(p.name for p in path.iterdir() if p.is_dir()) if path.is_dir() else []


class ZipStore:
    """A ZIP file."""

    def __init__(self, archive: zipfile.ZipFile) -> None:
        self.archive = archive
        self.names = set(archive.namelist())

    def text(self, name: str) -> bytes | None:
        """Return the content of a file, None if it is not there."""
        if name not in self.names:
            return None
        _check_length(name, self.archive.getinfo(name).file_size)
        return self.archive.read(name)

    def children(self, name: str) -> list[str]:
        """Return the names of directories in one."""
        start = f"{name}/" if name else ""
        rests = [n[len(start) :] for n in self.names if n.startswith(start)]
        return sorted({rest.split("/", 1)[0] for rest in rests if "/" in rest})


@dataclass(frozen=True)
class Node:
    """A group or an array: where it is, and what is said of it."""

    place: str
    is_array: bool
    attributes: dict[str, Any]
    dims: tuple[str, ...] | None = None


@contextmanager
def stored(path: Path) -> Iterator[Store]:
    """Give the store at a path."""
    if path.is_dir():
        yield DirectoryStore(path)
        return
    try:
        with zipfile.ZipFile(path) as archive:
            yield ZipStore(archive)
    except (VoluminousError, MemoryError):
        raise
    except Exception as error:  # nearly anything, from BadZipFile to NotImplementedError
        raise FileFormatError(f"the ZIP file is damaged or cut short ({error})") from error


def holds_zarr(path: Path, head: bytes) -> bool:
    """Return True for a directory or a ZIP file that is a Zarr store."""
    if path.is_dir():
        return any((path / name).is_file() for name in _NODES)
    if not head.startswith(ZIP):
        return False
    names = zip_names(path)
    return not names.isdisjoint(_NODES) or (not names and path.name.lower().endswith(".zarr.zip"))


def node_at(store: Store, place: str = "") -> Node | None:
    """Return the group or array at a place, None if there is none."""
    start = f"{place}/" if place else ""
    told = _json(store, start + "zarr.json")
    if told is not None:
        dims = told.get("dimension_names") or ([] if told.get("shape") == [] else None)
        attributes = _mapping(told.get("attributes"))
        return Node(place, told.get("node_type") == "array", attributes, _names(dims))
    attributes = _json(store, start + ".zattrs") or {}
    dims = _names(attributes.get("_ARRAY_DIMENSIONS"))
    if store.text(start + ".zarray") is not None:
        return Node(place, True, attributes, dims)
    if store.text(start + ".zgroup") is not None:
        return Node(place, False, attributes)
    return None


def arrays_in(store: Store, place: str = "", depth: int = 0) -> Iterator[Node]:
    """Give all arrays at a place and below."""
    if depth > _DEEPEST:
        raise FileFormatError(f"groups are nested deeper than {_DEEPEST} at {place!r}")
    node = node_at(store, place)
    if node is None or node.is_array:
        yield from [] if node is None else [node]
        return  # below an array are its pieces, which may be millions
    for count, name in enumerate(store.children(place)):
        if count > _MOST:
            raise FileFormatError(f"{place!r} holds more than {_MOST} groups")
        yield from arrays_in(store, f"{place}/{name}" if place else name, depth + 1)


def _json(store: Store, name: str) -> dict[str, Any] | None:
    text = store.text(name)
    if text is None:
        return None
    try:
        found = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise FileFormatError(f"{name} is no JSON: {error}") from error
    if not isinstance(found, dict):
        raise FileFormatError(f"{name} must be a JSON object, got {type(found).__name__}")
    return found


def _mapping(value: Any) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}


def _names(value: Any) -> tuple[str, ...] | None:
    """Return names of dimensions, if all are texts; those of a single number are none."""
    if isinstance(value, list) and all(isinstance(name, str) for name in value):
        return tuple(value)
    return None


def _check_length(name: str, size: int) -> None:
    if size > _LONGEST:
        raise FileFormatError(f"{name} has {size} bytes, expected at most {_LONGEST}")


@contextmanager
def zarr_store(path: Path) -> Iterator[Any]:
    """Give what the library and xarray take for a store."""
    zarr = require("zarr", "arrays", "reading Zarr")
    if path.is_dir():
        yield str(path)
    else:
        with closing(zarr.storage.ZipStore(str(path), mode="r")) as store:
            yield store


def zarr_array(store: Any, place: str) -> Any:
    """Return an array; nothing of its values is read."""
    zarr = require("zarr", "arrays", "reading Zarr")
    array = zarr.open_array(store, mode="r", path=place or None)
    pieces = tuple(int(n) for n in array.chunks)
    if any(n < 1 for n in pieces) or any(int(n) < 0 for n in array.shape):
        raise FileFormatError(f"{place!r} has shape {array.shape} in pieces of {pieces}")
    size = math.prod(pieces) * array.dtype.itemsize
    check_memory(size, f"one piece {pieces} of {place!r}", "store it in smaller chunks")
    return array
