"""The unit of an expression, and its plain numbers: each operation is checked, and converted for.

Kernels compute with the plain numbers of the fields in their own units. `resolve` walks through a
tree once the units of its fields are known, puts a factor wherever numbers in different units meet
(``km/s`` and ``cm/s``), and refuses what has no unit (``density + temperature``).

A plain number, written as such, is in the unit of what it is compared with (comparisons, ``min``,
``max``, ``clip``, ``%``, the places of ``interp``), and nowhere else. A ratio of velocities is a
plain number, in km/s and cm/s too; only fields in percent are compared in percent. ``log10`` of a
unit is in dex of it, astropy's ``dex(g / cm3)``: a plain number added to it, or a plain factor, is
a power of the field.
"""

from __future__ import annotations

import contextlib
import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NoReturn

import numpy as np

from ..errors import UnitsError
from ..units import Unit, parse_unit, unit_name
from .expression import Expression
from .ops import NumpyOps
from .tree import (
    Call,
    Comparison,
    Constant,
    Earlier,
    Field,
    IntegerPower,
    Interpolation,
    InUnit,
    Logic,
    Node,
    NumberWithUnit,
    Steps,
    Where,
    is_dex,
    nodes,
    text,
)

_ADVICE = (
    "write numbers with their units, as in 'log10(density / (1e-20 g/cm3))' or "
    "'exp(-20 K/temperature)'"
)


def resolve(expression: Expression, units: tuple[Unit, ...]) -> tuple[Expression, Any]:
    """Return an expression in plain numbers of its fields' units, and its own unit.

    Parameters
    ----------
    expression : Expression
    units : tuple of astropy unit or None
        Those of the fields in it, in the order of its `names`.

    Returns
    -------
    Expression
        The same if nothing has to be converted.
    astropy unit or None
        None if it is a plain number.
    """
    if not any(_counts(unit) for unit in units) and not has_units(expression):
        return expression, None
    changed, unit = _resolved(expression, units)
    return (expression if changed is None else changed), unit


def times(expression: Expression, number: float, unit: Unit) -> Expression:
    """Return an expression times a number with a unit."""
    return _combined("multiply", expression, InUnit(number, unit))


def without_unit(expression: Expression, unit: Unit, shown: str) -> Expression:
    """Return an expression that is in a unit as a plain number, divided by the unit, by a name."""
    if unit is None:
        return expression
    if is_dex(unit):
        found = _combined("add", expression, InUnit(0.0, _dex(unit.physical_unit**-1)))
    else:
        found = times(expression, 1.0, unit**-1)
    return Expression.of_tree(found.tree, found.names, shown)


def shifted(expression: Expression, number: float) -> Expression:
    """Return an expression of plain numbers plus a number."""
    return _combined("add", expression, Constant(number))


def product(*expressions: Expression) -> Expression:
    """Return the product of expressions that are no functions of several steps."""
    tree = functools.reduce(
        lambda left, right: Call("multiply", (left, right)), [e.tree for e in expressions]
    )
    names = tuple(dict.fromkeys(name for e in expressions for name in e.names))
    return Expression.of_tree(tree, names, text(tree))


def _combined(operation: str, expression: Expression, other: Node) -> Expression:
    tree = expression.tree
    if isinstance(tree, Steps):
        tree = Steps(tree.steps, Call(operation, (tree.result, other)))
    else:
        tree = Call(operation, (tree, other))
    return Expression.of_tree(tree, expression.names, text(tree))


def _counts(unit: Unit) -> bool:
    """Return whether a unit makes a difference: radians alone are plain numbers."""
    return unit is not None and not _is_radian(unit)


@functools.lru_cache(maxsize=256)
def has_units(expression: Expression) -> bool:
    """Return whether there are numbers with units in an expression."""
    return any(isinstance(node, (NumberWithUnit, InUnit)) for node in nodes(expression.tree))


@functools.lru_cache(maxsize=512)
def _resolved(expression: Expression, units: tuple[Unit, ...]) -> tuple[Expression | None, Any]:
    """Return what `resolve` does, None for an expression that stays as it is."""
    walk = _Walk(dict(zip(expression.names, units, strict=True)), expression)
    tree, unit = walk.whole(expression.tree)
    if tree == expression.tree:
        return None, unit
    return Expression.of_tree(tree, expression.names, text(tree)), unit


@dataclass
class _Part:
    """A node in plain numbers, with its unit (None: a plain number).

    `number` is its value if it is made of numbers without units alone, else None.
    """

    node: Node
    unit: Unit = None
    number: float | None = None

    @property
    def free(self) -> bool:
        return self.number is not None and (self.number == 0 or not math.isfinite(self.number))

    def bare(self, plain: bool) -> bool:
        """Return whether it has no unit, nor takes that of others: with `plain` numbers do."""
        return self.unit is None and not self.free and not (plain and self.number is not None)


class _Walk:
    """One walk through the tree of an expression."""

    def __init__(self, units: dict[str, Unit], expression: Expression) -> None:
        self._units, self._expression = units, expression
        self._steps: list[_Part] = []

    def whole(self, tree: Node) -> tuple[Node, Any]:
        if isinstance(tree, Steps):
            for step in tree.steps:
                self._steps.append(self.part(step))
            result = self._plain_if_pure(self.part(tree.result))
            return Steps(tuple(step.node for step in self._steps), result.node), result.unit
        result = self._plain_if_pure(self.part(tree))
        return result.node, result.unit

    def part(self, node: Node) -> _Part:
        match node:
            case NumberWithUnit(value, unit) | InUnit(value, unit):
                return _Part(InUnit(value, unit), unit)
            case Constant(value):
                return _Part(node, None, value)
            case Earlier(step):
                known = self._steps[step]
                return _Part(node, known.unit, known.number)
            case Field(name):
                return _Part(node, self._units[name])
            case IntegerPower(base, exponent):
                return self._power(node, self.part(base), exponent)
            case Comparison(operations, operands):
                parts = self._alike(node, [self.part(p) for p in operands], plain=True)
                return _Part(Comparison(operations, tuple(p.node for p in parts)))
            case Logic(operation, arguments):
                return _Part(Logic(operation, tuple(self.part(a).node for a in arguments)))
            case Interpolation(argument, places, entries):
                x = self._plain_if_pure(self.part(argument))
                return _Part(Interpolation(x.node, places, entries))
            case Where(condition, chosen, otherwise):
                mask = self.part(condition).node
                parts = self._alike(node, [self.part(chosen), self.part(otherwise)])
                return _Part(Where(mask, *(p.node for p in parts)), _unit_of(parts))
            case Call(operation, arguments):
                parts = [self.part(a) for a in arguments]
                if all(p.number is not None for p in parts):
                    return self._constant(Call(operation, tuple(p.node for p in parts)), parts)
                return _RULES[operation](self, node, parts)
        raise TypeError(f"not a number in an expression: {node!r}")

    def _constant(self, node: Call, parts: list[_Part]) -> _Part:
        ops = NumpyOps()
        with np.errstate(all="ignore"):
            values = [np.float64(p.number) for p in parts]
            return _Part(node, None, float(getattr(ops, node.operation)(*values)))

    # What several operations share.

    def _alike(self, node: Node, parts: list[_Part], *, plain: bool = False) -> list[_Part]:
        """Return numbers that are added, chosen from or compared, all in the unit of the first.

        With `plain`, numbers without a unit are in that of the others.
        """
        own = self._units.values()
        parts = [p if p.unit in own else self._plain_if_pure(p) for p in parts]
        varying = [p for p in parts if p.number is None and not isinstance(p.node, InUnit)]
        unit = _unit_of(varying) if varying else _unit_of(parts)
        plain = plain or is_dex(unit) or _is_radian(unit)
        if unit is not None and _is_pure(unit) and any(p.bare(plain) for p in parts):
            unit = None  # 1 - a, of percent
        fits = [p.unit is None and not p.bare(plain) for p in parts]
        return [p if fit else self._in(p, unit, node) for p, fit in zip(parts, fits, strict=True)]

    def _in(self, part: _Part, unit: Unit, node: Node) -> _Part:
        if part.unit == unit or not (_counts(part.unit) or _counts(unit)):
            return part
        dex = is_dex(part.unit)
        if dex != is_dex(unit):
            self._refuse_kind(node, part, unit)
        if dex:
            own, wanted = part.unit.physical_unit, unit.physical_unit
            factor = math.log10(self._factor(own, wanted) or self._refuse_kind(node, part, unit))
            operation, change = "add", _dex(wanted / own)
        else:
            factor = self._factor(part.unit, unit) or self._refuse_kind(node, part, unit)
            operation, change = "multiply", _quotient(unit, part.unit)
        if isinstance(part.node, InUnit):
            value = part.node.value
            return _Part(InUnit(value + factor if dex else value * factor, unit), unit)
        if change == _quotient(None, None):  # the same unit by another name
            return _Part(part.node, unit)
        return _Part(Call(operation, (part.node, InUnit(factor, change))), unit)

    def _factor(self, own: Any, unit: Unit) -> float | None:
        """Return what turns numbers in one unit into those in another; None if nothing does."""
        from astropy import units as u

        pair = [unit or u.dimensionless_unscaled for unit in (own, unit)]
        for first, second in (pair, map(_of_gauss, pair)):
            with contextlib.suppress(u.UnitsError, TypeError):
                return float(first.to(second))
        return None

    def _refuse_kind(self, node: Node, part: _Part, unit: Unit) -> NoReturn:
        wanted = "a plain number is needed" if unit is None else f"expected {_named(unit)}"
        own = "a plain number" if part.unit is None else f"in {_named(part.unit)}"
        shown = text(part.node)
        if isinstance(part.node, InUnit):
            shown = shown[1:-1]
        advice = f"write '{shown} {_named(unit)}'" if part.number is not None else _ADVICE
        self._refuse(node, f"{shown!r} is {own}, {wanted}", advice)

    def _pure(self, node: Node, part: _Part) -> Node:
        """Return a plain number, as functions such as exp need it; of an angle its radians."""
        if part.unit is not None and _is_angle(part.unit):
            part = self._in(part, _radian(), node)
        return part.node if _is_radian(part.unit) else self._in(part, None, node).node

    def _plain_if_pure(self, part: _Part) -> _Part:
        """Return a plain number in place of one in km/cm; a field in percent stays as it is."""
        bare = part.unit is None or isinstance(part.node, (Field, InUnit)) or is_dex(part.unit)
        if bare or not _is_pure(part.unit):
            return part
        return self._in(part, None, part.node)

    def _refuse(self, node: Node, problem: str, advice: str = _ADVICE) -> NoReturn:
        shown = text(node)
        inside = "" if node == self._expression.tree else f", in {shown!r}"
        units = ", ".join(f"{n} in {_named(u)}" for n, u in self._units.items())
        raise UnitsError(
            f"the unit of {self._expression.text!r} cannot be derived{inside}: {problem} "
            f"({units}); {advice}"
        )

    # One rule for each kind of operation: from the parts to what they make.

    def _sum(self, node: Call, parts: list[_Part]) -> _Part:
        first, second = parts
        sign = 1 if node.operation == "add" else -1
        if is_dex(first.unit) or is_dex(second.unit):
            return self._sum_of_dex(node, parts, sign)
        same = self._alike(node, parts)
        return _Part(Call(node.operation, tuple(p.node for p in same)), _unit_of(same))

    def _sum_of_dex(self, node: Call, parts: list[_Part], sign: int) -> _Part:
        """Return the logarithm of a product or quotient; plain numbers are logarithms of them."""
        own: list[Any] = [p.unit.physical_unit if is_dex(p.unit) else None for p in parts]
        unit = _product(own[0], own[1], sign)
        if unit is not None and _is_pure(unit):  # of two densities, in g/cm3 and in kg/m3
            parts = [parts[0], self._in(parts[1], _dex(own[0] ** -sign), node)]
            unit = None
        plain = [p.node if is_dex(p.unit) else self._pure(node, p) for p in parts]
        return _Part(Call(node.operation, tuple(plain)), None if unit is None else _dex(unit))

    def _product(self, node: Call, parts: list[_Part]) -> _Part:
        first, second = parts
        sign = 1 if node.operation == "multiply" else -1
        plain = Call(node.operation, (first.node, second.node))
        if sign > 0 and 0 in (first.number, second.number):
            return _Part(plain, None, 0.0)  # fits any unit
        if is_dex(first.unit) or is_dex(second.unit):
            log, other = parts if is_dex(first.unit) else parts[::-1]
            if other.number is None or (sign < 0 and log is second) or other.number == 0:
                self._refuse_dex(node, log)
            return _Part(plain, _dex(log.unit.physical_unit ** (other.number**sign)))
        return _Part(plain, _product(first.unit, second.unit, sign))

    def _power(self, node: Node, base: _Part, exponent: float) -> _Part:
        made = IntegerPower(base.node, int(exponent))
        if base.number is not None:
            return _Part(made, None, float(np.float64(base.number) ** exponent))
        if is_dex(base.unit):
            self._refuse_dex(node, base)
        plain = base.unit is None or _is_radian(base.unit)
        return _Part(made, None if plain else parse_unit(base.unit**exponent))

    def _general_power(self, node: Call, parts: list[_Part]) -> _Part:
        base, exponent = parts
        if is_dex(exponent.unit):
            if base.number != 10:
                self._refuse_dex(node, exponent)
            return _Part(Call("power", (base.node, exponent.node)), exponent.unit.physical_unit)
        plain = self._pure(node, exponent)
        if exponent.number is None or base.unit is None:
            return _Part(Call("power", (self._pure(node, base), plain)))
        if is_dex(base.unit):
            self._refuse_dex(node, base)
        return _Part(Call("power", (base.node, plain)), parse_unit(base.unit**exponent.number))

    def _root(self, node: Call, parts: list[_Part]) -> _Part:
        (x,) = parts
        if is_dex(x.unit):
            self._refuse_dex(node, x)
        return _Part(Call("sqrt", (x.node,)), None if x.unit is None else parse_unit(x.unit**0.5))

    def _logarithm(self, node: Call, parts: list[_Part]) -> _Part:
        (x,) = parts
        if x.unit is None or _is_pure(x.unit):
            return _Part(Call(node.operation, (self._pure(node, x),)))
        if is_dex(x.unit):
            self._refuse_dex(node, x)
        if node.operation == "log":
            shown = text(x.node)
            self._refuse(
                node,
                f"{shown!r} is in {_named(x.unit)}, and its natural logarithm has no unit; "
                f"log10({shown}) is in dex",
            )
        return _Part(Call("log10", (x.node,)), _dex(x.unit))

    def _same(self, node: Call, parts: list[_Part]) -> _Part:
        same = self._alike(node, parts, plain=True)
        return _Part(Call(node.operation, tuple(p.node for p in same)), _unit_of(same))

    def _negative(self, node: Call, parts: list[_Part]) -> _Part:
        (x,) = parts
        unit = _dex(x.unit.physical_unit**-1) if is_dex(x.unit) else x.unit
        return _Part(Call("negative", (x.node,)), unit)

    def _ratio(self, node: Call, parts: list[_Part]) -> _Part:
        same = self._alike(node, parts)
        unit = _radian() if node.operation == "atan2" else None
        return _Part(Call(node.operation, tuple(p.node for p in same)), unit)

    def _function(self, node: Call, parts: list[_Part]) -> _Part:
        return _Part(Call(node.operation, tuple(self._pure(node, p) for p in parts)))

    def _refuse_dex(self, node: Node, part: _Part) -> NoReturn:
        self._refuse(
            node,
            f"{text(part.node)!r} is in {_named(part.unit)}, and only plain numbers may be added "
            "to it or be its factors",
        )


_Rule = Callable[[_Walk, Call, list[_Part]], _Part]
_RULES: dict[str, _Rule] = {
    "add": _Walk._sum,
    "subtract": _Walk._sum,
    "multiply": _Walk._product,
    "divide": _Walk._product,
    "power": _Walk._general_power,
    "sqrt": _Walk._root,
    "log10": _Walk._logarithm,
    "log": _Walk._logarithm,
    "negative": _Walk._negative,
    **dict.fromkeys(("positive", "abs", "min", "max", "clip", "remainder"), _Walk._same),
    **dict.fromkeys(("atan2", "floor_divide"), _Walk._ratio),
    **dict.fromkeys(("exp", "sin", "cos", "tan", "tanh"), _Walk._function),
}


def _dex(unit: Unit) -> Unit:
    from astropy import units as u

    return u.dex(unit)


def _unit_of(parts: list[_Part]) -> Unit:
    return next((p.unit for p in parts if p.unit is not None), None)


def _product(first: Any, second: Any, sign: int) -> Unit:
    from astropy import units as u

    if _is_radian(first) and _is_radian(second):
        return None
    first, second = (
        None if _is_radian(own) and other is not None and not _has_angle(other) else own
        for own, other in ((first, second), (second, first))
    )
    plain = u.dimensionless_unscaled
    return parse_unit((first or plain) * (second or plain) ** sign)


def _quotient(first: Any, second: Any) -> Unit:
    from astropy import units as u

    found = _product(first, second, -1)
    return u.dimensionless_unscaled if found is None else found


def _is_pure(unit: Unit) -> bool:
    from astropy import units as u

    return not is_dex(unit) and bool(_of_gauss(unit).is_equivalent(u.dimensionless_unscaled))


@functools.lru_cache(maxsize=64)
def _of_gauss(unit: Unit) -> Unit:
    """Return a unit with what gauss are in Gaussian units, where ``B**2 / (8*pi)`` is a pressure.

    astropy has them as 1e-4 tesla only, of SI.
    """
    from astropy import units as u

    if is_dex(unit):
        return unit
    gauss, found = u.Unit("g(1/2) / (cm(1/2) s)"), u.Unit(unit.scale)
    for base, power in zip(unit.bases, unit.powers, strict=True):
        is_gauss = base.name.endswith(("G", "Gauss", "gauss")) and base.is_equivalent(u.T)
        found = found * (base.to(u.G) * gauss if is_gauss else base) ** power
    return u.Unit(found)


def _is_angle(unit: Unit) -> bool:
    return bool(not is_dex(unit) and unit.is_equivalent(_radian()))


def _has_angle(unit: Unit) -> bool:
    return any(_is_angle(base) for base in unit.bases)


@functools.lru_cache(maxsize=64)  # comparing units takes 0.3 ms
def _is_radian(unit: Unit) -> bool:
    return unit is not None and unit == _radian()


def _radian() -> Unit:
    from astropy import units as u

    return u.rad


def _named(unit: Unit) -> str:
    return unit_name(unit) or "no unit"
