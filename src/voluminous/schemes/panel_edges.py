"""Panels that end where the medium has an edge, and the surfaces that may be there.

A panel ends just beyond an edge: the next one begins on the other side. Where a medium is nothing
but surfaces without width, those that are alone in a panel need not be at its end.
"""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import Any

from ..backend import dr
from ..backend.functions import precision_of
from ..media.edges import edges_ahead, first_edge
from .panels import Piece
from .path import Path, over

# How far behind an edge a panel ends, as a part of the segment: beyond what rounding makes of it.
# With 2^-16 in single precision shells behind gates were off by up to 1e-4 of the maximum.
_BEHIND = {"single": 2.0**-20, "double": 2.0**-32}


def surface_alone(
    source: Any, whole: Any, cubics: Any, known: Any, length: Any, nothing: Path
) -> tuple[Path, Any]:
    """Return a segment of nothing but surfaces without width, and where there is one at most."""
    count, hidden = edges_ahead(whole, source.edges)
    good = ~hidden & (count < 2)
    real = type(length)
    piece = Piece(cubics, length, real(0), real(1), [[v[0], v[-1]] for v in known])
    return with_layer(source, False, piece, good & (count > 0), nothing), good


def up_to_edge(source: Any, piece: Piece, known: Any) -> tuple[Piece, Any, Any]:
    """Return a panel up to the first edge that shows, where there is one, and where some may hide.

    Parameters
    ----------
    source : Interpolated
        Where coefficients are from.
    piece : Piece
        The panel.
    known : list of lists of arrays
        The scalars at places of the segment, its ends among them.
    """
    nowhere = piece.width < 0.0
    if not source.edges:
        return piece, nowhere, nowhere
    seen = ~nowhere
    if not source.hollow:
        seen, _ = source.visible(piece.stretch(source, edgeless=False))
    return dr.if_stmt(
        args=(piece, known, nowhere),
        cond=seen,
        true_fn=functools.partial(_looked_ahead, source),
        false_fn=_unchanged,
    )


def _unchanged(piece: Piece, known: Any, nowhere: Any) -> tuple[Piece, Any, Any]:
    return piece, nowhere, nowhere


def _looked_ahead(source: Any, piece: Piece, known: Any, nowhere: Any) -> tuple[Piece, Any, Any]:
    count, hidden = edges_ahead(piece.stretch(source, edgeless=False), source.edges)
    piece = dr.if_stmt(
        args=(piece, known),
        cond=count > (1 if source.hollow else 0),
        true_fn=functools.partial(_cut, source),
        false_fn=_whole,
    )
    return piece, count > 0, hidden


def _whole(piece: Piece, known: Any) -> Piece:
    return piece


def _cut(source: Any, piece: Piece, known: Any) -> Piece:
    place = first_edge(piece.stretch(source, edgeless=False), source.edges)
    end = dr.fma(place, piece.width, _BEHIND[precision_of(type(place))])
    width = dr.select(end < piece.width, end, piece.width)
    return replace(piece, width=width).ending(source, known)


def with_layer(source: Any, backward: bool, piece: Piece, passed: Any, found: Path) -> Path:
    """Return a panel with the surfaces without width at its end, where one is passed."""
    if not source.layered:
        return found
    return dr.if_stmt(
        args=(piece, found),
        cond=passed,
        true_fn=functools.partial(_layered, source, backward),
        false_fn=_bare,
    )


def _bare(piece: Piece, found: Path) -> Path:
    return found


def _layered(source: Any, backward: bool, piece: Piece, found: Path) -> Path:
    stretch, place = piece.stretch(source), 1.0
    if source.hollow and source.looks_inside:
        place = first_edge(stretch, source.edges)
    layer = source.layer(stretch, place)
    zero = piece.length * 0.0
    layer.error = [zero, zero, source.numbers.brightness(layer.emission)]
    return over(layer, found) if backward else over(found, layer)
