"""What lies in front of a stretch of ray, and what that leaves it to be off by.

A stretch may be off by a share of what is left of a pixel's error, so that the sum stays below it
however many there are. Where all had the same share, a tenth to a quarter of the pixels of
colormaps in turbulent fields was drawn twice.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ..backend import dr
from .path import Path, most

# A stretch may always be off by that part of what the first one may.
_LEAST = 0.2


@dataclass
class InFront:
    """What lies in front of a stretch, as far as the walk has come by there.

    Attributes
    ----------
    transparency : array
        The largest of what it lets through; one where the walk goes towards the observer.
    spent : array
        How far it may be off, as a part of what the whole pixel may.
    """

    transparency: Any
    spent: Any

    def allows(self, source: Any, wrong: Any, dim: Any) -> tuple[Any, Any]:
        """Return where a stretch behind it may be off by so much: its emission, transparency."""
        allowed, allowed_dim, _ = source.tolerance
        left = 1.0 - self.spent
        left = dr.select(left > _LEAST, left, _LEAST)
        through = self.transparency
        return through * wrong <= left * allowed, through * dim <= left * allowed_dim

    def with_stretch(self, source: Any, path: Path, backward: bool) -> InFront:
        """Return it with a stretch that was solved."""
        allowed, allowed_dim, share = source.tolerance
        wrong, dim, _ = path.error
        parts = wrong / allowed + dim / allowed_dim
        spent = dr.fma(share * self.transparency, parts, self.spent)
        through = self.transparency if backward else self.transparency * most(path.transparency)
        return InFront(through, spent)
