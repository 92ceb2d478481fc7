"""What a file or an object of VTK tells, whatever way it is written: points, and arrays on them."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...errors import FileFormatError
from ..names import field_name
from ..scanners.placement import Arrangement
from ..scanners.voxels import COLORS, VECTOR
from .axes import cell_counts

POINT, CELL = "point", "cell"
# Of the names that programs use for the one number that all know.
_TIME = ("TimeValue", "TIME", "Time", "time")
_TIME_IN_TITLE = re.compile(r"\btime\s*=\s*([-+.\deE]+)")
# What VTK writes as title of everything.
_NO_TITLE = "vtk output"
_MOST_COMPONENTS = 4096


@dataclass(frozen=True)
class Array:
    """Values at all points, or in all cells.

    Attributes
    ----------
    name : str
        As in the file.
    at : str
        `POINT` or `CELL`; empty in formats that do not tell these apart.
    components : int
        Values at each.
    dtype : dtype
        Their type, in this machine's byte order.
    load : callable
        Returns them: shape (nz, ny, nx, components).
    labels : tuple of str
        Names of the components, if all have one.
    unit : str
        As astropy knows it; empty for none.
    """

    name: str
    at: str
    components: int
    dtype: np.dtype[Any]
    load: Callable[[], np.ndarray]
    labels: tuple[str, ...] = ()
    unit: str = ""

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
    """Structured data.

    Attributes
    ----------
    points : tuple of three int
        Number of points along each index, the fastest first.
    arrange : callable
        ``arrange(at, unit)`` returns where the cells are.
    arrays : sequence of Array
        All there are.
    active : dict of str
        Names of the scalars that are to be shown, at points and in cells.
    meta : dict
        What else is told.
    low : tuple of three int
        Index of the first point along each, where this is a piece of something.
    """

    points: tuple[int, ...]
    arrange: Callable[[str, Any], Arrangement]
    arrays: Sequence[Array]
    active: dict[str, str] = field(default_factory=dict)
    meta: dict[str, Any] = field(default_factory=dict)
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
    """Return a volume's `meta`: what a file tells besides fields.

    Parameters
    ----------
    values : dict
        Numbers and texts by the file's names for them.
    title : str, optional
        A line of text; some codes tell the time in it.
    """
    meta = {"time" if name in _TIME else name: value for name, value in values.items()}
    found = _TIME_IN_TITLE.search(title)
    if found and "time" not in meta:
        with contextlib.suppress(ValueError):
            meta["time"] = float(found[1])
    return meta if title in ("", _NO_TITLE) else {"title": title, **meta}
