"""Volumes from files and to files: one format per file, found through one registry.

`open` and `save` are all that most people need; `io.contract` is what a new format has to provide.
"""

from .contract import FieldInfo, Reader
from .labelled.convert import from_xarray
from .registry import find_reader, open, readers
from .saving import save

__all__ = ["FieldInfo", "Reader", "find_reader", "from_xarray", "open", "readers", "save"]
