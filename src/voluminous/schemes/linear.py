"""Coefficients that are linear along a segment: what second order and Olson-Kunasz share."""

from __future__ import annotations

from typing import Any


def start_values(source: Any, walk: Any, track: Any, cursor: Any) -> list[Any]:
    """Return the coefficients where the ray enters: carried along, each wall is looked up once."""
    return list(source.interpolate(walk.entry_corners(track, cursor), cursor.inside))


def end_values(
    source: Any, walk: Any, track: Any, segment: Any, carried: list[Any], backward: bool
) -> tuple[list[Any], list[Any], list[Any]]:
    """Return the coefficients at the segment's front, at its back, and where the walk goes on."""
    reached = list(source.interpolate(walk.exit_corners(track, segment), segment.active))
    front, back = (reached, carried) if backward else (carried, reached)
    return front, back, reached
