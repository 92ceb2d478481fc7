"""Import Dr.Jit, once LLVM is found: importing it loads LLVM."""

from __future__ import annotations

from ..errors import DeviceError
from ..llvm import ensure_llvm

# Why the CPU cannot be used, if it cannot; a GPU may do without LLVM.
missing_llvm: DeviceError | None = None
try:
    ensure_llvm()
except DeviceError as error:
    missing_llvm = error

import drjit as dr  # noqa: E402

__all__ = ["dr", "missing_llvm"]
