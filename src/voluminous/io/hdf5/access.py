"""Know an HDF5 file, and open it."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...errors import MissingPackageError
from .trial import check

if TYPE_CHECKING:
    import h5py

# What libhdf5 says of such values.
_NO_FILTER = re.compile(
    r"can't open directory|required filter|filter .*(not|n't) (registered|avail)"
)
MAGIC = b"\x89HDF\r\n\x1a\n"
# A user block of 512 bytes or more may come first.
_STARTS = (0, 512, 1024, 2048)


def is_hdf5(head: bytes) -> bool:
    """Return whether a file with these first bytes is HDF5."""
    return any(head[start:].startswith(MAGIC) for start in _STARTS)


@contextmanager
def opened(path: Path) -> Iterator[h5py.File]:
    """Open a file to read, once it is known that this does no harm.

    Raises
    ------
    FileFormatError
        If the file makes libhdf5 crash or hang.
    MissingPackageError
        If values are packed by a filter that nobody has.
    OSError
        If libhdf5 refuses it.
    """
    import h5py

    check(path)
    with filters(), h5py.File(path, "r") as file:
        yield file


def holds(path: Path, head: bytes, mark: Callable[[h5py.File], Any]) -> bool:
    """Return whether a file is HDF5 that has a mark; False if it is damaged."""
    if not is_hdf5(head):
        return False
    try:
        with opened(path) as file:
            return bool(mark(file))
    except Exception:  # whoever reads it says what is wrong
        return False


@contextmanager
def filters() -> Iterator[None]:
    """Let hdf5plugin unpack values, if it is there: Blosc, LZ4, Zstandard, SZ …

    Raises
    ------
    MissingPackageError
        If values are packed by a filter that nobody has.
    """
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
