"""How a surface lies in the light of a ray: the angles between its normal and the ray."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ..backend import dr
from ..expressions import Expression
from .front_light import change_across
from .modulation import Middle, kept
from .shade import HEADLIGHT, Light
from .stretch import NODES, extremes

if TYPE_CHECKING:
    from .context import Context
    from .stretch import Panel, Stretch

# What the cosine of ray and normal may change by within a panel.
_TURN = 0.1
# What a curve may be off by between two places of Gauss and Legendre, of its second difference.
_CURVED = 0.125


@dataclass(frozen=True)
class Lamp:
    """Lamps: at the camera, or in fixed directions.

    Attributes
    ----------
    normal : list of three Expression
        The components of the gradient.
    shading : float
        Which part of the light is the lamps'; at 0 there are none.
    lights : sequence of (direction or "headlight", weight)
        As in `Shade`.
    """

    normal: list[Expression]
    shading: float
    lights: tuple[Light, ...] = ((HEADLIGHT, 1.0),)

    def shade(self, panel: Panel, context: Context, middle: Middle) -> Any:
        """Return how bright a surface of some width looks on a panel.

        The mean of two places (Gauss-Legendre) in what the panel has of it: the normal turns in it,
        whether that is a small part of the panel or all of it.
        """
        if self.shading == 0:
            return 1.0
        share = self._share(context)
        way = dr.sqrt(middle.spread * middle.place * (1.0 - middle.place))
        first, last = (
            self._cosine(panel.fields(f), panel.stretch, context)
            for f in (middle.place - way, middle.place + way)
        )
        return 1.0 - share + 0.5 * share * (first + last)

    def light(self, fields: dict[str, Any], stretch: Stretch, context: Context) -> Any:
        """Return how bright the surface looks at a place of a stretch, with these fields."""
        if self.shading == 0:
            return 1.0
        share = self._share(context)
        return 1.0 - share + share * self._cosine(fields, stretch, context)

    def off(self, stretch: Stretch, context: Context) -> Any:
        """Return what light may be off by in a surface of some width, as a part of its emission.

        A panel and its halves look at the same places where the surface is all in one of them.
        """
        if self.shading == 0:
            return stretch.length * 0.0
        first, middle, last = self._lit(stretch, context)
        return _CURVED * self._share(context) * dr.abs(first - 2.0 * middle + last)

    def across(self, stretch: Stretch, context: Context, extent: Any, depth: Any) -> Any:
        """Return what light may be off by in a surface that absorbs: its front is seen most.

        Parameters
        ----------
        extent, depth : array
            What part of a half of the stretch the surface takes, and its optical depth there.
        """
        share = self._share(context)
        nodes = [[1.0 - share + share * lit] for lit in self._lit(stretch, context)]
        return change_across(nodes, extent, depth)

    def turns(self, stretch: Stretch, context: Context) -> Any:
        """Return where the normal turns by so much that a few places do not show its way."""
        if self.shading == 0:
            return stretch.length < 0.0
        low, high = extremes(self._lit(stretch, context))
        return high - low > _TURN

    def _share(self, context: Context) -> Any:
        return context.keep(("shading", self.shading), lambda: context.narrow_number(self.shading))

    def _lit(self, stretch: Stretch, context: Context) -> list[Any]:
        """Return the cosine of ray and normal at both ends and in the middle; computed once."""
        return kept(
            stretch,
            ("lit", self.normal[0].text, self.lights),
            lambda: [self._cosine(stretch.fields(s), stretch, context) for s in NODES],
        )

    def _cosine(self, fields: dict[str, Any], stretch: Stretch, context: Context) -> Any:
        across = _scaled([context.evaluate(e, fields) for e in self.normal], context)
        found = 0.0
        for direction, weight in self.lights:
            if direction == HEADLIGHT:
                way = _scaled([stretch.cubics[axis][1] for axis in "xyz"], context)
            else:
                way = [context.narrow_number(d) for d in direction]
            cosine = lambert(across, way)
            one = self.lights == ((HEADLIGHT, 1.0),)
            found = cosine if one else found + context.narrow_number(weight) * cosine
        return found


def lambert(across: list[Any], way: list[Any]) -> Any:
    """Return the cosine between two directions, on either side; one if there is no normal."""
    size = dr.sqrt(_dot(across, across) * _dot(way, way))
    cosine = dr.abs(_dot(across, way)) / dr.select(size > 0.0, size, 1.0)
    return dr.select(size > 0.0, cosine, 1.0)


def _scaled(vector: list[Any], context: Context) -> list[Any]:
    """Return a vector over its largest component: squares of gradients in g/cm⁴ underflow."""
    x, y, z = (dr.abs(v) for v in vector)
    most = dr.maximum(x, dr.maximum(y, z))
    return [context.narrow(v / dr.select(most > 0.0, most, 1.0)) for v in vector]


def _dot(a: list[Any], b: list[Any]) -> Any:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
