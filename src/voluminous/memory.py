"""Checks of available memory before it is allocated."""

from __future__ import annotations

import os

from .errors import MemoryNeededError

# Numbers of glibc's options of malloc.
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
# Sizes below this always fit.
_SMALL = 64 << 20


def check_memory(needed: int, what: str, advice: str) -> None:
    """Refuse work that needs more bytes than are available."""
    if needed < _SMALL:
        return
    free = available_memory()
    if needed > free:
        raise MemoryNeededError(
            f"{what} needs {needed} bytes ({needed / 2**30:.2f} GiB), but only {free} bytes "
            f"({free / 2**30:.2f} GiB) are available; {advice}"
        )


def fits(needed: int) -> bool:
    """Return True if so many bytes can be taken."""
    return needed < _SMALL or needed <= available_memory()


def available_memory() -> int:
    """Return the bytes that can be taken without swapping."""
    import psutil

    return int(psutil.virtual_memory().available)


def reuse_memory() -> None:
    """Keep freed memory of this process for the next arrays of its size, as far as C allows.

    Workers of Dask give every array back to the system at once, and get pages of zeros for the
    next: it takes half as much time again (1024³ at 800²: 10.5 s of a processor, 6.5 s with this).
    """
    import ctypes

    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if os.name == "posix" else None
    if mallopt is not None:  # of glibc, or one that ignores it
        mallopt(_MMAP_THRESHOLD, 32 << 20)
        mallopt(_TRIM_THRESHOLD, 256 << 20)
