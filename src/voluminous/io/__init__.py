"""Reading and writing of volumes: one module per file format, selected through one registry.

`open` and `Volume.save` suffice for most uses; `io.contract` defines what a new format must
provide.
"""

from .contract import FieldInfo, Reader
from .labelled.convert import from_xarray
from .registry import find_reader, open, readers

__all__ = ["FieldInfo", "Reader", "find_reader", "from_xarray", "open", "readers"]
