"""`Expression`: the text a user wrote, parsed once, evaluated with NumPy or Dr.Jit.

Along a segment of a ray fields are polynomials with Bézier control points. A sum of fields has the
sums of these control points and stays between them (Farin 2002, section 5.1); so does a monotonic
function of a sum. Therefore expressions know whether they are one (`Expression.kind`).
"""

from __future__ import annotations

import functools
import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from enum import IntEnum
from itertools import chain, pairwise
from numbers import Real
from typing import Any, NamedTuple

import numpy as np

from ..errors import ExpressionError, unknown_name
from ..units import as_quantity, is_quantity, parse_unit
from .ops import Ops, Value
from .parser import Vector, marked, one_line, parse
from .tree import (
    Call,
    Constant,
    Derivative,
    Earlier,
    Field,
    InUnit,
    Node,
    NumberWithUnit,
    Steps,
    field_names,
    in_steps,
    nodes,
    replaced,
    text,
)


class Monotonicity(IntEnum):
    """How an expression depends on its fields: each kind includes those before it."""

    CONSTANT = 0
    SUM = 1
    MONOTONIC = 2
    ANY = 3


_SUMS = {"add", "subtract", "negative", "positive"}
_MONOTONIC = {*_SUMS, "log10", "log", "exp", "sqrt", "tanh", "min", "max", "clip", "power"}
# Operations without jumps, kinks and oscillations.
_SMOOTH = {*_SUMS, "multiply", "divide", "log10", "log", "exp", "sqrt", "tanh", "power"}
_SMOOTH |= {"integer_power"}
# Operations that may be undefined, infinite or either of two values.
_PARTIAL = {"divide", "power", "log", "log10", "sqrt", "tan", "remainder", "floor_divide"}
_PARTIAL |= {"compare"}
# Operations that may make peaks narrower than any structure of their arguments.
_PEAKED = {"divide", "exp", "power", "tanh", "sin", "cos", "tan", "atan2", "remainder"}
_PEAKED |= {"floor_divide", "where", "interp"}
_ORDER = {"less", "less_equal", "greater", "greater_equal"}


class Expression:
    """A value computed from fields, element by element.

    Parameters
    ----------
    source : str, float, Quantity or Expression
        The text, for example ``"log10(density)"``, or a number, also with a unit. An
        `Expression` is returned as is.

    Attributes
    ----------
    text : str
        What the user wrote, on one line and stripped.
    names : tuple of str
        The field names used, without repetition, in order of first appearance. Identifiers are in
        Unicode normal form NFKC, as everywhere in Python. Derivatives are fields too, by names such
        as ``gradmag(log10(density))``; the names in them are not listed.

    Raises
    ------
    ExpressionError
        If the text is not in the language; a caret shows where.

    Notes
    -----
    Operators are Python's ``+ - * / // % **``, comparisons (also chained), ``and or not`` (also
    written ``& | ~``) and ``a if c else b``; functions are ``where log10 log exp sqrt abs min max
    sin cos tan tanh atan2 clip``, and tables ``interp(x, [x1, x2], [y1, y2])``, linear in between
    and constant beyond both ends; constants are numbers, ``pi``, ``e``, ``true`` and ``false``.
    Derivatives are ``gradmag``, ``laplacian`` and the vector ``grad``, with components
    ``grad(a).x``; vectors, also ``vector(a, b, c)``, become numbers by ``norm`` and ``dot``, and by
    ``los``: the component along the line of sight, away from the observer. There ``velocity``, also
    in quotes, is the vector of the fields ``velocity_x``, ``velocity_y`` and ``velocity_z``.
    ``//`` and ``%`` have Python's signs. ``and`` and ``or`` give true or false, not an operand.

    A number may be followed by a unit, ``"exp(-20 K/temperature)"``; such an expression has a value
    in a volume only, whose fields have units.

    Two expressions are equal if they mean the same tree: ``a+b`` equals ``(a + b)``.

    Examples
    --------
    >>> import numpy as np
    >>> from voluminous.expressions import Expression, NumpyOps
    >>> expr = Expression("2 * density if density > 1 else 0")
    >>> expr.names
    ('density',)
    >>> expr.evaluate(NumpyOps(), {"density": np.array([0.5, 3.0])})
    array([0., 6.])
    """

    __slots__ = ("names", "text", "tree")

    text: str
    names: tuple[str, ...]
    tree: Node

    def __new__(cls, source: str | float | Expression) -> Expression:
        """Return the parsed `source`, or `source` itself if it is parsed already."""
        if isinstance(source, Expression):
            return source
        shown = _source_text(source)
        return cls.of_tree(*parse(marked(shown)), shown)

    def among(self, fields: tuple[str, ...]) -> Expression:
        """Return what the text means where these fields exist.

        In ``20 K/T`` T is the tesla, unless there is a field T.
        """
        plain = marked(self.text, fields)
        return self if plain == marked(self.text) else self.of_tree(*parse(plain), self.text)

    @classmethod
    def of_tree(
        cls, tree: Node, names: tuple[str, ...] | None = None, shown: str | None = None
    ) -> Expression:
        """Return the expression of a tree, with the fields in it (at least).

        `shown` is its text, which no other expression of the same fields may have.
        """
        self = super().__new__(cls)
        object.__setattr__(self, "tree", tree)
        object.__setattr__(self, "names", field_names(tree) if names is None else names)
        object.__setattr__(self, "text", text(tree) if shown is None else shown)
        return self

    def margins(self) -> tuple[Expression, ...]:
        """Return the differences of compared values; the expression may jump where one is zero."""
        differences = [
            Call("subtract", sides)
            for node in self._calls("compare")
            for sides in pairwise(node.arguments)
        ]
        return self._parts("margin", differences)

    def quotients(self) -> tuple[Expression, ...]:
        """Return the whole quotients of ``//`` and ``%``; it may jump where one changes."""
        calls = self._calls("remainder", "floor_divide")
        return self._parts("quotient", [Call("floor_divide", node.arguments) for node in calls])

    def _parts(self, kind: str, trees: Iterable[Node]) -> tuple[Expression, ...]:
        steps = self.tree.steps if isinstance(self.tree, Steps) else ()
        return tuple(
            Expression.of_tree(in_steps(steps, tree), shown=f"{self.text}: {kind} {k}")
            for k, tree in enumerate(trees)
        )

    @property
    def stepped(self) -> bool:
        """Whether it is a condition that changes only where one of its `margins` is zero."""
        return _is_stepped(self.tree)

    @property
    def smooth(self) -> bool:
        """Whether it has neither jumps, kinks nor oscillations where it is finite."""
        return all(
            isinstance(node, (Constant, Field, Earlier, Steps))
            or (isinstance(node, Call) and node.operation in _SMOOTH)
            for node in nodes(self.tree)
        )

    @property
    def partial(self) -> bool:
        """Whether it may be undefined, infinite or either of two values for some of its fields."""
        powers = (node.constants[0] for node in self._calls("integer_power"))
        return any(self._calls(*_PARTIAL)) or any(power < 0 for power in powers)

    @property
    def peaked(self) -> bool:
        """Whether it may have peaks narrower than any structure of its fields.

        Products and roots of fields have none.
        """
        powers = (node.constants[0] for node in self._calls("integer_power"))
        return any(self._calls(*_PEAKED)) or any(not 0 < power < 4 for power in powers)

    def kind(self, curved: Collection[str] = ()) -> Monotonicity:
        """Return whether it is a constant, a sum of fields, monotonic in one, or none of these.

        Parameters
        ----------
        curved : collection of str
            Names that are no polynomials along rays, such as the radius.
        """
        return _kind_of(self.tree, curved)

    def _calls(self, *operations: str) -> Iterator[Call]:
        for node in nodes(self.tree):
            if isinstance(node, Call) and node.operation in operations:
                yield node

    def evaluate(self, ops: Ops, values: Mapping[str, Value]) -> Value:
        """Return the value of the expression.

        Parameters
        ----------
        ops : Ops
            `NumpyOps` or `DrjitOps`.
        values : mapping of str to array
            The fields, all of `names`.

        Returns
        -------
        array
            Numbers of the fields' common shape (a scalar array if no field is used). A comparison
            gives 1 and 0. An undefined value, such as ``log10(0)``, is infinite or NaN.

        Raises
        ------
        UnknownNameError
            If a field is missing; names the nearest.
        UnitsError
            If it contains numbers with units: only a volume can convert them.
        """
        check_names(self, values)
        fitted, fields = ops.prepare({name: values[name] for name in self.names})
        with np.errstate(all="ignore"):
            return self.tree.number(fitted, fields)

    def __setattr__(self, attribute: str, value: Any) -> None:
        raise AttributeError("an Expression cannot be changed; make a new one")

    def __eq__(self, other: object) -> bool:
        return self.tree == other.tree if isinstance(other, Expression) else NotImplemented

    def __hash__(self) -> int:
        return hash(self.tree)

    def __repr__(self) -> str:
        return f"Expression({self.text!r})"

    def __reduce__(self) -> tuple[Any, ...]:
        if any(isinstance(node, InUnit) for node in nodes(self.tree)):
            return Expression.of_tree, (self.tree, self.names, self.text)  # in plain numbers
        return Expression, (self.text,)


def _kind_of(
    node: Node, curved: Collection[str] = (), steps: Sequence[Monotonicity] = ()
) -> Monotonicity:
    """Return how an expression depends on its fields, given the kinds of the steps before it.

    Fields in `curved`, such as the radius, are no polynomials along rays.
    """
    match node:
        case Constant():
            return Monotonicity.CONSTANT
        case Field(name):
            return Monotonicity.ANY if name in curved else Monotonicity.SUM
        case Earlier(step):
            return steps[step]
        case Steps(own, result):
            kinds: list[Monotonicity] = []
            for one in own:
                kinds.append(_kind_of(one, curved, kinds))
            return _kind_of(result, curved, kinds)
        case Call("compare" | "where" | "logical_and" | "logical_or" | "logical_not"):
            return Monotonicity.ANY
        case Call(_, arguments):
            return _kind_of_call(node, [_kind_of(a, curved, steps) for a in arguments])
    return Monotonicity.ANY


def _kind_of_call(node: Call, kinds: list[Monotonicity]) -> Monotonicity:
    highest, varying = max(kinds), sum(kind != Monotonicity.CONSTANT for kind in kinds)
    if not varying or (node.operation in _SUMS and highest == Monotonicity.SUM):
        return highest
    if varying > 1 or highest == Monotonicity.ANY:
        return Monotonicity.ANY
    match node:
        case Call("multiply"):
            return highest
        case Call("divide") if kinds[1] == Monotonicity.CONSTANT:
            return highest
        case Call("interp", _, (_, entries)):
            monotonic = list(entries) in (sorted(entries), sorted(entries, reverse=True))
        case Call("integer_power", _, (exponent,)):
            monotonic = _is_odd(exponent)
        case Call("power", (_, Constant(exponent))) if exponent.is_integer():
            monotonic = _is_odd(exponent)
        case _:
            monotonic = node.operation in _MONOTONIC
    return Monotonicity.MONOTONIC if monotonic else Monotonicity.ANY


def _is_odd(exponent: float) -> bool:
    return exponent > 0 and exponent % 2 == 1


def _is_stepped(tree: Node) -> bool:
    match tree:
        case Call("logical_and" | "logical_or" | "logical_not", arguments):
            return all(map(_is_stepped, arguments))
        case Call("compare", operands, (operations,)):
            below = (node for side in operands for node in nodes(side) if isinstance(node, Call))
            return _ORDER.issuperset(operations) and not any(
                node.operation in ("compare", "where") for node in below
            )
    return False


def components(source: str | float | Expression) -> tuple[Expression, ...]:
    """Return the three components of a vector such as ``grad(density)``, else the expression."""
    if isinstance(source, str):
        tree, _ = parse(marked(one_line(source)), vectors=True)
        if isinstance(tree, Vector):
            return tuple(Expression(text(component)) for component in tree.components)
    return (Expression(source),)


def check_names(expr: Expression, known: Iterable[str]) -> None:
    """Raise the error for the first name in `expr` that is not `known`."""
    names = list(known)
    for name in expr.names:
        if name not in names:
            raise unknown_name("field", name, names)


def _source_text(source: Any) -> str:
    if isinstance(source, str):
        return one_line(source)
    source = as_quantity(source)
    if is_quantity(source) and np.ndim(source.value) == 0:
        return text(NumberWithUnit(float(source.value), parse_unit(source.unit)))
    if not isinstance(source, Real):
        raise ExpressionError(
            f"an expression is text such as 'log10(density)' or a number, "
            f"got {type(source).__name__}"
        )
    try:
        number = float(source)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise ExpressionError(f"an expression must be a finite number or text, got {number}")
    return repr(number)


class DerivedField(NamedTuple):
    """A field computed from others, not from their values in the same cell alone.

    `operation` is ``gradmag``, ``laplacian``, ``grad.x``, ``grad.y`` or ``grad.z``; ``cellwise``;
    ``los``, the component away from the observer; or ``along.x`` and the like, a component of a
    vector field that is given by others. `arguments` are the expression in parentheses, or the
    three components of a vector; `name` is its name in `Expression.names`.
    """

    name: str
    operation: str
    arguments: tuple[Expression, ...]


@functools.lru_cache(maxsize=1024)
def derived_field(name: str) -> DerivedField | None:
    """Return the derived field of a name such as ``gradmag(a)``, however written; else None."""
    if "(" not in name:  # most names are identifiers
        return None
    try:
        tree, _ = parse(marked(one_line(name)))
    except ExpressionError:
        return None
    if not isinstance(tree, Derivative):
        return None
    argument = tree.argument
    parts = argument.components if isinstance(argument, Vector) else (argument,)
    return DerivedField(tree.name, tree.operation, tuple(Expression(text(p)) for p in parts))


def required_names(expression: Expression) -> tuple[str, ...]:
    """Return the fields and coordinates that an expression needs, also those in derivatives."""
    names: dict[str, None] = {}
    for name in expression.names:
        derived = derived_field(name)
        needed = [(name,)] if derived is None else map(required_names, derived.arguments)
        names |= dict.fromkeys(chain.from_iterable(needed))
    return tuple(names)


class ComparisonField(NamedTuple):
    """A comparison, and the name of the field that is true where it holds."""

    name: str
    condition: Expression


def on_one_side(
    expressions: Iterable[Expression],
) -> tuple[tuple[Expression, ...], tuple[ComparisonField, ...]]:
    """Return expressions with fields in place of comparisons, and these comparisons, each once."""
    sides: dict[Node, ComparisonField] = {}

    def decided(expression: Expression) -> Expression:
        tree = expression.tree
        steps = tree.steps if isinstance(tree, Steps) else ()

        def field_of(node: Node) -> Node | None:
            if not isinstance(node, Call) or node.operation != "compare":
                return None
            comparison = in_steps(steps, node)
            if comparison not in sides:
                name = f"%side {len(sides)}"
                condition = Expression.of_tree(comparison, shown=f"{expression.text}: {name}")
                sides[comparison] = ComparisonField(name, condition)
            return Field(sides[comparison].name)

        new = replaced(tree, field_of)
        return Expression.of_tree(new, shown=f"{expression.text}: on one side")

    changed = tuple(map(decided, expressions))
    return changed, tuple(sides.values())
