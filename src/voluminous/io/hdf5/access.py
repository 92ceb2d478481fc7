"""Know an HDF5 file, and open it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .trial import check

if TYPE_CHECKING:
    import h5py

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
    OSError
        If libhdf5 refuses it.
    """
    import h5py

    check(path)
    with h5py.File(path, "r") as file:
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
