"""Where voxels are: from an origin and three steps to a grid along x, y and z.

Medical formats place an array of voxels by the centre of the first one and a step per axis of the
array, in patient coordinates. The grid's are **LPS**, as in DICOM and ITK: x to the patient's left,
y to the back (posterior), z to the head (superior). Files in RAS (NIfTI, some NRRD) are turned
about z: x and y change sign.

Steps along coordinate axes, in any order and sense, only mean that the array has to be transposed
and flipped. Oblique ones would need resampling, which blurs: the voxels keep their own axes, each
called after the coordinate it is nearest to, about the volume's true centre; how they are turned
is told besides (`Arrangement.direction`).
"""

from __future__ import annotations

import itertools
import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import FileFormatError
from ..edges import edges_of_centers

if TYPE_CHECKING:
    from ...grids import CartesianGrid

LPS = "LPS"
# What the file's coordinates are multiplied with to become LPS; "" is no patient's space.
SIGNS = {LPS: (1.0, 1.0, 1.0), "RAS": (-1.0, -1.0, 1.0), "LAS": (1.0, -1.0, 1.0), "": (1.0,) * 3}
# Voxels by which the farthest one may be off: directions are often written with six digits.
_TOLERANCE = 0.01
# Cosine between axes above which a warning is due: half a degree.
_SHEARED = 0.01


@dataclass(frozen=True)
class Placement:
    """Where the voxels of an array are.

    Attributes
    ----------
    origin : array_like, shape (3,)
        Centre of the first voxel.
    steps : array_like, shape (3, 3)
        ``steps[b]`` leads from a voxel to the next along axis b of the array.
    unit : str
        Of lengths; empty for none.
    space : str
        A key of `SIGNS`: which way the coordinates run in a patient.
    stations : array of float, shape (n,), optional
        Distances of the slices along axis 2 from the first, where they are not equally far apart;
        ``steps[2]`` is then their mean.
    """

    origin: Any
    steps: Any
    unit: str = ""
    space: str = ""
    stations: Any = None


@dataclass(frozen=True)
class Arrangement:
    """How an array of voxels is brought to a grid.

    Attributes
    ----------
    grid : CartesianGrid
        In LPS where the file tells.
    order : tuple of int
        The axes of the array that become x, y and z.
    backward : tuple of bool
        Which of x, y and z run against the array.
    direction : array, shape (3, 3), or None
        Column a is the true unit vector along the grid's axis a, if that is another: a point p of
        the grid, whose centre is c, truly is at c + direction @ (p - c).
    """

    grid: CartesianGrid
    order: tuple[int, ...]
    backward: tuple[bool, ...]
    direction: np.ndarray | None

    def put(self, values: np.ndarray) -> np.ndarray:
        """Return a view of an array in the file's order, (n0, n1, n2), in the grid's."""
        turned = values.transpose(self.order)
        return turned[tuple(slice(None, None, -1 if b else 1) for b in self.backward)]


def arranged(shape: tuple[int, ...], placement: Placement) -> Arrangement:
    """Return grid and order of an array of voxels.

    Raises
    ------
    FileFormatError
        If the steps are not finite, or do not span space.
    """
    from ...grids import CartesianGrid

    signs = np.array(SIGNS[placement.space])
    origin = np.asarray(placement.origin, float) * signs
    steps = np.asarray(placement.steps, float) * signs
    widths = _lengths(origin, steps)
    units = steps / widths[:, None]
    order = _nearest_axes(units)
    backward = tuple(bool(units[order[axis], axis] < 0) for axis in range(3))
    direction = np.where(backward, -1.0, 1.0) * units[list(order)].T
    counts = np.array(shape)[list(order)]
    oblique = _is_oblique(direction, counts * widths[list(order)], widths[list(order)])
    if oblique:
        _warn_of_shear(direction)
    middle = origin + (np.array(shape) - 1) / 2 @ steps
    edges = []
    for axis, (source, back) in enumerate(zip(order, backward, strict=True)):
        spread = placement.stations if source == 2 else None
        ticks = _edges(shape[source], widths[source], spread)
        ticks = -ticks[::-1] if back else ticks
        # Where it can be, the first voxel is exactly where the file says.
        start = middle[axis] - (ticks[0] + ticks[-1]) / 2 if oblique else origin[axis]
        edges.append(start + ticks)
    grid = CartesianGrid(*edges, unit=placement.unit)
    return Arrangement(grid, order, backward, direction if oblique else None)


def _lengths(origin: np.ndarray, steps: np.ndarray) -> np.ndarray:
    widths = np.linalg.norm(steps, axis=1)
    sound = np.all(np.isfinite(origin)) and np.all(np.isfinite(widths)) and np.all(widths > 0)
    if not sound or abs(np.linalg.det(steps / widths[:, None])) < _SHEARED:
        raise FileFormatError(
            f"expected steps between voxels that span space, got {steps.tolist()} from the "
            f"origin {origin.tolist()}"
        )
    return widths


def _nearest_axes(units: np.ndarray) -> tuple[int, ...]:
    def nearness(order: tuple[int, ...]) -> float:
        return float(sum(abs(units[source, axis]) for axis, source in enumerate(order)))

    # Rounding must not decide between axes that are equally near.
    return max(itertools.permutations(range(3)), key=lambda order: round(nearness(order), 6))


def _is_oblique(direction: np.ndarray, extents: np.ndarray, widths: np.ndarray) -> bool:
    off = np.abs(direction - np.eye(3)) * extents  # column a: how far the end of axis a is off
    return bool(np.any(off > _TOLERANCE * widths[:, None]))


def _warn_of_shear(direction: np.ndarray) -> None:
    cosines = direction.T @ direction - np.eye(3)
    if np.max(np.abs(cosines)) > _SHEARED:
        warnings.warn(
            "the voxels' axes are not at right angles (a tilted gantry?); they are drawn as if "
            "they were. Resample the data if shapes matter",
            stacklevel=2,
        )


def _edges(count: int, width: float, stations: Any) -> np.ndarray:
    if stations is None:
        return width * (np.arange(count + 1) - 0.5)
    return edges_of_centers(stations)
