"""What formats for Cartesian volumes ask of a volume that is to be written."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..errors import InputError

if TYPE_CHECKING:
    from ..grids import CartesianGrid
    from ..volume import Volume


def cartesian(volume: Volume) -> CartesianGrid:
    """Return the volume's grid.

    Raises
    ------
    InputError
        If it is of another kind.
    """
    if not volume.grid.is_rectilinear:
        raise InputError(
            f"this format holds Cartesian grids only, got {type(volume.grid).__name__}; save it as "
            ".h5, or resample it first (volume.resample, voluminous convert --resample)"
        )
    grid: CartesianGrid = volume.grid
    return grid
