"""How much memory a render takes, known before it is taken."""

from __future__ import annotations

from ..errors import MemoryNeededError

# Below this nobody needs to ask the system.
_SMALL = 64 << 20
# Slabs of temporary numbers while classifying.
_OVERHEAD = 96 << 20


def check_memory(needed: int, what: str) -> None:
    """Refuse work that does not fit.

    Raises
    ------
    MemoryNeededError
        With the number of bytes needed and available.
    """
    if needed < _SMALL:
        return
    free = available_memory()
    if needed + _OVERHEAD > free:
        raise MemoryNeededError(
            f"{what} needs {needed + _OVERHEAD} bytes ({(needed + _OVERHEAD) / 2**30:.2f} GiB), "
            f"but only {free} bytes ({free / 2**30:.2f} GiB) are available; take "
            "precision='single', scheme='first-order' (which can do without a table), or a coarser "
            "or smaller volume"
        )


def fits(needed: int) -> bool:
    """Return True if so many bytes can be taken."""
    return needed < _SMALL or needed + _OVERHEAD <= available_memory()


def available_memory() -> int:
    """Return the bytes that can be taken without swapping."""
    import psutil

    return int(psutil.virtual_memory().available)
