"""A file that HDF5 is written to, so that a full disk is an error and no crash."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import h5py


class Sink(io.FileIO):
    """A file that takes all that is written, and remembers that it could not.

    Where a file cannot be closed, since what is left in its buffers cannot be written, libhdf5 1.14
    ends the process: of small files that is all there is. So it never hears of it.

    Attributes
    ----------
    failed : OSError or None
        Why not all is in the file.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path, "w+")
        self.failed: OSError | None = None

    def write(self, data: Any) -> int:
        """Write all bytes, unless some could not be written before; return how many were given."""
        left = memoryview(data).cast("B")
        count = len(left)
        try:
            while len(left) and self.failed is None:
                left = left[super().write(left) or 0 :]
        except OSError as error:
            self.failed = error
        return count

    def truncate(self, size: int | None = None) -> int:
        """Set the length of the file, if that is possible."""
        try:
            return super().truncate(size)
        except OSError as error:
            self.failed = self.failed or error
            return size or 0

    def check(self) -> None:
        """Raise what has happened.

        Raises
        ------
        OSError
            If something could not be written.
        """
        if self.failed is not None:
            raise self.failed


@contextmanager
def created(path: Path, **options: Any) -> Iterator[tuple[h5py.File, Sink]]:
    """Give a new HDF5 file, closed in the end, and what it is written to.

    Raises
    ------
    OSError
        If not all could be written.
    """
    import h5py

    with Sink(path) as sink:
        with h5py.File(sink, "w", **options) as file:
            yield file, sink
        sink.check()
