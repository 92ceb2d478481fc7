"""A stretch of ray on which fields are polynomials of the distance, and media are integrated.

What schemes that classify interpolated fields ask of a medium is its mean emissivity and extinction
over a panel, a part of a stretch over which its scalars may be taken as linear (`Medium.means`).
"""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ..backend import dr
from ..backend.functions import horner
from ..expressions import Expression, Margin
from .context import Context
from .turning import Turning, enclosed, is_cubic, spread

# Where the scalars of a stretch are known: its panels lie between two of these.
NODES = (0.0, 0.5, 1.0)
# What is without width counts on panels of at least this length, in cells.
_SHORTEST = 1e-20
Cubic = Sequence[Any]  # coefficients of 1, s, s², s³; or fewer


class Stretch:
    """A piece of a ray, s from 0 to 1 along the walk.

    Parameters
    ----------
    cubics : dict of str to sequence of arrays
        Coefficients of every field as a polynomial of s, lowest power first.
    context : Context
        How expressions are evaluated.
    length : array
        Its length, in units of the grid's scale.
    rough : bool
        It need not be known closely where expressions are: it is asked where something may show.

    Attributes
    ----------
    edgeless : bool
        No edge of the medium is inside of it: what is in its middle is everywhere.
    """

    def __init__(
        self, cubics: Mapping[str, Cubic], context: Context, length: Any, *, rough: bool = False
    ) -> None:
        self.cubics, self.context, self.length, self.rough = cubics, context, length, rough
        self.edgeless = False
        self._scalars: dict[tuple[str, float], Any] = {}
        self._controls: dict[str, list[Any]] = {}
        self._turnings: dict[str, Turning] = {}
        self._spreads: dict[str, tuple[Any, Any, Any]] = {}

    def fields(self, s: Any) -> dict[str, Any]:
        """Return all fields at a place, and what follows from x, y and z."""
        return self._complete(self._own_fields(s))

    def places(self) -> list[dict[str, Any]]:
        """Return the fields alone at both ends and in the middle, in order."""
        return [within_limits(self._own_fields(s), self.context) for s in NODES]

    def ranges(self) -> dict[str, tuple[Any, Any]]:
        """Return between which values each field alone stays."""
        ends = {name: extremes(self.field_points(name)) for name in self.cubics}
        low, high = (
            within_limits({name: pair[k] for name, pair in ends.items()}, self.context)
            for k in (0, 1)
        )
        return {name: (low[name], high[name]) for name in ends}

    def _own_fields(self, s: Any) -> dict[str, Any]:
        s = self.context.real(s)
        return {name: horner(s, c) for name, c in self.cubics.items()}

    def scalar(self, expr: Expression | Margin, s: float) -> Any:
        """Return an expression at 0, ½ or 1; computed once."""
        key = (expr.text, s)
        if key not in self._scalars:
            self._scalars[key] = self.context.evaluate(expr, self._fields_at_node(s))
        return self._scalars[key]

    def nodes(self, expr: Expression | Margin) -> list[Any]:
        """Return an expression at both ends and the middle, in order."""
        return [self.scalar(expr, s) for s in NODES]

    def set_scalar(self, expr: Expression, s: float, value: Any) -> None:
        """Say which value an expression has at a place.

        At 0 it is what it was at the end of the stretch before, so that the integrals over a ray's
        stretches join up to the last bit.
        """
        self._scalars[expr.text, s] = value

    def known(self, expr: Expression) -> list[Any]:
        """Return what was computed of an expression at the control points, both ends among them.

        Not in the middle: where samples will do it is not needed.
        """
        return self.controls(expr)

    def set_known(self, expr: Expression, values: list[Any]) -> None:
        """Take what `known` returned for the same stretch in another scope of a kernel."""
        self._scalars[expr.text, 0.0], self._scalars[expr.text, 1.0] = values[0], values[-1]
        self._controls[expr.text] = values

    def hull(self, expr: Expression | Margin) -> tuple[Any, Any]:
        """Return the least and the greatest value that an expression may have.

        Infinite where it is undefined in a part of the stretch.
        """
        found = self.turning(expr)
        return found.low, found.high

    def turns(self, expr: Expression | Margin, least: Any) -> Any:
        """Return where an expression may go back and forth by more than a number."""
        return self.turning(expr).apart > least

    def is_cubic(self, expr: Expression) -> bool:
        """Return whether an expression is a cubic of s, as fields are."""
        return is_cubic(expr, self.context)

    def turning(self, expr: Expression | Margin) -> Turning:
        """Return between which values an expression stays; computed once."""
        if expr.text not in self._turnings:
            self._turnings[expr.text] = enclosed(self, expr)
        return self._turnings[expr.text]

    def spread(self, expr: Expression) -> tuple[Any, Any, Any]:
        """Return how far an expression may go, and bounds of two derivatives; computed once."""
        if expr.text not in self._spreads:
            self._spreads[expr.text] = spread(self, expr)
        return self._spreads[expr.text]

    def controls(self, expr: Expression | Margin) -> list[Any]:
        """Return an expression at the four Bézier control points of the fields."""
        if expr.text not in self._controls:
            inner = [self.context.evaluate(expr, self._control(i)) for i in (1, 2)]
            self._controls[expr.text] = [self.scalar(expr, 0.0), *inner, self.scalar(expr, 1.0)]
        return self._controls[expr.text]

    def derivatives(self, expr: Expression) -> list[Any]:
        """Return bounds of an expression's first three derivatives by s.

        The third is that of a cubic with its values at the control points.
        """
        b0, b1, b2, b3 = self.controls(expr)
        found = self.turning(expr)
        return [found.slope, found.bend, 6.0 * dr.abs(b3 - b0 + 3.0 * (b1 - b2))]

    def field_points(self, name: str) -> list[Any]:
        """Return the Bézier control points of a field."""
        cubic = self.cubics[name]
        inner = [control_point(cubic, number) for number in (1, 2)]
        return [cubic[0], *inner, sum(cubic[1:], cubic[0])]

    def part(self, start: Any, width: Any) -> Stretch:
        """Return the part from `start` on, of a width, as a stretch of its own."""
        begin, part = self.context.real(start), self.context.real(width)
        cubics = {name: shifted(c, begin, part) for name, c in self.cubics.items()}
        return Stretch(cubics, self.context, self.length * width)

    def with_constants(self, values: Mapping[str, Any]) -> Stretch:
        """Return it with more fields, each the same all along."""
        cubics = {**self.cubics, **{name: [value] for name, value in values.items()}}
        found = Stretch(cubics, self.context, self.length, rough=self.rough)
        found.edgeless = self.edgeless
        return found

    def panel(self, first: float, last: float) -> Panel:
        """Return the panel between two of the places 0, ½ and 1."""
        return Panel(self, first, last)

    def _fields_at_node(self, s: float) -> dict[str, Any]:
        if s == 0.0:
            return self._complete({name: c[0] for name, c in self.cubics.items()})
        if s == 1.0:
            return self._complete({name: sum(c[1:], c[0]) for name, c in self.cubics.items()})
        return self.fields(s)

    def _complete(self, fields: dict[str, Any]) -> dict[str, Any]:
        return with_coordinates(within_limits(fields, self.context), self.context)

    def _control(self, number: int) -> dict[str, Any]:
        return self._complete({n: control_point(c, number) for n, c in self.cubics.items()})


class Straight(Stretch):
    """A stretch on which scalars are taken as linear, whatever the fields do between its ends."""

    def scalar(self, expr: Expression | Margin, s: float) -> Any:
        if 0.0 < s < 1.0:
            return (1.0 - s) * self.scalar(expr, 0.0) + s * self.scalar(expr, 1.0)
        return super().scalar(expr, s)

    def controls(self, expr: Expression | Margin) -> list[Any]:
        return [self.scalar(expr, 0.0), self.scalar(expr, 1.0)]

    def ranges(self) -> dict[str, tuple[Any, Any]]:
        first, _, last = self.places()
        return {name: extremes([first[name], last[name]]) for name in first}

    def turning(self, expr: Expression | Margin) -> Turning:
        first, last = self.controls(expr)
        zero = self.length * 0.0
        return Turning(*extremes([first, last]), zero, dr.abs(last - first), zero)


@dataclass
class Panel:
    """A part of a stretch over which scalars are taken as linear.

    Attributes
    ----------
    first, last : float
        Where in the stretch it is: two of 0, ½ and 1.
    """

    stretch: Stretch
    first: float
    last: float

    @property
    def length(self) -> Any:
        """Its length, in units of the grid's scale."""
        return self.stretch.length * (self.last - self.first)

    @property
    def per_length(self) -> Any:
        """One over its length, for surfaces: one between two segments is not lost."""
        return 1.0 / dr.select(self.length > _SHORTEST, self.length, _SHORTEST)

    def ends(self, expr: Expression) -> tuple[Any, Any]:
        """Return an expression at both ends."""
        return self.stretch.scalar(expr, self.first), self.stretch.scalar(expr, self.last)

    def fields(self, f: Any) -> dict[str, Any]:
        """Return all fields at a fraction of the panel."""
        return self.stretch.fields(self.place(f))

    def place(self, f: Any) -> Any:
        """Return where in the stretch a fraction of the panel is."""
        return self.first + f * (self.last - self.first)


def extremes(values: Sequence[Any]) -> tuple[Any, Any]:
    """Return the least and the largest of some arrays."""
    low = functools.reduce(lambda a, b: dr.select(b < a, b, a), values)
    high = functools.reduce(lambda a, b: dr.select(b > a, b, a), values)
    return low, high


def within_limits(fields: dict[str, Any], context: Context) -> dict[str, Any]:
    """Return interpolated fields, none beyond the least and largest of its values."""
    for name, (low, high) in context.limits.items():
        if name in fields:
            value = dr.select(fields[name] < low, low, fields[name])
            fields[name] = dr.select(value > high, high, value)
    return fields


def with_coordinates(fields: dict[str, Any], context: Context) -> dict[str, Any]:
    """Return fields with what follows from x, y and z, if these are among them."""
    if all(axis in fields for axis in "xyz"):
        fields["r"] = dr.sqrt(sum(fields[axis] * fields[axis] for axis in "xyz"))
        for name, formula in context.coordinates.items():
            fields[name] = context.evaluate(formula, fields)
    return fields


def control_point(cubic: Cubic, number: int) -> Any:
    """Return a Bézier control point of a polynomial of at most third degree.

    The coefficient of Bernstein's polynomial `number` of degree three: Σ c_k C(n, k) / C(3, k).
    """
    ratios = {1: (1.0, 1 / 3), 2: (1.0, 2 / 3, 1 / 3)}[number]
    total = cubic[0]
    for c, ratio in zip(cubic[1:], ratios[1:], strict=False):
        total = dr.fma(c, ratio, total)
    return total


def shifted(cubic: Cubic, start: Any, width: Any) -> list[Any]:
    """Return the coefficients of p(start + width s) (Horner's rule for all derivatives)."""
    own = list(cubic)
    count = len(own)
    for first in range(count - 1):
        for k in range(count - 2, first - 1, -1):
            own[k] = dr.fma(own[k + 1], start, own[k])
    power = width
    for k in range(1, count):
        own[k] = own[k] * power
        power = power * width
    return own
