"""All access to Dr.Jit: device, precision, locating LLVM, and the arithmetic that kernels need."""

from ..llvm import ensure_llvm
from .device import Backend, available_devices, get_backend, llvm_version
from .jit import aligned, clone_inputs, copy_into, dr, from_host
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
