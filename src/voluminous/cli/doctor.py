"""Check that everything voluminous needs works here, and say what to do if not."""

from __future__ import annotations

import argparse
import importlib.metadata
import math
import os
import platform
import re
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from ..errors import DeviceError, MissingPackageError, VoluminousError

# Every scheme is exact for a slab of constant coefficients, so only rounding errors remain.
_TOLERANCE = {"single": 1e-6, "double": 1e-13}
_EMISSIVITY, _EXTINCTION, _THICKNESS = 2.0, 0.7, 1.5
_CACHE_VARIABLE = "DRJIT_CACHE_DIR"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command: there are none."""


def run(args: argparse.Namespace) -> int:
    """Print the results of the checks; return 1 if one fails."""
    failed = []
    for name, check in CHECKS.items():
        title = name
        try:
            for line in check():
                print(f"{title:9} {line}", flush=True)
                title = ""
        except Exception as error:  # a failure must not stop the other checks
            kind = "" if isinstance(error, VoluminousError) else f"{type(error).__name__}: "
            print(f"{title:9} WRONG: {kind}{error}", flush=True)
            failed.append(name)
    if failed:
        print(f"\nWrong: {', '.join(failed)}. The lines above say what to do.")
        return 1
    print("\nAll is well. Next: voluminous demo")
    return 0


def _system() -> Iterator[str]:
    import psutil

    yield f"Python {platform.python_version()}, {platform.platform()}"
    yield sys.executable
    memory = psutil.virtual_memory()
    yield f"memory {memory.available / 2**30:.1f} GiB free of {memory.total / 2**30:.1f} GiB"


def _packages() -> Iterator[str]:
    distribution = importlib.metadata.distribution("voluminous")
    yield f"voluminous {distribution.version}"
    for requirement, _, marker in (line.partition(";") for line in distribution.requires or []):
        if "extra ==" in marker:
            continue
        name, _, least = requirement.strip().partition(">=")
        try:
            version = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            if marker:  # it may be for other systems
                continue
            raise MissingPackageError(f"{name} is missing: pip install '{requirement}'") from None
        if _numbers(version) < _numbers(least):
            raise MissingPackageError(
                f"{name} {version} is too old: pip install --upgrade '{requirement}'"
            )
        yield f"{name} {version}"


def _numbers(version: str) -> list[int]:
    release = re.split(r"[^\d.]", version)[0].rstrip(".")
    return [int(number) for number in release.split(".")]


def _llvm() -> Iterator[str]:
    from ..llvm import VARIABLE, ensure_llvm

    ensure_llvm()
    yield os.environ[VARIABLE]
    from ..backend import get_backend, llvm_version

    get_backend("cpu")
    yield f"LLVM {'.'.join(map(str, llvm_version() or ()))}"


def _devices() -> Iterator[str]:
    from ..backend import available_devices, dr

    devices = available_devices()
    if not devices:
        raise DeviceError("no device works; see the line on LLVM")
    yield f"{', '.join(devices)}; {dr.thread_count()} threads, {os.cpu_count()} CPUs"


def _cache() -> Iterator[str]:
    usual = tempfile.gettempdir() + "/drjit" if sys.platform == "win32" else "~/.drjit"
    folder = Path(os.environ.get(_CACHE_VARIABLE) or usual).expanduser()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise DeviceError(
            f"compiled kernels cannot be kept in {folder} ({error.strerror}), so every process "
            f"compiles again: set {_CACHE_VARIABLE} to a directory you may write to"
        ) from error
    yield str(folder)


def _rays() -> Iterator[str]:
    """Yield the deviation of rays through a slab from j/α (1 - exp(-α L)), for all devices."""
    from ..backend import available_devices
    from ..cameras import Orthographic
    from ..drawing import render
    from ..media import Coefficients
    from ..models import uniform_slab
    from ..schemes import SCHEMES

    slab, medium = uniform_slab(_EMISSIVITY, _EXTINCTION, _THICKNESS), Coefficients("j", "a")
    camera = Orthographic(width=0.5, resolution=1)
    expected = _EMISSIVITY / _EXTINCTION * -math.expm1(-_EXTINCTION * _THICKNESS)
    for device in available_devices():
        for precision, tolerance in _TOLERANCE.items():
            if (device, precision) == ("metal", "double"):
                continue
            images = (
                render(slab, medium, camera, scheme=scheme, precision=precision, device=device)
                for scheme in SCHEMES
            )
            error = max(abs(image.intensity.item() / expected - 1.0) for image in images)
            if not error <= tolerance:
                raise DeviceError(
                    f"rays on {device!r} in {precision} precision are off by {error:.1e}, more "
                    f"than {tolerance:.0e}: another LLVM (or driver) may help; please report this"
                )
            yield f"{device}, {precision} precision: right to {error:.0e} (slab, all schemes)"


CHECKS: dict[str, Callable[[], Iterator[str]]] = {
    "system": _system,
    "packages": _packages,
    "LLVM": _llvm,
    "devices": _devices,
    "cache": _cache,
    "rays": _rays,
}
"""The checks, in this order; each yields lines, and raises if something is wrong."""
