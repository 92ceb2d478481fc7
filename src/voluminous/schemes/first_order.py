"""First order: emissivity and extinction are constant in a cell. Exact for such a medium."""

from __future__ import annotations

from ..backend.functions import attenuation
from ..backend.types import Float
from ..grids.contract import Segment
from .base import CellSource, Scheme, Solution


class FirstOrder(Scheme[CellSource]):
    """Solve a homogeneous segment: θ = e^{-α s}, b = j (1 - e^{-α s}) / α.

    The formal solution of the transfer equation with constant coefficients (e.g. Rybicki &
    Lightman 1979, equation 1.30), in a form that is accurate for every optical depth and is
    b = j s for a pure emitter.
    """

    name = "first-order"
    order = 1

    def solve(
        self, segment: Segment, source: CellSource, carried: list[Float]
    ) -> tuple[Solution, list[Float]]:
        j, alpha = source.at(segment)
        depth = [a * segment.length for a in alpha]
        solved = [attenuation(tau) for tau in depth]
        visible = [mean * segment.length for _, mean in solved]
        emission = [jc * visible[c if len(visible) > 1 else 0] for c, jc in enumerate(j)]
        return Solution(emission, [theta for theta, _ in solved], depth), carried
