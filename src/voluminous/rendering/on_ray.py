"""Coefficients evaluated on the ray: no table, for volumes with more cells than the rays visit."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..backend import dr
from ..backend.functions import flush_subnormal
from ..memory import check_memory
from .classify import Classifier, cell_coordinates


class OnRay:
    """The medium evaluated in every cell that a ray visits; the same bits as from a table.

    Unusable coefficients become NaN, which the picture shows: it is looked at afterwards.
    """

    def __init__(self, classifier: Classifier, backend: Any) -> None:
        self.classifier, self.backend = classifier, backend
        self.numbers = classifier.numbers
        self.names = classifier.medium.names
        volume = classifier.volume
        self.fields = {
            name: _device_array(volume.array(name), backend)
            for name in self.names
            if name in volume
        }
        self.largest = classifier.largest()

    def at(self, cell: Any, active: Any) -> tuple[list[Any], list[Any]]:
        """Return j and α of a cell."""
        Wide = self.backend.Wide
        grid = self.classifier.grid
        values = {
            name: Wide(dr.gather(type(data), data, cell, active))
            for name, data in self.fields.items()
        }
        if len(values) < len(self.names):
            values = {**cell_coordinates(grid, cell, self.backend), **values}
        found = self.classifier.evaluate(values)
        for k in range(self.numbers.emissions, len(found)):
            found[k] = dr.select(found[k] >= 0, found[k], math.nan)
        return self.numbers.split([self._narrow(v) for v in found])

    def _narrow(self, value: Any) -> Any:
        return flush_subnormal(self.backend.Float(value))


def _device_array(array: np.ndarray, backend: Any) -> Any:
    """Return a field on the device; float arrays in the CPU's memory are used where they are."""
    flat = array.reshape(-1)
    if flat.dtype.kind != "f":
        size = flat.size * (4 if flat.dtype.itemsize <= 2 else 8)
        check_memory(size, "an integer field as floating point", "crop or coarsen the volume")
        flat = flat.astype(np.float32 if flat.dtype.itemsize <= 2 else np.float64)
    kind = backend.module.Float32 if flat.dtype == np.float32 else backend.module.Float64
    return kind(flat)
