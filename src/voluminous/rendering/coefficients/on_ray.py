"""Coefficients evaluated on the ray: no table, for volumes with more cells than the rays visit."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ...backend import dr
from ...backend.functions import flush_subnormal
from ...grids.contract import Segment
from ...memory import check_memory
from ...schemes.base import Coefficients
from .classify import Classifier, device_array


class OnRay:
    """The medium evaluated in every cell that a ray visits; the same bits as from a table.

    Unusable coefficients become NaN, which the picture shows: it is looked at afterwards.
    """

    blocks = None

    def __init__(self, classifier: Classifier, backend: Any) -> None:
        self.classifier, self.backend = classifier, backend
        self.numbers = classifier.numbers
        volume = classifier.volume
        self.fields = {
            name: _whole_field(volume.array(name), backend)
            for name in classifier.medium.names
            if name in volume
        }
        classifier.centers.whole()  # made before rays are traced
        self.largest = self.bounds = self.numbers.in_units(classifier.largest())

    def inputs(self) -> Any:
        return self.fields, self.classifier.centers.whole(), self.numbers.inputs()

    def at(self, segment: Segment) -> Coefficients:
        cell, active = segment.cell, segment.active
        Wide = self.backend.Wide
        values = {
            name: Wide(dr.gather(type(data), data, cell, active))
            for name, data in self.fields.items()
        }
        found = self.classifier.evaluate({**self.classifier.centers.at(cell, active), **values})
        for k in range(self.numbers.emissions, len(found)):
            found[k] = dr.select(found[k] >= 0, found[k], math.nan)
        return self.numbers.split([self._narrow(v) for v in found])

    def _narrow(self, value: Any) -> Any:
        return flush_subnormal(self.backend.Float(value))


def _whole_field(array: np.ndarray, backend: Any) -> Any:
    if array.dtype.kind != "f":
        size = array.size * (4 if array.dtype.itemsize <= 2 else 8)
        check_memory(size, "an integer field as floating point", "crop or coarsen the volume")
    return device_array(array.reshape(-1), backend)
