"""Checks of available memory before it is allocated."""

from __future__ import annotations

from .errors import MemoryNeededError

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
