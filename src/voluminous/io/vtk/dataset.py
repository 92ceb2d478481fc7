"""Where the cells of VTK's structured data are.

VTK has values at points and in the cells between them. Cells here are those in both cases: for
values at points, cells around these, whose walls lie midway. Interpolated schemes then draw what
VTK draws, since the field between two centres is linear there as it is between two points.
"""

from __future__ import annotations

import contextlib
import functools
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...deferred import Deferred
from ...errors import FileFormatError, InputError
from ...memory import check_memory
from ..contract import FieldInfo, Reader
from ..edges import edges_of_centers, is_even
from ..names import chosen_fields, field_name
from ..scanners.placement import Arrangement, Placement, arranged
from ..scanners.voxels import COLORS, VECTOR

if TYPE_CHECKING:
    from ...volume import Volume


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
    """Return where the cells of image data are."""
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
    """Return where the cells of a rectilinear grid are."""
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
    """Return the coordinates of a structured grid whose points lie on planes of x, y and z."""
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


POINT, CELL = "point", "cell"
# Of the names that programs use for the one number that all know.
_TIME = ("TimeValue", "TIME", "Time", "time")
_TIME_IN_TITLE = re.compile(r"\btime\s*=\s*([-+.\deE]+)")
# What VTK writes as title of everything.
_NO_TITLE = "vtk output"
_MOST_COMPONENTS = 4096


@dataclass(frozen=True)
class Array:
    """Values at all points, or in all cells."""

    name: str  # as in the file
    at: str  # `POINT` or `CELL`; empty in formats that do not tell these apart
    components: int  # values at each
    dtype: np.dtype[Any]  # their type, in this machine's byte order
    load: Callable[[], np.ndarray]  # returns them: shape (nz, ny, nx, components)
    labels: tuple[str, ...] = ()  # names of the components, if all have one
    unit: str = ""  # as astropy knows it; empty for none

    def __post_init__(self) -> None:
        if not 1 <= self.components <= _MOST_COMPONENTS:
            raise FileFormatError(
                f"array {self.name!r}: expected 1 to {_MOST_COMPONENTS} components, got "
                f"{self.components}"
            )

    @property
    def place(self) -> str:
        """What it is called, at points or in cells."""
        return f"{self.at}/{self.name}" if self.at else self.name

    def endings(self, upright: bool = True) -> tuple[str, ...]:
        """Return what is put behind the name for each component; x, y, z only of upright data."""
        count = self.components
        if count == 1:
            return ("",)
        if self.dtype == np.uint8 and count in (3, 4):
            return COLORS[:count]
        if count == 3 and upright:
            return VECTOR
        if len(set(self.labels)) == count:
            return tuple(f"_{label}" for label in self.labels)
        return tuple(f"_{number}" for number in range(count))

    def names(self, upright: bool = True) -> tuple[str, ...]:
        """Return the names of the fields it becomes."""
        if self.components == 1:
            return (field_name(self.name),)
        return tuple(field_name(self.name + ending) for ending in self.endings(upright))


@dataclass(frozen=True)
class Dataset:
    """Structured data."""

    points: tuple[int, ...]  # number of points along each index, the fastest first
    arrange: Callable[[str, Any], Arrangement]  # ``arrange(at, unit)`` returns where the cells are
    arrays: Sequence[Array]  # all there are
    # names of the scalars that are to be shown, at points and in cells
    active: dict[str, str] = field(default_factory=dict)
    meta: dict[str, Any] = field(default_factory=dict)  # what else is told
    # index of the first point along each, where this is a piece of something
    low: tuple[int, ...] = (0, 0, 0)

    def shape(self, at: str) -> tuple[int, ...]:
        """Return the number of cells along each index."""
        return cell_counts(self.points, at)

    def preferred(self) -> str:
        """Return where the values are that are shown if nobody asks for others.

        Where there are any; where there are active scalars; where there are more.
        """
        shown = [array.at for array in self.arrays if not is_internal(array)]
        if len(set(shown)) == 1:
            return shown[0]
        if len(self.active) == 1:
            return next(iter(self.active))
        return CELL if shown.count(CELL) > shown.count(POINT) else POINT


def is_internal(array: Array) -> bool:
    """Return True for what VTK keeps for itself, such as ``vtkGhostType``."""
    return array.name.startswith("vtk")


def told(values: dict[str, Any], title: str = "") -> dict[str, Any]:
    """Return a volume's `meta`: what a file tells besides fields."""
    meta = {"time" if name in _TIME else name: value for name, value in values.items()}
    found = _TIME_IN_TITLE.search(title)
    if found and "time" not in meta:
        with contextlib.suppress(ValueError):
            meta["time"] = float(found[1])
    return meta if title in ("", _NO_TITLE) else {"title": title, **meta}


# Bits of ``vtkGhostType`` (vtkDataSetAttributes.h) that say that there is nothing to see.
_HIDDEN = {POINT: 2, CELL: 32}
_GHOSTS = "vtkGhostType"
OPTIONS = {
    "unit": "unit of length",
    "resolution": "resample to equal cells: how many along the longest side, or three numbers",
}


class DatasetReader(Reader):
    """A reader that makes a `Dataset` of a file; what there is in it follows."""

    options = OPTIONS

    def dataset(self, path: Path, **options: Any) -> Dataset:
        """Return what a file tells, with the reader's options but for ``unit``."""
        raise NotImplementedError

    def read(self, path: Path, fields: Any = None, *, unit: Any = None, **options: Any) -> Volume:
        return volume_of(self.dataset(path, **options), fields, unit)

    def info(self, path: Path, *, unit: Any = None, **options: Any) -> tuple[FieldInfo, ...]:
        return infos(self.dataset(path, **options))


class Parts:
    """The components of an array, decoded once: those nobody has asked for yet are kept."""

    def __init__(self, array: Array, wanted: set[int]) -> None:
        self._array, self._wanted = array, wanted
        self._kept: dict[int, np.ndarray] = {}

    def take(self, component: int) -> np.ndarray:
        """Return one component, shape (nz, ny, nx)."""
        if component not in self._kept:
            values = self._array.load()
            self._kept = {k: values[..., k] for k in self._wanted | {component}}
        self._wanted = self._wanted - {component}
        return self._kept.pop(component)


def volume_of(dataset: Dataset, fields: Any = None, unit: Any = None) -> Volume:
    """Return the volume of a dataset, whose fields are read when they are used."""
    from ...volume import Volume

    chosen = chosen_arrays(dataset, fields)
    at = common_place(chosen)
    arrangement = dataset.arrange(at, unit or dataset.meta.get("length_unit"))
    volume = Volume(arrangement.grid)
    volume.meta |= {name: v for name, v in dataset.meta.items() if name != "length_unit"}
    if arrangement.direction is not None:
        volume.meta["direction"] = arrangement.direction.tolist()
        chosen = chosen_arrays(dataset, fields, upright=False)
    source = Source(dataset, chosen, arrangement)
    for name, (array, _) in chosen.items():
        volume[name] = Deferred(functools.partial(source.load, name), array.dtype, array.unit)
    return volume


class Source:
    """What reads the fields that are chosen of a dataset, each as an array on its grid."""

    def __init__(
        self, dataset: Dataset, chosen: dict[str, tuple[Array, int]], arrangement: Arrangement
    ) -> None:
        at = common_place(chosen)
        self._hidden = next((a for a in dataset.arrays if (a.name, a.at) == (_GHOSTS, at)), None)
        self._chosen, self._parts, self._arrangement = chosen, _parts(chosen), arrangement

    def load(self, name: str) -> np.ndarray:
        """Return the values of a field; NaN where VTK hides them."""
        array, component = self._chosen[name]
        values, hidden = self._parts[array.place].take(component), self._hidden
        if hidden is not None and values.dtype.kind == "f":
            blank = (hidden.load()[..., 0] & _HIDDEN[hidden.at]) != 0
            values = np.where(blank, values.dtype.type(np.nan), values)
        return self._arrangement.put(values.transpose())


def _parts(chosen: dict[str, tuple[Array, int]]) -> dict[str, Parts]:
    wanted: dict[str, set[int]] = {}
    for array, component in chosen.values():
        wanted.setdefault(array.place, set()).add(component)
    return {array.place: Parts(array, wanted[array.place]) for array, _ in chosen.values()}


def infos(dataset: Dataset) -> tuple[FieldInfo, ...]:
    """Return what there is to read."""
    return tuple(
        FieldInfo(name, place, dataset.shape(array.at), str(array.dtype), array.unit)
        for place, (name, array, _) in _known(dataset).items()
    )


def _known(dataset: Dataset, upright: bool = True) -> dict[str, tuple[str, Array, int]]:
    """Return, by place, the name, array and component of all fields; preferred ones first."""
    preferred = dataset.preferred()
    known = {}
    for array in sorted(dataset.arrays, key=lambda array: array.at != preferred):
        several = array.components > 1
        endings = array.endings(upright)
        for k, (name, ending) in enumerate(zip(array.names(upright), endings, strict=True)):
            place = f"{array.place}/{ending[1:]}" if several else array.place
            known[place] = (name, array, k)
    return known


def chosen_arrays(
    dataset: Dataset, fields: Any, upright: bool = True
) -> dict[str, tuple[Array, int]]:
    """Return array and component of each field that is asked for, by its name."""
    known = _known(dataset, upright)
    if not known:
        raise FileFormatError("expected values at points or in cells, there are none")
    offered = known
    if fields is None:
        preferred = dataset.preferred()
        shown = {p: k for p, k in known.items() if k[1].at == preferred}
        offered = {p: k for p, k in shown.items() if not is_internal(k[1])} or shown or known
    places = chosen_fields({place: name for place, (name, _, _) in offered.items()}, fields)
    return {name: known[place][1:] for name, place in places.items()}


def common_place(chosen: dict[str, tuple[Array, int]]) -> str:
    """Return where the values of all fields are."""
    found = {array.at for array, _ in chosen.values()}
    if len(found) > 1:
        listed = "; ".join(
            f"{at}s: " + ", ".join(n for n, (array, _) in chosen.items() if array.at == at)
            for at in sorted(found)
        )
        raise InputError(
            f"values at points and in cells are on different grids; choose fields of one kind "
            f"({listed})"
        )
    return found.pop()
