"""The process that looks through HDF5 files; it may die of one.

Run as a script, with the module path of its parent (JSON) as argument. Paths of files come on
standard input, one per line, in JSON; for each a line goes out: one `ALIVE` per object, and what is
wrong with the file, if anything is.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import signal
import sys
import time
from collections.abc import Iterator
from typing import Any

ALIVE = b"."
# Seconds for one file: the headers of a thousand data sets take 0.3 s.
LONGEST = 2.0
# Seconds of processor time for one object; the slowest of disks does not count.
STEADY = 3.0
# Bytes of a data set that is read: texts and lists are in heaps, which only reading goes through.
SMALL = 1 << 16


class DamagedError(Exception):
    """What libhdf5 would not notice before it has taken the memory."""


def look_through(path: str, alive: Any) -> None:
    """Look at the attributes and the layout of all objects, and at what is in small data sets.

    Parameters
    ----------
    path : str
    alive : callable
        Called before the file is opened, and before each object.

    Raises
    ------
    DamagedError
        If an attribute is said to be larger than the file.
    """
    import h5py

    until = time.monotonic() + LONGEST
    size = os.path.getsize(path)
    alive()
    with h5py.File(path, "r") as file:
        waiting, seen = [file["/"]], set()
        while waiting and time.monotonic() < until:
            alive()
            item = waiting.pop()
            with _trying():
                address = h5py.h5o.get_info(item.id).addr
                if address not in seen:
                    seen.add(address)
                    _look(item, size)
                    waiting += _children(item)


def _end_after(seconds: float) -> None:
    """Let the system end this process if libhdf5 goes round in circles (not on Windows)."""
    if hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_PROF, seconds)


@contextlib.contextmanager
def _trying() -> Iterator[None]:
    """Go on after whatever libhdf5 notices: whoever reads the file will say so."""
    try:
        yield
    except DamagedError:
        raise
    except Exception:
        pass


def _look(item: Any, size: int) -> None:
    import h5py

    for name in item.attrs:
        with _trying():
            told = item.attrs.get_id(name)
            if math.prod(told.shape or ()) * told.dtype.itemsize > size:
                raise DamagedError(f"the attribute {name!r} of {item.name} is larger than the file")
            item.attrs[name]
    if isinstance(item, h5py.Dataset):
        with contextlib.suppress(Exception):
            _ = item.shape, item.dtype, item.compression, item.fillvalue
            if item.chunks:
                item.id.get_num_chunks()
            if item.nbytes <= SMALL and not item.is_virtual and not item.external:
                item[()]


def _children(item: Any) -> list[Any]:
    """Return what is in a group; links to other places lead out of what is looked at."""
    import h5py

    found = []
    for name in item if isinstance(item, h5py.Group) else ():
        with contextlib.suppress(Exception):
            if isinstance(item.get(name, getlink=True), h5py.HardLink):
                found.append(item[name])
    return found


def main() -> None:
    """Serve until the parent closes the pipe."""
    with contextlib.suppress(ImportError):  # not on Windows
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))  # a crash leaves no file behind
    sys.path[:] = json.loads(sys.argv[1])
    out = sys.stdout.buffer

    def say(what: bytes) -> None:
        out.write(what)
        out.flush()

    def alive() -> None:
        say(ALIVE)
        _end_after(STEADY)

    for line in sys.stdin:
        trouble = ""
        try:
            look_through(json.loads(line), alive)
        except DamagedError as error:
            trouble = ascii(str(error))[1:-1]
        except Exception:  # libhdf5 refuses it, and will again
            pass
        _end_after(0)
        say(trouble.encode() + b"\n")


if __name__ == "__main__":
    main()
