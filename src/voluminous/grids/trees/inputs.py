"""What users give to make refined grids, as arrays."""

from __future__ import annotations

import reprlib
from typing import Any

import numpy as np

from ...errors import InputError


def as_array(values: Any, name: str, dtype: Any = None) -> np.ndarray:
    """Return values as an array.

    Raises
    ------
    InputError
        If rows are of different lengths, or values are no numbers where `dtype` wants some.
    """
    try:
        return np.asarray(values, dtype=dtype)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"{name} must be an array of numbers, all rows equally long, got {reprlib.repr(values)}"
        ) from error
