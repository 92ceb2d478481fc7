"""The only door to Dr.Jit: device, precision, finding LLVM, and the arithmetic kernels need."""

from ..llvm import ensure_llvm
from .check import llvm_version
from .device import Backend, available_devices, get_backend
from .jit import dr

__all__ = ["Backend", "available_devices", "dr", "ensure_llvm", "get_backend", "llvm_version"]
