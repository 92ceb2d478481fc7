"""Colours and gates that are looked up inside shells: what panels do not show of them.

Two things, each where a panel and its halves agree and are wrong: more is seen of the front of an
opaque shell than of its back (`front_light`), and where the scalar bends the shell is not where a
line passes it (`unseen_place`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from .front_light import unseen_change
from .unseen_place import misplaced_change

if TYPE_CHECKING:
    from ..expressions import Expression
    from .context import Context
    from .modulation import Modulation
    from .stretch import Stretch


@dataclass
class LookedUp:
    """Shells of one scalar on a stretch of ray.

    Attributes
    ----------
    expr : Expression
        The scalar.
    ranges : list of pairs of arrays
        Between which of its values they are seen.
    thin : array or float
        How thin they are, from 0 to 1: where the middle of a wide one is, bends do not matter.
    extent : array
        What part of the steeper half of the stretch one takes.
    depth : array
        Its optical depth in a half; zero where its colour cannot vary unseen.
    """

    expr: Expression
    ranges: list[tuple[Any, Any]]
    thin: Any
    extent: Any
    depth: Any

    def error(self, modulation: Modulation, stretch: Stretch, context: Context) -> Any:
        """Return the relative error of emission and extinction that panels do not show."""
        misplaced, _ = self._misplaced(modulation, stretch, context)
        return misplaced + unseen_change(modulation, stretch, context, self.extent, self.depth)

    def lost(self, modulation: Modulation, stretch: Stretch, context: Context) -> Any:
        """Return where that says nothing, and panels must be narrower."""
        return self._misplaced(modulation, stretch, context)[1]

    def _misplaced(
        self, modulation: Modulation, stretch: Stretch, context: Context
    ) -> tuple[Any, Any]:
        return misplaced_change(modulation, stretch, context, self.expr, self.ranges, self.thin)
