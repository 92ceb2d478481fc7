"""Panels: parts of a segment that are as wide as the medium lets them be."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from ..backend import dr


@dataclass
class Piece:
    """A segment's fields as polynomials, its length, and a panel of it.

    Attributes
    ----------
    cubics : dict of str to list of arrays
        The fields along the segment.
    length : array
        Length of the segment.
    begin, width : array
        Where the panel begins and how wide it is, as parts of the segment.
    scalars : list of pairs of arrays
        The medium's scalars at both ends of the panel.
    """

    cubics: Any
    length: Any
    begin: Any
    width: Any
    scalars: list[Any]

    def stretch(self, source: Any, *, edgeless: bool = True) -> Any:
        """Return the panel as a stretch of its own; with edges inside, or none.

        Media that tell no edges may have some.
        """
        part = self._part(source)
        part.edgeless = edgeless and bool(source.edges)
        for expr, (first, last) in zip(source.scalars, self.scalars, strict=True):
            part.set_scalar(expr, 0.0, first)
            part.set_scalar(expr, 1.0, last)
        return part

    def ending(self, source: Any, known: Any) -> Piece:
        """Return it with the scalars where it ends.

        To the last bit where the next segment begins, lest a crossing be counted twice.

        Parameters
        ----------
        known : list of lists of arrays
            The scalars at places of the segment, its ends among them.
        """
        part, last = self._part(source), self.begin + self.width >= 1.0
        ends = [
            dr.select(last, values[-1], part.scalar(expr, 1.0))
            for expr, values in zip(source.scalars, known, strict=True)
        ]
        pairs = [[first, end] for (first, _), end in zip(self.scalars, ends, strict=True)]
        return replace(self, scalars=pairs)

    def _part(self, source: Any) -> Any:
        return source.stretch(self.cubics, self.length).part(self.begin, self.width)


def next_panel(good: Any, begin: Any, width: Any, tried: Any) -> tuple[Any, Any]:
    """Return where the panel begins that comes after one, and how wide it is, in segments.

    One that is good enough is left behind, and the next tried twice as wide, if there is room;
    another is tried again, half as wide. Where it was narrower than `tried`, for an edge, the next
    is tried as wide as that.
    """
    begin = dr.select(good, begin + width, begin)
    wider = dr.select(2.0 * width > tried, 2.0 * width, tried)
    width = dr.select(good, wider, 0.5 * width)
    return begin, dr.select(width < 1.0 - begin, width, 1.0 - begin)


def known_stretch(source: Any, cubics: Any, known: Any, length: Any, *, rough: bool = False) -> Any:
    """Return a segment's stretch with what was computed of it outside of a branch."""
    whole = source.stretch(cubics, length, rough=rough)
    for expr, values in zip(source.scalars, known, strict=True):
        whole.set_known(expr, values)
    return whole
