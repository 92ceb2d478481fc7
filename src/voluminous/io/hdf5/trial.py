"""Let another process look through an HDF5 file first, since libhdf5 may crash or hang.

The process is started for the first file (0.2 s: Python and h5py) and serves all that follow
(5 ms for a few data sets), until this one ends. A search without an end is ended after 3 s of
processor time; where the system cannot do that, the silence shows it.
"""

from __future__ import annotations

import functools
import json
import os
import queue
import signal
import subprocess
import sys
import threading
from pathlib import Path

from ...errors import FileFormatError
from . import trial_child

# Seconds without a sign of life: a single look at an object takes milliseconds, on the slowest
# of shared disks seconds.
PATIENCE = 60.0
_HUNG = "libhdf5 does not come to an end"
_CRASHED = "libhdf5 crashes"


def check(path: Path) -> None:
    """Check that libhdf5 survives a look at all objects of a file.

    Raises
    ------
    FileFormatError
        If it crashes or hangs.
    """
    try:
        told = path.stat()
    except OSError:  # whoever opens it says so
        return
    trouble = _trouble(os.path.abspath(path), told.st_size, told.st_mtime_ns)
    if trouble:
        raise FileFormatError(
            f"{path}: expected an HDF5 file, but it is damaged: {trouble}; copy it again from "
            "where it comes from"
        )


@functools.lru_cache(maxsize=4096)
def _trouble(path: str, size: int, changed: int) -> str:
    return _LOOKER.look(path) if can_start_python() else ""


def can_start_python() -> bool:
    """Return False inside of a program (ParaView, Blender) that is not the interpreter."""
    return "py" in Path(sys.executable or "").name.lower() and not hasattr(sys, "frozen")


class Looker:
    """The process, and what it says."""

    def __init__(self, script: str = trial_child.__file__) -> None:
        self._script = script
        self._process: subprocess.Popen[bytes] | None = None
        self._owner = 0
        self._said: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        self._lock = threading.Lock()

    def look(self, path: str) -> str:
        """Return what became of libhdf5; empty if it is well."""
        with self._lock:
            try:
                process = self._running()
                assert process.stdin is not None
                process.stdin.write(json.dumps(path).encode() + b"\n")
                process.stdin.flush()
            except OSError:  # no process can be started here: go without
                self._process = None
                return ""
            return self._answer(process)

    def _running(self) -> subprocess.Popen[bytes]:
        # A fork of this process must not talk into its parent's pipe.
        if self._process is None or self._owner != os.getpid() or self._process.poll() is not None:
            self._owner, self._said = os.getpid(), queue.SimpleQueue()
            self._process = subprocess.Popen(
                [sys.executable, "-I", self._script, json.dumps(sys.path)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                # Else numpy starts a thread per core, for nothing.
                env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
            )
            heard = threading.Thread(target=_hear, args=(self._process, self._said), daemon=True)
            heard.start()
        return self._process

    def _answer(self, process: subprocess.Popen[bytes]) -> str:
        trouble = b""
        while True:
            try:
                said = self._said.get(timeout=PATIENCE)
            except queue.Empty:
                self._end(process)
                return _HUNG
            if said == b"\n":
                return trouble.decode().lstrip(".")
            if not said:
                self._end(process)
                return _ending(process.returncode)
            trouble += said

    def _end(self, process: subprocess.Popen[bytes]) -> None:
        process.kill()
        process.wait()
        self._process = None


def _ending(code: int) -> str:
    if code == 0:
        return ""
    return _HUNG if code == -getattr(signal, "SIGPROF", 0) else _CRASHED


def _hear(process: subprocess.Popen[bytes], said: queue.SimpleQueue[bytes]) -> None:
    assert process.stdout is not None
    with process.stdout as pipe:
        while byte := pipe.read(1):
            said.put(byte)
    said.put(b"")


_LOOKER = Looker()
