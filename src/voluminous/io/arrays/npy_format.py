"""The head of NumPy's array format: shape and type, known before anything is read."""

from __future__ import annotations

from typing import IO, Any

import numpy as np

from ...errors import FileFormatError

MAGIC = b"\x93NUMPY"


def header(file: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Return shape, Fortran order and type of the array at the beginning of a file.

    Raises
    ------
    FileFormatError
        If it is of a version that is not known.
    """
    version = np.lib.format.read_magic(file)
    if version == (1, 0):
        return np.lib.format.read_array_header_1_0(file)
    if version == (2, 0):
        return np.lib.format.read_array_header_2_0(file)
    raise FileFormatError(f"expected NumPy's array format 1.0 or 2.0, got {version}")
