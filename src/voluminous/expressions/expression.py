"""`Expression`: the text a user wrote, parsed once, evaluated with NumPy or Dr.Jit."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from numbers import Real
from typing import Any, NamedTuple

import numpy as np

from ..errors import ExpressionError, unknown_name
from ..units import as_quantity, is_quantity, parse_unit
from .analysis import (
    Margin,
    Monotonicity,
    is_partial,
    is_smooth,
    is_stepped,
    kind_of,
    margins,
    may_peak,
)
from .language import marked, one_line
from .ops import Ops
from .parser import Vector, parse
from .tree import Comparison, Derivative, Field, Node, NumberWithUnit, Steps, in_steps, nodes, text


class Expression:
    """A value computed from fields, element by element.

    Parameters
    ----------
    source : str, float, Quantity or Expression
        The text, for example ``"log10(density)"``, or a number, or one with a unit. An
        `Expression` is returned as is.

    Attributes
    ----------
    text : str
        What the user wrote, on one line and without the spaces around it.
    names : tuple of str
        The field names used, without repetition, in order of first appearance. Identifiers are in
        Unicode normal form NFKC, as everywhere in Python. Derivatives are fields too, by names such
        as ``gradmag(log10(density))``; the names in them are not listed.

    Raises
    ------
    ExpressionError
        If the text is not in the language; shows the place with a caret.

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
        """Return it as it is meant where there are these fields: one hides a unit of its name.

        In ``20 K/T`` T is the tesla, unless there is a field T.
        """
        plain = marked(self.text, fields)
        return self if plain == marked(self.text) else self.of_tree(*parse(plain), self.text)

    @classmethod
    def of_tree(cls, tree: Node, names: tuple[str, ...], shown: str) -> Expression:
        """Return the expression of a tree of which there is no text in the language.

        Parameters
        ----------
        tree : Node
            What it means.
        names : tuple of str
            The fields in it, at least.
        shown : str
            What stands for it: of no other expression of the same fields.
        """
        self = super().__new__(cls)
        for attribute, value in (("text", shown), ("names", names), ("tree", tree)):
            object.__setattr__(self, attribute, value)
        return self

    def margins(self) -> tuple[Margin, ...]:
        """Return the differences of what it compares: where one changes its sign, it may jump."""
        return margins(self.tree, self.text)

    @property
    def stepped(self) -> bool:
        """Whether it is a condition that changes at its `margins`, and nowhere else."""
        return is_stepped(self.tree)

    @property
    def smooth(self) -> bool:
        """Whether it has neither jumps nor kinks wherever it is finite, nor waves of its own."""
        return is_smooth(self.tree)

    @property
    def partial(self) -> bool:
        """Whether it may be undefined, infinite or either of two values for some of its fields."""
        return is_partial(self.tree)

    @property
    def peaked(self) -> bool:
        """Whether it may have peaks that are narrower than what its fields do."""
        return may_peak(self.tree)

    def kind(self, curved: Collection[str] = ()) -> Monotonicity:
        """Return whether it is a sum of fields, grows or falls with one, or neither.

        Parameters
        ----------
        curved : collection of str
            Names that are no polynomials along rays, such as the radius.
        """
        return kind_of(self.tree, curved)

    def evaluate(self, ops: Ops, values: Mapping[str, Any]) -> Any:
        """Return the value of the expression.

        Parameters
        ----------
        ops : Ops
            `NumpyOps` or `DrjitOps`.
        values : mapping of str to array
            The fields; all that are in `names` must be there.

        Returns
        -------
        array
            Numbers of the fields' common shape (a scalar array if no field is used). A comparison
            gives 1 and 0. Where a value does not exist, such as ``log10(0)``, infinite or NaN.

        Raises
        ------
        UnknownNameError
            If a field is missing; names the nearest.
        UnitsError
            If there are numbers with units in it: a volume converts them.
        """
        check_names(self, values)
        fitted, fields = ops.prepare({name: values[name] for name in self.names})
        # Dr.Jit knows no floating-point warnings; for NumPy the result itself says enough.
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

    def __reduce__(self) -> tuple[type[Expression], tuple[str]]:
        return Expression, (self.text,)


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
    """A field that is computed from others, with more than their values in the same cell.

    Attributes
    ----------
    name : str
        Its name in `Expression.names`.
    operation : str
        ``gradmag``, ``laplacian``, ``grad.x``, ``grad.y`` or ``grad.z``; ``los``, the component
        away from the observer; or ``along.x`` and the like, the component of a vector that is given
        by others.
    arguments : tuple of Expression
        What is differentiated; or the three components of a vector.
    """

    name: str
    operation: str
    arguments: tuple[Expression, ...]


@functools.lru_cache(maxsize=1024)
def derived_field(name: str) -> DerivedField | None:
    """Return what a name such as ``gradmag(a)`` stands for, however it is written; or None."""
    if "(" not in name:  # most names are identifiers
        return None
    try:
        tree, _ = parse(one_line(name))
    except ExpressionError:
        return None
    if not isinstance(tree, Derivative):
        return None
    argument = tree.argument
    parts = argument.components if isinstance(argument, Vector) else (argument,)
    return DerivedField(tree.name, tree.operation, tuple(Expression(text(p)) for p in parts))


def required_names(expression: Expression) -> tuple[str, ...]:
    """Return the fields and coordinates that an expression needs, those in derivatives too."""
    found: dict[str, None] = {}
    for name in expression.names:
        derived = derived_field(name)
        if derived is None:
            found[name] = None
            continue
        for argument in derived.arguments:
            found |= dict.fromkeys(required_names(argument))
    return tuple(found)


@dataclass(frozen=True)
class ComparisonField:
    """A comparison, and the field that tells whether it holds."""

    name: str
    condition: Expression


def on_one_side(
    expressions: Iterable[Expression],
) -> tuple[tuple[Expression, ...], tuple[ComparisonField, ...]]:
    """Return expressions without comparisons, and what these were, each once."""
    sides: dict[Node, ComparisonField] = {}
    found = tuple(_decided(expression, sides) for expression in expressions)
    return found, tuple(sides.values())


def _decided(expression: Expression, sides: dict[Node, ComparisonField]) -> Expression:
    tree = expression.tree
    before = tree.steps if isinstance(tree, Steps) else ()

    def side_of(node: Comparison) -> Field:
        own = in_steps(before, node)
        if own not in sides:
            name = f"%side {len(sides)}"
            condition = Expression.of_tree(own, _fields(own), f"{expression.text}: {name}")
            sides[own] = ComparisonField(name, condition)
        return Field(sides[own].name)

    new = _replaced(tree, side_of)
    return Expression.of_tree(new, _fields(new), f"{expression.text}: on one side")


def _fields(tree: Node) -> tuple[str, ...]:
    return tuple(dict.fromkeys(node.name for node in nodes(tree) if isinstance(node, Field)))


def _replaced(node: Any, side_of: Any) -> Any:
    if isinstance(node, tuple):
        return tuple(_replaced(part, side_of) for part in node)
    if isinstance(node, Comparison):
        return side_of(node)
    if not isinstance(node, Node) or isinstance(node, Field):
        return node
    parts = {f.name: getattr(node, f.name) for f in dataclasses.fields(node)}  # type: ignore[arg-type]
    return type(node)(**{name: _replaced(value, side_of) for name, value in parts.items()})
