"""Memory that work takes, known before it is taken."""

from __future__ import annotations

from .errors import MemoryNeededError

# Below this nobody needs to ask the system.
_SMALL = 64 << 20


def check_memory(needed: int, what: str, advice: str) -> None:
    """Refuse work that does not fit.

    Parameters
    ----------
    needed : int
        Bytes.
    what, advice : str
        What needs them, and what to do if they are not there.
    """
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
