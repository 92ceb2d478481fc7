"""Points that users give: as plain numbers in a grid's unit."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import InputError
from ..units import plain


def plain_points(points: Any, unit: Any) -> np.ndarray:
    """Return points as float64, shape (n, 3), in a grid's unit; plain numbers are in it already.

    Raises
    ------
    InputError
        If they have another shape.
    UnitsError
        If they are no numbers, or have a unit that cannot be converted.
    """
    array = np.asarray(plain(points, unit, "points"))
    if array.ndim != 2 or array.shape[1] != 3:
        raise InputError(
            f"points must have shape (n, 3), one row of x, y and z for each, got {array.shape}"
            + ("; give [[x, y, z]] for one point" if array.shape == (3,) else "")
            + ("; transpose them" if array.ndim == 2 and array.shape[0] == 3 else "")
        )
    return array
