"""HDF5 files are opened here, after another process has looked at them: libhdf5 can crash.

A few in a thousand damaged files make the library read memory that is not its own, or search
forever; no error can be caught then, and what the user has in memory is lost. So a process of its
own goes through the file first (`trial`), and only a file that it survives is opened.
"""

from .access import MAGIC, filters, holds, is_hdf5, opened
from .data_sets import check_place, data_set, data_sets, is_own, read, text
from .trial import check

__all__ = [
    "MAGIC",
    "check",
    "check_place",
    "data_set",
    "data_sets",
    "filters",
    "holds",
    "is_hdf5",
    "is_own",
    "opened",
    "read",
    "text",
]
