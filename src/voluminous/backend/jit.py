"""Dr.Jit, imported after LLVM is located, which the import loads; its arrays from NumPy."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import DeviceError
from ..llvm import ensure_llvm
from ..memory import LOADING, check_limits

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

# The reason why the CPU cannot be used, if any; a GPU may not need LLVM.
missing_llvm: DeviceError | None = None
try:
    ensure_llvm()
except DeviceError as error:
    missing_llvm = error

# Without that Dr.Jit ends the process, in several ways.
check_limits(LOADING, "loading Dr.Jit and LLVM")
import drjit as dr  # noqa: E402

__all__ = ["aligned", "clone_inputs", "copy_into", "dr", "from_host", "missing_llvm"]


# Vectors are loaded from addresses that are multiples of this many bytes.
_ALIGNMENT = 128


def from_host(kind: Any, values: ArrayLike) -> Any:
    """Return numbers as a device array.

    Dr.Jit uses NumPy's memory in place, and compiles into a kernel whether vectors in it are
    aligned. For most arrays this is random: each case compiled a separate kernel, in 100 to
    2000 ms, and adjacent numbers were gathered together only if they happened to be aligned.
    """
    dtype = np.dtype(dr.type_v(kind).name.lower())
    return kind(aligned(np.ascontiguousarray(values, dtype)))


def aligned(values: np.ndarray) -> np.ndarray:
    """Return contiguous numbers at an aligned address: a copy, unless they are aligned already.

    Dr.Jit always loads whole vectors: from unaligned memory it reads up to 120 bytes beyond the
    end, and if no page follows there, the process is killed. A vector at an aligned address does
    not extend into another page.
    """
    if values.__array_interface__["data"][0] % _ALIGNMENT == 0:
        return values
    room = np.empty(values.nbytes + _ALIGNMENT, np.uint8)
    first = -room.__array_interface__["data"][0] % _ALIGNMENT
    copy: np.ndarray = room[first : first + values.nbytes].view(values.dtype).reshape(values.shape)
    copy[...] = values
    return copy


def clone_inputs(tree: Any) -> Any:
    """Return a copy of arrays, in lists, tuples and dataclasses, in separate memory.

    CPU only: there NumPy can access the memory that kernels read.
    """
    if isinstance(tree, dr.ArrayBase):
        copy = dr.empty(type(tree), len(tree))
        copy_into(copy, tree)
        return copy
    parts = _parts(tree)
    copies = {key: clone_inputs(part) for key, part in parts.items()}
    if dataclasses.is_dataclass(tree) and not isinstance(tree, type):
        return dataclasses.replace(tree, **copies)
    return type(tree)(copies.values()) if parts else tree


def copy_into(copy: Any, tree: Any) -> None:
    """Copy the numbers of arrays into the result of `clone_inputs` for similar arrays.

    No kernel that reads it may be running.
    """
    if isinstance(tree, dr.ArrayBase):
        # Views, in a fifth of the time that `numpy.asarray` takes.
        copy.numpy()[...] = tree.numpy()
        return
    old = _parts(copy)
    for key, part in _parts(tree).items():
        copy_into(old[key], part)


def _parts(tree: Any) -> dict[Any, Any]:
    if isinstance(tree, (list, tuple)):
        return dict(enumerate(tree))
    if dataclasses.is_dataclass(tree):
        return {f.name: getattr(tree, f.name) for f in dataclasses.fields(tree)}
    return {}
