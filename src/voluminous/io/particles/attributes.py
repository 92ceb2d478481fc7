"""Numbers among the attributes of HDF5 files."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...errors import FileFormatError


def number(attributes: Any, *names: str) -> float | None:
    """Return the first attribute there is, one finite number; None if there is none."""
    for name in names:
        if name in attributes:
            values = np.ravel(attributes[name])
            if values.size != 1 or values.dtype.kind not in "fiub" or not np.isfinite(values[0]):
                raise FileFormatError(f"{name} must be a number, got {attributes[name]!r}")
            return float(values[0])
    return None
