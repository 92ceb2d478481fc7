"""A segment in panels that are as wide as the medium lets them be, from its beginning to its end.

Panels end where the medium has an edge (`panel_edges`). Where it is smooth one is solved with
samples, the error of which is bounded (`smooth_segment`). In closed form, and compared with its two
halves (`halving`), it is solved where the medium is not smooth; where it is so dense that only the
front of a panel shows; where its scalars are linear, since there closed forms are exact; and where
there were too many panels.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

from ..backend import dr
from .halving import attempt
from .in_front import InFront
from .panel_edges import up_to_edge, with_layer
from .panels import Piece, known_stretch, next_panel
from .path import Path, empty_path, most, over
from .smooth_segment import smooth_segment

# Panels are not made narrower than this fraction of a segment. With 2^-8 in single precision, three
# surfaces of noise in a 500th of a cell were off by 0.1 of the maximum, in more time; where panels
# at jumps of gates stopped there, in 0.7 of the time, 4 to 28 % of pixels were beyond their error.
_NARROWEST = 2.0**-14
# What is no number in panels as narrow as that is none in narrower ones: of a negative extinction
# pictures of 20 x 20 pixels took minutes until they were refused.
_NO_NUMBER = 2.0**-4
# Scalars are linear along a segment if their slope changes by less than this part of it.
_STRAIGHT = 0.01
# Shells so much thinner than a segment are not sampled: the closed forms of `attempt` have no width
# that is too small. Shells of noise as wide as a third to a thirtieth of a cell take a half to a
# quarter of the time with samples.
_SAMPLED = 2.0**-6
# Optical depths of segments that are not sampled: attenuation by samples is that of thin panels.
_DENSE = 2.0


@dataclass
class Progress:
    """How far the panels of one segment are: where, how wide, and what has been gathered."""

    begin: Any
    width: Any
    scalars: list[Any]
    path: Path


def in_panels(
    source: Any,
    backward: bool,
    widest: float,
    cubics: Any,
    known: Any,
    length: Any,
    in_front: InFront,
    nothing: Path,
    found: Path,
) -> Path:
    """Return a segment solved in panels that are narrow enough.

    The first of them is as wide as `widest` of the segment, if it can be.
    """
    real = type(length)
    closed = most(found.depth) > _DENSE
    if source.linear:
        closed |= _straight(source, cubics, known, length)

    def going_on(state: Progress) -> Any:
        return state.begin < 1.0

    def step(state: Progress) -> tuple[Progress]:
        pairs = [[value, value] for value in state.scalars]
        piece = Piece(cubics, length, state.begin, state.width, pairs).ending(source, known)
        piece, passed, hidden = up_to_edge(source, piece, known)
        seen = in_front.with_stretch(source, state.path, backward)
        found, good = _solved(source, backward, piece, seen, closed)
        good &= ~hidden | (piece.width <= _NARROWEST)
        found = with_layer(source, backward, piece, good & passed, found)
        front, back = (found, state.path) if backward else (state.path, found)
        panel = next_panel(good, state.begin, piece.width, state.width)
        scalars = [dr.select(good, end, start) for start, end in piece.scalars]
        return (Progress(*panel, scalars, dr.select(good, over(front, back), state.path)),)

    starts = [values[0] for values in known]
    state = Progress(real(0), real(widest), starts, nothing)
    (state,) = dr.while_loop((state,), going_on, step, label="panels")
    return state.path


def _straight(source: Any, cubics: Any, known: Any, length: Any) -> Any:
    whole = known_stretch(source, cubics, known, length, rough=True)
    found = length >= 0.0
    for expr in source.scalars:
        slope, bend, _ = whole.derivatives(expr)
        found &= bend <= _STRAIGHT * slope
    return found


def _solved(
    source: Any, backward: bool, piece: Piece, seen: InFront, closed: Any
) -> tuple[Path, Any]:
    if source.hollow:
        return _nothing(source, piece), piece.width > 0.0
    if not source.finer:
        return _compared(source, backward, piece, seen)
    return dr.if_stmt(
        args=(piece, seen),
        cond=closed | (piece.width < _SAMPLED),
        true_fn=functools.partial(_compared, source, backward),
        false_fn=functools.partial(_sampled, source, backward),
    )


def _nothing(source: Any, piece: Piece) -> Path:
    numbers = source.numbers
    return empty_path(type(piece.length), numbers.emissions, numbers.extinctions, 3)


def _sampled(source: Any, backward: bool, piece: Piece, seen: InFront) -> tuple[Path, Any]:
    found, good = smooth_segment(source, piece.stretch(source), seen, backward, fine=True)
    return found, good


def _compared(source: Any, backward: bool, piece: Piece, seen: InFront) -> tuple[Path, Any]:
    part = piece.stretch(source)
    least = piece.width <= _NARROWEST
    found, good = attempt(source, part, seen, backward, least)
    _, hidden = source.visible(part)
    no_number = dr.isnan(found.error[0] + found.error[1]) & (piece.width <= _NO_NUMBER)
    return found, (good & ~hidden) | least | no_number
