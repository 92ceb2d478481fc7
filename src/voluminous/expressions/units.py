"""The unit of an expression: each operation is checked, and numbers are converted.

Kernels compute with plain numbers in the units of the fields. `resolve` walks through a tree once
the units of its fields are known, inserts a factor wherever numbers in different units meet
(``km/s`` and ``cm/s``), and refuses an expression without a unit (``density + temperature``).

A plain number, written as such, is in the unit of what it is compared with (comparisons, ``min``,
``max``, ``clip``, ``%``, the places of ``interp``), and nowhere else. A ratio of velocities is a
plain number, in km/s and cm/s too; only fields in percent are compared in percent. A result whose
unit is another one times a number, such as ``K erg s2 / (g km2)``, is in that: in kelvin.
``log10`` of a quantity is in dex of its unit, astropy's ``dex(g / cm3)``: a plain number added to
it, or a plain factor, is a power of the field.
"""

from __future__ import annotations

import contextlib
import functools
import math
from collections.abc import Callable
from typing import Any, NamedTuple, NoReturn, TypeAlias

import numpy as np

from ..errors import UnitsError
from ..units import Unit, parse_unit, unit_name
from .expression import Expression
from .ops import NumpyOps
from .tree import (
    Call,
    Constant,
    Earlier,
    Field,
    InUnit,
    Node,
    NumberWithUnit,
    Steps,
    is_dex,
    nodes,
    text,
)

_ADVICE = (
    "write numbers with their units, as in 'log10(density / (1e-20 g/cm3))' or "
    "'exp(-20 K/temperature)'"
)


def resolve(expression: Expression, units: tuple[Unit, ...]) -> tuple[Expression, Unit]:
    """Return an expression in plain numbers of its fields' units, and its own unit.

    `units` are those of the fields in it, in the order of its `names`. The expression is the same
    if nothing has to be converted; the unit is None if it is a plain number.
    """
    if not any(_counts(unit) for unit in units) and not has_units(expression):
        return expression, None
    changed, unit = _resolved(expression, units)
    return changed or expression, unit


def times(expression: Expression, number: float, unit: Unit) -> Expression:
    """Return an expression times a number with a unit."""
    return _combined("multiply", expression, InUnit(number, unit))


def without_unit(expression: Expression, unit: Unit, shown: str) -> Expression:
    """Return an expression divided by its unit: a plain number; `shown` is its text."""
    if unit is None:
        return expression
    if is_dex(unit):
        plain = _combined("add", expression, InUnit(0.0, _dex(unit.physical_unit**-1)))
    else:
        plain = times(expression, 1.0, unit**-1)
    return Expression.of_tree(plain.tree, plain.names, shown)


def shifted(expression: Expression, number: float) -> Expression:
    """Return an expression of plain numbers plus a number."""
    return _combined("add", expression, Constant(number))


def product(*expressions: Expression) -> Expression:
    """Return the product of expressions, none of which has several steps."""
    tree = functools.reduce(
        lambda left, right: Call("multiply", (left, right)), [e.tree for e in expressions]
    )
    names = tuple(dict.fromkeys(name for e in expressions for name in e.names))
    return Expression.of_tree(tree, names)


def _combined(operation: str, expression: Expression, other: Node) -> Expression:
    tree = expression.tree
    if isinstance(tree, Steps):
        tree = Steps(tree.steps, Call(operation, (tree.result, other)))
    else:
        tree = Call(operation, (tree, other))
    return Expression.of_tree(tree, expression.names)


def _counts(unit: Unit) -> bool:
    """Return whether a unit makes a difference: radians alone are plain numbers."""
    return unit is not None and not _is_radian(unit)


@functools.lru_cache(maxsize=1 << 13)
def has_units(expression: Expression) -> bool:
    """Return whether an expression contains numbers with units."""
    return any(isinstance(node, (NumberWithUnit, InUnit)) for node in nodes(expression.tree))


class _Part(NamedTuple):
    """A node in plain numbers, with its unit (None: a plain number).

    `number` is its value if it consists of numbers without units alone, else None.
    """

    node: Node
    unit: Unit = None
    number: float | None = None

    def is_bare(self, plain: bool) -> bool:
        """Return whether it has no unit and cannot take that of others; with `plain` numbers can.

        Zeros and infinities always can.
        """
        free = self.number is not None and (self.number == 0 or not math.isfinite(self.number))
        return self.unit is None and not free and not (plain and self.number is not None)


@functools.lru_cache(maxsize=1 << 13)  # spectra have hundreds
def _resolved(expression: Expression, units: tuple[Unit, ...]) -> tuple[Expression | None, Unit]:
    """Return what `resolve` does, None for an expression that stays as it is."""
    walk = _Walk(dict(zip(expression.names, units, strict=True)), expression)
    tree, unit = walk.whole(expression.tree)
    if tree == expression.tree:
        return None, unit
    return Expression.of_tree(tree, expression.names), unit


class _Walk:
    """Derives units through the tree of an expression; `_RULES` has a method per operation."""

    def __init__(self, units: dict[str, Unit], expression: Expression) -> None:
        self._units, self._expression = units, expression
        self._steps: list[_Part] = []

    def whole(self, tree: Node) -> tuple[Node, Unit]:
        if not isinstance(tree, Steps):
            result = self._known(self.part(tree))
            return result.node, result.unit
        for step in tree.steps:
            self._steps.append(self.part(step))
        result = self._known(self.part(tree.result))
        return Steps(tuple(step.node for step in self._steps), result.node), result.unit

    def part(self, node: Node) -> _Part:
        match node:
            case NumberWithUnit(value, unit) | InUnit(value, unit):
                return _Part(InUnit(value, unit), unit)
            case Constant(value):
                return _Part(node, None, value)
            case Earlier(step):
                return self._steps[step]._replace(node=node)
            case Field(name):
                return _Part(node, self._units[name])
            case Call(operation, arguments):
                parts = [self.part(a) for a in arguments]
                values = [np.float64(p.number) for p in parts if p.number is not None]
                if len(values) < len(parts) or operation in _NOT_ARITHMETIC:
                    return _RULES.get(operation, _Walk._call)(self, node, parts)
                with np.errstate(all="ignore"):
                    value = getattr(NumpyOps(), operation)(*values, *node.constants)
                return self._call(node, parts)._replace(number=float(value))
        raise TypeError(f"not a number in an expression: {node!r}")

    def _call(self, node: Call, parts: list[_Part], unit: Unit = None) -> _Part:
        return _Part(node.with_children(tuple(part.node for part in parts)), unit)

    def _alike(self, node: Node, parts: list[_Part], *, plain: bool = False) -> list[_Part]:
        """Return numbers that are added, chosen from or compared, all in the unit of the first.

        With `plain`, numbers without a unit are in that of the others.
        """
        field_units = self._units.values()
        parts = [p if p.unit in field_units else self._plain_if_pure(p) for p in parts]
        varying = [p for p in parts if p.number is None and not isinstance(p.node, InUnit)]
        unit = _unit_of(varying) if varying else _unit_of(parts)
        plain = plain or is_dex(unit) or _is_radian(unit)
        if unit is not None and _is_pure(unit) and any(p.is_bare(plain) for p in parts):
            unit = None  # 1 - a, of percent
        fits = [p.unit is None and not p.is_bare(plain) for p in parts]
        return [p if fit else self._in(p, unit, node) for p, fit in zip(parts, fits, strict=True)]

    def _in(self, part: _Part, unit: Unit, node: Node) -> _Part:
        if part.unit == unit or not (_counts(part.unit) or _counts(unit)):
            return part
        dex = is_dex(part.unit)
        if dex != is_dex(unit):
            self._refuse_kind(node, part, unit)
        present, wanted = (
            (part.unit.physical_unit, unit.physical_unit) if dex else (part.unit, unit)
        )
        factor = _factor(present, wanted) or self._refuse_kind(node, part, unit)
        factor = math.log10(factor) if dex else factor
        if isinstance(part.node, InUnit):
            value = part.node.value
            return _Part(InUnit(value + factor if dex else value * factor, unit), unit)
        change = _dex(wanted / present) if dex else _quotient(unit, part.unit)
        if change == _quotient(None, None):  # the same unit by another name
            return _Part(part.node, unit)
        operation = "add" if dex else "multiply"
        return _Part(Call(operation, (part.node, InUnit(factor, change))), unit)

    def _pure(self, node: Node, part: _Part) -> _Part:
        """Return a plain number, as functions such as exp need it; of an angle its radians."""
        if part.unit is not None and _is_angle(part.unit):
            part = self._in(part, _radian(), node)
        return part if _is_radian(part.unit) else self._in(part, None, node)

    def _plain_if_pure(self, part: _Part) -> _Part:
        """Return a plain number in place of one in km/cm; a field in percent stays as it is."""
        bare = part.unit is None or isinstance(part.node, (Field, InUnit)) or is_dex(part.unit)
        return part if bare or not _is_pure(part.unit) else self._in(part, None, part.node)

    def _known(self, part: _Part) -> _Part:
        """Return a plain number, or one in kelvin in place of one in ``K erg s2 / (g km2)``."""
        part = self._plain_if_pure(part)
        if part.unit is None or isinstance(part.node, (Field, InUnit)) or is_dex(part.unit):
            return part
        known = _known_unit(part.unit)
        return self._in(part, known, part.node)._replace(unit=known)

    def _refuse(self, node: Node, problem: str, advice: str = _ADVICE) -> NoReturn:
        shown = text(node)
        inside = "" if node == self._expression.tree else f", in {shown!r}"
        units = ", ".join(f"{n} in {_named(u)}" for n, u in self._units.items())
        raise UnitsError(
            f"the unit of {self._expression.text!r} cannot be derived{inside}: {problem} "
            f"({units}); {advice}"
        )

    def _refuse_kind(self, node: Node, part: _Part, unit: Unit) -> NoReturn:
        wanted = "a plain number is needed" if unit is None else f"expected {_named(unit)}"
        present = "a plain number" if part.unit is None else f"in {_named(part.unit)}"
        shown = text(part.node)
        if isinstance(part.node, InUnit):
            shown = shown[1:-1]
        advice = f"write '{shown} {_named(unit)}'" if part.number is not None else _ADVICE
        self._refuse(node, f"{shown!r} is {present}, {wanted}", advice)

    def _refuse_dex(self, node: Node, part: _Part) -> None:
        if is_dex(part.unit):
            self._refuse(
                node,
                f"{text(part.node)!r} is in {_named(part.unit)}, and only plain numbers may be "
                "added to it or be its factors",
            )

    def _sum(self, node: Call, parts: list[_Part]) -> _Part:
        if not any(is_dex(p.unit) for p in parts):
            return self._same(node, parts, plain=False)
        # The logarithm of a product or quotient; plain numbers are logarithms of factors.
        sign = 1 if node.operation == "add" else -1
        units: list[Unit] = [p.unit.physical_unit if is_dex(p.unit) else None for p in parts]
        unit = _product(units[0], units[1], sign)
        if unit is not None and _is_pure(unit):  # of two densities, in g/cm3 and in kg/m3
            parts = [parts[0], self._in(parts[1], _dex(units[0] ** -sign), node)]
            unit = None
        parts = [p if is_dex(p.unit) else self._pure(node, p) for p in parts]
        return self._call(node, parts, None if unit is None else _dex(unit))

    def _times(self, node: Call, parts: list[_Part]) -> _Part:
        first, second = parts
        sign = 1 if node.operation == "multiply" else -1
        plain = self._call(node, parts)
        if sign > 0 and 0 in (first.number, second.number):
            return plain._replace(number=0.0)  # fits any unit
        if is_dex(first.unit) or is_dex(second.unit):
            log, other = parts if is_dex(first.unit) else parts[::-1]
            if other.number is None or (sign < 0 and log is second) or other.number == 0:
                self._refuse_dex(node, log)
            assert other.number is not None
            return plain._replace(unit=_dex(log.unit.physical_unit ** (other.number**sign)))
        return plain._replace(unit=_product(first.unit, second.unit, sign))

    def _power(self, node: Call, base: _Part, exponent: float) -> _Part:
        self._refuse_dex(node, base)
        plain = base.unit is None or (_is_radian(base.unit) and node.operation != "sqrt")
        return self._call(node, [base], None if plain else parse_unit(base.unit**exponent))

    def _general_power(self, node: Call, parts: list[_Part]) -> _Part:
        base, exponent = parts
        if is_dex(exponent.unit):
            if base.number != 10:
                self._refuse_dex(node, exponent)
            return self._call(node, parts, exponent.unit.physical_unit)
        plain = self._pure(node, exponent)
        if exponent.number is None or base.unit is None:
            return self._call(node, [self._pure(node, base), plain])
        self._refuse_dex(node, base)
        return self._call(node, [base, plain], parse_unit(base.unit**exponent.number))

    def _logarithm(self, node: Call, parts: list[_Part]) -> _Part:
        (x,) = parts
        if x.unit is None or _is_pure(x.unit):
            return self._function(node, parts)
        self._refuse_dex(node, x)
        if node.operation == "log":
            shown = text(x.node)
            self._refuse(
                node,
                f"{shown!r} is in {_named(x.unit)}, and its natural logarithm has no unit; "
                f"log10({shown}) is in dex",
            )
        return self._call(node, parts, _dex(x.unit))

    def _same(self, node: Call, parts: list[_Part], plain: bool = True) -> _Part:
        same = self._alike(node, parts, plain=plain)
        return self._call(node, same, _unit_of(same))

    def _where(self, node: Call, parts: list[_Part]) -> _Part:
        choices = self._alike(node, parts[1:])
        return self._call(node, [parts[0], *choices], _unit_of(choices))

    def _negative(self, node: Call, parts: list[_Part]) -> _Part:
        unit = parts[0].unit
        return self._call(node, parts, _dex(unit.physical_unit**-1) if is_dex(unit) else unit)

    def _function(self, node: Call, parts: list[_Part]) -> _Part:
        return self._call(node, [self._pure(node, p) for p in parts])


_NOT_ARITHMETIC = {"where", "compare", "interp", "logical_and", "logical_or", "logical_not"}
_Rule: TypeAlias = Callable[[_Walk, Call, list[_Part]], _Part]
_RULES: dict[str, _Rule] = {
    "add": _Walk._sum,
    "subtract": _Walk._sum,
    "multiply": _Walk._times,
    "divide": _Walk._times,
    "power": _Walk._general_power,
    "sqrt": lambda walk, node, parts: walk._power(node, parts[0], 0.5),
    "integer_power": lambda walk, node, parts: walk._power(node, parts[0], node.constants[0]),
    "compare": lambda walk, node, parts: walk._same(node, parts)._replace(unit=None),
    "interp": lambda walk, node, parts: walk._call(node, [walk._plain_if_pure(parts[0])]),
    "where": _Walk._where,
    "log10": _Walk._logarithm,
    "log": _Walk._logarithm,
    "negative": _Walk._negative,
    **dict.fromkeys(("positive", "abs", "min", "max", "clip", "remainder"), _Walk._same),
    "atan2": lambda walk, node, parts: walk._call(node, walk._alike(node, parts), _radian()),
    "floor_divide": lambda walk, node, parts: walk._call(node, walk._alike(node, parts)),
    **dict.fromkeys(("exp", "sin", "cos", "tan", "tanh"), _Walk._function),
}


def _astropy() -> Any:
    from astropy import units

    return units


def _dex(unit: Unit) -> Unit:
    return _astropy().dex(unit)


def _unit_of(parts: list[_Part]) -> Unit:
    return next((p.unit for p in parts if p.unit is not None), None)


def _factor(present: Unit, unit: Unit) -> float | None:
    """Return what converts numbers from one unit to another; None if they are of other kinds."""
    u = _astropy()
    pair = [unit or u.dimensionless_unscaled for unit in (present, unit)]
    for first, second in (pair, map(_of_gauss, pair)):
        with contextlib.suppress(u.UnitsError, TypeError):
            return float(first.to(second))
    return None


def _product(first: Unit, second: Unit, sign: int) -> Unit:
    if _is_radian(first) and _is_radian(second):
        return None
    first, second = (
        None if _is_radian(one) and other is not None and not _has_angle(other) else one
        for one, other in ((first, second), (second, first))
    )
    plain = _astropy().dimensionless_unscaled
    return parse_unit((first or plain) * (second or plain) ** sign)


def _quotient(first: Unit, second: Unit) -> Unit:
    return _product(first, second, -1) or _astropy().dimensionless_unscaled


def _is_pure(unit: Unit) -> bool:
    return not is_dex(unit) and bool(
        _of_gauss(unit).is_equivalent(_astropy().dimensionless_unscaled)
    )


@functools.lru_cache(maxsize=64)
def _of_gauss(unit: Unit) -> Unit:
    """Return a unit with gauss as in Gaussian units, where ``B**2 / (8*pi)`` is a pressure.

    astropy's gauss is 1e-4 tesla, of SI.
    """
    if is_dex(unit):
        return unit
    u = _astropy()
    gauss, result = u.Unit("g(1/2) / (cm(1/2) s)"), u.Unit(unit.scale)
    for base, power in zip(unit.bases, unit.powers, strict=True):
        is_gauss = base.name.endswith(("G", "Gauss", "gauss")) and base.is_equivalent(u.T)
        result = result * (base.to(u.G) * gauss if is_gauss else base) ** power
    return u.Unit(result)


@functools.lru_cache(maxsize=256)
def _known_unit(unit: Unit) -> Unit:
    """Return a part of a unit that is all of it but for a number, or a base unit; else itself."""
    u = _astropy()
    parts = [b**p for b, p in zip(unit.bases, unit.powers, strict=True)]
    if unit.scale == 1.0 and len(parts) == 1:
        return unit
    known = (*parts, *unit.bases, u.K, u.cm, u.g, u.s)
    return next((part for part in known if _is_pure(unit / part)), unit)


def _is_angle(unit: Unit) -> bool:
    return bool(not is_dex(unit) and unit.is_equivalent(_radian()))


def _has_angle(unit: Unit) -> bool:
    return any(_is_angle(base) for base in unit.bases)


@functools.lru_cache(maxsize=64)  # comparing units takes 0.3 ms
def _is_radian(unit: Unit) -> bool:
    return unit is not None and unit == _radian()


def _radian() -> Unit:
    return _astropy().rad


def _named(unit: Unit) -> str:
    return unit_name(unit) or "no unit"
