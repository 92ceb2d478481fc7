"""Imports Dr.Jit after locating LLVM, which the import loads."""

from __future__ import annotations

from ..errors import DeviceError
from ..llvm import ensure_llvm
from ..memory import LOADING, check_limits

# The reason why the CPU cannot be used, if any; a GPU may not need LLVM.
missing_llvm: DeviceError | None = None
try:
    ensure_llvm()
except DeviceError as error:
    missing_llvm = error

# Without that Dr.Jit ends the process, in several ways.
check_limits(LOADING, "loading Dr.Jit and LLVM")
import drjit as dr  # noqa: E402

__all__ = ["dr", "missing_llvm"]
