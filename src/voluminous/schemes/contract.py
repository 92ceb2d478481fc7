"""What a scheme promises: how ONE segment is solved.

The transfer equation over a segment gives an emission b and a transparency θ per channel (design
section 1). A scheme says what it needs of the volume beforehand, what it carries along a ray from
one segment to the next, and how it gets (b, θ) from both.
"""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any, Protocol

from .path import Path

# One segment solved is a stretch of path like any other.
Solution = Path


class Scheme(Protocol):
    """How a segment is solved. `front` is the end nearer to the camera."""

    name: str
    order: int
    place: str  # "cell", "vertex": where coefficients are tabulated; "field": fields, interpolated
    linear: bool  # the emission is linear in the emissivity, whatever the extinction
    controlled: bool  # it keeps to a tolerance, and tells the error (`Path.error`)
    coarseness: (
        float  # "field": scalars may be off by that part of a structure's width; 0: by nothing
    )
    reckoned: bool  # in double precision the last bits of positions are to be RADMC-3D's

    # Besides, if need be: `complete` (leave nothing out because it is faint), `everywhere` (visit
    # empty cells too), `passed` (see `carried_beyond`), `key` (see `Keyed`).

    def start(self, source: Any, walk: Any, track: Any, cursor: Any) -> list[Any]:
        """Return what is carried along the ray, where it enters (a list of arrays)."""

    def leapt(
        self, source: Any, walk: Any, track: Any, cursor: Any, carried: list[Any], moved: Any
    ) -> list[Any]:
        """Return what is carried by rays some of which crossed empty space (a mask).

        The cursor is where they are now.
        """

    def solve(
        self, source: Any, walk: Any, track: Any, segment: Any, carried: list[Any], backward: bool
    ) -> tuple[Solution, list[Any]]:
        """Return the segment's solution, and what to carry on.

        ``backward`` is True if the walk runs towards the camera: then the end of the segment
        is its front.
        """


class Keyed:
    """A scheme of which its class and its attributes tell all."""

    def key(self) -> Hashable:
        """Return what identifies it: what was traced is launched again for an equal key.

        None if nothing does: what steers a class of somebody else's may change unseen.
        """
        own = type(self).__module__.rpartition(".")[0] == __package__
        return (type(self).__name__, *sorted(vars(self).items())) if own else None


def scheme_key(scheme: Any) -> Hashable:
    """Return what identifies a scheme, or None; see `Keyed`."""
    return scheme.key() if hasattr(scheme, "key") else None


def carried_beyond(scheme: Any, carried: list[Any], onward: list[Any]) -> list[Any]:
    """Return what a scheme carries on from a segment whose solution is left out.

    Parameters
    ----------
    scheme : Scheme
        Its method ``passed(carried, onward)`` tells, if it has one: what follows from where the ray
        is goes on, what was gathered stays as it was.
    carried, onward : list of arrays
        What was carried to the segment, and what would be carried on if it had been seen.
    """
    passed = getattr(scheme, "passed", None)
    return onward if passed is None else passed(carried, onward)
