"""Coordinates of cell centres, as media on tables and on the ray need them."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...backend import dr, from_host
from ...fields import COORDINATES, coordinates
from ...memory import check_memory

# Cells whose coordinates are computed at once.
_CHUNK = 1 << 20


class Centers:
    """The coordinates of a volume that a medium names.

    A grid with `traced_centers` computes x, y and z in the kernel. Of others they are computed on
    the host: of consecutive cells when these are classified, of all cells for rays.

    Parameters
    ----------
    volume : Volume
        Its fields are no coordinates.
    names : iterable of str
        What the medium looks at; may hold fields.
    """

    def __init__(self, volume: Any, names: Any, backend: Any) -> None:
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

    def at(self, cell: Any, active: Any) -> dict[str, Any]:
        """Return the coordinates of any cells (traced)."""
        if self.traced:
            return self._computed(cell)
        Wide = self.backend.Wide
        return {name: dr.gather(Wide, data, cell, active) for name, data in self.whole().items()}

    def whole(self) -> dict[str, Any]:
        """Return the coordinates of all cells; kept. Rays need them where nothing is traced."""
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

    def _computed(self, cell: Any) -> dict[str, Any]:
        values = dict(zip("xyz", self.grid.traced_centers(cell, self.backend), strict=True))
        values["r"] = dr.sqrt(sum(values[name] * values[name] for name in "xyz"))
        return {name: values[name] for name in self.names}

    def _on_device(self, values: np.ndarray) -> Any:
        return from_host(self.backend.Wide, values)
