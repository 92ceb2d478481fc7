"""What a derivative that an expression names is made of."""

from __future__ import annotations

import functools
from typing import NamedTuple

from ..errors import ExpressionError
from .expression import Expression
from .parser import parse
from .source import one_line
from .text import text
from .tree import Derivative


class DerivedField(NamedTuple):
    """A derivative of an expression.

    Attributes
    ----------
    name : str
        Its name in `Expression.names`.
    operation : str
        ``gradmag``, ``laplacian``, ``grad.x``, ``grad.y`` or ``grad.z``.
    argument : Expression
        What is differentiated.
    """

    name: str
    operation: str
    argument: Expression


@functools.lru_cache(maxsize=1024)
def derived_field(name: str) -> DerivedField | None:
    """Return the derivative that a name stands for, however it is written; None if it is none."""
    if "(" not in name:  # most names are identifiers
        return None
    try:
        tree, _ = parse(one_line(name))
    except ExpressionError:
        return None
    if not isinstance(tree, Derivative):
        return None
    return DerivedField(tree.name, tree.operation, Expression(text(tree.argument)))


def required_names(expression: Expression) -> tuple[str, ...]:
    """Return the fields and coordinates that an expression needs, those in derivatives too."""
    found: dict[str, None] = {}
    for name in expression.names:
        derived = derived_field(name)
        found |= dict.fromkeys((name,) if derived is None else required_names(derived.argument))
    return tuple(found)
