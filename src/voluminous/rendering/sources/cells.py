"""A medium evaluated on ranges of cells, and the coordinates of their centres."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from ...backend import Backend, aligned, dr, from_host
from ...backend.types import Float, Int, Mask
from ...errors import InputError
from ...expressions import Expression
from ...expressions.interval import Interval
from ...fields import COORDINATES, coordinates
from ...media.context import Context
from ...media.contract import Medium
from ...media.ranges import RangeContext
from ...memory import check_memory
from ...volume import Volume
from ..cache import VolumeStatistics

if TYPE_CHECKING:
    from ...grids.contract import Grid

# Cells whose coordinates are computed at once.
_CHUNK = 1 << 20


class CellCenters:
    """The coordinates of a volume that a medium uses.

    A grid with `traced_centers` computes x, y and z in the kernel. Those of other grids are
    computed on the host: for consecutive cells during classification, for all cells during ray
    tracing.

    Parameters
    ----------
    volume : Volume
        Names of its fields are not coordinates.
    names : iterable of str
        Names that the medium uses; may include fields.
    """

    def __init__(self, volume: Volume, names: Any, backend: Backend) -> None:
        self.grid, self.backend = volume.grid, backend
        self.names = [n for n in names if n in volume.coordinates and n not in volume]
        cartesian = all(name in COORDINATES for name in self.names)
        self.traced = cartesian and self.grid.has_traced_centers
        self._whole: dict[str, Any] = {}

    def part(self, first: int, count: int) -> dict[str, Any]:
        """Return the coordinates of consecutive cells."""
        if self.traced:
            UInt = self.backend.UInt
            lane = dr.arange(UInt, count) + dr.opaque(UInt, first)
            return self._computed(lane)
        found = coordinates(self.grid, self.names, first, first + count)
        return {name: self._on_device(values) for name, values in found.items()}

    def at(self, cell: Int, active: Mask) -> dict[str, Any]:
        """Return the coordinates of any cells (traced)."""
        if self.traced:
            return self._computed(cell)
        Wide = self.backend.Wide
        return {name: dr.gather(Wide, data, cell, active) for name, data in self.whole().items()}

    def whole(self) -> dict[str, Any]:
        """Return the coordinates of all cells; cached. Rays need them where nothing is traced."""
        if not self._whole and not self.traced and self.names:
            size = self.grid.size
            advice = "leave coordinates out of the medium, or coarsen the volume"
            check_memory(8 * size * len(self.names), "coordinates of all cells", advice)
            filled = {name: np.empty(size) for name in self.names}
            for first in range(0, size, _CHUNK):
                last = min(first + _CHUNK, size)
                for name, values in coordinates(self.grid, self.names, first, last).items():
                    filled[name][first:last] = values
            self._whole = {name: self._on_device(values) for name, values in filled.items()}
        return self._whole

    def _computed(self, cell: Int) -> dict[str, Any]:
        values = dict(zip("xyz", self.grid.traced_centers(cell, self.backend), strict=True))
        values["r"] = dr.sqrt(sum(values[name] * values[name] for name in "xyz"))
        return {name: values[name] for name in self.names}

    def _on_device(self, values: np.ndarray) -> Any:
        return from_host(self.backend.Wide, values)


class CellEvaluator:
    """Evaluates a medium on the cells of a volume.

    Attributes
    ----------
    numbers : PerChannel or SharedProfiles
        The numbers computed per cell.
    centers : CellCenters
        The coordinates that the medium uses.
    """

    def __init__(
        self,
        volume: Volume,
        medium: Medium,
        numbers: Int,
        backend: Backend,
        statistics: VolumeStatistics | None = None,
    ) -> None:
        self.volume, self.medium, self.numbers = volume, medium, numbers
        self._largest: list[float] | None = None
        self.backend, self.grid = backend, volume.grid
        self.statistics = statistics or VolumeStatistics(volume)
        check_fields(volume, medium)
        self.centers = CellCenters(volume, medium.names, backend)

    def context(self, real: Any) -> Context:
        """Return the context that evaluates the medium with a given number type."""
        return Context(
            real=real,
            number=lambda value: dr.opaque(real, value),
            unit=self.volume.unit,
            unit_of=self.volume.expression_unit,
        )

    def classify(self, first: int, count: int) -> list[Any]:
        """Return the numbers times the grid's scale for consecutive cells (traced)."""
        fields = self.centers.part(first, count)
        for name in self.medium.names:
            if name not in fields:
                fields[name] = self._values(name, first, count)
        spread = dr.zeros(self.backend.Wide, count)
        return [spread + v for v in self.evaluate(fields)]

    def evaluate(self, fields: dict[str, Any]) -> list[Any]:
        """Return the numbers times the grid's scale, from field values (traced)."""
        scale = self.backend.wide(self.grid.scale)
        return [v * scale for v in self.numbers.values(fields, self.context(self.backend.Wide))]

    def largest(self) -> list[float]:
        """Return bounds of the numbers' magnitudes, from the ranges of the fields alone."""
        if self._largest is None:
            self._largest = self._find_largest()
        return list(self._largest)

    def expect(self, largest: list[float]) -> None:
        """Restore an earlier result of `largest` for the same medium and fields."""
        self._largest = list(largest)

    def _find_largest(self) -> list[float]:
        fields = {name: self.statistics.range_of(name) for name in self.medium.names}
        return [float(end.max()) for end in self.most_in(fields)]

    def most_in(self, fields: dict[str, Interval]) -> list[np.ndarray]:
        """Return bounds of the numbers' magnitudes while the fields stay in ranges."""
        context = RangeContext(self.volume.unit, self.volume.expression_unit)
        with np.errstate(all="ignore"):
            found = self.numbers.ranges(fields, context)
        return [np.maximum(np.abs(v.lo), np.abs(v.hi)) * self.grid.scale for v in found]

    def unusable(self, values: list[Float]) -> Any:
        """Return where numbers are not finite, or an extinction is negative (traced)."""
        bad = self.backend.Bool(False)
        for v in values:
            bad |= ~dr.isfinite(v)
        for v in values[self.numbers.emissions :]:
            bad |= v < 0
        return bad

    def _values(self, name: str, first: int, count: int) -> Any:
        flat = self.volume.array(name).reshape(-1)[first : first + count]
        return self.backend.Wide(device_array(aligned(_floating(flat)), self.backend))

    def refuse(self, values: list[Float], bad: Any, first: int) -> None:
        """Raise the error that names the first cell with unusable coefficients."""
        bad = np.asarray(bad)
        place = int(np.flatnonzero(bad)[0])
        cell = tuple(int(i) for i in np.unravel_index(first + place, self.grid.shape))
        told = []
        for k, v in enumerate(values):
            value = float(np.asarray(v)[place]) / self.grid.scale
            if not np.isfinite(value) or (k >= self.numbers.emissions and value < 0):
                name = "emissivity" if k < self.numbers.emissions else "extinction"
                told.append(f"{name} of channel {k % self.numbers.emissions} is {value:g}")
        fields = ", ".join(
            f"{name} = {self.volume.array(name)[cell]:g}"
            for name in self.medium.names
            if name in self.volume
        )
        raise InputError(
            f"the medium gives coefficients that cannot be used in {int(bad.sum())} cells (of "
            f"those looked at so far); the first is {cell}: {'; '.join(told)}"
            f"{f', where {fields}' if fields else ''}. Emissivity must be finite, extinction "
            "finite and not negative: clip the fields, or use where(...) in the expression"
        )


def check_fields(volume: Volume, medium: Medium) -> None:
    """Raise the error that names the nearest field if a medium uses an unknown one."""
    for name in medium.names:
        if name not in volume.coordinates and name not in volume:
            volume.array(name)


def device_array(flat: np.ndarray, backend: Backend) -> Any:
    """Return numbers on the device; integers become floating point that holds them.

    Float arrays in the CPU's memory are used in place for gathers, unless they are
    `backend.aligned`.
    """
    flat = _floating(flat)
    kind = backend.module.Float32 if flat.dtype == np.float32 else backend.module.Float64
    return kind(flat)


def _floating(flat: np.ndarray) -> np.ndarray:
    """Return integers as floating point that holds them; other numbers are unchanged."""
    if flat.dtype.kind == "f":
        return flat
    return flat.astype(np.float32 if flat.dtype.itemsize <= 2 else np.float64)


_ACROSS = "sqrt(x*x + y*y)"


def ray_coordinates(volume: Volume, names: Iterable[str]) -> dict[str, Expression]:
    """Return the named curvilinear coordinates of the grid, as expressions of x, y and z."""
    grid = volume.grid
    own = [n for n in names if n in grid.coordinates and n not in (*COORDINATES, *volume)]
    return {name: _formula(name, grid) for name in own}


def _formula(name: str, grid: Grid) -> Expression:
    if name == "R":
        return Expression(_ACROSS)
    if name == "theta":
        height = "abs(z)" if grid.mirror else "z"
        return Expression(f"atan2({_ACROSS}, {height})")
    # Azimuths that exceed the first one by less than a full circle.
    first = float(grid.edges[grid.coordinates.index("phi")][0])
    return Expression(f"atan2(y, x) - 2*pi*((atan2(y, x) - {first!r}) // (2*pi))")


# Dr.Jit arrays, and the offsets of packets in them, are 32-bit.
LARGEST = 2**32 - 1


# Cells classified at once: limits the memory of temporaries, and the delay of an interrupt.
SLAB = 1 << 19
