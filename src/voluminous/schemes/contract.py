"""What a scheme promises: how ONE segment is solved.

The transfer equation over a segment gives an emission b and a transparency θ per channel (design
section 1). A scheme says what it needs of the volume beforehand, what it carries along a ray from
one segment to the next, and how it gets (b, θ) from both.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol


@dataclass
class Solution:
    """One segment solved: emission per channel; transparency and optical depth per extinction."""

    emission: list[Any]
    transparency: list[Any]
    depth: list[Any]


class Scheme(Protocol):
    """How a segment is solved. `front` is the end nearer to the camera."""

    name: str
    order: int
    place: str  # "cell" or "vertex": where the coefficients are tabulated
    linear: bool  # the emission is linear in the emissivity, whatever the extinction
    reckoned: bool  # in double precision the last bits of positions are to be RADMC-3D's

    def start(self, source: Any, walk: Any, track: Any, cursor: Any) -> list[Any]:
        """Return what is carried along the ray, where it enters (a list of arrays)."""

    def solve(
        self, source: Any, walk: Any, track: Any, segment: Any, carried: list[Any], backward: bool
    ) -> tuple[Solution, list[Any]]:
        """Return the segment's solution, and what to carry on.

        ``backward`` is True if the walk runs towards the camera: then the end of the segment
        is its front.
        """
