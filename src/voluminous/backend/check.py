"""Which LLVM Dr.Jit has loaded, and whether it can be trusted."""

from __future__ import annotations

import os

from ..errors import DeviceError
from ..llvm import OLDEST_LLVM, VARIABLE, WHEEL
from .jit import dr


def check_llvm() -> None:
    """Refuse an LLVM too old to be trusted; call once the LLVM backend is loaded."""
    version = llvm_version()
    if version is None:
        raise DeviceError(
            f"Dr.Jit could not load the LLVM library {os.environ.get(VARIABLE)!r}; "
            f"install another one, or set {VARIABLE}"
        )
    if version[0] < OLDEST_LLVM:
        name = ".".join(map(str, version))
        raise DeviceError(
            f"Dr.Jit loaded LLVM {name}, which is too old (it miscompiles or aborts); version "
            f"{OLDEST_LLVM} or newer is needed: set {VARIABLE} to it, or pip install {WHEEL} and "
            "import voluminous before drjit"
        )


def llvm_version() -> tuple[int, int, int] | None:
    """Return the version of the LLVM that Dr.Jit uses, or None if it cannot be loaded."""
    if not dr.has_backend(dr.JitBackend.LLVM):
        return None
    major, minor, patch = dr.detail.llvm_version()
    return major, minor, patch
