"""Find an LLVM shared library that Dr.Jit can use, before Dr.Jit looks for one itself.

Left alone, Dr.Jit takes whatever the system carries. Of those that Debian 12 has, 14 is refused and
15 aborts the whole process inside the compiler, so an old one must never be picked silently.
"""

from __future__ import annotations

import contextlib
import functools
import importlib.metadata
import os
import re
import sys
from pathlib import Path

from .errors import DeviceError

OLDEST_LLVM = 16
VARIABLE = "DRJIT_LIBLLVM_PATH"
WHEEL = "karellen-llvm-core"

_SYSTEM_PATTERNS = {
    "linux": (
        "/usr/lib/*-linux-gnu/libLLVM*.so*",
        "/usr/lib/llvm-*/lib/libLLVM*.so*",
        "/usr/lib64/libLLVM*.so*",
        "/usr/lib/libLLVM*.so*",
    ),
    "darwin": (
        "/opt/homebrew/opt/llvm*/lib/libLLVM*.dylib",
        "/usr/local/opt/llvm*/lib/libLLVM*.dylib",
    ),
    "win32": ("C:/Program Files/LLVM/bin/LLVM-C.dll",),
}


@functools.cache
def ensure_llvm() -> None:
    """Point Dr.Jit to a usable LLVM library; call before the LLVM backend is first used."""
    chosen = os.environ.get(VARIABLE)
    if chosen:
        if not Path(chosen).exists():
            raise DeviceError(
                f"{VARIABLE} is set to {chosen!r}, which does not exist; "
                "correct it, or unset it to let voluminous find LLVM"
            )
        return
    library = _from_wheel() or _from_system()
    if library is None:
        raise DeviceError(
            f"no LLVM shared library (version {OLDEST_LLVM} or newer) was found. "
            f"On Linux x86-64: pip install {WHEEL}. On macOS: brew install llvm. "
            f"Elsewhere install LLVM and set {VARIABLE} to its shared library"
        )
    os.environ[VARIABLE] = str(library)


def find_llvm_early() -> None:
    """Find LLVM when voluminous is imported; no error, because a GPU may not need it."""
    with contextlib.suppress(DeviceError):
        ensure_llvm()


def _from_wheel() -> Path | None:
    try:
        files = importlib.metadata.files(WHEEL) or []
    except importlib.metadata.PackageNotFoundError:
        return None
    names = [f for f in files if re.match(r"(libLLVM.*\.(so|dylib)|LLVM-C.*\.dll)", f.name)]
    # Real file first: the plain name is a symbolic link made after installation.
    paths = (Path(str(f.locate())).resolve() for f in sorted(names, key=lambda f: -len(f.name)))
    return next((path for path in paths if path.exists()), None)


def _from_system() -> Path | None:
    libraries: list[tuple[int, Path]] = []
    for pattern in _SYSTEM_PATTERNS.get(sys.platform, ()):
        root = Path(pattern).anchor
        libraries += [(_version_in(p), p) for p in Path(root).glob(pattern[len(root) :])]
    version, path = max(libraries, default=(0, None))
    return path if version >= OLDEST_LLVM else None


def _version_in(path: Path) -> int:
    """Return the major version in a path such as ``libLLVM-19.so`` or ``llvm-19/lib/…``."""
    patterns = r"LLVM-(\d+)", r"libLLVM\.so\.(\d+)", r"llvm[-@](\d+)", r"llvm/(\d+)\."
    matches = (re.search(pattern, str(path.resolve())) for pattern in patterns)
    return next((int(match[1]) for match in matches if match), 0)
