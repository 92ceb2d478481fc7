"""Optional packages: imported where used, with an error that says how to install them."""

from __future__ import annotations

import functools
import importlib
import importlib.metadata
import importlib.util
from collections.abc import Callable
from typing import Any

from .errors import MissingPackageError

# What rooms above add for lower ones to find by name, such as {"scheme": {"olson-kunasz": make}}:
# functions that make it when it is used (`radmc3d`).
REGISTERED: dict[str, dict[str, Callable[[], Any]]] = {"scheme": {}, "reader": {}, "tracer": {}}


@functools.cache
def version() -> str:
    """Return the installed version; setuptools-scm derives it from the tags of the repository."""
    try:
        return importlib.metadata.version("voluminous")
    except importlib.metadata.PackageNotFoundError:  # run from its sources
        return "0+unknown"


def require(module: str, extra: str, purpose: str) -> Any:
    """Return a module of an optional package, which an extra of voluminous installs.

    The purpose begins the error message: "reading NRRD files".
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        # A missing package needs no traceback; a broken one does.
        absent = isinstance(error, ModuleNotFoundError) and error.name == module.partition(".")[0]
        raise MissingPackageError(
            f"{purpose} needs the package {module.partition('.')[0]!r} ({error}); install it with\n"
            f"  {install_line(extra)}"
        ) from (None if absent else error)


def install_line(extra: str) -> str:
    """Return the command that installs the packages of an extra."""
    return (
        f'pip install "voluminous[{extra}]"  (in a clone of voluminous: pip install ".[{extra}]")'
    )


def is_installed(module: str) -> bool:
    """Return True if a module can be found; it is not imported."""
    return importlib.util.find_spec(module) is not None
