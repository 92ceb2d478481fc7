"""What walks through a box have in common: when rays enter it and leave."""

from __future__ import annotations

from typing import Any

from ..backend import dr
from .axes import NEVER
from .contract import Ray, Walk


class BoxWalk(Walk):
    """Rays through a box between planes of x, y and z, however it is divided into cells.

    Attributes
    ----------
    axes : list of three Axis
    scale, to_scale : array
        The unit of distances in the volume's unit, and one over it.
    """

    axes: list[Any]
    to_scale: Any

    def enter(self, ray: Ray) -> tuple[Any, Any]:
        """Return the track and the cursor at the point where each ray enters the domain."""
        Wide = self.backend.Wide
        sides = [
            axis.side(o, d) for axis, o, d in zip(self.axes, ray.origin, ray.direction, strict=True)
        ]
        arrive = dr.maximum(dr.maximum(sides[0].arrive, sides[1].arrive), sides[2].arrive)
        leave = dr.minimum(dr.minimum(sides[0].leave, sides[1].leave), sides[2].leave)
        first = None if ray.first is None else ray.first * self.to_scale
        last = None if ray.last is None else ray.last * self.to_scale
        start = arrive if first is None else dr.maximum(arrive, first)
        inside = start < (leave if last is None else dr.minimum(leave, last))
        if ray.active is not None:
            inside &= ray.active
        # A ray that misses starts somewhere finite, so that no lane computes with infinities.
        arrive = dr.select(inside, arrive, Wide(0))
        begin = dr.select(inside, start, Wide(0)) - arrive
        bound = None if last is None else self.backend.Float(dr.minimum(last - arrive, NEVER))
        return self._start(sides, arrive, begin, inside, bound)

    def _start(self, sides: Any, arrive: Any, begin: Any, inside: Any, bound: Any) -> Any:
        """Return track and cursor of rays that reach the box, and start `begin` later."""
        raise NotImplementedError
