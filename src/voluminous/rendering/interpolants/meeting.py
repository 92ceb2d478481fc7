"""What the cells say that meet at a vertex of a tree."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...backend import dr

# Cells whose widths differ by less, relatively, are alike.
_ALIKE = 1e-6


@dataclass
class Said:
    """What cells say of one field at a vertex.

    Attributes
    ----------
    values, rises : array
        Sums of their values, and of what these change by on the way to the vertex.
    least, most : array
        Range of the values.
    """

    values: Any
    rises: Any
    least: Any
    most: Any

    def with_one(self, value: Any, rise: Any, there: Any) -> Said:
        """Return it with one cell more, where there is one."""
        return Said(
            self.values + dr.select(there, value, 0.0),
            self.rises + dr.select(there, rise, 0.0),
            dr.select(there & (value < self.least), value, self.least),
            dr.select(there & (value > self.most), value, self.most),
        )

    def mean(self, count: Any, share: Any) -> Any:
        """Return the mean, with a share of the rises, no less and no more than the values."""
        mean = dr.fma(share, self.rises, self.values) / count
        mean = dr.select(mean < self.least, self.least, mean)
        return dr.select(mean > self.most, self.most, mean)


@dataclass
class Meeting:
    """Sums over the octants around a vertex, for `corner_values`.

    Attributes
    ----------
    count : array
        How many octants have a cell.
    said : list of Said
        What these say of each field.
    alike : array of Bool
        All octants have cells, as wide as each other.
    width : list of three arrays
        Widths of the last cell.
    hanging : array of Bool
        There are cells that have no corner there.
    number, low, extent, size : arrays, lists of three, array
        The largest of those: its number, where it is, and how large.
    """

    count: Any
    said: list[Said]
    alike: Any
    width: list[Any]
    hanging: Any
    number: Any
    low: list[Any]
    extent: list[Any]
    size: Any

    @classmethod
    def start(cls, backend: Any, count: int, fields: int) -> Meeting:
        """Return what is known of so many fields before any cell is asked."""

        def full(value: float) -> Any:
            return dr.full(backend.Float, value, count)

        return cls(
            count=full(0.0),
            said=[Said(full(0.0), full(0.0), full(np.inf), full(-np.inf)) for _ in range(fields)],
            alike=dr.full(backend.Bool, True, count),
            width=[full(0.0) for _ in range(3)],
            hanging=dr.full(backend.Bool, False, count),
            number=dr.zeros(backend.UInt, count),
            low=[full(0.0) for _ in range(3)],
            extent=[full(1.0) for _ in range(3)],
            size=full(0.0),
        )

    def is_alike(self, width: list[Any]) -> Any:
        """Return where a cell is as wide as the one before, if there was any."""
        same = self.width[0] == 0.0
        both = True
        for a, b in zip(width, self.width, strict=True):
            both = both & (dr.abs(a - b) <= _ALIKE * a)
        return same | both

    def means(self) -> list[Any]:
        """Return the means of what the cells say of each field.

        Each value is moved along its gradient: all the way, or half where cells are alike.
        """
        share = dr.select(self.alike, 0.5, 1.0)
        return [said.mean(self.count, share) for said in self.said]


def is_corner(vertex: list[Any], low: list[Any], extent: list[Any]) -> Any:
    """Return which vertices are corners of boxes that they touch."""
    found = True
    for v, a, s in zip(vertex, low, extent, strict=True):
        found = found & ((v == a) | (v == a + s))
    return found
