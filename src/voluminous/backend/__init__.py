"""The only door to Dr.Jit: device, precision, finding LLVM, and the arithmetic kernels need."""

from ..llvm import ensure_llvm
from .check import llvm_version
from .device import Backend, available_devices, get_backend
from .host import aligned, from_host
from .jit import dr
from .twins import clone_inputs, copy_into
from .types import Float, Int, Mask

__all__ = [
    "Backend",
    "Float",
    "Int",
    "Mask",
    "aligned",
    "available_devices",
    "clone_inputs",
    "copy_into",
    "dr",
    "ensure_llvm",
    "from_host",
    "get_backend",
    "llvm_version",
]
