"""Structured VTK data: the grid of cells, and the arrays that become fields of a volume.

VTK has values at points and in the cells between them. Cells here are those in both cases: for
values at points, cells around these, whose walls lie midway. Interpolated schemes then draw what
VTK draws, since the field between two centres is linear there as it is between two points.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...deferred import Deferred
from ...errors import FileFormatError, InputError
from ...memory import check_memory
from ..axes import edges_of_centers, is_even
from ..contract import FieldInfo, Reader
from ..names import chosen_fields, field_name
from ..scanners.placement import Arrangement, Placement, arranged
from ..scanners.voxels import COLORS, VECTOR

if TYPE_CHECKING:
    from ...volume import Volume

POINT, CELL = "point", "cell"
UPRIGHT = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
ADVICE = "; give resolution=64 (cells along the longest side) to resample it to equal cells"
OPTIONS = {
    "unit": "unit of length",
    "resolution": "resample to equal cells: how many along the longest side, or three numbers",
}
# Bytes that walls take while they are made, and walks through them.
_PER_POINT = 64
# Bits of ``vtkGhostType`` (vtkDataSetAttributes.h) of points and cells that are not to be shown.
_HIDDEN = {POINT: 2, CELL: 32}


@dataclass(frozen=True)
class Even:
    """Grid of image data: equally spaced points."""

    origin: Any  # of the point of index (0, 0, 0)
    spacing: Any
    direction: Any  # nine numbers, row by row: columns are where the indices lead
    low: tuple[int, ...]  # the first index along each
    points: tuple[int, ...]

    def __call__(self, at: str, unit: Any) -> Arrangement:
        """Return where the cells are around the points, or between them."""
        counts = np.asarray(self.points)
        size = _PER_POINT * int(counts.sum())
        check_memory(size, "the walls of the cells", "is the file damaged?")
        widths = np.asarray(self.spacing, float)
        widths = np.where((widths == 0) & (counts == 1), 1.0, widths)
        steps = np.asarray(self.direction, float).reshape(3, 3).T * widths[:, None]
        first = np.asarray(self.origin, float) + np.asarray(self.low) @ steps
        if at == CELL:  # a single layer of points is a layer of cells
            first = first + 0.5 * (counts > 1) @ steps
        return arranged(cell_counts(self.points, at), Placement(first, steps, unit))


@dataclass(frozen=True)
class Uneven:
    """Rectilinear grid: coordinates of the points along x, y and z."""

    lines: tuple[np.ndarray, ...]

    def __call__(self, at: str, unit: Any) -> Arrangement:
        """Return where the cells are around the points, or between them."""
        from ...grids import CartesianGrid

        lines = [np.asarray(line, np.float64) for line in self.lines]
        for name, line in zip("xyz", lines, strict=True):
            steps = np.diff(line)
            if not (np.isfinite(line).all() and ((steps > 0).all() or (steps < 0).all())):
                raise FileFormatError(
                    f"expected finite {name} coordinates that increase, or decrease, from point "
                    f"to point, got {np.array2string(line, threshold=6)}"
                )
        backward = tuple(bool(line[0] > line[-1]) for line in lines)
        lines = [line[::-1] if down else line for line, down in zip(lines, backward, strict=True)]
        widths = [(line[-1] - line[0]) / (len(line) - 1) for line in lines if len(line) > 1]
        # A single layer is as thick as cells are wide along the other axes.
        width = float(np.mean(widths)) if widths else 1.0
        grid = CartesianGrid(*(_edges(line, at, width) for line in lines), unit=unit)
        return Arrangement(grid, (0, 1, 2), backward, None)


def _edges(line: np.ndarray, at: str, width: float) -> np.ndarray:
    if len(line) == 1:
        return np.asarray(line[0] + np.array([-0.5, 0.5]) * width)
    if at == POINT:
        return edges_of_centers(line)
    # A grid of equal cells is faster, and files round coordinates.
    return np.linspace(line[0], line[-1], len(line)) if is_even(line) else line


def cell_counts(points: Any, at: str) -> tuple[int, ...]:
    """Return the number of cells around points, or between them."""
    return tuple(max(int(n) - 1, 1) if at == CELL else int(n) for n in points)


@dataclass(frozen=True)
class DataArray:
    """Values at all points, or in all cells."""

    name: str
    at: str  # `POINT` or `CELL`; empty in formats that have no such difference
    components: int
    dtype: np.dtype[Any]
    load: Callable[[], np.ndarray]  # returns them: shape (nz, ny, nx, components)
    labels: tuple[str, ...] = ()  # of the components, if all have one
    unit: str = ""

    @property
    def place(self) -> str:
        """What it is called, at points or in cells."""
        return f"{self.at}/{self.name}" if self.at else self.name

    @property
    def is_internal(self) -> bool:
        """True for what VTK keeps for itself, such as ``vtkGhostType``."""
        return self.name.startswith("vtk")

    def endings(self, upright: bool) -> tuple[str, ...]:
        """Return the name suffix of each component; x, y, z only for upright data."""
        count = self.components
        if count == 1:
            return ("",)
        if self.dtype == np.uint8 and count in (3, 4):
            return COLORS[:count]
        if count == 3 and upright:
            return VECTOR
        labels = self.labels if len(set(self.labels)) == count else range(count)
        return tuple(f"_{label}" for label in labels)


Chosen = dict[str, tuple[DataArray, int]]  # name of a field → array and component


@dataclass(frozen=True)
class Dataset:
    """Structured data: points, and arrays on them."""

    points: tuple[int, ...]  # along each index, the fastest first
    arrange: Callable[[str, Any], Arrangement]  # of `POINT` or `CELL`, and the unit of length
    arrays: Sequence[DataArray]
    active: Mapping[str, str] = field(default_factory=dict)  # scalars to show, by `POINT`, `CELL`
    meta: dict[str, Any] = field(default_factory=dict)

    def shape(self, at: str) -> tuple[int, ...]:
        """Return the number of cells along each index."""
        return cell_counts(self.points, at)

    def preferred(self) -> str:
        """Return where the values are that are shown by default.

        Where there are any; where there are active scalars; where there are more.
        """
        shown = [array.at for array in self.arrays if not array.is_internal]
        if len(set(shown)) == 1:
            return shown[0]
        if len(self.active) == 1:
            return next(iter(self.active))
        return CELL if shown.count(CELL) > shown.count(POINT) else POINT

    def fields(self, upright: bool = True) -> dict[str, tuple[str, DataArray, int]]:
        """Return, by place, the name, array and component of all fields; preferred ones first."""
        preferred = self.preferred()
        result = {}
        for array in sorted(self.arrays, key=lambda array: array.at != preferred):
            for k, ending in enumerate(array.endings(upright)):
                place = f"{array.place}/{ending[1:]}" if ending else array.place
                result[place] = (field_name(array.name + ending), array, k)
        return result

    def infos(self) -> tuple[FieldInfo, ...]:
        """Return descriptions of the fields in this data set."""
        return tuple(
            FieldInfo(name, place, self.shape(array.at), str(array.dtype), array.unit)
            for place, (name, array, _) in self.fields().items()
        )

    def chosen(self, fields: Any, upright: bool = True) -> Chosen:
        """Return the array and component of each requested field, by name."""
        known = self.fields(upright)
        if not known:
            raise FileFormatError("expected values at points or in cells, there are none")
        offered = known
        if fields is None:
            preferred = self.preferred()
            shown = {p: k for p, k in known.items() if k[1].at == preferred}
            offered = {p: k for p, k in shown.items() if not k[1].is_internal} or shown or known
        places = chosen_fields({place: name for place, (name, _, _) in offered.items()}, fields)
        return {name: known[place][1:] for name, place in places.items()}

    def volume(self, fields: Any = None, unit: Any = None) -> Volume:
        """Return the volume; its fields are read on first use."""
        from ...volume import Volume

        chosen = self.chosen(fields)
        arrangement = self.arrange(common_place(chosen), unit or self.meta.get("length_unit"))
        volume = Volume(arrangement.grid)
        volume.meta |= {name: v for name, v in self.meta.items() if name != "length_unit"}
        if arrangement.direction is not None:
            volume.meta["direction"] = arrangement.direction.tolist()
            chosen = self.chosen(fields, upright=False)
        arrays = ArrangedArrays(self, chosen, arrangement)
        for name, (array, _) in chosen.items():
            volume[name] = Deferred(functools.partial(arrays.load, name), array.dtype, array.unit)
        return volume


class ArrangedArrays:
    """Loads the chosen fields of a dataset, each as an array on its grid."""

    def __init__(self, dataset: Dataset, chosen: Chosen, arrangement: Arrangement) -> None:
        ghosts = ("vtkGhostType", common_place(chosen))
        self._hidden = next((a for a in dataset.arrays if (a.name, a.at) == ghosts), None)
        self._chosen, self._arrangement = chosen, arrangement
        # Components of an array that was decoded, and that nobody has asked for yet.
        self._waiting: dict[tuple[str, int], np.ndarray] = {}

    def load(self, name: str) -> np.ndarray:
        """Return the values of a field; hidden points and cells are NaN."""
        array, component = self._chosen[name]
        if (array.place, component) not in self._waiting:
            whole = array.load()
            for other, k in self._chosen.values():
                if other.place == array.place:
                    self._waiting[array.place, k] = whole[..., k]
        values, hidden = self._waiting.pop((array.place, component)), self._hidden
        if hidden is not None and values.dtype.kind == "f":
            blank = (hidden.load()[..., 0] & _HIDDEN[hidden.at]) != 0
            values = np.where(blank, values.dtype.type(np.nan), values)
        return self._arrangement.put(values.transpose())


def common_place(chosen: Chosen) -> str:
    """Return where the values of all fields are: at points, or in cells."""
    result = {array.at for array, _ in chosen.values()}
    if len(result) > 1:
        listed = "; ".join(
            f"{at}s: " + ", ".join(n for n, (array, _) in chosen.items() if array.at == at)
            for at in sorted(result)
        )
        raise InputError(
            "values at points and in cells are on different grids; choose fields of one kind "
            f"({listed})"
        )
    return result.pop()


class DatasetReader(Reader):
    """Base class of readers that convert a file to a `Dataset`."""

    options = OPTIONS

    def dataset(self, path: Path, **options: Any) -> Dataset:
        """Return what is in a file, with the reader's options but for ``unit``."""
        raise NotImplementedError

    def read(self, path: Path, fields: Any = None, *, unit: Any = None, **options: Any) -> Volume:
        return self.dataset(path, **options).volume(fields, unit)

    def info(self, path: Path, *, unit: Any = None, **options: Any) -> tuple[FieldInfo, ...]:
        return self.dataset(path, **options).infos()
