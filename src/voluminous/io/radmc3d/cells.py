"""A grid from a file, with what puts values in the order of the file into that of the grid."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...units import parse_unit

if TYPE_CHECKING:
    from ...grids import CartesianGrid, OctreeGrid, PatchGrid, SphericalGrid


@dataclass(frozen=True)
class Cells:
    """A grid, and how values in a file's order become a field.

    `arranged` returns what `Volume` takes: an array, or one array per patch. `in_order` is True if
    nothing need be moved.
    """

    grid: CartesianGrid | OctreeGrid | PatchGrid | SphericalGrid
    arranged: Callable[[NDArray[Any]], Any]
    in_order: bool = False


def converted(lengths: NDArray[np.float64], unit: Any) -> NDArray[np.float64]:
    """Return lengths in cm in another unit; those in cm keep all their bits."""
    if unit is None or parse_unit(unit) == parse_unit("cm"):
        return lengths
    from astropy import units as u

    from ...units import plain

    in_unit: NDArray[np.float64] = plain(lengths * u.cm, parse_unit(unit), "the walls")
    return in_unit


def shaped(shape: tuple[int, ...]) -> Callable[[NDArray[Any]], NDArray[Any]]:
    """Return what makes an array [i1, i2, i3] of values of which the first index is fastest."""

    def arranged(values: NDArray[Any]) -> NDArray[Any]:
        found = values.reshape(shape[::-1])
        array = np.empty(shape, values.dtype.newbyteorder("="))
        for j in range(shape[1]):  # a third of the time of transposing the whole
            array[:, j] = found[:, j].T
        return array

    return arranged


def as_they_are(values: NDArray[Any]) -> NDArray[Any]:
    """Return values of which the order is that of the grid."""
    return values
