"""Volumes from files and to files: one format per file, found through one registry.

`open` and `Volume.save` are all that most people need; `io.contract` is what a new format has to
provide.
"""

from typing import Any

from .contract import FieldInfo, Reader
from .labelled.convert import from_xarray
from .registry import find_reader, open, readers

__all__ = ["FieldInfo", "Reader", "find_reader", "from_xarray", "open", "readers"]


def __getattr__(name: str) -> Any:
    if name == "save":
        raise AttributeError("voluminous.io.save(volume, path) is now volume.save(path)")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
