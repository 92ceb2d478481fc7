"""What rays have gathered, as NumPy arrays."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np


@dataclass
class Paths:
    """Paths of rays.

    Attributes
    ----------
    rows : list of array, shape (n,)
        One per number of a path. On the CPU they are the memory that kernels wrote to: put into one
        array they took 2 ms of the 13 of a picture of 400 × 400.
    counts : (int, int, int)
        How many emissions, extinctions and errors there are.
    stopped : bool
        Some rays stopped early.
    """

    rows: list[np.ndarray]
    counts: tuple[int, int, int]
    stopped: bool

    @property
    def emission(self) -> list[np.ndarray]:
        """Intensities, in as many rows as there are emissions."""
        return self.rows[: self.counts[0]]

    @property
    def transparency(self) -> list[np.ndarray]:
        """Transparencies, in as many rows as there are extinctions."""
        first, count, _ = self.counts
        return self.rows[first : first + count]

    @property
    def depth(self) -> list[np.ndarray]:
        """Optical depths, in as many rows as there are extinctions."""
        first, count, _ = self.counts
        return self.rows[first + count : first + 2 * count]

    @property
    def error(self) -> list[np.ndarray]:
        """What is known of errors; see `schemes.path.Path`."""
        first, count, _ = self.counts
        return self.rows[first + 2 * count :]

    def some(self, index: np.ndarray) -> Paths:
        """Return some of the rays."""
        return _mapped(lambda row: row[index], [self])

    def put(self, index: np.ndarray, new: Paths) -> None:
        """Put others in the place of some rays."""
        for row, values in zip(self.rows, new.rows, strict=True):
            row[index] = values
        self.stopped |= new.stopped

    def plus(self, other: Paths) -> Paths:
        """Return the sums of two paths each."""
        return _mapped(np.add, [self, other])

    def times(self, factor: float) -> Paths:
        """Return all numbers times a factor."""
        return _mapped(lambda row: row * factor, [self])


def mean(found: Iterable[Paths]) -> Paths:
    """Return the means of several sets of paths."""
    total, count = None, 0
    for one in found:
        total, count = one if total is None else total.plus(one), count + 1
    assert total is not None
    return total if count == 1 else total.times(1.0 / count)


def _mapped(function: Callable[..., np.ndarray], paths: Sequence[Paths]) -> Paths:
    rows = [function(*each) for each in zip(*(one.rows for one in paths), strict=True)]
    return Paths(rows, paths[0].counts, any(one.stopped for one in paths))
