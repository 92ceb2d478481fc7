"""Where the cells of VTK's structured data are.

VTK has values at points and in the cells between them. Cells here are those in both cases: for
values at points, cells around these, whose walls lie midway. Interpolated schemes then draw what
VTK draws, since the field between two centres is linear there as it is between two points.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...errors import FileFormatError, InputError
from ...memory import check_memory
from ..edges import edges_of_centers, is_even
from ..scanners.placement import Arrangement, Placement, arranged

UPRIGHT = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
# Of single precision, as a fraction of the coordinates.
_ROUNDING = 1e-6
ADVICE = "; give resolution=64 (cells along the longest side) to resample it to equal cells"
# Bytes that walls take while they are made, and walks through them.
_PER_POINT = 64


@dataclass(frozen=True)
class Even:
    """Where image data are: what `even_arrangement` asks for."""

    origin: Any
    spacing: Any
    direction: Any
    low: tuple[int, ...]
    points: tuple[int, ...]

    def __call__(self, at: str, unit: Any) -> Arrangement:
        """Return where the cells are."""
        return even_arrangement(
            self.origin, self.spacing, self.direction, self.low, self.points, at, unit
        )


@dataclass(frozen=True)
class Uneven:
    """Where a rectilinear grid is: coordinates along x, y and z."""

    lines: tuple[np.ndarray, ...]

    def __call__(self, at: str, unit: Any) -> Arrangement:
        """Return where the cells are."""
        return uneven_arrangement(self.lines, at, unit)


def even_arrangement(
    origin: Any, spacing: Any, direction: Any, low: Any, points: Any, at: str, unit: Any = ""
) -> Arrangement:
    """Return where the cells of image data are.

    Parameters
    ----------
    origin, spacing : three float
        Where the point of index (0, 0, 0) is, and the steps along each index.
    direction : nine float
        Row by row: columns are the directions along which the indices count.
    low : three int
        The first index along each.
    points : three int
        Number of points.
    at : str
        ``"point"`` for cells around the points, ``"cell"`` for those between.
    unit : str or unit
        Of lengths.
    """
    counts = np.asarray(points)
    check_memory(_PER_POINT * int(counts.sum()), "the walls of the cells", "is the file damaged?")
    widths = np.asarray(spacing, float)
    widths = np.where((widths == 0) & (counts == 1), 1.0, widths)
    steps = np.asarray(direction, float).reshape(3, 3).T * widths[:, None]
    first = np.asarray(origin, float) + np.asarray(low) @ steps
    if at == "cell":  # a single layer of points is a layer of cells
        first = first + 0.5 * (counts > 1) @ steps
    return arranged(cell_counts(points, at), Placement(first, steps, unit))


def uneven_arrangement(coordinates: Any, at: str, unit: Any = "") -> Arrangement:
    """Return where the cells of a rectilinear grid are.

    Parameters
    ----------
    coordinates : three arrays
        Of the points along x, y and z; increasing or decreasing.
    at, unit
        As for image data.

    Raises
    ------
    FileFormatError
        If coordinates neither increase nor decrease.
    """
    from ...grids import CartesianGrid

    lines = [np.asarray(line, np.float64) for line in coordinates]
    for name, line in zip("xyz", lines, strict=True):
        _check_line(name, line)
    backward = tuple(bool(line[0] > line[-1]) for line in lines)
    lines = [line[::-1] if down else line for line, down in zip(lines, backward, strict=True)]
    widths = [(line[-1] - line[0]) / (len(line) - 1) for line in lines if len(line) > 1]
    # A single layer is as thick as cells are wide along the other axes.
    width = float(np.mean(widths)) if widths else 1.0
    grid = CartesianGrid(*(_edges(line, at, width) for line in lines), unit=unit)
    return Arrangement(grid, (0, 1, 2), backward, None)


def aligned_lines(points: np.ndarray) -> list[np.ndarray]:
    """Return the coordinates of a structured grid whose points lie on planes of x, y and z.

    Parameters
    ----------
    points : array, shape (nz, ny, nx, 3)
        Where the points are.

    Raises
    ------
    InputError
        If it is curved or oblique.
    """
    lines = [points[0, 0, :, 0], points[0, :, 0, 1], points[:, 0, 0, 2]]
    for k, line in enumerate(lines):
        planes = line.reshape([-1 if axis == 2 - k else 1 for axis in range(3)])
        rounding = _ROUNDING * float(np.max(np.abs(line)))
        if not np.all(np.abs(points[..., k] - planes) <= rounding):
            raise InputError(
                f"a structured grid whose points do not lie on planes of constant {'xyz'[k]} is "
                f"curved or oblique{ADVICE}"
            )
    return lines


def cell_counts(points: Any, at: str) -> tuple[int, ...]:
    """Return the number of cells around points, or between them."""
    return tuple(max(int(n) - 1, 1) if at == "cell" else int(n) for n in points)


def _check_line(name: str, line: np.ndarray) -> None:
    steps = np.diff(line)
    if not (np.isfinite(line).all() and ((steps > 0).all() or (steps < 0).all())):
        raise FileFormatError(
            f"expected finite {name} coordinates that increase, or decrease, from point to point, "
            f"got {np.array2string(line, threshold=6)}"
        )


def _edges(line: np.ndarray, at: str, width: float) -> np.ndarray:
    """Return the walls of the cells around ascending points, or between them."""
    if len(line) == 1:
        return line[0] + np.array([-0.5, 0.5]) * width
    if at == "point":
        return edges_of_centers(line)
    # A grid of equal cells is faster, and files round coordinates.
    return np.linspace(line[0], line[-1], len(line)) if is_even(line) else line
