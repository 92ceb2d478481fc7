"""Where voxels are: from an origin and three steps to a grid along x, y and z, and back.

Medical formats place an array of voxels by the centre of the first one and a step per axis of the
array, in patient coordinates. The grid's are **LPS**, as in DICOM and ITK: x to the patient's left,
y to the back (posterior), z to the head (superior). Files in RAS (NIfTI, some NRRD) are turned
about z: x and y change sign.

Steps along coordinate axes, in any order and sense, only mean that the array has to be transposed
and flipped. Oblique ones would need resampling, which blurs: the voxels keep their own axes, each
called after the coordinate it is nearest to, about the volume's true centre; how they are turned
is in `Arrangement.direction`.
"""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import FileFormatError, InputError
from ...grids.cartesian.grid import CartesianGrid
from ...units import parse_unit, plain
from ..arrays.layout import equal_cells
from ..axes import cartesian, edges_of_centers
from ..units import known_unit

if TYPE_CHECKING:
    from ...grids import CartesianGrid
    from ...volume import Volume

LPS = "LPS"
# What the file's coordinates are multiplied with to become LPS; "" is no patient's space.
SIGNS = {LPS: (1.0, 1.0, 1.0), "RAS": (-1.0, -1.0, 1.0), "LAS": (1.0, -1.0, 1.0), "": (1.0,) * 3}
# Voxels by which the farthest one may be off: directions are often written with six digits.
_TOLERANCE = 0.01
# Cosine between axes above which a warning is due: half a degree.
_SHEARED = 0.01
_INCH = "25.4 mm"


@dataclass(frozen=True)
class Placement:
    """Where the voxels of an array are."""

    origin: Any  # centre of the first voxel
    steps: Any  # ``steps[b]`` leads from a voxel to the next along axis b of the array
    unit: str = ""
    space: str = ""  # a key of `SIGNS`: which way the coordinates run in a patient
    # Distances of the slices along axis 2 from the first, where they are not equally far apart;
    # ``steps[2]`` is then their mean.
    stations: Any = None


@dataclass(frozen=True)
class Arrangement:
    """How an array of voxels is brought to a grid."""

    grid: CartesianGrid
    order: tuple[int, ...]  # the axes of the array that become x, y and z
    backward: tuple[bool, ...]  # which of x, y and z run against the array
    # Column a is the true unit vector along the grid's axis a, if that is another: a point p of
    # the grid, whose centre is c, truly is at c + direction @ (p - c).
    direction: np.ndarray | None

    def put(self, values: np.ndarray) -> np.ndarray:
        """Return a view of an array in the file's order, (n0, n1, n2), in the grid's."""
        turned = values.transpose(self.order)
        return np.asarray(turned[tuple(slice(None, None, -1 if b else 1) for b in self.backward)])


def arranged(shape: tuple[int, ...], placement: Placement) -> Arrangement:
    """Return grid and order of an array of voxels."""
    from ...grids import CartesianGrid

    signs = np.array(SIGNS[placement.space])
    origin = np.asarray(placement.origin, float) * signs
    steps = np.asarray(placement.steps, float) * signs
    widths = np.linalg.norm(steps, axis=1)
    sound = np.all(np.isfinite(origin)) and np.all(np.isfinite(widths)) and np.all(widths > 0)
    if not sound or abs(np.linalg.det(steps / widths[:, None])) < _SHEARED:
        raise FileFormatError(
            f"expected steps between voxels that span space, got {steps.tolist()} from the "
            f"origin {origin.tolist()}"
        )
    units = steps / widths[:, None]

    def nearness(order: tuple[int, ...]) -> float:
        # Rounding must not decide between axes that are equally near.
        return round(float(sum(abs(units[source, a]) for a, source in enumerate(order))), 6)

    order = max(itertools.permutations(range(3)), key=nearness)
    backward = tuple(bool(units[order[axis], axis] < 0) for axis in range(3))
    direction = np.where(backward, -1.0, 1.0) * units[list(order)].T
    extents = np.array(shape)[list(order)] * widths[list(order)]
    # Column a: how far the end of axis a is off.
    off = np.abs(direction - np.eye(3)) * extents
    oblique = bool(np.any(off > _TOLERANCE * widths[list(order)][:, None]))
    if oblique and np.max(np.abs(direction.T @ direction - np.eye(3))) > _SHEARED:
        warnings.warn(
            "the voxels' axes are not at right angles (a tilted gantry?); they are drawn as if "
            "they were. Resample the data if shapes matter",
            stacklevel=2,
        )
    middle = origin + (np.array(shape) - 1) / 2 @ steps
    edges = []
    for axis, (source, back) in enumerate(zip(order, backward, strict=True)):
        ticks = widths[source] * (np.arange(shape[source] + 1) - 0.5)
        if source == 2 and placement.stations is not None:
            ticks = edges_of_centers(placement.stations)
        ticks = -ticks[::-1] if back else ticks
        # Where it can be, the first voxel is exactly where the file says.
        start = middle[axis] - (ticks[0] + ticks[-1]) / 2 if oblique else origin[axis]
        edges.append(start + ticks)
    grid = CartesianGrid(*edges, unit=placement.unit)
    return Arrangement(grid, order, backward, direction if oblique else None)


def equal_voxels(shape: tuple[int, ...], spacing: Any, unit: Any, bounds: Any = None) -> Placement:
    """Return the placement of voxels that begin at 0, or fill bounds, as other arrays do."""
    grid = equal_cells(shape, {"spacing": spacing, "bounds": bounds}, unit)
    widths = np.ptp(grid.bounds, axis=1) / grid.shape
    return Placement(grid.bounds[:, 0] + widths / 2, np.diag(widths), grid.describe()["unit"])


def length_unit(text: str) -> str:
    """Return astropy's name of a unit of length or angle; the empty string for anything else.

    Examples
    --------
    >>> length_unit("micron"), length_unit('"mm"'), length_unit("pixel"), length_unit("inch")
    ('micron', 'mm', '', '25.4 mm')
    """
    # ImageJ writes the micro sign as it does in Java's source.
    word = text.strip().strip('"').replace("\\u00B5", "u").replace("µ", "u").replace("μ", "u")
    name = known_unit(_INCH if word.lower() in ("in", "inch") else word)
    unit = parse_unit(name)
    return name if unit is not None and unit.physical_type in ("length", "angle") else ""


def conversion(unit: str, to: str) -> float:
    """Return the factor between two of these units; 1 if either is unknown."""
    if not unit or not to or unit == to:
        return 1.0
    return float(parse_unit(unit).to(parse_unit(to)))


def lattice(volume: Volume, unit: str = "") -> tuple[np.ndarray, np.ndarray]:
    """Return the centre of the first cell of a uniform Cartesian volume, and the steps along axes.

    Both turned as they truly are, in LPS where the volume says how a patient lies; in a unit if one
    is given and the volume's lengths have one.
    """
    grid = cartesian(volume)
    if not (isinstance(grid, CartesianGrid) and grid.is_uniform):
        raise InputError(
            "this format holds cells of equal width only; resample the volume first: "
            "volume.resample(…)"
        )
    factor = 1.0
    if unit and grid.unit is not None:
        factor = float(plain(1.0 * grid.unit, parse_unit(unit), "the cell edges"))
    bounds = grid.bounds * factor
    widths = np.ptp(bounds, axis=1) / grid.shape
    direction, middle = direction_of(volume), middle_of(volume) * factor
    first = bounds[:, 0] + widths / 2
    if "direction" in volume.meta:  # else the numbers stay as they are, to the last digit
        first = middle + direction @ (first - middle)
    turn = to_patient(volume)
    return turn @ first, (turn @ direction).T * widths[:, None]


def to_patient(volume: Volume) -> np.ndarray:
    """Return the matrix to LPS from x, y and z, whose letters are in ``meta["orientation"]``."""
    code = volume.meta.get("orientation", LPS)
    turn = [[(c == a) - (c == b) for c in str(code)] for a, b in zip(LPS, "RAI", strict=True)]
    if np.shape(turn) != (3, 3) or abs(round(np.linalg.det(turn))) != 1:
        raise InputError(f"meta['orientation'] must be letters such as 'LPS', got {code!r}")
    return np.array(turn, float)


def direction_of(volume: Volume) -> np.ndarray:
    """Return how the cells are turned: column a is the true unit vector along axis a."""
    direction = np.asarray(volume.meta.get("direction", np.eye(3)), float)
    if direction.shape != (3, 3):
        raise InputError(
            f"meta['direction'] must be a matrix of 3 x 3, got the shape {direction.shape}; "
            "delete it if the volume is not turned"
        )
    return direction


def middle_of(volume: Volume) -> np.ndarray:
    """Return the point about which the cells are turned: the centre of the scan."""
    return np.asarray(volume.meta.get("direction_center", volume.grid.bounds.mean(axis=1)), float)


def single_field(volume: Volume, kind: str) -> str:
    """Return the name of the volume's only field."""
    if len(volume.fields) != 1:
        listed = ", ".join(volume.fields) or "none"
        raise InputError(
            f"{kind} holds one field, the volume has {listed}; choose one when it is opened: "
            "vm.open(path, 'name')"
        )
    return volume.fields[0]


def slabs(values: np.ndarray) -> Iterator[bytes]:
    """Give the numbers of a field, little-endian, x fastest, a slice at a time."""
    stored = values.dtype.newbyteorder("<")
    for k in range(values.shape[2]):
        yield values[:, :, k].astype(stored, copy=False).tobytes(order="F")
