"""A batch of rays, what a kernel reads of it, and what it writes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ...backend import dr
from ...backend.functions import flush_subnormal
from ...schemes.path import Path
from .march import Cutoff
from .pixels import Lanes

# Sums below so many times the smallest normal number count as zero: they may have lost subnormal
# terms, and with how many threads, decides.
MARGIN = 2.0**36


@dataclass
class Batch:
    """Rays that are followed together.

    Attributes
    ----------
    lanes : Lanes
        The rays.
    offset : (float, float)
        Where in pixels they go through, besides.
    first : int
        The place of the first one's results.
    whole : (int, int), optional
        The pixels of the picture, where these are the lanes of all of it, kept.
    """

    lanes: Lanes
    offset: tuple[float, float] = (0.0, 0.0)
    first: int = 0
    whole: tuple[int, int] | None = None


@dataclass
class Numbers:
    """What changes from picture to picture: arrays of one number each.

    Attributes
    ----------
    vectors : list of lists of arrays
        The camera's.
    places : list of [array, array]
        Along both axes: the width of a pixel, and where the middle of the picture is.
    ending : Cutoff or None
        When rays stop.
    tolerance : tuple of arrays
        What a segment may be off by, of schemes that control it.
    """

    vectors: list[list[Any]]
    places: list[list[Any]]
    ending: Cutoff | None
    tolerance: tuple[Any, ...]


class Found:
    """What rays find, and where they stopped early: computed when, and whenever, it is written."""

    def __init__(self, path: Path, early: Any, lanes: Lanes) -> None:
        numbers = path.emission + path.transparency + path.depth + path.error
        kind = type(path.transparency[0] if path.transparency else numbers[0])
        self.numbers = [flush_subnormal(number, MARGIN) for number in numbers]
        self.numbers.append(dr.select(early, kind(1), 0))
        self.lanes, self.path = lanes, path

    def write(self, rows: list[Any], first: int) -> None:
        """Write all numbers to where they belong, the results of the first ray to a place."""
        # Dr.Jit puts what belongs to an older scope first: kernels would differ between what was
        # traced now and before. What another thread traced has to be in one.
        dr.detail.new_scope(dr.backend_v(rows[0]))
        target = self.lanes.target + dr.opaque(type(self.lanes.target), first)
        for row, number in zip(rows, self.numbers, strict=True):
            dr.scatter(row, number, target, self.lanes.there)
        dr.eval(rows)
