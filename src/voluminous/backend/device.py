"""Devices and precisions: the array types of kernels, and the LLVM version they need."""

from __future__ import annotations

import functools
import importlib
import os
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import DeviceError, InputError, check_name
from ..llvm import OLDEST_LLVM, VARIABLE, WHEEL
from ..memory import KERNELS, check_limits
from .jit import dr, missing_llvm


def llvm_version() -> tuple[int, int, int] | None:
    """Return the version of the LLVM that Dr.Jit uses, or None if it cannot be loaded."""
    if not dr.has_backend(dr.JitBackend.LLVM):
        return None
    major, minor, patch = dr.detail.llvm_version()
    return major, minor, patch


PRECISIONS = ("single", "double")
DEVICES = {"cpu": "llvm", "cuda": "cuda", "metal": "metal"}


@dataclass(frozen=True, eq=False)
class Backend:
    """The array types of one device in one precision, of which there is one; part of cache keys.

    Attributes
    ----------
    Float, Int, UInt, Bool : type
        Dr.Jit arrays that kernels compute with.
    Wide : type
        Double precision where the device has it. It is used for work done once per ray or once per
        cell, so that single precision costs digits only where it saves time.
    derivatives : bool
        The arrays record operations, so that results can be differentiated.
    """

    device: str
    precision: str
    Float: Any
    Wide: Any
    Int: Any
    UInt: Any
    Bool: Any
    module: Any
    derivatives: bool = False

    def __reduce__(self) -> Any:
        return get_backend, (self.device, self.precision, self.derivatives)

    def with_precision(self, precision: str) -> Backend:
        """Return the backend of another precision, otherwise the same."""
        return get_backend(self.device, precision, self.derivatives)

    @property
    def dtype(self) -> np.dtype[Any]:
        """NumPy type of `Float`."""
        return np.dtype(np.float32 if self.precision == "single" else np.float64)

    @property
    def tiny(self) -> float:
        """Smallest normal number of `Float`: smaller ones are clamped to zero."""
        return float(np.finfo(self.dtype).tiny)

    def packet(self, width: int) -> Any:
        """Return the type of `width` neighbouring values gathered at once (1, 2 or 4)."""
        suffix = "f" if self.precision == "single" else "f64"
        return self.Float if width == 1 else getattr(self.module, f"Array{width}{suffix}")

    def quotient(self, numerator: Any, denominator: Any) -> Any:
        """Return numerator // denominator of non-negative 32-bit integers.

        CPUs have no vector instruction for it; in double precision the half keeps it exact.
        """
        if self.device != "cpu":
            return numerator // denominator
        return self.UInt((self.Wide(numerator) + 0.5) / self.Wide(denominator))

    def opaque(self, value: float) -> Any:
        """Return a number as run-time data, so that a change compiles no other kernel."""
        return dr.opaque(self.Float, value)

    def wide(self, value: float) -> Any:
        """Return a number as run-time data in `Wide` precision."""
        return dr.opaque(self.Wide, value)


def get_backend(
    device: str = "auto", precision: str = "single", derivatives: bool = False
) -> Backend:
    """Return the backend for a device and a precision.

    ``"auto"`` is a GPU where there is one that has the precision, else the CPU.

    Raises
    ------
    MemoryNeededError
        If there is no room for a kernel: Dr.Jit would end the process.
    """
    check_name("precision", precision, PRECISIONS)
    check_name("device", device, ("auto", *DEVICES))
    if device == "auto":
        gpu = "cuda" if _has("cuda") else "metal"
        usable = _has(gpu) and (gpu == "cuda" or precision == "single")
        device = gpu if usable else "cpu"
    check_limits(KERNELS, "compiling and running kernels")
    return _backend(device, precision, derivatives)


@functools.cache
def _backend(device: str, precision: str, derivatives: bool) -> Backend:
    if device == "cpu":
        _check_llvm()
    elif not _has(device):
        raise DeviceError(
            f"device {device!r} is not available here; "
            f"available: {', '.join(available_devices())}. Use device='auto'"
        )
    if device == "metal" and precision == "double":
        raise InputError("Metal GPUs have no double precision; use precision='single' or 'cpu'")
    suffix = ".ad" if derivatives else ""
    module = importlib.import_module(f"drjit.{DEVICES[device]}{suffix}")
    real = module.Float32 if precision == "single" else module.Float64
    return Backend(
        device=device,
        precision=precision,
        Float=real,
        Wide=module.Float32 if device == "metal" else module.Float64,
        Int=module.Int,
        UInt=module.UInt,
        Bool=module.Bool,
        module=module,
        derivatives=derivatives,
    )


def _check_llvm() -> None:
    if missing_llvm is not None:
        raise missing_llvm
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


def available_devices() -> tuple[str, ...]:
    """Return the names of the devices that work here."""
    return tuple(name for name in DEVICES if _has(name))


@functools.cache
def _has(device: str) -> bool:
    kind = getattr(dr.JitBackend, DEVICES[device].upper(), None)
    return kind is not None and bool(dr.has_backend(kind))
