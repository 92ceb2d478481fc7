"""What writers of voxels ask of a volume, and give to the file."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import InputError
from ...units import parse_unit, plain
from ..cartesian import cartesian

if TYPE_CHECKING:
    from ...volume import Volume


@dataclass(frozen=True)
class Lattice:
    """Where the voxels of a file are, axes x, y, z: centre of the first, widths, unit vectors.

    Row a of `units` is the direction of axis a.
    """

    origin: np.ndarray
    widths: np.ndarray
    units: np.ndarray

    @property
    def steps(self) -> np.ndarray:
        """What leads from a voxel to the next, a row per axis."""
        return self.units * self.widths[:, None]


def single_field(volume: Volume, kind: str) -> str:
    """Return the name of the volume's only field.

    Raises
    ------
    InputError
        If there is another number of them.
    """
    if len(volume.fields) != 1:
        listed = ", ".join(volume.fields) or "none"
        raise InputError(
            f"{kind} holds one field, the volume has {listed}; choose one when it is opened: "
            "vm.open(path, 'name')"
        )
    return volume.fields[0]


def lattice(volume: Volume, unit: str = "") -> Lattice:
    """Return where the cells of a uniform Cartesian volume are, turned as they truly are.

    Parameters
    ----------
    volume : Volume
        Its ``meta["direction"]``, if there is one, is put back (see `Arrangement`).
    unit : str
        Unit of the result, if the volume's lengths have one; by default the volume's.

    Raises
    ------
    InputError
        If it is on another kind of grid, or the direction is no matrix.
    UnitsError
        If its coordinates are no lengths.
    """
    grid = cartesian(volume)
    if not grid.is_uniform:
        raise InputError(
            "this format holds cells of equal width only; resample the volume first: "
            "volume.resample(…)"
        )
    bounds = grid.bounds * _factor(grid.unit, unit)
    widths = np.ptp(bounds, axis=1) / grid.shape
    direction, middle = direction_of(volume), bounds.mean(axis=1)
    first = bounds[:, 0] + widths / 2
    if "direction" in volume.meta:  # else the numbers stay as they are, to the last digit
        first = middle + direction @ (first - middle)
    return Lattice(first, widths, direction.T)


def _factor(own: Any, unit: str) -> float:
    if not unit or own is None:
        return 1.0
    return float(plain(1.0 * own, parse_unit(unit), "the cell edges"))


def direction_of(volume: Volume) -> np.ndarray:
    """Return how the cells are turned: column a is the true unit vector along axis a.

    Raises
    ------
    InputError
        If ``meta["direction"]`` is no matrix.
    """
    direction = np.asarray(volume.meta.get("direction", np.eye(3)), float)
    if direction.shape != (3, 3):
        raise InputError(
            f"meta['direction'] must be a matrix of 3 x 3, got the shape {direction.shape}; "
            "delete it if the volume is not turned"
        )
    return direction


def slabs(values: np.ndarray) -> Iterator[bytes]:
    """Give the numbers of a field, little-endian, x fastest, a slice at a time."""
    stored = values.dtype.newbyteorder("<")
    for k in range(values.shape[2]):
        yield values[:, :, k].astype(stored, copy=False).tobytes(order="F")
