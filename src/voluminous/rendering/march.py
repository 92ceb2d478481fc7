"""The ray loop: grid walk → scheme ← medium, composed into a path."""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any

from ..backend import dr
from ..backend.functions import loop
from ..backend.types import Float, Int, Mask
from ..grids.contract import Ray, Segment
from ..schemes.base import Position, Scheme, Source
from ..schemes.path import Path, most, over


@dataclass
class Cutoff:
    """Criterion at which a front-to-back ray stops because the rest is negligible.

    A ray stops where ``transparency · behind < Σ weight · emission + least``: `behind` bounds the
    intensity from behind, and the sum is an allowed fraction of the intensity gathered so far. With
    ``behind = 1`` and no weights it stops at transparency `least`. If there is one `behind` for
    each channel of a spectrum, a ray stops where all of them may.
    """

    behind: list[Float]
    weights: list[Float]
    least: Float

    def reached(self, path: Path) -> Mask:
        if len(self.behind) > 1:
            return self._every(path)
        brightest, enough = most(path.transparency), self.least
        for weight, b in zip(self.weights, path.emission, strict=False):
            enough = dr.fma(weight, b, enough)
        return brightest * self.behind[0] < enough

    def _every(self, path: Path) -> Mask:
        through, count = path.transparency, len(self.behind)
        through = through if len(through) > 1 else through * count
        rows = zip(through, self.behind, self.weights, path.emission, strict=True)
        # Channels without emission are not waited for.
        stops = (t * behind <= weight * b for t, behind, weight, b in rows)
        return functools.reduce(operator.and_, stops)


@dataclass
class RayState:
    """State of rays, passed from one piece of a domain to the next.

    Attributes
    ----------
    carried : list of arrays or None
        The scheme's state, carried from segment to segment; None before the first piece.
    begun, over : array of Bool or None
        Lanes that have entered a piece (the scheme starts the others where they enter), and that
        have reached the cut-off; None if there are none.
    cursor : cursor or None
        Where lanes wait in the whole grid, of walks confined to some leaves of a tree.
    moved : array of Bool or None
        Lanes that come through a gap between stretches to where they enter next.
    """

    path: Path
    carried: list[Float] | None = None
    begun: Mask = None
    over: Mask = None
    cursor: Any = None
    moved: Mask = None


@dataclass
class MarchState:
    """The state of the loop; `over` are the lanes that reached the cut-off."""

    cursor: Any
    carried: list[Float]
    path: Path
    over: Mask


def march(
    walk: Any, source: Source, scheme: Scheme, ray: Ray, before: RayState, *how: Any
) -> MarchState:
    """Trace rays through the volume, one stretch after another, and return their final state.

    The cursor of a ray that stopped early is still inside.
    """
    if ray.stretches is None:
        return _march(walk, source, scheme, ray, before, *how)
    for stretch in ray.stretches:
        end = _march(walk, source, scheme, ray.confined(*stretch), before, *how)
        lanes = end.cursor.inside | True
        before = RayState(end.path, end.carried, lanes, end.over, moved=lanes)
    return replace(end, cursor=replace(end.cursor, inside=end.cursor.inside | end.over))


def _march(
    walk: Any,
    source: Source,
    scheme: Scheme,
    ray: Ray,
    before: RayState,
    cutoff: Cutoff | None,
    backward: bool,
    hidden: Int | None = None,
) -> MarchState:
    """Trace rays through a stretch; they pass cells that are `hidden`, in bits, as gaps."""
    track, cursor = walk.enter(ray)
    never = cursor.inside & False
    carried = scheme.start(here := Position(walk, track, cursor), source)
    if before.carried is not None:
        carried = dr.select(before.begun, before.carried, carried)
        if before.moved is not None:
            carried = scheme.after_skip(here, source, carried, before.moved & cursor.inside)
    state = MarchState(cursor, carried, before.path, never if before.over is None else before.over)

    def going_on(state: MarchState) -> Mask:
        return state.cursor.inside & ~state.over

    def step(state: MarchState) -> tuple[MarchState]:
        segment, cursor = walk.next(track, state.cursor)
        segment.ray, segment.walk, segment.track = ray, walk, track
        segment.entry, segment.backward = state.cursor, backward
        if hidden is not None:
            segment.hidden = _in_bits(hidden, segment)
            segment.active &= ~segment.hidden
            segment.length = dr.select(segment.hidden, 0.0, segment.length)
        solution, carried = scheme.solve(segment, source, state.carried)
        if segment.unsolved is not False:
            cursor = dr.select(segment.unsolved, state.cursor, cursor)
        if hidden is not None:
            carried = scheme.after_skip(
                Position(walk, track, cursor), source, carried, segment.hidden
            )
        front, back = (solution, state.path) if backward else (state.path, solution)
        # The path BEFORE this segment is tested, so that the next look-up need not wait for this
        # segment's exponential (first order: 32 instead of 43 ms; one more segment is harmless).
        reached = never if cutoff is None else cutoff.reached(state.path)
        return (MarchState(cursor, carried, over(front, back), reached),)

    bricks = source.skipping.bricks
    skip = walk.skipper(track, bricks)
    coarse = bricks is not None and bricks.coarse

    def visit(state: MarchState) -> tuple[MarchState]:
        """Skip empty space, then cross the brick, or the cells up to a gap, that may be visible."""
        skipped = skip(state.cursor)
        here = Position(walk, track, skipped.cursor)
        carried = scheme.after_skip(here, source, state.carried, skipped.moved)

        def within(state: MarchState) -> Mask:
            return going_on(state) & skipped.holds(state.cursor)

        entered = MarchState(skipped.cursor, carried, state.path, state.over)
        if coarse or source.backend.derivatives:
            # One step crosses most bricks: a loop over their cells takes longer than returning to
            # the outer loop (core, 100³: 20 ms with it, 17 ms without).
            (left,) = step(entered)
            return (dr.select(going_on(entered), left, entered),)
        (left,) = loop((entered,), within, step, label=f"{scheme.name} cells")
        return (left,)

    body = step if skip is None else visit
    end: MarchState
    (end,) = loop((state,), going_on, body, label=f"{scheme.name} march")
    return end


def _in_bits(bits: Int, segment: Segment) -> Mask:
    cell = segment.own_cell
    word = dr.gather(type(bits), bits, cell >> 5, segment.active)
    return segment.active & ((word >> (cell & 31)) & 1 == 1)


def hand_on(before: RayState, entered: Mask, after: MarchState) -> RayState:
    """Return the rays' state for the next piece, given the lanes that `entered` this one."""
    begun = entered if before.begun is None else before.begun | entered
    cursor = None if before.cursor is None else after.cursor
    moved = None if before.moved is None else before.moved & ~entered
    return RayState(after.path, after.carried, begun, after.over, cursor, moved)


def arrays_in(tree: Any) -> Iterator[Any]:
    """Yield the arrays in lists and dataclasses."""
    if isinstance(tree, list):
        for part in tree:
            yield from arrays_in(part)
    elif is_dataclass(tree):
        for field in fields(tree):
            yield from arrays_in(getattr(tree, field.name))
    elif tree is not None:
        yield tree


def mapped(function: Callable[[Any], Any], tree: Any) -> Any:
    """Return a tree of what a function makes of its arrays."""
    if isinstance(tree, list):
        return [mapped(function, part) for part in tree]
    if is_dataclass(tree) and not isinstance(tree, type):
        parts = {f.name: mapped(function, getattr(tree, f.name)) for f in fields(tree)}
        return replace(tree, **parts)
    return None if tree is None else function(tree)
