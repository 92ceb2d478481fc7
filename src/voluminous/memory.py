"""Numbers of bytes, and checks of available memory before it is allocated."""

from __future__ import annotations

import math
import os
import re
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from .errors import InputError, MemoryNeededError

# Numbers of glibc's options of malloc.
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
# Sizes below this always fit.
_SMALL = 64 << 20
# What Dr.Jit and LLVM take of address space when they are loaded with this package (370 MiB with
# two threads), and to compile and run a kernel, besides its arrays.
LOADING, KERNELS = 448 << 20, 128 << 20
# More than any machine has: control groups of version 1 without a limit have the largest number.
_NO_LIMIT = 1 << 60
_SIZES = {"": 0, "K": 1, "M": 2, "G": 3, "T": 4}
_TEXT = re.compile(r"\s*([0-9.]+(?:e[0-9]+)?)\s*([KMGT]?)(i?)B?\s*", re.IGNORECASE)


def byte_count(memory: Any) -> int:
    """Return a number of bytes from text such as ``"2 GiB"`` or ``"500 MB"``, or a number."""
    if isinstance(memory, (int, float)) and memory is not True and 0 < memory < 1e30:
        return int(memory)
    found = _TEXT.fullmatch(memory) if isinstance(memory, str) else None
    try:
        count = float(found[1]) if found else 0.0
    except ValueError:
        count = 0.0
    if not found or not 0.0 < count < math.inf:
        raise InputError(
            "memory is the number of bytes that drawing may take, as in memory='2 GiB', '500 MB' "
            f"or 2_000_000_000, got {memory!r}"
        )
    return int(count * (1024 if found[3] else 1000) ** _SIZES[found[2].upper()])


def check_memory(needed: int, what: str, advice: str, free: int | None = None) -> None:
    """Refuse work that needs more bytes than are available, or than are free."""
    if needed < _SMALL:
        return
    free = available_memory() if free is None else free
    if needed > free:
        raise MemoryNeededError(
            f"{what} needs {needed} bytes ({needed / 2**30:.2f} GiB), but only {free} bytes "
            f"({free / 2**30:.2f} GiB) are available; {advice}"
        )


def check_limits(needed: int, what: str) -> None:
    """Refuse what libraries would end the process for, where its limits leave too little."""
    free = min(_left_of_limits(), default=needed)
    check_memory(needed, what, "raise the limits of the process (ulimit -v, ulimit -d)", free)


def fits(needed: int) -> bool:
    """Return True if so many bytes can be taken."""
    return needed < _SMALL or needed <= available_memory()


def available_memory(
    process: Path = Path("/proc/self"), groups: Path = Path("/sys/fs/cgroup")
) -> int:
    """Return the bytes that this process can take without swapping.

    The least of what the machine has, and of what the limits of the process (``ulimit``) and those
    of its control groups leave: of a batch job, or a container.
    """
    import psutil

    left = *_left_of_limits(), *_left_in_groups(process, groups)
    return max(0, min(int(psutil.virtual_memory().available), *left, sys.maxsize))


def _left_of_limits() -> Iterator[int]:
    if sys.platform == "linux":
        import resource

        import psutil

        held = psutil.Process().memory_info()
        for kind, size in ((resource.RLIMIT_AS, held.vms), (resource.RLIMIT_DATA, held.data)):
            limit = resource.getrlimit(kind)[0]
            if limit != resource.RLIM_INFINITY:
                yield max(0, limit - size)


def _left_in_groups(process: Path, groups: Path) -> Iterator[int]:
    """Yield what the control groups of a process, and those around them, leave of their limits.

    Versions 2 and 1: https://docs.kernel.org/admin-guide/cgroup-v2.html, ``cgroup-v1/memory.html``.
    Pages of files count in their usage, but are given back when memory is short.
    """
    with suppress(OSError):
        for line in (process / "cgroup").read_text().splitlines():
            _, controllers, place = (*line.split(":", 2), "", "")[:3]
            if controllers and "memory" not in controllers.split(","):
                continue
            root, files, word = groups, ("memory.max", "memory.current"), ""
            if controllers:
                root, word = groups / "memory", "total_"
                files = ("memory.limit_in_bytes", "memory.usage_in_bytes")
            # In a container the path may be as the machine outside sees it.
            inner = root.joinpath(*(part for part in place.split("/") if part not in ("", "..")))
            for group in (inner, *inner.parents[: len(inner.parts) - len(root.parts)]):
                # Not there, or the word "max".
                with suppress(OSError, ValueError):
                    if (limit := int((group / files[0]).read_text())) >= _NO_LIMIT:
                        continue
                    held = int((group / files[1]).read_text())
                    stat = dict(p.split() for p in (group / "memory.stat").read_text().splitlines())
                    cached = (f"{word}{kind}_file" for kind in ("active", "inactive"))
                    yield limit - held + sum(int(stat.get(name, 0)) for name in cached)


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
