"""HDF5 files: detection by the first bytes, opening, checks of data sets, and writing.

A data set is read only if the file is large enough for its declared size, and never from another
file outside of the directory.
"""

from __future__ import annotations

import io
import itertools
import math
import re
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import FileFormatError, MissingPackageError
from ..files import check_readable, url_of
from ..memory import check_memory
from . import remote
from .payload import inside

if TYPE_CHECKING:
    import h5py

# libhdf5's error for such values.
_NO_FILTER = re.compile(
    r"can't open directory|required filter|filter .*(not|n't) (registered|avail)"
)
MAGIC = b"\x89HDF\r\n\x1a\n"
# A user block of 512 bytes or more may precede the signature.
_STARTS = (0, 512, 1024, 2048)


def is_hdf5(head: bytes) -> bool:
    """Return True if a file with these first bytes is HDF5."""
    return any(head[start:].startswith(MAGIC) for start in _STARTS)


@contextmanager
def opened(path: Path) -> Iterator[h5py.File]:
    """Open a file to read, or one at a URL."""
    import h5py

    if not (url := url_of(path)):
        check_readable(path)
        with filters(), h5py.File(path, "r") as file:
            yield file
        return
    with remote.for_hdf5(url) as source:
        try:
            with filters(), h5py.File(source, "r") as file:
                yield file
        except (OSError, RuntimeError, KeyError):
            # HDF5 does not tell why it could not read.
            failed, source.failed = source.failed, None
            if failed is None:
                raise
            raise failed from None


def first_bytes(path: Path, length: int) -> bytes:
    """Return the first bytes of a file, or of one at a URL."""
    if url_of(path):
        return remote.head_of(path, length)
    check_readable(path)
    with open(path, "rb") as file:
        return file.read(length)


def holds(path: Path, head: bytes, mark: Callable[[h5py.File], Any]) -> bool:
    """Return True if a file is HDF5 and `mark` accepts it; False if it is damaged."""
    if not is_hdf5(head):
        return False
    try:
        with opened(path) as file:
            return bool(mark(file))
    except Exception:  # reading it reports the error
        return False


@contextmanager
def filters() -> Iterator[None]:
    """Enable hdf5plugin's filters if it is installed: Blosc, LZ4, Zstandard, SZ …"""
    with suppress(ImportError):
        import hdf5plugin  # noqa: F401 - registers itself
    try:
        yield
    except OSError as error:
        if not _NO_FILTER.search(str(error)):
            raise
        raise MissingPackageError(
            "values are packed by a filter that HDF5 lacks here; get it with\n"
            "  pip install hdf5plugin"
        ) from error


# Slightly above the maximum compression ratio of deflate, 1032.
_MOST_PACKED = 2000


def is_own(group: h5py.Group, name: str) -> bool:
    """Return True if an item is stored in the group itself, not linked from elsewhere."""
    import h5py

    return isinstance(group.get(name, getlink=True), h5py.HardLink)


def data_set(path: Path, group: h5py.Group, name: str) -> Any:
    """Return a numeric data set."""
    import h5py

    item = group[name] if is_own(group, name) else None
    if not isinstance(item, h5py.Dataset):
        raise FileFormatError(f"expected a data set {group.name}/{name}")
    if item.dtype.kind not in "fiub" or item.shape is None:
        raise FileFormatError(f"{item.name} must be numbers, got {item.dtype}")
    check_place(path, item)
    size = item.size * item.dtype.itemsize
    if not item.is_virtual and size > _MOST_PACKED * item.id.get_storage_size():
        raise FileFormatError(
            f"{item.name} promises values of shape {item.shape}, but has "
            f"{item.id.get_storage_size()} bytes in the file"
        )
    return item


# Virtual data sets whose sources were looked at: file, time of its last change, and name.
_SOUND: set[tuple[str, int, str]] = set()
# Virtual data sets may have virtual sources, so many times.
_DEEPEST = 8


def check_place(path: Path, item: h5py.Dataset, above: tuple[Any, ...] = ()) -> None:
    """Refuse external values, and virtual ones from outside of the directory or from themselves."""
    import h5py

    if item.external:
        raise FileFormatError(
            f"the values of {item.name} are in {item.external[0][0]!r}, not in the file itself; "
            "copy them into one file with h5repack"
        )
    if not item.is_virtual:
        return
    known = (str(path), 0 if url_of(path) else path.stat().st_mtime_ns, item.name)
    if known in _SOUND:
        return
    address = (path.resolve(), h5py.h5o.get_info(item.id).addr)
    if address in above or len(above) == _DEEPEST:
        raise FileFormatError(
            f"the values of {item.name} are virtual, and come from itself, or from others through "
            f"{_DEEPEST} virtual data sets; write the values themselves"
        )
    for name, place in {(s.file_name, s.dset_name) for s in item.virtual_sources()}:
        there = path if name == "." else inside(path.parent, name)
        with nullcontext(item.file) if name == "." else opened(there) as file:
            if isinstance(source := file.get(place), h5py.Dataset):
                check_place(there, source, (*above, address))
    _SOUND.add(known)


def check_places(path: Path) -> None:
    """Check all data sets of a file that a library reads, if it is HDF5 (and not on a server)."""
    if not url_of(path) and is_hdf5(first_bytes(path, _STARTS[-1] + len(MAGIC))):
        with opened(path) as file:
            file.visititems(
                lambda _, item: check_place(path, item) if hasattr(item, "is_virtual") else None
            )


def data_sets(path: Path, group: h5py.Group) -> tuple[dict[str, Any], dict[str, str]]:
    """Return the numeric data sets in a group, and the reason for rejecting each other item."""
    import h5py

    sets: dict[str, Any] = {}
    others: dict[str, str] = {}
    for name in group:
        item = group[name] if is_own(group, name) else None
        if not isinstance(item, h5py.Dataset):
            others[name] = "a link" if item is None else "a group"
        elif not item.size:
            others[name] = "no values"
        elif item.dtype.kind not in "fiub":
            others[name] = f"values of type {item.dtype}"
        else:
            sets[name] = data_set(path, group, name)
    return sets, others


# Data sets, by file and name, of which it was said that chunks are missing.
_TOLD: set[tuple[str, str]] = set()


def warn_of_missing(item: h5py.Dataset, index: Any = ...) -> None:
    """Warn, once, if a part of a data set has chunks that were never written.

    HDF5 takes the fill value for their cells, as if a program that was stopped had gone on.
    """
    key = (item.file.filename, item.name)
    if not item.chunks or item.is_virtual or key in _TOLD:
        return
    counts = [-(-n // side) for n, side in zip(item.shape, item.chunks, strict=True)]
    if item.id.get_num_chunks() >= math.prod(counts):
        return
    ranges = []
    index = (slice(None),) * item.ndim if index is ... else index
    for one, n, side in zip(index, item.shape, item.chunks, strict=True):
        low, high = one.indices(n)[:2] if isinstance(one, slice) else (one, one + 1)
        ranges.append(range(low // side, -(-high // side)))
    for number in itertools.product(*ranges):
        first = tuple(i * side for i, side in zip(number, item.chunks, strict=True))
        if item.id.get_chunk_info_by_coord(first).byte_offset is None:
            _TOLD.add(key)
            warnings.warn(
                f"{key[0]}: the chunk {number} of {item.name} was never written: HDF5 takes the "
                f"fill value {item.fillvalue} for its cells; others may be missing, too",
                stacklevel=2,
            )
            return


def read(item: h5py.Dataset, column: int | None = None) -> np.ndarray:
    """Return the values of a data set, or one column of them, in native byte order."""
    count = item.size if column is None else len(item)
    check_memory(count * item.dtype.itemsize, f"reading {item.name}", "read a part of the data")
    warn_of_missing(item)
    values = item[()] if column is None else item[:, column]
    return np.asarray(values, item.dtype.newbyteorder("="))


def fixed(content: str) -> np.ndarray:
    """Return a text of fixed length: others are in a heap, of whose damage HDF5 hangs."""
    import h5py

    encoded = content.encode()
    return np.array(encoded, h5py.string_dtype("utf-8", max(len(encoded), 1)))


def text(attribute: Any) -> str:
    """Return an attribute that is a single string, in any storage; "" for any other."""
    values = np.ravel(attribute)
    first = values[0] if values.size == 1 else ""
    first = first.decode("utf-8", "replace") if isinstance(first, bytes) else first
    return first.strip() if isinstance(first, str) else ""


class Sink(io.FileIO):
    """A file object that accepts all writes and records the first error.

    If a file cannot be closed because its buffers cannot be written, libhdf5 1.14 ends the process;
    small files are written entirely from these buffers. So errors are hidden from libhdf5.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path, "w+")
        self.failed: OSError | None = None

    def write(self, data: Any) -> int:
        """Write all bytes, unless an earlier write failed; return the number of bytes given."""
        left = memoryview(data).cast("B")
        count = len(left)
        try:
            while len(left) and self.failed is None:
                left = left[super().write(left) or 0 :]
        except OSError as error:
            self.failed = error
        return count

    def truncate(self, size: int | None = None) -> int:
        """Set the length of the file, if possible."""
        try:
            return super().truncate(size)
        except OSError as error:
            self.failed = self.failed or error
            return size or 0

    def check(self) -> None:
        """Raise the recorded error."""
        if self.failed is not None:
            raise self.failed


@contextmanager
def created(path: Path, **options: Any) -> Iterator[tuple[h5py.File, Sink]]:
    """Yield a new HDF5 file, closed at the end, and the sink that it is written to."""
    import h5py

    with Sink(path) as sink:
        with h5py.File(sink, "w", **options) as file:
            yield file, sink
        sink.check()
