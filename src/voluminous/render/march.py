"""The one ray loop: grid walk → scheme ← medium, folded into a path."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ..backend import dr

from ..grids.contract import Ray
from .path import Path, over


@dataclass
class Cutoff:
    """When a front-to-back ray stops: what is behind can no longer matter.

    A ray stops where its transparency is at most `transparency`, or where that times `behind`, the
    most that can come from behind, is at most `fraction` of what it has gathered.
    """

    transparency: Any
    behind: list[Any]
    fraction: Any

    def reached(self, path: Path) -> Any:
        """Return the lanes that may stop."""
        grey = len(path.transparency) == 1
        rest = [
            path.transparency[0 if grey else c] * most for c, most in enumerate(self.behind)
        ]
        return (_largest(path.transparency) <= self.transparency) | (
            _largest(rest) < self.fraction * _largest(path.emission)
        )


@dataclass
class State:
    """What goes round the loop."""

    cursor: Any
    carried: list[Any]
    path: Path


def march(
    walk: Any, source: Any, scheme: Any, ray: Ray, path: Path, cutoff: Cutoff | None, backward: bool
) -> tuple[Path, Any]:
    """Follow rays through the volume and return their paths, and the lanes that stopped early.

    Parameters
    ----------
    walk, source, scheme
        How to step, what the medium is, and how one segment is solved.
    ray : Ray
        Rays to follow; they run towards the camera if `backward`.
    path : Path
        What the rays have gathered before: a chunk goes on where the one before it stopped.
    cutoff : Cutoff or None
        When to stop early (only away from the camera).
    backward : bool
        Fold back to front.
    """
    track, cursor = walk.enter(ray)
    state = State(cursor, scheme.start(source, walk, track, cursor), path)

    def going_on(state: State) -> Any:
        if cutoff is None:
            return state.cursor.inside
        return state.cursor.inside & ~cutoff.reached(state.path)

    def step(state: State) -> tuple[State]:
        segment, cursor = walk.next(track, state.cursor)
        solution, carried = scheme.solve(source, walk, track, segment, state.carried, backward)
        front, back = (solution, state.path) if backward else (state.path, solution)
        return (State(cursor, carried, over(front, back)),)

    (state,) = dr.while_loop((state,), going_on, step, label=f"{scheme.name} march")
    return state.path, state.cursor.inside


def _largest(values: list[Any]) -> Any:
    largest = values[0]
    for value in values[1:]:
        largest = dr.maximum(largest, value)
    return largest
